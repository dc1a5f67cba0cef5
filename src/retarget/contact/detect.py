"""Contacts of a body with itself: which points of its skin touch which others, from when to when, and why.

A vertex touches another part when it comes closer to it than a threshold (or is inside it). What is that close in the rest
pose, or near a shared joint, is how the body is built and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import joint_transforms
from retarget.body.skinning import Skinner, prepare_skinning, rest_vertices
from retarget.character import Character
from retarget.contact.collide import Collider, SurfacePairs, prepare_collider
from retarget.contact.parts import PARTS, body_height
from retarget.contact.slim import slim_bodies
from retarget.contact.thinned import ThinnedSkin, thinned_skin
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError

Array = np.ndarray

THRESHOLD = 0.012
"""Share of the body's height within which skin touches."""
LEAVE = 1.5
"""Thresholds beyond which a contact has ended."""
AT_REST = 3.0
"""Thresholds: what is closer than this to a part in the rest pose makes no contact with it (Basset 2019 leaves open how
contacts of the body's build are told apart; this is ours)."""
SHORTEST = 0.07
"""Seconds that a contact lasts at least, and the longest gap that is bridged."""


HANGS_BESIDE = np.zeros((len(PARTS), len(PARTS)), dtype=bool)
"""A hand and the thigh or the pelvis that it hangs beside."""
for _side in ("left", "right"):
    for _other in (f"{_side}Thigh", "pelvis"):
        _pair = [PARTS.index(f"{_side}Hand"), PARTS.index(_other)]
        HANGS_BESIDE[_pair, _pair[::-1]] = True


@dataclass(frozen=True, eq=False)
class Contacts:
    """Touching points of a clip, one row a frame, vertex and part, by frame, vertex and part."""

    frame: Int[Array, "rows"]
    vertex: Int[Array, "rows"]
    part: Int[Array, "rows"]
    """Index into `contact.parts.PARTS` of what the vertex touches."""
    face: Int[Array, "rows"]
    """Face of the mesh with the touched point."""
    barycentric: Float[Array, "rows 3"]
    """The touched point in that face."""
    distance: Float[Array, "rows"]
    """Signed, metres; negative where the vertex is inside."""
    track: Int[Array, "rows"]
    """Row of `tracks` that each belongs to."""
    tracks: ContactTracks


@dataclass(frozen=True, eq=False)
class ContactTracks:
    """Contacts over time: a vertex that touches a part from one frame to another."""

    vertex: Int[Array, "tracks"]
    own_part: Int[Array, "tracks"]
    part: Int[Array, "tracks"]
    start: Int[Array, "tracks"]
    """First frame."""
    stop: Int[Array, "tracks"]
    """Frame after the last."""
    anchor_frame: Int[Array, "tracks"]
    """The frame on which the vertex is closest, or deepest."""
    face: Int[Array, "tracks"]
    """Face with the touched point on that frame."""
    barycentric: Float[Array, "tracks 3"]
    pose_probability: Float[Array, "tracks"]
    """How likely the contact belongs to the pose (1) and not to the body's girth (0)."""


@dataclass(frozen=True, eq=False)
class ContactDetector:
    """A body prepared for contact detection; `prepare_contacts` makes one."""

    collider: Collider
    """Tests nothing that is close at rest."""
    threshold: float
    """Metres within which skin touches."""
    skinner: Skinner
    humanoid: Humanoid
    slim: Float[Array, "bodies vertices 3"]
    """The vertices of the same body slimmer and slimmer, as it is bound."""
    thinned: ThinnedSkin
    """The vertices that are tested."""

    def frame(self, vertices: Float[Array, "vertices 3"]) -> SurfacePairs:
        """All touching pairs of one posed body."""
        return self.collider.pairs(vertices, self.threshold)

    def clip(
        self,
        world_rotations: Float[Array, "frames joints 4"],
        world_positions: Float[Array, "frames joints 3"],
        fps: float,
    ) -> Contacts:
        """Contacts of a whole clip from its world pose (positions in metres), tracked: they begin within the threshold,
        last until `LEAVE` thresholds, bridge gaps and are dropped below `SHORTEST` seconds. Rows of the frames that a
        gap bridges are absent. Raises `RetargetError` for a pose that is not this body's or not finite."""
        found = []
        placed = hands_placed(self.humanoid, world_positions)
        step = 64  # posed surfaces in memory at a time
        for start in range(0, len(world_rotations), step):
            part = slice(start, start + step)
            posed = self.skinner.vertices(world_rotations[part], world_positions[part])
            moves = self._moves(world_rotations[part], world_positions[part])
            for number, vertices in enumerate(posed):
                pairs = self.collider.pairs(vertices, LEAVE * self.threshold)
                stays = self._stays(moves[number], pairs)
                own = self.collider.parts.vertex_parts[pairs.vertex]
                hand = np.maximum(placed[start + number, own], placed[start + number, pairs.part])
                beside = HANGS_BESIDE[own, pairs.part]  # there a hand touches because arms hang, on thin bodies too
                belongs = np.where(beside, hand, np.maximum(stays, hand))
                found.append((np.full(len(pairs.vertex), start + number), pairs, belongs))
        least = min(max(1, round(SHORTEST * fps)), max(1, len(world_rotations)))
        return _tracked(found, self.threshold, least, self.collider)

    def _moves(self, world_rotations: Array, world_positions: Array) -> Float[Array, "frames columns 3 4"]:
        """World-from-mesh of every column of the skin; none are needed where there is no slimmer body."""
        if len(self.slim) == 0:
            return np.zeros((len(world_rotations), 0, 3, 4))
        skin = self.skinner.character.skin
        T_world_joint = joint_transforms(world_rotations, world_positions)[:, skin.joints, :3]
        return np.ascontiguousarray(T_world_joint @ skin.inverse_binds)

    def _stays(self, moves: Float[Array, "columns 3 4"], pairs: SurfacePairs) -> Float[Array, "pairs"]:
        """Share of the slimmer bodies on which the same points still meet in the same pose; a gap of one threshold counts
        full, of three not at all. All 1 where the body is thin already."""
        shares = np.ones(len(pairs.vertex))
        if len(self.slim) and len(shares):
            from retarget.contact import skin_kernels

            skin, faces = self.skinner.character.skin, self.skinner.character.mesh.faces
            skin_kernels.touching_share(
                moves, skin.columns, skin.weights, self.slim, pairs.vertex, faces[pairs.face], pairs.barycentric,
                pairs.normal, float(self.threshold), shares,
            )  # fmt: skip
        return shares


def prepare_contacts(
    character: Character, humanoid: Humanoid, threshold: float | None = None, spacing: float = 0.0
) -> ContactDetector:
    """Prepare a body. `threshold` in metres (None: `THRESHOLD` of its height); of vertices closer together than `spacing`
    (a share of its height) only one is tested. Raises `RetargetError` for a character without a surface and for a
    threshold that is no length."""
    if threshold is not None and not 0.0 < threshold < np.inf:
        raise RetargetError(f"the contact threshold must be a length in metres above 0, received {threshold!r}")
    collider = prepare_collider(character, humanoid)
    rest = rest_vertices(character)
    height = body_height(rest, collider.parts, humanoid)
    threshold = THRESHOLD * height if threshold is None else threshold
    near = collider.pairs(rest, AT_REST * threshold)
    thinned = thinned_skin(rest, collider.blocks.vertices, spacing * height)
    slim = [each.mesh.vertices for each in slim_bodies(character, humanoid, collider.parts)]
    return ContactDetector(
        collider.without(near.vertex, near.part).only(thinned.kept), threshold, prepare_skinning(character), humanoid,
        np.array(slim).reshape(len(slim), len(rest), 3), thinned,
    )  # fmt: skip


def hands_placed(humanoid: Humanoid, world_positions: Float[Array, "frames joints 3"]) -> Float[Array, "frames parts"]:
    """How sure it is that a hand was put where it is, whatever the body's girth: 1 for a hand on a bent or raised arm, 0
    for one that hangs beside the thigh. By part; 0 for parts that are no hands.

    Girth alone cannot tell a hand on a heavy belly from a heavy arm against its flank: on a slim body both let go. An arm
    hangs when it is straight and points down the trunk. Ours.
    """
    joints = humanoid.joints
    at = {name: world_positions[:, joint] for name, joint in joints.items()}
    down = at["hips"] - at["neck" if "neck" in joints else "head"]
    down = down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-12)
    placed = np.zeros((len(world_positions), len(PARTS)))
    for side in ("left", "right"):
        shoulder, elbow, hand = (at[f"{side}{name}"] for name in ("UpperArm", "LowerArm", "Hand"))
        length = np.linalg.norm(elbow - shoulder, axis=1) + np.linalg.norm(hand - elbow, axis=1)
        reach = np.linalg.norm(hand - shoulder, axis=1)
        # An arm that hangs at ease is bent by up to 45 degrees (reach .92), one with its hand on the hip by 80 (.77).
        straight = np.clip((reach / np.maximum(length, 1e-12) - 0.82) / 0.08, 0.0, 1.0)
        downwards = ((hand - shoulder) * down).sum(axis=1) / np.maximum(reach, 1e-12)
        hanging = straight * np.clip((downwards - np.cos(np.radians(40))) / 0.14, 0.0, 1.0)
        placed[:, PARTS.index(f"{side}Hand")] = 1.0 - hanging
    return placed


def _tracked(
    found: list[tuple[Array, SurfacePairs, Array]], threshold: float, least: int, collider: Collider
) -> Contacts:
    """Rows of all frames, ordered into tracks; what never comes within the threshold or is too short is dropped."""
    rows = _by_vertex_and_part(found)
    frame, distance = rows["frame"], rows["distance"]
    same = (np.diff(rows["vertex"]) == 0) & (np.diff(rows["part"]) == 0) & (np.diff(frame) <= least)
    run = np.cumsum(np.append(True, ~same))[: len(frame)] - 1
    # A track begins with the first row within the threshold, though the run may have been near before.
    starts = np.flatnonzero(np.append(True, ~same)[: len(frame)])
    begun, last = np.zeros(0), np.zeros(0)
    if len(starts):
        begun = np.minimum.reduceat(np.where(distance < threshold, frame.astype(float), np.inf), starts)
        last = frame[np.append(starts[1:], len(frame)) - 1]  # rows of a run come by frame
    kept = (frame >= begun[run]) & (last[run] + 1 - begun[run] >= least)
    rows = {name: column[kept] for name, column in rows.items()}
    _, first, track = np.unique(run[kept], return_index=True, return_inverse=True)
    track = track.ravel()
    stop = np.append(first[1:], len(track))[: len(first)]  # none where nothing touches
    anchor = np.lexsort((rows["distance"], track))[first]  # the closest row of each track
    count = np.bincount(track, minlength=len(first))
    tracks = ContactTracks(
        vertex=rows["vertex"][first],
        own_part=collider.parts.vertex_parts[rows["vertex"][first]],
        part=rows["part"][first],
        start=rows["frame"][first],
        stop=rows["frame"][stop - 1] + 1,
        anchor_frame=rows["frame"][anchor],
        face=rows["face"][anchor],
        barycentric=rows["barycentric"][anchor],
        pose_probability=np.bincount(track, weights=rows["probability"], minlength=len(first)) / count,
    )
    by_frame = np.lexsort((rows["part"], rows["vertex"], rows["frame"]))
    columns = {name: column[by_frame] for name, column in rows.items() if name != "probability"}
    return Contacts(track=track[by_frame], tracks=tracks, **columns)


def _by_vertex_and_part(found: list[tuple[Array, SurfacePairs, Array]]) -> dict[str, Array]:
    """All frames' rows as columns, by vertex, part and frame; of several pieces of one part only the nearest."""
    integers, floats = np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = {"frame": np.concatenate([integers, *(frames for frames, _, _ in found)])}
    for name in ("vertex", "part", "face"):
        rows[name] = np.concatenate([integers, *(getattr(pairs, name) for _, pairs, _ in found)])
    rows["barycentric"] = np.concatenate([np.zeros((0, 3)), *(pairs.barycentric for _, pairs, _ in found)])
    rows["distance"] = np.concatenate([floats, *(pairs.distance for _, pairs, _ in found)])
    rows["probability"] = np.concatenate([floats, *(probability for _, _, probability in found)])
    key = (rows["vertex"] * len(PARTS) + rows["part"]) * (int(rows["frame"].max(initial=0)) + 1) + rows["frame"]
    order = np.lexsort((rows["distance"], key))
    nearest = order[np.append(True, np.diff(key[order]) != 0)[: len(order)]]
    return {name: column[nearest] for name, column in rows.items()}
