"""Two-bone inverse kinematics against cases that can be worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.motion.ik import two_bone

TOP = np.zeros(3)


def reached(top, middle, end, goal, pole):
    """Middle and end joint after the two rotations."""
    upper, lower = two_bone(*(np.asarray(v, float) for v in (top, middle, end, goal, pole)))
    new_middle = top + rot.rotate(upper, np.asarray(middle - top, float))
    return new_middle, new_middle + rot.rotate(lower, np.asarray(end - middle, float))


def random_limbs(count=200, seed=0):
    rng = np.random.default_rng(seed)
    upper, lower = (rot.unit(rng.normal(size=(count, 3))) * rng.uniform(0.2, 0.5, (count, 1)) for _ in range(2))
    top = rng.normal(size=(count, 3))
    return top, top + upper, top + upper + lower, rng


def test_reaches_every_goal_within_reach_and_keeps_bone_lengths():
    top, middle, end, rng = random_limbs()
    upper, lower = (np.linalg.norm(v, axis=1) for v in (middle - top, end - middle))
    distance = rng.uniform(np.abs(upper - lower) * 1.01 + 0.01, (upper + lower) * 0.99)
    goal = top + rot.unit(rng.normal(size=top.shape)) * distance[:, None]
    new_middle, new_end = reached(top, middle, end, goal, rng.normal(size=top.shape))
    assert np.abs(new_end - goal).max() < 1e-9
    assert np.abs(np.linalg.norm(new_middle - top, axis=1) - upper).max() < 1e-12
    assert np.abs(np.linalg.norm(new_end - new_middle, axis=1) - lower).max() < 1e-12


def test_a_limb_that_is_there_already_is_left_alone():
    top, middle, end, rng = random_limbs(seed=1)
    upper, lower = two_bone(top, middle, end, end, rng.normal(size=top.shape))
    bent = np.linalg.norm(np.cross(rot.unit(middle - top), rot.unit(end - middle)), axis=1) > 0.2
    assert bent.sum() > 100
    for q in (upper, lower):
        assert np.abs(np.abs(q[bent, 3]) - 1).max() < 1e-9


def test_a_right_angle_by_hand():
    # Bones of 1 and 1 stretched down; the goal at distance sqrt(2) needs a right angle at the knee.
    new_middle, new_end = reached(
        TOP, np.array([0, -1, 0]), np.array([0, -2, 0]), np.array([0, -np.sqrt(2), 0]), np.array([0, 0, 1])
    )
    assert np.allclose(new_end, [0, -np.sqrt(2), 0], atol=1e-9)
    assert np.allclose(new_middle, [0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-9), (
        "a straight limb bends towards the pole"
    )


def test_the_bend_stays_in_its_plane_whatever_the_pole():
    middle, end = np.array([0, -1, 0.3]), np.array([0, -2, 0])
    new_middle, _ = reached(TOP, middle, end, np.array([0, -1.5, 0]), np.array([1, 0, 0]))
    assert abs(new_middle[0]) < 1e-9 and new_middle[2] > 0.3


@pytest.mark.parametrize("distance, expected", [(5.0, 1.5), (0.01, 0.5)], ids=["too far", "too near"])
def test_out_of_reach_is_approached_along_the_line(distance, expected):
    middle, end = np.array([0, -1, 0.2]), np.array([0, -1.4, 0.5])  # lengths about 1 and 0.5
    goal = np.array([0.6, -0.8, 0.0]) * distance
    scale = np.linalg.norm(middle)
    new_middle, new_end = reached(
        TOP, middle / scale, middle / scale + rot.unit(end - middle) * 0.5, goal, np.array([0, 0, 1])
    )
    assert np.isfinite(new_end).all()
    assert np.abs(new_end - rot.unit(goal) * expected).max() < 0.01


def test_the_twist_of_the_bones_follows_the_limb():
    # Turning the whole limb about the vertical by moving its goal turns both bones by the same rotation.
    middle, end = np.array([0, -0.2, 0.4]), np.array([0, -0.8, 0.5])
    quarter = rot.from_rotation_vector(np.array([0, np.pi / 2, 0]))
    goal = rot.rotate(quarter, end)
    upper, lower = two_bone(TOP, middle, end, goal, np.array([0, 0, 1.0]))
    assert np.allclose(np.abs((upper * lower).sum()), 1, atol=1e-9)
    assert np.allclose(rot.rotate(upper, end), goal, atol=1e-9)


def test_a_limb_without_length_stays_finite():
    for goal in (np.zeros(3), np.ones(3)):
        upper, lower = two_bone(TOP, TOP, TOP, goal, np.array([0, 0, 1.0]))
        assert np.isfinite(upper).all() and np.isfinite(lower).all()
