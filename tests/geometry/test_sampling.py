"""Points of a surface: as many as the area deserves, on it, the same every time."""

import numpy as np
import pytest

from retarget.body.human import human
from retarget.errors import RetargetError
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.sampling import sample_surface

TWO = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0]])
FACES = np.array([[0, 1, 2], [3, 4, 5], [0, 0, 1]])


def test_every_piece_gets_what_its_area_deserves():
    points = sample_surface(TWO, FACES, 20_000)
    large = points[:, 0] > 4
    assert large.mean() == pytest.approx(0.9, abs=0.01)
    local = (points[large] - TWO[3]) / 3
    assert local[:, :2].min() >= 0 and local[:, :2].sum(axis=1).max() <= 1 + 1e-9
    assert local.mean(axis=0) == pytest.approx([1 / 3, 1 / 3, 0], abs=0.01), "even within a triangle"


def test_points_lie_on_the_surface_and_are_the_same_every_time():
    body = human().mesh
    points = sample_surface(body.vertices, body.faces, 500, 3)
    assert np.array_equal(points, sample_surface(body.vertices, body.faces, 500, 3))
    assert not np.array_equal(points, sample_surface(body.vertices, body.faces, 500, 4))
    away = np.linalg.norm(SurfaceIndex(body.vertices, body.faces).closest(points).of(body.vertices) - points, axis=1)
    assert np.median(away) < 1e-9 and away.max() < 0.002


@pytest.mark.parametrize("faces", [np.zeros((0, 3), np.int64), np.array([[0, 0, 1]])])
def test_a_surface_without_area_has_no_points(faces):
    with pytest.raises(RetargetError, match="has no area"):
        sample_surface(TWO, faces, 10)
