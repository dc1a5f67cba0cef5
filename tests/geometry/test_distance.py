"""Distances along edges."""

import numpy as np
import pytest
from made_bodies import joined, sheet
from made_motions import body

from retarget.geometry.distance import distance_along_edges, edge_graph, within


def test_a_straight_way_is_exact_and_a_crooked_one_longer():
    vertices, faces = sheet([0, 0, 0], [2, 0, 0], [0, 1, 0.0], rows=11, columns=21)
    found = distance_along_edges(edge_graph(vertices, faces), np.array([0]), np.inf)
    straight = np.linalg.norm(vertices - vertices[0], axis=1)
    along_x = vertices[:, 1] == 0
    assert found[along_x] == pytest.approx(straight[along_x])
    assert (found >= straight - 1e-12).all()
    assert (found <= 1.42 * straight + 1e-12).all()


def test_edges_are_told_once_and_in_both_directions():
    vertices, faces = sheet([0, 0, 0], [1, 0, 0], [0, 1, 0.0], rows=3, columns=3)
    faces = np.concatenate([faces, faces[:, ::-1], [[0, 0, 1]]])
    graph = edge_graph(vertices, faces).toarray()
    assert np.array_equal(graph, graph.T) and (np.diag(graph) == 0).all()
    assert graph[0, 1] == pytest.approx(0.5) and graph.max() == pytest.approx(np.sqrt(0.5))


def test_beyond_the_limit_and_beyond_the_piece_is_infinitely_far():
    vertices, faces = joined(sheet([0, 0, 0], [1, 0, 0], [0, 1, 0.0]), sheet([0, 0, 0.1], [1, 0, 0], [0, 1, 0.0]))
    graph = edge_graph(vertices, faces)
    found = distance_along_edges(graph, np.array([0]), 0.5)
    assert (found[np.isfinite(found)] <= 0.5).all() and np.isinf(found[144:]).all()
    assert np.isinf(distance_along_edges(graph, np.array([], dtype=int), 1.0)).all()
    assert not within(graph, np.array([], dtype=int), 1.0).any()


def test_a_bridge_joins_pieces_and_the_shortest_counts():
    vertices, faces = joined(sheet([0, 0, 0], [1, 0, 0], [0, 1, 0.0]), sheet([0, 0, 0.1], [1, 0, 0], [0, 1, 0.0]))
    bridges = np.array([[144, 0], [0, 144], [0, 144], [0, 1]])
    found = distance_along_edges(
        edge_graph(vertices, faces, bridges, np.array([0.7, 0.3, 0.5, 9.0])), np.array([0]), np.inf
    )
    assert found[144] == pytest.approx(0.3) and found[1] == pytest.approx(1 / 11)
    assert found[144 + 11] == pytest.approx(0.3 + 1)


def test_more_sources_and_wider_limits_reach_more():
    character = body("average")
    graph = edge_graph(character.mesh.vertices, character.mesh.faces)
    few, many = np.array([0, 100]), np.arange(0, 6000, 500)
    near = within(graph, few, 0.1)
    assert near[few].all() and 2 < near.sum() < len(near) / 2
    assert within(graph, few, 0.2)[near].all() and within(graph, np.union1d(few, many), 0.1)[near].all()
