"""Copying a pose: limbs point where the source's point, twist joints share, unmatched joints rest."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, poses, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, rest_pose, still_motion, world_pose
from retarget.casting import Hints, cast
from retarget.character import Character, Skeleton
from retarget.evaluate.cases import arms_turned, in_other_rest_pose, limb_directions
from retarget.evaluate.metrics import angle_error_degrees
from retarget.motion.copy import copy_rotations, plan_copy, positions_of
from retarget.retargeting import prepare


@pytest.mark.parametrize("preset", ["heavy", "child", "toddler"])
@pytest.mark.parametrize("rest", [0.0, -35.0, 40.0])
def test_limbs_point_where_the_sources_point(preset, rest):
    target = cast_by_names(in_other_rest_pose(body(preset), arms_turned(rest)))
    result = prepare(actor(), target, "copy-rotations", foot_lock=False)(walk()).motion
    directions = [
        limb_directions(each, world_pose(motion)[1]) for each, motion in ((actor(), walk()), (target, result))
    ]
    assert angle_error_degrees(*directions).max() < 1e-3


def test_a_joint_without_partner_rests_in_its_parent():
    names = {name: name for name in body().skeleton.names}
    fingerless = {
        name: name for name in names if not any(part in name for part in ("imal", "Distal", "Thumb", "Intermediate"))
    }
    source, target = cast_by_names(body(), fingerless), actor("heavy")
    plan = plan_copy(source, target, 0.0, 0.0)
    assert "leftIndexProximal" in plan.unmatched and "leftHand" not in plan.unmatched
    world = copy_rotations(plan, world_pose(walk())[0])
    parents, fingers = target.skeleton.parents, [target.humanoid.joints[name] for name in plan.unmatched]
    local = rot.multiply(rot.inverse(world[:, parents[fingers]]), world[:, fingers])
    assert rot.angle_between(local, target.skeleton.rest_rotations[fingers]).max() < 1e-9


@pytest.mark.parametrize("name", ["heavy", "toddler"])
def test_bodies_on_one_rig_get_equal_rotations_where_that_is_wanted(name):
    own = walk()
    plain, alike = (
        prepare(actor(), actor(name), "copy-rotations", foot_lock=False, steady=False, limits=False, one_rig=one_rig)(own).motion
        for one_rig in (False, True)
    )
    assert rot.angle_between(alike.rotations, own.rotations).max() < 1e-9
    assert rot.angle_between(plain.rotations, own.rotations).max() > np.radians(2), "else limbs point the same way"
    assert np.allclose(alike.translations, plain.translations, atol=0.02)


def test_on_another_rig_limbs_point_the_same_way_all_the_same():
    target = cast_by_names(in_other_rest_pose(body("heavy"), arms_turned(40.0)))
    made = [
        prepare(actor(), target, "copy-rotations", foot_lock=False, one_rig=one_rig)(walk()).motion.rotations
        for one_rig in (False, True)
    ]
    assert np.array_equal(*made)


def test_lengths_and_hip_heights():
    plan = plan_copy(actor(), actor("child"), 0.0, 0.0)
    again = plan_copy(actor("child"), actor(), 0.0, 0.0)
    assert plan.scale * again.scale == pytest.approx(1.0)
    assert plan.scale < 0.9
    _, at = rest_pose(actor().skeleton)
    sockets = at[[actor().humanoid.joints[f"{side}UpperLeg"] for side in ("left", "right")], 1].mean()
    assert plan.source_hip_height == pytest.approx(sockets, rel=0.01), "straight legs stand as high as the rest pose"


def with_twist_joint(character, share):
    """A joint in the left forearm, some way along, that no other joint hangs on."""
    skeleton = character.skeleton
    elbow, wrist = skeleton.index("leftLowerArm"), skeleton.index("leftHand")
    longer = Skeleton(
        (*skeleton.names, "leftForeArmTwist"),
        np.append(skeleton.parents, elbow),
        np.concatenate([skeleton.offsets, share * skeleton.offsets[wrist : wrist + 1]]),
        np.concatenate([skeleton.rest_rotations, rot.IDENTITY[None]]),
        skeleton.end_offsets,
    )
    return replace(character, skeleton=longer)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_a_twist_joint_takes_its_share_of_the_hands_twist(share):
    names = {name: name for name in body().skeleton.names}
    target = cast(with_twist_joint(body(), share), Hints(joints=names))
    joint = target.skeleton.index("leftForeArmTwist")
    assert target.humanoid.twists == {joint: "leftLowerArm"}
    plan = plan_copy(actor(), target, 0.0, 0.0)
    _, rest = rest_pose(body().skeleton)
    elbow, wrist = (body().skeleton.index(name) for name in ("leftLowerArm", "leftHand"))
    axis = rot.unit(rest[wrist] - rest[elbow])
    world = copy_rotations(plan, poses(1, {"leftHand": 0.8 * axis}))
    turned = rot.multiply(rot.inverse(world[0, elbow]), world[0, joint])
    assert np.allclose(rot.to_rotation_vector(turned), 0.8 * share * axis, atol=1e-6)


def test_positions_hang_on_the_hips():
    skeleton = body().skeleton
    still = still_motion(skeleton, 2)
    hips = np.array([[0.0, 1, 0], [2, 3, 4]])
    placed = positions_of(skeleton, still.rotations, 0, hips)
    _, expected = forward(
        skeleton.parents,
        still.rotations,
        np.where(np.arange(len(skeleton))[:, None] == 0, hips[:, None], skeleton.offsets),
    )
    assert np.allclose(placed, expected)


def test_a_root_above_the_hips_stays_where_it_is():
    skeleton = body().skeleton
    longer = Skeleton(
        ("root", *skeleton.names),
        np.concatenate([[-1], skeleton.parents + 1]),
        np.concatenate([np.zeros((1, 3)), skeleton.offsets]),
        np.concatenate([rot.IDENTITY[None], skeleton.rest_rotations]),
    )
    target = cast(Character(longer), Hints(joints={name: name for name in skeleton.names}))
    result = prepare(actor(), target, "copy-rotations", foot_lock=False)(walk()).motion
    assert result.moved == (0, 1)
    _, places = world_pose(result)
    assert np.abs(places[:, 0]).max() == 0
    assert np.abs(places[:, 1:] - world_pose(walk())[1]).max() < 0.05, (
        "the skeleton alone measures its soles a little otherwise"
    )
