"""Weights where neighbours were placed far apart: filled in from around, and nothing else."""

import numpy as np

from retarget.geometry.resample import Surface
from retarget.rig.stretch import fill_stretched


def strip(count=40, step=0.01):
    """A band of triangles along x, two vertices wide."""
    x = np.arange(count) * step
    vertices = np.concatenate([np.stack([x, np.full(count, y), np.zeros(count)], axis=1) for y in (0.0, step)])
    first = np.arange(count - 1)
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + count], axis=1),
            np.stack([first + 1, first + count + 1, first + count], axis=1),
        ]
    )
    return Surface(vertices, faces)


def jumping(mesh, far):
    """Places as on the mesh, but those of `far` on another limb, and weights that follow."""
    rest, weights = mesh.vertices.copy(), np.tile([1.0, 0.0], (len(mesh), 1))
    rest[far] += [0.0, 0.4, 0.0]
    weights[far] = [0.0, 1.0]
    return rest, weights


def test_a_jump_becomes_a_passage():
    mesh = strip()
    far = mesh.vertices[:, 0] > 0.195
    rest, weights = jumping(mesh, far)
    found = fill_stretched(mesh, rest, rings=3).of(weights)
    steps = np.abs(np.diff(found[:40, 1]))
    assert steps.max() < 0.2 and np.allclose(found.sum(axis=1), 1.0)
    assert np.array_equal(found[:10], weights[:10]) and np.array_equal(found[30:40], weights[30:40])


def test_a_lone_mistake_takes_what_is_around_it():
    mesh = strip()
    far = np.zeros(len(mesh), dtype=bool)
    far[20] = True
    rest, weights = jumping(mesh, far)
    assert fill_stretched(mesh, rest).of(weights)[20, 0] > 0.99


def test_without_stretched_edges_nothing_changes():
    mesh = strip()
    weights = np.random.default_rng(0).dirichlet([1.0, 1.0], size=len(mesh))
    assert fill_stretched(mesh, mesh.vertices).of(weights) is weights


def test_a_piece_that_is_stretched_all_over_keeps_its_weights():
    mesh = strip(3)
    rest = mesh.vertices * 40.0
    weights = np.random.default_rng(0).dirichlet([1.0, 1.0], size=len(mesh))
    found = fill_stretched(mesh, rest).of(weights)
    assert np.isfinite(found).all() and np.allclose(found.sum(axis=1), 1.0)


def test_vertices_at_one_place_get_one_value():
    mesh = strip()
    doubled = Surface(np.concatenate([mesh.vertices, mesh.vertices[20:21]]), mesh.faces)
    far = np.zeros(len(doubled), dtype=bool)
    far[[20, 80]] = True
    rest, weights = jumping(doubled, far)
    found = fill_stretched(doubled, rest).of(weights)
    assert np.array_equal(found[20], found[80]) and found[80, 0] > 0.99
