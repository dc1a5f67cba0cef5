"""Joints read off a surface alone, against the pose that made the surface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_bodies import ARMS_AT_WORK, pose, posed, with_joint
from made_motions import body
from scipy.spatial.transform import Rotation

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Mesh, Skin
from retarget.errors import RetargetError
from retarget.motion.joint_frames import prepare_frames

MAIN = ("hips", "spine", "chest", "neck", "head", *(
    f"{side}{name}" for side in ("left", "right")
    for name in ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
))  # fmt: skip


@cache
def frames(preset):
    return prepare_frames(body(preset))


def errors(character, found, turns):
    """Degrees and metres by joint."""
    world, places = (each[0] for each in pose(character, turns))
    return np.degrees(rot.angle_between(found[0], world)), np.linalg.norm(found[1] - places, axis=1)


@pytest.mark.parametrize("preset", ["thin", "very_heavy", "child"])
def test_a_skinned_pose_gives_its_joints_back(preset):
    character = body(preset)
    degrees, metres = errors(character, frames(preset).of(posed(character, ARMS_AT_WORK)), ARMS_AT_WORK)
    main = [character.skeleton.index(name) for name in MAIN]
    assert degrees[main].max() < 1.0 and metres[main].max() < 0.005
    assert degrees.max() < 2.0 and metres.max() < 0.01, "fingers too"


def test_rest_gives_rest():
    world, places = rest_pose(body("heavy").skeleton)
    turned, at = frames("heavy").of(rest_vertices(body("heavy")))
    assert np.degrees(rot.angle_between(turned, world)).max() < 1e-3 and np.abs(at - places).max() < 1e-5


def test_turning_the_surface_turns_the_joints():
    turn = Rotation.from_rotvec([0.3, 2.0, -0.4])
    vertices = posed(body("heavy"), ARMS_AT_WORK)
    plain, moved = (frames("heavy").of(each) for each in (vertices, turn.apply(vertices) + [1.0, 2, 3]))
    assert np.abs(moved[1] - (turn.apply(plain[1]) + [1.0, 2, 3])).max() < 1e-5
    assert np.degrees(rot.angle_between(moved[0], rot.multiply(turn.as_quat(), plain[0]))).max() < 1e-3


def test_a_joint_without_skin_follows_the_one_it_hangs_on():
    character = with_joint(body("thin"), "cup", "leftHand", [0.1, 0.0, 0.05])
    found = prepare_frames(character).of(posed(body("thin"), ARMS_AT_WORK))
    degrees, metres = errors(character, found, ARMS_AT_WORK)
    assert degrees[-1] < 1.0 and metres[-1] < 0.005
    assert np.degrees(rot.angle_between(found[0][-1], rot.IDENTITY)) > 20


def test_noise_on_the_skin_hardly_turns_joints():
    noise = np.random.default_rng(0).normal(scale=0.002, size=(len(body("thin").mesh.vertices), 3))
    degrees, metres = errors(body("thin"), frames("thin").of(posed(body("thin"), ARMS_AT_WORK) + noise), ARMS_AT_WORK)
    main = [body("thin").skeleton.index(name) for name in MAIN if "Shoulder" not in name]
    assert degrees[main].max() < 2.0 and metres[main].max() < 0.006


def test_a_skin_that_tells_of_no_joint_is_refused():
    skin = body("thin").skin
    few = Skin(skin.joints, skin.inverse_binds, skin.columns[:3], skin.weights[:3])
    with pytest.raises(RetargetError, match="no joint of"):
        prepare_frames(
            replace(body("thin"), mesh=Mesh(body("thin").mesh.vertices[:3], np.array([[0, 1, 2]])), skin=few)
        )
