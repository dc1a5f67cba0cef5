"""The surface that a body is looked for on: one piece, closed enough, of moderate size, whatever the file holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.geometry.resample import Surface, cleaned, decimate, largest_pieces, subdivide
from retarget.geometry.shell import CELLS, covering_points, shell
from retarget.geometry.topology import areas, pieces, signed_volume

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
THINNEST = 1e-14
"""Area of a triangle, in squares of the extent, that is none."""
MOST_LEFT_OUT = 0.15
"""Share of the surface that may stand apart from the body: more looks like a second one."""
STANDS_APART = "stands apart from the largest part, as a second body would; leave one body in the file"
COARSEST = 40
"""Voxels along the longest side of a sparse cloud."""
LEAST_EXTENT = 0.35
"""Largest extent over the root of the area (a ball's is .56): what has less is crumpled, and a shell is laid around it."""
CRUMBS, FAR = 0.01, 0.1
"""Share of the area, and distance from all else in diagonals of its box, of pieces that a file has left lying about."""
STRAY, STRAY_AWAY = 8.0, 0.04
"""How many times as far from its neighbours as is usual, and in diagonals of the cloud, a stray point lies."""
LARGEST, SMALLEST = 1e30, 1e-30
"""Units from the origin, and across, beyond which squares of lengths are lost."""
THICKEST, TIGHT = 5, 0.85
"""Voxels that gaps are closed by, at most; and the share of a thicker shell's volume that one without leaks has."""


@dataclass(frozen=True, eq=False)
class WorkingSurface:
    """What is worked on in place of a mesh."""

    surface: Surface
    fused: bool
    """Whether it is a shell around many pieces, where what touches has grown together."""
    pieces: int
    left_out: float = 0.0
    """Share of what the shell would be around all there is that stands apart from it, like a second body."""


def working_surfaces(surface: Surface) -> Iterator[WorkingSurface]:
    """Connected surfaces of about `VERTICES` vertices, outward oriented, in which the body may be found: the largest piece
    where it reaches as far as everything together, then the shell around all pieces where there are several.

    Raises `RetargetError` where there is no area to work on.
    """
    surface = cleaned(surface)
    flat = (
        areas(surface.vertices, surface.faces)
        <= THINNEST * float(np.ptp(surface.vertices, axis=0).max(initial=0.0)) ** 2
    )
    left = len(flat) - int(flat.sum())
    if left < 4:
        raise RetargetError(f"the mesh has {left} triangle{'' if left == 1 else 's'} with an area; a body needs a surface")
    surface = _without_crumbs(surface)
    found = largest_pieces(surface)
    whole = np.ptp(surface.vertices, axis=0)
    span = float((np.ptp(found[0].vertices, axis=0) / np.maximum(whole, 1e-12 * whole.max())).min())
    if span >= WHOLE and float(whole.max()) > LEAST_EXTENT * surface_size(found[0]):
        yield WorkingSurface(_of_good_size(found[0]), False, len(found))
    else:
        span = 0.0
    if len(found) > 1 or span < WHOLE:
        around, left_out = _shell_of(surface)
        yield WorkingSurface(_of_good_size(around), True, len(found), left_out)


def _without_crumbs(surface: Surface) -> Surface:
    """Without the small pieces that lie far from all else: one stray triangle would be taken for a part of the extent."""
    label = pieces(surface.faces, len(surface))
    size = np.bincount(label, weights=areas(surface.vertices, surface.faces))
    order = np.argsort(size, kind="stable")
    small = np.zeros(len(size), dtype=bool)
    small[order] = np.cumsum(size[order]) < CRUMBS * size.sum()
    body = surface.vertices[surface.faces[~small[label]]]
    low, high = body.min(axis=(0, 1)), body.max(axis=(0, 1))
    away = FAR * float(np.linalg.norm(high - low))
    outside = (
        ((surface.vertices < low - away) | (surface.vertices > high + away)).any(axis=1)[surface.faces].all(axis=1)
    )
    far = small & (np.bincount(label, weights=outside, minlength=len(size)) == np.bincount(label))
    return cleaned(Surface(surface.vertices, surface.faces[~far[label]])) if far.any() else surface


def _of_good_size(surface: Surface) -> Surface:
    while len(surface) < FEWEST:
        surface, _ = subdivide(surface)
    return outward(largest_pieces(decimate(surface, VERTICES))[0])


def _shell_of(surface: Surface) -> tuple[Surface, float]:
    """The shell around all pieces, as thin as makes one piece of nearly all of it; and the share that is not in it."""
    step = float(np.ptp(surface.vertices, axis=0).max()) / CELLS
    return _thin_shell(covering_points(surface, 0.7 * step), CELLS)


def _thin_shell(
    points: Float[Array, "points 3"], cells: int, gaps: int | Int[Array, "points"] = 0
) -> tuple[Surface, float]:
    """The thinnest shell that is one piece but for crumbs and that a thicker one encloses no more with: then nothing leaks.

    `gaps` are voxels that it is thicker by, at each point. Beside it the share of vertices that its other pieces have. Raises
    `RetargetError` where there is nothing to lay a shell around.
    """
    gaps = np.broadcast_to(np.clip(gaps, 0, WIDEST), len(points))
    thin = largest_pieces(shell(points, 1 + gaps, cells))
    for thickness in range(2, THICKEST + 1):
        thicker = largest_pieces(shell(points, thickness + gaps, cells))
        if not thin or not thicker:
            thin = thin or thicker
            continue
        whole = _share_of_first(thin) > 0.98
        inside, more = (abs(float(signed_volume(each[0].vertices, each[0].faces))) for each in (thin, thicker))
        if whole and inside > TIGHT * more:
            break
        thin = thicker
    if not thin:
        raise RetargetError("no closed surface can be laid around it: it is a line, or points that lie too far apart")
    return thin[0], 1.0 - _share_of_first(thin)


def _share_of_first(found: list[Surface]) -> float:
    return len(found[0]) / sum(len(each) for each in found)


def surface_of_points(points: Float[Array, "points 3"]) -> Surface:
    """A closed surface around a cloud of points, as fine as the points allow, its vertices drawn to the nearest points.

    Points far from all others are left out. Raises `RetargetError` for fewer than `FEWEST_POINTS`, for points that are no
    surface, and for several things that stand apart.
    """
    from scipy.spatial import cKDTree

    _check_places(points)
    points = _without_strays(points)
    if len(points) < FEWEST_POINTS:
        raise RetargetError(
            f"the cloud has {len(points)} points; at least {FEWEST_POINTS} are needed to see a body in it"
        )
    tree = cKDTree(points)
    apart = tree.query(points, k=NEIGHBOURS)[0][:, -1]
    extent = float(np.ptp(points, axis=0).max())
    cells = int(np.clip(extent / max(float(np.median(apart)), 1e-12), COARSEST, CELLS))
    found, left_out = _thin_shell(points, cells, np.ceil(apart / extent * cells).astype(int) - 1)
    if left_out > MOST_LEFT_OUT:
        raise RetargetError(f"{100 * left_out:.0f} % of the surface around the points {STANDS_APART}")
    distance, near = tree.query(found.vertices, k=NEIGHBOURS)
    weight = np.exp(-((distance / np.maximum(distance.mean(axis=1, keepdims=True), 1e-12)) ** 2))
    drawn = np.einsum("vk,vkx->vx", weight / weight.sum(axis=1, keepdims=True), points[near])
    return outward(Surface(drawn, found.faces))


def _without_strays(points: Float[Array, "points 3"]) -> Float[Array, "kept 3"]:
    """Without points far from their neighbours, by what is usual in the cloud and by the size of its bulk."""
    from scipy.spatial import cKDTree

    if len(points) < FEWEST_POINTS:
        return points
    apart = cKDTree(points).query(points, k=NEIGHBOURS)[0][:, -1]
    bulk = float(np.linalg.norm(np.ptp(np.percentile(points, (2, 98), axis=0), axis=0)))
    return points[apart <= max(STRAY * float(np.median(apart)), STRAY_AWAY * bulk)]


def outward(surface: Surface) -> Surface:
    """The same with faces turned so that the volume inside is positive (of an open surface, as seen from its middle)."""
    if signed_volume(surface.vertices - surface.vertices.mean(axis=0), surface.faces) < 0:
        return Surface(surface.vertices, surface.faces[:, ::-1])
    return surface


def surface_size(surface: Surface) -> float:
    """The square root of the area, in units of the surface."""
    return float(np.sqrt(areas(surface.vertices, surface.faces).sum()))


def finite_surface(vertices: Float[Array, "vertices 3"], faces: Array) -> Surface:
    """Check what came from a file. Raises `RetargetError` for places that are not finite, all the same or beyond all
    measure, and for meshes of more faces than can be worked on."""
    if not np.isfinite(vertices).all():
        raise RetargetError(f"{int((~np.isfinite(vertices)).any(axis=1).sum())} vertices are not finite numbers")
    if len(faces) > MOST_FACES:
        raise RetargetError(f"the mesh has {len(faces)} faces; up to {MOST_FACES} can be rigged")
    _check_places(vertices)
    return Surface(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))


def _check_places(places: Float[Array, "places 3"]) -> None:
    if len(places) == 0 or float(np.ptp(places, axis=0).max()) <= 0.0:
        raise RetargetError("all vertices lie in one place; a body needs a surface")
    farthest, extent = float(np.abs(places).max()), float(np.ptp(places, axis=0).max())
    if farthest > LARGEST or extent < SMALLEST:
        raise RetargetError(f"it is {extent:.3g} units large, {farthest:.3g} from the origin: no lengths to work with")
