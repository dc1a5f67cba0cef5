"""Poses made to touch what they should and nothing else: damped Gauss-Newton, frame by frame and over whole clips.

Frame by frame, each solution starts at the frame before (`follow`): that needs no future, and is what online use gets. A
clip is then solved once more as one problem (`together`): the equations of all its frames, linearised there, with the
curvature of the correction over time as one more term, so that contacts that come and go do not jerk; it is banded, and
solved directly in windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.motion.touch.equations import TALL, Linearised, PoseEquations
from retarget.motion.touch.goals import FrameGoals

Array = np.ndarray

ROUNDS = 2
"""Gauss-Newton steps a frame that starts at the frame before."""
COLD = 6
"""The same for the first frame, which nothing has warmed."""
TOGETHER, MOST_TOGETHER = 3, 5
"""Gauss-Newton steps of a whole clip, and how many there are at most for frames that are still deep inside themselves."""
STILL_DEEP = 0.003
"""Share of the height: how deep that is."""
INSISTENT = 4.0
"""How many times more than smoothness and closeness to the copied pose such frames weigh then than before."""
PRIOR = 0.006
"""Weight of closeness to the copied pose, times the joint's stiffness."""
STEADY = 0.3
"""Weight of closeness to the frame before, likewise, at 30 frames a second, where there is no look ahead."""
FOLLOW = 0.003
"""The same between the frames that a clip is solved at first."""
CALM = 2400.0
"""How many times more than that where nothing needs to be mended, over a clip,"""
FADED = 600.0
"""and online, where a correction that is no longer needed must fade without a look ahead."""
CURVATURE, SPEED = 12.0, 0.02
"""Weights of the correction's second and first difference over a clip, likewise, at 30 frames a second."""
SMOOTHER, DEEP = 2.5, 250
"""How many times more curvature weighs on a frame with `DEEP` penetrating vertices: how far limbs deep inside a trunk are
from its skin, and in which direction, changes from frame to frame."""
SMOOTHEST, HOPELESS = 75.0, (0.02, 0.05)
"""Likewise where some vertex stays inside by the second share of the height, and less down to the first: what no pose can
free should at least lie still."""
STIFFNESS = {
    "hips": 3000.0, "spine": 100.0, "chest": 100.0, "upperChest": 100.0, "neck": 20.0, "head": 20.0, "Shoulder": 2.0,
    "Hand": 2.0, "UpperLeg": 20.0, "LowerLeg": 20.0, "Foot": 20.0,
}  # fmt: skip
"""Of each joint against being turned from its copied pose; 1 for those not named."""
INERTIA = STIFFNESS | {
    "Shoulder": 6.0, "UpperArm": 3.0, "LowerArm": 3.0, "Hand": 6.0, "UpperLeg": 100.0, "LowerLeg": 100.0, "Foot": 100.0,
}  # fmt: skip
"""Likewise against its correction changing over time, and against being turned where nothing needs to be mended."""
FREE = {
    "hips": 0.12, "spine": 0.15, "chest": 0.15, "upperChest": 0.15, "neck": 0.2, "head": 0.25, "Shoulder": 0.3,
    "UpperArm": 0.9, "LowerArm": 1.1, "Hand": 0.7, "UpperLeg": 0.35, "LowerLeg": 0.45, "Foot": 0.35,
    "ThumbMetacarpal": 0.5, "IndexProximal": 0.5, "MiddleProximal": 0.5, "RingProximal": 0.5, "LittleProximal": 0.5,
}  # fmt: skip
"""Radians that each joint may turn away from its copied pose; beyond, `BOUND` pulls it back: what cannot be reached within
is left, rather than the body be bent out of its pose."""
FREE_SHIFT = 0.03
"""Likewise of the hips, in heights of the body."""
BOUND = 300.0
"""Weight of what a turn goes beyond its freedom."""
SHIFT_STIFFNESS = 1000.0
"""The same of the hips against being shifted: a decimetre weighs as much as ten radians squared of an elbow."""
SHIFT_BOUND = 10.0
"""Of a shift beyond its freedom, over that of a turn, for a body of one metre."""
STAYED = 0.002
"""Radians, or metres: the equations of a frame that has moved by less are taken as they are."""
LONGEST_TURN = 0.25
"""Radians that a joint turns in one step at most; metres that the hips shift."""
NOTHING = 1e-4
"""Radians: steps shorter than this end a frame's rounds."""
WINDOW, OVERLAP = 160, 24
"""Frames that are solved together, and how many of them the next window solves again."""


@dataclass(frozen=True, eq=False)
class Solver:
    """A prepared target with its stiffness; `prepare_solver` makes one."""

    equations: PoseEquations
    stiffness: Float[Array, "unknowns"]
    """What being turned, or shifted, from the copied pose weighs."""
    inertia: Float[Array, "unknowns"]
    """What the correction's changes over time weigh."""
    free: Float[Array, "unknowns"]
    """How far each turn, or the shift, may go: the same for the three numbers of a vector."""

    def follow(
        self,
        copied: Float[Array, "joints 4"],
        offsets: Float[Array, "joints 3"],
        goals: FrameGoals,
        before: Float[Array, "unknowns"],
        rounds: int,
        steady: float,
        need: float = 1.0,
    ) -> Float[Array, "unknowns"]:
        """The correction of one frame that starts at, and stays near, that of the frame before. Where there is less `need`
        (1 to 0) the copied pose holds more; where there is none the pose returns to it, and nothing is looked at."""
        x, prior = before.copy(), PRIOR * (self.stiffness + FADED * (1.0 - need) * self.inertia)
        if need == 0.0:
            return x * (steady * self.inertia / (steady * self.inertia + prior))
        for _ in range(rounds):
            found = self.equations.linearise(copied, offsets, goals, x)
            if not found.penetrating and not len(goals.weight) and not x.any():
                break
            matrix = found.matrix
            bound, back = self._bound(x)
            matrix[np.diag_indices(len(x))] += prior + steady * self.inertia + bound + 1e-6
            step = _solved(
                matrix, found.right - prior * x - steady * self.inertia * (x - before) - bound * (x - back)
            )
            x += step * np.minimum(1.0, LONGEST_TURN / np.maximum(_lengths(step), 1e-12))
            if _lengths(step).max() < NOTHING:
                break
        return x

    def together(
        self, x: Float[Array, "frames unknowns"], found: Sequence[Linearised], fps: float, need: Float[Array, "frames"]
    ) -> Float[Array, "frames unknowns"]:
        """The corrections of a clip as one problem, from the equations of its frames linearised near `x`. Where there is
        less `need` (1 to 0) the copied pose holds more."""
        solved = x.copy()
        for start in range(0, len(x), WINDOW - OVERLAP):
            stop = min(start + WINDOW, len(x))
            known = solved[max(start - 2, 0) : start]  # the curvature runs on from what is solved already
            solved[start:stop] = self._window(x[start:stop], found[start:stop], known, fps, need[start:stop])
            if stop == len(x):
                break
        step = solved - x
        return x + step * np.minimum(1.0, LONGEST_TURN / np.maximum(_lengths(step), 1e-12))

    def _bound(
        self, x: Float[Array, "*frames unknowns"]
    ) -> tuple[Float[Array, "*frames unknowns"], Float[Array, "*frames unknowns"]]:
        """Weights of what is beyond its freedom, and the nearest that is within."""
        share = self.free / np.maximum(_lengths(x), 1e-12)
        weight = np.where(share < 1.0, BOUND, 0.0)
        weight[..., -3:] *= (1.0 / self.equations.actor.height) ** 2 * SHIFT_BOUND
        return weight, x * np.minimum(share, 1.0)

    def _window(
        self, x: Float[Array, "frames unknowns"], found: Sequence[Linearised], known: Array, fps: float, need: Array
    ) -> Float[Array, "frames unknowns"]:
        from scipy.linalg import solveh_banded

        frames, size = x.shape
        curvature, speed = _differences(frames, len(known))
        # Equal curvature and speed cost alike, whatever the frame rate.
        rate = fps / 30.0
        depth = np.array([min(1.0, each.penetrating / DEEP) for each in found])
        deepest = np.array([each.deepest for each in found]) / self.equations.actor.height
        hopeless = np.clip((deepest - HOPELESS[0]) / (HOPELESS[1] - HOPELESS[0]), 0.0, 1.0)
        smooth = CURVATURE * rate**4 * (1.0 + np.append(np.zeros(len(known)), SMOOTHER * depth + SMOOTHEST * hopeless))
        rows = smooth[1:-1]  # of the frame in the middle of each second difference
        time = curvature.T @ (rows[:, None] * curvature) + SPEED * rate**2 * speed.T @ speed
        fixed, time = time[len(known) :, : len(known)], time[len(known) :, len(known) :]
        matrices = np.stack([each.matrix for each in found])
        at = np.stack([each.at for each in found])
        right = np.stack([each.right for each in found]) + (matrices @ at[..., None])[..., 0]
        right -= (fixed @ known) * self.inertia
        bound, back = self._bound(x)
        right += bound * back
        rows, columns = np.tril_indices(size)
        reach = min(2, frames - 1)
        band = np.zeros((max(reach * size + 1, size), frames, size))
        band[rows - columns, :, columns] = matrices[:, rows, columns].T
        for apart in range(reach + 1):
            own = np.diagonal(time, -apart)
            band[apart * size, : frames - apart] += own[:, None] * self.inertia
        band[0] += PRIOR * (self.stiffness + CALM * (1.0 - need)[:, None] * self.inertia) + bound + 1e-6
        flat = band.reshape(len(band), frames * size)
        return solveh_banded(flat, right.ravel(), lower=True, overwrite_ab=True, check_finite=False).reshape(x.shape)


def prepare_solver(equations: PoseEquations) -> Solver:
    """A solver with the joints' stiffness."""
    names = [name.removeprefix("left").removeprefix("right") for name in equations.levers.names]
    joints = np.repeat([STIFFNESS.get(name, 1.0) for name in names], 3)
    inertia = np.repeat([INERTIA.get(name, 1.0) for name in names], 3)
    free = np.repeat([FREE[name] for name in names], 3)
    shift = np.full(3, SHIFT_STIFFNESS * (TALL / equations.actor.height) ** 2)
    return Solver(
        equations, np.append(joints, shift), np.append(inertia, shift),
        np.append(free, np.full(3, FREE_SHIFT * equations.actor.height)),
    )  # fmt: skip


def _solved(matrix: Float[Array, "unknowns unknowns"], right: Float[Array, "unknowns"]) -> Float[Array, "unknowns"]:
    """The solution of a symmetric positive definite system; overwrites both."""
    from scipy.linalg.lapack import dposv

    _, solution, failed = dposv(matrix, right, lower=True, overwrite_a=True)
    return solution if failed == 0 else np.zeros_like(right)


def _lengths(step: Float[Array, "*frames unknowns"]) -> Float[Array, "*frames unknowns"]:
    """For every unknown the length of the vector of three that it belongs to."""
    vectors = step.reshape(*step.shape[:-1], -1, 3)
    return np.repeat(np.linalg.norm(vectors, axis=-1), 3, axis=-1)


def _differences(frames: int, known: int) -> tuple[Float[Array, "_ both"], Float[Array, "_ both"]]:
    """Matrices of second and first differences over the known frames and those to be solved, without rows that only see
    known frames."""
    whole = np.eye(frames + known)
    first, second = np.diff(whole, axis=0), np.diff(whole, n=2, axis=0)
    return second[max(known - 2, 0) :], first[max(known - 1, 0) :]
