"""A method of your own: one file and one line in `METHODS`.

It copies local rotations by name, as simple scripts do: right only where both bodies rest alike."""

from dataclasses import dataclass

from retarget import METHODS, Motion, Result, RetargetError, embedded_motion, human, retarget
from retarget.body.kinematics import still_motion
from retarget.methods import Method, Retargeter


@dataclass(frozen=True)
class ByName(Method):
    scale: float = 1.0  # settings are fields

    def prepare(self, source, target):
        shared = [name for name in target.humanoid.joints if name in source.humanoid.joints]
        return Prepared(self, target, [(source.humanoid.joints[name], target.humanoid.joints[name]) for name in shared])


@dataclass(frozen=True, eq=False)
class Prepared(Retargeter):
    settings: ByName
    target: object
    pairs: list

    def __call__(self, motion):
        rotations = still_motion(self.target.skeleton, len(motion)).rotations
        for theirs, ours in self.pairs:
            rotations[:, ours] = motion.rotations[:, theirs]
        moved = Motion(self.target.skeleton, rotations, self.settings.scale * motion.translations[:, :1], motion.fps)
        return Result(self.target, moved)

    def step(self, pose):
        raise RetargetError("this method takes whole clips")


METHODS["by-name"] = ByName
print(retarget(embedded_motion("walk"), human(height=1.2, age=0.12), method="by-name", scale=0.7).status)
