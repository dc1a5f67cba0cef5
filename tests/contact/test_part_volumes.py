"""Volumes of a body's parts: what they are, how they change, and how they come back."""

from functools import cache

import numpy as np
import pytest
from made_bodies import ARMS_AT_WORK, posed
from made_motions import actor, body

from retarget.body.skinning import rest_vertices
from retarget.contact.part_volumes import prepare_volumes
from retarget.evaluate.touch import judged_body
from retarget.geometry import turn_kernels as kernels
from retarget.geometry.topology import weld


@cache
def volumes():
    return prepare_volumes(judged_body(actor("heavy")).collider, rest(), body("heavy").mesh.faces)


@cache
def rest():
    return rest_vertices(body("heavy")).astype(np.float64)


def normals(vertices):
    found = np.empty_like(vertices)
    kernels.normals(vertices, volumes().faces, found)
    return found


def whole(vertices, faces):
    """Cubic metres within a closed surface."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return (a * np.cross(b, c)).sum() / 6


def test_the_parts_at_rest_fill_the_body():
    parts = volumes().of(rest())
    assert np.array_equal(parts, volumes().volumes) and (parts > 0).all()
    faces = weld(rest())[body("heavy").mesh.faces]
    assert parts.sum() == pytest.approx(whole(rest(), faces), rel=0.02), "seams are closed alike on both sides"


def test_volumes_do_not_change_with_the_place_and_grow_with_the_cube():
    assert volumes().of(rest() + [3.0, -2, 5]) == pytest.approx(volumes().volumes, rel=1e-9)
    assert volumes().of(2 * rest()) == pytest.approx(8 * volumes().volumes, rel=1e-9)


def test_the_matrix_is_how_volumes_change():
    """Central differences along random offsets of all parts."""
    vertices = posed(body("heavy"), ARMS_AT_WORK)
    own = normals(vertices)
    _, matrix = volumes()._system(vertices, own)
    random = np.random.default_rng(0)
    for _ in range(4):
        offsets = random.normal(size=matrix.shape[1])
        way, small = (volumes().shares @ offsets)[:, None] * own, 1e-5
        change = (volumes().of(vertices + small * way) - volumes().of(vertices - small * way)) / (2 * small)
        assert matrix @ offsets == pytest.approx(change, rel=1e-5, abs=1e-8 * np.abs(change).max())


@pytest.mark.parametrize("by", [0.006, -0.006])
def test_an_inflated_body_comes_back(by):
    vertices = rest() + by * normals(rest())
    before = np.abs(volumes().of(vertices) / volumes().volumes - 1)
    after = np.abs(volumes().of(volumes().kept(vertices)) / volumes().volumes - 1)
    assert before.max() > 0.1
    assert after.max() < 0.01


def test_a_posed_body_keeps_its_volumes():
    vertices = posed(body("heavy"), ARMS_AT_WORK)
    before = np.abs(volumes().of(vertices) / volumes().volumes - 1)
    kept = volumes().kept(vertices)
    after = np.abs(volumes().of(kept) / volumes().volumes - 1)
    assert before.max() > 0.03 and after.max() < 0.01
    assert np.linalg.norm(kept - vertices, axis=1).max() < 0.02


def test_a_body_at_rest_stays_as_it_is():
    assert np.abs(volumes().kept(rest()) - rest()).max() < 1e-6


def test_offsets_fade_out_over_seams():
    shares = volumes().shares
    assert shares.min() >= 0 and shares.sum(axis=1).max() <= 1 + 1e-9
    faces = volumes().faces
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.abs(shares[edges[:, 0]] - shares[edges[:, 1]]).max() < 0.3, "no step from vertex to vertex"
