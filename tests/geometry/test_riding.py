"""Points that ride on a surface keep their place in it, and their distance from it."""

import numpy as np

from retarget.geometry.riding import place_riders

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
POINTS = np.array([[0.2, 0.1, 0.05], [0.5, 0.9, -0.02], [1.0, 1.0, 0.0]])


def test_at_rest_they_lie_where_they_lay():
    riders = place_riders(POINTS, SQUARE, FACES)
    assert len(riders) == 3
    np.testing.assert_allclose(riders.of(SQUARE), POINTS, atol=1e-12)


def test_they_turn_and_stretch_with_the_surface_and_stay_as_far_off():
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # by a quarter about +Y: +Z becomes +X
    stretched = SQUARE * [2.0, 1, 1]
    wanted = (POINTS * [2.0, 1, 1]) @ turn.T + [0, 3, 0]
    np.testing.assert_allclose(place_riders(POINTS, SQUARE, FACES).of(stretched @ turn.T + [0, 3, 0]), wanted, atol=1e-12)


def test_a_surface_shown_larger_holds_them_farther_off():
    np.testing.assert_allclose(place_riders(POINTS, SQUARE, FACES, 100.0).of(100 * SQUARE), 100 * POINTS, atol=1e-9)
