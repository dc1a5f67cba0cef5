"""Deformation transfer as a method: the baseline for bodies of one mesh. The surface is all of `motion.deformation_transfer`
(Sumner and Popović 2004); the skeletal motion is fitted to it, for whoever needs one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import forward, local_positions, world_pose
from retarget.body.skinning import Skinner, prepare_skinning, rest_vertices, skin_motion
from retarget.character import MeshMotion, Motion, Pose
from retarget.errors import RetargetError
from retarget.methods.base import Method, Result, Retargeter
from retarget.motion.align import Actor, same_skeleton
from retarget.motion.deformation_transfer import DeformationTransfer as SurfaceTransfer
from retarget.motion.deformation_transfer import prepare_deformation_transfer
from retarget.motion.fit import fit_motion
from retarget.motion.joint_frames import JointFrames, prepare_frames

Array = np.ndarray


@dataclass(frozen=True)
class DeformationTransfer(Method):
    """Every triangle of the target stretched and turned as the same triangle of the source; no contacts, no ground.

    Needs bodies with the same faces in the same rest pose (a rest pose that differs shows as a difference in every frame).
    Joint lengths of the skeletal motion are the target's own, so that its skin is not quite the surface; `stats` tells.
    """

    laws: ClassVar[frozenset[str]] = frozenset(
        {
            "same body, same motion",
            "scaling both bodies scales the path",
            "equal results for equal input",
            "stepping equals the clip",
        }
    )
    """Not those about other rest poses and facings, which show in every frame, nor permuted vertices: other faces are refused.
    The embedded bodies' meshes are not mirror images of themselves vertex for vertex."""

    def prepare(self, source: Actor, target: Actor) -> PreparedDeformationTransfer:
        """Match the bodies. Raises `RetargetError` for bodies without a surface, with other faces, or whose skin tells of no
        joint."""
        for actor, which in ((source, "source"), (target, "target")):
            if actor.character.skin is None:
                raise RetargetError(f"the {which} has no surface; deformation transfer needs one (use copy-rotations)")
        faces, others = source.character.mesh.faces, target.character.mesh.faces
        if not np.array_equal(faces, others):
            raise RetargetError(
                f"deformation transfer needs bodies with the same faces; the source has {len(faces)} over "
                f"{len(source.character.mesh.vertices)} vertices, the target {len(others)} over "
                f"{len(target.character.mesh.vertices)}{', in another order' * (len(faces) == len(others))} (use shape-transfer)"
            )
        rest = (rest_vertices(actor.character) for actor in (source, target))
        transfer = prepare_deformation_transfer(*rest, others)
        return PreparedDeformationTransfer(
            source, target, prepare_skinning(source.character), transfer, prepare_frames(target.character)
        )


@dataclass(frozen=True, eq=False)
class PreparedDeformationTransfer(Retargeter):
    """A matched pair of bodies."""

    source: Actor
    target: Actor
    skinning: Skinner
    """Of the source."""
    transfer: SurfaceTransfer
    frames: JointFrames
    """Of the target."""

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip. Raises `RetargetError` for a motion of another skeleton or without frames."""
        if not same_skeleton(motion.skeleton, self.source.skeleton):
            raise RetargetError("the motion belongs to another skeleton than the one that was prepared")
        if len(motion) == 0:
            raise RetargetError(f"the clip {motion.name!r} has no frames")
        vertices = self.transfer.frames(self.skinning.vertices(*world_pose(motion)))
        made = self._fitted(vertices, motion.fps, motion.name)
        away = 1000 * np.linalg.norm(skin_motion(self.target.character, made) - vertices, axis=-1)
        stats = {
            "scale": self.transfer.scale,
            "skin_rms_mm": round(float(np.sqrt((away**2).mean())), 3),
            "skin_worst_mm": round(float(away.max()), 3),
        }
        mesh = replace(self.target.character.mesh, vertices=vertices[0])
        surface = MeshMotion(mesh, vertices.astype(np.float32), motion.fps, motion.name)
        return Result(self.target, made, stats=stats, surface=surface)

    def step(self, pose: Pose) -> Pose:
        """The pose of one frame; nothing is kept from frame to frame."""
        skeleton = self.source.skeleton
        if len(pose.rotations) != len(skeleton) or max(pose.moved) >= len(skeleton):
            raise RetargetError(f"the pose has {len(pose.rotations)} joints, the prepared source {len(skeleton)}")
        local = local_positions(skeleton, pose.translations[None], pose.moved)
        posed = self.skinning.vertices(*forward(skeleton.parents, pose.rotations[None], local))
        return self._fitted(self.transfer.frames(posed)).pose(0)

    def _fitted(self, vertices: Float[Array, "frames vertices 3"], fps: float = 30.0, name: str = "") -> Motion:
        """The target's joints on its surface."""
        return fit_motion(self.frames, vertices, fps, name, self._leading())

    def _leading(self) -> list[int]:
        """Joints that say where the root is: the trunk's and the legs', of which none hangs far from it."""
        wanted = ("hips", "spine", "leftUpperLeg", "rightUpperLeg")
        return [self.target.humanoid.joints[name] for name in wanted if name in self.target.humanoid.joints]
