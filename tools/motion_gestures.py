"""The clips in which a standing person's hands touch the body."""

from __future__ import annotations

import numpy as np
from motion_body import SIDES, SIGN, Performer
from motion_clip import Clip
from motion_hands import Hold
from motion_pose import Channels, arm
from motion_reach import keep_out, reach
from motion_steps import feet_apart, keep_within_reach, lay_soles, place_feet
from motion_time import clock, ease
from motion_walk import Gait, live, stand_height, walk_body, walk_steps

Array = np.ndarray
PADS = ("IndexPad", "MiddlePad", "RingPad", "LittlePad")
AKIMBO = dict(flex=-15, abduct=45, internal=50, elbow=100, pronate=20, wrist=-35, adduct=-15, index=15, middle=15, ring=15, little=15)
ACROSS = dict(**{"raise": 4, "forward": 14}, flex=68, abduct=-22, internal=40, elbow=125, pronate=20, wrist=-5, index=15, middle=15, ring=15, little=15)


def standing(performer: Performer, seconds: float, seed: int) -> tuple[Channels, Array, dict[str, Array]]:
    """Somebody who stands and breathes: (channels, times, planted feet)."""
    t = clock(seconds)
    act = Channels(len(t))
    planted = place_feet(performer, act, t, feet_apart(), [])
    act.hips[:] = [0.0, stand_height(performer), -0.004]
    live(act, t, seed)
    return act, t, planted


def finish(performer: Performer, name: str, act: Channels, planted: dict[str, Array], touches: list[tuple[float, float, str, str]]) -> Clip:
    """The clip of channels whose feet and hands are in place; `touches` are (start, end, part, part)."""
    return Clip.of(performer, name, act, planted, touches)


def hip_hold(side: str) -> Hold:
    sign = SIGN[side]
    place = {side + "HipSide": 0.1, side + "Waist": 0.5, side + "HipFront": 0.4}
    return Hold(
        side, ("IndexBase", *PADS, "ThumbPad"), ("pelvis", "abdomen", side + "Thigh"), {"Palm": place},
        fingers=(-sign * 0.35, -0.35, 0.87), palm=(-sign * 0.8, -0.45, -0.45),
    )  # fmt: skip


def shoulder_hold(side: str) -> Hold:
    """The hand of `side` on the other shoulder."""
    sign, other = SIGN[side], "right" if side == "left" else "left"
    place = {other + "ShoulderTop": 0.35, other + "ShoulderFront": 0.45, other + "ShoulderTip": 0.2}
    return Hold(
        side, ("IndexBase", "LittleBase", *PADS), ("chest", other + "UpperArm", "neck"), {"Palm": place},
        fingers=(-sign * 0.5, 0.5, -0.7), palm=(sign * 0.15, -0.7, -0.7),
    )  # fmt: skip


def hands_on_hips(performer: Performer) -> Clip:
    act, t, planted = standing(performer, 4.4, 11)
    ready = ease(t, 0.5, 1.4) * (1 - ease(t, 3.3, 4.2))
    act.trunk[:, 0] -= np.radians(2.5) * ready
    act.hips[:, 0] += 0.012 * ready
    act.turn[:, 2] -= np.radians(1.2) * ready
    act.trunk[:, 2] += np.radians(1.0) * ready
    act.look[:, 0] += np.radians(9) * ease(t, 1.5, 2.1) * (1 - ease(t, 2.6, 3.4))
    times = {"left": (0.35, 1.3, 3.2, 4.15), "right": (0.42, 1.4, 3.27, 4.2)}
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)
    for side in SIDES:
        put_on_hip(performer, act, t, side, times[side])
    touches = [(times[side][1] + 0.1, times[side][2] - 0.07, side + "Hand", "pelvis") for side in SIDES]
    return finish(performer, "hands_on_hips", act, planted, touches)


def put_on_hip(performer: Performer, act: Channels, t: Array, side: str, times: tuple[float, float, float, float]) -> None:
    sign = SIGN[side]
    reach(performer, act, t, hip_hold(side), arm(**AKIMBO), times, away=(sign * 0.85, -0.05, 0.5))
    keep_out(performer, act, side, times[0], times[1])
    keep_out(performer, act, side, times[2], times[3])


def put_on_shoulder(performer: Performer, act: Channels, t: Array, side: str, times: tuple[float, float, float, float]) -> None:
    reach(performer, act, t, shoulder_hold(side), arm(**ACROSS), times, away=(-SIGN[side] * 0.1, 0.5, 0.85), lift=0.08)
    keep_out(performer, act, side, times[0], times[1])
    keep_out(performer, act, side, times[2], times[3])


def hand_to_shoulder(performer: Performer) -> Clip:
    act, t, planted = standing(performer, 4.4, 12)
    ready = ease(t, 0.5, 1.5) * (1 - ease(t, 3.2, 4.2))
    act.trunk[:, 1] -= np.radians(5) * ready
    act.trunk[:, 2] -= np.radians(1.5) * ready
    act.look += np.radians([-12, 5, -2]) * (ease(t, 0.7, 1.5) * (1 - ease(t, 2.8, 3.7)))[:, None]
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)
    times = (0.4, 1.5, 3.1, 4.2)
    put_on_shoulder(performer, act, t, "left", times)
    return finish(performer, "hand_to_shoulder", act, planted, [(times[1] + 0.1, times[2] - 0.07, "leftHand", "chest")])


def demo(performer: Performer) -> Clip:
    """Some steps, hands on the hips, then one hand to the opposite shoulder."""
    t = clock(8.0)
    act = Channels(len(t))
    steps = walk_steps(0.35, 5, 0.52)
    planted = place_feet(performer, act, t, feet_apart(), steps)
    amount = walk_body(performer, act, t, feet_apart(), steps, Gait())
    live(act, t, 13, 1 - 0.7 * amount)
    done = max(step.land for step in steps)
    hips = {"left": (done - 0.05, done + 0.8, done + 1.95, done + 3.0), "right": (done + 0.02, done + 0.9, done + 3.75, done + 4.7)}
    shoulder = (done + 2.0, done + 2.85, done + 3.8, done + 4.75)
    hips["left"] = (*hips["left"][:3], done + 2.75)
    ready = ease(t, done, done + 0.9)
    act.trunk[:, 0] -= np.radians(2.0) * ready * (1 - ease(t, done + 3.6, done + 4.6))
    twist = ease(t, shoulder[0], shoulder[1]) * (1 - ease(t, shoulder[2], shoulder[3]))
    act.trunk[:, 1] -= np.radians(5) * twist
    act.look += np.radians([-12, 5, -2]) * (twist * (1 - ease(t, shoulder[2] - 0.4, shoulder[2])))[:, None]
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)
    for side in SIDES:
        put_on_hip(performer, act, t, side, hips[side])
    put_on_shoulder(performer, act, t, "left", shoulder)
    touches = [(hips[side][1] + 0.1, hips[side][2] - 0.07, side + "Hand", "pelvis") for side in SIDES]
    touches.append((shoulder[1] + 0.1, shoulder[2] - 0.07, "leftHand", "chest"))
    return finish(performer, "demo", act, planted, touches)
