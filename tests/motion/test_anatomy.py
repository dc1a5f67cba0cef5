"""Anatomical frames: whatever the rest pose, limbs, palms and feet are named alike."""

import numpy as np
import pytest
from made_motions import body, cast_by_names

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.evaluate.cases import arms_turned, in_other_rest_pose, with_other_joint_axes
from retarget.motion.anatomy import bend_directions, joint_from_frame, rest_frames

RESTS = {"A": {}, "T": arms_turned(-40.0), "I": arms_turned(45.0)}
X, Y, Z = np.eye(3)


def frames_of(character):
    actor = cast_by_names(character)
    return rest_frames(actor.skeleton, actor.humanoid)


@pytest.mark.parametrize("rest", RESTS)
def test_the_first_axis_of_a_limb_is_its_bone(rest):
    character = in_other_rest_pose(body(), RESTS[rest])
    _, at = rest_pose(character.skeleton)
    frames = frames_of(character)
    for start, end in (
        ("leftUpperArm", "leftLowerArm"),
        ("rightLowerArm", "rightHand"),
        ("leftUpperLeg", "leftLowerLeg"),
    ):
        bone = at[character.skeleton.index(end)] - at[character.skeleton.index(start)]
        assert np.allclose(rot.rotate(frames[start], X), rot.unit(bone), atol=1e-9)


@pytest.mark.parametrize("rest", RESTS)
def test_frames_turn_with_the_bones_so_that_posed_palms_and_feet_agree(rest):
    """In one and the same world pose every rest pose must give the same world frame: no twist invented, none lost."""
    plain, changed = body(), in_other_rest_pose(body(), RESTS[rest])
    actors = [cast_by_names(each) for each in (plain, changed)]
    pose = rot.from_rotation_vector(np.random.default_rng(0).normal(size=(len(plain.skeleton), 3)))
    K, other = (joint_from_frame(actor.skeleton, actor.humanoid) for actor in actors)
    for name, joint in actors[0].humanoid.joints.items():
        angle = np.degrees(
            rot.angle_between(rot.multiply(pose[joint], K[name]), rot.multiply(pose[joint], other[name]))
        )
        allowed = (
            2.0 if "Hand" in name or "Arm" in name or "imal" in name or "Distal" in name or "Thumb" in name else 1e-6
        )
        assert angle < (allowed if "Shoulder" not in name else 1e-6), name


def test_frames_do_not_know_the_joints_own_axes():
    plain, rolled = frames_of(body()), frames_of(with_other_joint_axes(body(), 11))
    for name in plain:
        assert rot.angle_between(plain[name], rolled[name]) < 1e-6, name


def test_frames_of_a_standing_body_point_where_anatomy_says():
    frames = frames_of(body())
    assert np.allclose(rot.rotate(frames["hips"], Y), Y) and np.allclose(rot.rotate(frames["head"], Z), Z, atol=1e-6)
    for side in ("left", "right"):
        assert rot.rotate(frames[f"{side}Foot"], X) @ Z > 0.9, "feet point forward"
        assert rot.rotate(frames[f"{side}Foot"], Y) @ Y > 0.999, "soles lie flat"
        assert rot.rotate(frames[f"{side}UpperLeg"], X) @ Y < -0.95
        back = rot.rotate(frames[f"{side}Hand"], Y)
        assert back @ (X if side == "left" else -X) > 0.5, "hanging hands show their backs outward"


def test_frames_of_both_sides_mirror_each_other():
    frames = frames_of(body())
    flip = np.array([-1.0, 1, 1])
    for name in frames:
        if name.startswith("left") and not name.endswith(("Shoulder", "Eye")):
            mine, theirs = frames[name], frames["right" + name[4:]]
            for axis in (X, Y):
                assert np.allclose(rot.rotate(mine, axis) * flip, rot.rotate(theirs, axis), atol=1e-5), name


def test_knees_bend_forward_and_elbows_back():
    actor = cast_by_names(in_other_rest_pose(body(), arms_turned(-40.0)))
    rotations, _ = rest_pose(actor.skeleton)
    for limb, direction in bend_directions(actor.skeleton, actor.humanoid).items():
        joint = actor.humanoid.joints[limb[: -len("Leg")] + ("UpperLeg" if limb.endswith("Leg") else "UpperArm")]
        world = rot.rotate(rotations[joint], direction)
        assert world @ (Z if limb.endswith("Leg") else -Z) > 0.8, limb
