"""Hands on the body: what a hand does there, and arms solved so that it lies on the skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from motion_body import SIDES, Performer
from motion_pose import ARM, LIMITS, Channels, pose, pose_arm
from motion_time import FPS, ease
from motion_touch import Aim, Apart, Meet, PosedSurface, Problem, Touch, faces_of

from retarget.motion.filter import gaussian

Array = np.ndarray
Direction = tuple[float, float, float]
STIFF = np.array([40, 40, 10, 10, 10, 10, 10, 10, 15, 8, 8, 8, 5, 5, 5, 5, 12]) * 1e-3
"""How much each arm angle resists being changed from the guess: metres of contact error that a radian is worth."""


@dataclass(frozen=True, eq=False)
class Hold:
    """What one hand does on the body, in words that do not depend on the mesh."""

    side: str
    points: Sequence[str] = ()
    """Marks of this arm (without the side) that touch: 'Palm', 'IndexPad', ..."""
    parts: Sequence[str] = ()
    """Parts of the body that they touch."""
    near: dict[str, dict[str, float]] | None = None
    """Mark of this arm: place on the body that it shall be near, a mix of up to three landmarks."""
    fingers: Direction | None = None
    """World direction from the wrist to the tip of the middle finger."""
    palm: Direction | None = None
    """World direction that the palm faces."""
    away: Direction = (0.0, 0.0, 1.0)
    """World direction in which the hand comes and goes."""
    shift: Direction = (0.0, 0.0, 0.0)
    """Metres in the world by which the goals lie off the places in `near`."""
    pull: float = 0.25
    aim: float = 0.05
    touch: float = 3.0
    stiff_girdle: float = 1.0
    stiff_shoulder: float = 1.0
    stiff_fingers: float = 1.0
    """How much more than usual shoulder girdle, upper arm and fingers resist being moved from the guess."""
    clear: Sequence[str] = ()
    """Other arms that this arm may pass through (it is not looked at then)."""


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


def one_frame(performer: Performer, act: Channels, frame: int) -> tuple[Array, Array]:
    """Rotations (1, joints, 4) and hips (1, 3) of one frame."""
    part = Channels(1)
    for name in ("hips", "turn", "trunk", "look"):
        setattr(part, name, getattr(act, name)[frame : frame + 1])
    for name in ("arms", "ankles", "feet", "toes", "knees"):
        setattr(part, name, {side: getattr(act, name)[side][frame : frame + 1] for side in SIDES})
    return pose(performer, part)


def arm_problem(performer: Performer, act: Channels, frame: int, holds: Sequence[Hold], lift: float = 0.0) -> Problem:
    """The problem of one arm, or of both together, at one frame of a clip; its angles are those of each hold in turn.

    `lift` metres keep the hands off the skin: no touch is asked then, and the arms keep a little more distance.
    """
    rotations, hips = one_frame(performer, act, frame)

    def build(angles: Array) -> tuple[Array, Array]:
        turns = np.repeat(rotations, len(angles), axis=0)
        for hold, own in zip(holds, np.split(angles, len(holds), axis=1), strict=True):
            pose_arm(performer, hold.side, own, turns)
        return turns, np.repeat(hips, len(angles), axis=0)

    touches, meets, aims, aparts = [], [], [], []
    for hold in holds:
        mark = lambda name, side=hold.side: performer.landmark(side + name)  # noqa: E731
        if hold.points and not lift:
            touches.append(Touch(np.array([mark(name) for name in hold.points]), part_faces(performer, *hold.parts), hold.touch))
        shift = tuple(np.multiply(hold.away, lift) + hold.shift)
        for mine, place in (hold.near or {}).items():
            names = (list(place) * 3)[:3]
            mix = np.array([place[name] if i < len(place) else 0.0 for i, name in enumerate(names)])
            meets.append(Meet(mark(mine), np.array([performer.landmark(name) for name in names]), mix, hold.pull, shift))
        if hold.fingers:
            aims.append(Aim(mark("WristOutside"), mark("MiddleTip"), hold.fingers, hold.aim))
        if hold.palm:
            aims.append(Aim(mark("BackOfHand"), mark("Palm"), hold.palm, hold.aim))
        faces = body_faces(performer, hold.side, *hold.clear)
        aparts.append(Apart(limb_vertices(performer, hold.side), faces, margin=0.006 if lift else 0.0))
    low, high = np.tile(LIMITS, (len(holds), 1)).T
    stiff = np.concatenate([STIFF * np.repeat([hold.stiff_girdle, hold.stiff_shoulder, 1.0, hold.stiff_fingers], [2, 3, 4, 8]) for hold in holds])
    return Problem(performer, build, low, high, stiff, touches, meets, aims, aparts)


def settle(problem: Problem, lifted: Problem, guess: Array) -> Array:
    """Arms of a guess brought to their place: first hands and fingers as they are wanted but off the skin, then on it."""
    free = replace(lifted, aparts=(), aims=[replace(aim, weight=4 * aim.weight) for aim in lifted.aims])
    outside = replace(lifted, aims=free.aims).solve(free.solve(guess, rounds=30), rounds=20)
    return problem.solve(outside, rounds=50)


def polish(problem: Problem, angles: Array, rounds: int = 30, aim: float = 0.3) -> Array:
    """Closed and clean: places no longer count, only the skin, and staying near a pose that is where it should be."""
    aims = [replace(each, weight=aim * each.weight) for each in problem.aims]
    return replace(problem, meets=(), aims=aims).solve(angles, rounds=rounds)


def anchored(performer: Performer, problem: Problem, angles: Array, weight: float = 0.6) -> tuple[Meet, ...]:
    """The points of the skin that the touching points lie on in a solved pose: they stay together while it is held."""
    posed = performer.skin(performer.world(*problem.build(angles[None])))[0]
    meets = []
    for touch in problem.touches:
        face, mix, _, _ = PosedSurface(posed, performer.faces, touch.faces).nearest(posed[touch.points])
        meets += [Meet(int(p), performer.faces[f], m, weight) for p, f, m in zip(touch.points, face, mix, strict=True)]
    return tuple(meets)


def keep_hold(performer: Performer, act: Channels, holds: Sequence[Hold], start: float, end: float, reach: float = 0.25, aim: float = 0.3) -> None:
    """Correct arms over the frames of a contact (seconds) so that it stays closed while the body lives.

    Each touching point keeps its place on the skin; the corrections fade out over `reach` seconds on either side.
    """
    first, last = int(round(start * FPS)), int(round(end * FPS))
    angles = np.concatenate([act.arms[hold.side] for hold in holds], axis=1)
    middle = (first + last) // 2
    problem = arm_problem(performer, act, middle, holds)
    solved = polish(problem, angles[middle], rounds=14, aim=aim)
    anchors = anchored(performer, problem, solved)
    correction = np.zeros((last - first + 1, angles.shape[1]))
    for order in (range(middle, last + 1), range(middle, first - 1, -1)):
        delta = solved - angles[middle]
        for frame in order:
            here = replace(arm_problem(performer, act, frame, holds), meets=anchors, aims=())
            delta = here.solve(angles[frame] + delta, guess=angles[frame] + delta, rounds=7) - angles[frame]
            correction[frame - first] = delta
    frames = np.arange(act.frames)
    widened = gaussian(correction[np.clip(frames - first, 0, len(correction) - 1)], 1.0)
    fade, at = int(round(reach * FPS)), frames.astype(float)
    share = ease(at, first - fade, first) * (1 - ease(at, last, last + fade))
    for k, hold in enumerate(holds):
        act.arms[hold.side] = act.arms[hold.side] + (widened * share[:, None])[:, k * len(ARM) : (k + 1) * len(ARM)]
