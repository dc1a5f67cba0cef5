"""Legs crossed in standing: how far the crossing knee turns in is found on the skin of the legs."""

from __future__ import annotations

import numpy as np
from motion_body import Performer
from motion_clip import Clip
from motion_hands import one_frame, part_faces
from motion_pose import ARM, Channels
from motion_steps import Step, feet_apart, keep_within_reach, lay_soles, place_feet
from motion_time import FPS, bump, clock, ease, keyed
from motion_touch import PosedSurface
from motion_walk import live, stand_height

Array = np.ndarray
rad = np.radians
ACROSS = (0.17, 0.085)
"""Where the ankle of the right foot stands: metres to the left of the middle (the left one stands at half that), and forward."""
OVER, BACK = (0.75, 1.5), (3.35, 4.1)
"""When the right foot swings over and back, seconds."""


def legs_crossed(performer: Performer) -> Clip:
    """The right foot goes across before the left one and rests on its ball, leg on leg; then it goes back."""
    middle = int(round(0.5 * (OVER[1] + BACK[0]) * FPS))
    act, planted = _crossed(performer)
    own = act.knees["right"][middle]
    low, high = -0.1, 0.8
    for _ in range(14):  # the further the knee turns in, the nearer the legs are
        turn = 0.5 * (low + high)
        act.knees["right"][middle] = own + turn
        low, high = (turn, high) if legs_apart(performer, act, middle) > 0.0008 else (low, turn)
    act.knees["right"][middle] = own
    _keep_touching(performer, act, turn)
    touches = [(OVER[1] + 0.17, BACK[0] - 0.1, *touching_parts(performer, act, middle))]
    return Clip.of(performer, "legs_crossed", act, planted, touches)


def _crossed(performer: Performer) -> tuple[Channels, dict[str, Array]]:
    t = clock(4.9)
    act = Channels(len(t))
    steps = [
        Step("right", *OVER, *ACROSS, 10.0, push=30.0, strike=-30.0, rest=27.0, height=0.07, around=0.22, roll_start=0.6, settle=0.12),
        Step("right", *BACK, -0.085, 0.0, -4.0, push=36.0, strike=-12.0, height=0.07, around=0.24, roll_start=0.85, settle=0.14),
    ]  # fmt: skip
    planted = place_feet(performer, act, t, feet_apart(), steps)
    held = ease(t, 0.3, 1.0) * (1 - ease(t, 3.7, 4.6))
    alone = bump(t, 0.35, 0.85, 1.7) + bump(t, 2.9, 3.4, 4.3)
    act.hips[:, 0] = 0.068 * held + 0.012 * alone
    act.hips[:, 1] = stand_height(performer) - 0.006 * held
    act.hips[:, 2] = -0.004 + 0.012 * held
    act.turn[:, 2] = rad(3.5) * held + rad(2) * alone
    act.turn[:, 0] = rad(5) * held
    act.trunk[:, 2] = -rad(4.5) * held - rad(1.5) * alone
    act.trunk[:, 1] = -rad(5) * held
    act.look[:, 1] = rad(10) * bump(t, 0.5, 1.1, 2.0)
    act.look[:, 0] = keyed(t, [(0, 0), (1.7, 0), (2.2, -rad(9)), (2.8, -rad(7)), (3.5, 0), (9, 0)])
    balance = bump(t, 0.5, 1.1, 1.9) + bump(t, 3.0, 3.6, 4.4)
    for side, share in (("left", 0.8), ("right", 1.0)):
        act.arms[side][:, ARM.index("abduct")] += rad(11) * share * balance + rad(3) * held
        act.arms[side][:, ARM.index("elbow")] += rad(9) * share * balance
        act.arms[side][:, ARM.index("flex")] += rad(4) * share * balance
    live(act, t, 61, 1 - 0.5 * held)
    keep_within_reach(performer, act)
    lay_soles(performer, act, planted)
    return act, planted


def _distances(performer: Performer, act: Channels, frame: int) -> tuple[Array, Array, Array, Array]:
    """(right leg's vertices, their nearest faces of the left leg, barycentrics, signed distances) at one frame."""
    mine = performer.part("rightShin", "rightFoot", "rightThigh")
    mine = mine[performer.vertices[mine, 1] < performer.place("rightUpperLeg")[1] - 0.12]
    posed = performer.skin(performer.world(*one_frame(performer, act, frame)))[0]
    faces = part_faces(performer, "leftShin", "leftFoot", "leftThigh")
    face, mix, _, distance = PosedSurface(posed, performer.faces, faces).nearest(posed[mine])
    return mine, face, mix, distance


def legs_apart(performer: Performer, act: Channels, frame: int) -> float:
    """Smallest signed distance between the legs, metres; negative where they sink into one another."""
    distance = _distances(performer, act, frame)[3]
    return float(distance[distance > -0.06].min())


def touching_parts(performer: Performer, act: Channels, frame: int) -> tuple[str, str]:
    """The parts of the right and the left leg that are nearest to each other."""
    mine, face, _, distance = _distances(performer, act, frame)
    nearest = int(np.abs(distance).argmin())
    names, model = performer.model.part_names, performer.model
    return names[model.vertex_parts[mine[nearest]]], names[model.face_parts[face[nearest]]]


def _keep_touching(performer: Performer, act: Channels, first: float, gap: float = 0.0008) -> None:
    """Turn the right knee in every frame of the hold, so that the legs stay closed while the body sways."""
    frames = np.arange(int(np.ceil((OVER[1] + 0.12) * FPS)), int(BACK[0] * FPS) - 1)
    correction = np.zeros(act.frames)
    own = act.knees["right"].copy()
    for frame in frames:
        turn = correction[frame - 1] if frame > frames[0] else first
        for _ in range(6):
            values = []
            for shift in (0.0, 0.01):
                act.knees["right"][frame] = own[frame] + turn + shift
                values.append(legs_apart(performer, act, int(frame)) - gap)
            slope = (values[1] - values[0]) / 0.01
            if abs(values[0]) < 2e-4 or abs(slope) < 1e-3:
                break
            turn += float(np.clip(-values[0] / slope, -0.05, 0.05))
        correction[frame] = turn
    act.knees["right"] = own
    held = correction[np.clip(np.arange(act.frames), frames[0], frames[-1])]
    at = np.arange(act.frames).astype(float)
    act.knees["right"] += held * ease(at, frames[0] - 12.0, float(frames[0])) * (1 - ease(at, float(frames[-1]), frames[-1] + 12.0))
