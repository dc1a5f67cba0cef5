"""Surfaces with other numbers of triangles keep their shape."""

import numpy as np
import pytest

from retarget.body.human import human
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.resample import Surface, cleaned, decimate, largest_pieces, subdivide
from retarget.geometry.topology import areas, pieces, signed_volume


@pytest.fixture(scope="module")
def body():
    mesh = human().mesh
    return Surface(mesh.vertices, mesh.faces)


def test_subdividing_keeps_area_volume_and_orientation(body):
    fine, placing = subdivide(body)
    assert len(fine.faces) == 4 * len(body.faces)
    assert np.array_equal(fine.vertices[: len(body)], body.vertices)
    assert np.allclose(placing @ body.vertices, fine.vertices)
    assert np.allclose(placing.sum(axis=1), 1)
    assert areas(fine.vertices, fine.faces).sum() == pytest.approx(areas(body.vertices, body.faces).sum())
    assert signed_volume(fine.vertices, fine.faces) == pytest.approx(signed_volume(body.vertices, body.faces))


def test_decimating_keeps_the_surface(body):
    coarse = decimate(body, 2000)
    assert 1500 < len(coarse) <= 2200
    places = SurfaceIndex(coarse.vertices, coarse.faces).closest(body.vertices)
    away = np.linalg.norm(places.of(coarse.vertices) - body.vertices, axis=1)
    assert away.mean() < 0.002 and away.max() < 0.02
    assert signed_volume(coarse.vertices, coarse.faces) == pytest.approx(
        signed_volume(body.vertices, body.faces), rel=0.02
    )


def test_small_surfaces_stay_as_they_are(body):
    assert decimate(body, 10_000) is body


def test_cleaning_takes_out_what_is_no_surface():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [5, 5, 5]])
    faces = np.array([[0, 1, 2], [3, 2, 1], [1, 1, 2], [2, 0, 1]])
    found = cleaned(Surface(vertices, faces))
    assert len(found) == 3 and len(found.faces) == 1


def test_pieces_come_largest_first(body):
    hat = Surface(body.vertices * 0.1 + 5, body.faces)
    both = Surface(np.concatenate([hat.vertices, body.vertices]), np.concatenate([hat.faces, body.faces + len(hat)]))
    found = largest_pieces(both)
    assert len(found) == 2 and pieces(both.faces, len(both)).max() == 1
    assert np.ptp(found[0].vertices) > 5 * np.ptp(found[1].vertices)
