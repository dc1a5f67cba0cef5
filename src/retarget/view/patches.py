"""Where a body touches or penetrates itself on one frame, as small surfaces just above its skin, for viewers whose meshes
have one colour; and the clock that such a viewer plays by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8, UInt32

from retarget.body.rotations import unit

Array = np.ndarray

KINDS: tuple[tuple[str, tuple[int, int, int], int, int], ...] = (
    ("touch", (64, 156, 255), 1, 2),
    ("shallow", (255, 176, 32), 2, 11),
    ("deep", (222, 30, 44), 11, 256),
)
"""Name, sRGB, and the range of codes (`stage.Spots`): touching, less than a centimetre inside, deeper."""
LIFT = 0.0015
"""Metres between the skin and a patch."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A small surface."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]


def patches(
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    vertex: Int[Array, "rows"],
    code: UInt8[Array, "rows"],
) -> dict[str, Patch]:
    """A patch for each of `KINDS`: the faces with a marked corner, by the highest code, along their normals
    a little above the posed skin (metres)."""
    codes = np.zeros(len(vertices), dtype=np.uint8)
    codes[vertex] = code
    marked = codes[faces]
    chosen = np.flatnonzero(marked.any(axis=1))
    highest = marked[chosen].max(axis=1)
    return {name: _lifted(vertices, faces[chosen[(highest >= low) & (highest < high)]]) for name, _, low, high in KINDS}


def padded(patch: Patch, vertices: int, faces: int) -> tuple[Float[Array, "vertices 3"], UInt32[Array, "faces 3"]]:
    """The patch for buffers of so many vertices and faces, or of new sizes where these do not fit: filled up with its first
    vertex and with faces that have no area."""
    (vertices, faces) = (_room(*each) for each in ((len(patch.vertices), vertices), (len(patch.faces), faces)))
    places = np.broadcast_to(patch.vertices[:1], (vertices, 3)).astype(np.float32)
    places[: len(patch.vertices)] = patch.vertices
    corners = np.zeros((faces, 3), dtype=np.uint32)
    corners[: len(patch.faces)] = patch.faces
    return places, corners


def _room(needed: int, there: int) -> int:
    """Buffers keep their size while what is needed fills a half of them; new ones have an eighth to spare."""
    return there if needed <= there <= max(2 * needed, 64) else max(needed + needed // 8, 64)


def part_surfaces(
    faces: Int[Array, "faces 3"], parts: Int[Array, "vertices"]
) -> dict[int, tuple[Int[Array, "kept"], Int[Array, "own 3"]]]:
    """The skin divided into one surface a body part: which vertices each has, and its faces over these. A face belongs to
    the part of its first corner."""
    found = {}
    for part in np.unique(parts[faces[:, 0]]).tolist():
        kept, inner = np.unique(faces[parts[faces[:, 0]] == part], return_inverse=True)
        found[part] = (kept, inner.reshape(-1, 3))
    return found


def _lifted(vertices: Array, faces: Array) -> Patch:
    kept, inner = np.unique(faces, return_inverse=True)
    inner = inner.reshape(-1, 3)
    points = vertices[kept].astype(np.float64)
    corners = points[inner]
    normal, sums = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), np.zeros_like(points)
    for corner in range(3):
        np.add.at(sums, inner[:, corner], normal)
    return Patch(points + LIFT * unit(sums), inner)


@dataclass(frozen=True)
class Clock:
    """The moment that is shown, and how it goes on."""

    seconds: float
    """Length of the clip."""
    time: float = 0.0
    playing: bool = True
    speed: float = 1.0

    def after(self, passed: float) -> Clock:
        """The clock when so many seconds have passed outside; at the end it starts again."""
        if not self.playing or self.seconds <= 0:
            return self
        return replace(self, time=(self.time + passed * self.speed) % self.seconds)

    def at(self, time: float) -> Clock:
        """The clock standing still at a moment of the clip."""
        return replace(self, time=min(max(time, 0.0), self.seconds), playing=False)
