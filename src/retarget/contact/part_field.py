"""The dense interaction field of Ye 2024, summed up by pairs of body parts: what a small network can look at in a millisecond.

The paper gives every sensor's 20 nearest and farthest partners to six layers of a PointNet. Here sensors of two parts (a forearm and
the chest) are compared at once: where their closest pairs are on the source, how the same pairs stand on the target, in the
observer's tangent frame as in the paper (`contact/interaction_field.py` has the field itself), and, which the paper has not, how
deep one part has sunk into the other on the target. All is in the axes of the target's hips and in shares of its height, so that
neither rig, place, facing nor size matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Character, Skeleton
from retarget.contact.sensor_bones import BONES, SIDES, Stance, sensor_bones
from retarget.contact.sensors import (
    Sensors,
    SensorSkinner,
    dense_layout,
    place_sensors,
    prepare_sensor_skinning,
    surface_points,
)
from retarget.correspond.joints import Humanoid

Array = np.ndarray

COUNT = 700
"""Sensors of a body, about: 5 % of the height from one to the next."""
FIGURES = 22
"""Numbers of a pair of parts (`part_field_kernels.py`): how close it is on the source, narrowly and widely (2); both times where the
first part should go against the second, a little out of it where it is inside on the source (6); where they are closest, from the first
part's joint and from the hips (6); by how much the first has sunk in, in all and at most (2); which way is out, and where (6)."""
QUARTERS = 4
"""Directions in which a bone's girth is measured."""
_TRUNK = ("upperChest", "chest", "spine", "hips")
JOINTS: dict[str, tuple[str, ...]] = {
    "spine": ("hips",), "chest": _TRUNK, "neck": ("neck", "head"),
    "leftShoulder": ("leftShoulder", *_TRUNK), "rightShoulder": ("rightShoulder", *_TRUNK),
}  # fmt: skip
"""Whose axes a bone of the sensors has, where that is no joint of its name; the first that a body has."""


def _pairs() -> tuple[tuple[str, str], ...]:
    found = []
    for side, other in zip(SIDES, SIDES[::-1]):
        trunk = ("spine", "chest", "neck", "head")
        arm = tuple(f"{other}{part}" for part in ("Shoulder", "UpperArm", "LowerArm", "Hand"))
        thighs, shins = ("leftUpperLeg", "rightUpperLeg"), ("leftLowerLeg", "rightLowerLeg")
        found += [(f"{side}UpperArm", part) for part in (*trunk, *arm, *thighs)]
        found += [(f"{side}LowerArm", part) for part in (*trunk, *arm, *thighs, *shins)]
        found += [(f"{side}Hand", part) for part in (*trunk, *arm, *thighs, *shins, f"{side}UpperArm", f"{side}Shoulder")]
        found += [(f"{side}UpperLeg", part) for part in ("spine", "chest")]
        legs = ("UpperLeg", "LowerLeg", "Foot")
        found += [(f"{side}{own}", f"{other}{part}") for own in legs for part in legs]
    return tuple(found)


PAIRS = _pairs()
"""Parts that are compared: the first is the one that moves, in most poses."""
PAIR_BONES = np.array([[BONES.index(part) for part in pair] for pair in PAIRS])


@dataclass(frozen=True, eq=False)
class PartField:
    """Two bodies with their sensors; `prepare_part_field` makes one."""

    skinners: tuple[SensorSkinner, SensorSkinner]
    """Of source and target."""
    used: Int[Array, "used"]
    """Sensors that are on both bodies, by bone."""
    starts: Int[Array, "bones_1"]
    """Where the run of each bone begins among those used."""
    joints: Int[Array, "bones"]
    """The target's joint of each bone."""
    upright: Float[Array, "bones 4"]
    """Rotation from a body's own axes to each of these joints, in the common stance."""
    heights: Float[Array, "2"]
    girths: Float[Array, "figures"]
    """Lengths and girths of the bones of both bodies, in shares of their heights."""

    def source(
        self, world_rotations: Float[Array, "frames joints 4"], world_positions: Float[Array, "frames joints 3"]
    ) -> tuple[Float[Array, "frames used 3"], Float[Array, "frames used 3 3"]]:
        """The source's posed sensors, which do not change from look to look."""
        return self._posed(0, world_rotations, world_positions)

    def target(
        self, world_rotations: Float[Array, "frames joints 4"], world_positions: Float[Array, "frames joints 3"]
    ) -> tuple[Float[Array, "frames used 3"], Float[Array, "frames used 3 3"]]:
        """The target's posed sensors."""
        return self._posed(1, world_rotations, world_positions)

    def _posed(self, body: int, world_rotations: Array, world_positions: Array) -> tuple[Array, Array]:
        places, frames = self.skinners[body].pose(world_rotations, world_positions)
        return np.take(places, self.used, axis=1), np.take(frames, self.used, axis=1)  # contiguous, as compiled loops want them

    def axes(self, world_rotations: Float[Array, "frames joints 4"]) -> Float[Array, "frames bones 4"]:
        """World rotations of the target's bones, from the body's own axes in the common stance."""
        return rot.multiply(world_rotations[:, self.joints], rot.inverse(self.upright))

    def figures(
        self,
        source: tuple[Float[Array, "frames used 3"], Float[Array, "frames used 3 3"]],
        target: tuple[Float[Array, "frames used 3"], Float[Array, "frames used 3 3"]],
        world_rotations: Float[Array, "frames joints 4"],
        world_positions: Float[Array, "frames joints 3"],
    ) -> Float[Array, "frames figures"]:
        """What a network sees of frames of the target beside the source's: the figures of all pairs of parts, the turns of bones
        against the hips (two columns of each matrix), where up is, and girths."""
        from retarget.contact.part_field_kernels import part_figures

        axes = self.axes(world_rotations)
        hips = rot.to_matrix(axes[:, 0])
        roots = np.ascontiguousarray(np.concatenate([hips, world_positions[:, self.joints[0], :, None]], axis=2))
        out = np.zeros((len(axes), len(PAIRS), FIGURES), np.float32)
        part_figures(
            *source, *target, self.starts, PAIR_BONES, self.heights, roots,
            np.ascontiguousarray(world_positions[:, self.joints]), out,
        )  # fmt: skip
        turns = rot.to_matrix(rot.multiply(rot.inverse(axes[:, :1]), axes[:, 1:]))[..., :2]
        count = len(axes)
        rest = np.broadcast_to(self.girths, (count, len(self.girths)))
        return np.concatenate([out.reshape(count, -1), turns.reshape(count, -1), hips[:, 1], rest], axis=1, dtype=np.float32)


def field_sensors(character: Character, humanoid: Humanoid) -> Sensors:
    """The sensors of a body that are compared. Raises `RetargetError` for a body without a surface, a head or a whole limb."""
    return place_sensors(character, humanoid, dense_layout(COUNT))


def prepare_part_field(source: Sensors, target: Sensors, humanoid: Humanoid, heights: tuple[float, float]) -> PartField:
    """Two bodies by their `field_sensors`; the target's joints, and the heights of both (metres)."""
    layout, used = source.layout, np.flatnonzero(source.valid & target.valid)
    joints = {name: next(each for each in JOINTS.get(name, (name,)) if each in humanoid.joints) for name in BONES}
    own = np.array([humanoid.joints[joint] for joint in joints.values()])
    return PartField(
        (prepare_sensor_skinning(source), prepare_sensor_skinning(target)), used,
        np.searchsorted(layout.bones[used], np.arange(len(BONES) + 1)), own,
        stance_axes(target.character.skeleton, humanoid, target.stance)[own],
        np.array(heights, dtype=np.float64), np.concatenate([_girths(source), _girths(target)]),
    )  # fmt: skip


def stance_axes(skeleton: Skeleton, humanoid: Humanoid, stance: Stance) -> Float[Array, "joints 4"]:
    """World rotations of a body's joints in the common stance, seen from the body's own axes."""
    rotations, _ = rest_pose(skeleton)
    turned = {humanoid.joints[name]: turn for name, turn in stance.turns.items()}
    delta = np.empty((len(skeleton), 4))
    for joint, parent in enumerate(skeleton.parents):
        delta[joint] = turned.get(joint, delta[parent] if parent >= 0 else rot.IDENTITY)
    return rot.multiply(rot.multiply(rot.inverse(stance.world_from_body), delta), rotations)


def _girths(sensors: Sensors) -> Float[Array, "figures"]:
    """Of every bone its length, and how far the skin is from it in four directions; shares of the height."""
    stance, layout, found = sensors.stance, sensors.layout, []
    places = surface_points(stance.vertices, stance.faces, sensors.faces, sensors.barycentrics)
    quarter = np.round(layout.around / (2 * np.pi / QUARTERS)).astype(int) % QUARTERS
    for number, bone in enumerate(sensor_bones(stance).values()):
        found.append(float(np.linalg.norm(bone.child - bone.parent)))
        away = places - bone.parent
        away = np.linalg.norm(away - (away @ bone.axes[0])[:, None] * bone.axes[0], axis=1)
        own = sensors.valid & (layout.bones == number) & (layout.along >= 0) & (layout.along < 1)
        for each in range(QUARTERS):
            here = own & (quarter == each)
            found.append(float(away[here].mean()) if here.any() else 0.0)
    return np.array(found, dtype=np.float32) / stance.height
