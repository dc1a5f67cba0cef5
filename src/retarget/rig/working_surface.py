"""The surface that a body is looked for on: one piece, closed enough, of moderate size, whatever the file holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.geometry.resample import Surface, cleaned, decimate, largest_pieces, subdivide
from retarget.geometry.shell import CELLS, covering_points, shell
from retarget.geometry.topology import areas, signed_volume

Array = np.ndarray

VERTICES = 5_000
FEWEST = 2_500
"""Coarser surfaces are subdivided."""
MOST_FACES = 4_000_000
WHOLE = 0.9
"""Share of the extent on every axis: a piece that reaches so far may be the body, and what else there is its clothes."""
FEWEST_POINTS, NEIGHBOURS = 300, 8
WIDEST = 8
"""Voxels between sparse points of a cloud that are bridged, at most."""
COARSEST = 40
"""Voxels along the longest side of a sparse cloud."""
THICKEST, TIGHT = 5, 0.85
"""Voxels that gaps are closed by, at most; and the share of a thicker shell's volume that one without leaks has."""


@dataclass(frozen=True, eq=False)
class WorkingSurface:
    """What is worked on in place of a mesh."""

    surface: Surface
    fused: bool
    """Whether it is a shell around many pieces, where what touches has grown together."""
    pieces: int


def working_surfaces(surface: Surface) -> Iterator[WorkingSurface]:
    """Connected surfaces of about `VERTICES` vertices, outward oriented, in which the body may be found: the largest piece
    where it reaches as far as everything together, then the shell around all pieces where there are several.

    Raises `RetargetError` where there is no area to work on.
    """
    surface = cleaned(surface)
    if len(surface.faces) < 4:
        raise RetargetError(f"the mesh has {len(surface.faces)} triangles with an area; a body needs a surface")
    found = largest_pieces(surface)
    whole = np.ptp(surface.vertices, axis=0)
    span = float((np.ptp(found[0].vertices, axis=0) / np.maximum(whole, 1e-12 * whole.max())).min())
    if span >= WHOLE:
        yield WorkingSurface(_of_good_size(found[0]), False, len(found))
    if len(found) > 1 or span < WHOLE:
        yield WorkingSurface(_of_good_size(_shell_of(surface)), True, len(found))


def _of_good_size(surface: Surface) -> Surface:
    while len(surface) < FEWEST:
        surface, _ = subdivide(surface)
    return outward(largest_pieces(decimate(surface, VERTICES))[0])


def _shell_of(surface: Surface) -> Surface:
    """The shell around all pieces, as thin as makes one piece of nearly all of it."""
    step = float(np.ptp(surface.vertices, axis=0).max()) / CELLS
    return _thin_shell(covering_points(surface, 0.7 * step), CELLS)


def _thin_shell(points: Float[Array, "points 3"], cells: int, gaps: int | Int[Array, "points"] = 0) -> Surface:
    """The thinnest shell that is one piece but for crumbs and that a thicker one encloses no more with: then nothing leaks.

    `gaps` are voxels that it is thicker by, at each point.
    """
    gaps = np.broadcast_to(np.clip(gaps, 0, WIDEST), len(points))
    thin = largest_pieces(shell(points, 1 + gaps, cells))
    for thickness in range(2, THICKEST + 1):
        thicker = largest_pieces(shell(points, thickness + gaps, cells))
        whole = len(thin[0]) > 0.98 * sum(len(each) for each in thin)
        inside, more = (abs(float(signed_volume(each[0].vertices, each[0].faces))) for each in (thin, thicker))
        if whole and inside > TIGHT * more:
            break
        thin = thicker
    return thin[0]


def surface_of_points(points: Float[Array, "points 3"]) -> Surface:
    """A closed surface around a cloud of points, as fine as the points allow, its vertices drawn to the nearest points.

    Raises `RetargetError` for fewer than `FEWEST_POINTS`.
    """
    from scipy.spatial import cKDTree

    if len(points) < FEWEST_POINTS:
        raise RetargetError(f"the cloud has {len(points)} points; at least {FEWEST_POINTS} are needed to see a body in it")
    tree = cKDTree(points)
    apart = tree.query(points, k=NEIGHBOURS)[0][:, -1]
    extent = float(np.ptp(points, axis=0).max())
    cells = int(np.clip(extent / max(float(np.median(apart)), 1e-12), COARSEST, CELLS))
    found = _thin_shell(points, cells, np.ceil(apart / extent * cells).astype(int) - 1)
    distance, near = tree.query(found.vertices, k=NEIGHBOURS)
    weight = np.exp(-((distance / np.maximum(distance.mean(axis=1, keepdims=True), 1e-12)) ** 2))
    drawn = np.einsum("vk,vkx->vx", weight / weight.sum(axis=1, keepdims=True), points[near])
    return outward(Surface(drawn, found.faces))


def outward(surface: Surface) -> Surface:
    """The same with faces turned so that the volume inside is positive."""
    if signed_volume(surface.vertices, surface.faces) < 0:
        return Surface(surface.vertices, surface.faces[:, ::-1])
    return surface


def surface_size(surface: Surface) -> float:
    """The square root of the area, in units of the surface."""
    return float(np.sqrt(areas(surface.vertices, surface.faces).sum()))


def finite_surface(vertices: Float[Array, "vertices 3"], faces: Array) -> Surface:
    """Check what came from a file. Raises `RetargetError` for places that are not finite or all the same, and for meshes
    of more faces than can be worked on."""
    if not np.isfinite(vertices).all():
        raise RetargetError(f"{int((~np.isfinite(vertices)).any(axis=1).sum())} vertices are not finite numbers")
    if len(faces) > MOST_FACES:
        raise RetargetError(f"the mesh has {len(faces)} faces; up to {MOST_FACES} can be rigged")
    if len(vertices) == 0 or float(np.ptp(vertices, axis=0).max()) <= 0.0:
        raise RetargetError("all vertices lie in one place; a body needs a surface")
    return Surface(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
