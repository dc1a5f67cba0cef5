"""Surfaces with another number of triangles: what slow methods work on, whatever the file holds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.geometry.topology import distinct, pieces, proper, unique_pairs, weld

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices and faces, nothing else."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def leaders(self) -> Int[Array, "vertices"]:
        """For each vertex the first one at its place (`weld`)."""
        return weld(self.vertices)


def decimate(surface: Surface, vertices: int) -> Surface:
    """At most about so many vertices, by quadric edge collapse; a smaller surface comes back as it is."""
    if len(surface) <= vertices:
        return surface
    import fast_simplification

    wanted = max(4, round(len(surface.faces) * vertices / len(surface)))
    points, faces = fast_simplification.simplify(
        surface.vertices.astype(np.float32), surface.faces.astype(np.int32), target_count=wanted
    )
    return cleaned(Surface(points.astype(np.float64), faces.astype(np.int64)))


def subdivide(surface: Surface) -> tuple[Surface, Any]:
    """Four faces in place of each, at the middles of edges, and the sparse matrix (new x old vertices) that places the new
    vertices, which come after the old ones."""
    from scipy.sparse import csr_matrix, identity, vstack

    faces, count = surface.faces, len(surface)
    edges, inverse, _ = unique_pairs(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))
    ab, bc, ca = (inverse.reshape(-1, 3) + count).T
    a, b, c = faces.T
    split = np.concatenate(
        [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    rows = np.repeat(np.arange(len(edges)), 2)
    middles = csr_matrix((np.full(edges.size, 0.5), (rows, edges.ravel())), shape=(len(edges), count))
    placing = vstack([identity(count, format="csr"), middles]).tocsr()
    return Surface(placing @ surface.vertices, split), placing


def cleaned(surface: Surface) -> Surface:
    """The same without faces of no area, faces that come twice and vertices that no face uses; copies of one place are one
    vertex."""
    leader = surface.leaders
    faces = leader[surface.faces]
    faces = faces[proper(faces)]
    faces = faces[distinct(faces)]
    used, packed = np.unique(faces, return_inverse=True)
    return Surface(surface.vertices[used], packed.reshape(-1, 3).astype(np.int64))


def largest_pieces(surface: Surface) -> list[Surface]:
    """The connected pieces, the one with the largest area first."""
    from retarget.geometry.topology import areas

    label = pieces(surface.faces, len(surface))
    size = np.bincount(label, weights=areas(surface.vertices, surface.faces))
    rank = np.empty(len(size), dtype=np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    owner = np.full(len(surface), len(size))
    owner[surface.faces] = rank[label][:, None]
    # All pieces are packed at once: a soup of a million pieces would otherwise be gone through a million times.
    order, number = np.argsort(owner, kind="stable"), np.empty(len(surface), dtype=np.int64)
    starts = np.searchsorted(owner[order], np.arange(len(size) + 1))
    number[order] = np.arange(len(surface)) - starts[owner[order]]
    mine = np.argsort(rank[label], kind="stable")
    ends = np.searchsorted(rank[label][mine], np.arange(len(size) + 1))
    vertices, faces = surface.vertices[order], number[surface.faces[mine]]
    return [
        Surface(vertices[starts[piece] : starts[piece + 1]], faces[ends[piece] : ends[piece + 1]])
        for piece in range(len(size))
    ]
