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
from retarget.io.decimal_text import number, shown
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

BLOCK = 1 << 14
"""Vertices or faces turned into text at a time."""


def load(path: str | Path) -> Asset:
    """Read an OBJ or PLY file: kind 'mesh', or 'points' when it has no faces.

    Texture coordinates are kept where no vertex has two of them (without seams). Raises `FileError` with the place for
    what cannot be read, numbers that are not finite, and faces that name vertices that do not exist.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            if path.suffix.lower() == ".ply":
                surface, notes = read_ply(path, file)
            else:
                surface, notes = _read_obj(path, file)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    if isinstance(surface, Mesh):
        return Asset(path, "mesh", mesh=surface, notes=notes)
    return Asset(path, "points", points=surface, notes=notes)


def save(path: str | Path, surface: Mesh | PointCloud) -> None:
    """Write a mesh or a cloud as OBJ (text, 9 digits) or PLY (binary, double precision); the suffix chooses.

    Materials are not written. The file appears whole or not at all. Raises `FileError` for another suffix or a folder
    that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".obj", ".ply"):
        received = path.suffix or "a file without suffix"
        raise FileError(path, f"a bare surface is written as .obj or .ply, not as {received!r}")
    if not isinstance(surface, (Mesh, PointCloud)):
        raise RetargetError(f"a Mesh or a PointCloud can be written here, received {type(surface).__name__}")
    write = write_ply if path.suffix.lower() == ".ply" else _write_obj
    with written_whole(path) as file:
        write(file, surface)


@dataclass
class _Obj:
    """What the lines of an OBJ file add up to."""

    path: Path
    line: int = 0
    vertices: array = field(default_factory=lambda: array("d"))
    texture: array = field(default_factory=lambda: array("d"))
    corners: array = field(default_factory=lambda: array("q"))
    texture_corners: array = field(default_factory=lambda: array("q"))
    """The texture coordinate of each corner, -1 for none."""
    counts: array = field(default_factory=lambda: array("q"))
    lines: array = field(default_factory=lambda: array("q"))
    """The line of each polygon."""
    passed_over: dict[str, int] = field(default_factory=dict)

    def fault(self, problem: str) -> FileError:
        return FileError(self.path, problem, f"line {self.line}")

    def take(self, words: list[bytes]) -> None:
        keyword = words[0]
        if keyword == b"v":
            self.vertices.extend(self.values(words, 3, "a vertex takes three finite numbers"))
        elif keyword == b"f":
            self.face(words)
        elif keyword == b"vt":
            words += [b"0"] * (len(words) == 2)  # v may be left out
            self.texture.extend(self.values(words, 2, "a texture coordinate takes two finite numbers"))
        elif keyword in PASSED_OVER:
            if name := PASSED_OVER[keyword]:
                self.passed_over[name] = self.passed_over.get(name, 0) + 1
        else:
            raise self.fault(f"{shown(keyword)} is no word of an OBJ file")

    def values(self, words: list[bytes], count: int, rule: str) -> list[float]:
        values = [number(word) for word in words[1 : count + 1]]
        if len(values) != count or None in values:
            raise self.fault(f"{rule}, received {shown(b' '.join(words[1:]))}")
        return values

    def face(self, words: list[bytes]) -> None:
        if len(words) < 4:
            raise self.fault(f"a face needs three corners, received {shown(b' '.join(words[1:]))}")
        vertices, texture = len(self.vertices) // 3, len(self.texture) // 2
        for word in words[1:]:
            first, *rest = word.split(b"/")
            self.corners.append(self.index(first, vertices, word))
            self.texture_corners.append(self.index(rest[0], texture, word) if rest and rest[0] else -1)
        self.counts.append(len(words) - 1)
        self.lines.append(self.line)

    def index(self, digits: bytes, newest: int, word: bytes) -> int:
        """OBJ counts from 1, negative numbers back from the newest. Whether a later one exists is known at the end."""
        try:
            index = int(digits)
        except ValueError:
            raise self.fault(f"{shown(word)} is no corner of a face (v, v/vt, v//vn or v/vt/vn)") from None
        if not -newest <= index < 1 << 40 or index == 0:
            raise self.fault(f"corner {shown(word)} reaches outside the {newest} given so far; the first has number 1")
        return index - 1 if index > 0 else index + newest

    def surface(self) -> tuple[Mesh | PointCloud, tuple[str, ...]]:
        vertices = np.array(self.vertices).reshape(-1, 3)
        if not len(vertices):
            raise FileError(self.path, "holds no vertex ('v x y z'); is it an OBJ file?")
        notes = tuple(f"{count} statements about {name} were passed over" for name, count in self.passed_over.items())
        if not self.counts:
            return PointCloud(vertices), notes
        corners = self.checked(self.corners, len(vertices), "vertex")
        counts = np.array(self.counts)
        uvs, more = self.uvs(len(vertices), corners)
        return Mesh(vertices, fan(corners, counts), uvs=uvs), notes + more

    def checked(self, corners: array, count: int, what: str) -> Int[Array, "corners"]:
        indices = np.array(corners)
        if len(missing := np.flatnonzero(indices >= count)):
            polygon = np.searchsorted(np.cumsum(self.counts), missing[0], side="right")
            self.line = self.lines[int(polygon)]
            raise self.fault(f"the face names {what} {int(indices[missing[0]]) + 1} of {count}")
        return indices

    def uvs(
        self, vertices: int, corners: Int[Array, "corners"]
    ) -> tuple[Float[Array, "vertices 2"] | None, tuple[str, ...]]:
        """Texture coordinates by vertex, where that is possible; OBJ has them by corner, origin bottom left."""
        chosen = self.checked(self.texture_corners, len(self.texture) // 2, "texture coordinate")
        if not len(chosen) or chosen.min() < 0:
            return None, ()
        coordinates = np.array(self.texture).reshape(-1, 2) * [1, -1] + [0, 1]
        uvs = np.zeros((vertices, 2))
        uvs[corners] = coordinates[chosen]
        torn = len(np.unique(corners[(uvs[corners] != coordinates[chosen]).any(axis=1)]))
        if torn:
            return None, (f"texture coordinates were passed over: {torn} vertices on seams have several",)
        return uvs, ()


def _read_obj(path: Path, file: BinaryIO) -> tuple[Mesh | PointCloud, tuple[str, ...]]:
    obj = _Obj(path)
    for obj.line, words in _statements(file):
        obj.take(words)
    return obj.surface()


def _statements(file: BinaryIO) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line that has any, without comments; a backslash at the end joins the next line."""
    start, joined = 0, []
    for line, text in enumerate(file, 1):
        if line == 1:
            text = text.removeprefix(b"\xef\xbb\xbf")
        start = start or line
        stripped = text.split(b"#", 1)[0].rstrip()
        if stripped.endswith(b"\\"):
            joined.append(stripped[:-1])
            continue
        if words := b" ".join([*joined, stripped]).split():
            yield start, words
        start, joined = 0, []
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
