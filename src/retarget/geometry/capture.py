"""A virtual scanner: what depth cameras around a body would measure of it, with their faults.

Every camera draws the surface into a picture of depths (`capture_kernels.look`), and every pixel becomes a point. Which
faults are made, and how, is ours: noise that grows with the square of the distance and steps of depth, as triangulating
sensors have both (Khoshelham and Elberink 2012); no reading where the surface turns away; holes; points that fly
between an edge and what lies behind it; pieces of floor that were not cut away; cameras that are not quite where they
are taken to be.

Nothing here knows bodies or time: `prepare_studio` places cameras once, `Studio.scan` takes one frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.geometry.topology import areas

Array = np.ndarray

SEEN = 0.25
"""Part of a body's area that one camera sees, projected: a quarter of a convex one (Cauchy)."""
SPARE = 2.0
"""Pixels that are looked at for each point wanted: holes take some, and the rest are chosen at random."""
MOST_PIXELS = 1 << 24
"""Of one camera's picture: 16 million, more than any depth camera has."""
EDGE = 0.03
"""Difference of depth between neighbouring pixels that is an edge, as a part of the studio's reach."""
FLOWN = 0.25
"""How far flying points reach behind an edge, as a part of the reach."""
FLOOR_AROUND = 0.2
"""How far around the body floor is left in, as a part of the reach: what lies further away is cut off, as users do."""


@dataclass(frozen=True)
class Scanner:
    """Settings of the virtual scanner. Lengths are metres; shares run from 0 (none) to 1."""

    cameras: int = 4
    """Depth cameras, evenly around the body; one is a half view."""
    points: int | None = 6890
    """Points of a frame at most, chosen at random; None keeps all."""
    pixel: float | None = None
    """What a pixel spans in the middle of the studio; None: as fine as `points` needs (10 mm for a person, 6,890 points
    and four cameras: pictures of about 160 x 120)."""
    noise: float = 0.003
    """Standard deviation of a depth in the middle of the studio; it grows with the square of the distance."""
    steps: float = 0.001
    """Depths are multiples of this in the middle of the studio, of more behind it."""
    misplaced: float = 0.0
    """Standard deviation of the error of a camera's place, which is the same on every frame."""
    holes: float = 0.0
    """How much is lost: surface that turns away from the camera, and blobs; at 1 about half of all points."""
    outliers: float = 0.0
    """Share of the pixels at edges that fly, and a thousandth of it of all points anywhere."""
    floor: bool = False
    """Whether pieces of the floor around the feet are left in."""
    azimuth: float = 0.0
    """Where the first camera stands, radians about +Y; 0 sees the front of a body that faces +Z."""

    def __post_init__(self) -> None:
        if not (isinstance(self.cameras, (int, np.integer)) and 1 <= self.cameras <= 64):
            raise RetargetError(f"a scanner has 1 to 64 cameras, received {self.cameras}")
        if self.points is not None and not 1 <= self.points <= 1_000_000:
            raise RetargetError(f"a scanner gives 1 to 1000000 points, received {self.points}")
        if self.pixel is not None and not 0 < self.pixel < np.inf:
            raise RetargetError(f"a pixel spans a positive number of metres, received {self.pixel}")
        for name in ("noise", "steps", "misplaced"):
            if not 0 <= getattr(self, name) < np.inf:
                raise RetargetError(f"{name} is a length that is not negative, received {getattr(self, name)}")
        for name in ("holes", "outliers"):
            if not 0 <= getattr(self, name) <= 1:
                raise RetargetError(f"{name} is a share from 0 to 1, received {getattr(self, name)}")
        if not np.isfinite(self.azimuth):
            raise RetargetError(f"azimuth is an angle, received {self.azimuth}")


@dataclass(frozen=True, eq=False)
class Studio:
    """Cameras that stand; `prepare_studio` makes one."""

    scanner: Scanner
    eyes: Float[Array, "cameras 3"]
    axes: Float[Array, "cameras 3 3"]
    """Rows: right, down and forward of each camera, in the world."""
    believed: Float[Array, "cameras 3"]
    """Where the eyes are taken to be."""
    middle: float
    """Distance from the eyes to the middle of the studio."""
    reach: float
    """Radius of the body."""
    focal: float
    """Pixels that a length spans at a depth of the same length."""
    floor_vertices: Float[Array, "corners 3"]
    floor_faces: Int[Array, "pieces 3"]

    def scan(
        self, vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], seed: int | Sequence[int] = 0
    ) -> Float32[Array, "points 3"]:
        """What is measured of one frame, metres, in no order; no points where the body is out of sight.

        The same seed gives the same points. Raises `RetargetError` for vertices that are not finite.
        """
        if not np.isfinite(vertices).all():
            raise RetargetError("a surface whose vertices are not finite cannot be scanned")
        if not len(faces):
            return np.zeros((0, 3), dtype=np.float32)
        draw = np.random.default_rng(seed)
        triangles = np.asarray(faces, dtype=np.int64)
        places = np.asarray(vertices, dtype=np.float64)
        body = places
        if len(self.floor_faces):
            triangles = np.concatenate([triangles, self.floor_faces + len(places)])
            places = np.concatenate([places, self.floor_vertices])
        box = _box(body)
        seen = [self._seen(camera, len(body), box, places, triangles, draw) for camera in range(len(self.eyes))]
        points = np.concatenate(seen)
        if self.scanner.outliers:
            strays = draw.binomial(len(points), 0.001 * self.scanner.outliers)
            points = np.concatenate([points, box.mean(axis=0) + draw.uniform(-1.2, 1.2, (strays, 3)) * self.reach])
        order = draw.permutation(len(points))[: self.scanner.points]
        return points[order].astype(np.float32)

    def _seen(
        self, camera: int, body: int, box: Array, places: Array, faces: Array, draw: np.random.Generator
    ) -> Float[Array, "points 3"]:
        """Points of one camera, in the world as it is believed. The first `body` places are the body's, within
        `box`."""
        from retarget.geometry.capture_kernels import look, placed_points, readings

        scanner = self.scanner
        placed = self._projected(camera, places)
        first, last = _box(placed[:body])[:, :2]
        around = 1.0 + (len(self.floor_faces) > 0) * FLOOR_AROUND * self.reach * self.focal / self.middle
        left, top = np.floor(first - around)
        columns, rows = (np.ceil(last + around) - (left, top)).clip(0, 1e9).astype(int)
        if rows * columns > MOST_PIXELS:
            raise RetargetError(
                f"a picture of {columns} x {rows} pixels is too large; choose larger pixels or fewer points"
            )
        nearness, owner = np.zeros((rows, columns)), np.full((rows, columns), -1, dtype=np.int64)
        look(placed, faces, left, top, nearness, owner)
        found = readings(placed, faces, nearness, owner, self.focal, left, top)
        if scanner.holes:
            found = found[self._kept(found, draw)]
        depth, is_floor = found[:, 2].copy(), found[:, 5] >= len(faces) - len(self.floor_faces)
        if scanner.outliers:
            # Some readings at edges lie between the edge and what is behind it.
            gap = found[:, 3] - depth
            at_edge = np.flatnonzero(gap > EDGE * self.reach)
            at_edge = at_edge[draw.random(len(at_edge)) < scanner.outliers]
            depth[at_edge] += np.minimum(gap[at_edge], FLOWN * self.reach) * draw.random(len(at_edge))
        depth += draw.normal(size=len(depth)) * (scanner.noise / self.middle**2) * depth**2
        if scanner.steps:
            # Even steps of 1 / depth, as of a disparity in pixels.
            step = scanner.steps / self.middle**2
            depth = 1.0 / np.maximum(np.round((1.0 / depth) / step) * step, step)
        points = placed_points(found[:, :2], depth, self.focal, self.axes[camera], self.believed[camera])
        if not is_floor.any():
            return points
        low, high = box[0] - FLOOR_AROUND * self.reach, box[1] + FLOOR_AROUND * self.reach
        x, y, z = ((points[:, axis] > low[axis]) & (points[:, axis] < high[axis]) for axis in range(3))
        return points[~is_floor | (x & y & z)]

    def _projected(self, camera: int, places: Array) -> Array:
        """Pixels right and down of the middle of the picture, and depth."""
        placed = (places - self.eyes[camera]) @ self.axes[camera].T
        placed[:, :2] *= self.focal / np.maximum(placed[:, 2:], 1e-6)
        return placed

    def _kept(self, found: Array, draw: np.random.Generator) -> Array:
        """Readings that are no holes."""
        amount = self.scanner.holes
        ragged = draw.uniform(0.7, 1.3, len(found))
        kept = found[:, 4] > (0.15 + 0.35 * amount) * ragged  # up to 81 degrees away from the camera are read, or 60
        blobs = draw.poisson(6 * amount)
        if blobs and len(found):
            across, down = found[:, 0].copy(), found[:, 1].copy()
            pixels = 2 * self.reach * self.focal / self.middle
            for middle in draw.integers(len(found), size=blobs).tolist():
                tall, wide = draw.uniform(0.015, 0.05 + 0.05 * amount, 2) * pixels
                kept &= ((down - down[middle]) / tall) ** 2 + ((across - across[middle]) / wide) ** 2 > ragged
        return kept


def prepare_studio(
    scanner: Scanner,
    vertices: Float[Array, "*frames vertices 3"],
    faces: Int[Array, "faces 3"],
    seed: int | Sequence[int] = 0,
    floor: float | None = None,
) -> Studio:
    """Place cameras around all frames of a moving surface (metres, +Y up), or around one.

    They look at the middle of all frames, in turn from a little above it and from well above, from further away than
    any frame reaches. `floor` is the height of the floor; None takes the lowest vertex. Raises `RetargetError` for a
    surface without area or with vertices that are not finite.
    """
    frames = np.asarray(vertices, dtype=np.float64).reshape(-1, vertices.shape[-2], 3)
    if not np.isfinite(frames).all():
        raise RetargetError("a surface whose vertices are not finite cannot be scanned")
    area = float(np.median(areas(frames[:: max(1, len(frames) // 8)], faces).sum(axis=1))) if len(faces) else 0.0
    if not area > 0:
        raise RetargetError("a surface without area cannot be scanned")
    draw = np.random.default_rng(seed)
    low, high = frames.min(axis=(0, 1)), frames.max(axis=(0, 1))
    middle = 0.5 * (low + high)
    body = 0.5 * float(np.median(np.linalg.norm(np.ptp(frames, axis=1), axis=1)))
    away = 0.5 * float(np.linalg.norm(high - low)) + 1.5 * body
    turns = scanner.azimuth + 2 * np.pi * np.arange(scanner.cameras) / scanner.cameras
    rise = np.where(np.arange(scanner.cameras) % 2, 0.45, 0.1)
    outward = np.stack([np.sin(turns) * np.cos(rise), np.sin(rise), np.cos(turns) * np.cos(rise)], axis=1)
    eyes = middle + away * outward
    right = rot.unit(np.cross(np.array([0.0, 1.0, 0.0]), outward))
    axes = np.stack([right, -np.cross(outward, right), -outward], axis=1)
    pixel = scanner.pixel
    if pixel is None:
        wanted = SPARE * (6890 if scanner.points is None else scanner.points)
        pixel = float(np.sqrt(scanner.cameras * SEEN * area / wanted))
    believed = eyes + draw.normal(size=eyes.shape) * scanner.misplaced
    corners, pieces = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    if scanner.floor:
        corners, pieces = _floor_pieces(low, high, low[1] if floor is None else floor, body, draw)
    return Studio(scanner, eyes, axes, believed, away, body, away / pixel, corners, pieces)


def scan(
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    scanner: Scanner | None = None,
    seed: int | Sequence[int] = 0,
) -> Float32[Array, "points 3"]:
    """What a scanner measures of one surface (metres), its cameras placed around it: `prepare_studio` and
    `Studio.scan`."""
    return prepare_studio(scanner or Scanner(), vertices, faces, seed).scan(vertices, faces, seed)


def _box(places: Float[Array, "places 3"]) -> Float[Array, "2 3"]:
    """Least and greatest coordinates. The copy makes it thirty times as fast: numpy reduces short rows slowly."""
    columns = np.ascontiguousarray(places.T)
    return np.stack([columns.min(axis=1), columns.max(axis=1)])


def _floor_pieces(low: Array, high: Array, level: float, body: float, draw: np.random.Generator) -> tuple[Array, Array]:
    """Ragged discs of floor, about where the body has been."""
    corners, pieces = [], []
    for number in range(int(draw.integers(3, 8))):
        x, z = draw.uniform(low[[0, 2]] - 0.1 * body, high[[0, 2]] + 0.1 * body)
        turn = np.linspace(0, 2 * np.pi, 10, endpoint=False)
        radius = draw.uniform(0.05, 0.35) * body * draw.uniform(0.6, 1.0, len(turn))
        rim = np.stack([x + radius * np.cos(turn), np.full(len(turn), level), z + radius * np.sin(turn)], axis=1)
        start, around = number * (len(turn) + 1), np.arange(len(turn))
        corners.append(np.concatenate([[[x, level, z]], rim]))
        pieces.append(
            np.stack([np.full(len(turn), start), start + 1 + around, start + 1 + np.roll(around, -1)], axis=1)
        )
    return np.concatenate(corners), np.concatenate(pieces)
