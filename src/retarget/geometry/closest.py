"""The nearest place on a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

CANDIDATES = 8
"""Faces tried for each point: those with the nearest centroids, and the faces around the nearest vertex."""


CHUNK = 1_000
"""Points searched at once: what is worked on stays in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Places:
    """Points on a surface, each in one of its faces."""

    corners: Int[Array, "points 3"]
    """Vertices of the face that each point lies in."""
    weights: Float[Array, "points 3"]
    """Barycentric coordinates: not negative, rows sum to one."""

    def of(self, values: Float[Array, "vertices *columns"]) -> Float[Array, "points *columns"]:
        """A function of the vertices at the points."""
        if values.ndim == 2 and values.shape[1] > 6:
            return self.matrix(len(values)) @ values  # three times the result would not fit for many columns
        return np.einsum("pc,pc...->p...", self.weights, values[self.corners])

    def matrix(self, vertices: int) -> Any:
        """The same as a sparse matrix (points x vertices)."""
        from scipy.sparse import csr_matrix

        rows = np.repeat(np.arange(len(self.corners)), 3)
        return csr_matrix((self.weights.ravel(), (rows, self.corners.ravel())), shape=(len(self.corners), vertices))


class SurfaceIndex:
    """A surface prepared for many searches, in space or with further coordinates beside it (normals, so that what touches is
    told apart)."""

    def __init__(self, vertices: Float[Array, "vertices d"], faces: Int[Array, "faces 3"]) -> None:
        from scipy.spatial import cKDTree

        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._centroids = cKDTree(self.vertices[self.faces].mean(axis=1))

    def closest(self, points: Float[Array, "points d"], candidates: int = CANDIDATES) -> Places:
        """The nearest place for each point.

        Exact where one of the `candidates` faces with the nearest centroids holds it, as on surfaces of even triangles;
        elsewhere off by no more than the size of a face.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        found = [self._closest(points[start : start + CHUNK], candidates) for start in range(0, len(points), CHUNK)]
        if not found:
            return Places(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))
        return Places(np.concatenate([each.corners for each in found]), np.concatenate([each.weights for each in found]))

    def _closest(self, points: Float[Array, "points d"], candidates: int) -> Places:
        from retarget.geometry.closest_kernels import nearest_places

        _, near = self._centroids.query(points, k=min(candidates, len(self.faces)))
        corners, weights = np.empty((len(points), 3), dtype=np.int64), np.empty((len(points), 3))
        nearest_places(points, self.vertices, self.faces, near.reshape(len(points), -1), corners, weights)
        return Places(corners, weights)
