"""A body's skin by fewer vertices, evenly spread: hands and faces have many more than contacts need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

USUAL = 6900
"""Vertices of the embedded human: points are counted as if every body had as many."""


@dataclass(frozen=True, eq=False)
class ThinnedSkin:
    """Some of a body's vertices for all of them; `thinned_skin` makes one."""

    kept: Int[Array, "kept"]
    stands_for: Float[Array, "vertices"]
    """How many vertices of a body of `USUAL` ones each kept vertex stands for; 0 for the others."""
    nearest: Int[Array, "vertices"]
    """The kept vertex that each vertex is nearest to at rest."""

    def depths(
        self,
        depth: Float[Array, "vertices"],
        normals: Float[Array, "vertices 3"],
        posed: Float[Array, "vertices 3"],
    ) -> Float[Array, "vertices"]:
        """How deep all vertices are inside something, from how deep kept ones are (metres, `-inf` for those that nothing is
        known of) and its normals there: to first order, as if its surface were flat between them."""
        known = np.isfinite(depth[self.nearest])
        nearest = self.nearest[known]
        found = np.full(len(posed), -np.inf)
        found[known] = depth[nearest] - ((posed[known] - posed[nearest]) * normals[nearest]).sum(axis=1)
        return found


def thinned_skin(
    rest: Float[Array, "vertices 3"], chosen: Int[Array, "chosen"], spacing: float
) -> ThinnedSkin:
    """Keep so few of the `chosen` vertices that no two are closer than `spacing` (metres), in their order. Where none are
    chosen, none are kept."""
    from scipy.spatial import cKDTree

    places = rest[chosen]
    if len(chosen) == 0:
        return ThinnedSkin(chosen, np.zeros(len(rest)), np.zeros(len(rest), dtype=np.int64))
    near = cKDTree(places).query_ball_point(places, spacing)
    open_ = np.ones(len(chosen), dtype=bool)
    first = []
    for number, others in enumerate(near):
        if open_[number]:
            first.append(number)
            open_[others] = False
    kept = chosen[first]
    nearest = kept[cKDTree(rest[kept]).query(rest)[1]]
    stands_for = np.zeros(len(rest))
    np.add.at(stands_for, nearest[chosen], USUAL / len(chosen))
    return ThinnedSkin(kept, stands_for, nearest)
