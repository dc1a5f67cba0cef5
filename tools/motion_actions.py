"""The clips in which the whole body moves: walk, run, jump, turn, wave."""

from __future__ import annotations

import numpy as np
from motion_body import SIDES, SIGN, Performer
from motion_clip import Clip
from motion_pose import ARM, Channels, arm
from motion_reach import keep_out
from motion_steps import Stand, Step, feet_apart, keep_within_reach, lay_soles, place_feet
from motion_time import FPS, bump, clock, ease, keyed
from motion_walk import Gait, live, stand_height, support_keys, walk_body, walk_steps

Array = np.ndarray
rad = np.radians
GRAVITY = 9.81


def ground(performer: Performer, act: Channels, planted: dict[str, Array]) -> None:
    """Legs that reach, soles on the floor, arms outside the body."""
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)
    for side in SIDES:
        keep_out(performer, act, side, 0.0, act.frames / FPS)


def walk(performer: Performer) -> Clip:
    """From a stand, six steps, to a stand."""
    t = clock(4.7)
    act = Channels(len(t))
    steps = walk_steps(0.55, 6, 0.53)
    planted = place_feet(performer, act, t, feet_apart(), steps)
    amount = walk_body(performer, act, t, feet_apart(), steps, Gait())
    live(act, t, 3, 1 - 0.7 * amount)
    ground(performer, act, planted)
    return Clip.of(performer, "walk", act, planted, [])


def run(performer: Performer) -> Clip:
    """A steady run at 2.6 m/s, filmed in its midst: it neither begins nor ends in a stand."""
    t = clock(3.2)
    act = Channels(len(t))
    pace, standing, speed, ahead = 0.35, 0.205, 2.6, 0.24
    steps, start = [], {}
    for i in range(-3, 12):
        side = SIDES[i % 2]
        lands = i * pace
        z = speed * lands + ahead
        x = SIGN[side] * 0.035
        if side not in start:
            start[side] = Stand(x, z, SIGN[side] * 4.0)
            continue
        steps.append(Step(
            side, lands - 2 * pace + standing, lands, x, z, SIGN[side] * 4.0, push=58.0, strike=0.0, height=0.19,
            kick=1.5, kick_time=0.33, roll_start=0.38, settle=0.04,
        ))  # fmt: skip
    planted = place_feet(performer, act, t, start, steps)
    beat = 2 * np.pi * t / pace  # 0 when a foot lands
    stride = np.pi * t / pace  # 0 when the left foot lands, pi when the right one does
    lowest = 2 * np.pi * 0.42 * standing / pace
    act.hips[:, 2] = speed * t - 0.012 * np.sin(beat - lowest)
    act.hips[:, 1] = stand_height(performer) - 0.035 - 0.034 * np.cos(beat - lowest)
    act.hips[:, 0] = 0.012 * np.sin(stride + 0.2)
    act.turn[:] = np.stack([-rad(8) * np.cos(stride), rad(7) + rad(2) * np.cos(beat - 0.5), rad(4) * np.sin(stride + 0.1)], axis=-1)
    act.trunk[:] = np.stack([rad(4) - rad(2) * np.cos(beat - 0.3), rad(17) * np.cos(stride - 0.2), -rad(3.5) * np.sin(stride)], axis=-1)
    act.look[:] = np.stack([0 * t, rad(4) + rad(1.2) * np.cos(beat), 0.15 * act.turn[:, 2]], axis=-1)
    for side in SIDES:
        forth = -SIGN[side] * np.cos(stride - 0.15)
        late = -SIGN[side] * np.cos(stride - 0.55)
        base = arm(flex=-12, abduct=15, internal=16, elbow=92, pronate=-8, wrist=2, index=42, middle=48, ring=52, little=52, thumb=20, oppose=15)
        act.arms[side][:] = base
        for name, degrees in (("flex", 31 * forth), ("elbow", 14 * late), ("internal", 12 * forth), ("abduct", -5 * forth), ("forward", 5 * forth), ("wrist", -4 * late)):
            act.arms[side][:, ARM.index(name)] += rad(degrees)
    ground(performer, act, planted)
    return Clip.of(performer, "run", act, planted, [])


def jump(performer: Performer) -> Clip:
    """Down, a leap of 26 cm a little forward, a soft landing, up again."""
    t = clock(3.6)
    act = Channels(len(t))
    off, flight = 1.20, 0.46
    down = off + flight
    steps = [
        Step(side, off + late, down + late, SIGN[side] * 0.095, 0.26, SIGN[side] * 6.0, push=46.0, strike=-24.0, flight=True,
             height=GRAVITY * flight**2 / 8 + 0.015, kick=0.95, roll_start=0.84, settle=0.10)
        for side, late in (("left", 0.0), ("right", 0.012))
    ]  # fmt: skip
    planted = place_feet(performer, act, t, feet_apart(), steps)
    speed = GRAVITY * flight / 2
    act.hips[:, 1] = _leap_height(t, stand_height(performer), off, flight, speed)
    forward = [(0, -0.004), (0.45, -0.004), (0.9, -0.075), (off, 0.05), (down, 0.21), (down + 0.24, 0.185), (down + 0.9, 0.26), (9, 0.256)]
    act.hips[:, 2] = keyed(t, forward, soft=1.5)
    crouch = bump(t, 0.4, 0.92, off) + 0.9 * bump(t, down - 0.05, down + 0.24, down + 1.0)
    stretch = bump(t, 0.98, off + 0.05, off + 0.35)
    act.turn[:, 1] = rad(20) * crouch - rad(3) * stretch
    act.trunk[:, 0] = rad(26) * crouch - rad(7) * stretch + rad(5) * bump(t, off + 0.15, down, down + 0.4)
    act.look[:, 1] = rad(9) * crouch - rad(8) * stretch
    swing = [
        (-1.0, arm()), (0.1, arm()), (0.42, arm(flex=8, abduct=12)), (0.9, arm(flex=-46, abduct=14, elbow=14)),
        (1.08, arm(flex=15, abduct=14, elbow=38)),
        (off + 0.07, arm(**{"raise": 12}, flex=118, abduct=22, internal=5, elbow=32, wrist=-8)),
        (off + 0.26, arm(**{"raise": 8}, flex=92, abduct=34, internal=5, elbow=28, wrist=5)),
        (down + 0.05, arm(flex=48, abduct=30, elbow=30, wrist=-6)), (down + 0.3, arm(flex=22, abduct=24, internal=20, elbow=34)),
        (down + 0.75, arm(flex=-6, abduct=9)), (down + 1.15, arm(flex=4)), (9, arm()),
    ]  # fmt: skip
    for side, late in (("left", 0.0), ("right", 0.018)):
        act.arms[side][:] = keyed(t - late, swing, soft=1.6, late=[0, 0, 0, 0, 0, 0.03, 0.04, 0.06, 0.06, *[0.07] * 8])
    live(act, t, 31, 1 - bump(t, 0.3, 1.0, 3.0))
    # Both knees open a little where they bend.
    for side in SIDES:
        act.knees[side] += SIGN[side] * rad(9) * crouch
    ground(performer, act, planted)
    return Clip.of(performer, "jump", act, planted, [])


def _leap_height(t: Array, top: float, off: float, flight: float, speed: float) -> Array:
    """Height of the hips: sink, push off, fly on a parabola, give way, rise."""
    from scipy.interpolate import CubicHermiteSpline

    low, leave, land = top - 0.235, top + 0.075, top + 0.045
    keys = [  # time, height, velocity
        (0.0, top, 0.0), (0.42, top, 0.0), (0.90, low, 0.0), (off - 0.26, low, 0.0), (off, leave, speed),
    ]  # fmt: skip
    down = off + flight
    after = [(down, land, -speed), (down + 0.24, top - 0.20, 0.0), (down + 0.30, top - 0.20, 0.05), (down + 0.95, top - 0.004, 0.05), (down + 1.2, top, 0.0), (9.0, top, 0.0)]
    before_curve, after_curve = (CubicHermiteSpline(*np.array(part).T) for part in (keys, after))
    share = np.clip((t - off) / flight, 0, 1)
    fly = leave + speed * (t - off) - 0.5 * GRAVITY * (t - off) ** 2 + (land - leave) * share
    return np.where(t < off, before_curve(np.minimum(t, off)), np.where(t < down, fly, after_curve(np.maximum(t, down))))


def turn(performer: Performer) -> Clip:
    """About face to the left in five steps, the eyes first."""
    t = clock(4.2)
    act = Channels(len(t))
    plan = (("left", 0.75, 52), ("right", 1.22, 88), ("left", 1.69, 142), ("right", 2.16, 176), ("left", 2.63, 184))
    steps, apart = [], 0.085
    for side, lift, yaw in plan:
        angle = rad(yaw - (0 if yaw > 175 else 4 * SIGN[side]))
        wide = apart * (1.0 if yaw > 170 else 1.12)
        at = SIGN[side] * wide * np.array([np.cos(angle), -np.sin(angle)])
        steps.append(Step(side, lift, lift + 0.4, at[0], at[1], yaw, push=30.0, strike=-3.0 if yaw < 175 else 0.0, height=0.022, roll_start=0.7, settle=0.08))
    start = feet_apart()
    planted = place_feet(performer, act, t, start, steps)
    keys = support_keys(start, steps)
    path = keyed(t, [(-1.0, np.zeros(2)), (0.4, np.zeros(2)), (0.68, np.array([-0.035, 0.0])), *[(k[0], 0.62 * k[1]) for k in keys], (3.6, keys[-1][1]), (9.0, keys[-1][1])], soft=2.8)
    act.hips[:, [0, 2]] = path
    top = stand_height(performer)
    act.hips[:, 1] = keyed(t, [(-1, top), (0.4, top), (0.7, top - 0.008), *[(k[0], top - (0.006 if k[2] else 0.02)) for k in keys[:-1]], (3.5, top), (9, top)], soft=2.2)
    yaw = rad([0, 0, 22, 62, 100, 142, 170, 180, 180])
    when = np.array([-1, 0.55, 1.0, 1.45, 1.9, 2.35, 2.8, 3.25, 9])
    act.turn[:, 0] = keyed(t, list(zip(when, yaw, strict=True)), soft=3.0)
    chest = keyed(t, list(zip(when - 0.13, yaw, strict=True)), soft=3.0)
    head = keyed(t, [(-1, 0), (0.4, 0), (0.95, rad(58)), (1.5, rad(112)), (2.1, rad(168)), (2.5, rad(180)), (9, rad(180))], soft=2.5)
    act.trunk[:, 1] = np.clip(chest - act.turn[:, 0], -rad(25), rad(25))
    act.look[:, 0] = head
    act.look[:, 1] = rad(7) * bump(t, 0.4, 1.2, 2.6)
    busy = ease(t, 0.5, 1.0) * (1 - ease(t, 2.8, 3.4))
    act.turn[:, 2] = rad(2.2) * busy * np.sin(np.pi * (t - 0.75) / 0.47 + np.pi)
    act.trunk[:, 2] = -act.turn[:, 2] * 0.8 + rad(1.5) * busy
    drag = keyed(t, list(zip(when + 0.12, yaw, strict=True)), soft=3.0) - chest  # arms stay behind
    for side in SIDES:
        angles = act.arms[side]
        angles[:, ARM.index("flex")] += SIGN[side] * 0.35 * drag
        angles[:, ARM.index("abduct")] += rad(7) * busy
        angles[:, ARM.index("elbow")] += rad(8) * busy
    live(act, t, 41, 1 - 0.7 * busy)
    ground(performer, act, planted)
    return Clip.of(performer, "turn", act, planted, [])


def wave(performer: Performer) -> Clip:
    """The right hand goes up and waves, the weight on the left leg."""
    t = clock(4.4)
    act = Channels(len(t))
    planted = place_feet(performer, act, t, feet_apart(), [])
    act.hips[:] = [0.0, stand_height(performer), -0.004]
    up = ease(t, 0.35, 1.15) * (1 - ease(t, 3.3, 4.15))
    act.hips[:, 0] += 0.022 * up
    act.hips[:, 1] -= 0.004 * up
    act.turn[:, 2] += rad(2.6) * up
    act.trunk[:, 2] += rad(-4.2) * up
    act.trunk[:, 1] += rad(3) * up
    act.look += rad([4, -3, -4]) * up[:, None]
    raised = arm(**{"raise": 13, "forward": 4}, flex=34, abduct=72, internal=-62, elbow=96, pronate=18, wrist=-8, index=2, middle=2, ring=3, little=3, spread=9, adduct=-8, thumb=0)
    LATE = np.array([-0.04, -0.03, 0, 0, 0.03, 0.02, 0.06, 0.09, 0.09, *[0.1] * 8])
    when = t[:, None] - LATE
    own = ease(when, 0.3, 1.15) * (1 - ease(when, 3.25, 4.15))
    act.arms["right"] = act.arms["right"] * (1 - own) + raised * own
    strength = ease(t, 0.95, 1.35) * (1 - ease(t, 3.0, 3.45))
    beat = 2 * np.pi * (t - 1.0) / 0.56
    for name, degrees, phase in (("internal", 13, 0.0), ("elbow", 7, 0.5), ("radial", 9, 0.75), ("abduct", 2.5, -0.4), ("pronate", 5, 0.6), ("raise", 1.0, -0.5)):
        act.arms["right"][:, ARM.index(name)] += rad(degrees) * strength * np.sin(beat - phase)
    act.trunk[:, 2] += rad(0.5) * strength * np.sin(beat + 0.6)
    act.look[:, 2] += rad(0.8) * strength * np.sin(beat + 0.2)
    live(act, t, 51)
    ground(performer, act, planted)
    return Clip.of(performer, "wave", act, planted, [])
