"""Weights: few, summing to one, without leaks where parts touch."""

import numpy as np
import pytest
from rig_bodies import case

from retarget.body.human import human
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.geometry.topology import vertex_normals
from retarget.rig.fit import prepare_skin
from retarget.rig.registration import Registered, register
from retarget.rig.templates import human_template
from retarget.rig.weights import finer_places, places_on_template, rigid_pieces, sparse_weights


def exact(seed):
    """The truth of a case as a registration, in metres."""
    truth, faces = case(seed), human_template().faces
    posed = truth.posed / truth.scale
    found = np.ones(len(posed), dtype=bool)
    return Registered(posed, vertex_normals(posed, faces), found), Surface(
        truth.mesh.vertices / truth.scale, truth.mesh.faces
    )


@pytest.mark.parametrize("seed", [6, 24, 12, 28])
def test_places_are_right_where_hands_and_legs_touch(seed):
    """Arms crossed (twice), hands clapped, legs crossed."""
    truth, template = case(seed), human_template()
    registered, mesh = exact(seed)
    rest = template.model.points
    found = places_on_template(mesh, registered, template.faces, rest).of(rest)
    away = np.linalg.norm(found - truth.places.of(rest), axis=1)[truth.body]
    assert np.percentile(away, 99.5) < 0.03


def test_a_patch_across_a_leak_is_placed_beside_its_neighbours():
    """A palm's worth of the hip laid onto the hand, as where a hand rests on it, goes back to the hip."""
    template, body = human_template(), human(height=1.7).mesh
    rest = template.model.points
    posed = rest.copy()
    hand = np.flatnonzero(template.model.weights[:, template.names.index("leftHand")] > 0.9)
    hip = np.argmin(np.linalg.norm(rest - rest[hand].mean(axis=0) * [0.3, 1.0, 1.0], axis=1))
    posed[hand] += rest[hip] - rest[hand].mean(axis=0)  # the hand lies in the hip
    registered = Registered(posed, vertex_normals(posed, template.faces), np.ones(len(posed), dtype=bool))
    hips = Surface(rest, body.faces)  # a mesh whose hand is elsewhere
    found = places_on_template(hips, registered, template.faces, rest).of(rest)
    near = np.linalg.norm(rest - rest[hip], axis=1) < 0.06
    assert np.linalg.norm(found - rest, axis=1)[near].max() < 0.15


def test_four_joints_a_vertex_the_heaviest_first():
    draw = np.random.default_rng(0)
    weights = draw.dirichlet(np.full(30, 0.2), size=200)
    columns, kept = sparse_weights(weights)
    assert columns.shape == (200, 4) and np.allclose(kept.sum(axis=1), 1) and (kept >= 0).all()
    assert (np.diff(kept, axis=1) <= 1e-12).all()
    assert np.array_equal(columns[:, 0], weights.argmax(axis=1))


def test_fewer_joints_than_four():
    columns, kept = sparse_weights(np.array([[0.25, 0.75], [1.0, 0.0]]))
    assert columns.tolist() == [[1, 0], [0, 0]] and kept.tolist() == [[0.75, 0.25], [1.0, 0.0]]


def test_small_pieces_move_as_one():
    body = human().mesh
    eye = 0.012 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + [0.03, 1.6, 0.1]
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Surface(np.concatenate([body.vertices, eye]), np.concatenate([body.faces, faces + len(body.vertices)]))
    weights = np.random.default_rng(1).dirichlet([1, 1, 1], size=len(mesh))
    found = rigid_pieces(mesh, weights, np.zeros(len(mesh)))
    assert np.ptp(found[-4:], axis=0).max() == 0 and np.allclose(found[-1], weights[-4:].mean(axis=0))
    assert np.array_equal(found[:-4], weights[:-4])


def test_what_a_hand_holds_moves_as_the_part_next_to_the_hand():
    body = human().mesh
    stick = np.stack([np.full(40, 0.6), np.linspace(0.9, 1.9, 40), np.full(40, 0.05)], axis=1)
    stick[::2, 0] += 0.01
    faces = np.stack([np.arange(38), np.arange(1, 39), np.arange(2, 40)], axis=1)
    mesh = Surface(np.concatenate([body.vertices, stick]), np.concatenate([body.faces, faces + len(body.vertices)]))
    weights = np.random.default_rng(1).dirichlet([1, 1, 1], size=len(mesh))
    away = np.concatenate([np.zeros(len(body.vertices)), np.linspace(0.0, 1.0, 40)])
    found = rigid_pieces(mesh, weights, away)
    assert np.allclose(found[-40:], weights[-40:-36].mean(axis=0))
    assert np.array_equal(found[:-40], weights[:-40])


def test_laying_on_ends_on_the_surface():
    truth = case(6)
    registered, mesh = exact(6)
    moved = registered.vertices + 0.01 * np.sin(registered.vertices * 9)[:, ::-1]
    found = register(moved, human_template().faces, prepare_skin(mesh))
    from retarget.geometry.closest import SurfaceIndex

    index = SurfaceIndex(mesh.vertices, mesh.faces)
    away = np.linalg.norm(index.closest(found.vertices).of(mesh.vertices) - found.vertices, axis=1)
    before = np.linalg.norm(index.closest(moved).of(mesh.vertices) - moved, axis=1)
    assert away.mean() < 0.15 * before.mean() and found.found.mean() > 0.95
    assert isinstance(truth.places, Places)


def test_a_map_is_followed_within_faces_and_not_where_it_jumps():
    rest = human_template().model.points
    faces = human_template().faces[:3]
    found = Places(faces, np.full((3, 3), 1 / 3))
    far = human_template().faces[-1]
    known = Places(np.stack([faces[0], far, faces[2]]), np.array([[0.2, 0.3, 0.5], [0.2, 0.3, 0.5], [1.0, 0.0, 0.0]]))
    places = finer_places(known, found, rest)
    assert np.allclose(places.weights, [[0.2, 0.3, 0.5], [1 / 3] * 3, [1 / 3] * 3])
    assert np.array_equal(places.corners, faces)
