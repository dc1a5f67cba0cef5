"""One body's shape in another's pose: the target's own edges, turned as the source's surface has turned.

After Basset 2019, section 4.1: near-isometric change is pose, all else is shape. The paper walks every vertex to its place in
a local frame, some hundred times, and low frequencies never arrive. Here the rotation R of every vertex is read off the source
(rest to posed), and one linear system finds the vertices whose edges differ least from those wanted (gradient-domain
deformation, Sorkine and Alexa 2007). Integrating the paper's rotated Laplacian offsets directly was 10 % off in limbs.

A posed surface is near-isometric only: skin stretches at joints, and with edges that are turned alone a body in its own pose
came out 13 mm off (root mean square; its arms up to 32), since every path into a limb leads over such skin. So the edge wanted is

    ratio (source's posed edge) + R (target's rest edge - ratio source's rest edge)

with `ratio` that of their lengths at rest: the source's own edges wherever the shapes agree, turned ones where they do not.
The same body gives the same pose, exactly, and other bodies lie closer to what skinning makes of the same motion (very heavy:
17 mm instead of 32, child 7 instead of 16; figures of arms on hips). What skin stretches by is then the source's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.errors import RetargetError
from retarget.geometry.cholesky import Factor, factor
from retarget.geometry.topology import adjacency, pieces, proper

Array = np.ndarray

FLATNESS = 0.5
"""What a vertex's normal counts in its rotation, over its edges."""
ANCHOR = 1e-8
"""Weight of every vertex's place, over an edge's: the graph leaves one translation free. With 1e-4, the graph's lowest
frequencies, whose eigenvalues are not much larger, came out 7 cm too short."""
LONGEST = 3.0
"""How many times the median an edge's ratio may be: edges that have no length on the source would stretch without bounds."""
BRIDGES = 6
"""Vertices of a separate piece (an eye, a shoe) that are tied to what is nearest at rest."""


@dataclass(frozen=True, eq=False)
class IsometricShape:
    """A target prepared for one source; `prepare_isometric` makes one."""

    source: Float[Array, "vertices 3"]
    target: Float[Array, "vertices 3"]
    """Both at rest, metres, vertex for vertex."""
    faces: Int[Array, "faces 3"]
    """Those that the source has, over welded vertices."""
    normals: Float[Array, "vertices 3"]
    """Of the source, at rest."""
    starts: Int[Array, "_"]
    """First entry of each vertex in `others`, and the end."""
    others: Int[Array, "entries"]
    """Neighbours along edges and bridges."""
    ratios: Float[Array, "entries"]
    """Length of the target's edge over the source's, at rest; 0 for an edge that the source does not have."""
    shape: Float[Array, "entries 3"]
    """The target's edge at rest less the source's times its ratio, metres: what turns."""
    donors: Int[Array, "vertices"]
    """Whose rotation each vertex has: its own, or that of the nearest vertex that the source has too."""
    laplacian: Factor
    welded: Int[Array, "vertices"]
    """The first vertex at each vertex's place at rest."""

    def posed(self, source: Float[Array, "vertices 3"]) -> Float[Array, "vertices 3"]:
        """The target in the pose of the source's `source` (metres), its centre at the origin. What is not finite in makes all
        not finite."""
        from retarget.geometry import turn_kernels as kernels

        count = len(self.target)
        normals, turns, mean, edges = (
            np.empty((count, 3)),
            np.zeros((count, 4)),
            np.empty((count, 4)),
            np.empty((count, 3)),
        )
        turns[:, 3] = 1.0
        matrices = np.empty((count, 3, 3))
        kernels.normals(source, self.faces, normals)
        kernels.vertex_turns(
            self.source,
            self.normals,
            source,
            normals,
            self.starts,
            self.others,
            self.ratios,
            FLATNESS,
            self.donors,
            turns,
        )
        kernels.mean_turns(turns, self.starts, self.others, mean)
        kernels.turned_edges(mean, self.shape, self.ratios, source, self.starts, self.others, matrices, edges)
        return self._solved(edges)[self.welded]

    def _solved(self, edges: Float[Array, "vertices 3"]) -> Float[Array, "vertices 3"]:
        """Edges sum to nothing over the graph, so the anchor at the origin moves nothing but the centre."""
        found = self.laplacian.solve(edges)
        return found - found.mean(axis=0)


def prepare_isometric(
    source: Float[Array, "vertices 3"],
    target: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    welded: Int[Array, "vertices"],
    known: Bool[Array, "vertices"] | None = None,
) -> IsometricShape:
    """Prepare two rest shapes (metres) with the same vertices. `welded` names the first vertex at each one's place; `known`
    which vertices the source has at all (None: every one), the others turn with the nearest that it has.

    Raises `RetargetError` for shapes of different size, that are not finite, or of which the source has nothing.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise RetargetError(f"the two shapes must have the same vertices, received {source.shape} and {target.shape}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise RetargetError("a vertex at rest lies nowhere (a coordinate is not finite)")
    from scipy import sparse
    from scipy.sparse.csgraph import dijkstra

    from retarget.geometry import turn_kernels as kernels

    faces = np.ascontiguousarray(welded[faces])
    faces = faces[proper(faces)]
    if len(faces) == 0:
        raise RetargetError("the surface has no faces; a shape is carried along its edges")
    count = len(target)
    bridges = _bridges(target, faces, np.flatnonzero(welded == np.arange(count)))
    graph = adjacency(np.concatenate([faces, bridges[:, [0, 1, 1]]]), count)
    degree = np.asarray(graph.sum(axis=1)).ravel()
    donors, told = np.arange(count), faces
    if known is not None and not known.all():
        told = faces[known[faces].all(axis=1)]
        sources = np.unique(told)
        if len(sources) == 0:
            raise RetargetError("no vertex of the target has a place on the source")
        _, _, donors = dijkstra(
            graph, directed=False, indices=sources, min_only=True, return_predecessors=True, unweighted=True
        )
        donors = np.where(donors >= 0, donors, np.arange(count))
    starts, others = graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
    rows = np.repeat(np.arange(count), np.diff(starts))
    source, target = np.ascontiguousarray(source, np.float64), np.ascontiguousarray(target, np.float64)
    before, after = source[rows] - source[others], target[rows] - target[others]
    ratios = _ratios(before, after, (donors[rows] == rows) & (donors[others] == others))
    normals = np.empty((count, 3))
    kernels.normals(source, told, normals)
    matrix = sparse.diags_array(degree + ANCHOR) - graph
    return IsometricShape(
        source, target, told, normals, starts, others, ratios, after - ratios[:, None] * before,
        donors.astype(np.int64), factor(matrix), welded,
    )  # fmt: skip


def _ratios(
    before: Float[Array, "entries 3"], after: Float[Array, "entries 3"], known: Bool[Array, "entries"]
) -> Float[Array, "entries"]:
    lengths, own = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    known = known & (lengths > 0)
    ratios = np.where(known, own / np.where(known, lengths, 1.0), 0.0)
    return np.minimum(ratios, LONGEST * np.median(ratios[known])) if known.any() else ratios


def _bridges(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], firsts: Int[Array, "different"]
) -> Int[Array, "bridges 2"]:
    """Edges that tie every piece to the nearest of those that are larger, and what no face names (of `firsts`, the vertices
    that are not another's copy) to the vertex nearest to it, so that the graph is one."""
    from scipy.spatial import cKDTree

    piece = pieces(faces, len(vertices))
    owner = np.full(len(vertices), -1)
    owner[faces] = piece[:, None]
    order = np.argsort(-np.bincount(owner[owner >= 0]), kind="stable")
    found = [np.zeros((0, 2), dtype=np.int64)]
    joined = np.flatnonzero(owner == order[0])
    for number in order[1:]:
        own = np.flatnonzero(owner == number)
        distance, nearest = cKDTree(vertices[joined]).query(vertices[own])
        chosen = np.argsort(distance, kind="stable")[:BRIDGES]
        found.append(np.stack([own[chosen], joined[nearest[chosen]]], axis=1))
        joined = np.concatenate([joined, own])
    loose = firsts[owner[firsts] < 0]
    if len(loose):
        found.append(np.stack([loose, joined[cKDTree(vertices[joined]).query(vertices[loose])[1]]], axis=1))
    return np.concatenate(found)
