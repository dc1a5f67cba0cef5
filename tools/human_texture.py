"""The embedded human's texture: flat colour regions drawn pixel by pixel in MakeHuman's UV layout."""

from __future__ import annotations

import io

import numpy as np
from human_regions import MATERIALS, Wardrobe
from human_source import Source
from human_topology import IRIS, PUPIL, Body
from PIL import Image

SIZE, FINE = 1024, 2  # pixels; drawn finer and averaged
MASKS = {"lips": "mpfb_lips", "nails": "mpfb_fingernails", "toes": "mpfb_toenails"}
NAIL = (0.68, 0.45, 0.36)


def mask_at(source: Source, name: str, uvs: np.ndarray) -> np.ndarray:
    """Value in [0, 1] of one of MakeHuman's UV masks at texture coordinates (..., 2), origin bottom left."""
    image = np.asarray(Image.open(io.BytesIO(source.read(f"textures/{name}.jpg"))).convert("L"), dtype=float) / 255
    x = np.clip(uvs[..., 0] * image.shape[1], 0, image.shape[1] - 1).astype(int)
    y = np.clip((1 - uvs[..., 1]) * image.shape[0], 0, image.shape[0] - 1).astype(int)
    return image[y, x]


def bake(source: Source, body: Body, vertices: np.ndarray, parts: np.ndarray, wardrobe: Wardrobe) -> bytes:
    """PNG of the texture: regions by signed fields at each pixel's point of the average body."""
    face, weights = rasterise(body.uvs[body.face_uvs] * [1, -1] + [0, 1], SIZE * FINE)
    rows, columns = np.nonzero(face >= 0)
    owner = face[rows, columns]
    points = np.einsum("pk,pkx->px", weights[rows, columns], vertices[body.faces[owner]])
    uvs = np.einsum("pk,pkx->px", weights[rows, columns], body.uvs[body.face_uvs[owner]])
    field = wardrobe.fields(points, parts[owner])
    color = np.tile(np.array(MATERIALS["skin"]), (len(points), 1))
    for mask, file in MASKS.items():
        amount = mask_at(source, file, uvs)[:, None]
        color += 0.8 * amount * (np.array(MATERIALS["lips"] if mask == "lips" else NAIL) - color)
    for name, inside in (
        ("hair", field["hair"]),
        ("hair", wardrobe.brow(points)),
        ("shorts", field["shorts"]),
        ("shirt", field["shirt"]),
    ):
        color[inside > 0] = MATERIALS[name]
    eye = np.zeros(len(body.faces), bool)
    eye[[frozenset(f) in set().union(*body.eye_faces.values()) for f in body.faces.tolist()]] = True
    radius = np.linalg.norm(np.abs(points[:, :2]) * [1, 1] - wardrobe.eye[:2] * [1, 1], axis=1)
    here = eye[owner]
    color[here] = MATERIALS["eyeWhite"]
    color[here & (radius < IRIS)] = MATERIALS["iris"]
    color[here & (radius < PUPIL)] = MATERIALS["pupil"]
    image = np.zeros((SIZE * FINE, SIZE * FINE, 3))
    image[rows, columns] = color
    image = grow(image, face >= 0, steps=8 * FINE)
    image = image.reshape(SIZE, FINE, SIZE, FINE, 3).mean(axis=(1, 3))
    encoded = np.where(image < 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
    out = io.BytesIO()
    Image.fromarray(np.round(encoded * 255).astype(np.uint8)).quantize(128, dither=Image.Dither.NONE).save(
        out, "PNG", optimize=True
    )
    return out.getvalue()


def rasterise(corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Face index (-1 for none) and barycentric weights of each pixel, for triangles (faces, 3, 2) in [0, 1]."""
    face = np.full((size, size), -1, dtype=np.int32)
    weights = np.zeros((size, size, 3), dtype=np.float32)
    for k, ((ax, ay), (bx, by), (cx, cy)) in enumerate(corners * size):
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        low_x, high_x = int(min(ax, bx, cx)), int(max(ax, bx, cx)) + 1
        low_y, high_y = int(min(ay, by, cy)), int(max(ay, by, cy)) + 1
        x, y = np.meshgrid(np.arange(low_x, high_x) + 0.5, np.arange(low_y, high_y) + 0.5)
        b = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
        c = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
        inside = (b >= -1e-6) & (c >= -1e-6) & (b + c <= 1 + 1e-6)
        face[low_y:high_y, low_x:high_x][inside] = k
        weights[low_y:high_y, low_x:high_x][inside] = np.stack([1 - b - c, b, c], axis=-1)[inside]
    return face, weights


def grow(image: np.ndarray, filled: np.ndarray, steps: int) -> np.ndarray:
    """Spreads the colours beyond the edges of the charts, so that filtering never picks up the background."""
    from scipy.ndimage import distance_transform_edt

    distance, (rows, columns) = distance_transform_edt(~filled, return_indices=True)
    near = distance <= steps
    grown = image.copy()
    grown[near] = image[rows[near], columns[near]]
    grown[~near] = MATERIALS["skin"]
    return grown
