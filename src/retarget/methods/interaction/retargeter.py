"""Clips and single poses through the interaction solver."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions, world_pose
from retarget.character import Motion, Pose
from retarget.contact.contact_edits import without_effect
from retarget.methods.base import Result, Retargeter
from retarget.methods.interaction.looker import Looker
from retarget.methods.interaction.network import InteractionNetwork
from retarget.motion.copy_clip import Copier
from retarget.motion.stand_in import StandIn
from retarget.motion.touch.goals import ClipGoals, GoalMaker
from retarget.motion.touch.mend import (
    Before,
    between,
    corrected,
    frames_of,
    one_frame,
    solve_clip,
    solve_next,
    solved_frames,
)
from retarget.motion.touch.report import corrections, remaining
from retarget.motion.touch.solve import Solver

Array = np.ndarray

LEARNED_TOGETHER, LEARNED_STAYED = 1, 0.012
"""Rounds of a whole clip that starts from what a network says; and radians, or metres, from which on frames that have moved are looked
at again."""


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
    start: tuple[Looker, InteractionNetwork] | None = None
    """Who says where clips start from; None for key frames solved one after the other."""
    before: list[Before] = field(default_factory=list)
    """What the last online frame left."""
    steps: list[int] = field(default_factory=lambda: [0])
    """How many online frames there were."""

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` as `Copier.clip` does."""
        if self.causal:
            return self._causal(motion)
        copied, equations = self.copier.clip(motion), self.solver.equations
        chosen, fps = solved_frames(motion)
        frames = frames_of(copied.motion, chosen)
        touching = None if copied.contacts is None else copied.contacts.touching[chosen]
        performed = self.stand_in.motion(motion) if self.stand_in else motion
        performed = replace(frames_of(performed, chosen), fps=fps, name=motion.name)
        found, goals = self.goals.clip(performed, frames, equations, touching)
        x = self._solved(performed, frames, goals, fps)
        if self.copier.settings.in_place:
            x[:, [-3, -1]] = 0.0  # across the ground the body stays where it is
        stats = copied.stats | {
            "contacts_of_the_source": len(found.tracks.vertex),
            **corrections(equations, x, chosen / motion.fps),
        }
        offsets = local_positions(frames.skeleton, frames.translations, frames.moved)
        status, left = remaining(
            equations,
            goals,
            chosen / motion.fps,
            lambda f: equations.pose(frames.rotations[f], offsets[f], x[f]).vertices,
        )
        stats |= left
        idle = without_effect(found, self.goals.edits.of_clip(motion.name), fps, len(chosen))
        if idle:
            stats["contacts_file_without_effect"] = idle
        if self.stand_in:
            stats["stand_in"] = list(self.stand_in.notes)
        whole = corrected(equations, copied.motion, between(x, chosen, len(motion)))
        return Result(self.copier.target, whole, status, stats)

    def _solved(self, performed: Motion, frames: Motion, goals: ClipGoals, fps: float) -> Float[Array, "frames unknowns"]:
        if self.start is None:
            return solve_clip(self.solver, frames, goals, fps)
        looker, network = self.start
        turned = network.clip(looker, performed, frames, fps)
        start = looker.unknowns.to_solver(turned, world_pose(frames)[0])
        return solve_clip(self.solver, frames, goals, fps, start=start, together=LEARNED_TOGETHER, stayed=LEARNED_STAYED)

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
        frame = one_frame(self.copier.step(pose), self.copier.target.skeleton)
        performed = self.stand_in.pose(pose) if self.stand_in else pose
        performer = self.stand_in.actor if self.stand_in else self.copier.source
        equations = self.solver.equations
        found = self.goals.online(
            one_frame(performed, performer.skeleton), frame, equations, seconds, self.copier.floor
        )
        now = solve_next(self.solver, frame, found.frame(0), before, fps)
        return corrected(equations, frame, now.x[None]).pose(0), now

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
