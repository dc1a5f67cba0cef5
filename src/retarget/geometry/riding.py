"""Points that ride on a moving surface: where they lay on it, and how far off along its normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from retarget.geometry.closest import Places, SurfaceIndex

Array = np.ndarray

CANDIDATES = 16
"""Faces that are tried for each point."""


@dataclass(frozen=True, eq=False)
class Riders:
    """Points on a surface; `place_riders` makes them."""

    places: Places
    away: Float[Array, "points"]
    """How far off the surface each lies, along its face's normal, in the surface's unit."""

    def __len__(self) -> int:
        return len(self.away)

    def of(self, vertices: Shaped[Array, "vertices 3"]) -> Float[Array, "points 3"]:
        """Where they lie when the surface's vertices lie there."""
        corners = vertices[self.places.corners].astype(np.float64)
        return np.einsum("pc,pca->pa", self.places.weights, corners) + self.away[:, None] * _normals(corners)


def place_riders(
    points: Float[Array, "points 3"], vertices: Float[Array, "vertices 3"], faces: Array, scale: float = 1.0
) -> Riders:
    """Where points lie on a surface that is then shown `scale` times as large."""
    places = SurfaceIndex(vertices, faces).closest(points, CANDIDATES)
    normals = _normals(vertices[places.corners])
    return Riders(places, scale * ((points - places.of(vertices)) * normals).sum(axis=1))


def _normals(corners: Float[Array, "points 3 3"]) -> Float[Array, "points 3"]:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
