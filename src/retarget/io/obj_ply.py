"""Bare surfaces and point clouds: OBJ and PLY, read and written by ourselves.

Why not trimesh: a fault must be told with its line or byte in one sentence (trimesh passes over OBJ lines that it does
not know and drops faces that name missing vertices), vertices must keep the file's order and number (it splits them at
texture seams), and a header that declares more than the file holds must be refused before memory is taken. What is left
to do is small: a loop over the lines of an OBJ, and `ply.py`.

One vertex of the file is one vertex of the mesh, in the file's order, so that landmarks and correspondences by index
hold and the surface stays closed. Polygons become fans of triangles, objects and groups one mesh.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, Int

from retarget.character import Mesh, PointCloud
from retarget.errors import FileError, RetargetError
from retarget.io.asset import Asset
from retarget.io.decimal_text import LARGEST, shown, workable
from retarget.io.ply import fan, read_ply, write_ply
from retarget.io.whole_file import written_whole

Array = np.ndarray

# Statements of an OBJ file that say nothing about the triangles, by what a note calls them.
PASSED_OVER = {
    b"materials": b"mtllib usemtl maplib usemap",
    b"lines and single points": b"l p",
    b"free-form surfaces": b"vp cstype deg bmat step curv curv2 surf parm trim hole scrv sp end con ctech stech",
    b"": b"vn o g s mg bevel c_interp d_interp lod shadow_obj trace_obj",
}
PASSED_OVER = {word: name.decode() for name, words in PASSED_OVER.items() for word in words.split()}

LONGEST_LINE = 1 << 24
"""Characters; a face of a million corners."""
BLOCK = 1 << 14
"""Vertices or faces turned into text at a time."""


def load(path: str | Path, empty: bool = False) -> Asset:
    """Read an OBJ or PLY file: kind 'mesh', or 'points' when it has no faces. With `empty` a PLY without vertices is a
    cloud of no points (a frame in which nothing was seen).

    Texture coordinates are kept where no vertex has two of them (without seams). Raises `FileError` with the place for
    what cannot be read, numbers that are not finite, and faces that name vertices that do not exist.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            if path.suffix.lower() == ".ply":
                surface, notes = read_ply(path, file, empty)
            else:
                surface, notes = _read_obj(path, file)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    if isinstance(surface, Mesh):
        return Asset(path, "mesh", mesh=surface, notes=notes)
    return Asset(path, "points", points=surface, notes=notes)


def save(path: str | Path, surface: Mesh | PointCloud) -> None:
    """Write a mesh or a cloud as OBJ (text, 9 digits) or PLY (binary, double precision); the suffix chooses. Clouds
    are written as PCD, too.

    Materials are not written. The file appears whole or not at all. Raises `FileError` for another suffix or a folder
    that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".pcd" and isinstance(surface, PointCloud):
        from retarget.io import pcd

        return pcd.save(path, surface)
    if path.suffix.lower() not in (".obj", ".ply"):
        received = path.suffix or "a file without suffix"
        raise FileError(path, f"a bare surface is written as .obj or .ply, not as {received!r}")
    write = write_ply if path.suffix.lower() == ".ply" else _write_obj
    with written_whole(path) as file:
        write(file, surface)


@dataclass
class _Obj:
    """What the lines of an OBJ file add up to. Ranges are checked at the end, all at once; lines are kept for that."""

    path: Path
    line: int = 0
    vertices: array = field(default_factory=lambda: array("d"))
    vertex_lines: array = field(default_factory=lambda: array("q"))
    texture: array = field(default_factory=lambda: array("d"))
    corners: array = field(default_factory=lambda: array("q"))
    """Vertex of each corner, from 1 on."""
    texture_corners: array = field(default_factory=lambda: array("q"))
    """Texture coordinate of each corner, from 1 on; 0 for none."""
    counts: array = field(default_factory=lambda: array("q"))
    """Corners of each face."""
    face_lines: array = field(default_factory=lambda: array("q"))
    passed_over: dict[str, int] = field(default_factory=dict)

    def fault(self, problem: str, line: int | None = None) -> FileError:
        return FileError(self.path, problem, f"line {line or self.line}")

    def take(self, words: list[bytes]) -> None:
        keyword = words[0]
        if keyword == b"v":
            self.vertices.extend(self.values(words, 3, "a vertex takes three numbers"))
            self.vertex_lines.append(self.line)
        elif keyword == b"f":
            self.face(words)
        elif keyword == b"vt":
            words += [b"0"] * (len(words) == 2)  # v may be left out
            self.texture.extend(self.values(words, 2, "a texture coordinate takes two numbers"))
        elif keyword in PASSED_OVER:
            if name := PASSED_OVER[keyword]:
                self.passed_over[name] = self.passed_over.get(name, 0) + 1
        else:
            raise self.fault(f"{shown(keyword)} is no word of an OBJ file")

    def values(self, words: list[bytes], count: int, rule: str) -> list[float]:
        try:
            values = [float(word) for word in words[1 : count + 1]]
        except ValueError:
            values = []
        if len(values) != count:
            raise self.fault(f"{rule}, received {shown(b' '.join(words[1:]))}")
        return values

    def face(self, words: list[bytes]) -> None:
        if len(words) < 4:
            raise self.fault(f"a face needs three corners, received {shown(b' '.join(words[1:]))}")
        parts = [word.split(b"/", 2) for word in words[1:]]
        try:
            corners = [int(part[0]) for part in parts]
            texture = [int(part[1]) if len(part) > 1 and part[1] else 0 for part in parts]
            if min(corners) < 1 or min(texture) < 0:
                corners = [self.counted_back(each, len(self.vertices) // 3) for each in corners]
                texture = [each and self.counted_back(each, len(self.texture) // 2) for each in texture]
            self.corners.extend(corners)
            self.texture_corners.extend(texture)
        except (ValueError, OverflowError) as error:
            if isinstance(error, RetargetError):
                raise
            received = shown(b" ".join(words[1:]))
            raise self.fault(f"the corners of a face are v, v/vt, v//vn or v/vt/vn, received {received}") from None
        self.counts.append(len(corners))
        self.face_lines.append(self.line)

    def counted_back(self, index: int, newest: int) -> int:
        """Negative numbers count back from the newest."""
        if index == 0 or index < -newest:
            raise self.fault(f"a corner has number {index}, with {newest} given so far; the first has number 1")
        return index if index > 0 else index + newest + 1

    def surface(self) -> tuple[Mesh | PointCloud, tuple[str, ...]]:
        vertices = np.array(self.vertices).reshape(-1, 3)
        if not len(vertices):
            raise FileError(self.path, "holds no vertex ('v x y z'); is it an OBJ file?")
        if not workable(vertices):
            bad = int(np.flatnonzero(~(np.abs(vertices) < LARGEST).all(axis=1))[0])
            raise self.fault(f"a vertex at {vertices[bad].tolist()}, which is no place", self.vertex_lines[bad])
        notes = tuple(f"{count} statements about {name} were passed over" for name, count in self.passed_over.items())
        if not self.counts:
            return PointCloud(vertices), notes
        corners = self.from_zero(self.corners, len(vertices), "vertex")
        uvs, more = self.uvs(len(vertices), corners)
        return Mesh(vertices, fan(corners, np.array(self.counts, dtype=np.int64)), uvs=uvs), notes + more

    def from_zero(self, corners: array, count: int, what: str) -> Int[Array, "corners"]:
        indices = np.array(corners, dtype=np.int64)
        if len(missing := np.flatnonzero(indices > count)):
            face = int(np.searchsorted(np.cumsum(self.counts), missing[0], side="right"))
            raise self.fault(f"the face names {what} {indices[missing[0]]} of {count}", self.face_lines[face])
        return indices - 1

    def uvs(
        self, vertices: int, corners: Int[Array, "corners"]
    ) -> tuple[Float[Array, "vertices 2"] | None, tuple[str, ...]]:
        """Texture coordinates by vertex, where that is possible; OBJ has them by corner, origin bottom left."""
        chosen = self.from_zero(self.texture_corners, len(self.texture) // 2, "texture coordinate")
        coordinates = np.array(self.texture).reshape(-1, 2) * [1, -1] + [0, 1]
        if chosen.min() < 0:
            return None, ()
        if not workable(coordinates):
            return None, ("texture coordinates were passed over: some are not finite",)
        uvs = np.zeros((vertices, 2))
        uvs[corners] = coordinates[chosen]
        torn = len(np.unique(corners[(uvs[corners] != coordinates[chosen]).any(axis=1)]))
        if torn:
            return None, (f"texture coordinates were passed over: {torn} vertices on seams have several",)
        return uvs, ()


def _read_obj(path: Path, file: BinaryIO) -> tuple[Mesh | PointCloud, tuple[str, ...]]:
    obj = _Obj(path)
    for obj.line, words in _statements(path, file):
        obj.take(words)
    return obj.surface()


def _statements(path: Path, file: BinaryIO) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line that has any, without comments; a backslash at the end joins the next line.
    Raises `FileError` for a line longer than any."""
    start, joined = 0, []
    lines = iter(lambda: file.readline(LONGEST_LINE), b"")
    for line, text in enumerate(lines, 1):
        if len(text) == LONGEST_LINE:
            raise FileError(path, f"a line of more than {LONGEST_LINE} characters; this is no OBJ file", f"line {line}")
        if line == 1:
            text = text.removeprefix(b"\xef\xbb\xbf")
        start = start or line
        stripped = (text.split(b"#", 1)[0] if b"#" in text else text).rstrip()
        if stripped.endswith(b"\\"):
            joined.append(stripped[:-1])
            continue
        if words := (b" ".join([*joined, stripped]) if joined else stripped).split():
            yield start, words
        if joined:
            joined = []
        start = 0
    if words := b" ".join(joined).split():
        yield start, words


def _write_obj(file: BinaryIO, surface: Mesh | PointCloud) -> None:
    if isinstance(surface, PointCloud):
        _write_rows(file, "v %.9g %.9g %.9g\n", surface.points)
        return
    _write_rows(file, "v %.9g %.9g %.9g\n", surface.vertices)
    faces = surface.faces + 1
    if surface.uvs is None:
        _write_rows(file, "f %d %d %d\n", faces)
    else:
        _write_rows(file, "vt %.9g %.9g\n", surface.uvs * [1, -1] + [0, 1])
        _write_rows(file, "f %d/%d %d/%d %d/%d\n", np.repeat(faces, 2, axis=1))


def _write_rows(file: BinaryIO, line: str, rows: Array) -> None:
    for start in range(0, len(rows), BLOCK):
        block = rows[start : start + BLOCK]
        file.write((line * len(block) % tuple(block.ravel().tolist())).encode("ascii"))
