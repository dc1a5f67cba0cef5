"""Distances along a surface by heat: smooth, near to the true ones, a millisecond each once the surface is prepared.

Crane, Weischedel and Wardetzky 2013, "Geodesics in Heat", on the intrinsic Delaunay triangulation. Where neighbours within
a limit are all that matters, `distance.py` needs no preparing.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from retarget.geometry.resample import Surface
from retarget.geometry.topology import areas

Array = np.ndarray


class Geodesics:
    """One surface prepared; distances are in units of the square root of its area, so that bodies of any size compare."""

    def __init__(self, surface: Surface) -> None:
        import potpourri3d

        self.size = float(np.sqrt(areas(surface.vertices, surface.faces).sum()))
        self._solver = potpourri3d.MeshHeatMethodDistanceSolver(surface.vertices, surface.faces)

    def distance(self, vertex: int) -> Float[Array, "vertices"]:
        """From one vertex to all."""
        return self._solver.compute_distance(vertex) / self.size

    def distances(self, vertices: Int[Array, "sources"]) -> Float[Array, "vertices sources"]:
        """From several vertices to all."""
        return np.stack([self.distance(vertex) for vertex in vertices.tolist()], axis=1)


def farthest_points(points: Float[Array, "points d"], count: int, first: int = 0) -> Int[Array, "chosen"]:
    """Points spread evenly: each the farthest from those before it, so every beginning of the list is spread too."""
    chosen = np.empty(min(count, len(points)), dtype=np.int64)
    distance = np.full(len(points), np.inf)
    chosen[0] = first
    for number in range(1, len(chosen)):
        away = points - points[chosen[number - 1]]
        np.minimum(distance, np.einsum("pd,pd->p", away, away), out=distance)
        chosen[number] = int(distance.argmax())
    return chosen
