"""The points a body stands on: heels and balls of the feet, palms; fixed to their joints, measured at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Skeleton
from retarget.correspond.joints import Humanoid

Array = np.ndarray

# Shares of the leg length, measured on the embedded human; used where a body has no surface to measure.
SOLE_BELOW_TOE_JOINT = 0.02
HEEL_BEHIND_ANKLE = 0.055
FOOT_LENGTH = 0.16
STANDS = np.cos(np.radians(45))
"""A body whose up direction is within 45 degrees of the vertical stands at rest."""

BODY_JOINTS = ("hips", "head") + tuple(
    f"{side}{part}" for side in ("left", "right") for part in ("LowerLeg", "LowerArm", "UpperArm")
)
"""What a body lies, sits, kneels or crawls on, besides its feet and hands."""


@dataclass(frozen=True, eq=False)
class SupportLimb:
    """A leg or an arm that can carry the body."""

    name: str
    """'leftLeg', 'rightLeg', 'leftArm' or 'rightArm'."""
    joints: tuple[int, int, int]
    """Hip, knee, ankle, or shoulder, elbow, wrist."""
    points: Float[Array, "points 3"]
    """Where it touches the ground, in the frame of the last joint (metres): heel and ball of a foot, palm of a hand."""


def leg_length(skeleton: Skeleton, humanoid: Humanoid) -> float:
    """Thigh and shin, metres; the mean of both sides. The length that paths and thresholds scale with."""
    _, rest = rest_pose(skeleton)
    place = {name: rest[joint] for name, joint in humanoid.joints.items()}
    return float(
        np.mean(
            [
                np.linalg.norm(place[f"{side}LowerLeg"] - place[f"{side}UpperLeg"])
                + np.linalg.norm(place[f"{side}Foot"] - place[f"{side}LowerLeg"])
                for side in ("left", "right")
            ]
        )
    )


def support_limbs(character: Character, humanoid: Humanoid) -> tuple[SupportLimb, ...]:
    """Both legs, then both arms. The body must be in metres with +Y up; where its rest pose lies, it is stood up."""
    skeleton, joints = character.skeleton, humanoid.joints
    rotations, rest = rest_pose(skeleton)
    surface = rest_vertices(character) if character.skin is not None else None
    upright = stand_up(humanoid)
    rotations, rest = rot.multiply(upright, rotations), rot.rotate(upright, rest)
    surface = None if surface is None else rot.rotate(upright, surface)
    humanoid = replace(humanoid, axes=rot.rotate(upright, humanoid.axes))
    limbs = []
    for side in ("left", "right"):
        chain = tuple(joints[f"{side}{part}"] for part in ("UpperLeg", "LowerLeg", "Foot"))
        ankle = chain[2]
        world = _foot_points(character, humanoid, side, rest, surface)
        limbs.append(SupportLimb(f"{side}Leg", chain, rot.rotate(rot.inverse(rotations[ankle]), world - rest[ankle])))
    for side in ("left", "right"):
        chain = tuple(joints[f"{side}{part}"] for part in ("UpperArm", "LowerArm", "Hand"))
        wrist = chain[2]
        knuckle = joints.get(f"{side}MiddleProximal")
        forearm = rest[wrist] - rest[chain[1]]
        palm = rest[knuckle] if knuckle is not None else rest[wrist] + 0.35 * forearm
        limbs.append(
            SupportLimb(f"{side}Arm", chain, rot.rotate(rot.inverse(rotations[wrist]), palm - rest[wrist])[None])
        )
    return tuple(limbs)


def stand_up(humanoid: Humanoid) -> Float[Array, "4"]:
    """The turn that stands up a body whose rest pose lies; none where it stands, whatever its lean."""
    up = humanoid.axes[1]
    return rot.IDENTITY if up[1] > STANDS else rot.swing_between(up, np.array([0.0, 1.0, 0.0]))


def _foot_points(
    character: Character, humanoid: Humanoid, side: str, rest: Float[Array, "joints 3"], surface: Array | None
) -> Float[Array, "2 3"]:
    """World places of heel and ball at rest, on the sole."""
    skeleton, joints = character.skeleton, humanoid.joints
    leg = leg_length(skeleton, humanoid)
    ankle = rest[joints[f"{side}Foot"]]
    own = descendants(skeleton, joints[f"{side}Foot"])
    forward = humanoid.axes[2] * [1, 0, 1]
    toe_joint = joints.get(f"{side}Toes")
    along = (rest[toe_joint] - ankle if toe_joint is not None else forward) * [1, 0, 1]
    heading = rot.unit(along if np.linalg.norm(along) > 0.02 * leg and along @ forward > 0 else forward)
    vertices = None
    if surface is not None:
        vertices = surface[np.isin(_leading_joint(character), own)]
    if vertices is not None and len(vertices) >= 8:
        sole = float(np.percentile(vertices[:, 1], 1))
        low = vertices[vertices[:, 1] < sole + 0.25 * (ankle[1] - sole)] if ankle[1] > sole else vertices
        reach = (low - ankle) @ heading
        back = float(reach.min()) * 0.8
        front = float((rest[toe_joint] - ankle) @ heading) if toe_joint is not None else float(reach.max()) * 0.6
    else:
        ends = [rest[joint][1] for joint in own]
        sole = min(ends) - SOLE_BELOW_TOE_JOINT * leg
        back = -HEEL_BEHIND_ANKLE * leg
        front = float((rest[toe_joint] - ankle) @ heading) if toe_joint is not None else 0.75 * FOOT_LENGTH * leg
    points = np.stack([ankle + back * heading, ankle + max(front, 0.05 * leg) * heading])
    points[:, 1] = sole
    return points


def descendants(skeleton: Skeleton, joint: int) -> list[int]:
    """The joint and all below it."""
    below = [joint]
    for child in range(joint + 1, len(skeleton)):
        if skeleton.parents[child] in below:
            below.append(child)
    return below


def _leading_joint(character: Character) -> Array:
    """The joint with the largest weight, for each vertex."""
    skin = character.skin
    lead = skin.weights.argmax(axis=1)
    return skin.joints[np.take_along_axis(skin.columns, lead[:, None], axis=1)[:, 0]]


def support_points(
    limbs: tuple[SupportLimb, ...],
    world_rotations: Float[Array, "frames joints 4"],
    world_positions: Float[Array, "frames joints 3"],
) -> list[Float[Array, "frames points 3"]]:
    """World trajectories of each limb's points."""
    return [
        world_positions[:, limb.joints[2], None] + rot.rotate(world_rotations[:, limb.joints[2], None], limb.points)
        for limb in limbs
    ]
