"""Interaction by a network alone: for when speed is all."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.character import Motion, Pose
from retarget.errors import RetargetError
from retarget.methods.base import Method, Result, Retargeter
from retarget.methods.interaction.looker import Looker, prepare_looker
from retarget.methods.interaction.network import InteractionNetwork, load_network
from retarget.motion.align import Actor
from retarget.motion.copy_clip import Copier, CopySettings, prepare_copier
from retarget.motion.stand_in import StandIn, fit_stand_in
from retarget.motion.touch.mend import between, frames_of, one_frame, solved_frames

Array = np.ndarray

KEPT = 0.5
"""How much of the last frame's correction a frame keeps online, at 30 frames a second."""


@dataclass(frozen=True)
class LearnedInteraction(CopySettings, Method):
    """Copied rotations, corrected by a network that has learnt what `interaction` does.

    Several times as fast, less exact: contacts that a thin performer has lie near their places on other bodies, and most of
    what sinks in comes out; of what the performer has inside itself, as much as surfaces that touch may be apart. It knows humanoids
    alone; joints that it has no place for (tails, capes, second joints of fingers) stay as copied.
    """

    laws: ClassVar[frozenset[str]] = frozenset(
        {
            "mirrored in, mirrored out",
            "turning the world turns the result",
            "scaling both bodies scales the path",
            "equal results for equal input",
            "permuting vertices permutes the result",
        }
    )
    """What it sees depends on neither place, facing nor size. It keeps no other law exactly: the same body gets corrections of a
    fraction of a degree, clips are smoothed and single poses are not."""

    weights: Path | None = None
    """Folder of other weights than the package's."""
    step_fps: float = 30.0
    """Frames a second that `step` is called with."""

    def prepare(self, source: Actor, target: Actor) -> PreparedLearned:
        """Match the bodies. Raises `RetargetError` for a target without a surface, a head or a whole limb, and `FileError` for
        weights that cannot be used."""
        if target.character.skin is None:
            raise RetargetError("the target has no surface; the method 'learned-interaction' needs one (use copy-rotations)")
        network = load_network() if self.weights is None else load_network(self.weights)
        stand_in = fit_stand_in(source) if source.character.skin is None else None
        looker = prepare_looker(stand_in.actor if stand_in else source, target)
        return PreparedLearned(prepare_copier(self, source, target), stand_in, looker, network, self.step_fps)


@dataclass(frozen=True, eq=False)
class PreparedLearned(Retargeter):
    """A matched pair of bodies."""

    copier: Copier
    stand_in: StandIn | None
    """The body whose surface is looked at, where the source has none."""
    looker: Looker
    network: InteractionNetwork
    step_fps: float
    before: list[Float[Array, "1 SIZE"]] = field(default_factory=list)
    """The last online frame's correction."""

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` as `Copier.clip` does."""
        copied = self.copier.clip(motion)
        chosen, fps = solved_frames(motion)
        frames = frames_of(copied.motion, chosen)
        performed = frames_of(self.stand_in.motion(motion) if self.stand_in else motion, chosen)
        turned = self.network.clip(self.looker, performed, frames, fps)
        whole = between(turned, chosen, len(motion))
        if self.copier.settings.in_place:
            whole[:, [-3, -1]] = 0.0  # across the ground the body stays where it is
        moved = self.looker.moved(copied.motion, world_pose(copied.motion)[0], whole)
        if copied.contacts is not None:  # what rests on the ground is held again: legs turn by a degree or two
            moved = self.copier.clip(motion, turned=world_pose(moved)[0]).motion
        return Result(self.copier.target, moved, stats=copied.stats)

    def step(self, pose: Pose) -> Pose:
        """The next pose online, on top of the copied one; corrections follow within a frame or two."""
        frame = one_frame(self.copier.step(pose), self.copier.target.skeleton)
        performed, performer = (self.stand_in.pose(pose), self.stand_in.actor) if self.stand_in else (pose, self.copier.source)
        turned = self.network(self.looker, one_frame(performed, performer.skeleton), frame)
        if self.before:
            kept = KEPT ** (30.0 / self.step_fps)
            turned = kept * self.before[0] + (1.0 - kept) * turned
        self.before[:] = [turned]
        return self.looker.moved(frame, world_pose(frame)[0], turned).pose(0)
