"""Feet: where they stand, how they roll from heel to toe, how they swing; and soles that lie on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from motion_body import SIDES, Performer
from motion_pose import Channels, leg_reach, pose, yaw_pitch_roll
from motion_time import FPS, ease
from scipy.interpolate import PchipInterpolator

from retarget.body import rotations as rot
from retarget.motion.filter import gaussian, upper_envelope

Array = np.ndarray


@dataclass(frozen=True)
class Step:
    """One foot leaves the floor at `lift` and stands again from `land` (seconds)."""

    side: str
    lift: float
    land: float
    x: float
    z: float
    yaw: float = 0.0
    """Where the ankle then is (metres) and how the foot is turned (degrees to the left)."""
    push: float = 50.0
    """Degrees by which the heel is raised when the toes leave the floor."""
    strike: float = 16.0
    """Degrees by which the toes are raised when the heel touches the floor; negative: the ball touches first."""
    height: float = 0.0
    """Metres added to the middle of the swing."""
    around: float = 0.0
    """Metres by which the middle of the swing lies in front of the straight way."""
    rest: float = 0.0
    """Degrees by which the heel stays raised while the foot stands."""
    flight: bool = False
    """Whether the foot rises and falls with a body in free flight, on a parabola."""
    kick: float = 1.1
    """How far the foot turns toes down in its swing, in multiples of `push`."""
    kick_time: float = 0.14
    """When it does, as a share of the swing."""
    roll_start: float = 0.55
    """When the heel begins to rise, as a share of the time the foot stands."""
    settle: float = 0.11
    """Seconds from touching the floor until the foot is flat."""


@dataclass(frozen=True)
class Stand:
    """Where an ankle is at the beginning (metres), and its foot's yaw (degrees)."""

    x: float
    z: float = 0.0
    yaw: float = 0.0


def feet_apart(width: float = 0.17, yaw: float = 4.0) -> dict[str, Stand]:
    """A relaxed stand: ankles `width` metres apart, feet turned out."""
    return {"left": Stand(width / 2, 0.0, yaw), "right": Stand(-width / 2, 0.0, -yaw)}


def place_feet(performer: Performer, act: Channels, t: Array, start: dict[str, Stand], steps: Sequence[Step]) -> dict[str, Array]:
    """Fill in ankles, feet and toes of a clip; returns for each side which frames have the foot on the floor."""
    planted = {}
    for side in SIDES:
        mine = sorted((step for step in steps if step.side == side), key=lambda step: step.lift)
        planted[side] = _place_foot(performer, act, t, side, start[side], mine)
    return planted


def _place_foot(performer: Performer, act: Channels, t: Array, side: str, start: Stand, steps: Sequence[Step]) -> Array:
    stands: list[Stand | Step] = [start, *steps]
    pitch = _pitch(t, steps)
    toes = np.maximum(pitch, 0.0)
    anchors = [_flat_ankle(performer, side, stand) for stand in stands]
    yaws = np.radians([stand.yaw for stand in stands])
    on_floor = np.ones(len(t), dtype=bool)
    ankle, yaw = _rolled(performer, side, anchors[0], np.full(len(t), yaws[0]), pitch), np.full(len(t), yaws[0])
    for i, step in enumerate(steps):
        after = t >= step.land - 1e-9
        ankle = np.where(after[:, None], _rolled(performer, side, anchors[i + 1], np.full(len(t), yaws[i + 1]), pitch), ankle)
        yaw = np.where(after, yaws[i + 1], yaw)
    for i, step in enumerate(steps):
        swing = (t > step.lift + 1e-9) & (t < step.land - 1e-9)
        on_floor &= ~swing
        if not swing.any():
            continue
        share = (t[swing] - step.lift) / (step.land - step.lift)
        yaw[swing] = yaws[i] + (yaws[i + 1] - yaws[i]) * ease(share, 0.0, 1.0)
        ends = np.array([step.lift, step.land])
        slope = 0.5 / FPS
        around = (ends[:, None] + [-slope, 0.0, slope]).ravel()
        roll = _pitch(around, steps)
        before = _rolled(performer, side, anchors[i], np.full(3, yaws[i]), roll[:3])
        behind = _rolled(performer, side, anchors[i + 1], np.full(3, yaws[i + 1]), roll[3:])
        span = step.land - step.lift
        speed = ((before[1] - before[0]) / slope, (behind[2] - behind[1]) / slope)
        path = _hermite(share, before[1], behind[1], speed[0] * span, speed[1] * span)
        path[:, 1] += step.height * (4 * share * (1 - share) if step.flight else np.sin(np.pi * share) ** 2)
        ankle[swing] = path
        path[:, 2] += step.around * np.sin(np.pi * share) ** 2
        relaxed = np.radians(8) * np.sin(np.pi * share)
        toes[swing] = np.maximum(toes[swing] * (1 - ease(share, 0.0, 0.45)), relaxed)
    act.ankles[side], act.toes[side] = ankle, np.where(on_floor, toes, gaussian(toes, 0.6))
    act.feet[side] = np.stack([yaw, pitch, np.zeros(len(t))], axis=-1)
    act.knees[side] = gaussian(yaw, 3.0) + performer.legs[side].heading * 0.5
    return on_floor


def _pitch(t: Array, steps: Sequence[Step]) -> Array:
    """How far the heel is above the ball, radians: zero while the foot is flat."""
    keys = [(-10.0, 0.0)]
    for i, step in enumerate(steps):
        landed = steps[i - 1].land if i else step.lift - 0.62
        rise = landed + step.roll_start * (step.lift - landed) if i else step.lift - 0.32
        before = steps[i - 1].rest if i else 0.0
        keys.append((max(rise, keys[-1][0] + 0.02), before))
        span = step.land - step.lift
        keys.append((max(step.lift - 0.12, keys[-1][0] + 0.02), before + 0.33 * (step.push - before)))  # when the other foot lands, at a walk
        keys += [(step.lift, step.push), (step.lift + step.kick_time * span, step.push * step.kick), (step.lift + 0.62 * span, 0.12 * step.push)]
        keys += [(step.land - 0.04 * span, -step.strike), (step.land, -step.strike * 0.95), (step.land + step.settle, step.rest)]
    keys.append((keys[-1][0] + 100.0, keys[-1][1]))
    times, values = np.array(keys).T
    return np.radians(PchipInterpolator(times, values)(t))


def _hermite(s: Array, start: Array, end: Array, start_slope: Array, end_slope: Array) -> Array:
    s = s[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * start + s * (1 - s) ** 2 * start_slope
        + s * s * (3 - 2 * s) * end + s * s * (s - 1) * end_slope
    )  # fmt: skip


def _flat_ankle(performer: Performer, side: str, stand: Stand | Step) -> Array:
    return np.array([stand.x, performer.place(side + "Foot")[1], stand.z])


def _rolled(performer: Performer, side: str, flat: Array, yaw: Array, pitch: Array) -> Array:
    """Ankle of a standing foot: a raised heel turns it about the joint of the toes, raised toes about the heel."""
    heel = performer.vertices[performer.landmark(side + "HeelSole")] - performer.place(side + "Foot")
    ball = performer.legs[side].foot
    turn, flat_turn = (yaw_pitch_roll(np.stack([yaw, p, 0 * yaw], axis=-1)) for p in (pitch, 0 * pitch))
    pivot = np.where(pitch[:, None] > 0, ball, heel)
    return flat + rot.rotate(flat_turn, pivot) - rot.rotate(turn, pivot)


def sole_vertices(performer: Performer, side: str) -> Array:
    """Vertices that follow foot and toes alone."""
    return np.flatnonzero(performer.weight(side + "Foot", side + "Toes") > 0.9)


def lay_soles(performer: Performer, act: Channels, planted: dict[str, Array], clearance: float = 0.008, rounds: int = 3) -> None:
    """Move the ankles up or down until the lowest point of every standing foot is at y = 0 and swinging feet are clear.

    Near a landing the clearance asked of a swinging foot fades to zero.
    """
    for _ in range(rounds):
        world = performer.world(*pose(performer, act))
        for side in SIDES:
            lowest = performer.skin(world, sole_vertices(performer, side))[..., 1].min(axis=1)
            on = planted[side]
            away = np.array([np.abs(np.flatnonzero(on) - f).min() if on.any() else 99 for f in range(len(on))])
            wanted = clearance * np.minimum(away / 4.0, 1.0)
            sunk = np.where(on, 0.0, np.maximum(wanted - lowest, 0.0))
            lift = np.where(on, -lowest, np.maximum(sunk, gaussian(upper_envelope(sunk, 2), 1.0)))
            # Where a foot has just left the floor its correction goes over into the swing, and the same before landing.
            act.ankles[side][:, 1] += _spread(lift, on)


def _spread(lift: Array, on: Array, reach: int = 5) -> Array:
    """The corrections of standing frames faded into the swinging ones next to them."""
    out = lift.copy()
    frames = np.arange(len(on))
    for f in np.flatnonzero(~on):
        before, after = frames[on & (frames < f)], frames[on & (frames > f)]
        carried = 0.0
        for near in ([before[-1]] if len(before) else []) + ([after[0]] if len(after) else []):
            carried += lift[near] * (1 - ease(np.array(float(abs(f - near))), 0.0, float(reach + 1)))
        out[f] = max(lift[f], 0.0) + carried
    return out


def keep_within_reach(performer: Performer, act: Channels) -> None:
    """Sink the hips, smoothly, where a leg would have to be longer than it is."""
    pelvis = yaw_pitch_roll(act.turn)
    need = np.zeros(act.frames)
    for side in SIDES:
        hip = act.hips + rot.rotate(pelvis, performer.skeleton.offsets[performer.joint[side + "UpperLeg"]])
        line = act.ankles[side] - hip
        within = np.sqrt(np.maximum(leg_reach(performer, side) ** 2 - (line[:, [0, 2]] ** 2).sum(axis=1), 0.01))
        need = np.maximum(need, -line[:, 1] - within)
    act.hips[:, 1] -= gaussian(upper_envelope(np.maximum(need, 0.0), 2), 1.4)
