"""Distances along surfaces, and points spread evenly."""

import numpy as np
import pytest
from made_bodies import sphere

from retarget.geometry.geodesic import Geodesics, farthest_points


def test_half_way_around_the_ball():
    ball = sphere()
    distance = Geodesics(ball).distance(0) * np.sqrt(4 * np.pi)
    true = np.arccos(np.clip(ball.vertices @ ball.vertices[0], -1, 1))
    assert np.abs(distance - true).max() < 0.12
    assert distance[1] == pytest.approx(np.pi, abs=0.1)  # the opposite pole


def test_in_units_of_the_body():
    ball = sphere(3)
    other = type(ball)(ball.vertices * 250, ball.faces)
    assert np.allclose(Geodesics(ball).distances(np.array([0, 5])), Geodesics(other).distances(np.array([0, 5])), atol=1e-6)


def test_every_beginning_of_the_farthest_points_is_spread():
    points = np.random.default_rng(0).uniform(size=(2000, 2))
    chosen = farthest_points(points, 100, first=3)
    assert chosen[0] == 3 and len(set(chosen.tolist())) == 100
    for count in (10, 100):
        gaps = np.linalg.norm(points[:, None] - points[chosen[:count]], axis=2).min(axis=1)
        assert gaps.max() < 1.6 / np.sqrt(count)


def test_no_more_points_than_there_are():
    assert len(farthest_points(np.zeros((3, 3)), 10)) == 3
