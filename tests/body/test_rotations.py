import numpy as np
import pytest

from retarget.body import rotations as rot


@pytest.fixture
def quaternions():
    return rot.normalise(np.random.default_rng(0).normal(size=(500, 4)))


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_euler_round_trip_in_every_order_and_at_gimbal_lock(quaternions, order):
    locked = rot.from_euler(np.array([[0.3, np.pi / 2, 0.7], [0.3, -np.pi / 2, 0.7]]), order)
    both = np.concatenate([quaternions, locked])
    again = rot.from_euler(rot.to_euler(both, order), order)
    assert rot.angle_between(again, both).max() < 1e-6


def test_euler_order_is_the_order_of_multiplication():
    angles = np.array([0.1, 0.2, 0.3])
    one = [rot.from_rotation_vector(np.eye(3)["XYZ".index(axis)] * angle) for axis, angle in zip("ZXY", angles)]
    assert rot.angle_between(rot.from_euler(angles, "ZXY"), rot.multiply(rot.multiply(one[0], one[1]), one[2])) < 1e-9


def test_matrix_and_rotation_vector_round_trips(quaternions):
    assert rot.angle_between(rot.from_matrix(rot.to_matrix(quaternions)), quaternions).max() < 1e-9
    assert rot.angle_between(rot.from_rotation_vector(rot.to_rotation_vector(quaternions)), quaternions).max() < 1e-9


def test_rotating_a_vector_agrees_with_the_matrix(quaternions):
    vectors = np.random.default_rng(1).normal(size=(500, 3))
    assert np.allclose(rot.rotate(quaternions, vectors), np.einsum("nij,nj->ni", rot.to_matrix(quaternions), vectors))


def test_swing_takes_one_direction_to_the_other_without_twist():
    rng = np.random.default_rng(2)
    a, b = rot.unit(rng.normal(size=(100, 3))), rot.unit(rng.normal(size=(100, 3)))
    swing = rot.swing_between(a, b)
    assert np.allclose(rot.rotate(swing, a), b)
    assert np.abs((swing[:, :3] * a).sum(axis=-1)).max() < 1e-9
    assert np.allclose(rot.rotate(rot.swing_between(a, -a), a), -a)


def test_twist_is_the_part_about_the_axis(quaternions):
    axis = np.array([0.0, 1.0, 0.0])
    twist = rot.twist_about(quaternions, axis)
    swing = rot.multiply(quaternions, rot.inverse(twist))
    assert np.abs(swing[:, 1]).max() < 1e-9


def test_slerp_moves_at_constant_speed():
    a, b = rot.IDENTITY, rot.from_rotation_vector(np.array([0.0, 0.0, 1.0]))
    for t in (0.0, 0.25, 1.0, 1.5):
        assert np.allclose(rot.to_rotation_vector(rot.slerp(a, b, np.array(t))), [0, 0, t])


def test_continuous_never_flips_and_keeps_the_rotation(quaternions):
    smooth = rot.continuous(quaternions)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) >= 0).all()
    assert rot.angle_between(smooth, quaternions).max() < 1e-7


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 2.5])
def test_the_left_jacobian_says_how_small_changes_turn(size):
    vectors = size * rot.unit(np.random.default_rng(3).normal(size=(20, 3)))
    for axis in np.eye(3):
        changed = rot.multiply(rot.from_rotation_vector(vectors + 1e-5 * axis), rot.inverse(rot.from_rotation_vector(vectors)))
        assert np.abs(rot.to_rotation_vector(changed) / 1e-5 - rot.left_jacobian(vectors) @ axis).max() < 1e-4
