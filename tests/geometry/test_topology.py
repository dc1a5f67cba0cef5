"""Welding, pieces, rims and closing: what holds for every set of triangles."""

from itertools import combinations

import numpy as np
import pytest
from made_bodies import ball, box, joined, sheet, tube
from made_motions import body

from retarget.body.human import human_model, textured
from retarget.geometry.topology import (
    areas,
    closing_fans,
    distinct,
    is_oriented,
    pieces,
    proper,
    rim_edges,
    signed_volume,
    unique_pairs,
    weld,
)


def closed(vertices, faces):
    """The surface with its fans."""
    caps, rims = closing_fans(faces, len(vertices))
    centres = [vertices[rim].mean(axis=0) for rim in rims]
    return np.concatenate([vertices, *(centre[None] for centre in centres)]), np.concatenate([faces, caps])


def faces_of_each_edge(faces):
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def test_copies_along_texture_seams_are_welded():
    character, model = body("average"), human_model()
    copies = textured(character)
    assert len(copies.mesh.vertices) > len(character.mesh.vertices)
    welded = weld(copies.mesh.vertices)
    assert len(np.unique(welded)) == len(character.mesh.vertices)
    corners = welded[copies.mesh.faces]
    assert len(rim_edges(corners)) == 0, "closed again"
    assert np.array_equal(copies.mesh.vertices[corners], character.mesh.vertices[model.faces])


def test_welding_names_the_first_of_each_place_and_is_idempotent():
    rng = np.random.default_rng(0)
    places = rng.normal(size=(50, 3))
    which = rng.integers(50, size=400)
    welded = weld(places[which])
    assert (welded <= np.arange(400)).all() and np.array_equal(welded[welded], welded)
    assert np.array_equal(which[welded], which)
    assert len(np.unique(welded)) == len(np.unique(which))


def test_copies_that_differ_in_the_last_bits_are_welded_wherever_they_lie():
    rng = np.random.default_rng(1)
    places = rng.normal(size=(3000, 3))
    extent = np.ptp(places, axis=0).max()
    shaken = places + rng.uniform(-1, 1, size=places.shape) * 2e-7 * extent
    welded = weld(np.concatenate([places, shaken]))
    assert np.array_equal(welded, np.tile(np.arange(3000), 2))


def test_places_further_apart_or_with_other_attributes_stay():
    places = np.array([[0.0, 0, 0], [1, 0, 0], [3e-6, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert weld(places).tolist() == [0, 1, 2, 0, 0]
    attributes = np.array([[1.0, 0], [1, 0], [1, 0], [0, 1], [0.9999, 0.0001]])
    assert weld(places, attributes).tolist() == [0, 1, 2, 3, 0]
    assert weld(np.zeros((0, 3))).tolist() == [] and weld(np.ones((4, 3))).tolist() == [0, 0, 0, 0]


def test_faces_that_count():
    faces = np.array([[0, 1, 2], [2, 1, 0], [1, 2, 0], [0, 1, 1], [3, 1, 0]])
    assert proper(faces).tolist() == [True, True, True, False, True]
    assert distinct(faces).tolist() == [True, False, False, True, True]


def test_orientation():
    _, faces = ball(6, 8)
    assert is_oriented(faces) and is_oriented(faces[10:]) and is_oriented(faces[:, ::-1])
    turned = faces.copy()
    turned[::3] = turned[::3, ::-1]
    assert not is_oriented(turned)
    assert is_oriented(np.concatenate([faces, faces[:, ::-1]])), "both sides of a sheet"


def test_pieces_are_numbered_as_they_come():
    _, faces = joined(ball(6, 8), box([0, 0, 0], [1, 1, 1]), ball(4, 5))
    order = np.random.default_rng(2).permutation(len(faces))
    number = pieces(faces[order], int(faces.max()) + 1)
    assert sorted(set(number.tolist())) == [0, 1, 2]
    assert np.array_equal(np.unique(number, return_index=True)[1], np.sort(np.unique(number, return_index=True)[1]))
    of_vertex = np.repeat([0, 1, 2], [8 * 5 + 2, 8, 5 * 3 + 2])[faces[order][:, 0]]
    for one, other in combinations(range(3), 2):
        assert set(number[of_vertex == one]).isdisjoint(number[of_vertex == other])
    assert len(pieces(faces[:0], 5)) == 0


def test_a_closed_surface_has_no_rim_and_an_open_one_runs_along_it():
    vertices, faces = box([0, 0, 0], [1, 2, 3])
    assert len(rim_edges(faces)) == 0 and len(closing_fans(faces, 8)[0]) == 0
    lid = faces[2:]  # the two triangles of z = 0 taken away
    edges = rim_edges(lid)
    assert {tuple(edge) for edge in edges.tolist()} == {(1, 0), (0, 2), (2, 3), (3, 1)} or {
        tuple(edge) for edge in edges.tolist()
    } == {(0, 1), (1, 3), (3, 2), (2, 0)}
    directed = {tuple(edge) for face in lid.tolist() for edge in zip(face, face[1:] + face[:1])}
    assert all(tuple(edge) in directed for edge in edges.tolist()), "each along its face"


@pytest.mark.parametrize("seed", range(6))
def test_fans_make_every_edge_even_whatever_the_surface(seed):
    """Random triangles of a body, and random triangles over few vertices: non-manifold edges, rims that touch."""
    rng = np.random.default_rng(seed)
    faces = human_model().faces
    some = faces[rng.random(len(faces)) < rng.uniform(0.1, 0.95)]
    wild = rng.integers(12, size=(40, 3))
    for surface, count in ((some, int(faces.max()) + 1), (wild[proper(wild)], 12)):
        caps, rims = closing_fans(surface, count)
        assert len(rims) == (int(caps[:, 2].max()) + 1 - count if len(caps) else 0)
        assert (faces_of_each_edge(np.concatenate([surface, caps])) % 2 == 0).all()
        for number, rim in enumerate(rims):
            assert np.array_equal(np.unique(caps[caps[:, 2] == count + number][:, :2]), rim)


def test_rims_that_do_not_touch_get_centres_of_their_own_and_close_outward():
    vertices, faces = joined(tube([0, 0, 0], [0, 3, 0], 0.5), tube([5, 0, 0], [5, 3, 0], 0.5))
    assert len(closing_fans(faces, len(vertices))[1]) == 4
    both, shut = closed(vertices, faces)
    assert is_oriented(shut)
    a_tube = 3.0 * 16 / 2 * 0.5**2 * np.sin(2 * np.pi / 16)  # a prism over a regular polygon
    assert abs(signed_volume(both, shut)) == pytest.approx(2 * a_tube, rel=1e-12)


def test_volume_and_area_of_a_box_and_a_ball():
    vertices, faces = box([1, 2, 3], [2, 4, 6.5])
    assert signed_volume(vertices, faces) == pytest.approx(1 * 2 * 3.5)
    assert signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-7.0)
    assert areas(vertices, faces).sum() == pytest.approx(2 * (2 + 3.5 + 7))
    vertices, faces = ball(96, 192, 0.7)
    assert signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=1e-3)
    assert areas(vertices, faces).sum() == pytest.approx(4 * np.pi * 0.7**2, rel=1e-3)
    batch = np.stack([vertices, 2 * vertices + [3, 1, 4]])
    assert signed_volume(batch, faces)[1] == pytest.approx(8 * signed_volume(batch, faces)[0])
    assert areas(batch, faces).shape == (2, len(faces))


def test_the_parts_of_a_body_add_up_to_it():
    """Fans over a seam serve the parts on its both sides once each, turned over: they cancel."""
    model, vertices = human_model(), body("heavy").mesh.vertices
    whole = float(signed_volume(vertices, model.faces))
    parts = [float(signed_volume(*closed(vertices, model.faces[model.face_parts == part]))) for part in range(17)]
    assert len(parts) == 17 and min(parts) > 0
    assert sum(parts) == pytest.approx(whole, rel=1e-9) and 0.05 < whole < 0.2


def test_a_flat_sheet_encloses_nothing():
    vertices, faces = closed(*sheet([0, 0, 0], [1, 0, 0], [0, 1, 0.0]))
    assert abs(signed_volume(vertices, faces)) < 1e-12


def test_unique_pairs_are_those_of_unique_rows():
    pairs = np.random.default_rng(4).integers(0, 9, size=(60, 2)).astype(np.int32)
    for own, wanted in zip(unique_pairs(pairs), np.unique(pairs, axis=0, return_inverse=True, return_counts=True)):
        assert np.array_equal(own, wanted.reshape(own.shape))
    assert [len(each) for each in unique_pairs(pairs[:0])] == [0, 0, 0]
