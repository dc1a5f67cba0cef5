"""Fewer vertices for all of a skin."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.contact.thinned import USUAL, thinned_skin


@pytest.fixture
def skin():
    return np.random.default_rng(2).uniform(size=(500, 3))


def test_kept_vertices_are_apart_and_stand_for_all(skin):
    chosen = np.arange(0, 500, 2)
    thinned = thinned_skin(skin, chosen, 0.1)
    assert 20 < len(thinned.kept) < 200 and set(thinned.kept) <= set(chosen)
    apart = np.linalg.norm(skin[thinned.kept][:, None] - skin[thinned.kept], axis=-1)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 0.1
    assert thinned.stands_for.sum() == pytest.approx(USUAL)
    assert (np.flatnonzero(thinned.stands_for) == np.sort(thinned.kept)).all()


def test_depths_behind_a_plane_are_known_everywhere(skin):
    """Below a tilted plane every vertex is as deep as its kept neighbours tell, and nothing is known of the rest."""
    thinned = thinned_skin(skin, np.arange(500), 0.1)
    normal = np.array([0.6, 0.8, 0.0])
    depth = 0.7 - skin @ normal
    known = np.full(500, -np.inf)
    known[thinned.kept] = depth[thinned.kept]
    normals = np.zeros((500, 3))
    normals[thinned.kept] = normal
    assert thinned.depths(known, normals, skin) == pytest.approx(depth)
    one = np.full(500, -np.inf)
    one[thinned.kept[0]] = 0.01
    found = thinned.depths(one, normals, skin)
    assert (np.isfinite(found) == (thinned.nearest == thinned.kept[0])).all() and 0 < np.isfinite(found).sum() < 100


def test_without_spacing_all_are_kept_and_without_vertices_none(skin):
    assert len(thinned_skin(skin, np.arange(500), 0.0).kept) == 500
    assert len(thinned_skin(skin, np.arange(0), 0.1).kept) == 0
