"""Corrections of a clip, all frames together, and of one frame after the other, online."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions, world_pose
from retarget.character import Motion, Pose, Skeleton
from retarget.motion.touch.equations import PoseEquations
from retarget.motion.touch.faults import FADING, has_fault, needs
from retarget.motion.touch.goals import ClipGoals, FrameGoals
from retarget.motion.touch.solve import (
    COLD,
    FOLLOW,
    INSISTENT,
    MOST_TOGETHER,
    ROUNDS,
    STAYED,
    STEADY,
    STILL_DEEP,
    TOGETHER,
    Solver,
)

Array = np.ndarray

KEY = 0.2
"""Seconds between the frames that are solved one after the other before the clip is solved as a whole."""
RATE = 30.0
"""Frames a second that are solved, about; those between follow smoothly."""


@dataclass(frozen=True, eq=False)
class Before:
    """What a frame leaves to the next, online."""

    x: Float[Array, "unknowns"]
    """Its correction."""
    need: float
    """How much it might be changed, 0 to 1."""


def solved_frames(motion: Motion) -> tuple[Int[Array, "chosen"], float]:
    """The frames of a clip that are solved, about `RATE` a second and the last, and how many there are a second."""
    stride = max(1, round(motion.fps / RATE))
    return np.unique(np.append(np.arange(0, len(motion), stride), len(motion) - 1)), motion.fps / stride


def solve_clip(
    solver: Solver,
    copied: Motion,
    goals: ClipGoals,
    fps: float,
    patience: int = 1,
    start: Float[Array, "frames unknowns"] | None = None,
    together: int = TOGETHER,
    stayed: float = STAYED,
) -> Float[Array, "frames unknowns"]:
    """Corrections of a copied clip, in `patience` times the usual number of steps at most. Frames `KEY` apart are solved one
    after the other, beginning at `start` (else at nothing) with what the key before was moved by; the rest is moved by what lies
    between them. Then all are solved as one problem, in `together` steps and more where frames stay deep; beyond the usual
    number of steps such frames insist. Frames that have moved by less than `stayed` (radians, or metres) are not looked at again.
    Frames without a fault are not looked at: they stay as copied."""
    equations, count = solver.equations, len(copied)
    deep = STILL_DEEP * equations.actor.height
    offsets = local_positions(copied.skeleton, copied.translations, copied.moved)
    need = needs(equations, copied, offsets, goals)
    wanted = [goals.frame(f).weakened(need[f]) for f in range(count)]
    start = np.zeros((count, equations.size)) if start is None else start * (need > 0)[:, None]
    x = start + _moved_at_keys(solver, copied, offsets, wanted, need, fps, patience, start)
    found = [equations.nothing] * count
    for turn in range(patience * MOST_TOGETHER if together else 0):
        looked_at = [
            f for f in np.flatnonzero(need).tolist()
            if turn == 0 or (np.abs(x[f] - found[f].at).max() > stayed and (turn < patience * together or found[f].deepest > deep))
        ]  # fmt: skip
        if not looked_at:
            break
        for f in looked_at:
            found[f] = equations.linearise(copied.rotations[f], offsets[f], wanted[f], x[f])
            if turn >= patience * TOGETHER:
                found[f] = found[f].times(INSISTENT)
        x = solver.together(x, found, fps, need)
    return x


def _moved_at_keys(
    solver: Solver,
    copied: Motion,
    offsets: Float[Array, "frames joints 3"],
    wanted: Sequence[FrameGoals],
    need: Float[Array, "frames"],
    fps: float,
    patience: int,
    start: Float[Array, "frames unknowns"],
) -> Float[Array, "frames unknowns"]:
    """By how much frames `KEY` apart move from `start`, one after the other, and what lies between them."""
    count, moved, at_keys = len(copied), np.zeros(solver.equations.size), []
    keys = np.unique(np.append(np.arange(0, count, max(1, round(KEY * fps))), count - 1))
    for number, frame in enumerate(keys.tolist()):
        rounds, steady = (ROUNDS, FOLLOW) if number else (patience * COLD, 0.0)
        if need[frame]:
            before = start[frame] + moved
            moved = solver.follow(copied.rotations[frame], offsets[frame], wanted[frame], before, rounds, steady) - start[frame]
        else:
            moved = np.zeros(solver.equations.size)
        at_keys.append(moved)
    return np.stack([np.interp(np.arange(count), keys, column) for column in np.array(at_keys).T], axis=1)


def solve_next(
    solver: Solver,
    copied: Motion,
    goals: FrameGoals,
    before: Before | None,
    fps: float,
    always: bool = False,
    patience: int = 1,
) -> Before:
    """The correction of a frame (a motion of one) that starts at, and stays near, that of the frame before. Poses without a
    fault are left as they are, unless `always` lets contacts pull. `patience` as in `solve_clip`, for the first frame."""
    equations = solver.equations
    rotations, offsets = copied.rotations[0], local_positions(copied.skeleton, copied.translations, copied.moved)[0]
    still = np.zeros(equations.size)
    faulty = always or has_fault(equations, equations.pose(rotations, offsets, still, goals.surface), goals)
    if before is None:
        need, at, rounds = float(faulty), still, patience * COLD
    else:
        change = 1.0 / max(FADING * fps, 1.0)
        need, at, rounds = float(np.clip(before.need + (change if faulty else -change), 0.0, 1.0)), before.x, ROUNDS
    return Before(solver.follow(rotations, offsets, goals.weakened(need), at, rounds, STEADY, need), need)


def corrected(equations: PoseEquations, copied: Motion, x: Float[Array, "frames unknowns"]) -> Motion:
    """The copied motion with corrections on top."""
    return turned_by(copied, equations.levers.turning, equations.hips, x)


def turned_by(copied: Motion, turning: Int[Array, "turning"], hips: int, x: Float[Array, "frames unknowns"]) -> Motion:
    """The same for a body of which only the joints that turn, and the one that is shifted, are known."""
    rotations, translations = copied.rotations.copy(), copied.translations.copy()
    turns = x[:, :-3].reshape(len(x), -1, 3)
    rotations[:, turning] = rot.multiply(rot.from_rotation_vector(turns), rotations[:, turning])
    shift = x[:, -3:]
    if hips != 0:
        shift = rot.rotate(rot.inverse(world_pose(copied)[0][:, copied.skeleton.parents[hips]]), shift)
    translations[:, copied.moved.index(hips)] += shift
    return replace(copied, rotations=rotations, translations=translations)


def frames_of(motion: Motion, chosen: Int[Array, "chosen"]) -> Motion:
    """Some frames of a motion, at its own rate."""
    return replace(motion, rotations=motion.rotations[chosen], translations=motion.translations[chosen])


def one_frame(pose: Pose, skeleton: Skeleton) -> Motion:
    """A pose as a motion of one frame."""
    return Motion(skeleton, pose.rotations[None], pose.translations[None], RATE, pose.moved)


def between(x: Float[Array, "chosen unknowns"], chosen: Array, frames: int) -> Float[Array, "frames unknowns"]:
    """The corrections of frames between those that were solved: splines."""
    if len(chosen) < 2:
        return np.repeat(x, frames, axis=0)
    if len(chosen) == frames:
        return x
    from scipy.interpolate import CubicSpline

    return CubicSpline(chosen, x)(np.arange(frames))
