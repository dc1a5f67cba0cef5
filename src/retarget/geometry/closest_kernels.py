"""Compiled loop of `closest`: the nearest place among a few triangles, in any number of dimensions. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
FLAT = 1e-14
"""Squared area, over the squared lengths of two edges, of a triangle that is taken for a line."""


@njit(**OPTIONS)
def nearest_places(points, vertices, faces, near, corners, weights):
    """For every point the face, of those in its row of `near`, that comes nearest, and where: its vertices and the barycentric
    coordinates are written into `corners` and `weights` (points x 3). The first of equals is taken."""
    dimensions = points.shape[1]
    for point in range(len(points)):
        best = np.inf
        for candidate in range(near.shape[1]):
            i, j, k = faces[near[point, candidate], 0], faces[near[point, candidate], 1], faces[near[point, candidate], 2]
            d00, d01, d11, d20, d21, d22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for axis in range(dimensions):
                a = vertices[i, axis]
                ab, ac, ap = vertices[j, axis] - a, vertices[k, axis] - a, points[point, axis] - a
                d00, d01, d11 = d00 + ab * ab, d01 + ab * ac, d11 + ac * ac
                d20, d21, d22 = d20 + ap * ab, d21 + ap * ac, d22 + ap * ap
            v, w = _coordinates(d00, d01, d11, d20, d21)
            gap = d22 - 2.0 * (v * d20 + w * d21) + v * v * d00 + 2.0 * v * w * d01 + w * w * d11
            if gap < best or candidate == 0:
                best = gap
                corners[point, 0], corners[point, 1], corners[point, 2] = i, j, k
                weights[point, 0], weights[point, 1], weights[point, 2] = max(1.0 - v - w, 0.0), v, w


@njit(**OPTIONS)
def _coordinates(d00, d01, d11, d20, d21):
    """Barycentric coordinates of the second and third corner, from inner products of the edges ab (0), ac (1) and of ap (2):
    inside by projection onto the plane, else on the nearest of the three edges."""
    area = d00 * d11 - d01 * d01
    if area > FLAT * max(d00 * d11, 1e-300):
        v, w = (d11 * d20 - d01 * d21) / area, (d00 * d21 - d01 * d20) / area
        if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
            return v, w
    along_ab = min(max(d20 / max(d00, 1e-300), 0.0), 1.0)
    along_ac = min(max(d21 / max(d11, 1e-300), 0.0), 1.0)
    across = d00 - 2.0 * d01 + d11
    along_bc = min(max((d21 - d20 + d00 - d01) / max(across, 1e-300), 0.0), 1.0)
    v, w = along_ab, 0.0
    best = _gap(v, w, d00, d01, d11, d20, d21)
    gap = _gap(0.0, along_ac, d00, d01, d11, d20, d21)
    if gap < best:
        v, w, best = 0.0, along_ac, gap
    if _gap(1.0 - along_bc, along_bc, d00, d01, d11, d20, d21) < best:
        v, w = 1.0 - along_bc, along_bc
    return v, w


@njit(**OPTIONS)
def _gap(v, w, d00, d01, d11, d20, d21):
    """Squared distance from the point to the place, less the point's from the first corner."""
    return v * v * d00 + 2.0 * v * w * d01 + w * w * d11 - 2.0 * (v * d20 + w * d21)


def compile_kernels() -> None:
    """Compile, or read from the cache, in advance."""
    points, faces = np.zeros((1, 3)), np.zeros((1, 3), dtype=np.int64)
    nearest_places(points, points, faces, np.zeros((1, 1), dtype=np.int64), faces.copy(), points.copy())
