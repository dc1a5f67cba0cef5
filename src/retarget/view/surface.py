"""A mesh as pictures see it: its base colour and its smooth normals at any point of its triangles."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from retarget.body.rotations import unit
from retarget.character import Material, Mesh
from retarget.errors import RetargetError

Array = np.ndarray
log = logging.getLogger("retarget")

TEXTURE_SIZE = 1024
"""Larger textures are reduced: a picture's cell has no more pixels than that."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What all pictures of one mesh share; `prepare_surface` makes one."""

    mesh: Mesh
    """Without the vertices of no face."""
    kept: Int[Array, "vertices"]
    """Which of the original mesh's vertices these are."""
    given: int
    """Number of the original mesh's vertices."""
    welded: Int[Array, "vertices"]
    """The first vertex at the same rest position: where texture seams split a vertex, its halves are lit as one."""
    textures: tuple[tuple[Float[Array, "_ _ 3"], ...] | None, ...]
    """A material's linear base colour texture at full, half, quarter... size; None for a material without one."""
    factors: Float[Array, "materials 3"]
    material: Int[Array, "faces"]


def prepare_surface(mesh: Mesh) -> Surface:
    """Decode the textures and find vertices that coincide. A texture that cannot be read is left out with a warning."""
    kept, faces = np.unique(mesh.faces, return_inverse=True)
    given, uvs = len(mesh.vertices), None if mesh.uvs is None else mesh.uvs[kept]
    mesh = replace(mesh, vertices=mesh.vertices[kept], faces=faces.reshape(-1, 3), uvs=uvs)
    _, first, group = np.unique(np.round(mesh.vertices, 7), axis=0, return_index=True, return_inverse=True)
    materials = mesh.materials or (Material(base_color=(0.62, 0.62, 0.62, 1.0)),)
    textures = tuple(_texture(each) if mesh.uvs is not None and each.image else None for each in materials)
    factors = np.array([each.base_color[:3] for each in materials], dtype=np.float32).reshape(-1, 3)
    which = np.zeros(len(mesh.faces), dtype=np.int64) if mesh.face_materials is None else mesh.face_materials
    return Surface(mesh, kept, given, first[group.reshape(-1)], textures, factors, which)


def _texture(material: Material) -> tuple[Float[Array, "_ _ 3"], ...] | None:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(material.image)) as image:
            image.draft("RGB", (TEXTURE_SIZE, TEXTURE_SIZE))
            level = image.convert("RGB").reduce(max(1, min(image.size) // TEXTURE_SIZE))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        log.warning("the texture of material %r cannot be read and is left out: %s", material.name, error)
        return None
    levels = [to_linear(np.asarray(level))]
    while min(level.size) > 1:
        level = level.reduce(2)
        levels.append(to_linear(np.asarray(level)))
    return tuple(levels)


def to_linear(srgb: UInt8[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Bytes of a picture to linear light in 0..1."""
    value = np.arange(256) / 255.0
    table = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return table.astype(np.float32)[srgb]


def to_srgb(linear: Float[Array, "*shape"]) -> UInt8[Array, "*shape"]:
    """Linear light to the bytes of a picture; what is brighter than white becomes white."""
    value = np.linspace(0.0, 1.0, 8193)
    table = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    index = (np.clip(linear, 0.0, 1.0) * 8192 + 0.5).astype(np.int16)
    return np.round(table * 255).astype(np.uint8)[index]


def check_vertices(count: int, vertices: Float[Array, "*frames vertices 3"], where: str = "") -> None:
    """Raise `RetargetError` unless these are finite positions of that many vertices."""
    where = where and f"{where}: "
    if vertices.shape[-2] != count:
        received = vertices.shape[-2]
        raise RetargetError(f"{where}the mesh has {count} vertices, received positions of {received}")
    bad = ~np.isfinite(vertices).all(axis=-1)
    if bad.any():
        place = np.argwhere(bad)[0]
        frame = f" of frame {place[0]}" if len(place) > 1 else ""
        first = f"the first is vertex {place[-1]}{frame}"
        raise RetargetError(f"{where}{int(bad.sum())} vertex positions are not finite, {first}")


def base_color(
    surface: Surface,
    points: Float[Array, "vertices 2"],
    face: Int[Array, "samples"],
    corners: Int[Array, "samples 3"],
    weights: Float[Array, "samples 3"],
) -> Float[Array, "samples 3"]:
    """Factor times texture, the nearest texel of the level whose texels are about as large as the samples."""
    owner = surface.material[face]
    color = surface.factors[owner]
    if not any(surface.textures):
        return color
    uv = np.einsum("sc,sck->sk", weights, surface.mesh.uvs.astype(np.float32)[corners])
    shown = np.maximum(_areas(points, surface.mesh.faces), 1e-12)
    stretch = np.sqrt(_areas(surface.mesh.uvs, surface.mesh.faces) / shown)
    for index, levels in enumerate(surface.textures):
        if levels is None:
            continue
        mine = np.flatnonzero(owner == index)
        size = np.sqrt(levels[0].shape[0] * levels[0].shape[1])
        texels = np.log2(np.maximum(stretch[face[mine]] * size, 1.0))
        wanted = np.minimum(np.round(texels), len(levels) - 1).astype(np.int64)
        for number in np.unique(wanted):
            part = mine[wanted == number]
            high, wide = levels[number].shape[:2]
            place = np.floor((uv[part] % 1.0) * np.array([wide, high], dtype=np.float32)).astype(np.int64)
            x, y = np.minimum(place, [wide - 1, high - 1]).T
            color[part] *= levels[number][y, x]
    return color


def _areas(points: Float[Array, "vertices 2"], faces: Int[Array, "faces 3"]) -> Float[Array, "faces"]:
    a, b = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def smooth_normals(
    surface: Surface,
    vertices: Float[Array, "vertices 3"],
    face: Int[Array, "samples"],
    weights: Float[Array, "samples 3"],
    eye: Float[Array, "3"],
) -> Float[Array, "samples 3"]:
    """Unit normals toward the viewer, smooth except across edges that are sharp (a cube's stay flat)."""
    faces = surface.mesh.faces
    triangles = vertices[faces]
    sides = unit(triangles[:, [1, 2, 0]] - triangles)
    flat = unit(np.cross(sides[:, 0], sides[:, 1]))
    # Weighted by the angle at each corner (Thürmer and Wüthrich 1998), so that it does not matter how a side was cut.
    angles = np.arccos(np.clip(-np.einsum("fck,fck->fc", sides, sides[:, [2, 0, 1]]), -1.0, 1.0)).ravel()
    joint = surface.welded[faces]
    sums = [np.bincount(joint.ravel(), angles * np.repeat(flat[:, k], 3), len(vertices)) for k in range(3)]
    smooth = np.stack(sums, axis=1)
    flip = np.where(((eye - triangles[:, 0]) * flat).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    corner = unit(smooth)[joint]
    agree = np.einsum("fck,fk->fc", corner, flat)
    # 1 up to 32 degrees between face and vertex normal, 0 from 46 on; a cube's vertices are at 55.
    keep = np.clip((agree - 0.69) / (0.85 - 0.69), 0.0, 1.0)[:, :, None]
    corner = (keep * corner + (1.0 - keep) * flat[:, None]) * flip[:, None]
    return unit(np.einsum("sc,sck->sk", weights, corner.astype(np.float32)[face]))
