"""Skinning weights, and anything else that a template knows of its vertices, carried over a map of places.

Musoni 2021 (section 4.1) compares three ways over functional maps, which `evaluate/reference` keeps. Ours is their third,
coordinates matched in space, on a template that was laid onto the mesh first: barycentric, so smooth, and told apart by
normals and by neighbours where parts touch.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.geometry.closest import Places, SurfaceIndex
from retarget.geometry.resample import Surface
from retarget.geometry.topology import pieces, unique_pairs, vertex_normals
from retarget.rig.fit import HEIGHT, LIKE_NORMALS
from retarget.rig.registration import Registered

Array = np.ndarray

INFLUENCES = 4
"""Joints that move one vertex, at most: what engines take."""
JUMP = 0.03 * HEIGHT
"""Metres that two neighbours' places may lie apart on the template beyond three times the edge: more is a leak."""
LEAST_PATCH = 0.2
"""Share of a piece's vertices: smaller patches behind a leak are taken for the mistake."""
SMALL_PIECE = 0.08 * HEIGHT
"""Extent of a piece that moves as one: eyes, teeth, buttons."""
HELD_AWAY = 0.04 * HEIGHT
"""Median distance of a piece from the body from which it is something held or worn that moves as one."""
LEAST_AGREEMENT = 0.3
"""Mean cosine between a piece's normals and those beneath it, from which they count."""
ASTRAY = 0.02 * HEIGHT
"""Metres on the template beyond which a place of a map that was handed over is taken for a mistake."""
HELD = 1.0
"""Weight of the template's rest place beside the place itself, where a patch is placed again next to its neighbours."""


def places_on_template(
    mesh: Surface,
    registered: Registered,
    faces: Int[Array, "faces 3"],
    rest: Float[Array, "template 3"],
    like_normals: float = LIKE_NORMALS,
) -> Places:
    """For every vertex of the mesh its place on the template: the nearest of the registered surface with a like normal.

    Patches that lie across a leak (neighbours on the mesh, far apart on the template: a hand on a hip) are placed again
    near their neighbours' places. Normals count for pieces that are turned as what lies beneath; linings are not.
    `like_normals` is how far apart normals put two places: little for bodies put together of pieces, whose surfaces turn every
    way.
    """
    normals = vertex_normals(mesh.vertices, mesh.faces)
    beneath = SurfaceIndex(registered.vertices, faces).closest(mesh.vertices).of(registered.normals)
    label = _vertex_pieces(mesh)
    agreement = np.bincount(label, (normals * beneath).sum(axis=1)) / np.bincount(label)
    normals[agreement[label] < LEAST_AGREEMENT] = 0.0
    lifted = np.concatenate([registered.vertices, like_normals * registered.normals], axis=1)
    seen = np.concatenate([mesh.vertices, like_normals * normals], axis=1)
    places = SurfaceIndex(lifted, faces).closest(seen, candidates=16)
    wrong = _across_leaks(mesh, places.of(rest))
    if not wrong.any():
        return places
    beside = _nearest_right(mesh, ~wrong)
    again = SurfaceIndex(np.concatenate([lifted, HELD * rest], axis=1), faces)
    held = HELD * places.of(rest)[beside[wrong]]
    mended = again.closest(np.concatenate([seen[wrong], held], axis=1), candidates=16)
    corners, weights = places.corners.copy(), places.weights.copy()
    corners[wrong], weights[wrong] = mended.corners, mended.weights
    return Places(corners, weights)


def finer_places(known: Places, found: Places, rest: Float[Array, "template 3"]) -> Places:
    """Places of a map that was handed over, wherever they lie within faces and near those that were found.

    A map from vertex to vertex is no finer than the template's triangles, and a wrong one jumps: there the laid-on template
    says more.
    """
    within = known.weights.max(axis=1) < 1.0 - 1e-6
    near = np.linalg.norm(known.of(rest) - found.of(rest), axis=1) < ASTRAY
    taken = (within & near)[:, None]
    return Places(np.where(taken, known.corners, found.corners), np.where(taken, known.weights, found.weights))


def sparse_weights(
    weights: Float[Array, "vertices joints"],
) -> tuple[Int[Array, "vertices influences"], Float[Array, "vertices influences"]]:
    """The heaviest `INFLUENCES` joints of each vertex, and weights that sum to one."""
    count = min(INFLUENCES, weights.shape[1])
    columns = np.argpartition(-weights, count - 1, axis=1)[:, :count]
    columns = np.take_along_axis(
        columns, np.argsort(-np.take_along_axis(weights, columns, axis=1), axis=1, kind="stable"), axis=1
    )
    kept = np.take_along_axis(weights, columns, axis=1)
    kept[kept < 1e-4] = 0.0
    return np.where(kept > 0, columns, 0), kept / kept.sum(axis=1, keepdims=True)


def rigid_pieces(
    mesh: Surface, weights: Float[Array, "vertices joints"], away: Float[Array, "vertices"]
) -> Float[Array, "vertices joints"]:
    """The same weights, one set for all vertices of each small piece, and of each piece that reaches far from the body: what a
    hand holds moves as the part of it next to the hand does. `away` is the distance to the template's skin.
    """
    label = _vertex_pieces(mesh)
    weights = weights.copy()
    order = np.argsort(label, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        if len(own) == len(mesh):
            break
        if np.ptp(mesh.vertices[own], axis=0).max() < SMALL_PIECE:
            weights[own] = weights[own].mean(axis=0)
        elif np.median(away[own]) > HELD_AWAY:
            nearest = own[np.argsort(away[own], kind="stable")[: max(1, len(own) // 10)]]
            weights[own] = weights[nearest].mean(axis=0)
    return weights


def _vertex_pieces(mesh: Surface) -> Int[Array, "vertices"]:
    """The piece of each vertex, copies at one place counted as one; vertices of no face are pieces of their own."""
    leader = mesh.leaders
    label = np.arange(len(mesh), 2 * len(mesh))
    faces = leader[mesh.faces]
    label[faces] = pieces(faces, len(mesh))[:, None]
    return np.unique(label[leader], return_inverse=True)[1]


def welded_edges(
    mesh: Surface,
) -> tuple[Int[Array, "vertices"], Int[Array, "edges 2"], Float[Array, "edges"]]:
    """For each vertex the one that stands for all at its place; edges between those, and their lengths."""
    leader = mesh.leaders
    edges, _, _ = unique_pairs(np.sort(leader[mesh.faces][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1))
    edges = edges[edges[:, 0] != edges[:, 1]]
    return leader, edges, np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)


def _across_leaks(mesh: Surface, rest: Float[Array, "vertices 3"]) -> Bool[Array, "vertices"]:
    """Vertices in patches that are small and whose neighbours all lie elsewhere on the template."""
    leader, edges, lengths = welded_edges(mesh)
    apart = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    good = apart <= 3 * lengths + JUMP
    if good.all():
        return np.zeros(len(mesh), dtype=bool)
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    def labels(pairs: Int[Array, "pairs 2"]) -> Int[Array, "vertices"]:
        graph = coo_matrix((np.ones(len(pairs), dtype=bool), pairs.T), shape=(len(mesh), len(mesh)))
        return connected_components(graph, directed=False)[1]

    patch, piece = labels(edges[good])[leader], labels(edges)[leader]
    small = np.bincount(patch)[patch] < LEAST_PATCH * np.bincount(piece)[piece]
    cut = np.zeros(patch.max() + 1, dtype=bool)
    cut[patch[edges[~good]]] = True
    return small & cut[patch]


def _nearest_right(mesh: Surface, right: Bool[Array, "vertices"]) -> Int[Array, "vertices"]:
    """For every vertex the nearest one, along edges, that is placed right; itself where it is, or where none is reached."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    leader, edges, lengths = welded_edges(mesh)
    both: Any = (np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]]))
    graph = csr_matrix((np.maximum(np.tile(lengths, 2), 1e-12), both), shape=(len(mesh), len(mesh)))
    sources = np.flatnonzero(right & (leader == np.arange(len(mesh))))
    _, _, owner = dijkstra(graph, directed=False, indices=sources, min_only=True, return_predecessors=True)
    owner = owner[leader]
    return np.where(owner < 0, np.arange(len(mesh)), owner)
