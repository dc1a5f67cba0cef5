"""A method of your own: one file and one line in `METHODS`. This one copies local rotations by name, as simple scripts
do, which is right only where both bodies rest alike.

    python examples/own_method.py
"""

from dataclasses import dataclass

from retarget import METHODS, Motion, Result, embedded_motion, human, retarget
from retarget.body.kinematics import still_motion
from retarget.errors import RetargetError
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
        path = self.settings.scale * motion.translations[:, :1]
        return Result(self.target.character, Motion(self.target.skeleton, rotations, path, motion.fps))

    def step(self, pose):
        raise RetargetError("this method takes whole clips")


METHODS["by-name"] = ByName
result = retarget(embedded_motion("walk"), human(height=1.2, age=0.12), method="by-name", scale=0.7)
print(f"{len(result.motion)} frames, {len(result.motion.skeleton)} joints, status {result.status}")
