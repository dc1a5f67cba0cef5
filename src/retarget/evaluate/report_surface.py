"""The part of a report that needs skin: what is inside what, which contacts came along, what rests on the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.skinning import Skinner
from retarget.contact.carried import same_topology
from retarget.contact.collide import prepare_collider
from retarget.contact.detect import Contacts, prepare_contacts
from retarget.contact.ground_surface import RestingParts, resting_parts_of_clip
from retarget.contact.parts import PARTS, BodyParts
from retarget.evaluate import metrics
from retarget.evaluate.metrics.basis import at_reference_height
from retarget.evaluate.problems import Problem, cm, episodes, problem, spoken
from retarget.evaluate.take import Take
from retarget.progress import Tell, untold

Array = np.ndarray

CHUNK = 64
"""Posed surfaces in memory at a time."""
OF_POSE = 0.5
"""Probability from which a contact counts as one of the pose."""
INSIDE = 0.005
"""Metres at 1.7 m that skin may be inside other skin, beyond the source's; deeper makes a sentence. Ours."""
THROUGH_FLOOR = 0.015
"""The same for skin below the floor."""
OUTERMOST = ("Hand", "Foot", "Forearm", "Shin", "UpperArm", "Thigh", "head", "neck")
"""What sentences begin with, of two parts that meet."""


@dataclass(frozen=True, eq=False)
class DepthRows:
    """Vertices inside other parts of their body, one row a frame, vertex and part."""

    frame: Int[Array, "rows"]
    vertex: Int[Array, "rows"]
    part: Int[Array, "rows"]
    """Index into `PARTS` of what the vertex is inside."""
    depth: Float[Array, "rows"]
    """Metres, positive."""
    frames: int

    def dense(self, start: int, stop: int, parts: BodyParts) -> Float[Array, "frames vertices"]:
        """Depth of every vertex on some frames, 0 outside; all copies along texture seams alike."""
        depth = np.zeros((stop - start, len(parts.vertex_parts)))
        rows = slice(*np.searchsorted(self.frame, (start, stop)))
        np.maximum.at(depth, (self.frame[rows] - start, self.vertex[rows]), self.depth[rows])
        return depth[:, parts.welded]


@dataclass(frozen=True, eq=False)
class SurfaceTrack:
    """What the skin of one body does over a clip."""

    take: Take
    skinner: Skinner
    parts: BodyParts
    depths: DepthRows
    contacts: Contacts
    threshold: float
    """Metres within which skin touches."""
    resting: RestingParts

    def meeting(self, of_pose: bool) -> dict[tuple[int, int], Bool[Array, "frames"]]:
        """The frames on which each pair of parts touches; with `of_pose` only by contacts that belong to the pose."""
        rows, tracks = self.contacts, self.contacts.tracks
        chosen = tracks.pose_probability[rows.track] >= OF_POSE if of_pose else np.ones(len(rows.frame), bool)
        own = self.parts.vertex_parts[rows.vertex]
        pairs = np.sort(np.stack([own, rows.part], axis=1), axis=1)
        found: dict[tuple[int, int], Array] = {}
        for pair in np.unique(pairs[chosen], axis=0).tolist():
            on = np.zeros(len(self.take), dtype=bool)
            on[rows.frame[chosen & (pairs == pair).all(axis=1)]] = True
            found[tuple(pair)] = on
        return found

    def inside(self) -> dict[tuple[int, int], Float[Array, "frames"]]:
        """How deep each pair of parts is in each other on every frame, metres."""
        rows = self.depths
        pairs = np.sort(np.stack([self.parts.vertex_parts[rows.vertex], rows.part], axis=1), axis=1)
        found: dict[tuple[int, int], Array] = {}
        for pair in np.unique(pairs, axis=0).tolist():
            chosen = (pairs == pair).all(axis=1)
            depth = np.zeros(rows.frames)
            np.maximum.at(depth, rows.frame[chosen], rows.depth[chosen])
            found[tuple(pair)] = depth
        return found

    def deepest(self) -> Float[Array, "frames"]:
        """Depth of the deepest vertex on every frame, metres."""
        depth = np.zeros(self.depths.frames)
        np.maximum.at(depth, self.depths.frame, self.depths.depth)
        return depth


def surface_track(take: Take, floor: float, tell: Tell = untold) -> SurfaceTrack:
    """Collide, detect contacts and see what rests, over the whole clip. Raises `RetargetError` without a surface."""
    actor, fps = take.actor, take.fps
    detector = prepare_contacts(actor.character, actor.humanoid)
    collider = prepare_collider(actor.character, actor.humanoid, detector.collider.parts)
    skinner = detector.skinner
    columns: list[list[Array]] = [[np.zeros(0, int)] * 3 + [np.zeros(0)]]
    for start in range(0, len(take), CHUNK):
        tell(f"collisions, frame {start} of {len(take)}", 0)
        part = slice(start, start + CHUNK)
        for number, vertices in enumerate(skinner.vertices(take.rotations[part], take.positions[part])):
            pairs = collider.pairs(vertices.astype(np.float64))
            rows = pairs.distance < 0
            at = np.full(int(rows.sum()), start + number)
            columns.append([at, pairs.vertex[rows], pairs.part[rows], -pairs.distance[rows]])
    depths = DepthRows(*(np.concatenate(column) for column in zip(*columns)), len(take))
    tell("contacts", 0)
    contacts = detector.clip(*take.pose, fps)
    resting = resting_parts_of_clip(skinner, collider.parts, *take.pose, fps, actor.height, floor)
    return SurfaceTrack(take, skinner, collider.parts, depths, contacts, detector.threshold, resting)


def penetration_figures(track: SurfaceTrack) -> dict[str, float | None]:
    """Penetration of one body."""
    limb, height = track.parts.limb_vertices, track.take.actor.height
    deepest = track.deepest()
    frame = int(deepest.argmax())
    figures: dict[str, float | None] = {
        "penetration_percent": None, "depth_mean_mm": None, "depth_p95_mm": None,
        "deepest_mm": 1000 * at_reference_height(float(deepest[frame]), height),
        "deepest_at_s": frame / track.take.fps if deepest[frame] > 0 else None,
    }  # fmt: skip
    if not limb.any():
        return figures
    depths = _limb_depths(track)[None]
    every = np.ones(depths.shape[1], dtype=bool)
    return figures | {
        "penetration_percent": float(_percent(track).mean()),
        "depth_mean_mm": metrics.depth_mean_mm(depths, every, height),
        "depth_p95_mm": metrics.depth_p95_mm(depths, every, height),
    }


def _chunks(track: SurfaceTrack) -> Iterator[tuple[int, int]]:
    for start in range(0, len(track.take), CHUNK):
        yield start, min(start + CHUNK, len(track.take))


def _percent(track: SurfaceTrack) -> Float[Array, "frames"]:
    dense = (track.depths.dense(*frames, track.parts) for frames in _chunks(track))
    return np.concatenate([metrics.penetration_percent(depth, track.parts.limb_vertices) for depth in dense])


def _limb_depths(track: SurfaceTrack) -> Float[Array, "penetrating"]:
    """Depths of all limb vertices that are inside something, of all frames together."""
    found = []
    for frames in _chunks(track):
        depth = track.depths.dense(*frames, track.parts)[:, track.parts.limb_vertices]
        found.append(depth[depth > 0])
    return np.concatenate(found)


def added_penetration(source: SurfaceTrack, result: SurfaceTrack) -> dict[str, float | None]:
    """What penetrates in the result and not in the source, and what penetrates more. By vertex on one mesh, else by body
    part, where each part counts by its share of limb vertices; a coarser figure under its own name."""
    limb, one_mesh = result.parts.limb_vertices, same_topology(source.take.actor.character, result.take.actor.character)
    name = "new_penetration_percent" if one_mesh else "new_part_penetration_percent"
    if not (limb.any() and source.parts.limb_vertices.any()):
        return {name: None, "excess_penetration_percent": None}
    new = []
    for frames in _chunks(result):
        mine, theirs = (track.depths.dense(*frames, track.parts) for track in (result, source))
        if one_mesh:
            new.append(metrics.new_penetration_percent(mine, theirs, limb))
            continue
        groups = [np.where(track.parts.limb_vertices, track.parts.vertex_parts, -1) for track in (result, source)]
        percents = [
            metrics.part_penetration_percent(depth, group, len(PARTS)) for depth, group in zip((mine, theirs), groups)
        ]
        share = np.bincount(groups[0][limb], minlength=len(PARTS)) / limb.sum()
        new.append(metrics.new_part_penetration_percent(*percents) @ share)
    excess = metrics.excess_penetration_percent(_percent(result), _percent(source))
    return {name: float(np.concatenate(new).mean()), "excess_penetration_percent": float(excess.mean())}


def surface_curves(who: str, track: SurfaceTrack, bigger: float = 1.0) -> dict[str, Array]:
    """Depth over time, in the result's size, and what touches what and the ground."""
    curves: dict[str, Array] = {f"depth_cm/{who}": 100 * bigger * track.deepest()}
    for part, name in enumerate(PARTS):
        if not name.endswith(("Foot", "Hand")) and track.resting.touching[:, part].any():
            curves[f"ground/{who}/{spoken(name)}"] = track.resting.touching[:, part]
    return curves


def touch_curves(source: SurfaceTrack | None, result: SurfaceTrack) -> dict[str, Array]:
    """Which parts touch when. Pairs are shown that touch by the pose in either clip; girth alone is no event."""
    sides = {"result": result} if source is None else {"result": result, "source": source}
    wanted = {pair for track in sides.values() for pair in track.meeting(of_pose=True)}
    curves = {}
    for who, track in sides.items():
        # The source shows what its pose asks for; the result shows all that its skin does between the same parts.
        found = track.meeting(of_pose=who == "source")
        curves |= {f"touch/{who}/{pair_name(pair)}": on for pair, on in found.items() if pair in wanted}
    return curves


def _outer_and_inner(pair: tuple[int, int]) -> tuple[str, str]:
    """Who touches whom: hands before forearms before upper arms before the trunk."""
    return tuple(sorted((PARTS[part] for part in pair), key=lambda name: (_rank(name), PARTS.index(name))))


def _rank(part: str) -> int:
    bare = part.removeprefix("left").removeprefix("right")
    return OUTERMOST.index(bare) if bare in OUTERMOST else len(OUTERMOST)


def pair_name(pair: tuple[int, int]) -> str:
    """'right hand – abdomen'."""
    return " – ".join(map(spoken, _outer_and_inner(pair)))


def subject_and_other(pair: tuple[int, int]) -> tuple[str, str]:
    """Names for a sentence: 'right hand', 'the abdomen'."""
    subject, other = _outer_and_inner(pair)
    return spoken(subject), f"the {spoken(other)}"


def deepest_fact(track: SurfaceTrack) -> str | None:
    """'right hand in the abdomen, 3.2 cm at 2.43 s (frame 73)'."""
    rows = track.depths
    if len(rows.depth) == 0:
        return None
    row = int(rows.depth.argmax())
    pair = (int(track.parts.vertex_parts[rows.vertex[row]]), int(rows.part[row]))
    subject, other = subject_and_other(pair)
    frame = int(rows.frame[row])
    return f"{subject} in {other}, {cm(float(rows.depth[row]))} at {frame / track.take.fps:.2f} s (frame {frame})"


def penetrations(source: SurfaceTrack | None, result: SurfaceTrack) -> Iterator[Problem]:
    """A sentence for every pair of parts that is deeper in each other than in the source."""
    take, fps = result.take, result.take.fps
    tolerable = take.own_size(INSIDE)
    theirs = source.inside() if source is not None else {}
    bigger = take.actor.height / source.take.actor.height if source is not None else 1.0
    for pair, depth in result.inside().items():
        own = theirs.get(pair, np.zeros_like(depth)) * bigger
        for episode in episodes(depth, depth - own > tolerable, fps):
            subject, other = subject_and_other(pair)
            at = episode.worst
            text = f"{subject} is {cm(depth[at])} inside {other} at {at / fps:.2f} s"
            text += f" (the source's {cm(own[at])})" if own[at] > tolerable else ""
            yield problem(
                text, (depth[at] - own[at]) / tolerable, episode, fps, "inside", *map(PARTS.__getitem__, pair)
            )


def through_floor(source: SurfaceTrack | None, result: SurfaceTrack) -> Iterator[Problem]:
    """A sentence for every part below the floor, farther than the source's."""
    take, fps = result.take, result.take.fps
    tolerable = take.own_size(THROUGH_FLOOR)
    below = _below(result)
    own = np.zeros_like(below)
    if source is not None:
        own = _below(source) * (take.actor.height / source.take.actor.height)
    for part, name in enumerate(PARTS):
        beyond = below[:, part] - own[:, part]
        for episode in episodes(below[:, part], beyond > tolerable, fps):
            at = episode.worst
            text = f"{spoken(name)} is {cm(below[at, part])} below the floor at {at / fps:.2f} s"
            yield problem(text, beyond[at] / tolerable, episode, fps, "floor", name)


def _below(track: SurfaceTrack) -> Float[Array, "frames parts"]:
    heights = track.resting.heights
    return np.where(np.isfinite(heights), np.maximum(track.resting.floor - heights, 0.0), 0.0)
