"""One closed surface around all there is: what is left of a body in many pieces, with holes, or of bare points.

Voxels that hold surface are made thicker until gaps close; what cannot be reached from outside is body; its border, moved
back inwards by the same thickness, is the shell. What touches grows together, which a single good surface is spared.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.errors import RetargetError
from retarget.geometry.resample import Surface

Array = np.ndarray

CELLS = 150
"""Voxels along the longest side."""
SOFTNESS = 0.8
"""Voxels over which the border is smoothed."""
MOST_COVERING = 20_000_000
"""Points that a surface is covered by, at most: many times what a body takes at `CELLS`."""


def shell(
    points: Float[Array, "points 3"], thickness: int | Int[Array, "points"] = 1, cells: int = CELLS
) -> Surface:
    """The closed surface around points that lie no farther apart than the thickness (in voxels, of all or of each) bridges.

    May have several pieces where the points do. Vertices lie within about a voxel of the points.
    """
    from scipy import ndimage

    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    step = max(float(extent.max()) / cells, 1e-12)
    thickness = np.broadcast_to(thickness, len(points))
    pad = int(thickness.max()) + 4
    shape = np.ceil(extent / step).astype(int) + 2 * pad + 1
    origin = low - pad * step
    places = np.round((points - origin) / step).astype(int)
    beyond, thick = np.full(shape, np.inf), np.zeros(shape)
    for level in np.unique(thickness):
        free = np.ones(shape, dtype=bool)
        free[tuple(places[thickness == level].T)] = False
        away = ndimage.distance_transform_edt(free) - level
        thick[away < beyond] = level
        np.minimum(beyond, away, out=beyond)
    outside, _ = ndimage.label(beyond > 0)
    body = outside != outside[0, 0, 0]
    inwards, outwards = ndimage.distance_transform_edt(body), ndimage.distance_transform_edt(~body)
    field = ndimage.gaussian_filter(outwards - inwards + thick, SOFTNESS)
    return _border(field, origin, step)


def covering_points(surface: Surface, step: float) -> Float[Array, "points 3"]:
    """Points on all faces, no farther apart than a step.

    Raises `RetargetError` for a surface of so large an area for its step that more than `MOST_COVERING` points would do it.
    """
    corners = surface.vertices[surface.faces]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    longest = np.sqrt(np.maximum.reduce([(side**2).sum(axis=1) for side in (ab, ac, ac - ab)]))
    divisions = np.maximum(1, np.ceil(longest / step)).astype(int)
    total = int(((divisions + 1) * (divisions + 2) // 2).sum())
    if total > MOST_COVERING:
        raise RetargetError(
            f"its {len(surface.faces)} triangles criss-cross: together they have many times the area of any body of this size"
        )
    found = [surface.vertices]
    for count in np.unique(divisions):
        own = divisions == count
        u, v = (axis.ravel() / count for axis in np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij"))
        inside = u + v <= 1 + 1e-9
        grid = a[own][:, None] + ab[own][:, None] * u[inside][:, None] + ac[own][:, None] * v[inside][:, None]
        found.append(grid.reshape(-1, 3))
    return np.concatenate(found)


def _border(field: Float[Array, "x y z"], origin: Float[Array, "3"], step: float) -> Surface:
    """The surface where a field is nought, negative inside: one vertex a cell that it crosses, at the mean of the crossings
    of the cell's edges (naive surface nets, Gibson 1998)."""
    size = np.array(field.shape) - 1
    total, count = np.zeros((*size, 3)), np.zeros(size)
    crossings = [_crossings(field, axis) for axis in range(3)]
    for axis, (index, _, place) in enumerate(crossings):
        position = index.astype(float)
        position[:, axis] += place
        for cell in _around(index, axis):
            inside = ((cell >= 0) & (cell < size)).all(axis=1)
            np.add.at(total, tuple(cell[inside].T), position[inside])
            np.add.at(count, tuple(cell[inside].T), 1)
    active = count > 0
    number = np.full(size, -1)
    number[active] = np.arange(int(active.sum()))
    faces = []
    for axis, (index, leaving, _) in enumerate(crossings):
        quads = np.stack([number[tuple(cell.T)] for cell in _around(index, axis)], axis=1)
        quads[~leaving] = quads[~leaving][:, ::-1]
        faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return Surface(origin + total[active] / count[active][:, None] * step, np.concatenate(faces))


def _crossings(
    field: Float[Array, "x y z"], axis: int
) -> tuple[Int[Array, "crossings 3"], Bool[Array, "crossings"], Float[Array, "crossings"]]:
    """Edges along an axis whose ends differ in sign: their first end, whether they lead out of the body, and where it is nought."""
    first, second = [slice(None)] * 3, [slice(None)] * 3
    first[axis], second[axis] = slice(0, -1), slice(1, None)
    a, b = field[tuple(first)], field[tuple(second)]
    differ = (a < 0) != (b < 0)
    return np.argwhere(differ), a[differ] < 0, a[differ] / (a[differ] - b[differ])


def _around(index: Int[Array, "crossings 3"], axis: int) -> list[Int[Array, "crossings 3"]]:
    """The four cells around an edge, in turn."""
    y, z = (axis + 1) % 3, (axis + 2) % 3
    cells = []
    for dy, dz in ((0, 0), (1, 0), (1, 1), (0, 1)):
        cell = index.copy()
        cell[:, y] -= dy
        cell[:, z] -= dz
        cells.append(cell)
    return cells
