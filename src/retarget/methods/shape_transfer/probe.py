"""Whether two surfaces agree well enough for the one's shape to be put into the other's pose."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions, local_rotations, rest_pose, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Pose
from retarget.methods.shape_transfer.shape import ShapeCarrier
from retarget.motion.align import Actor
from retarget.motion.copy_clip import Copier
from retarget.motion.touch.equations import PoseEquations
from retarget.motion.touch.mend import one_frame

Array = np.ndarray

BENDS: dict[str, tuple[int, float]] = {
    "spine": (0, 0.3), "neck": (0, 0.3), "leftUpperArm": (2, -0.7), "rightUpperArm": (2, 0.7), "leftLowerArm": (1, -1.2),
    "rightLowerArm": (1, 1.2), "leftUpperLeg": (0, -1.0), "rightUpperLeg": (0, -0.4), "leftLowerLeg": (0, 1.4),
    "rightLowerLeg": (0, 0.9),
}  # fmt: skip
"""Turns of the pose that is tried: axis of the body (to its left, up, forward) and radians."""
MOST, OFTEN = 0.06, 99.0
"""Share of the height that the surface may lie from the target's own skin in that pose, at this percentile of its vertices.
Bodies of one mesh lie within .02 to .04; a doll of loose pieces, matched piece by piece, is .1 to .4 off."""


def surfaces_agree(shape: ShapeCarrier, copier: Copier, equations: PoseEquations) -> tuple[bool, float]:
    """Put the source into a pose with bent limbs, give it the target's shape, and compare with what the target's skin makes
    of the copied pose. Returns whether that is near enough, and how far it is as a share of the height."""
    pose = bent(copier.source)
    posed = prepare_skinning(copier.source.character).vertices(*world_pose(one_frame(pose, copier.source.skeleton)))[0]
    found = shape.posed(posed)
    frame = one_frame(copier.step(pose, found.turned), copier.target.skeleton)
    offsets = local_positions(frame.skeleton, frame.translations, frame.moved)[0]
    made = equations.pose(frame.rotations[0], offsets, np.zeros(equations.size), found.surface).vertices
    copied = one_frame(copier.step(pose), copier.target.skeleton)
    skin = prepare_skinning(copier.target.character).vertices(*world_pose(copied))[0]
    body = equations.collider.parts.body_vertices
    away = float(np.percentile(np.linalg.norm(made - skin, axis=1)[body], OFTEN)) / copier.target.height
    return bool(away <= MOST), away


def bent(actor: Actor) -> Pose:
    """The body at rest with `BENDS`."""
    skeleton, turn = actor.skeleton, np.tile(rot.IDENTITY, (len(actor.skeleton), 1))
    world, _ = rest_pose(skeleton)
    bends = {actor.humanoid.joints[name]: each for name, each in BENDS.items() if name in actor.humanoid.joints}
    axes: Float[Array, "3 3"] = actor.humanoid.axes
    for joint, above in enumerate(skeleton.parents.tolist()):
        own = turn[above] if above >= 0 else rot.IDENTITY
        if joint in bends:
            axis, angle = bends[joint]
            own = rot.multiply(own, rot.from_rotation_vector(angle * axes[axis]))
        turn[joint] = own
    return Pose(local_rotations(skeleton.parents, rot.multiply(turn, world)), skeleton.offsets[:1])
