"""What the interaction network sees of a pair of bodies, and what becomes of a pose by what it says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.part_field import PartField, field_sensors, prepare_part_field
from retarget.contact.skin_levers import prepare_levers
from retarget.methods.interaction.unknowns import SIZE, Unknowns, prepare_unknowns
from retarget.motion.align import Actor
from retarget.motion.touch.mend import turned_by

Array = np.ndarray

Posed = tuple[Float[Array, "frames sensors 3"], Float[Array, "frames sensors 3 3"]]
"""Sensors on frames: places and tangent frames."""


@dataclass(frozen=True, eq=False)
class Looker:
    """A matched pair of bodies; `prepare_looker` makes one."""

    field: PartField
    unknowns: Unknowns
    turning: Int[Array, "turning"]
    """The target's joints that turn."""
    hips: int

    def source(self, performed: Motion) -> Posed:
        """The performer's sensors on every frame: found once for all looks."""
        return self.field.source(*world_pose(performed))

    def features(
        self, source: Posed, copied: Motion, world: Float[Array, "frames joints 4"], turned: Float[Array, "frames SIZE"]
    ) -> Float[Array, "frames features"]:
        """What a look sees: the field of the poses as corrected so far, and the correction. `world` are the copied rotations."""
        posed = world_pose(self.moved(copied, world, turned)) if turned.any() else world_pose(copied)
        return np.concatenate([self.field.figures(source, *posed), turned.astype(np.float32)], axis=1)

    def moved(self, copied: Motion, world: Float[Array, "frames joints 4"], turned: Float[Array, "frames SIZE"]) -> Motion:
        """The copied poses, corrected."""
        return turned_by(copied, self.turning, self.hips, self.unknowns.to_solver(turned, world))


def prepare_looker(source: Actor, target: Actor) -> Looker:
    """Match the bodies. Raises `RetargetError` for bodies without a surface, a head or a whole limb."""
    levers = prepare_levers(target.character, target.humanoid)
    sensors = [field_sensors(actor.character, actor.humanoid) for actor in (source, target)]
    field = prepare_part_field(*sensors, target.humanoid, (source.height, target.height))
    return Looker(field, prepare_unknowns(target, levers, sensors[1].stance), levers.turning, target.humanoid.joints["hips"])


def nothing_turned(frames: int) -> Float[Array, "frames SIZE"]:
    """No correction."""
    return np.zeros((frames, SIZE))
