"""Bodies over walking feet: how hips, trunk and arms go with the steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from motion_body import SIDES, SIGN, Performer
from motion_pose import ARM, Channels, leg_reach
from motion_steps import Stand, Step
from motion_time import breath, ease, keyed, sway
from scipy.interpolate import PchipInterpolator

from retarget.motion.filter import gaussian

Array = np.ndarray


@dataclass(frozen=True)
class Gait:
    """What makes a walk this person's walk; angles in degrees, lengths in metres."""

    arm_swing: float = 17.0
    elbow_swing: float = 9.0
    pelvis_yaw: float = 7.0
    pelvis_drop: float = 3.0
    trunk_twist: float = 10.0
    lean: float = 2.5
    side: float = 0.028
    """How far the hips go over the standing foot from the middle of the two."""
    crouch: float = 0.003
    """How much lower the hips are than on stretched legs when passing over the standing foot."""
    dip: float = 0.016
    """How much lower again when both feet are on the floor."""


def walk_steps(start: float, count: int, length: float, pace: float = 0.55, swing: float = 0.43, first: str = "left",
               width: float = 0.12, stand: float = 0.17, z: float = 0.0) -> list[Step]:  # fmt: skip
    """Alternating steps along +Z; the last one brings the feet together again."""
    steps, ahead = [], z
    for i in range(count):
        side = SIDES[(SIDES.index(first) + i) % 2]
        last = i == count - 1
        ahead += 0.0 if last else length * (0.85 if i == 0 else 1.0)
        across = SIGN[side] * 0.5 * (stand if last else (0.5 * (width + stand) if i == count - 2 else width))
        lands = start + swing + i * pace
        steps.append(Step(
            side, lands - swing, lands, across, ahead, SIGN[side] * (4.0 if last else 5.0),
            push=30.0 if i == 0 else 40.0 if last else 50.0, strike=3.0 if last else 13.0 if i == 0 else 17.0,
        ))  # fmt: skip
    return steps


def stand_height(performer: Performer, crouch: float = 0.002) -> float:
    """Height of the hips joint of a person who stands on flat feet below the hips."""
    hip = performer.skeleton.offsets[performer.joint["leftUpperLeg"]][1]
    return performer.place("leftFoot")[1] + leg_reach(performer, "left") - hip - crouch


def support_keys(start: dict[str, Stand], steps: Sequence[Step]) -> list[tuple[float, Array, bool]]:
    """(time, ground position (x, z) below the hips, whether one foot stands alone) over a sequence of steps."""
    at = {side: np.array([stand.x, stand.z]) for side, stand in start.items()}
    keys = []
    for step in sorted(steps, key=lambda step: step.land):
        other = "right" if step.side == "left" else "left"
        goal = np.array([step.x, step.z])
        stance = at[other]
        middle = 0.5 * (at[step.side] + goal)
        passing = np.array([stance[0], 0.5 * (stance[1] + middle[1])])
        keys.append((0.5 * (step.lift + step.land), passing, True))
        at[step.side] = goal
        keys.append((step.land + 0.012, 0.5 * (at["left"] + at["right"]), False))
    return keys


def walk_body(performer: Performer, act: Channels, t: Array, start: dict[str, Stand], steps: Sequence[Step], gait: Gait) -> Array:
    """Fill hips, trunk, head and arms for steps along +Z; returns how much of the walk there is at each time, 0 to 1."""
    begin, end = min(step.lift for step in steps), max(step.land for step in steps)
    keys = support_keys(start, steps)
    rest = 0.5 * sum(np.array([start[side].x, start[side].z]) for side in SIDES)
    halfway = 0.5 * (keys[0][1] + rest)
    # Before the first step the weight goes over to the foot that stays, a little back and aside.
    ground = [(t[0] - 1, rest), (begin - 0.38, rest), (begin - 0.05, halfway), *[(k[0], k[1]) for k in keys]]
    final = keys[-1][1]
    ground += [(end + 0.5, final), (t[-1] + 2, final)]
    path = keyed(t, ground, soft=2.6)
    middle = 0.5 * (start["left"].x + start["right"].x)
    act.hips[:, 2] = path[:, 1] - 0.004
    side_share = gait.side / 0.06
    act.hips[:, 0] = middle + side_share * gaussian(path[:, 0] - middle, 1.0)
    top = stand_height(performer)
    heights = [(t[0] - 1, top), (begin - 0.35, top), (begin, top - 0.6 * gait.crouch)]
    heights += [(k[0] + (0.02 if k[2] else 0.035), top - gait.crouch - (0.0 if k[2] else gait.dip)) for k in keys[:-1]]
    heights += [(end + 0.1, top - 0.8 * gait.crouch), (end + 0.45, top), (t[-1] + 2, top)]
    act.hips[:, 1] = keyed(t, heights, soft=1.8)
    amount = ease(t, begin - 0.2, begin + 0.6) * (1 - ease(t, end - 0.45, end + 0.35))
    stride = _stride(t, steps)
    rad = np.radians
    act.turn[:, 0] = -rad(gait.pelvis_yaw) * amount * np.cos(stride)
    act.turn[:, 1] = amount * rad(gait.lean * 0.5 + 0.9 * np.cos(2 * stride + 0.6))
    act.turn[:, 2] = rad(gait.pelvis_drop) * amount * np.sin(stride + 0.25)
    act.trunk[:, 0] = amount * rad(gait.lean * 0.6 - 1.0 * np.cos(2 * stride + 0.2))
    act.trunk[:, 1] = rad(gait.trunk_twist) * amount * np.cos(stride - 0.15)
    act.trunk[:, 2] = -0.85 * rad(gait.pelvis_drop) * amount * np.sin(stride + 0.1)
    act.look += np.stack([0.12 * act.trunk[:, 1], rad(2.0) * amount + rad(0.6) * amount * np.cos(2 * stride), -0.15 * act.turn[:, 2]], axis=-1)
    for s in SIDES:
        # Arms make room for the thighs before the first step.
        act.arms[s][:, ARM.index("abduct")] += rad(5) * ease(t, begin - 0.5, begin + 0.05) * (1 - ease(t, end, end + 0.5))
        _swing_arm(act, s, amount, stride, gait)
    return amount


def _swing_arm(act: Channels, side: str, amount: Array, stride: Array, gait: Gait) -> None:
    """The arm swings with the opposite leg, the forearm a little later, more before the body than behind it."""
    sign = SIGN[side]
    forth = -sign * np.cos(stride - 0.12)  # 1: arm in front
    late = -sign * np.cos(stride - 0.5)
    later = -sign * np.cos(stride - 0.8)
    angles, rad = act.arms[side], np.radians
    shade = 1.0 if side == "left" else 0.9  # nobody swings both arms alike
    add = dict(
        flex=gait.arm_swing * shade * (forth + 0.12), elbow=gait.elbow_swing * shade * (late + 0.8), abduct=-1.5 * forth,
        internal=3.0 * forth - 4.0, forward=2.2 * forth, wrist=-3.5 * later, pronate=4.0 * late + 4.0, index=3 * later, middle=3 * later,
        ring=4 * later, little=4 * later,
    )  # fmt: skip
    for name, degrees in add.items():
        angles[:, ARM.index(name)] += amount * rad(degrees)


def _stride(t: Array, steps: Sequence[Step]) -> Array:
    """Phase of the walk: a multiple of 2 pi when the left foot lands, odd multiples of pi when the right one does."""
    order = sorted(steps, key=lambda step: step.land)
    first = 0.0 if order[0].side == "left" else np.pi
    times = [step.land for step in order]
    phases = [first + np.pi * i for i in range(len(order))]
    pace = np.mean(np.diff(times)) if len(times) > 1 else 0.55
    times = [times[0] - 2 * pace, times[0] - pace, *times, times[-1] + pace, times[-1] + 2 * pace]
    phases = [first - 2 * np.pi, first - np.pi, *phases, phases[-1] + np.pi, phases[-1] + 2 * np.pi]
    return gaussian(PchipInterpolator(times, phases)(np.clip(t, times[0], times[-1])), 1.0)


def live(act: Channels, t: Array, seed: int, amount: Array | float = 1.0) -> None:
    """The life of a body that stands: breath, small shifts of weight, arms and head that are never quite still."""
    amount = np.broadcast_to(np.asarray(amount, dtype=float), t.shape)
    full = breath(t, phase=0.13 * seed)
    rad = np.radians
    act.hips[:, 0] += amount * 0.0035 * sway(t, seed, 3.4)
    act.hips[:, 2] += amount * 0.0025 * sway(t, seed + 1, 2.6)
    act.turn[:, 2] += amount * rad(0.5) * sway(t, seed, 3.4)
    act.turn[:, 0] += amount * rad(0.45) * sway(t, seed + 2, 4.0)
    act.trunk[:, 0] += rad(-1.1) * full + amount * rad(0.4) * sway(t, seed + 3, 3.0)
    act.trunk[:, 1] += amount * rad(0.5) * sway(t, seed + 4, 3.6)
    act.trunk[:, 2] += -0.8 * amount * rad(0.5) * sway(t, seed, 3.4)
    act.look[:, 0] += amount * rad(1.6) * sway(t, seed + 5, 4.5)
    act.look[:, 1] += amount * rad(0.9) * sway(t, seed + 6, 3.5)
    act.look[:, 2] += amount * rad(0.5) * sway(t, seed + 7, 4.0)
    for k, side in enumerate(SIDES):
        angles, own = act.arms[side], seed + 20 + 10 * k
        angles[:, 0] += rad(1.3) * breath(t - 0.06 - 0.04 * k, phase=0.13 * seed)
        for name, degrees in (("flex", 0.8), ("abduct", 0.5), ("internal", 0.8), ("elbow", 1.0), ("pronate", 1.2), ("wrist", 0.9)):
            angles[:, ARM.index(name)] += amount * rad(degrees) * sway(t, own, 3.2)
            own += 1
