"""Weights where neighbours on the mesh were placed far apart on the template: they are filled in from around.

Such places are wrong on one side or the other (a ball joint whose halves went to two limbs, toes beside a sole), and any motion
tears the edge between. Harmonic weights over the mesh's own edges have no such jumps. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.geometry.resample import Surface
from retarget.rig.fit import HEIGHT
from retarget.rig.weights import welded_edges

Array = np.ndarray

STRETCHED, APART = 2.0, 0.01 * HEIGHT
"""An edge is stretched whose ends' places on the template are further apart than this many times its length and so many metres."""
LEAST = 1e-6
"""Weight of a vertex's own value beside one edge's: what has nothing around it keeps what it has."""


@dataclass(frozen=True, eq=False)
class Filling:
    """Vertices whose values are filled in from those around: `fill_stretched` makes one."""

    leader: Int[Array, "vertices"]
    """The vertex at each vertex's place that stands for it."""
    filled: Int[Array, "filled"]
    own: Any
    """Factor of the Laplacian over them."""
    around: Int[Array, "around"]
    """The vertices that they have edges to and that are not filled."""
    others: Any
    """Those edges (filled x around)."""
    changed: Int[Array, "changed"]
    """What has another value afterwards: the filled, and copies of other vertices, which take those' values."""

    def of(self, values: Float[Array, "vertices columns"]) -> Float[Array, "vertices columns"]:
        """The values with the filled ones replaced."""
        if not len(self.filled):
            return values
        known = self.others @ values[self.leader[self.around]] + LEAST * values[self.filled]
        found = values.copy()
        found[self.filled] = np.clip(self.own.solve(np.ascontiguousarray(known)), 0.0, None)
        found[self.changed] = found[self.leader[self.changed]]
        sums = values[self.changed].sum(axis=1, keepdims=True)
        found[self.changed] *= sums / np.maximum(found[self.changed].sum(axis=1, keepdims=True), 1e-12)
        return found


def fill_stretched(mesh: Surface, rest: Float[Array, "vertices 3"], rings: int = 0) -> Filling:
    """The ends of stretched edges, prepared to be filled in. `rest` are the vertices' places on the template; `rings` of
    vertices around are filled too."""
    from scipy.sparse import coo_matrix, diags, identity
    from scipy.sparse.linalg import splu

    leader, edges, lengths = welded_edges(mesh)
    apart = np.linalg.norm(rest[leader][edges[:, 0]] - rest[leader][edges[:, 1]], axis=1)
    stretched = apart > STRETCHED * lengths + APART
    if not stretched.any():
        nothing = np.zeros(0, dtype=np.int64)
        return Filling(leader, nothing, None, nothing, None, nothing)
    weight = 1.0 / np.maximum(lengths, 1e-3 * HEIGHT)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    graph = coo_matrix((np.tile(weight, 2), (rows, columns)), shape=(len(mesh), len(mesh))).tocsr()
    inside = np.zeros(len(mesh))
    inside[edges[stretched]] = 1.0
    for _ in range(rings):
        inside = inside + graph @ inside
    filled = np.flatnonzero(inside)
    among = graph[filled]
    own = diags(np.asarray(among.sum(axis=1)).ravel()) - among[:, filled] + LEAST * identity(len(filled))
    outside = np.ones(len(mesh))
    outside[filled] = 0.0
    around = np.flatnonzero(outside * (np.asarray(among.sum(axis=0)).ravel() > 0.0))
    changed = np.flatnonzero((inside[leader] > 0.0) | (leader != np.arange(len(mesh))))
    return Filling(leader, filled, splu(own.tocsc()), around, among[:, around], changed)
