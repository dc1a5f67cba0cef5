"""Hands on the body: the vertices of palms and fingers, and arms solved so that they lie on the skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from motion_body import SIDES, Performer
from motion_pose import ARM, LIMITS, Channels, pose, pose_arm
from motion_time import FPS, ease
from motion_touch import Aim, Apart, Meet, Problem, Touch, faces_of

from retarget.motion.filter import gaussian

Array = np.ndarray
STIFF = np.array([40, 40, 10, 10, 10, 10, 10, 10, 15, 8, 8, 8, 5, 5, 5, 5, 12]) * 1e-3
"""How much each arm angle resists being changed from the guess: metres of contact error that a radian is worth."""


def limb_vertices(performer: Performer, side: str) -> Array:
    """Vertices of hand, forearm and the lower part of the upper arm."""
    upper = performer.part(side + "UpperArm")
    axis = performer.place(side + "LowerArm") - performer.place(side + "UpperArm")
    along = (performer.vertices[upper] - performer.place(side + "UpperArm")) @ axis / (axis @ axis)
    return np.concatenate([performer.part(side + "Hand", side + "Forearm"), upper[along > 0.55]])


def body_faces(performer: Performer, *without: str) -> Array:
    """Faces of the whole body but for some arms."""
    gone = [side + part for side in without for part in ("Hand", "Forearm", "UpperArm")]
    return faces_of(performer, np.setdiff1d(np.arange(len(performer.vertices)), performer.part(*gone)))


def part_faces(performer: Performer, *parts: str) -> Array:
    return faces_of(performer, performer.part(*parts))


@dataclass(frozen=True, eq=False)
class Hold:
    """What one hand does on the body, in words that do not depend on the mesh."""

    side: str
    points: Sequence[str]
    """Landmarks of this side (without its name) that touch: 'Palm', 'IndexTip', ..."""
    parts: Sequence[str]
    """Parts of the body that they touch."""
    near: dict[str, dict[str, float]]
    """Landmark of this side: place on the body that it shall be near, a mix of up to three landmarks."""
    fingers: tuple[float, float, float] | None = None
    """World direction from wrist to middle fingertip that is wanted."""
    palm: tuple[float, float, float] | None = None
    """World direction that the palm faces."""
    pull: float = 0.25
    aim: float = 0.05
    clear: Sequence[str] = ()
    """Further arms that are left out of what this arm must not enter."""
    soft: float = 3.0
    """Weight of the touching points."""


def arm_problem(performer: Performer, act: Channels, frame: int, hold: Hold, lift: float = 0.0, away: tuple[float, float, float] = (0, 0, 0)) -> Problem:
    """The problem of one arm at one frame of a clip. `lift` metres keep the hand off the skin (no touch is asked then)."""
    side = hold.side
    rotations, hips = one_frame(performer, act, frame)

    def build(angles: Array) -> tuple[Array, Array]:
        turns = np.repeat(rotations, len(angles), axis=0)
        pose_arm(performer, side, angles, turns)
        return turns, np.repeat(hips, len(angles), axis=0)

    points = np.array([performer.landmark(side + name) for name in hold.points])
    touches = [Touch(points, part_faces(performer, *hold.parts), hold.soft)] if lift == 0 else []
    meets = []
    for mine, other in hold.near.items():
        names = (list(other) * 3)[:3]
        mix = np.array([other[name] if i < len(other) else 0.0 for i, name in enumerate(names)])
        corners = np.array([performer.landmark(name) for name in names])
        meets.append(Meet(performer.landmark(side + mine), corners, mix, hold.pull, lift, away))
    aims = []
    if hold.fingers:
        aims += [Aim(performer.landmark(side + "WristOutside"), performer.landmark(side + "MiddleTip"), hold.fingers, hold.aim)]
    if hold.palm:
        aims += [Aim(performer.landmark(side + "BackOfHand"), performer.landmark(side + "Palm"), hold.palm, hold.aim)]
    apart = Apart(limb_vertices(performer, side), body_faces(performer, side, *hold.clear), margin=0.0 if lift == 0 else 0.006)
    return Problem(performer, build, LIMITS[:, 0], LIMITS[:, 1], STIFF, touches, meets, aims, (apart,))


def settle(problem: Problem, guess: Array) -> Array:
    """The arm of a guess brought to its place: first hand and fingers where and how they are wanted, then the skin."""
    free = replace(problem, touches=(), aparts=(), aims=[replace(aim, weight=4 * aim.weight) for aim in problem.aims])
    placed = free.solve(guess, rounds=25)
    return problem.solve(placed, rounds=30)


def one_frame(performer: Performer, act: Channels, frame: int) -> tuple[Array, Array]:
    """Rotations (1, joints, 4) and hips (1, 3) of one frame."""
    part = Channels(1)
    for name in ("hips", "turn", "trunk", "look"):
        setattr(part, name, getattr(act, name)[frame : frame + 1])
    for name in ("arms", "ankles", "feet", "toes", "knees"):
        setattr(part, name, {side: getattr(act, name)[side][frame : frame + 1] for side in SIDES})
    return pose(performer, part)


def held(performer: Performer, problem: Problem, angles: Array, hold: Hold, weight: float = 0.6) -> tuple[Meet, ...]:
    """The points of the skin that the touching points lie on in a solved pose: they stay together while it is held."""
    posed = performer.skin(performer.world(*problem.build(angles[None])))[0]
    from motion_touch import PosedSurface

    points = np.array([performer.landmark(hold.side + name) for name in hold.points])
    face, mix, _, _ = PosedSurface(posed, performer.faces, problem.touches[0].faces).nearest(posed[points])
    return tuple(Meet(int(p), performer.faces[f], m, weight) for p, f, m in zip(points, face, mix, strict=True))


def keep_hold(performer: Performer, act: Channels, hold: Hold, start: float, end: float, reach: float = 0.25) -> None:
    """Correct one arm over the frames of a contact (seconds) so that it stays closed while the body lives.

    The first frame's skin points are kept through the contact; the corrections fade out over `reach` seconds on
    either side, where the arm only has to stay outside the body.
    """
    side = hold.side
    first, last = int(round(start * FPS)), int(round(end * FPS))
    angles = act.arms[side]
    middle = (first + last) // 2
    problem = arm_problem(performer, act, middle, hold)
    solved = problem.solve(angles[middle], rounds=14)
    anchors = held(performer, problem, solved, hold)
    correction = np.zeros((last - first + 1, len(ARM)))
    for order in (range(middle, last + 1), range(middle, first - 1, -1)):
        delta = solved - angles[middle]
        for frame in order:
            here = replace(arm_problem(performer, act, frame, hold), meets=anchors, aims=())
            delta = here.solve(angles[frame] + delta, guess=angles[frame] + delta, rounds=5) - angles[frame]
            correction[frame - first] = delta
    fade = int(round(reach * FPS))
    frames = np.arange(act.frames)
    held_correction = correction[np.clip(frames - first, 0, len(correction) - 1)]
    share = ease(frames.astype(float), first - fade, first) * (1 - ease(frames.astype(float), last, last + fade))
    smooth = gaussian(held_correction, 1.0)
    act.arms[side] = angles + smooth * share[:, None]
