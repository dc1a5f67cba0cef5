"""Metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.evaluate.formulas import FORMULAS
from retarget.evaluate.metrics import angle_error_degrees, floor_error_cm, foot_slide_cm, jerk, position_error_cm


def test_angles():
    x, y = np.array([[[2.0, 0, 0]]]), np.array([[[0, 0.5, 0]]])
    assert angle_error_degrees(x, y)[0, 0] == pytest.approx(90)
    assert angle_error_degrees(x, x)[0, 0] == 0
    assert angle_error_degrees(x, -x)[0, 0] == pytest.approx(180)
    tiny = np.array([[[1.0, 1e-6, 0]]])
    assert angle_error_degrees(x, tiny)[0, 0] == pytest.approx(np.degrees(1e-6), rel=1e-6), (
        "exact near zero, unlike arccos"
    )


def test_a_slide_of_4_cm():
    points = np.zeros((6, 1, 3))
    points[1:5, 0, 0] = [0.0, 0.0, 0.04, 0.04]  # mean 0.02: every frame is 2 cm from it
    points[1:5, 0, 1] = [0, 9, 0, 9]  # heights do not count
    touching = np.array([0, 1, 1, 1, 1, 0], bool)[:, None]
    assert foot_slide_cm(points, touching, 1.7) == pytest.approx([2.0])
    assert foot_slide_cm(points, touching, 0.85) == pytest.approx([4.0]), "quoted at 1.7 m"


def test_one_value_a_contact():
    points = np.zeros((7, 2, 3))
    touching = np.array([[1, 1], [1, 0], [0, 0], [1, 0], [0, 1], [0, 1], [1, 1]], bool)
    assert len(foot_slide_cm(points, touching, 1.7)) == 5
    assert len(foot_slide_cm(points, np.zeros((7, 2), bool), 1.7)) == 0


def test_floor_error_is_that_of_the_lowest_resting_point():
    points = np.zeros((3, 2, 3))
    points[..., 1] = [[0.01, 0.05], [-0.02, 0.03], [0.5, 0.5]]
    touching = np.array([[1, 1], [1, 0], [0, 0]], bool)
    assert floor_error_cm(points, touching, np.zeros((3, 2)), 1.7) == pytest.approx([1.0, 2.0])
    assert floor_error_cm(points, touching, np.zeros((3, 2)) + 0.01, 1.7) == pytest.approx([0.0, 3.0])


def test_jerk_of_a_cubic():
    time = np.arange(20) / 10.0
    points = np.zeros((20, 1, 3))
    points[:, 0, 2] = time**3  # third derivative 6 m/s³
    assert jerk(points, 10.0, 0.5) == pytest.approx(12.0)
    points[:, 0, 2] = time**2
    assert jerk(points, 10.0, 0.5) == pytest.approx(0.0, abs=1e-9)
    assert jerk(points[:3], 10.0, 0.5) == 0.0


def test_joint_distance():
    a, b = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    b[0, 0] = [0.03, 0.04, 0]
    assert position_error_cm(a, b, 1.7) == pytest.approx(5 / 4)
    assert position_error_cm(a, b, 3.4) == pytest.approx(5 / 8)


def test_every_summary_key_has_its_formula_in_words():
    assert all(len(sentence) > 20 for sentence in FORMULAS.values())
