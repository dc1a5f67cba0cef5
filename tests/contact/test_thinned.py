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


def test_values_spread_between_kept_vertices(skin):
    thinned = thinned_skin(skin, np.arange(500), 0.1)
    values = np.zeros(500)
    values[thinned.kept] = skin[thinned.kept, 0]
    spread = thinned.spread(values)
    assert np.abs(spread - skin[:, 0]).max() < 0.1
    assert spread[thinned.kept] == pytest.approx(skin[thinned.kept, 0], abs=1e-4)
    assert thinned.spread(np.ones(500)) == pytest.approx(np.ones(500))


def test_without_spacing_all_are_kept_and_without_vertices_none(skin):
    assert len(thinned_skin(skin, np.arange(500), 0.0).kept) == 500
    assert len(thinned_skin(skin, np.arange(0), 0.1).kept) == 0
