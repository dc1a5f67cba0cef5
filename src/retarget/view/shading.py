"""One picture of one posed mesh: what every point of the picture sees, lit. Light is linear until the last step.

The light is soft and comes with the camera, so that every view reads alike: a key light from the upper left that also
throws the shadow, a fill light from the right, a rim light from behind, and a sky that is brighter than the ground.
Open or wrongly wound meshes are lit on the side that is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from retarget.body.rotations import unit
from retarget.character import Mesh
from retarget.view.camera import Camera
from retarget.view.ground import BACKGROUND, blur, draw_ground
from retarget.view.rasterise import barycentric, rasterise
from retarget.view.surface import Surface, base_color, check_vertices, prepare_surface, smooth_normals, to_srgb

Array = np.ndarray


def render(
    mesh: Mesh | Surface,
    vertices: Float[Array, "vertices 3"],
    camera: Camera,
    width: int = 512,
    height: int = 512,
    floor: float | None = 0.0,
    samples: int = 2,
) -> UInt8[Array, "height width 3"]:
    """One picture of a mesh whose vertices (metres) are here.

    `floor` is the height of the ground that receives the shadow; None leaves it out. What lies below the ground shines
    through it faintly. Edges are smoothed over `samples` x `samples` points a pixel. Triangles that reach behind the
    camera are not drawn. For many pictures of one mesh hand in its `prepare_surface`. Raises `RetargetError` for
    vertices that are not finite or do not belong to the mesh.
    """
    surface = mesh if isinstance(mesh, Surface) else prepare_surface(mesh)
    check_vertices(surface.given, vertices)
    vertices = vertices[surface.kept].astype(np.float64, copy=False)
    if floor is None:
        picture = np.tile(BACKGROUND, (height, width, 1))
    else:
        picture = draw_ground(vertices, surface.mesh.faces, camera, width, height, floor)
    seen = _look(surface.mesh, vertices, camera, width, height, samples)
    if seen is None:
        return to_srgb(picture)

    color = base_color(surface, seen.points, seen.faces, seen.corners, seen.weights)
    eye = np.asarray(camera.target) + camera.axes()[2] * camera.distance
    color *= _light(smooth_normals(surface, vertices, seen.faces, seen.weights, eye), camera)
    color *= _crevices(seen.nearness, camera, height).ravel()[seen.pixels, None]
    cover = _cover(seen, vertices, camera, floor)
    color *= cover[:, None]
    rows, columns = seen.nearness.shape
    layers = [np.bincount(seen.pixels, layer, rows * columns).reshape(rows, columns) for layer in (*color.T, cover)]
    body = np.stack(layers, axis=-1) / samples**2
    part = picture[seen.top : seen.top + rows, seen.left : seen.left + columns]
    part[:] = part * (1.0 - body[..., 3:]) + _soften(body[..., :3])
    return to_srgb(picture)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the camera sees of a mesh, within the window of the picture that holds it."""

    left: int
    top: int
    points: Float[Array, "vertices 2"]
    """Vertices on the picture, in samples from the window's corner."""
    nearness: Float[Array, "rows columns"]
    """Nearness at the first sample of every pixel of the window, 0 for the background."""
    faces: Int[Array, "samples"]
    """The triangle that each sample sees; samples of the background are not listed."""
    corners: Int[Array, "samples 3"]
    weights: Float[Array, "samples 3"]
    """Barycentric weights of those corners, correct in perspective."""
    pixels: Int[Array, "samples"]
    """The window's pixel to which each sample belongs."""


def _look(
    mesh: Mesh, vertices: Float[Array, "vertices 3"], camera: Camera, width: int, height: int, samples: int
) -> _Seen | None:
    """Rasterise; None where nothing is in sight."""
    points, near = camera.project(vertices, width, height)
    ahead = points[near > 0]
    if len(ahead) == 0 or len(mesh.faces) == 0:
        return None
    left, top = np.clip(np.floor(ahead.min(axis=0)), 0, (width, height)).astype(int).tolist()
    right, bottom = np.clip(np.ceil(ahead.max(axis=0)), 0, (width, height)).astype(int).tolist()
    if right <= left or bottom <= top:
        return None
    points = (points - (left, top)) * samples
    wide, high = (right - left) * samples, (bottom - top) * samples
    fragments = rasterise(points, near, mesh.faces, wide, high)
    hit = np.flatnonzero(fragments.faces >= 0)
    rows, columns = np.divmod(hit, wide)
    faces = fragments.faces.ravel()[hit]
    corners = mesh.faces[faces]
    weights = barycentric(points, corners, np.stack([columns, rows], axis=1) + 0.5).astype(np.float32)
    weights *= near.astype(np.float32)[corners]
    weights /= weights.sum(axis=1, keepdims=True)
    pixels = rows // samples * (right - left) + columns // samples
    return _Seen(left, top, points, fragments.nearness[::samples, ::samples], faces, corners, weights, pixels)


def _cover(
    seen: _Seen, vertices: Float[Array, "vertices 3"], camera: Camera, floor: float | None
) -> Float[Array, "samples"]:
    """How opaque each sample is: what is under the ground, by more than 4 mm on a human body, shines through."""
    cover = np.ones(len(seen.faces), dtype=np.float32)
    if floor is not None and camera.elevation > 0 and vertices[:, 1].min() < floor:
        level = np.einsum("sc,sc->s", seen.weights, vertices[:, 1].astype(np.float32)[seen.corners])
        cover[level < floor - 0.002 * camera.scale] = 0.3
    return cover


def _light(normals: Float[Array, "samples 3"], camera: Camera) -> Float[Array, "samples 3"]:
    """How brightly a white surface shines."""
    right, up, back = camera.axes()
    fill, rim = unit(right * 0.9 + up * 0.15 + back * 0.6), unit(up * 0.7 - back * 0.5 - right * 0.25)
    lights = np.stack([camera.key_light(), fill, rim, np.array([0.0, 1.0, 0.0]), back], axis=1).astype(np.float32)
    key, fill, rim, sky, facing = (normals @ lights).T
    key = np.clip((key + 0.25) / 1.25, 0.0, None) ** 1.5  # wraps softly round the form
    edge = (1.0 - np.clip(facing, 0.0, 1.0)) ** 3
    tone = 0.24 + 0.17 * sky + 0.17 * np.clip(fill, 0.0, None)
    cool, warm = np.array([0.97, 1.0, 1.05], np.float32), np.array([1.03, 1.0, 0.95], np.float32)
    return (tone + 0.5 * edge * np.clip(rim, 0.0, None))[:, None] * cool + (0.86 * key)[:, None] * warm


def _crevices(near: Float[Array, "rows columns"], camera: Camera, height: int) -> Float[Array, "rows columns"]:
    """Darken what lies behind its surroundings: unsharp masking of the depth buffer (Luft et al. 2006), here over the
    body alone, so that the background neither darkens nor lightens an outline."""
    body = near > 0
    depth = np.where(body, 1.0 / np.where(body, near, 1.0) - camera.distance, 0.0).astype(np.float32)
    radius = max(1, round(0.022 * height * camera.scale / camera.span))
    mean = blur(depth, radius) / np.maximum(blur(body.astype(np.float32), radius), 1e-3)
    return 1.0 - 0.45 * np.clip((depth - mean) / (0.06 * camera.scale), 0.0, 1.0)


def _soften(linear: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Compress highlights: below 0.5 as it is, then ever flatter toward white."""
    return np.where(linear < 0.5, linear, 0.5 + 0.5 * np.tanh(2.0 * linear - 1.0))
