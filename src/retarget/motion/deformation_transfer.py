"""Deformation transfer: how every triangle of one body is stretched and turned, given to another body with the same faces.

Sumner and Popović 2004, "Deformation transfer for triangle meshes". They seek the target's vertices whose deformation
gradients `T` come nearest to the source's `S` in the sum of `|S - T|²` over triangles, each counting the same whatever its
area. We keep that sum. (Weighing by area came 3 to 13 % nearer to the target's own skin, over three bodies and three motions
of the embedded human, where the paper's form is .2 to .8 cm off: too little to leave the paper for.) A triangle's gradient is
fixed by its two edges and a fourth vertex that stands on it along the normal, at a distance of the square root of twice its
area (equation 1). For the target the fourth vertices are unknowns of the paper's system; each occurs in one triangle only and
takes up its normal's share of `S - T` entirely, so they can be left out and the same vertices come back:

    minimise  Σ |(S E - Ẽ) E⁺|²      E, Ẽ: edges (3 x 2) of the target's triangle at rest and deformed

With `E = U diag(s) Vᵀ` the term is `(S E - Ẽ) V diag(1/s)`. Both sides are linear in the source's vertices and its triangles'
normals, so a frame costs one sparse product and one solve with a factor that is made once: 1.7 to 2.5 ms at 6,883 vertices and 3.0 to
3.8 at 12,883 on one core, after .15 to .46 s of preparation.

Ours, for the paper leaves it open or does not need it: where the pieces stand (see `DeformationTransfer`), and triangles
without area (see `FLOOR` and `THIN`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.errors import RetargetError
from retarget.geometry.cholesky import Factor, factor
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.topology import areas, weld

Array = np.ndarray

FLOOR = 1e-3
"""The least that `s` counts in a target triangle's term, as a share of the median edge: a triangle without height still holds
its corners together, with a weight that a factor in double precision bears."""
THIN = 1e-4
"""A source triangle whose smaller `s` is below this share of the larger does not tell how its surface is stretched across.
The triangle nearest to it tells that in its place; along its length its own edges do."""
LEAST = 1e-10
"""Edges shorter than this share of the source's extent are rounding, and tell nothing."""


@dataclass(frozen=True, eq=False)
class Anchors:
    """Where the pieces besides the main one hang: each by the unknown that lies nearest to the main piece at the target's rest."""

    vertices: Int[Array, "pieces"]
    corners: Int[Array, "pieces 3"]
    """The main piece's triangle at the nearest place."""
    weights: Float[Array, "pieces 3"]
    """Barycentric coordinates of that place."""
    gradient: Any
    """Sparse matrix (3·pieces x vertices+faces): the source's deformation gradients there, transposed."""
    offsets: Float[Array, "pieces 3"]
    """What the target's way from place to vertex has at rest beyond the scaled source's."""


@dataclass(frozen=True, eq=False)
class DeformationTransfer:
    """A pair of bodies, ready for the source's frames; `prepare_deformation_transfer` makes one.

    Gradients leave every connected piece free to shift. *The main piece* is the one with the largest area. Its centroid `c`
    (vertices weighted by the source's area around them, on both bodies) goes where the source's goes, times `scale`, and what
    the bodies' rest poses differ by beside that turns as the source turns (`R`, the rotation nearest to it):
    `c_target = scale c_source + R (c_target_rest - scale c_source_rest)`. So rest gives rest, and a rigid motion `(R, t)` of the
    source gives `(R, scale t)` of the target. *Another piece* does the same with respect to the place of the main piece that is
    nearest to it, with that place's deformation gradient instead of `R`. If it moves along with that place on the source, this
    is its rest offset transported by the gradient. A vertex without faces is a piece of its own.

    *Vertices that are one* (files double them along the seams of texture and normals) are one unknown, or the target would come
    apart there. Where the source moves them apart, the target does, by `scale` as much.
    """

    factor: Factor
    operator: Any
    """Sparse matrix (unknowns x vertices+faces) from the source's vertices and scaled normals to the right-hand side."""
    faces: Int[Array, "faces 3"]
    unknown: Int[Array, "vertices"]
    """Which unknown each vertex is: equal for vertices that are one."""
    first: Int[Array, "unknowns"]
    """The first vertex of each unknown."""
    piece: Int[Array, "unknowns"]
    """Which piece each unknown belongs to; 0 is the main one."""
    masses: Float[Array, "unknowns"]
    """Share of each in the main piece's centroid; they sum to one."""
    levers: Float[Array, "3 unknowns"]
    """The source's rest pose about that centroid, times the masses."""
    offset: Float[Array, "3"]
    """The target's centroid at rest, less the scaled source's."""
    anchors: Anchors
    scale: float
    """By how much larger the target moves about (ratio of heights, unless told)."""
    flat_source: int
    """Source triangles that do not tell their stretch across (see `THIN`)."""
    flat_target: int
    """Target triangles whose weight is held down (see `FLOOR`)."""

    def frames(self, posed: Float[Array, "frames vertices 3"]) -> Float[Array, "frames vertices 3"]:
        """The target's vertices (metres, float64) for the source's, each frame by itself.

        Raises `RetargetError` for another number of vertices, or for a vertex that is not finite.
        """
        count = len(self.unknown)
        if posed.ndim != 3 or posed.shape[1:] != (count, 3):
            raise RetargetError(f"posed vertices have the shape {posed.shape}; the bodies need (frames, {count}, 3)")
        found = np.empty(posed.shape, dtype=np.float64)
        for frame, vertices in enumerate(posed):
            _check_finite(vertices, f"frame {frame} of the source")
            found[frame] = self._frame(vertices.astype(np.float64))
        return found

    def _frame(self, posed: Float[Array, "vertices 3"]) -> Float[Array, "vertices 3"]:
        told = np.concatenate([posed, _standing(posed, self.faces)])
        found = self.factor.solve(self.operator @ told)
        source = posed[self.first]
        goal = self.scale * (self.masses @ source) + _nearest_rotation(self.levers @ source) @ self.offset
        shifts = np.empty((len(self.anchors.vertices) + 1, 3))
        shifts[0] = goal - self.masses @ found
        hung = self.anchors
        if len(hung.vertices):
            place = np.einsum("pc,pcx->px", hung.weights, found[hung.corners]) + shifts[0]
            away = source[hung.vertices] - np.einsum("pc,pcx->px", hung.weights, source[hung.corners])
            across = np.einsum("pix,pi->px", (hung.gradient @ told).reshape(-1, 3, 3), hung.offsets)
            shifts[1:] = place + self.scale * away + across  # the vertices themselves are held at nought
        found += shifts[self.piece]
        if len(found) == len(posed):
            return found
        return found[self.unknown] + self.scale * (posed - source[self.unknown])


def prepare_deformation_transfer(
    source_rest: Float[Array, "vertices 3"],
    target_rest: Float[Array, "target_vertices 3"],
    faces: Int[Array, "faces 3"],
    scale: float | int | None = None,
    welded: Int[Array, "welded_vertices"] | None = None,
) -> DeformationTransfer:
    """Prepare the transfer between two bodies in the same rest pose (metres, +Y up) with the same faces.

    `scale` says by how much larger the target moves about; left out, it is the ratio of the main piece's heights.
    `welded` names, for each vertex, the first that is one with it; left out, vertices are one that lie at the same place on both
    bodies (`geometry.topology.weld`). Give `np.arange(vertices)` to keep all apart. Rest poses that differ come out as a difference in every frame: bring them together first.

    Raises `RetargetError` for bodies of different numbers of vertices, without faces or without area, for faces that name
    missing vertices, vertices that are not finite, and a `scale` that is not positive, or cannot be told since a body has
    no height.
    """
    source_rest, target_rest = source_rest.astype(np.float64), target_rest.astype(np.float64)
    _check(source_rest, target_rest, faces, welded)
    faces = faces.astype(np.int64)
    if welded is None:
        welded = weld(source_rest) * len(source_rest) + weld(target_rest)
    _, first, unknown = np.unique(welded, return_index=True, return_inverse=True)
    first, unknown = _in_order(first, unknown.ravel())
    source, target, joint = source_rest[first], target_rest[first], unknown[faces]

    area, triangles = areas(source_rest, faces), _triangles(source_rest, faces)
    least = LEAST * float(np.ptp(source_rest, axis=0).max())
    known = triangles.s > np.stack([np.full(len(faces), least), np.maximum(THIN * triangles.s[:, 0], least)], axis=1)
    flat = ~known[:, 1]
    if flat.all():
        raise RetargetError(f"none of the source's {len(faces)} triangles has an area in its rest pose")
    piece = _pieces(joint, np.where(flat, 0.0, area), len(first))
    main = piece[joint[:, 0]] == 0
    if scale is None:
        scale = _height_ratio(source[piece == 0], target[piece == 0])
    elif not (np.isfinite(scale) and scale > 0):
        raise RetargetError(f"scale is {scale}; it must be a positive number")

    scale = float(scale)
    gradient = _source_gradient(source_rest, faces, piece[joint[:, 0]], triangles, known)
    stiffness, divergence, held_down = _target_terms(target, joint)
    masses = np.bincount(joint[main].ravel(), np.repeat(area[main], 3), len(first))
    masses /= masses.sum()
    centre = masses @ source
    anchors = _anchors(source, target, joint, piece, np.flatnonzero(main), gradient, scale)
    # The right-hand side sums to nought over a piece, so a weight on one vertex puts that vertex to nought and nothing else.
    held = np.concatenate([[int(masses.argmax())], anchors.vertices])
    return DeformationTransfer(
        factor=factor(stiffness + _diagonal(held, stiffness.diagonal().mean(), len(first))),
        operator=(divergence @ gradient).tocsr(),
        faces=faces,
        unknown=unknown,
        first=first,
        piece=piece,
        masses=masses,
        levers=(masses[:, None] * (source - centre)).T,
        offset=masses @ target - scale * centre,
        anchors=anchors,
        scale=scale,
        flat_source=int(flat.sum()),
        flat_target=int(held_down.sum()),
    )


@dataclass(frozen=True, eq=False)
class _Triangles:
    """Two edges of each triangle at rest, and their singular values: `edges = u diag(s) vᵀ`."""

    edges: Float[Array, "faces 3 2"]
    u: Float[Array, "faces 3 2"]
    s: Float[Array, "faces 2"]
    """Lengths, the larger first; their product is twice the area."""
    v: Float[Array, "faces 2 2"]


def _source_gradient(
    rest: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    piece: Int[Array, "faces"],
    triangles: _Triangles,
    known: Bool[Array, "faces 2"],
) -> Any:
    """The sparse matrix (3·faces x vertices+faces) from vertices and `_standing` normals to the transposed deformation
    gradients of all triangles, of which those directions are `known` that tell a gradient.

    `S = Ẽ E⁺ + S_b (1 - E E⁺)`, where `b` is the triangle itself, or the nearest one that is not flat.
    """
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    count, s, extent = len(faces), triangles.s, float(np.ptp(rest, axis=0).max())
    flat = ~known[:, 1]
    inverse = np.einsum(
        "fec,fc,fxc->fex", triangles.v, np.where(known, 1 / np.where(known, s, 1.0), 0.0), triangles.u
    )  # E⁺
    across = np.eye(3) - np.einsum("fxe,fey->fxy", triangles.edges, inverse)
    standing = _standing(rest, faces)
    upright = standing / np.where(flat, 1.0, (standing**2).sum(axis=1))[:, None]

    # Pieces are kept apart by a fourth coordinate, so that a triangle asks another piece only where its own knows nothing.
    places = np.concatenate([rest[faces].mean(axis=1), 10 * extent * piece[:, None]], axis=1)
    asked, good = np.arange(count), np.flatnonzero(~flat)
    if flat.any():
        asked[flat] = good[cKDTree(places[good]).query(places[flat])[1]]

    rows = 3 * np.arange(count)[:, None] + np.arange(3)  # of a face's transposed gradient
    own = _on_corners(inverse)  # faces 3(rest direction) 3(corner)
    borrowed = np.einsum("fxy,fxc->fyc", across, _on_corners(inverse)[asked])
    normal = np.einsum("fxy,fx->fy", across, upright[asked])
    values = np.concatenate([own.ravel(), borrowed.ravel(), normal.ravel()])
    index_rows = np.concatenate([np.repeat(rows.ravel(), 3)] * 2 + [rows.ravel()])
    corners, others = (np.repeat(each[:, None], 3, axis=1).ravel() for each in (faces, faces[asked]))
    columns = np.concatenate([corners, others, len(rest) + np.repeat(asked, 3)])
    return csr_matrix((values, (index_rows, columns)), shape=(3 * count, len(rest) + count))


def _target_terms(
    rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]
) -> tuple[Any, Any, Bool[Array, "faces"]]:
    """The normal equations' matrix (vertices x vertices), the sparse matrix (vertices x 3·faces) from transposed gradients
    to their right-hand side, and which triangles are held down by `FLOOR`."""
    from scipy.sparse import csr_matrix

    count, triangles = len(faces), _triangles(rest, faces)
    floor = FLOOR * np.median(np.linalg.norm(rest[faces] - np.roll(rest[faces], 1, axis=1), axis=2))
    if floor <= 0:
        raise RetargetError("most triangles of the target have corners at one place; there is no surface to move")
    weight = np.einsum("fec,fc,fgc->feg", triangles.v, 1 / np.maximum(triangles.s, floor) ** 2, triangles.v)
    own = _on_corners(weight)  # faces 2(edge) 3(corner)
    stiff = np.stack([-(own[:, 0] + own[:, 1]), own[:, 0], own[:, 1]], axis=1)
    onto = np.einsum("fec,fxe->fcx", own, triangles.edges)  # faces 3(corner) 3(rest direction)
    corners = np.repeat(faces[:, :, None], 3, axis=2)
    stiffness = csr_matrix(
        (stiff.ravel(), (corners.ravel(), corners.transpose(0, 2, 1).ravel())), shape=(len(rest), len(rest))
    )
    columns = np.broadcast_to(3 * np.arange(count)[:, None, None] + np.arange(3), (count, 3, 3))
    divergence = csr_matrix((onto.ravel(), (corners.ravel(), columns.ravel())), shape=(len(rest), 3 * count))
    return stiffness, divergence, triangles.s[:, 1] < floor


def _anchors(
    source_rest: Float[Array, "vertices 3"],
    target_rest: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    piece: Int[Array, "vertices"],
    main: Int[Array, "main_faces"],
    gradient: Any,
    scale: float,
) -> Anchors:
    """Hang the pieces besides the main one on the given faces of it."""
    other = np.flatnonzero(piece > 0)
    places = SurfaceIndex(target_rest, faces[main]).closest(target_rest[other])
    away = np.linalg.norm(places.of(target_rest) - target_rest[other], axis=1)
    order = np.lexsort((away, piece[other]))
    nearest = order[np.unique(piece[other][order], return_index=True)[1]]  # the first of each piece
    vertices, corners, weights = other[nearest], places.corners[nearest], places.weights[nearest]
    number = {tuple(face): index for index, face in zip(main, faces[main].tolist())}
    at = np.array([number[tuple(each)] for each in corners.tolist()], dtype=np.int64)
    offsets = [rest[vertices] - np.einsum("pc,pcx->px", weights, rest[corners]) for rest in (source_rest, target_rest)]
    rows = (3 * at[:, None] + np.arange(3)).ravel()
    return Anchors(vertices, corners, weights, gradient[rows], offsets[1] - scale * offsets[0])


def _standing(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> Float[Array, "faces 3"]:
    """From a triangle to its fourth vertex (Sumner and Popović 2004, equation 1); nought where there is no area."""
    by_axis = np.ascontiguousarray(vertices.T)  # gathering and multiplying whole rows takes a fifth of the time
    a, b, c = (np.take(by_axis, faces[:, corner], axis=1) for corner in range(3))
    p, q = b - a, c - a
    normal = np.empty_like(p)
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        normal[axis] = p[one] * q[two] - p[two] * q[one]
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    return (normal / np.sqrt(np.maximum(length, 1e-150))).T


def _triangles(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> _Triangles:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    edges = np.stack([b - a, c - a], axis=2)
    u, s, transposed = np.linalg.svd(edges, full_matrices=False)
    return _Triangles(edges, u, s, transposed.transpose(0, 2, 1))


def _on_corners(by_edge: Float[Array, "faces 2 columns"]) -> Array:
    """Coefficients of two edges (second axis) as coefficients of three corners (last axis)."""
    first, second = by_edge[:, 0], by_edge[:, 1]
    return np.stack([-(first + second), first, second], axis=2)


def _nearest_rotation(covariance: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The rotation that brings rest nearest to posed (Kabsch 1976), from the sum over vertices of `mass rest posedᵀ`, with rest
    about its centroid."""
    u, _, vt = np.linalg.svd(covariance.T)
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return u @ vt


def _pieces(faces: Int[Array, "faces 3"], area: Float[Array, "faces"], vertices: int) -> Int[Array, "vertices"]:
    """A number for each vertex, equal for those that are connected by faces, 0 for the piece of the largest area."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(links), dtype=bool), links.T), shape=(vertices, vertices))
    number, label = connected_components(graph, directed=False)
    main = int(np.bincount(label[faces[:, 0]], area, number).argmax())
    order = np.concatenate([[main], np.delete(np.arange(number), main)])
    rank = np.empty(number, dtype=np.int64)
    rank[order] = np.arange(number)
    return rank[label]


def _in_order(
    first: Int[Array, "unknowns"], unknown: Int[Array, "vertices"]
) -> tuple[Int[Array, "unknowns"], Int[Array, "vertices"]]:
    """The unknowns renumbered in the order in which their first vertices come."""
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[unknown]


def _diagonal(where: Int[Array, "entries"], value: float, size: int) -> Any:
    from scipy.sparse import csr_matrix

    return csr_matrix((np.full(len(where), value), (where, where)), shape=(size, size))


def _height_ratio(source: Float[Array, "vertices 3"], target: Float[Array, "vertices 3"]) -> float:
    heights = [float(np.ptp(rest[:, 1])) for rest in (source, target)]
    if min(heights) <= 0:
        raise RetargetError(f"the bodies' heights along +Y are {heights[0]:.3g} m and {heights[1]:.3g} m; give `scale`")
    return heights[1] / heights[0]


def _check(source: Array, target: Array, faces: Array, welded: Array | None) -> None:
    if len(source) != len(target):
        raise RetargetError(
            f"the source has {len(source)} vertices, the target {len(target)}; bodies with the same faces have equally many"
        )
    if len(faces) == 0:
        raise RetargetError("the bodies have no faces; deformation transfer needs a surface")
    if faces.min() < 0 or faces.max() >= len(source):
        wrong = faces.max() if faces.max() >= len(source) else faces.min()
        raise RetargetError(f"a face names vertex {wrong}; there are {len(source)}, numbered from 0")
    _check_finite(source, "the source's rest pose")
    _check_finite(target, "the target's rest pose")
    if welded is not None and len(welded) != len(source):
        raise RetargetError(f"`welded` has {len(welded)} entries; the bodies have {len(source)} vertices")


def _check_finite(vertices: Float[Array, "vertices 3"], what: str) -> None:
    if not np.isfinite(vertices).all():
        broken = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        raise RetargetError(f"{what} is not finite at {len(broken)} vertices, the first of them {broken[0]}")
