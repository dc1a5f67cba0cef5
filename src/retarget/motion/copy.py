"""Copy the pose of one body to another: anatomical frames carried over in world space, chains shared by arc length.

`plan_copy` does all matching once; `copy_pose` then is a handful of vectorised quaternion products a clip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import levels, rest_pose
from retarget.character import Skeleton
from retarget.contact.support import leg_length, stand_up
from retarget.motion.align import Actor, same_skeleton
from retarget.motion.anatomy import LIMBS, joint_from_frame, trunk_frame
from retarget.motion.chains import Chain, share, trunk_and_neck

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class CopyPlan:
    """Everything about a pair of bodies that does not change over time."""

    target: Skeleton
    driven: Int[Array, "driven"]
    """Target joints whose world rotation comes from the source."""
    first: Int[Array, "driven"]
    """Source joint each of them follows."""
    second: Int[Array, "driven"]
    """Source joint it is blended with (chains of different counts); the same as `first` where there is none."""
    weight: Float[Array, "driven"]
    """Share of the second."""
    first_frame: Float[Array, "driven 4"]
    """Joint-from-frame rotation of the first source joint."""
    second_frame: Float[Array, "driven 4"]
    frame_joint: Float[Array, "driven 4"]
    """Frame-from-joint rotation of the target joint."""
    twists: tuple[tuple[int, int, int, float], ...]
    """(twist joint, segment joint, end joint, share) on the target."""
    source_sockets: Int[Array, "2"]
    """Both hip joints of the source, whose middle carries the root path."""
    target_sockets: Int[Array, "2"]
    target_hips: int
    scale: float
    """Target leg length over source leg length."""
    source_hip_height: float
    """Height of the hip sockets over the soles on straight legs, source."""
    target_hip_height: float
    unmatched: tuple[str, ...]
    """Canonical joints the target has and the source lacks; they rest."""


def plan_copy(
    source: Actor, target: Actor, source_sole: float, target_sole: float, one_rig: bool = False
) -> CopyPlan:
    """Match the joints of two bodies. The soles are the heights of the lowest support point at rest, metres. With `one_rig`
    bodies on the same rig (`are_one_rig`) get equal rotations; without it, and on any other, limbs point the same way."""
    # What the motion shows of the source's feet means nothing to a target of the same skeleton: both rest alike.
    soles = {} if same_skeleton(source.skeleton, target.skeleton) else source.soles
    K_source = joint_from_frame(source.skeleton, source.humanoid, soles)
    K_target = joint_from_frame(target.skeleton, target.humanoid)
    if one_rig and are_one_rig(source.skeleton, target.skeleton):
        rows = [(joint, joint, joint, 0.0, *(rot.IDENTITY,) * 3) for joint in range(len(target.skeleton))]
    else:
        rows = _chain_rows(source, target, K_source)
        handled = {row[0] for row in rows}
        for name, joint in target.humanoid.joints.items():
            if name in source.humanoid.joints and joint not in handled:
                origin = source.humanoid.joints[name]
                rows.append((joint, origin, origin, 0.0, K_source[name], K_source[name], K_target[name]))
        rows.sort(key=lambda row: row[0])
    known = source.humanoid.joints
    driven = {row[0] for row in rows}
    return CopyPlan(
        target.skeleton,
        *(np.array([row[i] for row in rows]) for i in range(6)),
        frame_joint=rot.inverse(np.array([row[6] for row in rows])),
        twists=() if len(driven) == len(target.skeleton) else _twist_shares(target),
        source_sockets=np.array([known["leftUpperLeg"], known["rightUpperLeg"]]),
        target_sockets=np.array([target.humanoid.joints[f"{side}UpperLeg"] for side in ("left", "right")]),
        target_hips=target.humanoid.joints["hips"],
        scale=leg_length(target.skeleton, target.humanoid) / leg_length(source.skeleton, source.humanoid),
        source_hip_height=_straight_hip_height(source, source_sole),
        target_hip_height=_straight_hip_height(target, target_sole),
        unmatched=tuple(name for name, joint in target.humanoid.joints.items() if joint not in driven),
    )


def are_one_rig(a: Skeleton, b: Skeleton) -> bool:
    """Whether two skeletons differ in the lengths and directions of their bones alone: bodies of one parametric model."""
    return a.names == b.names and np.array_equal(a.parents, b.parents) and np.allclose(a.rest_rotations, b.rest_rotations)


def _chain_rows(source: Actor, target: Actor, K_source: dict[str, Array]) -> list[tuple]:
    """Hips, spine, neck and head: each target joint takes the source's rotation at its own place along the chain."""
    trunk = {actor: _trunk_joint_from_frame(actor) for actor in (source, target)}
    rows = {}
    for chain_source, chain_target in zip(_chains(source), _chains(target)):
        for i, (joint, place) in enumerate(zip(chain_target.joints, chain_target.place)):
            if joint in rows:
                continue
            first, second, weight = (chain_source.joints[0],) * 2 + (0.0,) if i == 0 else share(place, chain_source)
            rows[joint] = (
                joint,
                first,
                second,
                weight,
                trunk[source][first],
                trunk[source][second],
                trunk[target][joint],
            )
    return list(rows.values())


def _chains(actor: Actor) -> tuple[Chain, Chain]:
    return trunk_and_neck(actor.skeleton, actor.humanoid)


def _trunk_joint_from_frame(actor: Actor) -> Float[Array, "joints 4"]:
    """The trunk's frame seen from every joint: spine joints need no canonical name to take part in a chain."""
    rotations, _ = rest_pose(actor.skeleton)
    return rot.multiply(rot.inverse(rotations), trunk_frame(actor.humanoid.axes))


def _straight_hip_height(actor: Actor, sole: float) -> float:
    """Leg length plus what lies below the ankle at rest."""
    _, rest = rest_pose(actor.skeleton)
    rest = rot.rotate(stand_up(actor.humanoid), rest)
    ankle = np.mean([rest[actor.humanoid.joints[f"{side}Foot"], 1] for side in ("left", "right")])
    return leg_length(actor.skeleton, actor.humanoid) + float(ankle) - sole


def _twist_shares(target: Actor) -> tuple[tuple[int, int, int, float], ...]:
    """Twist joints of the target's forearms and shins, each with its place along the segment."""
    _, rest = rest_pose(target.skeleton)
    rows = []
    for joint, segment in target.humanoid.twists.items():
        if segment not in LIMBS or "Lower" not in segment or LIMBS[segment] not in target.humanoid.joints:
            continue
        start, end = target.humanoid.joints[segment], target.humanoid.joints[LIMBS[segment]]
        along = rest[end] - rest[start]
        place = float(np.clip((rest[joint] - rest[start]) @ along / max(along @ along, 1e-12), 0, 1))
        if end not in _below(target.skeleton, joint):
            rows.append((joint, start, end, max(place, 0.0)))
    return tuple(rows)


def _below(skeleton: Skeleton, joint: int) -> set[int]:
    below = {joint}
    for child in range(joint + 1, len(skeleton)):
        if skeleton.parents[child] in below:
            below.add(child)
    return below


def copy_rotations(
    plan: CopyPlan, source_rotations: Float[Array, "frames joints 4"]
) -> Float[Array, "frames targets 4"]:
    """World rotations of all target joints from the source's world rotations."""
    frames = rot.multiply(source_rotations[:, plan.first], plan.first_frame)
    blended = np.flatnonzero(plan.weight > 0)
    if len(blended):
        other = rot.multiply(source_rotations[:, plan.second[blended]], plan.second_frame[blended])
        frames[:, blended] = rot.slerp(frames[:, blended], other, plan.weight[blended])
    skeleton = plan.target
    world = np.empty((len(source_rotations), len(skeleton), 4))
    world[:, plan.driven] = rot.multiply(frames, plan.frame_joint)
    complete(plan, world)
    return world


def complete(plan: CopyPlan, world: Float[Array, "frames joints 4"]) -> None:
    """Fill in, in place, the joints that nothing drives: each keeps its rest rotation in its parent, and twist joints
    take their share of the twist along their segment."""
    skeleton = plan.target
    free = np.ones(len(skeleton), dtype=bool)
    free[plan.driven] = False
    for level in levels(skeleton.parents):
        resting = level[free[level]]
        if len(resting) == 0:
            continue
        if skeleton.parents[resting[0]] < 0:
            world[:, resting] = skeleton.rest_rotations[resting]
        else:
            world[:, resting] = rot.multiply(world[:, skeleton.parents[resting]], skeleton.rest_rotations[resting])
    for joint, segment, end, part in plan.twists:
        _share_twist(skeleton, world, joint, segment, end, part)


def _share_twist(skeleton: Skeleton, world: Array, joint: int, segment: int, end: int, part: float) -> None:
    """Turn a twist joint by its share of the twist between the segment and the joint at its end."""
    at_rest, rest = rest_pose(skeleton)
    axis = rot.unit(rot.rotate(rot.inverse(at_rest[segment]), rest[end] - rest[segment]))
    resting = rot.multiply(rot.inverse(at_rest[segment]), at_rest[end])
    local = rot.multiply(rot.multiply(rot.inverse(world[:, segment]), world[:, end]), rot.inverse(resting))
    twist = rot.twist_about(local, axis)
    own = rot.multiply(rot.inverse(at_rest[segment]), at_rest[joint])
    world[:, joint] = rot.multiply(rot.multiply(world[:, segment], rot.slerp(rot.IDENTITY, twist, part)), own)


def positions_of(
    skeleton: Skeleton,
    world_rotations: Float[Array, "frames joints 4"],
    hips: int,
    hips_positions: Float[Array, "frames 3"],
) -> Float[Array, "frames joints 3"]:
    """World positions of all joints when the hips are put where they should be and what lies above them rests."""
    positions = np.empty(world_rotations.shape[:-1] + (3,))
    for level in levels(skeleton.parents):
        above = skeleton.parents[level]
        if above[0] < 0:
            positions[:, level] = skeleton.offsets[level]
        else:
            positions[:, level] = positions[:, above] + rot.rotate(world_rotations[:, above], skeleton.offsets[level])
        if hips in level:
            positions[:, hips] = hips_positions
    return positions
