"""Embedded bodies as the reference networks of interaction take them. Functions that give tensors need torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.body.human import human, human_model
from retarget.casting import cast
from retarget.contact.interaction_field import PARTS
from retarget.contact.sensor_bones import BONES
from retarget.contact.sensors import Layout, Sensors, place_sensors
from retarget.methods.scan.features import JOINTS
from retarget.motion.align import Actor

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class ReferenceBody:
    """A body's sensors, and the skin weights of each on the 22 joints."""

    sensors: Sensors
    offsets: Float[Array, "joints 3"]
    weights: Float[Array, "sensors joints"]
    boxes: Float[Array, "joints 3"]
    """Edges of the box around the skin that follows each joint the most, at rest, metres (R2ET's shape)."""
    normals: Float[Array, "planes 3"]
    """Outward, of the hull of the sensors on trunk and head at rest; as many as there are planes at most, the last repeated."""
    levels: Float[Array, "planes"]
    """How far each plane is from the chest's rest place."""


PLANES = 200
CHEST = 2
"""The embedded human's joint that the hull goes with."""


def reference_body(shape: Mapping[str, str | float], layout: Layout) -> ReferenceBody:
    """An embedded body by its parameters."""
    return body_of(cast(human(**{name: float(value) for name, value in shape.items()})), layout)


def body_of(actor: Actor, layout: Layout) -> ReferenceBody:
    """An embedded human that is cast; fingers go with their hands."""
    sensors, skin = place_sensors(actor.character, actor.humanoid, layout), actor.character.skin
    owners = np.arange(len(actor.skeleton))
    for joint in range(JOINTS, len(owners)):
        owners[joint] = owners[human_model().parents[joint]]
    corners = actor.character.mesh.faces[sensors.faces]
    shares = sensors.barycentrics[:, :, None] * skin.weights[corners]
    weights = np.zeros((len(sensors), JOINTS))
    np.add.at(weights, (np.arange(len(sensors))[:, None, None], owners[skin.joints[skin.columns[corners]]]), shares)
    strongest = owners[skin.joints[np.take_along_axis(skin.columns, skin.weights.argmax(axis=1)[:, None], axis=1)[:, 0]]]
    boxes = np.zeros((JOINTS, 3))
    for joint in range(JOINTS):
        own = actor.character.mesh.vertices[strongest == joint]
        boxes[joint] = np.ptp(own, axis=0) if len(own) else 0.0
    return ReferenceBody(sensors, actor.skeleton.offsets[:JOINTS].copy(), weights, boxes, *_hull(sensors, actor))


def _hull(sensors: Sensors, actor: Actor) -> tuple[Array, Array]:
    from scipy.spatial import ConvexHull

    trunk = np.isin(sensors.layout.bones, [BONES.index(name) for name in (*PARTS["torso"], *PARTS["head"])])
    chest, above = actor.skeleton.offsets[CHEST].copy(), int(actor.skeleton.parents[CHEST])
    while above >= 0:
        chest, above = chest + actor.skeleton.offsets[above], int(actor.skeleton.parents[above])
    planes = ConvexHull(sensors.positions[trunk & sensors.valid] - chest).equations
    planes = planes[np.minimum(np.arange(PLANES), len(planes) - 1)]
    return planes[:, :3].copy(), -planes[:, 3]


def shapes_of(bodies: Sequence[ReferenceBody]):
    """Bodies as R2ET sees them, as tensors."""
    import torch

    from retarget.evaluate.reference.residual_network import Shapes

    return Shapes(*(torch.from_numpy(np.stack([getattr(body, name) for body in bodies]).astype(np.float32)) for name in ("boxes", "normals", "levels")))


def bodies_of(bodies: Sequence[ReferenceBody]):
    """Bodies as tensors."""
    import torch

    from retarget.evaluate.reference.interaction_networks import Bodies

    def stacked(values: list[Array]) -> torch.Tensor:
        return torch.from_numpy(np.stack(values).astype(np.float32))

    frames = stacked([body.sensors.frames for body in bodies])
    return Bodies(
        stacked([body.offsets for body in bodies]), stacked([body.sensors.positions for body in bodies]), frames,
        stacked([body.weights for body in bodies]), torch.from_numpy(np.stack([body.sensors.valid for body in bodies])),
    )  # fmt: skip
