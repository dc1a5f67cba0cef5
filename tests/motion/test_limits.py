"""Joint limits: what bodies can do passes untouched, what they cannot is eased back."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, still_motion, world_pose
from retarget.motion.limits import HYPEREXTENSION, MARGIN, ease_into_limits, joint_limits


def bent(name, axis, degrees):
    """World rotations of the rest pose with one joint turned about a world axis, what hangs on it following."""
    body = actor()
    motion = still_motion(body.skeleton)
    joint = body.skeleton.index(name)
    world, _ = rest_pose(body.skeleton)
    turn = rot.from_rotation_vector(np.radians(degrees) * np.asarray(axis, float))
    parent = world[body.skeleton.parents[joint]]
    local = rot.multiply(rot.inverse(parent), rot.multiply(turn, world[joint]))
    rotations = motion.rotations.copy()
    rotations[:, joint] = local
    return body, joint, world_pose(replace(motion, rotations=rotations))[0]


def eased_by(name, axis, degrees):
    body, joint, world = bent(name, axis, degrees)
    before = world.copy()
    ease_into_limits(joint_limits(body), world)
    others = np.delete(np.arange(len(body.skeleton)), joint)
    assert np.array_equal(world[:, others], before[:, others]), "only the joint itself turns"
    return float(np.degrees(rot.angle_between(world[0, joint], before[0, joint])))


@pytest.mark.parametrize("name", ["leftLowerLeg", "rightLowerLeg"])
def test_a_knee_bends_back_freely_and_hardly_forward(name):
    assert eased_by(name, [1, 0, 0], 120) < 1e-6
    assert eased_by(name, [1, 0, 0], -5) < 1e-6
    forward = eased_by(name, [1, 0, 0], -70)
    assert 20 < forward < 60
    least = 70 - np.degrees(HYPEREXTENSION + MARGIN) - 15  # the rest pose bends the knee a little
    assert forward > least


def test_a_head_does_not_turn_to_the_back():
    assert eased_by("head", [0, 1, 0], 80) < 1e-6
    assert 30 < eased_by("head", [0, 1, 0], 170) < 70


def test_more_stays_more():
    """Beyond the limit the angle still grows, so that a motion is not cut flat."""
    body, joint, start = bent("head", [0, 1, 0], 0)
    angles = []
    for degrees in (100, 115, 130, 150):
        _, _, world = bent("head", [0, 1, 0], degrees)
        ease_into_limits(joint_limits(body), world)
        angles.append(float(rot.angle_between(world[0, joint], start[0, joint])))
    assert angles == sorted(angles) and len(set(np.round(angles, 6))) == 4
    assert np.degrees(angles[-1]) < 121


def test_a_walk_is_left_alone():
    world = world_pose(walk())[0]
    assert ease_into_limits(joint_limits(actor()), world) == 0
