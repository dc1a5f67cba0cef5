"""The clips in which a standing person's hands touch the body, and the one that the demonstration shows."""

from __future__ import annotations

import numpy as np
from motion_body import SIDES, SIGN, Performer
from motion_clip import Clip
from motion_hands import Hold
from motion_pose import ARM, Channels, arm
from motion_reach import Times, keep_out, reach, solve_places
from motion_steps import Stand, feet_apart, keep_within_reach, lay_soles, place_feet
from motion_time import FPS, bump, clock, ease, keyed
from motion_walk import Gait, live, stand_height, walk_body, walk_steps

Array = np.ndarray
rad = np.radians
PADS = ("IndexPad", "MiddlePad", "RingPad", "LittlePad")
FLAT = dict(index=12, middle=12, ring=12, little=12)
OTHER = {"left": "right", "right": "left"}


def standing(performer: Performer, seconds: float, seed: int, start: dict[str, Stand] | None = None) -> tuple[Channels, Array, dict[str, Array]]:
    """Somebody who stands and breathes: (channels, times, planted feet)."""
    t = clock(seconds)
    act = Channels(len(t))
    planted = place_feet(performer, act, t, start or feet_apart(), [])
    act.hips[:] = [0.0, stand_height(performer), -0.004]
    live(act, t, seed)
    return act, t, planted


def stand_firm(performer: Performer, act: Channels, planted: dict[str, Array]) -> None:
    """Legs that reach and soles on the floor; before the hands are placed, because it moves the body."""
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)


def during(times: Times | Array, margin: float = 0.0) -> tuple[float, float]:
    """The part of a hold in which its contact is stated to be closed."""
    return times[1] + 0.1 + margin, times[2] - 0.07


def hip_hold(side: str) -> tuple[Hold, Array]:
    sign = SIGN[side]
    place = {side + "HipSide": 0.1, side + "Waist": 0.5, side + "HipFront": 0.4}
    hold = Hold(
        side, ("IndexBase", *PADS, "ThumbPad"), ("pelvis", "abdomen", side + "Thigh"), {"Palm": place},
        fingers=(-sign * 0.35, -0.35, 0.87), palm=(-sign * 0.8, -0.45, -0.45), away=(sign * 0.85, -0.05, 0.5),
    )  # fmt: skip
    return hold, arm(flex=-15, abduct=45, internal=50, elbow=100, pronate=20, wrist=-35, adduct=-15, **FLAT)


def shoulder_hold(side: str) -> tuple[Hold, Array]:
    """The hand of `side` on the other shoulder."""
    sign, other = SIGN[side], OTHER[side]
    place = {other + "ShoulderTop": 0.35, other + "ShoulderFront": 0.45, other + "ShoulderTip": 0.2}
    hold = Hold(
        side, ("IndexBase", "LittleBase", *PADS), ("chest", other + "UpperArm", "neck"), {"Palm": place},
        fingers=(-sign * 0.5, 0.5, -0.7), palm=(sign * 0.15, -0.7, -0.7), away=(-sign * 0.1, 0.4, 0.9), stiff_shoulder=6.0,
    )  # fmt: skip
    return hold, arm(**{"raise": 4, "forward": 14}, flex=72, abduct=-20, internal=48, elbow=118, pronate=20, wrist=-5, **FLAT)


def touch(performer: Performer, act: Channels, t: Array, placed: tuple[Hold, Array], times: Times, lift: float = 0.07) -> None:
    hold, guess = placed
    reach(performer, act, t, [hold], [guess], [times], lift)


def hands_on_hips(performer: Performer) -> Clip:
    act, t, planted = standing(performer, 4.4, 11)
    ready = ease(t, 0.5, 1.4) * (1 - ease(t, 3.3, 4.2))
    act.trunk[:, 0] -= rad(2.5) * ready
    act.hips[:, 0] += 0.012 * ready
    act.turn[:, 2] -= rad(1.2) * ready
    act.trunk[:, 2] += rad(1.0) * ready
    act.look[:, 0] += rad(9) * ease(t, 1.5, 2.1) * (1 - ease(t, 2.6, 3.4))
    stand_firm(performer, act, planted)
    times = {"left": (0.35, 1.3, 3.2, 4.15), "right": (0.42, 1.4, 3.27, 4.2)}
    for side in SIDES:
        touch(performer, act, t, hip_hold(side), times[side])
    return Clip.of(performer, "hands_on_hips", act, planted, [(*during(times[side]), side + "Hand", "pelvis") for side in SIDES])


def hand_to_shoulder(performer: Performer) -> Clip:
    act, t, planted = standing(performer, 4.4, 12)
    ready = ease(t, 0.5, 1.5) * (1 - ease(t, 3.2, 4.2))
    act.trunk[:, 1] -= rad(5) * ready
    act.trunk[:, 2] -= rad(1.5) * ready
    act.look += rad([-12, 5, -2]) * (ease(t, 0.7, 1.5) * (1 - ease(t, 2.8, 3.7)))[:, None]
    stand_firm(performer, act, planted)
    times = (0.35, 1.55, 3.1, 4.25)
    touch(performer, act, t, shoulder_hold("left"), times, 0.08)
    return Clip.of(performer, "hand_to_shoulder", act, planted, [(*during(times), "leftHand", "chest")])


def hand_on_belly(performer: Performer) -> Clip:
    """The right hand lies on a belly that breathes."""
    act, t, planted = standing(performer, 4.6, 21)
    ready = ease(t, 0.4, 1.4) * (1 - ease(t, 3.3, 4.4))
    act.trunk[:, 0] += rad(3.0) * ready - rad(1.6) * bump(t, 1.5, 2.5, 3.4)
    act.look += rad([-3, 14, 1]) * (ease(t, 0.5, 1.3) * (1 - ease(t, 2.9, 3.9)))[:, None]
    act.hips[:, 0] += 0.01 * ready
    stand_firm(performer, act, planted)
    hold = Hold(
        "right", ("Palm", "IndexBase", "LittleBase", *PADS), ("abdomen", "pelvis", "chest"), {"Palm": {"navel": 0.8, "belly": 0.2}},
        fingers=(0.95, -0.25, 0.05), palm=(0.05, 0.0, -1.0), away=(-0.3, 0.0, 0.95),
    )  # fmt: skip
    times = (0.35, 1.35, 3.3, 4.35)
    touch(performer, act, t, (hold, arm(flex=8, abduct=22, internal=55, elbow=85, pronate=5, wrist=0, **FLAT)), times)
    return Clip.of(performer, "hand_on_belly", act, planted, [(*during(times), "rightHand", "abdomen")])


def hands_behind_head(performer: Performer) -> Clip:
    """Both hands behind the head, elbows out, the chest open."""
    act, t, planted = standing(performer, 4.8, 22)
    ready = ease(t, 0.5, 1.6) * (1 - ease(t, 3.4, 4.5))
    act.trunk[:, 0] -= rad(5) * ready
    act.look += rad([3, -5, 0]) * (ease(t, 0.8, 1.8) * (1 - ease(t, 3.2, 4.2)))[:, None]
    act.hips[:, 2] += 0.008 * ready
    stand_firm(performer, act, planted)
    holds, guesses = [], []
    for side in SIDES:
        sign = SIGN[side]
        place = {"backOfHead": 0.75, side + "Ear": 0.25}
        up = 0.45 if side == "left" else 0.15
        holds.append(Hold(
            side, (*PADS, "MiddleMid", "RingMid"), ("head", "neck"), {"MiddleNear": place},
            fingers=(-sign * 0.9, up, -0.25), palm=(-sign * 0.35, 0.0, 0.93), away=(sign * 0.6, 0.25, -0.75),
        ))  # fmt: skip
        guesses.append(arm(**{"raise": 18, "forward": 0}, flex=62, abduct=112, internal=-55, elbow=132, pronate=20, wrist=0, **FLAT))
    times = [(0.35, 1.6, 3.35, 4.6), (0.43, 1.68, 3.3, 4.55)]
    reach(performer, act, t, holds, guesses, times, lift=0.06)
    window = during((0, max(each[1] for each in times), min(each[2] for each in times), 0))
    return Clip.of(performer, "hands_behind_head", act, planted, [(*window, side + "Hand", "head") for side in SIDES])


def arms_crossed(performer: Performer) -> Clip:
    """Each hand on the other upper arm, the right forearm in front of the left one."""
    act, t, planted = standing(performer, 5.0, 23)
    ready = ease(t, 0.5, 1.6) * (1 - ease(t, 3.5, 4.6))
    act.hips[:, 0] -= 0.016 * ready
    act.turn[:, 2] += rad(-1.8) * ready
    act.trunk[:, 2] += rad(2.0) * ready
    act.trunk[:, 0] -= rad(1.5) * ready
    act.look[:, 0] -= rad(10) * ease(t, 1.7, 2.3) * (1 - ease(t, 2.9, 3.6))
    stand_firm(performer, act, planted)
    under = Hold(
        "left", ("IndexBase", "LittleBase", *PADS), ("rightUpperArm",), {"Palm": {"rightUpperArmFront": 0.5, "rightElbowInside": 0.5}}, pull=0.5,
        fingers=(-0.85, 0.25, -0.4), palm=(0.2, -0.1, -0.95), away=(-0.1, 0.1, 1.0),
    )  # fmt: skip
    over = Hold(
        "right", ("Palm", "IndexBase", "LittleBase", *PADS), ("leftUpperArm",), {"Palm": {"leftUpperArmFront": 0.6, "leftElbowInside": 0.4}}, pull=0.5,
        fingers=(0.85, 0.35, -0.35), palm=(-0.45, 0.0, -0.9), away=(0.1, 0.1, 1.0),
    )  # fmt: skip
    holds = [under, over]
    guesses = [
        arm(**{"raise": 6, "forward": 18}, flex=24, abduct=-4, internal=62, elbow=104, pronate=-25, wrist=-20, **FLAT),
        arm(**{"forward": 20}, flex=38, abduct=-4, internal=46, elbow=88, pronate=-20, wrist=20, radial=-10, **FLAT),
    ]
    times = [(0.3, 1.25, 3.85, 4.8), (0.6, 1.75, 3.4, 4.4)]
    reach(performer, act, t, holds, guesses, times, lift=0.12, close=0.45, together=True)
    window = during((0, times[1][1], times[1][2], 0))
    touches = [(*window, "leftHand", "rightUpperArm"), (*window, "rightHand", "leftUpperArm")]
    return Clip.of(performer, "arms_crossed", act, planted, touches)


def clap(performer: Performer) -> Clip:
    """The palms meet three times before the chest."""
    act, t, planted = standing(performer, 3.8, 24)
    beats = (1.25, 1.78, 2.31)
    ready = ease(t, 0.35, 1.0) * (1 - ease(t, 2.6, 3.5))
    pulse = sum(bump(t, beat - 0.22, beat, beat + 0.25) for beat in beats)
    act.trunk[:, 0] += rad(1.0) * ready + rad(0.8) * pulse
    act.look[:, 1] += rad(3) * ready + rad(1.2) * pulse
    act.hips[:, 1] -= 0.004 * pulse
    stand_firm(performer, act, planted)
    holds, guesses = [], []
    for side in ("right", "left"):
        sign, meets = SIGN[side], side == "left"
        holds.append(Hold(
            side, ("PalmHeel", "IndexBase", "LittleBase", "MiddlePad") if meets else (), ("rightHand",) if meets else (),
            {"MiddleBase": {"rightMiddleBase": 1.0}} if meets else {"MiddleBase": {"chest": 0.6, "navel": 0.4}},
            fingers=(-sign * 0.12, 0.62 if meets else 0.5, 0.8), palm=(-sign, 0.0, -0.1), away=(sign * 0.8, -0.1 * sign, -0.15),
            shift=(0.035, 0.0, 0.0) if meets else (-0.01, 0.05, 0.26), pull=0.1 if meets else 0.3, aim=0.06, stiff_girdle=2.0, stiff_fingers=30.0,
        ))  # fmt: skip
        guesses.append(arm(flex=30, abduct=0, internal=30, elbow=88, pronate=4, wrist=-20, index=-4, middle=-6, ring=-6, little=-4, thumb=0, adduct=12, oppose=-8))
    frame = int(round(beats[1] * FPS))
    contacts, hovers = solve_places(performer, act, frame, holds, guesses, lift=0.11)
    near = keyed(t, [(0, 0), (beats[0] - 0.25, 0), *_claps(beats), (9, 0)], soft=0.7)[:, None]
    for hold, contact, hover, late in zip(holds, contacts, hovers, (0.0, 0.03), strict=True):
        own = (ease(t, 0.3 + late, 1.0) * (1 - ease(t, 2.5 - late, 3.45)))[:, None]
        act.arms[hold.side] = act.arms[hold.side] * (1 - own) + (hover + (contact - hover) * near) * own
    return Clip.of(performer, "clap", act, planted, [(beat - 0.034, beat + 0.034, "leftHand", "rightHand") for beat in beats])


def _claps(beats: tuple[float, ...]) -> list[tuple[float, float]]:
    """How closed the hands are: fast together, a moment closed, slower apart."""
    keys = []
    for beat in beats:
        keys += [(beat - 0.12, 0.45), (beat - 0.075, 1.0), (beat + 0.075, 1.0), (beat + 0.15, 0.6), (beat + 0.27, 0.0)]
    return keys


def squat_hands_on_knees(performer: Performer) -> Clip:
    """Down into a half squat, a hand on each knee, and up again."""
    act, t, planted = standing(performer, 5.0, 25, feet_apart(0.34, 14.0))
    down = ease(t, 0.4, 1.7) * (1 - ease(t, 3.4, 4.7))
    act.hips[:, 1] -= 0.012 + 0.262 * down
    act.hips[:, 2] -= 0.135 * down
    act.turn[:, 1] += rad(30) * down
    act.trunk[:, 0] += rad(24) * down - rad(3) * bump(t, 1.7, 2.6, 3.4)
    act.look[:, 1] += rad(12) * down
    for side in SIDES:
        act.knees[side] += SIGN[side] * rad(14) * down
        act.arms[side][:, ARM.index("abduct")] += rad(9)  # the thighs stand wide
    stand_firm(performer, act, planted)
    holds, guesses = [], []
    for side in SIDES:
        sign = SIGN[side]
        holds.append(Hold(
            side, ("PalmHeel", "IndexBase", "LittleBase", *PADS, "ThumbPad"), (side + "Thigh", side + "Shin"),
            {"Palm": {side + "Knee": 0.8, side + "ThighFront": 0.2}}, fingers=(-sign * 0.3, -0.75, 0.6), palm=(-sign * 0.1, -0.65, -0.75),
            away=(sign * 0.3, 0.5, 0.8),
        ))  # fmt: skip
        guesses.append(arm(**{"forward": 8}, flex=48, abduct=14, internal=30, elbow=28, pronate=45, wrist=-15, adduct=-15, **FLAT))
    times = [(0.45, 1.7, 3.4, 4.5), (0.5, 1.76, 3.36, 4.46)]
    reach(performer, act, t, holds, guesses, times)
    window = during((0, 1.76, 3.36, 0))
    return Clip.of(performer, "squat_hands_on_knees", act, planted, [(*window, side + "Hand", side + "Thigh") for side in SIDES])


def demo(performer: Performer) -> Clip:
    """Some steps, hands on the hips, then one hand to the opposite shoulder."""
    t = clock(8.0)
    act = Channels(len(t))
    steps = walk_steps(0.45, 5, 0.52)
    planted = place_feet(performer, act, t, feet_apart(), steps)
    amount = walk_body(performer, act, t, feet_apart(), steps, Gait())
    live(act, t, 13, 1 - 0.7 * amount)
    done = max(step.land for step in steps)
    hips = {"left": (done - 0.05, done + 0.8, done + 1.95, done + 2.75), "right": (done + 0.02, done + 0.9, done + 3.75, done + 4.7)}
    shoulder = (done + 2.0, done + 2.85, done + 3.8, done + 4.75)
    ready = ease(t, done, done + 0.9)
    act.trunk[:, 0] -= rad(2.0) * ready * (1 - ease(t, done + 3.6, done + 4.6))
    twist = ease(t, shoulder[0], shoulder[1]) * (1 - ease(t, shoulder[2], shoulder[3]))
    act.trunk[:, 1] -= rad(5) * twist
    act.look += rad([-12, 5, -2]) * (twist * (1 - ease(t, shoulder[2] - 0.4, shoulder[2])))[:, None]
    stand_firm(performer, act, planted)
    for side in SIDES:
        keep_out(performer, act, side, 0.0, done)
    for side in SIDES:
        touch(performer, act, t, hip_hold(side), hips[side])
    touch(performer, act, t, shoulder_hold("left"), shoulder, 0.08)
    touches = [(*during(hips[side]), side + "Hand", "pelvis") for side in SIDES]
    return Clip.of(performer, "demo", act, planted, [*touches, (*during(shoulder), "leftHand", "chest")])
