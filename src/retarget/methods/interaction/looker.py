"""What the interaction network sees of a pair of bodies, and what becomes of a pose by what it says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.part_field import FIGURES, PAIRS, QUARTERS, PartField, field_sensors, prepare_part_field
from retarget.contact.sensor_bones import BONES
from retarget.contact.skin_levers import TURNING, prepare_levers
from retarget.methods.interaction.hand_distances import HandDistances, prepare_hand_distances
from retarget.methods.interaction.unknowns import SIZE, Unknowns, prepare_unknowns
from retarget.motion.align import Actor
from retarget.motion.touch.mend import turned_by

Array = np.ndarray

SEEN = FIGURES * len(PAIRS) + 6 * (len(BONES) - 1) + 3 + 2 * (1 + QUARTERS) * len(BONES) + SIZE
"""Numbers that a network sees of a frame."""
AXES_FROM, ASKED_FROM = SEEN + 3 * len(TURNING), SEEN + 12 * len(TURNING)
"""Where axes of turns begin, and the equations of hands."""


def beside_seen(
    features: Float[Array, "frames features"],
) -> tuple[Float[Array, "frames TURNING 3"], Float[Array, "frames TURNING 3 3"], Float[Array, "frames ASKED"]]:
    """What stands behind what is seen: places of joints, axes of their turns, and what distances of hands ask."""
    places, axes, asked = np.split(features[:, SEEN:], [AXES_FROM - SEEN, ASKED_FROM - SEEN], axis=1)
    return places.reshape(len(features), -1, 3), axes.reshape(len(features), -1, 3, 3), asked


Posed = tuple[Float[Array, "frames sensors 3"], Float[Array, "frames sensors 3 3"]]
"""Sensors on frames: places and tangent frames."""


@dataclass(frozen=True, eq=False)
class Looker:
    """A matched pair of bodies; `prepare_looker` makes one."""

    field: PartField
    distances: HandDistances
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
        """What a look sees (`SEEN` numbers): the field of the poses as corrected so far, and the correction; and behind it, for the
        equations alone, where the joints' turns act (`Unknowns.levers`) and what distances of hands ask of them. `world` are the
        copied rotations."""
        posed = world_pose(self.moved(copied, world, turned)) if turned.any() else world_pose(copied)
        target, levers = self.field.target(*posed), self.unknowns.levers(turned, world, posed)
        asked = self.distances.equations(source[0], target[0], self.unknowns.roots(*posed), *levers)
        levers = (each.reshape(len(turned), -1) for each in levers)
        return np.concatenate([self.field.figures(source, target, *posed), turned, *levers, asked], axis=1, dtype=np.float32)

    def moved(self, copied: Motion, world: Float[Array, "frames joints 4"], turned: Float[Array, "frames SIZE"]) -> Motion:
        """The copied poses, corrected."""
        return turned_by(copied, self.turning, self.hips, self.unknowns.to_solver(turned, world))


def prepare_looker(source: Actor, target: Actor) -> Looker:
    """Match the bodies. Raises `RetargetError` for bodies without a surface, a head or a whole limb."""
    levers = prepare_levers(target.character, target.humanoid)
    sensors = [field_sensors(actor.character, actor.humanoid) for actor in (source, target)]
    field = prepare_part_field(*sensors, target.humanoid, (source.height, target.height))
    distances = prepare_hand_distances(field, tuple(sensors))
    return Looker(field, distances, prepare_unknowns(target, levers, sensors[1].stance), levers.turning, target.humanoid.joints["hips"])


def nothing_turned(frames: int) -> Float[Array, "frames SIZE"]:
    """No correction."""
    return np.zeros((frames, SIZE))
