"""Distances along a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray


def edge_graph(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> Any:
    """Sparse symmetric matrix of edge lengths between vertices."""
    from scipy.sparse import coo_matrix

    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    lengths = np.maximum(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1), 1e-12)
    count = len(vertices)
    return coo_matrix(
        (np.concatenate([lengths, lengths]), np.concatenate([edges, edges[:, ::-1]]).T), shape=(count, count)
    ).tocsr()


def distance_along_edges(graph: Any, sources: Int[Array, "_"], limit: float) -> Float[Array, "vertices"]:
    """Length of the shortest way along edges to the nearest source; infinite beyond `limit`.

    Longer than the geodesic by up to about an eighth on regular meshes: good for neighbourhoods, not for measures.
    """
    from scipy.sparse.csgraph import dijkstra

    if len(sources) == 0:
        return np.full(graph.shape[0], np.inf)
    return dijkstra(graph, directed=False, indices=sources, limit=limit, min_only=True)


def within(graph: Any, sources: Int[Array, "_"], limit: float) -> Bool[Array, "vertices"]:
    """Which vertices lie within a distance of the sources along edges."""
    return np.isfinite(distance_along_edges(graph, sources, limit))
