"""The target's shape in the source's pose, with no regard to what touches: the first half of shape transfer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_positions
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.character import Pose
from retarget.contact.carried import CarriedVertices, carry_vertices
from retarget.contact.collide import Collider
from retarget.contact.part_volumes import PartVolumes, prepare_volumes
from retarget.errors import RetargetError
from retarget.geometry.isometric import IsometricShape, prepare_isometric
from retarget.geometry.local_offsets import LocalOffsets, prepare_offsets
from retarget.motion.align import Actor
from retarget.motion.copy_clip import CopySettings, prepare_copier
from retarget.motion.joint_frames import JointFrames, prepare_frames
from retarget.motion.touch.goals import FrameSurface

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class PosedShape:
    """The target's surface on one frame, and its joints there."""

    surface: FrameSurface
    turned: Float[Array, "joints 4"]
    """World rotations of the joints."""

    def single(self) -> PosedShape:
        """The same with its vertices in single precision."""
        return replace(self, surface=replace(self.surface, vertices=self.surface.vertices.astype(np.float32)))


@dataclass(frozen=True, eq=False)
class ShapeCarrier:
    """A matched pair of surfaces; `prepare_shape` makes one."""

    isometric: IsometricShape
    offsets: LocalOffsets
    volumes: PartVolumes | None
    frames: JointFrames
    joints: Array
    """Joint of every column of the target's skin."""
    onto_source: CarriedVertices
    """Where the target's vertices lie on the source."""

    def posed(self, source: Float[Array, "vertices 3"]) -> PosedShape:
        """The target's shape in the pose of the source's vertices (metres); it stands nowhere in particular."""
        vertices = self.isometric.posed(self._on_target(source))
        if self.volumes is not None:
            vertices = self.volumes.kept(vertices)
        world, places = self.frames.of(vertices)
        turn = rot.to_matrix(rot.inverse(world))
        binds = np.empty((len(self.joints), 3, 4))
        binds[:, :, :3] = turn[self.joints]
        binds[:, :, 3] = -np.einsum("jab,jb->ja", turn, places)[self.joints]
        return PosedShape(FrameSurface(vertices, binds), world)

    def _on_target(self, source: Float[Array, "vertices 3"]) -> Float[Array, "others 3"]:
        return on_target(self.onto_source, np.ascontiguousarray(source, dtype=np.float64), len(self.isometric.target))


def on_target(onto_source: CarriedVertices, source: Float[Array, "vertices 3"], count: int) -> Float[Array, "others 3"]:
    """Places on a surface (metres) of the vertices of another."""
    if onto_source.by_sensors is None:
        return source
    return onto_source.places(source[None], np.zeros(count, dtype=np.int64), np.arange(count)[:, None])[:, 0]


def prepare_shape(source: Actor, target: Actor, collider: Collider, keep_volumes: bool) -> ShapeCarrier:
    """Match two surfaces. `collider` is the target's. Raises `RetargetError` for bodies without a surface, or that share too
    little of it."""
    if source.character.skin is None:
        raise RetargetError("the source has no surface; shape transfer gives the target's shape to the source's")
    onto = carry_vertices(target.character, target.humanoid, source.character, source.humanoid)
    own = rest_vertices(target.character)
    rest = _as_target_rests(source, target)
    known = onto.trusted(np.arange(len(own)))
    faces = target.character.mesh.faces
    isometric = prepare_isometric(on_target(onto, rest, len(own)), own, faces, collider.parts.welded, known)
    volumes = prepare_volumes(collider, own, faces) if keep_volumes else None
    offsets = prepare_offsets(own, faces, collider.parts.welded)
    return ShapeCarrier(
        isometric, offsets, volumes, prepare_frames(target.character), target.character.skin.joints, onto
    )


def _as_target_rests(source: Actor, target: Actor) -> Float[Array, "vertices 3"]:
    """The source's vertices in the pose in which the target rests (metres): its own rest pose may be another, and turns of its
    skin are to be counted from there."""
    skeleton = target.skeleton
    back = prepare_copier(CopySettings(foot_lock=False, limits=False), target, source)
    pose = back.step(Pose(skeleton.rest_rotations, skeleton.offsets[:1]))
    local = local_positions(source.skeleton, pose.translations[None], pose.moved)
    world = forward(source.skeleton.parents, pose.rotations[None], local)
    return prepare_skinning(source.character).vertices(*world)[0].astype(np.float64)
