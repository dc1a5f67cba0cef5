"""The nearest place on a surface, against every face tried."""

import numpy as np
import pytest

from retarget.body.human import human
from retarget.geometry.closest import SurfaceIndex


def in_triangle(point, *corners):
    """Barycentric coordinates of the place of one triangle nearest to a point."""
    return SurfaceIndex(np.stack(corners), np.array([[0, 1, 2]])).closest(point[None]).weights[0]


def by_sampling(point, a, b, c, steps=400):
    u, v = (axis.ravel() / steps for axis in np.meshgrid(np.arange(steps + 1), np.arange(steps + 1)))
    inside = u + v <= 1
    places = a + u[inside, None] * (b - a) + v[inside, None] * (c - a)
    return np.linalg.norm(places - point, axis=1).min()


@pytest.mark.parametrize("dimensions", [2, 3, 6])
def test_the_place_in_a_triangle_is_the_nearest(dimensions):
    draw = np.random.default_rng(dimensions)
    points, a, b, c = draw.normal(size=(4, 200, dimensions))
    weights = np.stack([in_triangle(*row) for row in zip(points, a, b, c)])
    assert weights.min() >= 0 and np.allclose(weights.sum(axis=1), 1)
    placed = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
    found = np.linalg.norm(placed - points, axis=1)
    sampled = [by_sampling(*row) for row in zip(points[:40], a, b, c)]
    assert np.all(found[:40] <= np.array(sampled) + 1e-9)
    assert np.allclose(found[:40], sampled, atol=0.02)


def test_flat_triangles_give_a_place_on_their_edges():
    weights = in_triangle(np.array([0.3, 1.0, 0.0]), *np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    assert np.isfinite(weights).all()
    assert weights @ [0.0, 1.0, 2.0] == pytest.approx(0.3)


def test_the_index_finds_what_trying_every_face_finds():
    mesh = human().mesh
    draw = np.random.default_rng(1)
    points = mesh.vertices[draw.integers(len(mesh.vertices), size=60)] + draw.normal(size=(60, 3)) * 0.02
    places = SurfaceIndex(mesh.vertices, mesh.faces).closest(points, candidates=16)
    found = np.linalg.norm(places.of(mesh.vertices) - points, axis=1)
    every = SurfaceIndex(mesh.vertices, mesh.faces).closest(points, candidates=len(mesh.faces))
    least = np.linalg.norm(every.of(mesh.vertices) - points, axis=1)
    assert np.all(found <= least + 0.002)


def test_of_all_faces_the_nearest_is_taken():
    draw = np.random.default_rng(2)
    vertices, faces = draw.normal(size=(30, 3)), draw.integers(30, size=(20, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    points = draw.normal(size=(10, 3))
    found = np.linalg.norm(SurfaceIndex(vertices, faces).closest(points, len(faces)).of(vertices) - points, axis=1)
    each = [[by_sampling(point, *vertices[face], steps=100) for face in faces] for point in points]
    assert np.allclose(found, np.min(each, axis=1), atol=0.03)


def test_places_are_a_matrix_too():
    mesh = human().mesh
    places = SurfaceIndex(mesh.vertices, mesh.faces).closest(mesh.vertices[:50] + 0.01)
    values = np.random.default_rng(0).normal(size=(len(mesh.vertices), 2))
    assert np.allclose(places.matrix(len(values)) @ values, places.of(values))
