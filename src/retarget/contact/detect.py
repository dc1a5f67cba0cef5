"""Contacts of a body with itself: which points of its skin touch which others, from when to when, and why.

A vertex touches another part when it comes closer to it than a threshold (or is inside it). What is that close in the rest
pose, or near a shared joint, is how the body is built and does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body.skinning import Skinner, prepare_skinning, rest_vertices
from retarget.character import Character
from retarget.contact.collide import Collider, SurfacePairs, prepare_collider
from retarget.contact.parts import PARTS
from retarget.contact.slim import slim_bodies
from retarget.correspond.joints import Humanoid

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
    slim: tuple[Skinner, ...]
    """The same body slimmer and slimmer, in the same skin topology."""

    def frame(self, vertices: Float[Array, "vertices 3"]) -> SurfacePairs:
        """All touching pairs of one posed body."""
        return self.collider.pairs(vertices, self.threshold)

    def clip(
        self,
        world_rotations: Float[Array, "frames joints 4"],
        world_positions: Float[Array, "frames joints 3"],
        fps: float,
    ) -> Contacts:
        """Contacts of a whole clip from its world pose, tracked: they begin within the threshold, last until `LEAVE`
        thresholds, bridge gaps and are dropped below `SHORTEST` seconds."""
        found = []
        placed = hands_placed(self.humanoid, world_positions)
        step = 64  # posed surfaces in memory at a time
        for start in range(0, len(world_rotations), step):
            part = slice(start, start + step)
            posed = self.skinner.vertices(world_rotations[part], world_positions[part])
            slim = [each.vertices(world_rotations[part], world_positions[part]) for each in self.slim]
            for number, vertices in enumerate(posed):
                pairs = self.collider.pairs(vertices, LEAVE * self.threshold)
                stays = self._stays([bodies[number] for bodies in slim], pairs)
                own = self.collider.parts.vertex_parts[pairs.vertex]
                hand = np.maximum(placed[start + number, own], placed[start + number, pairs.part])
                found.append((np.full(len(pairs.vertex), start + number), pairs, np.maximum(stays, hand)))
        least = max(2, int(round(SHORTEST * fps))) if len(world_rotations) > 1 else 1
        return _tracked(found, self.threshold, least, self.collider)

    def _stays(self, slim: Sequence[Float[Array, "vertices 3"]], pairs: SurfacePairs) -> Float[Array, "pairs"]:
        """Share of the slimmer bodies on which the same points still meet in the same pose; a gap of one threshold counts
        full, of three not at all."""
        if not slim or len(pairs.vertex) == 0:
            return np.ones(len(pairs.vertex))
        corners = self.skinner.character.mesh.faces[pairs.face]
        shares = []
        for vertices in slim:
            touched = (pairs.barycentric[:, :, None] * vertices[corners]).sum(axis=1)
            gap = ((vertices[pairs.vertex] - touched) * pairs.normal).sum(axis=1)
            shares.append(np.clip((3.0 - gap / self.threshold) / 2.0, 0.0, 1.0))
        return np.mean(shares, axis=0)


def prepare_contacts(character: Character, humanoid: Humanoid, threshold: float | None = None) -> ContactDetector:
    """Prepare a body. `threshold` in metres (None: `THRESHOLD` of its height). Raises `RetargetError` for a character
    without a surface."""
    collider = prepare_collider(character, humanoid)
    rest = rest_vertices(character)
    if threshold is None:
        threshold = THRESHOLD * float(np.ptp((rest @ humanoid.axes[1])[collider.parts.body_vertices]))
    near = collider.pairs(rest, AT_REST * threshold)
    slim = tuple(prepare_skinning(each) for each in slim_bodies(character, humanoid, collider.parts))
    return ContactDetector(
        collider.without(near.vertex, near.part), threshold, prepare_skinning(character), humanoid, slim
    )


def hands_placed(
    humanoid: Humanoid, world_positions: Float[Array, "frames joints 3"]
) -> Float[Array, "frames parts"]:
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
        straight = np.clip((reach / np.maximum(length, 1e-12) - 0.90) / 0.07, 0.0, 1.0)
        downwards = ((hand - shoulder) * down).sum(axis=1) / np.maximum(reach, 1e-12)
        hanging = straight * np.clip((downwards - np.cos(np.radians(40))) / 0.14, 0.0, 1.0)
        placed[:, PARTS.index(f"{side}Hand")] = 1.0 - hanging
    return placed


def _tracked(
    found: list[tuple[Array, SurfacePairs, Array]], threshold: float, least: int, collider: Collider
) -> Contacts:
    """Rows of all frames, ordered into tracks; what never comes within the threshold or is too short is dropped."""
    frame = np.concatenate([frames for frames, _, _ in found] or [np.zeros(0, dtype=np.int64)])
    columns = {
        name: np.concatenate([getattr(pairs, name) for _, pairs, _ in found])
        for name in ("vertex", "part", "face", "barycentric", "distance")
    } if found else _no_rows()  # fmt: skip
    probability = np.concatenate([each for _, _, each in found] or [np.zeros(0)])
    order = np.lexsort((frame, columns["part"], columns["vertex"]))
    frame, probability = frame[order], probability[order]
    columns = {name: column[order] for name, column in columns.items()}
    vertex, part, distance = columns["vertex"], columns["part"], columns["distance"]
    new = np.ones(len(frame), dtype=bool)
    new[1:] = (np.diff(vertex) != 0) | (np.diff(part) != 0) | (np.diff(frame) > least)
    run = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    if len(first) == 0:
        last = first
        closest = first.astype(float)
    else:
        last = np.append(first[1:], len(frame)) - 1
        closest = np.minimum.reduceat(distance, first)
    kept = (closest < threshold) & (frame[last] + 1 - frame[first] >= least)
    number = np.cumsum(kept) - 1
    rows = kept[run] if len(run) else np.zeros(0, dtype=bool)
    track = number[run[rows]]
    frame, probability = frame[rows], probability[rows]
    columns = {name: column[rows] for name, column in columns.items()}
    starts = np.flatnonzero(np.diff(track, prepend=-1))
    # The closest row of each track: sorted by track and distance, the first of each.
    anchor = np.lexsort((columns["distance"], track))[starts] if len(starts) else starts
    count = np.maximum(np.bincount(track, minlength=len(starts)), 1)
    tracks = ContactTracks(
        vertex=columns["vertex"][starts],
        own_part=collider.parts.vertex_parts[columns["vertex"][starts]],
        part=columns["part"][starts],
        start=frame[starts],
        stop=frame[np.append(starts[1:], len(frame)) - 1] + 1 if len(starts) else frame[starts],
        anchor_frame=frame[anchor],
        face=columns["face"][anchor],
        barycentric=columns["barycentric"][anchor],
        pose_probability=np.bincount(track, weights=probability, minlength=len(starts)) / count,
    )
    by_frame = np.lexsort((columns["part"], columns["vertex"], frame))
    columns = {name: column[by_frame] for name, column in columns.items()}
    return Contacts(frame=frame[by_frame], track=track[by_frame], tracks=tracks, **columns)


def _no_rows() -> dict[str, Array]:
    none = np.zeros(0, dtype=np.int64)
    return {"vertex": none, "part": none, "face": none, "barycentric": np.zeros((0, 3)), "distance": np.zeros(0)}
