"""The same surface with other triangles, by two remeshers, and where each new vertex lies on the old one."""

from __future__ import annotations

import numpy as np

from retarget.geometry.closest import Places, SurfaceIndex
from retarget.geometry.distance import edge_graph
from retarget.geometry.resample import Surface, decimate, subdivide
from retarget.geometry.topology import vertex_normals

Array = np.ndarray

TOUCHING = 0.01
"""Of the size: how far a normal counts when old and new places are matched, so that what touches is not mistaken."""


def collapsed(surface: Surface, count: int, draw: np.random.Generator) -> tuple[Surface, Places]:
    """Quadric edge collapse of a finer copy: few triangles where it is flat."""
    fine, placing = _finer(surface, 1.5 * count)
    found = decimate(fine, count)
    size = TOUCHING * float(np.ptp(surface.vertices, axis=0).max())
    lifted = np.concatenate([surface.vertices, size * vertex_normals(surface.vertices, surface.faces)], axis=1)
    index = SurfaceIndex(lifted, surface.faces)
    return found, index.closest(
        np.concatenate([found.vertices, size * vertex_normals(found.vertices, found.faces)], axis=1), candidates=16
    )


def clustered(surface: Surface, count: int, draw: np.random.Generator) -> tuple[Surface, Places]:
    """Even triangles: the dual of the clusters around scattered points (as Valette and Chassery 2004, one round)."""
    from scipy.sparse.csgraph import dijkstra

    fine, placing = _finer(surface, 4 * count)
    graph = edge_graph(fine.vertices, fine.faces)
    seeds = _scattered(fine, count, draw)
    for _ in range(2):
        _, _, owner = dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)
        place = np.searchsorted(seeds, owner)
        total = np.stack([np.bincount(place, fine.vertices[:, axis], len(seeds)) for axis in range(3)], axis=1)
        middle = total / np.bincount(place, minlength=len(seeds))[:, None]
        distance = ((fine.vertices - middle[place]) ** 2).sum(axis=1)
        order = np.lexsort((distance, place))
        seeds = np.sort(order[np.searchsorted(place[order], np.arange(len(seeds)))])
    _, _, owner = dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)
    faces = np.searchsorted(seeds, owner)[fine.faces]
    triangles = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(first)]
    used, packed = np.unique(triangles, return_inverse=True)
    return Surface(fine.vertices[seeds[used]], packed.reshape(-1, 3)), _placed(placing[seeds[used]].tocsr())


def _finer(surface: Surface, count: float | int) -> tuple[Surface, object]:
    from scipy.sparse import identity

    placing = identity(len(surface), format="csr")
    while len(surface) < count:
        surface, step = subdivide(surface)
        placing = step @ placing
    return surface, placing


def _scattered(surface: Surface, count: int, draw: np.random.Generator) -> Array:
    """Vertices drawn in proportion to the area around them."""
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    weight = np.bincount(surface.faces.ravel(), np.repeat(area, 3), len(surface))
    return np.sort(draw.choice(len(surface), size=min(count, len(surface)), replace=False, p=weight / weight.sum()))


def _placed(rows: object) -> Places:
    """The three heaviest entries of each row as a place. Rows of repeated subdivision lie in one face and have no more."""
    count = rows.shape[0]
    corners, weights = np.zeros((count, 3), dtype=np.int64), np.zeros((count, 3))
    for row in range(count):
        own = slice(rows.indptr[row], rows.indptr[row + 1])
        entries = own.stop - own.start
        corners[row, :entries], weights[row, :entries] = rows.indices[own], rows.data[own]
    return Places(corners, weights)
