"""What Basset 2019 calls shape: Laplacian offsets in local frames, and the volumes of the parts (sections 4.1 and 4.2).

Slips of the printed formulas, corrected: equation 2 subtracts the offset from the neighbours' mean, as here, but the text
then calls the desired position itself a direction: v + eps d(v) is read as v + eps (d(v) - v). The fifth term of the
tetrahedron's volume is -x_j y_i z_k, and its corners are O, v_i, v_j, v_k. The volume's direction n (V_T - V) multiplies a
unit vector with cubic metres: it is a length in metres only, so metres are taken as the paper's unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.evaluate.reference.part_tree import Solids
from retarget.geometry.topology import unique_pairs, vertex_normals

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class TargetShape:
    """The target's shape Omega, whatever the pose; `target_shape` makes one from the target at rest."""

    laplacian: Any
    """Sparse (vertices x vertices), `uniform_laplacian`."""
    corners: Int[Array, "faces 3"]
    neighbours: Int[Array, "vertices"]
    """The fixed neighbour of each vertex, by which its frame is turned."""
    offsets: Float[Array, "vertices 3"]
    """Omega: the Laplacian offset of each vertex in its own frame, metres."""

    def step(
        self, vertices: Float[Array, "vertices 3"]
    ) -> tuple[Float[Array, "vertices 3"], Float[Array, "vertices 3"]]:
        """d(v) - v of every vertex (equation 2; metres), and the normals there."""
        frames = local_frames(vertices, self.corners, self.neighbours)
        offsets = np.einsum("va,vai->vi", self.offsets, frames)
        return self.laplacian @ vertices - offsets, frames[:, 0]


def target_shape(rest: Float[Array, "vertices 3"], corners: Int[Array, "faces 3"]) -> TargetShape:
    """The shape of a body at rest (metres)."""
    laplacian = uniform_laplacian(corners, len(rest))
    neighbours = fixed_neighbours(rest, corners)
    offsets = np.einsum("vai,vi->va", local_frames(rest, corners, neighbours), laplacian @ rest)
    return TargetShape(laplacian, corners, neighbours, offsets)


def uniform_laplacian(corners: Int[Array, "faces 3"], vertices: int) -> Any:
    """Sparse L: the mean of a vertex's neighbours minus the vertex. Rows of vertices without neighbours are nought."""
    from scipy.sparse import csr_matrix, diags

    edges = _edges(corners)
    adjacent = csr_matrix((np.ones(len(edges)), edges.T), shape=(vertices, vertices))
    degree = np.asarray(adjacent.sum(axis=1)).ravel()
    return (diags(1.0 / np.maximum(degree, 1.0)) @ adjacent - diags((degree > 0).astype(float))).tocsr()


def fixed_neighbours(rest: Float[Array, "vertices 3"], corners: Int[Array, "faces 3"]) -> Int[Array, "vertices"]:
    """One neighbour of each vertex, itself where it has none. The paper takes any; ours is the one that lies the farthest
    off along the tangent plane at rest, so that its projection stays far from nought in other poses."""
    edges, normals = _edges(corners), vertex_normals(rest, corners)
    away = rest[edges[:, 1]] - rest[edges[:, 0]]
    across = np.linalg.norm(np.cross(away, normals[edges[:, 0]]), axis=1)
    order = np.lexsort((across, edges[:, 0]))
    chosen = np.arange(len(rest))
    chosen[edges[order, 0]] = edges[order, 1]  # the last of a vertex's edges, which lies the farthest, stays
    return chosen


def local_frames(
    vertices: Float[Array, "vertices 3"], corners: Int[Array, "faces 3"], neighbours: Int[Array, "vertices"]
) -> Float[Array, "vertices axes 3"]:
    """Normal, fixed neighbour projected onto its plane, and their cross product, each of length one (section 4.1). An axis
    that a degenerate neighbourhood leaves open is nought."""
    normal = vertex_normals(vertices, corners)
    away = vertices[neighbours] - vertices
    along = away - (away * normal).sum(axis=1, keepdims=True) * normal
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    return np.stack([normal, along, np.cross(normal, along)], axis=1)


def part_volumes(solids: Solids, vertices: Float[Array, "vertices 3"]) -> Float[Array, "parts"]:
    """Volume of each closed part, cubic metres: signed tetrahedra to the origin (section 4.2.1)."""
    points, (i, j, k) = np.ascontiguousarray(solids.points(vertices).T), solids.corners.T
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = points[:, i], points[:, j], points[:, k]
    tetrahedra = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return np.bincount(solids.owners, tetrahedra, solids.count) / 6.0


def volume_step(
    normals: Float[Array, "vertices 3"], vertex_parts: Int[Array, "vertices"], missing: Float[Array, "parts"]
) -> Float[Array, "vertices 3"]:
    """The volume's direction n (V_T - V) (section 5): the normal, times what volume the vertex's part lacks."""
    return normals * missing[vertex_parts, None]


def _edges(corners: Int[Array, "faces 3"]) -> Int[Array, "edges 2"]:
    """Every edge once in each direction, sorted by its start."""
    pairs = corners[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2)
    return unique_pairs(pairs[pairs[:, 0] != pairs[:, 1]])[0]
