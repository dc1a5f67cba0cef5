"""One closed surface around pieces, holes and bare points."""

import numpy as np
import pytest
from made_bodies import sphere

from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.resample import Surface, largest_pieces
from retarget.geometry.shell import covering_points, shell
from retarget.geometry.topology import is_oriented, rim_edges, signed_volume


def test_the_shell_of_a_ball_is_a_ball():
    ball = sphere(3)
    found = shell(covering_points(ball, 0.01), cells=100)
    assert len(rim_edges(found.faces)) == 0 and is_oriented(found.faces)
    assert signed_volume(found.vertices, found.faces) == pytest.approx(4 / 3 * np.pi, rel=0.06)
    assert np.abs(np.linalg.norm(found.vertices, axis=1) - 1).max() < 0.04


def test_holes_are_closed_and_pieces_joined():
    ball = sphere(3)
    torn = Surface(ball.vertices, ball.faces[:-12])
    twice = Surface(
        np.concatenate([torn.vertices, torn.vertices + [1.5, 0, 0]]), np.concatenate([torn.faces, torn.faces + len(torn)])
    )
    found = largest_pieces(shell(covering_points(twice, 0.02), thickness=3, cells=100))
    assert len(found) == 1
    assert len(rim_edges(found[0].faces)) == 0


def test_covering_points_leave_no_gap():
    ball = sphere(1)
    points = covering_points(ball, 0.05)
    places = SurfaceIndex(ball.vertices, ball.faces).closest(points)
    assert np.allclose(places.of(ball.vertices), points, atol=1e-9)
    draw = np.random.default_rng(2)
    weights = draw.dirichlet([1, 1, 1], size=300)
    sampled = np.einsum("pc,pcx->px", weights, ball.vertices[ball.faces[draw.integers(len(ball.faces), size=300)]])
    assert np.linalg.norm(sampled[:, None] - points, axis=2).min(axis=1).max() < 0.05
