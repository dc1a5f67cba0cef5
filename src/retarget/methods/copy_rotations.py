"""Copy rotations, done properly: the baseline that every table carries. All of it is `motion.copy_clip`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from retarget.character import Motion, Pose
from retarget.methods.base import LAWS, Method, Result, Retargeter
from retarget.motion.align import Actor
from retarget.motion.copy_clip import Copier, CopySettings, prepare_copier


@dataclass(frozen=True)
class CopyRotations(CopySettings, Method):
    """Copy every joint's rotation; scale the path; hold ground contacts.

    With `foot_lock` and `steady` a clip is looked at as a whole, so stepping online, which cannot look ahead, leaves
    contacts and shake as they come; without them both agree exactly.
    """

    laws: ClassVar[frozenset[str]] = LAWS

    def prepare(self, source: Actor, target: Actor) -> PreparedCopy:
        """Match the bodies. Raises `RetargetError` where a leg has no length."""
        return PreparedCopy(prepare_copier(self, source, target))


@dataclass(frozen=True, eq=False)
class PreparedCopy(Retargeter):
    """A matched pair of bodies."""

    copier: Copier

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` for a motion of another skeleton or without frames."""
        copied = self.copier.clip(motion)
        return Result(self.copier.target, copied.motion, stats=copied.stats)

    def step(self, pose: Pose) -> Pose:
        """The pose of one frame, with no look-ahead: contacts are left as they come."""
        return self.copier.step(pose)
