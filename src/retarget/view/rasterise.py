"""Which triangle every pixel sees: a scanline rasteriser with a depth buffer, vectorised over all triangles.

Every triangle is cut into its pixel rows, every row into the pixels whose centres it covers, so that work grows with
the covered pixels and large and small triangles take the same path. Neighbours share the exact end points of their
rows: no pixel between them is missed or drawn twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

CHUNK = 2_000_000
"""Pixels that one pass may expand at once (about 60 bytes each); a single larger triangle still passes alone."""
FAR = 1e8
"""Pixels from the picture's corner beyond which a corner is not drawn any more."""


@dataclass(frozen=True, eq=False)
class Fragments:
    """What the pixels of a picture see; row 0 is the top."""

    faces: Int[Array, "height width"]
    """The nearest triangle at each pixel's centre, -1 where there is none."""
    nearness: Float[Array, "height width"]
    """Its nearness there, 0 where there is none."""


def rasterise(
    points: Float[Array, "vertices 2"],
    nearness: Float[Array, "vertices"],
    faces: Int[Array, "faces 3"],
    width: int,
    height: int,
) -> Fragments:
    """The nearest triangle at every pixel centre.

    `points` are pixels, x right and y down, the first pixel's centre at (0.5, 0.5). `nearness` is larger for nearer
    points and affine on the picture plane: the inverse of the depth in perspective. Both sides of a triangle are
    drawn. Triangles with a corner of no positive nearness (behind the eye), not finite or beyond `FAR`, without area or
    outside the picture are passed over; equally near ones are won by the higher index.
    """
    buffer = np.zeros(height * width, dtype=np.uint64)
    corners = np.concatenate([points, nearness[:, None]], axis=1).astype(np.float64)
    usable = (np.abs(corners) < FAR).all(axis=1) & (corners[:, 2] > 0)
    kept = np.flatnonzero(usable[faces].all(axis=1)) if len(faces) else np.empty(0, dtype=np.int64)
    for chosen, ordered in _chunks(corners, faces, kept, width, height):
        _draw(buffer, ordered, chosen, width, height)
    buffer = buffer.reshape(height, width)
    # Positive single precision numbers are ordered as their bits are, so one integer holds depth and owner.
    seen = (buffer >> np.uint64(32)).astype(np.uint32).view(np.float32)
    return Fragments(buffer.astype(np.uint32).astype(np.int32) - 1, seen)


def _chunks(
    corners: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], kept: Int[Array, "kept"], width: int, height: int
) -> Iterator[tuple[Int[Array, "chunk"], Float[Array, "chunk 3 3"]]]:
    """Faces that touch the picture, their corners sorted from top to bottom, in portions of bounded cost."""
    for start in range(0, len(kept), CHUNK // 20):
        part = kept[start : start + CHUNK // 20]
        triangles = corners[faces[part]]
        order = np.argsort(triangles[:, :, 1], axis=1)
        triangles = np.take_along_axis(triangles, order[:, :, None], axis=1)
        rows = _first_centre(triangles[:, 2, 1], height) - _first_centre(triangles[:, 0, 1], height)
        x = triangles[:, :, 0]
        columns = _first_centre(x.max(axis=1), width) - _first_centre(x.min(axis=1), width)
        touching = np.flatnonzero((rows > 0) & (columns > 0))
        cost = np.cumsum(rows[touching] * columns[touching])
        cuts = np.searchsorted(cost, np.arange(CHUNK, cost[-1], CHUNK)) if len(cost) else []
        for piece in np.split(touching, np.unique(cuts)):
            if len(piece):
                yield part[piece], triangles[piece]


def _first_centre(position: Float[Array, "*batch"], limit: int) -> Int[Array, "*batch"]:
    """The first pixel whose centre is not before `position`, within 0..limit: one past the last that is before."""
    return np.ceil(np.clip(position - 0.5, 0, limit)).astype(np.int64)


def _draw(
    buffer: Array, triangles: Float[Array, "faces 3 3"], owners: Int[Array, "faces"], width: int, height: int
) -> None:
    """Lay triangles (corners sorted by y) into the buffer: nearness in the upper 32 bits, face + 1 in the lower."""
    # The edges of a triangle: top to bottom, top to middle, middle to bottom.
    start = triangles[:, [0, 0, 1]].reshape(-1, 3)
    run = (triangles[:, [2, 1, 2]] - triangles[:, [0, 0, 1]]).reshape(-1, 3)
    slope = run / np.where(run[:, 1:2] > 1e-9, run[:, 1:2], 1.0)
    x0, y0, n0 = np.ascontiguousarray(start.T)
    x_slope, _, n_slope = np.ascontiguousarray(slope.T)

    first = _first_centre(triangles[:, 0, 1], height)
    face, step = _expand(_first_centre(triangles[:, 2, 1], height) - first)
    row = first[face] + step
    y = row + 0.5
    edge = 3 * face
    down = y - y0[edge]
    xa, na = x0[edge] + down * x_slope[edge], n0[edge] + down * n_slope[edge]
    edge += 1 + (y >= triangles[:, 1, 1][face])
    down = y - y0[edge]
    xb, nb = x0[edge] + down * x_slope[edge], n0[edge] + down * n_slope[edge]

    left = np.minimum(xa, xb)
    column = _first_centre(left, width)
    span, step = _expand(_first_centre(np.maximum(xa, xb), width) - column)
    # Both ends of a span lie on edges, so that even a sliver's nearness stays inside its range.
    across = (nb - na) / np.where(xa == xb, 1.0, xb - xa)
    base = na + (column + 0.5 - xa) * across
    seen = base.astype(np.float32)[span] + across.astype(np.float32)[span] * step.astype(np.float32)
    key = seen.view(np.uint32).astype(np.uint64) << np.uint64(32)
    key |= (owners + 1).astype(np.uint64)[face][span]
    np.maximum.at(buffer, (row * width + column)[span] + step, key)


def _expand(counts: Int[Array, "items"]) -> tuple[Int[Array, "total"], Int[Array, "total"]]:
    """Repeat each index as often as its count, with the number of the repetition: [2, 0, 1] gives 0 0 2 and 0 1 0."""
    counts = np.maximum(counts, 0)
    item = np.repeat(np.arange(len(counts)), counts)
    return item, np.arange(len(item)) - np.repeat(np.cumsum(counts) - counts, counts)


def barycentric(
    points: Float[Array, "vertices 2"], corners: Int[Array, "samples 3"], at: Float[Array, "samples 2"]
) -> Float[Array, "samples 3"]:
    """Weights of a triangle's corners at a point of the picture, not negative, sum to one."""
    x, y = (points[:, k][corners.T] - at[:, k] for k in (0, 1))
    parts = np.stack([x[i] * y[j] - x[j] * y[i] for i, j in ((1, 2), (2, 0), (0, 1))])
    total = parts.sum(axis=0)
    weights = np.clip(parts / np.where(total == 0, 1.0, total), 0.0, 1.0)
    sums = weights.sum(axis=0)
    return np.where(sums > 0, weights / np.where(sums > 0, sums, 1.0), 1.0 / 3.0).T
