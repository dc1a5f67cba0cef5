"""A body's skin by fewer vertices, evenly spread: hands and faces have many more than contacts need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

USUAL = 6900
"""Vertices of the embedded human: points are counted as if every body had as many."""
AMONG = 3
"""Kept vertices that a value is interpolated from."""


@dataclass(frozen=True, eq=False)
class ThinnedSkin:
    """Some of a body's vertices for all of them; `thinned_skin` makes one."""

    kept: Int[Array, "kept"]
    stands_for: Float[Array, "vertices"]
    """How many vertices of a body of `USUAL` ones each kept vertex stands for; 0 for the others."""
    nearest: Int[Array, "vertices among"]
    """The kept vertices that each vertex is nearest to at rest."""
    shares: Float[Array, "vertices among"]
    """Of those, by their nearness; rows sum to 1."""

    def spread(self, values: Float[Array, "vertices"]) -> Float[Array, "vertices"]:
        """A value of the kept vertices on all of them."""
        return (values[self.nearest] * self.shares).sum(axis=1)


def thinned_skin(
    rest: Float[Array, "vertices 3"], chosen: Int[Array, "chosen"], spacing: float
) -> ThinnedSkin:
    """Keep so few of the `chosen` vertices that no two are closer than `spacing` (metres), in their order. Where none are
    chosen, none are kept."""
    from scipy.spatial import cKDTree

    places = rest[chosen]
    if len(chosen) == 0:
        return ThinnedSkin(chosen, np.zeros(len(rest)), np.zeros((len(rest), 1), dtype=np.int64), np.ones((len(rest), 1)))
    near = cKDTree(places).query_ball_point(places, spacing)
    open_ = np.ones(len(chosen), dtype=bool)
    first = []
    for number, others in enumerate(near):
        if open_[number]:
            first.append(number)
            open_[others] = False
    kept = chosen[first]
    distance, place = cKDTree(rest[kept]).query(rest, k=min(AMONG, len(kept)))
    distance, place = distance.reshape(len(rest), -1), place.reshape(len(rest), -1)
    shares = 1.0 / np.maximum(distance, 1e-6)
    stands_for = np.zeros(len(rest))
    np.add.at(stands_for, kept[place[chosen, 0]], USUAL / len(chosen))
    return ThinnedSkin(kept, stands_for, kept[place], shares / shares.sum(axis=1, keepdims=True))
