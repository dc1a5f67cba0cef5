"""The dense mesh interaction (DMI) field of Ye 2024: where the rest of the body is, seen from every sensor of a limb.

An entry is d = t_i⁻¹ (p_j - p_i): the place of a target sensor j in the tangent frame of an observing sensor i, in metres
(section 3.3). Which entries there are is chosen on the source, frame by frame, and never again on the target: for every
observer and every part of the body that it looks at, the nearest and the farthest targets (half of L = 20 each).

    >>> plan = prepare_field(source_sensors, target_sensors)  # 288 sensors: 480 rows of 20 entries
    >>> selection = plan.select(source_places)
    >>> here = interaction_field(source_places, source_frames, selection.observers, selection.targets, selection.source)
    >>> there = interaction_field(target_places, target_frames, selection.observers, selection.targets, selection.both)
    >>> loss = cosine_loss(here, there, selection.both)  # `field_losses` has it

A *row* is one observer looking at one part. Rows are ordered by group, part, observer, so that each group, part and
group x part is a slice. What the paper leaves open, and our choices:
- which bones are an arm, a leg, the torso, the head: `PARTS`. Clavicles are torso: their skin is, and a hand can touch the
  shoulder of its own side;
- K, the number of rows: all sensors of the limbs look at all parts of their group (`GROUPS`). Its groups hold no hand on a
  knee; `prepare_field(groups=...)` takes others;
- an observer with fewer valid targets than L in a part has them all once, and the rest of its row masked;
- zero vectors (sensors in one place) have cosine 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from retarget.contact.sensor_bones import BONES, sensor_bones
from retarget.contact.sensors import Layout, Sensors, surface_points
from retarget.errors import RetargetError, unknown_name

Array = np.ndarray

_ARM, _LEG = ("UpperArm", "LowerArm", "Hand"), ("UpperLeg", "LowerLeg", "Foot")
PARTS: dict[str, tuple[str, ...]] = {
    "leftArm": tuple(f"left{bone}" for bone in _ARM),
    "rightArm": tuple(f"right{bone}" for bone in _ARM),
    "leftLeg": tuple(f"left{bone}" for bone in _LEG),
    "rightLeg": tuple(f"right{bone}" for bone in _LEG),
    "torso": ("spine", "chest", "leftShoulder", "rightShoulder"),
    "head": ("neck", "head"),
}
"""The sensor bones of each part of the body; every bone belongs to one. Ours."""

GROUPS: dict[str, tuple[str, ...]] = {
    "leftArm": ("rightArm", "head", "torso"),
    "rightArm": ("leftArm", "head", "torso"),
    "leftLeg": ("rightLeg", "torso"),
    "rightLeg": ("leftLeg", "torso"),
}
"""The parts that each limb looks at (Ye 2024, appendix C)."""

DISTANCES = 100_000
"""Squared distances looked at in one go while targets are chosen: stays in the cache."""
ENTRIES = 40_000
"""Entries computed in one go: stays in the cache."""


@dataclass(frozen=True, eq=False)
class Block:
    """The rows of one limb that looks at one part."""

    limb: str
    part: str
    rows: slice
    observers: Int[Array, "observers"]
    """Sensor of each row."""
    candidates: Int[Array, "candidates"]
    """Sensors of the part that are valid on the source."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Which pairs of sensors make up the field, frame by frame; chosen on the source."""

    observers: Int[Array, "rows"]
    """The sensor that looks, of each row."""
    targets: Int[Array, "frames rows targets"]
    """The sensors that it sees: first the nearest, nearest first, then the farthest, farthest first. Where there is none,
    the observer itself."""
    source: Bool[Array, "frames rows targets"]
    """Which entries exist on the source (M_src): the same on every frame, as it is the sensors that hit. Read only."""
    both: Bool[Array, "frames rows targets"]
    """Which of them exist on the target too (M_tgt): those that are compared."""


@dataclass(frozen=True, eq=False)
class FieldPlan:
    """What the field of a pair of bodies needs and does not depend on the pose; `prepare_field` makes one."""

    layout: Layout
    nearest: int
    farthest: int
    valid: tuple[Bool[Array, "sensors"], Bool[Array, "sensors"]]
    """Sensors that hit, on the source and on the target."""
    blocks: tuple[Block, ...]
    observers: Int[Array, "rows"]
    """The sensor that looks, of each row."""
    exists: Bool[Array, "rows targets"]
    """Which entries exist on the source: fewer than all where a part has few sensors or the observer missed."""
    radii: tuple[Float[Array, "rows"], Float[Array, "rows"]]
    """Mean radius (metres) of the limb that each row looks out from, on source and target; 1 for a limb without sensors,
    no entry of which exists."""
    heights: tuple[float, float]
    """Of the two bodies, metres."""

    def rows(self, limb: str) -> slice:
        """The rows of a group. Raises `RetargetError` for a limb that is none."""
        own = [block.rows for block in self.blocks if block.limb == limb]
        if not own:
            raise unknown_name("limb", limb, tuple(dict.fromkeys(block.limb for block in self.blocks)), "the field")
        return slice(own[0].start, own[-1].stop)

    def select(self, source_positions: Float[Array, "frames sensors 3"]) -> Selection:
        """Choose the nearest and the farthest targets of every row on every frame of the source.

        Raises `RetargetError` for positions of another number of sensors and for positions that are not finite.
        """
        require_positions(source_positions, len(self.layout))
        frames = len(source_positions)
        targets = np.empty((frames, *self.exists.shape), dtype=np.int32)
        both = np.empty(targets.shape, dtype=bool)
        share = self.valid[0] / max(1, np.count_nonzero(self.valid[0]))
        largest = max(len(block.observers) * len(block.candidates) for block in self.blocks)
        for now in stretches(frames, DISTANCES // max(1, largest)):
            # |p|² - 2 p . q + |q|² as one product; about the body's middle and in double precision, so that it costs no
            # digits wherever the body is.
            places = source_positions[now] - (share @ source_positions[now])[:, None]
            lines = np.ones((2, *places.shape[:2], 5))
            lines[0, ..., :3], lines[1, ..., :3] = places, -2.0 * places
            lines[0, ..., 3] = lines[1, ..., 4] = dot(places, places)
            for block in self.blocks:
                self._select(block, lines, targets[now, block.rows], both[now, block.rows])
        both &= self.exists & self.valid[1][self.observers, None]
        np.copyto(targets, self.observers[:, None], where=~self.exists)
        return Selection(self.observers, targets, np.broadcast_to(self.exists, targets.shape), both)

    def _select(self, block: Block, lines: Float[Array, "2 frames sensors 5"], targets: Array, both: Array) -> None:
        """Fill in the targets of a block, and whether they are valid on the target."""
        near, far = _shares(block, self.nearest, self.farthest)
        seen = lines[1][:, block.candidates].transpose(0, 2, 1)
        for rows in stretches(len(block.observers), DISTANCES // max(1, len(block.candidates))):
            squared = lines[0][:, block.observers[rows]] @ seen
            chosen = np.take(block.candidates, nearest_and_farthest(squared, near, far))
            targets[:, rows, : near + far] = chosen
            both[:, rows, : near + far] = np.take(self.valid[1], chosen)


def prepare_field(
    source: Sensors,
    target: Sensors,
    nearest: int = 10,
    farthest: int = 10,
    groups: Mapping[str, tuple[str, ...]] = GROUPS,
) -> FieldPlan:
    """Lay out the field of two bodies. `nearest` and `farthest` are targets a row (0 leaves a kind out: the paper's
    nearest-only and farthest-only rows); `groups` names the parts that each limb looks at.

    Raises `RetargetError` for sensors of different layouts, for numbers that are negative or both zero, for unknown parts.
    """
    if len(source) != len(target) or not all(
        np.array_equal(getattr(source.layout, name), getattr(target.layout, name))
        for name in ("bones", "along", "around")
    ):
        raise RetargetError(f"sensors correspond on one layout only; received {len(source)} and {len(target)} sensors")
    if nearest < 0 or farthest < 0 or nearest + farthest == 0:
        raise RetargetError(
            f"nearest and farthest are numbers of targets, not both zero; received {nearest} and {farthest}"
        )
    for name in (*groups, *(part for parts in groups.values() for part in parts)):
        if name not in PARTS:
            raise unknown_name("part", name, tuple(PARTS), "the field")
    blocks = _blocks(source, groups)
    if not blocks:
        raise RetargetError("a field needs at least one limb that looks at one part; received none")
    radii = []
    for sensors in (source, target):
        own = part_radii(sensors)
        radii.append(np.concatenate([np.full(len(block.observers), own.get(block.limb, 1.0)) for block in blocks]))
    return FieldPlan(
        source.layout,
        nearest,
        farthest,
        (source.valid, target.valid),
        blocks,
        np.concatenate([block.observers for block in blocks]),
        _existing(blocks, source.valid, nearest, farthest),
        tuple(radii),
        (source.stance.height, target.stance.height),
    )


def _blocks(source: Sensors, groups: Mapping[str, tuple[str, ...]]) -> tuple[Block, ...]:
    part_of_bone = np.array([next(part for part, own in PARTS.items() if bone in own) for bone in BONES])
    part_of_sensor = part_of_bone[source.layout.bones]
    blocks, start = [], 0
    for limb, parts in groups.items():
        observers = np.flatnonzero(part_of_sensor == limb)
        for part in parts:
            rows = slice(start, start + len(observers))
            candidates = np.flatnonzero((part_of_sensor == part) & source.valid)
            blocks.append(Block(limb, part, rows, observers, candidates))
            start = rows.stop
    return tuple(blocks)


def _shares(block: Block, nearest: int, farthest: int) -> tuple[int, int]:
    """How many targets of either kind a block's rows have: no target twice, the nearest first."""
    near = min(nearest, len(block.candidates))
    return near, min(farthest, len(block.candidates) - near)


def _existing(
    blocks: tuple[Block, ...], valid: Bool[Array, "sensors"], nearest: int, farthest: int
) -> Bool[Array, "rows targets"]:
    """Which entries exist on the source: the first ones of a row."""
    exists = np.zeros((blocks[-1].rows.stop, nearest + farthest), dtype=bool)
    for block in blocks:
        exists[block.rows, : sum(_shares(block, nearest, farthest))] = valid[block.observers][:, None]
    return exists


def part_radii(sensors: Sensors) -> dict[str, float]:
    """Mean distance (metres) of each part's valid sensors from the bones they look out from; parts without are left out.

    Sensors on tilted rays, beyond the ends of their bones, do not count. Ye 2024 divides by an arm's radius and leaves
    open how it is measured; this is ours.
    """
    stance, layout = sensors.stance, sensors.layout
    places = surface_points(stance.vertices, stance.faces, sensors.faces, sensors.barycentrics)
    bones = list(sensor_bones(stance).values())
    parents, children = (np.stack([getattr(bone, end) for bone in bones]) for end in ("parent", "child"))
    origins = (1 - layout.along)[:, None] * parents[layout.bones] + layout.along[:, None] * children[layout.bones]
    away = np.linalg.norm(places - origins, axis=1)
    counted = sensors.valid & (layout.along >= 0) & (layout.along < 1)
    radii = {}
    for part, names in PARTS.items():
        own = counted & np.isin(layout.bones, [BONES.index(name) for name in names])
        if own.any():
            radii[part] = float(away[own].mean())
    return radii


# --- on plain arrays ------------------------------------------------------------------------------------------------


def nearest_and_farthest(
    squared: Float64[Array, "frames observers candidates"], nearest: int, farthest: int
) -> Int[Array, "frames observers chosen"]:
    """Indices of the `nearest` candidates, nearest first, then of the `farthest`, farthest first; of two at one distance
    the lower index counts as nearer. At most as many as there are candidates are asked for.

    `squared` are squared distances (metres²); they are overwritten. They give their last bits (one
    part in 2⁴⁴ with 256 candidates) to the candidate's index: one sort of whole numbers then yields both kinds, several
    times faster than `argsort` or `argpartition`.
    """
    count = squared.shape[-1]
    keys = squared.view(np.int64)  # in the same order; what rounding left below zero comes first
    low = (1 << max(1, (count - 1).bit_length())) - 1
    keys &= ~low
    keys |= np.arange(count)
    keys.sort(axis=-1)
    chosen = np.concatenate([keys[..., :nearest], keys[..., count - farthest :][..., ::-1]], axis=-1)
    chosen &= low
    return chosen


def interaction_field(
    positions: Float[Array, "frames sensors 3"],
    frames: Float[Array, "frames sensors 3 3"],
    observers: Int[Array, "rows"],
    targets: Int[Array, "frames rows targets"],
    mask: Bool[Array, "frames rows targets"],
) -> Float[Array, "frames rows targets 3"]:
    """The entries t_i⁻¹ (p_j - p_i) of a selection on one body, metres; zero where the mask says that there is none.

    `positions` and `frames` are a `SensorSkinner`'s: the columns of a frame are orthonormal, its inverse is its transpose.
    In the precision of the positions.
    """
    count, sensors, _ = positions.shape
    field = np.empty((*targets.shape, 3), dtype=np.result_type(positions, frames))
    for part in stretches(count, ENTRIES // max(1, int(np.prod(targets.shape[1:])))):
        now = positions[part]
        seen = np.where(mask[part], targets[part], observers[:, None])  # a masked entry looks at itself: zero
        seen = seen + sensors * np.arange(len(now))[:, None, None]
        away = np.take(now.reshape(-1, 3), seen, axis=0)
        away -= now[:, observers, None]
        np.matmul(away, frames[part][:, observers], out=field[part])  # rows: d^T = (p_j - p_i)^T t_i
    return field


def semantic_coordinates(
    layout: Layout, observers: Int[Array, "rows"], targets: Int[Array, "frames rows targets"]
) -> tuple[
    Int[Array, "frames rows targets 2"], Float[Array, "frames rows targets 2"], Float[Array, "frames rows targets 2"]
]:
    """(b_i, b_j), (l_i, l_j) and (phi_i, phi_j) of every entry: what a network reads beside d (P = 9 with it).

    As large as two fields: ask for a stretch of frames at a time.
    """
    pairs = np.empty((*targets.shape, 2), dtype=np.int32)
    pairs[..., 0], pairs[..., 1] = observers[:, None], targets
    return tuple(np.take(values, pairs) for values in (layout.bones, layout.along, layout.around))


def dot(a: Float[Array, "*pairs 3"], b: Float[Array, "*pairs 3"]) -> Float[Array, "*pairs"]:
    """Inner products of vectors, written out: several times faster than einsum and sum along an axis of three."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def stretches(frames: int, step: int) -> list[slice]:
    """Frames, `step` at a time."""
    step = max(1, step)
    return [slice(start, start + step) for start in range(0, frames, step)]


def require_positions(positions: Array, sensors: int) -> None:
    """Raise `RetargetError` for places of another number of sensors, and for some that are not finite."""
    if positions.shape[1] != sensors:
        raise RetargetError(f"the field has {sensors} sensors; received positions of {positions.shape[1]}")
    if not np.isfinite(positions).all():
        frame = int(np.flatnonzero(~np.isfinite(positions).all(axis=(1, 2)))[0])
        raise RetargetError(f"positions of sensors must be finite; those of frame {frame} are not")
