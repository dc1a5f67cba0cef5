"""Hold what rests on the ground: feet that stand, palms that push, without a pop.

While a point rests, the limb's end is displaced so that the point stays exactly where it is held; between contacts the
displacement runs along a cubic that leaves with the speed it had, so that the whole path stays smooth. Then the hips sink
just enough for straight legs to reach, and two-bone inverse kinematics follows.
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

RAMP = 0.30
"""Seconds over which a displacement fades to nothing when no other contact is near. Our choice."""
STRETCH = 0.9995
"""Share of its length to which a leg is stretched at most (or as far as the copied pose stretches it)."""


@dataclass(frozen=True, eq=False)
class LimbGoal:
    """Where the end joint of a limb has to be displaced to, over a clip."""

    limb: SupportLimb
    displacement: Float[Array, "frames 3"]
    """To be added to the copied position of the limb's end joint, metres."""
    active: Bool[Array, "frames"]
    """Frames on which some point of it rests."""


def limb_goal(
    limb: SupportLimb,
    points: Float[Array, "frames points 3"],
    touching: Bool[Array, "frames points"],
    support: Float[Array, "frames points"],
    floor: float,
    fps: float,
) -> LimbGoal:
    """Displacement of one limb from its points' copied trajectories and the contacts they should keep.

    `support` is the height under each point, in the target's world.
    """
    active = touching.any(axis=1)
    displacement = np.zeros((len(points), 3))
    runs = intervals(active)
    for start, stop in runs:
        part = slice(start, stop)
        displacement[part, [0]], displacement[part, [2]] = (
            column[:, None] for column in _held_in_place(points[part], touching[part], fps)
        )
        lift = np.where(touching[part], support[part] - points[part, :, 1], -np.inf).max(axis=1)
        displacement[part, 1] = gaussian(lift, 0.02 * fps)
    _bridge(displacement, runs, fps)
    # Nothing sinks below the floor, held or not.
    below = floor - (points[..., 1] + displacement[:, None, 1]).min(axis=1)
    free = ~active
    displacement[free, 1] += np.maximum(below[free], 0.0)
    return LimbGoal(limb, displacement, active)


def _held_in_place(points: Float[Array, "frames points 3"], touching: Bool[Array, "frames points"], fps: float) -> tuple[Array, Array]:
    """Horizontal displacement during one stance (heel down to toe off), by x and z.

    The anchors of all points come from the frames where most of them rest at once, so that a rolling foot passes from
    heel to ball without being pulled.
    """
    count = touching.sum(axis=1)
    flat = count == count.max()
    share = gaussian(touching.astype(float), 0.02 * fps) * touching
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    result = []
    for axis in (0, 2):
        anchors = points[flat][:, :, axis].mean(axis=0)
        result.append((share * (anchors - points[:, :, axis])).sum(axis=1))
    return result[0], result[1]


def _bridge(displacement: Float[Array, "frames 3"], runs: list[tuple[int, int]], fps: float) -> None:
    """Fill the frames between contacts, in place, with cubics that join on in value and speed."""
    frames = len(displacement)
    if not runs:
        return
    ramp = max(2, int(round(RAMP * fps)))
    reach = max(1, int(round(0.02 * fps)))

    def speed_at(frame: int, inward: int) -> Array:
        other = frame + inward * reach
        inside = next((start <= other < stop for start, stop in runs if start <= frame < stop), False)
        return (displacement[frame] - displacement[other]) / reach if inside else np.zeros(3)

    def fade(edge: int, outward: int, length: int) -> None:
        steps = np.arange(1, length + 1)
        frames_out = edge + outward * steps
        keep = (frames_out >= 0) & (frames_out < frames)
        displacement[frames_out[keep]] = _cubic(displacement[edge], speed_at(edge, -outward), np.zeros(3), np.zeros(3), length, steps[keep])

    first, last = runs[0][0], runs[-1][1]
    fade(first, -1, ramp)
    for (_, stop), (start, _) in zip(runs, runs[1:]):
        gap = start - stop + 1
        if gap <= 2.7 * ramp:
            steps = np.arange(1, gap)
            displacement[stop : start] = _cubic(
                displacement[stop - 1], speed_at(stop - 1, -1), displacement[start], -speed_at(start, 1), gap, steps
            )
        else:
            fade(stop - 1, 1, ramp)
            fade(start, -1, ramp)
    fade(last - 1, 1, ramp)


def _cubic(a: Array, speed_a: Array, b: Array, speed_b: Array, length: int, steps: Array) -> Float[Array, "steps 3"]:
    """Hermite cubic from a to b over `length` frames, speeds per frame, evaluated at whole frames."""
    t = (steps / length)[:, None]
    return (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * length * speed_a
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * length * speed_b
    )


def hip_drop(
    goals: Sequence[LimbGoal], positions: Float[Array, "frames joints 3"], fps: float
) -> Float[Array, "frames"]:
    """How far the hips must sink (metres, not negative) so that every resting leg reaches its goal."""
    need = np.zeros(len(positions))
    for goal in goals:
        top, middle, end = goal.limb.joints
        if not goal.limb.name.endswith("Leg") or not goal.active.any():
            continue
        length = np.linalg.norm(positions[0, middle] - positions[0, top]) + np.linalg.norm(positions[0, end] - positions[0, middle])
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
) -> Float[Array, "frames joints 4"]:
    """World rotations in which the limbs reach their goals after the hips sank by `drop`.

    `poles` holds, for each limb, the direction in which its middle joint bends out, in the first joint's frame. The end
    joints keep their world rotation; joints in between and below are for the caller to refill.
    """
    turned = world_rotations.copy()
    sink = drop[:, None] * np.array([0.0, 1.0, 0.0])
    for goal in goals:
        if not (goal.active.any() or drop.any()) or (goal.limb.name.endswith("Arm") and not goal.active.any()):
            continue
        top, middle, end = goal.limb.joints
        at = world_positions[:, [top, middle, end]] - sink[:, None]
        held = world_positions[:, end] + goal.displacement
        if goal.limb.name.endswith("Arm"):
            held = np.where(np.abs(goal.displacement).max(axis=-1, keepdims=True) > 0, held, at[:, 2])
        pole = rot.rotate(world_rotations[:, top], poles[goal.limb.name])
        upper, lower = two_bone(at[:, 0], at[:, 1], at[:, 2], held, pole)
        turned[:, top] = rot.multiply(upper, world_rotations[:, top])
        turned[:, middle] = rot.multiply(lower, world_rotations[:, middle])
    return turned
