"""Brute-force collision test: what `contact.collide` must agree with. Every face for every point, no tree, no culling,
double precision; rays in a direction of their own, so that not even the rounding is shared. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

_options = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def inside_by_parity(points, vertices, faces, direction):
    """Whether a ray from each point (points x 3) crosses a closed surface an odd number of times (Möller and Trumbore
    1997). The direction is a unit vector in general position. Returns bool (points)."""
    odd = np.zeros(len(points), dtype=np.bool_)
    for face in faces:
        a = vertices[face[0]]
        ab, ac = vertices[face[1]] - a, vertices[face[2]] - a
        px = direction[1] * ac[2] - direction[2] * ac[1]
        py = direction[2] * ac[0] - direction[0] * ac[2]
        pz = direction[0] * ac[1] - direction[1] * ac[0]
        determinant = ab[0] * px + ab[1] * py + ab[2] * pz
        if determinant == 0.0:
            continue
        for number in range(len(points)):
            x, y, z = points[number, 0] - a[0], points[number, 1] - a[1], points[number, 2] - a[2]
            u = (x * px + y * py + z * pz) / determinant
            if u < 0.0 or u > 1.0:
                continue
            qx, qy, qz = y * ab[2] - z * ab[1], z * ab[0] - x * ab[2], x * ab[1] - y * ab[0]
            v = (qx * direction[0] + qy * direction[1] + qz * direction[2]) / determinant
            if v < 0.0 or u + v > 1.0:
                continue
            if (ac[0] * qx + ac[1] * qy + ac[2] * qz) / determinant > 0.0:
                odd[number] = not odd[number]
    return odd


@njit(**_options)
def distance_to_faces(points, vertices, faces):
    """Distance (metres) from each point to the nearest of all faces: the least over their insides, edges and corners."""
    best = np.full(len(points), np.inf)
    for face in faces:
        corners = (vertices[face[0]], vertices[face[1]], vertices[face[2]])
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        length = np.sqrt((normal**2).sum())
        for number in range(len(points)):
            p = points[number]
            within = length > 0.0
            for corner in range(3):
                start, edge = corners[corner], corners[(corner + 1) % 3] - corners[corner]
                square = (edge**2).sum()
                share = ((p - start) * edge).sum() / square if square > 0.0 else 0.0
                share = min(max(share, 0.0), 1.0)
                best[number] = min(best[number], np.sqrt(((p - start - share * edge) ** 2).sum()))
                within = within and (np.cross(edge, p - start) * normal).sum() >= 0.0
            if within:
                best[number] = min(best[number], abs(((p - corners[0]) * normal).sum()) / length)
    return best
