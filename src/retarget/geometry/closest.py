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

        self.vertices, self.faces = vertices, faces
        self._centroids = cKDTree(vertices[faces].mean(axis=1))

    def closest(self, points: Float[Array, "points d"], candidates: int = CANDIDATES) -> Places:
        """The nearest place for each point.

        Exact where one of the `candidates` faces with the nearest centroids holds it, as on surfaces of even triangles;
        elsewhere off by no more than the size of a face.
        """
        found = [self._closest(points[start : start + CHUNK], candidates) for start in range(0, len(points), CHUNK)]
        if not found:
            return Places(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))
        return Places(np.concatenate([each.corners for each in found]), np.concatenate([each.weights for each in found]))

    def _closest(self, points: Float[Array, "points d"], candidates: int) -> Places:
        _, near = self._centroids.query(points, k=min(candidates, len(self.faces)))
        near = near.reshape(len(points), -1)
        corners = self.vertices[self.faces[near]]
        weights = barycentric_of_closest(points[:, None], *np.moveaxis(corners, 2, 0))
        placed = np.matmul(weights[:, :, None], corners)[:, :, 0]
        best = np.argmin(((placed - points[:, None]) ** 2).sum(axis=2), axis=1)
        rows = np.arange(len(points))
        return Places(self.faces[near[rows, best]], weights[rows, best])


def barycentric_of_closest(
    points: Float[Array, "*batch d"],
    a: Float[Array, "*other d"],
    b: Float[Array, "*other d"],
    c: Float[Array, "*other d"],
) -> Float[Array, "*broadcast 3"]:
    """Barycentric coordinates of the point of each triangle that lies nearest, in any number of dimensions.

    Inside by projection onto the plane, else on the nearest of the three edges.
    """
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    area = d00 * d11 - d01 * d01
    flat = area <= 1e-14 * np.maximum(d00 * d11, 1e-300)
    safe = np.where(flat, 1.0, area)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    inside = np.stack(np.broadcast_arrays(1 - v - w, v, w), axis=-1)
    outside = np.broadcast_to(flat, v.shape) | (inside < 0).any(axis=-1)
    if not outside.any():
        return inside
    choices, distances = [], []
    for first, second, start, along in ((0, 1, a, ab), (0, 2, a, ac), (1, 2, b, c - b)):
        length = (along * along).sum(-1)
        t = np.clip(((points - start) * along).sum(-1) / np.maximum(length, 1e-300), 0.0, 1.0)
        choice = np.zeros_like(inside)
        choice[..., first], choice[..., second] = 1 - t, t
        choices.append(choice)
        distances.append(((points - start - t[..., None] * along) ** 2).sum(-1))
    best = np.argmin(np.stack(distances), axis=0)
    edge = np.take_along_axis(np.stack(choices), best[None, ..., None], axis=0)[0]
    return np.where(outside[..., None], edge, inside)
