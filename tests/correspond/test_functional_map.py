"""Functional maps by their laws: a body onto itself, in another order, and in another pose."""

from functools import lru_cache

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.correspond.functional_map import (
    functional_map,
    map_from_descriptors,
    point_map,
    shared_energies,
    transferred,
    wave_kernel_signature,
    zoomout,
)
from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface, decimate
from retarget.geometry.spectral import spectral_basis

FUNCTIONS = 40


@lru_cache(maxsize=1)
def body() -> Surface:
    """A small embedded body."""
    return decimate(Surface(human().mesh.vertices, human().mesh.faces), 1500)


@lru_cache(maxsize=1)
def basis():
    return spectral_basis(body().vertices, body().faces, FUNCTIONS)


@lru_cache(maxsize=1)
def posed_basis():
    """The same triangles in another pose: an isometry but for the skin's stretching."""
    character = human()
    turns = np.tile(rot.IDENTITY, (len(character.skeleton), 1))
    for name, degrees in {
        "leftUpperArm": (0, -40, 30),
        "rightLowerArm": (0, 50, 0),
        "leftUpperLeg": (-40, 0, 0),
    }.items():
        turns[human_model().joint_names.index(name)] = rot.from_rotation_vector(np.radians(degrees))
    world, joints = forward(character.skeleton.parents, turns[None], character.skeleton.offsets[None])
    posed = prepare_skinning(character).vertices(world, joints)[0].astype(np.float64)
    from scipy.spatial import cKDTree

    near = cKDTree(character.mesh.vertices).query(body().vertices)[1]
    moved = body().vertices + posed[near] - character.mesh.vertices[near]
    return spectral_basis(moved, body().faces, FUNCTIONS)


def test_a_body_onto_itself_is_the_identity():
    same = np.arange(len(body()))
    np.testing.assert_allclose(functional_map(basis(), basis(), same), np.eye(FUNCTIONS), atol=1e-9)
    for adjoint in (False, True):
        found = point_map(np.eye(FUNCTIONS), basis().vectors, basis().vectors, adjoint)
        np.testing.assert_array_equal(found, same)


def test_places_at_corners_are_the_point_map_itself():
    found = np.random.default_rng(0).integers(len(body()), size=len(body()))
    places = Places(np.tile(found[:, None], (1, 3)), np.tile([1.0, 0.0, 0.0], (len(found), 1)))
    np.testing.assert_allclose(
        functional_map(basis(), basis(), places), functional_map(basis(), basis(), found), atol=1e-12
    )


def test_an_isometry_has_an_orthogonal_map_and_a_random_one_has_not():
    same = np.arange(len(body()))
    C = functional_map(basis(), posed_basis(), same)[:20, :20]
    assert np.abs(C @ C.T - np.eye(20)).mean() < 0.02
    shuffled = functional_map(basis(), posed_basis(), np.random.default_rng(0).permutation(same))[:20, :20]
    assert np.abs(shuffled @ shuffled.T - np.eye(20)).mean() > 0.04


def test_vertices_in_another_order_give_the_map_in_that_order():
    order = np.random.default_rng(1).permutation(len(body()))
    place = np.argsort(order)
    other = spectral_basis(body().vertices[order], place[body().faces], FUNCTIONS)
    C = functional_map(basis(), other, order)
    np.testing.assert_allclose(np.abs(C @ C.T), np.eye(FUNCTIONS), atol=1e-6)
    np.testing.assert_array_equal(point_map(C, basis().vectors, other.vectors), order)
    heights = body().vertices[:, 1]
    np.testing.assert_allclose(transferred(C, basis(), other, heights), basis().smooth(heights)[order], atol=1e-6)


def test_zoomout_finds_a_posed_body_from_a_coarse_start():
    same = np.arange(len(body()))
    start = functional_map(basis(), posed_basis(), same)[:8, :8]
    crude = point_map(start, basis().vectors, posed_basis().vectors)
    away = lambda found: np.linalg.norm(body().vertices[found] - body().vertices, axis=1).mean()  # noqa: E731
    for samples in (None, 500):
        C, found = zoomout(basis(), posed_basis(), start, range(9, FUNCTIONS + 1), samples)
        assert C.shape == (FUNCTIONS, FUNCTIONS)
        assert away(found) < 0.01 < 0.3 * away(crude)


def test_functions_travel_with_the_map_as_far_as_the_bases_are_fine():
    same = np.arange(len(body()))
    C = functional_map(basis(), posed_basis(), same)
    functions = np.stack([body().vertices[:, 1], np.ones(len(body()))], axis=1)
    got = transferred(C, basis(), posed_basis(), functions)
    assert np.abs(got[:, 0] - functions[:, 0]).mean() < 0.02
    np.testing.assert_allclose(got[:, 1], 1.0, atol=1e-6)
    few = transferred(C[:10, :20], basis(), posed_basis(), functions)
    assert np.abs(few[:, 0] - functions[:, 0]).mean() > np.abs(got[:, 0] - functions[:, 0]).mean()


def test_wave_kernels_keep_to_the_body_and_not_to_the_pose():
    energies, width = shared_energies(basis(), posed_basis(), 30)
    one, other = (wave_kernel_signature(each, energies, width) for each in (basis(), posed_basis()))
    np.testing.assert_allclose(basis().masses @ one, 1.0, atol=1e-9)  # squares of normed functions, averaged
    apart = np.abs(one - other).mean() / np.abs(one - one.mean(axis=0)).mean()
    assert apart < 0.25


def test_descriptors_that_tell_all_vertices_apart_give_the_true_map():
    places = body().vertices - body().vertices.mean(axis=0)
    tellers = np.concatenate(
        [places, places**2, places**3, places[:, [0]] * places[:, [1, 2]], np.sin(9 * places)], axis=1
    )
    C = map_from_descriptors(basis().first(12), posed_basis().first(12), tellers, tellers, commutativity=1e-4)
    true = functional_map(basis().first(12), posed_basis().first(12), np.arange(len(body())))
    assert np.abs(C - true).max() < 0.1
    stiff = map_from_descriptors(
        basis().first(12), basis().first(12), tellers[:, :1], tellers[:, :1], commutativity=1e6
    )
    assert np.abs(stiff - np.diag(np.diag(stiff))).max() < 1e-3  # commuting alone is diagonal


def test_what_does_not_belong_together_is_refused():
    with pytest.raises(RetargetError, match=f"the target {len(body())}"):
        functional_map(basis(), basis(), np.arange(10))
    with pytest.raises(RetargetError, match=f"names vertices 1 to {len(body())}"):
        functional_map(basis(), basis(), np.arange(1, len(body()) + 1))
    with pytest.raises(RetargetError, match="must grow"):
        zoomout(basis(), basis(), np.eye(10), [12, 12])
    with pytest.raises(RetargetError, match="40 functions at most"):
        zoomout(basis(), basis(), np.eye(10), [41])
    with pytest.raises(RetargetError, match="3 descriptors on the template, 2"):
        map_from_descriptors(basis(), basis(), body().vertices, body().vertices[:, :2])
