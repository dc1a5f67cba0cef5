"""Where a body stands: which of its points rest on the ground, when, and at what height.

Works on trajectories of a few points (heels, balls of the feet, palms), so that it serves motions with and without a
surface. Every threshold scales with the leg length: a toddler and a giant are judged alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

Array = np.ndarray

# Our choices, for a leg of 0.9 m (the published thresholds, NKN's 0.12 m/s among them, do not scale with the body).
ENTER_SPEED = 0.12 / 0.9
"""Leg lengths a second below which a low point begins to rest."""
LEAVE_SPEED = 0.25 / 0.9
"""Leg lengths a second above which a resting point has left."""
ENTER_SHARE, LEAVE_SHARE = 0.06, 0.12
"""The same as shares of the point's highest speed within `PEAK_WINDOW`: a running foot never stands as still as a
walking one, but it is still against its own swing."""
PEAK_WINDOW = 0.25
"""Seconds, to both sides."""
HEIGHT = 0.045 / 0.9
"""Leg lengths above its support at which a point can still rest (soft soles, noise of captured feet)."""
SNAP = 0.04 / 0.9
"""Supports closer than this to the floor are the floor."""
HAND = 0.25
"""Leg lengths by which the palm of a body without fingers can be misplaced: what hands show up to so much below the floor
of the feet is that floor."""
STANDING = 0.6
"""Leg lengths over the floor at which the hips of a standing body are at least."""
THICKNESS = 0.05
"""Leg lengths between the floor and the joint of a knee or an elbow that lies on it."""
SLIDE_WINDOW = 0.3
"""Seconds. A point that strays on both sides of this is sliding, however slowly."""
SLIDE = 0.03 / 0.9
"""Leg lengths it may stray within the window."""
SHORTEST = 0.07
"""Seconds that a contact lasts at least; shorter ones are noise. Also the longest gap that is bridged."""


@dataclass(frozen=True)
class RestingRule:
    """When a point counts as resting; leg lengths and leg lengths a second."""

    enter_speed: float = ENTER_SPEED
    leave_speed: float = LEAVE_SPEED
    height: float = HEIGHT


HELD_RULE = RestingRule()
"""What methods hold by."""
WIDE_RULE = RestingRule(0.18 / 0.9, 0.45 / 0.9, 0.06 / 0.9)
"""Counts more of landing and leaving as contact than methods hold: the benches judge by it as well, lest a method be
judged only where its own detector saw a contact."""


@dataclass(frozen=True, eq=False)
class GroundContacts:
    """Contacts of points with the ground."""

    touching: Bool[Array, "frames points"]
    """Whether the point rests on something."""
    support: Float[Array, "frames points"]
    """Height of what it rests on (metres); the floor where it does not rest."""
    heights: Float[Array, "frames points"]
    """Height of each point, metres."""
    floor: float
    """Height of the main floor, metres."""


def speeds(points: Float[Array, "frames points 3"], fps: float) -> Float[Array, "frames points"]:
    """Speed of each point, m/s, by central differences over about a twentieth of a second, so that the noise of a
    120 Hz capture does not count as movement."""
    frames = len(points)
    if frames < 2:
        return np.zeros(points.shape[:2])
    reach = max(1, int(round(fps / 40)))
    ahead = np.minimum(np.arange(frames) + reach, frames - 1)
    behind = np.maximum(np.arange(frames) - reach, 0)
    return np.linalg.norm(points[ahead] - points[behind], axis=-1) * (fps / (ahead - behind))[:, None]


def hysteresis(enter: Bool[Array, "frames points"], stay: Bool[Array, "frames points"]) -> Bool[Array, "frames points"]:
    """On from a frame of `enter` for as long as `stay` holds, in both directions of time."""
    block = np.cumsum(np.diff(stay.astype(np.int8), axis=0, prepend=0) != 0, axis=0)
    on = np.zeros_like(stay)
    for point in range(stay.shape[1]):
        started = np.unique(block[enter[:, point] & stay[:, point], point])
        on[:, point] = stay[:, point] & np.isin(block[:, point], started)
    return on


def intervals(on: Bool[Array, "frames"]) -> list[tuple[int, int]]:
    """Runs of True as half-open ranges."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist()))


def without_short_runs(on: Bool[Array, "frames"], least: int) -> Bool[Array, "frames"]:
    """Bridge gaps, then drop runs, shorter than `least` frames."""
    on = on.copy()
    runs = intervals(on)
    for (_, stop), (start, _) in zip(runs, runs[1:]):
        if start - stop < least:
            on[stop:start] = True
    for start, stop in intervals(on):
        if stop - start < least and not (start == 0 or stop == len(on)):
            on[start:stop] = False
    return on


def running_maximum(values: Float[Array, "frames points"], reach: int) -> Float[Array, "frames points"]:
    """Largest value within ±reach frames."""
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0).max(axis=-1)


def sliding(
    points: Float[Array, "frames points 3"], still: Bool[Array, "frames points"], fps: float, leg_length: float
) -> Bool[Array, "frames points"]:
    """Frames of long stillness on which a point creeps along: a slow slide is a movement, not a stand."""
    reach = int(round(SLIDE_WINDOW * fps))
    frames = np.arange(len(points))
    flat = points[..., [0, 2]]
    ahead = np.linalg.norm(flat[np.minimum(frames + reach, len(points) - 1)] - flat, axis=-1)
    behind = np.linalg.norm(flat[np.maximum(frames - reach, 0)] - flat, axis=-1)
    creeping = np.minimum(ahead, behind) > SLIDE * leg_length
    for point in range(points.shape[1]):
        for start, stop in intervals(still[:, point]):
            if stop - start < 2 * reach:
                creeping[start:stop, point] = False
    return creeping


def floor_height(
    points: Float[Array, "frames points 3"], slow: Bool[Array, "frames points"], leg_length: float
) -> float:
    """Height of the main floor: where the lowest points rest when they rest; the lowest point seen if they never do."""
    lowest = points[..., 1].min(axis=1)
    resting = np.where(slow, points[..., 1], np.inf).min(axis=1)
    near = resting[np.isfinite(resting) & (resting < np.percentile(lowest, 10) + HEIGHT * leg_length)]
    return float(np.median(near)) if len(near) >= 3 else float(np.percentile(lowest, 2))


def ground_contacts(
    points: Float[Array, "frames points 3"],
    fps: float,
    leg_length: float,
    feet: int | None = None,
    body: Float[Array, "frames joints 3"] | None = None,
    rule: RestingRule = HELD_RULE,
) -> GroundContacts:
    """Find when each point rests on the floor, or on something higher that carries the body (a stair, a box).

    A point that is slow and near the floor rests. A point that is slow higher up rests only if, at some time of that
    stillness, nothing lower carries the body: so a foot held in the air beside a standing leg does not count.

    The first `feet` points are of feet and tell the floor better than the others (None: all points are alike). `body`
    are places of other joints, hips first: of who never stands up (crawls, sits, lies), they tell how deep the floor is.
    """
    speed = speeds(points, fps) / leg_length
    peak = running_maximum(speed, int(round(PEAK_WINDOW * fps)))
    slow = speed < np.maximum(rule.enter_speed, ENTER_SHARE * peak)
    floor = floor_height(points, slow, leg_length)
    if feet is not None:
        of_feet = floor_height(points[:, :feet], slow[:, :feet], leg_length)
        floor = of_feet if of_feet - floor < HAND * leg_length else floor
    if body is not None and (body[:, 0, 1] - floor > STANDING * leg_length).sum() < 3:
        floor = min(floor, float(np.percentile(body[..., 1].min(axis=1), 10)) - THICKNESS * leg_length)
    height = points[..., 1] - floor
    still = hysteresis(slow, speed < np.maximum(rule.leave_speed, LEAVE_SHARE * peak))
    low = height < rule.height * leg_length
    # A raised point must come to a real rest: half the speed, and not drift while it does.
    raised = hysteresis(speed < 0.5 * ENTER_SPEED, speed < ENTER_SPEED) & ~low
    still &= ~sliding(points, still, fps, leg_length)
    least = max(2, int(round(SHORTEST * fps)))
    touching = np.stack([without_short_runs(run, least) for run in (still & low).T], axis=1)
    support = np.full(points.shape[:2], floor)
    for point in range(points.shape[1]):
        hand = feet is not None and point >= feet
        deepest = floor - (HAND if hand else SNAP) * leg_length
        for start, stop in intervals(touching[:, point]):
            level = float(np.median(points[start:stop, point, 1]))
            support[start:stop, point] = floor if deepest < level < floor + SNAP * leg_length else level
    carried = touching.any(axis=1)
    for point in range(points.shape[1]):
        for start, stop in intervals(without_short_runs(raised[:, point], least)):
            alone = ~carried[start:stop]
            if alone.sum() >= 2 * least:
                touching[start:stop, point] = True
                support[start:stop, point] = float(np.median(points[start:stop, point, 1]))
    return GroundContacts(touching, support, points[..., 1], floor)
