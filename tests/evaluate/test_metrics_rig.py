"""Rig metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.evaluate.metrics import (
    flipped_percent,
    joint_error_cm,
    map_error_percent,
    registration_mm,
    rest_vertex_error_cm,
    torn_percent,
    weight_mse_x100,
)


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


def test_rest_error_ignores_turns_and_moves_and_neither_scale_nor_shape():
    truth = np.random.default_rng(0).normal(size=(20, 3))
    turn = rot.from_rotation_vector(np.array([0.4, -1.1, 0.3]))
    np.testing.assert_allclose(rest_vertex_error_cm(rot.rotate(turn, truth) + 3, truth, 1.7), 0, atol=1e-9)
    bent = truth * [1, 1.1, 1]
    assert rest_vertex_error_cm(bent, truth, 1.7).mean() > 2
    np.testing.assert_allclose(rest_vertex_error_cm(bent, truth, 0.85), 2 * rest_vertex_error_cm(bent, truth, 1.7))
    assert rest_vertex_error_cm(truth * [1, 1, -1], truth, 1.7).mean() > 10  # a mirror image is no turn


def test_registration_and_map_errors_by_hand():
    truth = np.zeros((2, 3))
    result = np.array([[0.003, 0, 0.004], [0, 0, 0]])
    np.testing.assert_allclose(registration_mm(result, truth, 1.7), [5, 0])
    np.testing.assert_allclose(registration_mm(result, truth, 3.4), [2.5, 0])
    np.testing.assert_allclose(map_error_percent(result, truth, 0.5), [1, 0])
    with pytest.raises(RetargetError, match="height must be positive"):
        map_error_percent(result, truth, 0.0)


def test_flips_are_counted_away_from_the_midline_only():
    truth = np.array([[0.5, 0, 0], [-0.5, 0, 0], [0.02, 1, 0], [0.5, 1, 0]])
    mirrored = truth * [-1, 1, 1]
    assert flipped_percent(truth, truth, mirrored, 0.1) == 0
    assert flipped_percent(mirrored, truth, mirrored, 0.1) == 75
    assert flipped_percent(mirrored, truth, mirrored, 0.01) == 100
    moved = truth.copy()
    moved[0] = [-0.1, 0, 0]
    assert flipped_percent(moved, truth, mirrored, 0.1) == 25
    assert np.isnan(flipped_percent(truth[:0], truth[:0], truth[:0], 0.1))


def test_edges_that_grew_are_torn():
    posed = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    edges = np.array([[0, 1], [1, 2], [0, 2], [0, 1]])
    assert torn_percent(posed, posed, edges, 1.7) == 0
    grown = posed.copy()
    grown[1] = [0.27, 0, 0]  # twice its length and 3 % of the height are 0.251; the other edge may reach 0.334
    assert torn_percent(grown, posed, edges, 1.7) == 50
    assert torn_percent(grown, posed, edges, 3.0) == 0
    assert torn_percent(posed * 0.1, posed, edges, 1.7) == 0
    assert np.isnan(torn_percent(posed, posed, edges[:0], 1.7))
