"""Joint limits: what bodies can do passes untouched, what they cannot is eased back."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, still_motion, world_pose
from retarget.motion.limit_kernels import nearest_within
from retarget.motion.limits import HYPEREXTENSION, MARGIN, ease_into_limits, joint_limits, stack_limits


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


def within(name, axis, degrees):
    """The bounds of a body, its world rotations with one joint turned, what is beyond and the nearest rotations within."""
    body, joint, world = bent(name, axis, degrees)
    bounds = stack_limits(joint_limits(body))
    allowed = bounds.allowed(rest_pose(body.skeleton)[0][None])[0]
    wanted = np.empty((len(bounds.joints), 4))
    beyond = nearest_within(
        world[0], bounds.joints, bounds.carriers, bounds.frames, bounds.carrier_frames, bounds.axes, bounds.hinges,
        allowed, wanted,
    )  # fmt: skip
    return bounds, world[0], joint, beyond, wanted, allowed


@pytest.mark.parametrize(
    ("name", "axis", "free", "beyond"),
    [("leftLowerLeg", [1, 0, 0], 120, -70), ("head", [0, 1, 0], 80, 170), ("rightHand", [1, 0, 0], 60, 150)],
)
def test_only_what_is_beyond_its_limit_is_brought_back_and_no_further(name, axis, free, beyond):
    assert not within(name, axis, free)[3].any()
    bounds, world, joint, found, wanted, allowed = within(name, axis, beyond)
    assert bounds.joints[found].tolist() == [joint]
    world[joint] = wanted[found][0]
    again = nearest_within(
        world, bounds.joints, bounds.carriers, bounds.frames, bounds.carrier_frames, bounds.axes, bounds.hinges,
        allowed + 1e-6, wanted,
    )  # fmt: skip
    assert not again.any()
    own = int(np.flatnonzero(found)[0])
    has = bounds.allowed(world[None])[0, own]
    assert np.isclose(has, allowed[own], atol=1e-6).any(), "it stops at the limit"


def test_a_pose_that_may_stay_sets_the_limit():
    """Where the copied pose is beyond a limit, the solver leaves it there, and takes it no further."""
    body, _, world = bent("leftLowerLeg", [1, 0, 0], -70)
    bounds = stack_limits(joint_limits(body))
    wide = bounds.allowed(world)[0]
    wanted = np.empty((len(bounds.joints), 4))
    own = (bounds.joints, bounds.carriers, bounds.frames, bounds.carrier_frames, bounds.axes, bounds.hinges)
    assert not nearest_within(world[0], *own, wide + 1e-9, wanted).any()
    further = bent("leftLowerLeg", [1, 0, 0], -80)[2]
    assert nearest_within(further[0], *own, wide, wanted).any()
