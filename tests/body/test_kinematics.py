"""Forward kinematics against matrices multiplied out by hand."""

import numpy as np
import pytest
from made_motions import body, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import (
    FEW,
    forward,
    joint_transforms,
    levels,
    local_positions,
    local_rotations,
    rest_pose,
    still_motion,
    world_pose,
)
from retarget.character import Motion, Skeleton

QUARTER_Z = rot.from_rotation_vector(np.array([0, 0, np.pi / 2]))


def arm():
    return Skeleton(
        ("a", "b", "c"),
        np.array([-1, 0, 1]),
        np.array([[0, 1, 0], [1, 0, 0], [1, 0, 0.0]]),
        np.tile(rot.IDENTITY, (3, 1)),
    )


def test_an_arm_bent_twice_by_a_right_angle():
    skeleton = arm()
    rotations = np.array([[QUARTER_Z, QUARTER_Z, rot.IDENTITY]])
    turns, places = world_pose(Motion(skeleton, rotations, np.array([[[0, 1.0, 0]]])))
    assert np.allclose(places[0], [[0, 1, 0], [0, 2, 0], [-1, 2, 0]])
    assert np.allclose(rot.rotate(turns[0, 2], np.array([1.0, 0, 0])), [-1, 0, 0])


@pytest.mark.parametrize("frames", [5, FEW + 1])
def test_forward_agrees_with_matrices(frames):
    rng = np.random.default_rng(0)
    parents = np.array([-1, 0, 0, 1, 3, 2, 4])
    rotations, positions = rot.normalise(rng.normal(size=(frames, 7, 4))), rng.normal(size=(frames, 7, 3))
    world = joint_transforms(*forward(parents, rotations, positions))
    local = joint_transforms(rotations, positions)
    for joint, parent in enumerate(parents):
        expected = local[:, joint] if parent < 0 else world[:, parent] @ local[:, joint]
        assert np.allclose(world[:, joint], expected)


def test_local_rotations_undo_forward():
    motion = walk()
    turns, _ = world_pose(motion)
    assert rot.angle_between(local_rotations(motion.skeleton.parents, turns), motion.rotations).max() < 1e-7


def test_levels_put_parents_first():
    assert [level.tolist() for level in levels(np.array([-1, 0, 0, 1, 3, 2]))] == [[0], [1, 2], [3, 5], [4]]


def test_moved_joints_leave_their_offsets():
    skeleton = arm()
    places = local_positions(skeleton, np.array([[[5.0, 5, 5], [7, 7, 7]]]), (0, 2))
    assert np.allclose(places[0], [[5, 5, 5], [1, 0, 0], [7, 7, 7]])
    assert np.allclose(skeleton.offsets[0], [0, 1, 0]), "the skeleton itself is not touched"


@pytest.mark.parametrize("frames", [1, 4])
def test_the_still_motion_is_the_rest_pose(frames):
    skeleton = body().skeleton
    still = still_motion(skeleton, frames)
    rotations, places = rest_pose(skeleton)
    assert len(still) == frames
    assert np.allclose(world_pose(still)[0], rotations) and np.allclose(world_pose(still)[1], places)
