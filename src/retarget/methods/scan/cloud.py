"""One frame of a capture, made ready: thinned to even density, without floor and what floats about, binned for neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped

Array = np.ndarray

CELL = 0.02
"""Metres: of the points in a cube of this side the mean is taken. Raw clouds are dense at heads and hands."""
MOST = 1800
"""Points that are kept of a cloud, evenly."""
MOST_CELLS = 2_000_000
"""Cubes around a cloud; where there are more, what lies far off is left out first, and then cubes are larger."""
BIN = 0.05
"""Metres: side of the cubes in which neighbours are looked for."""
FLOOR_BAND, FLOOR_ABOVE, FLOOR_CELL = 0.03, 0.15, 0.06
"""Metres: what lies so near to the lowest points, with nothing above it within so much, in columns of this side, is floor."""
FLOOR_WIDE = 1.0
"""Metres: the lowest band of a body alone is not so wide, unless it lies."""
FLOOR_SHARE = 0.07
"""Share of the points in the lowest band from which some are floor, however wide it is: feet alone come to .04."""


@dataclass(frozen=True, eq=False)
class Bins:
    """Points in cubic cells; see `fit_kernels`."""

    points: Float[Array, "points 3"]
    low: Float[Array, "3"]
    dims: Int[Array, "3"]
    starts: Int[Array, "_"]
    order: Int[Array, "points"]
    by_cell: Float[Array, "points 3"]
    """The points in this order."""

    def nearest(self, queries: Float[Array, "queries 3"], reach: float) -> tuple[Int[Array, "queries"], Float[Array, "queries"]]:
        """The nearest point to each query at about `reach` metres or less, -1 where there is none, and squared distances."""
        import retarget.methods.scan.fit_kernels as kernels

        found, squares = np.empty(len(queries), dtype=np.int32), np.empty(len(queries))
        rings = max(1, int(np.ceil(reach / BIN)))
        kernels.nearest(queries, self.by_cell, self.low, BIN, self.dims, self.starts, self.order, rings, found, squares)
        return found, squares


def binned(points: Float[Array, "points 3"]) -> Bins:
    """Points prepared for questions after neighbours."""
    import retarget.methods.scan.fit_kernels as kernels

    low, high = np.zeros(3), np.zeros(3)
    if len(points):
        kernels.extent(points, low, high)
    dims = np.minimum(((high - low) / BIN).astype(np.int64) + 1, 400)
    starts, order = np.empty(int(dims.prod()) + 1, dtype=np.int32), np.empty(len(points), dtype=np.int32)
    kernels.fill_bins(points, low, BIN, dims, starts, order)
    return Bins(points, low, dims, starts, order, points[order])


def thinned(points: Shaped[Array, "points 3"], most: int = MOST) -> Float[Array, "thinned 3"]:
    """The cloud at even density, at most `most` points, metres; without points that are not finite. Their order does not
    matter."""
    import retarget.methods.scan.fit_kernels as kernels

    points = np.ascontiguousarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        points = points[finite]
    if not len(points):
        return points
    low, high = points.min(axis=0), points.max(axis=0)
    if ((high - low) / CELL + 1).prod() > MOST_CELLS:
        middle = np.median(points, axis=0)
        points = points[(np.abs(points - middle) < 1.5).all(axis=1)]
        low, high = points.min(axis=0), points.max(axis=0)
    dims = ((high - low) / CELL).astype(np.int64) + 1
    means = np.empty((len(points), 3))
    count = kernels.voxel_means(points, low, CELL, dims, means)
    return fewer(means[:count], most)


def fewer(points: Float[Array, "points 3"], most: int = MOST) -> Float[Array, "fewer 3"]:
    """At most so many of the points, evenly chosen."""
    count = len(points)
    return points if count <= most else points[(np.arange(most) * count) // most]


def without_floor(points: Float[Array, "points 3"]) -> Float[Array, "kept 3"]:
    """The cloud without what is left of a floor beside the feet; +Y is up."""
    if len(points) < 50:
        return points
    lowest = np.partition(points[:, 1], 4)[4]
    band = points[:, 1] < lowest + FLOOR_BAND
    flat = points[band][:, [0, 2]]
    if (np.ptp(flat, axis=0) < FLOOR_WIDE).all() and band.mean() < FLOOR_SHARE:
        return points
    above = points[(points[:, 1] >= lowest + FLOOR_BAND) & (points[:, 1] < lowest + FLOOR_ABOVE)][:, [0, 2]]
    low = flat.min(axis=0) - 2 * FLOOR_CELL
    dims = ((flat.max(axis=0) - low) / FLOOR_CELL).astype(np.int64) + 3
    covered = np.zeros(dims, dtype=bool)
    cells = ((above - low) / FLOOR_CELL).astype(np.int64)
    inside = ((cells > 0) & (cells < dims - 1)).all(axis=1)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            covered[cells[inside, 0] + i, cells[inside, 1] + j] = True
    own = ((flat - low) / FLOOR_CELL).astype(np.int64)
    kept = ~band
    kept[np.flatnonzero(band)] = covered[own[:, 0], own[:, 1]]
    return points[kept]


def pieces(points: Float[Array, "points 3"], gap: float = 0.12) -> Int[Array, "points"]:
    """Which piece each point of a thinned cloud belongs to, the largest first: points nearer than about `gap` metres hang
    together."""
    from scipy.ndimage import label

    cells = ((points - points.min(axis=0)) / gap).astype(np.int64)
    filled = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    filled[tuple(cells.T)] = True
    numbers = label(filled, structure=np.ones((3, 3, 3)))[0][tuple(cells.T)] - 1
    rank = np.argsort(np.argsort(-np.bincount(numbers), kind="stable"), kind="stable")
    return rank[numbers]
