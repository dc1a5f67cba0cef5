"""Rig metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.evaluate.metrics import joint_error_cm, weight_mse_x100


def test_weight_error_by_hand():
    truth = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1]])
    result = np.array([[1.0, 0], [0.8, 0.1], [0.4, 1], [0, 1]])
    np.testing.assert_allclose(weight_mse_x100(result, truth), [100 * (0.04 + 0.16) / 4, 100 * 0.01 / 4])
    np.testing.assert_allclose(weight_mse_x100(truth, truth), 0)


def test_weight_error_follows_the_order_of_joints_and_not_that_of_vertices():
    random = np.random.default_rng(0)
    result, truth = random.dirichlet(np.ones(5), size=(2, 30))
    wanted = weight_mse_x100(result, truth)
    vertices, joints = random.permutation(30), random.permutation(5)
    np.testing.assert_allclose(weight_mse_x100(result[vertices], truth[vertices]), wanted)
    np.testing.assert_allclose(weight_mse_x100(result[:, joints], truth[:, joints]), wanted[joints])
    half = weight_mse_x100(truth + 0.5 * (result - truth), truth)
    np.testing.assert_allclose(half, wanted / 4)


def test_joint_error_by_hand():
    truth = np.array([[0.0, 1, 0], [0, 0.5, 0]])
    result = truth + [[0.03, 0, 0.04], [0, 0, 0]]
    np.testing.assert_allclose(joint_error_cm(result, truth, 1.7), [5, 0])
    np.testing.assert_allclose(joint_error_cm(result, truth, 0.85), [10, 0])
    turn = rot.from_rotation_vector(np.array([0.4, -1.1, 0.3]))
    moved = joint_error_cm(rot.rotate(turn, result) + 3, rot.rotate(turn, truth) + 3, 1.7)
    assert moved == pytest.approx([5, 0])
