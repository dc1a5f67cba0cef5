"""What of a body's skin rests on the ground: feet, but also the back in a roll, the seat, knees, hands in a cartwheel.

`ground.py` follows a few points that every skeleton has; this looks at the whole posed surface. A part rests while some of
its lowest skin is near the ground and does not move: so a back that rolls without slipping rests although no point of
it stays, and a foot that slides does not. All thresholds scale with the height of the body, and are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from retarget.body.skinning import Skinner
from retarget.contact.ground import (
    ENTER_SHARE,
    LEAVE_SHARE,
    PEAK_WINDOW,
    SHORTEST,
    hysteresis,
    intervals,
    running_maximum,
    without_short_runs,
)
from retarget.contact.parts import PARTS, BodyParts

Array = np.ndarray

# For a body of 1.7 m.
ENTER_SPEED, LEAVE_SPEED = 0.12 / 1.7, 0.25 / 1.7
"""Heights a second below which the lowest skin of a part begins to rest, above which it has left."""
ENTER_HEIGHT, LEAVE_HEIGHT = 0.025 / 1.7, 0.04 / 1.7
"""Heights over the floor at which a part begins to rest, and at which it has left."""
DEEPEST = 0.15 / 1.7
"""Heights below the floor at which a part has gone through it and rests on nothing."""
LAYER = 0.01 / 1.7
"""Heights above a part's lowest vertex to which skin counts as lowest: about the distance of two vertices."""
RAISED_SHARE = 0.5
"""Share of `ENTER_SPEED` that skin on something higher than the floor comes down to: a real rest."""
CHUNK = 64
"""Frames posed at a time."""


@dataclass(frozen=True, eq=False)
class RestingParts:
    """Which parts of a body rest on the ground."""

    touching: Bool[Array, "frames parts"]
    """Whether the part (`contact.parts.PARTS`) rests on something."""
    support: Float[Array, "frames parts"]
    """Height of what it rests on (metres); the floor where it does not rest."""
    heights: Float[Array, "frames parts"]
    """Height of each part's lowest point, metres; inf for parts that the body does not have."""
    floor: float
    """Height of the floor, metres."""


def resting_parts(
    vertices: Float[Array, "frames vertices 3"], parts: BodyParts, fps: float, height: float, floor: float
) -> RestingParts:
    """Which parts of a posed surface rest. `height` is the body's (metres), `floor` where its main floor is, as
    `ground.GroundContacts.floor` says."""
    heights, speeds = lowest_skin(vertices, parts, fps, height)
    return _resting(heights, speeds, fps, height, floor)


def resting_parts_of_clip(
    skinner: Skinner,
    parts: BodyParts,
    world_rotations: Float[Array, "frames joints 4"],
    world_positions: Float[Array, "frames joints 3"],
    fps: float,
    height: float,
    floor: float,
) -> RestingParts:
    """The same from a world pose, with few posed surfaces in memory at a time."""
    frames, reach = len(world_positions), _reach(fps)
    rows = []
    for start in range(0, frames, CHUNK):
        first, last = max(start - reach, 0), min(start + CHUNK + reach, frames)
        posed = skinner.vertices(world_rotations[first:last], world_positions[first:last])
        inner = slice(start - first, start - first + min(CHUNK, frames - start))
        rows.append([each[inner] for each in lowest_skin(posed, parts, fps, height)])
    heights, speeds = (np.concatenate(column) for column in zip(*rows)) if rows else np.zeros((2, 0, len(PARTS)))
    return _resting(heights, speeds, fps, height, floor)


def lowest_skin(
    vertices: Float[Array, "frames vertices 3"], parts: BodyParts, fps: float, height: float
) -> tuple[Float[Array, "frames parts"], Float[Array, "frames parts"]]:
    """Height of each part's lowest point, and the speed (m/s) of the slowest skin among its lowest; inf for parts that the
    body does not have. Speeds are central differences over about a twentieth of a second, one-sided at the ends."""
    frames, body = len(vertices), parts.body_vertices
    reach = _reach(fps)
    ahead = np.minimum(np.arange(frames) + reach, frames - 1)
    behind = np.maximum(np.arange(frames) - reach, 0)
    lowest, slowest = np.full((2, frames, len(PARTS)), np.inf)
    for part in range(len(PARTS)):
        own = np.flatnonzero(body & (parts.vertex_parts == part))
        if len(own) == 0 or frames == 0:
            continue
        skin = vertices[:, own].astype(np.float64)
        lowest[:, part] = skin[..., 1].min(axis=1)
        if frames > 1:
            speed = np.linalg.norm(skin[ahead] - skin[behind], axis=-1) * (fps / (ahead - behind))[:, None]
        else:
            speed = np.zeros(skin.shape[:2])
        low = skin[..., 1] <= lowest[:, part, None] + LAYER * height
        slowest[:, part] = np.where(low, speed, np.inf).min(axis=1)
    return lowest, slowest


def _reach(fps: float) -> int:
    return max(1, int(round(fps / 40)))


def _resting(
    heights: Float[Array, "frames parts"],
    speeds: Float[Array, "frames parts"],
    fps: float,
    height: float,
    floor: float,
) -> RestingParts:
    speed = speeds / height
    peak = running_maximum(speed, int(round(PEAK_WINDOW * fps))) if len(speed) else speed
    peak = np.where(np.isfinite(peak), peak, 0.0)
    over = (heights - floor) / height
    present = over > -DEEPEST
    begins = (over < ENTER_HEIGHT) & (speed < np.maximum(ENTER_SPEED, ENTER_SHARE * peak)) & present
    lasts = (over < LEAVE_HEIGHT) & (speed < np.maximum(LEAVE_SPEED, LEAVE_SHARE * peak)) & present
    least = max(2, int(round(SHORTEST * fps))) if len(speed) > 1 else 1
    touching = hysteresis(begins, lasts)
    touching = np.stack([without_short_runs(run, least) for run in touching.T], axis=1)
    support = np.full(heights.shape, floor)
    _add_raised(touching, support, heights, speed, over, least)
    return RestingParts(touching, support, heights, floor)


def _add_raised(
    touching: Bool[Array, "frames parts"],
    support: Float[Array, "frames parts"],
    heights: Float[Array, "frames parts"],
    speed: Float[Array, "frames parts"],
    over: Float[Array, "frames parts"],
    least: int,
) -> None:
    """Stairs, boxes, beds: what comes to a real rest higher up, is the lowest of the body and for a while all that can
    carry it. Works in place."""
    carried = touching.any(axis=1)
    slow = hysteresis(speed < RAISED_SHARE * ENTER_SPEED, speed < ENTER_SPEED) & (over >= ENTER_HEIGHT)
    lowest = over <= over.min(axis=1, keepdims=True) + ENTER_HEIGHT
    for part in range(touching.shape[1]):
        for start, stop in intervals(without_short_runs(slow[:, part], least)):
            alone = ~carried[start:stop] & lowest[start:stop, part]
            if alone.sum() >= 2 * least:
                touching[start:stop, part] = True
                support[start:stop, part] = float(np.median(heights[start:stop, part]))
