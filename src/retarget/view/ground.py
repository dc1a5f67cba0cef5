"""The ground of a picture, drawn without triangles: a soft grid that fades away, and the shadow of the body on it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from retarget.view.camera import Camera
from retarget.view.rasterise import rasterise

Array = np.ndarray

BACKGROUND = np.array([0.905, 0.905, 0.895], dtype=np.float32)
"""Colour of everything without a subject, linear."""
GROUND = np.array([0.78, 0.785, 0.78], dtype=np.float32)
LINE = np.array([0.52, 0.53, 0.54], dtype=np.float32)
SHADOW = np.array([0.30, 0.32, 0.36], dtype=np.float32)
REACH = 1.5
"""The ground has faded away at this distance from the target, in units of the camera's scale."""
MAP = 160
"""Texels along the longer side of the shadow, without its blurred border."""


def draw_ground(
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    camera: Camera,
    width: int,
    height: int,
    floor: float,
) -> Float[Array, "height width 3"]:
    """Ground, grid and shadow in linear light; the background where the ground has faded or is not seen.

    The grid stands still in the world (lines every 0.5 m for a body of human size), so that a walk is seen to travel.
    """
    picture = np.empty((height, width, 3), dtype=np.float32)
    picture[:] = BACKGROUND
    rows, x, z = _ground_points(camera, width, height, floor)
    if len(rows) < 2:
        return picture
    away = np.hypot(x - camera.target[0], z - camera.target[2]) / camera.scale
    across = np.abs((np.arange(width) + 0.5) / width * 2 - 1)
    across = _smooth((1.0 - across) / 0.35).astype(np.float32)
    step = grid_step(camera.scale)
    lines = np.maximum(_lines(x, step, camera.scale), _lines(z, step, camera.scale))
    strength = np.clip(1.25 - away / REACH * 1.25, 0.0, 1.0) * across
    part = BACKGROUND + (GROUND - BACKGROUND) * strength[..., None] + (LINE - GROUND) * (lines * strength)[..., None]
    if len(faces):
        dark = _shadow(vertices, faces, camera.key_light(), floor, x, z) * _smooth(np.minimum(across * 2, 1.0))
        part *= 1.0 - dark[..., None] * (1.0 - SHADOW)
    picture[rows] = part
    return picture


def grid_step(scale: float) -> float:
    """Distance of the grid lines in metres: the 1, 2 or 5 times a power of ten next below 0.4 of the body."""
    power = 10.0 ** np.floor(np.log10(0.4 * scale))
    return float(max(k * power for k in (1, 2, 5) if k * power <= 0.4 * scale))


def _ground_points(
    camera: Camera, width: int, height: int, floor: float
) -> tuple[Int[Array, "rows"], Float[Array, "rows width"], Float[Array, "rows width"]]:
    """The pixel rows that see ground within reach, and the world x and z of what their pixels see."""
    right, up, back = camera.axes()
    pixel = camera.span / height
    u = (np.arange(width) + 0.5 - width / 2) * pixel
    v = camera.shift + (height / 2 - np.arange(height) - 0.5) * pixel
    ray = v[:, None] * up - camera.distance * back  # the part toward the right is level
    eye = np.asarray(camera.target) + camera.distance * back
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (floor - eye[1]) / ray[:, 1]
        x, z = eye[0] + along * ray[:, 0], eye[2] + along * ray[:, 2]
        away = np.hypot(x - camera.target[0], z - camera.target[2])
        rows = np.flatnonzero((along > 0) & (away < REACH * camera.scale))
    along = along[rows, None]
    x, z = ((start[rows, None] + along * u * right[k]).astype(np.float32) for start, k in ((x, 0), (z, 2)))
    return rows, x, z


def _lines(position: Float[Array, "rows width"], step: float, scale: float) -> Float[Array, "rows width"]:
    """How much of each pixel a family of parallel lines covers."""
    pixel = np.abs(np.gradient(position, axis=0)) + np.abs(np.gradient(position, axis=1))
    pixel = np.maximum(pixel, 1e-9 * scale)
    half = 0.002 * scale
    distance = np.abs(position / step - np.round(position / step)) * step
    return np.clip((half - distance) / pixel + 0.5, 0.0, 1.0) * np.minimum(1.0, 2 * half / pixel)


def _shadow(
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    light: Float[Array, "3"],
    floor: float,
    x: Float[Array, "rows width"],
    z: Float[Array, "rows width"],
) -> Float[Array, "rows width"]:
    """Darkness of the ground: what stands on it throws a dark narrow shadow, what floats a pale wide one."""
    above = np.maximum(vertices[:, 1] - floor, 0.0)
    cast = vertices[:, [0, 2]] - above[:, None] * light[[0, 2]] / light[1]
    low, high = cast.min(axis=0), cast.max(axis=0)
    size = max(float((high - low).max()), float(above.max()), 1e-6)
    texel, border = size / MAP, MAP // 6
    wide, deep = (np.ceil((high - low) / texel).astype(int) + 2 * border + 1).tolist()
    seen = rasterise((cast - low) / texel + border, size / (size + above), faces, wide, deep)
    cover = seen.nearness > 0
    lift = np.where(cover, 1.0 / np.where(cover, seen.nearness, 1.0) - 1.0, 0.0)  # height above ground / size
    contact = blur(np.exp(-lift / 0.03) * cover, 3)
    body = 0.6 * blur(np.exp(-lift / 0.35) * cover, 3) + 0.4 * blur(cover.astype(np.float64), border // 3)
    dark = np.clip(0.55 * body + 0.5 * contact, 0.0, 0.95)
    return _bilinear(dark, (x - low[0]) / texel + border - 0.5, (z - low[1]) / texel + border - 0.5)


def _bilinear(
    image: Float[Array, "rows columns"], x: Float[Array, "high wide"], y: Float[Array, "high wide"]
) -> Float[Array, "high wide"]:
    """The image between its texel centres, 0 outside."""
    rows, columns = image.shape
    inside = np.nonzero((x >= 0) & (y >= 0) & (x < columns - 1) & (y < rows - 1))
    i, j = y[inside].astype(np.int64), x[inside].astype(np.int64)
    s, t = y[inside] - i, x[inside] - j
    result = np.zeros(x.shape)
    above = image[i, j] * (1 - t) + image[i, j + 1] * t
    below = image[i + 1, j] * (1 - t) + image[i + 1, j + 1] * t
    result[inside] = above * (1 - s) + below * s
    return result


def blur(image: Float[Array, "rows columns"], radius: int) -> Float[Array, "rows columns"]:
    """Three box blurs, close to a Gaussian of standard deviation `radius`; outside the image there is nothing (0)."""
    for axis in (0, 1) * 3:
        pad = [(0, 0), (0, 0)]
        pad[axis] = (radius + 1, radius)
        sums = np.cumsum(np.pad(image, pad), axis=axis)
        size = 2 * radius + 1
        upper, lower = (slice(size, None), slice(None, -size)) if axis == 0 else (np.s_[:, size:], np.s_[:, :-size])
        image = (sums[upper] - sums[lower]) / size
    return image


def _smooth(t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
