"""Clips and single poses through the interaction solver."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions, world_pose
from retarget.character import Motion, Pose
from retarget.contact.contact_edits import without_effect
from retarget.methods.base import Result, Retargeter
from retarget.methods.interaction.equations import PoseEquations
from retarget.methods.interaction.faults import FADING, has_fault, needs
from retarget.methods.interaction.goals import ClipGoals, GoalMaker
from retarget.methods.interaction.report import corrections, remaining
from retarget.methods.interaction.solve import (
    COLD,
    FOLLOW,
    MOST_TOGETHER,
    ROUNDS,
    STAYED,
    STEADY,
    STILL_DEEP,
    TOGETHER,
    Solver,
)
from retarget.motion.copy_clip import Copier
from retarget.motion.stand_in import StandIn

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


@dataclass(frozen=True, eq=False)
class PreparedInteraction(Retargeter):
    """A matched pair of bodies."""

    copier: Copier
    stand_in: StandIn | None
    """The body whose surface is looked at, where the source has none."""
    goals: GoalMaker
    solver: Solver
    causal: bool
    step_fps: float
    """Frames a second that `step` is called with."""
    before: list[Before] = field(default_factory=list)
    """What the last online frame left."""
    steps: list[int] = field(default_factory=lambda: [0])
    """How many online frames there were."""

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` as `Copier.clip` does."""
        if self.causal:
            return self._causal(motion)
        copied = self.copier.clip(motion)
        stride = max(1, round(motion.fps / RATE))
        chosen = np.unique(np.append(np.arange(0, len(motion), stride), len(motion) - 1))
        frames, fps = _frames(copied.motion, chosen), motion.fps / stride
        touching = None if copied.contacts is None else copied.contacts.touching[chosen]
        performed = self.stand_in.motion(motion) if self.stand_in else motion
        performed = replace(_frames(performed, chosen), fps=fps, name=motion.name)
        found, goals = self.goals.clip(performed, frames, self.solver.equations, touching)
        x = self._solve(frames, goals, fps)
        if self.copier.settings.in_place:
            x[:, [-3, -1]] = 0.0  # across the ground the body stays where it is
        stats = copied.stats | {
            "contacts_of_the_source": len(found.tracks.vertex),
            **corrections(self.solver.equations, x, chosen / motion.fps),
        }
        status, left = remaining(self.solver.equations, frames, goals, x, chosen / motion.fps)
        stats |= left
        idle = without_effect(found, self.goals.edits.of_clip(motion.name), fps, len(chosen))
        if idle:
            stats["contacts_file_without_effect"] = idle
        if self.stand_in:
            stats["stand_in"] = list(self.stand_in.notes)
        if len(chosen) < len(motion):
            x = _between(x, chosen, len(motion))
        return Result(self.copier.target, corrected(self.solver.equations, copied.motion, x), status, stats)

    def step(self, pose: Pose) -> Pose:
        """The next pose online, on top of the copied one; starts where the last frame's solution was. Needs no later
        frame: a contact's pull follows how close the source's surfaces are. Times of a contacts file count from the first
        call. Raises `RetargetError` where one adds contacts."""
        before = self.before[0] if self.before else None
        result, now = self._next(pose, before, self.steps[0] / self.step_fps, self.step_fps)
        self.before[:] = [now]
        self.steps[0] += 1
        return result

    def _next(self, pose: Pose, before: Before | None, seconds: float, fps: float) -> tuple[Pose, Before]:
        copied, equations = self.copier.step(pose), self.solver.equations
        frame = _one(copied, self.copier.target.skeleton)
        performed = self.stand_in.pose(pose) if self.stand_in else pose
        performer = self.stand_in.actor if self.stand_in else self.copier.source
        found = self.goals.online(_one(performed, performer.skeleton), frame, equations, seconds, self.copier.floor)
        offsets = local_positions(frame.skeleton, frame.translations, frame.moved)[0]
        goals, still = found.frame(0), np.zeros(equations.size)
        faulty = has_fault(equations, equations.pose(copied.rotations, offsets, still), goals)
        if before is None:
            need = float(faulty)
            x = self.solver.follow(copied.rotations, offsets, goals.weakened(need), still, COLD, STEADY, need)
        else:
            change = 1.0 / max(FADING * fps, 1.0)
            need = float(np.clip(before.need + (change if faulty else -change), 0.0, 1.0))
            x = self.solver.follow(copied.rotations, offsets, goals.weakened(need), before.x, ROUNDS, STEADY, need)
        return corrected(equations, frame, x[None]).pose(0), Before(x, need)

    def _causal(self, motion: Motion) -> Result:
        """A clip frame by frame."""
        poses, before = [], None
        for number in range(len(motion)):
            pose, before = self._next(motion.pose(number), before, number / motion.fps, motion.fps)
            poses.append(pose)
        made = Motion(
            self.copier.target.skeleton,
            rot.continuous(np.stack([pose.rotations for pose in poses])),
            np.stack([pose.translations for pose in poses]),
            motion.fps, poses[0].moved, motion.name,
        )  # fmt: skip
        return Result(self.copier.target, made, stats={"scale": self.copier.plan.scale})

    def _solve(self, copied: Motion, goals: ClipGoals, fps: float) -> Float[Array, "frames unknowns"]:
        """Frames `KEY` apart one after the other, the rest between them, then all as one problem. Frames without a fault
        are not looked at: they stay as copied."""
        equations, count = self.solver.equations, len(copied)
        deep = STILL_DEEP * equations.actor.height
        offsets = local_positions(copied.skeleton, copied.translations, copied.moved)
        need = needs(equations, copied, offsets, goals)
        wanted = [goals.frame(f).weakened(need[f]) for f in range(count)]
        keys = np.unique(np.append(np.arange(0, count, max(1, round(KEY * fps))), count - 1))
        at_keys, x = [], np.zeros(equations.size)
        for number, frame in enumerate(keys.tolist()):
            rounds, steady = (ROUNDS, FOLLOW) if number else (COLD, 0.0)
            if need[frame]:
                x = self.solver.follow(copied.rotations[frame], offsets[frame], wanted[frame], x, rounds, steady)
            else:
                x = np.zeros(equations.size)
            at_keys.append(x)
        x = np.stack([np.interp(np.arange(count), keys, column) for column in np.array(at_keys).T], axis=1)
        found = [equations.nothing] * count
        for turn in range(MOST_TOGETHER):
            looked_at = [
                f for f in np.flatnonzero(need).tolist()
                if turn == 0 or (np.abs(x[f] - found[f].at).max() > STAYED and (turn < TOGETHER or found[f].deepest > deep))
            ]  # fmt: skip
            if not looked_at:
                break
            for f in looked_at:
                found[f] = equations.linearise(copied.rotations[f], offsets[f], wanted[f], x[f])
            x = self.solver.together(x, found, fps, need)
        return x


def corrected(equations: PoseEquations, copied: Motion, x: Float[Array, "frames unknowns"]) -> Motion:
    """The copied motion with corrections on top."""
    rotations, translations = copied.rotations.copy(), copied.translations.copy()
    turning, hips = equations.levers.turning, equations.hips
    turns = x[:, :-3].reshape(len(x), -1, 3)
    rotations[:, turning] = rot.multiply(rot.from_rotation_vector(turns), rotations[:, turning])
    shift = x[:, -3:]
    if hips != 0:
        shift = rot.rotate(rot.inverse(world_pose(copied)[0][:, copied.skeleton.parents[hips]]), shift)
    translations[:, copied.moved.index(hips)] += shift
    return replace(copied, rotations=rotations, translations=translations)


def _frames(motion: Motion, chosen: Int[Array, "chosen"]) -> Motion:
    return replace(motion, rotations=motion.rotations[chosen], translations=motion.translations[chosen])


def _one(pose: Pose, skeleton) -> Motion:
    """A pose as a motion of one frame."""
    return Motion(skeleton, pose.rotations[None], pose.translations[None], RATE, pose.moved)


def _between(x: Float[Array, "chosen unknowns"], chosen: Array, frames: int) -> Float[Array, "frames unknowns"]:
    """The corrections of frames between those that were solved: splines."""
    if len(chosen) < 2:
        return np.repeat(x, frames, axis=0)
    from scipy.interpolate import CubicSpline

    return CubicSpline(chosen, x)(np.arange(frames))
