"""Hold what rests on the ground: feet that stand, palms that push, without a pop.

For each limb a displacement of its end joint is sought that makes resting points stand still and touch their support,
is smooth everywhere else, and fades where nothing rests. That is a least-squares problem over the whole clip with a
banded matrix, solved in one pass. Then the hips sink just enough for straight legs to reach, and two-bone inverse
kinematics follows. The formulation is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.contact.ground import intervals
from retarget.contact.support import SupportLimb
from retarget.motion.filter import gaussian, upper_envelope
from retarget.motion.ik import two_bone

Array = np.ndarray

# Our choices, in seconds.
FADE = 0.15
"""A displacement fades over about this time where nothing rests."""
GRIP = 0.006
"""A point that comes to rest stands still after about this time: below a frame, so contacts hold exactly."""
TENSION = 0.06
"""How long, about, a correction runs on with the speed it has: a taut curve does not swing wide before and after a
contact, at the price of some curvature."""
LIFT_SIGMA = 0.10
"""Low-pass on the body's lift."""
SOFTNESS = 0.02 / 0.9
"""Share of the leg length: the difference between two feet's lifts over which the lower one takes the lead."""
STRETCH = 0.9995
"""Share of its length to which a leg is stretched at most (or as far as the copied pose stretches it)."""


@dataclass(frozen=True, eq=False)
class LimbGoal:
    """How the end joint of a limb has to be displaced over a clip."""

    limb: SupportLimb
    displacement: Float[Array, "frames 3"]
    """To be added to the copied position of the end joint, metres."""
    turn: Float[Array, "frames"]
    """To be turned about the vertical on top of the copied rotation, radians."""
    active: Bool[Array, "frames"]
    """Frames on which some point of it rests."""


def body_lift(
    points: Sequence[Float[Array, "frames _ 3"]],
    touching: Sequence[Bool[Array, "frames _"]],
    support: Sequence[Float[Array, "frames _"]],
    leg_length: float,
    fps: float,
) -> Float[Array, "frames"]:
    """How far the whole body should rise (or sink, negative) so that resting feet meet their support.

    What legs of other proportions are off by goes into the height of the hips first, not into the bend of the knees. Of
    two feet the lower one counts more (a soft maximum: a leg can reach down, but not push the floor away). Takes the
    lists of the legs, and of what else carries the body, but not of the arms. Between contacts the lift runs on
    linearly; it is low-passed.
    """
    frames = len(points[0])
    lifts = np.full((frames, len(points)), np.nan)
    for leg, (path, rests, level) in enumerate(zip(points, touching, support)):
        lift = np.where(rests, level - path[..., 1], -np.inf).max(axis=1)
        lifts[:, leg] = np.where(np.isfinite(lift), lift, np.nan)
    standing = np.flatnonzero(np.isfinite(lifts).any(axis=1))
    if len(standing) == 0:
        return np.zeros(frames)
    share = np.exp((lifts[standing] - np.nanmax(lifts[standing], axis=1, keepdims=True)) / (SOFTNESS * leg_length))
    known = np.nansum(share * lifts[standing], axis=1) / np.nansum(share, axis=1)
    return gaussian(np.interp(np.arange(frames), standing, known), LIFT_SIGMA * fps)


def limb_goal(
    limb: SupportLimb,
    end: Float[Array, "frames 3"],
    points: Float[Array, "frames points 3"],
    touching: Bool[Array, "frames points"],
    support: Float[Array, "frames points"],
    ground: Float[Array, "frames"],
    fps: float,
) -> LimbGoal:
    """Displacement of one limb from its copied trajectories and the contacts that it should keep.

    `end` is the copied path of its last joint, `points` those of the points fixed to it, `support` the height under each
    point, `ground` the height below which no point may sink, all in the target's world.
    """
    active = touching.any(axis=1)
    turn = np.zeros(len(points))
    if points.shape[1] == 2:  # a foot: while heel and ball both rest it does not swivel either
        sole = points[:, 1] - points[:, 0]
        heading = np.unwrap(np.arctan2(sole[:, 0], sole[:, 2]))
        turn = settle(heading[:, None, None], touching.all(axis=1, keepdims=True), fps)[:, 0]
        spin = rot.from_rotation_vector(turn[:, None] * np.array([0.0, 1.0, 0.0]))
        points = end[:, None] + rot.rotate(spin[:, None], points - end[:, None])
    displacement = np.empty((len(points), 3))
    displacement[:, [0, 2]] = settle(points[..., [0, 2]], touching, fps)
    displacement[:, 1] = _settle_height(points[..., 1], touching, support, ground, fps)
    return LimbGoal(limb, displacement, turn, active)


def settle(
    values: Float[Array, "frames points channels"], resting: Bool[Array, "frames points"], fps: float
) -> Float[Array, "frames channels"]:
    """The smooth correction d that makes every point stand still while it rests.

    Minimises  sum over resting steps |Δ(p + d)|² / g²  +  sum over free steps |Δd|² / t²  +  sum |Δ²d|²  +  sum |d - h|² / f⁴
    with g the grip, t the tension and f the fade in frames: contact steps cost their movement, all else costs the curvature
    and the movement that the correction adds. h is nothing on free frames; on resting ones it leads to the place where the
    point rested most of the contact, so that the frames of landing and leaving do not push the whole stance aside.
    """
    still = (resting[1:] & resting[:-1]).astype(float)
    held = still.sum(axis=1)
    step_weight = np.where(held > 0, held * (GRIP * fps) ** -2, (TENSION * fps) ** -2)
    moved = (still[..., None] * np.diff(values, axis=0)).sum(axis=1)
    step_goal = -moved / np.maximum(held, 1)[:, None]
    home = np.zeros((len(values), values.shape[2]))
    count = np.maximum(resting.sum(axis=1), 1)[:, None]
    for point in range(resting.shape[1]):
        for start, stop in intervals(resting[:, point]):
            path = values[start:stop, point]
            home[start:stop] += (_rested_at(path) - path) / count[start:stop]
    return _least_squares(np.full(len(values), (FADE * fps) ** -4), home, step_weight, step_goal)


def _rested_at(path: Float[Array, "frames channels"]) -> Float[Array, "channels"]:
    """The mean place of a path, its still frames counting more than its moving ones."""
    if len(path) < 2:
        return path[0]
    speed = np.linalg.norm(np.gradient(path, axis=0), axis=-1)
    share = 1 / (1 + (speed / max(speed.mean(), 1e-12)) ** 2)
    return share @ path / share.sum()


def _settle_height(
    heights: Float[Array, "frames points"],
    touching: Bool[Array, "frames points"],
    support: Float[Array, "frames points"],
    ground: Float[Array, "frames"],
    fps: float,
) -> Float[Array, "frames"]:
    """Vertical correction: the lowest resting point meets its support, and nothing else sinks below the ground."""
    need = np.where(touching, support - heights, -np.inf).max(axis=1)
    pinned = np.isfinite(need)
    lowest = heights.min(axis=1)
    need = np.maximum(need, np.where(pinned, ground - lowest, -np.inf))  # a heel is not pushed down to set a ball
    steps = np.full(len(need) - 1, (TENSION * fps) ** -2)
    # Free points that would sink are pinned to the ground as well; each round can only add such frames.
    for _ in range(3):
        weight = np.where(pinned, (GRIP * fps) ** -4, (FADE * fps) ** -4)
        goal = np.where(pinned, need, 0.0)[:, None]
        lift = _least_squares(weight, goal, steps, np.zeros((len(steps), 1)))
        sunk = ~pinned & (lowest + lift[:, 0] < ground - 1e-4)
        if not sunk.any():
            break
        need, pinned = np.where(sunk, ground - lowest, need), pinned | sunk
    return lift[:, 0]


def _least_squares(
    weight: Float[Array, "frames"],
    goal: Float[Array, "frames channels"],
    step_weight: Float[Array, "steps"],
    step_goal: Float[Array, "steps channels"],
) -> Float[Array, "frames channels"]:
    """Minimise  Σ weight (d - goal)² + Σ step_weight (Δd - step_goal)² + Σ (Δ²d)²  by banded Cholesky.

    Every weight is positive.
    """
    from scipy.linalg import solveh_banded

    frames = len(weight)
    band = np.zeros((3, frames))  # lower form: diagonal, first, second below
    band[0] = weight
    band[0, :-1] += step_weight
    band[0, 1:] += step_weight
    band[1, :-1] -= step_weight
    if frames > 2:
        for offset, (diagonal, first, second) in enumerate(((1, -2, 1), (4, -2, 0), (1, 0, 0))):
            rows = slice(offset, frames - 2 + offset)
            band[0, rows] += diagonal
            band[1, rows] += first
            band[2, rows] += second
    right = weight[:, None] * goal
    right[:-1] -= step_weight[:, None] * step_goal
    right[1:] += step_weight[:, None] * step_goal
    return solveh_banded(band[: min(3, frames)], right, lower=True, check_finite=False)


def hip_drop(
    goals: Sequence[LimbGoal], positions: Float[Array, "frames joints 3"], fps: float
) -> Float[Array, "frames"]:
    """How far the hips must sink (metres, not negative) so that every resting leg reaches its goal."""
    need = np.zeros(len(positions))
    for goal in goals:
        top, middle, end = goal.limb.joints
        if not goal.limb.name.endswith("Leg") or not goal.active.any():
            continue
        length = np.linalg.norm(positions[0, middle] - positions[0, top]) + np.linalg.norm(
            positions[0, end] - positions[0, middle]
        )
        copied = np.linalg.norm(positions[:, end] - positions[:, top], axis=-1)
        longest = np.maximum(STRETCH * length, copied)
        way = positions[:, end] + goal.displacement - positions[:, top]
        across = np.linalg.norm(way[:, [0, 2]], axis=-1)
        down = -way[:, 1]
        within = np.sqrt(np.maximum(longest**2 - np.minimum(across, 0.9 * longest) ** 2, 0))
        need = np.maximum(need, np.where(goal.active, down - within, 0.0))
    return upper_envelope(np.maximum(need, 0.0), int(round(0.15 * fps)))


def reach_goals(
    goals: Sequence[LimbGoal],
    world_rotations: Float[Array, "frames joints 4"],
    world_positions: Float[Array, "frames joints 3"],
    poles: dict[str, Float[Array, "3"]],
    drop: Float[Array, "frames"],
    below: dict[int, Sequence[int]],
) -> Float[Array, "frames joints 4"]:
    """World rotations in which the limbs reach their goals after the hips sank by `drop`.

    `poles` holds, for each limb, the direction in which its middle joint bends out, in the first joint's frame. The end
    joints keep their world rotation but for the goal's turn, with all joints `below` each (itself included); joints in
    between are for the caller to refill.
    """
    turned = world_rotations.copy()
    sink = drop[:, None] * np.array([0.0, 1.0, 0.0])
    for goal in goals:
        is_leg = goal.limb.name.endswith("Leg")
        if not goal.active.any() and not (is_leg and drop.any()):
            continue
        top, middle, end = goal.limb.joints
        at = world_positions[:, [top, middle, end]] - sink[:, None]
        held = world_positions[:, end] + goal.displacement
        if not is_leg:  # hands leave the ground they stood on with the body: they sink with it
            held = held - sink * ~goal.active[:, None]
        pole = rot.rotate(world_rotations[:, top], poles[goal.limb.name])
        upper, lower = two_bone(at[:, 0], at[:, 1], at[:, 2], held, pole)
        turned[:, top] = rot.multiply(upper, world_rotations[:, top])
        turned[:, middle] = rot.multiply(lower, world_rotations[:, middle])
        spin = rot.from_rotation_vector(goal.turn[:, None] * np.array([0.0, 1.0, 0.0]))
        for joint in below[end]:
            turned[:, joint] = rot.multiply(spin, world_rotations[:, joint])
    return turned
