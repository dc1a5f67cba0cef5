"""How the triangles of a surface hang together: welding, pieces, rims, closing."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


def weld(
    vertices: Float[Array, "vertices 3"], attributes: Float[Array, "vertices attributes"] | None = None
) -> Int[Array, "vertices"]:
    """For each vertex, the first one that lies at the same place and has the same `attributes`.

    Files double vertices along texture seams; such copies agree to the last bit or nearly so. Places are the same when
    they lie within a millionth of the surface's extent of each other, attributes when none differs by a thousandth;
    what is the same as a third is the same.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(vertices) == 0:
        return np.zeros(0, dtype=np.int64)
    tolerance = max(1e-6 * float(np.ptp(vertices, axis=0).max()), 1e-300)
    rows = np.round((vertices - vertices.min(axis=0)) / tolerance)
    if attributes is not None:
        rows = np.concatenate([rows, np.round(attributes * 1e3)], axis=1)
    first, cell = _first_of_each(rows)
    # Copies that differ in the last bits may have been rounded into neighbouring cells.
    near = cKDTree(vertices[first]).query_pairs(tolerance, output_type="ndarray")
    if attributes is not None:
        near = near[(np.abs(attributes[first[near[:, 0]]] - attributes[first[near[:, 1]]]) < 1e-3).all(axis=1)]
    joined = coo_matrix((np.ones(len(near), dtype=bool), near.T), shape=(len(first), len(first)))
    count, group = connected_components(joined, directed=False)
    leader = np.full(count, len(vertices))
    np.minimum.at(leader, group, first)
    return leader[group[cell]]


def proper(faces: Int[Array, "faces 3"]) -> Array:
    """Which faces have three different corners (bool)."""
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def distinct(faces: Int[Array, "faces 3"]) -> Array:
    """Which faces are the first on their three corners (bool). Files for viewers that draw one side only hold every
    face twice, the copy turned over."""
    kept = np.zeros(len(faces), dtype=bool)
    kept[_first_of_each(np.sort(faces, axis=1))[0]] = True
    return kept


def _first_of_each(rows: Array) -> tuple[Int[Array, "kept"], Int[Array, "rows"]]:
    """Where each different row of whole numbers comes first, and which of these every row is: what `np.unique(axis=0)` gives
    but for the order of the rows, by one number a row, many times as fast."""
    key = np.zeros(len(rows), dtype=np.int64)
    for column in rows.T.astype(np.int64):
        column = column - column.min(initial=0)
        side = int(column.max(initial=0)) + 1
        if int(key.max(initial=0)) >= np.iinfo(np.int64).max // side:
            key = np.unique(key, return_inverse=True)[1]
        if int(key.max(initial=0)) >= np.iinfo(np.int64).max // side:
            column, side = np.unique(column, return_inverse=True)[1], len(rows)
        key = key * side + column
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    return first, group


def unique_pairs(
    pairs: Int[Array, "pairs 2"],
) -> tuple[Int[Array, "kept 2"], Int[Array, "pairs"], Int[Array, "kept"]]:
    """The different rows of pairs of indices in their order, which of them each row is, and how often each comes: what
    `np.unique(axis=0)` gives, by one number a row, many times as fast."""
    pairs = pairs.astype(np.int64)
    side = int(pairs.max(initial=0)) + 1
    keys, inverse, count = np.unique(pairs[:, 0] * side + pairs[:, 1], return_inverse=True, return_counts=True)
    return np.stack(np.divmod(keys, side), axis=1), inverse.ravel(), count


def adjacency(faces: Int[Array, "faces 3"], vertices: int) -> Any:
    """Which vertices share an edge: a sparse symmetric matrix (vertices x vertices, CSR) of ones, without a diagonal."""
    from scipy import sparse

    first = np.concatenate([faces[:, corner] for corner in (0, 1, 2)])
    second = np.concatenate([faces[:, corner] for corner in (1, 2, 0)])
    apart = first != second
    first, second = first[apart], second[apart]
    ends = np.concatenate([first, second]), np.concatenate([second, first])
    graph = sparse.csr_matrix((np.ones(len(ends[0])), ends), shape=(vertices, vertices))
    graph.data[:] = 1.0
    graph.sort_indices()
    return graph


def is_oriented(faces: Int[Array, "faces 3"]) -> bool:
    """Whether the faces around every edge that is no rim run along it in both directions equally often."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    along = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    _, edge, count = unique_pairs(np.sort(directed, axis=1))
    return not np.bincount(edge, weights=along, minlength=len(count))[count % 2 == 0].any()


def pieces(faces: Int[Array, "faces 3"], vertices: int) -> Int[Array, "faces"]:
    """A number for each face: equal for faces that are connected through shared vertices. Numbers ascend from 0 in the
    order in which their first face comes."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if len(faces) == 0:
        return np.zeros(0, dtype=np.int64)
    rows, columns = faces[:, [0, 1]].T.reshape(2, -1)
    rows, columns = np.concatenate([rows, faces[:, 1]]), np.concatenate([columns, faces[:, 2]])
    graph = coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(vertices, vertices))
    _, label = connected_components(graph, directed=False)
    _, first, group = np.unique(label[faces[:, 0]], return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return order[group.ravel()]


def rim_edges(faces: Int[Array, "faces 3"]) -> Int[Array, "edges 2"]:
    """The directed edges of the rim: those that belong to an odd number of faces, each along one of its faces.

    On a manifold surface these are the edges with one face. Over any set of triangles they form closed loops: at every
    vertex an even number of them meet.
    """
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    undirected = np.sort(directed, axis=1)
    kept, inverse, count = unique_pairs(undirected)
    odd = count % 2 == 1
    forward = np.bincount(
        inverse, weights=np.where(directed[:, 0] == undirected[:, 0], 1, -1), minlength=len(kept)
    )
    edges = kept[odd]
    return np.where((forward[odd] > 0)[:, None], edges, edges[:, ::-1])


def loops(edges: Int[Array, "edges 2"], vertices: int) -> Int[Array, "edges"]:
    """A number for each rim edge: equal for those that hang together."""
    if len(edges) == 0:
        return np.zeros(0, dtype=np.int64)
    return pieces(np.concatenate([edges, edges[:, :1]], axis=1), vertices)


def closing_fans(faces: Int[Array, "faces 3"], vertices: int) -> tuple[Int[Array, "caps 3"], list[Int[Array, "_"]]]:
    """Triangles that close a surface, and the rims whose centroids they meet in (Basset 2019, section 4.2.1).

    The n-th rim's centroid has the index `vertices + n`. With the fans every edge belongs to an even number of faces,
    whatever the surface was: a ray then crosses it an even number of times from outside, an odd number from inside.
    Fans are oriented like the surface around them.
    """
    edges = rim_edges(faces)
    loop = loops(edges, vertices)
    caps = np.stack([edges[:, 1], edges[:, 0], vertices + loop], axis=1)
    by_loop = edges[np.argsort(loop, kind="stable")]
    return caps, [np.unique(own) for own in np.split(by_loop, np.cumsum(np.bincount(loop))[:-1])] if len(loop) else []


def areas(vertices: Float[Array, "*batch vertices 3"], faces: Int[Array, "faces 3"]) -> Float[Array, "*batch faces"]:
    """Area of each face."""
    a, b, c = (vertices[..., faces[:, corner], :] for corner in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)


def signed_volume(
    vertices: Float[Array, "*batch vertices 3"], faces: Int[Array, "faces 3"]
) -> Float[Array, "*batch"] | float:
    """Volume within a closed, outward oriented surface: the sum of signed tetrahedra to the origin (Basset 2019, section
    4.2.1, with the fifth term of the printed formula corrected to -x_j y_i z_k)."""
    a, b, c = (vertices[..., faces[:, corner], :] for corner in range(3))
    return (a * np.cross(b, c)).sum(axis=(-1, -2)) / 6.0


def vertex_normals(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> Float[Array, "vertices 3"]:
    """Unit normals of the vertices: the mean over the faces around, by area; nought where no face has an area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    corners, count = faces.ravel(), len(vertices)
    total = np.stack([np.bincount(corners, np.repeat(across[:, axis], 3), count) for axis in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
