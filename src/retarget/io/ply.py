"""PLY: a header that declares elements and their properties, then the rows as text or bytes."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float, Int

from retarget.character import Mesh, PointCloud
from retarget.errors import FileError
from retarget.io.decimal_text import LARGEST, numbers, shown, workable

Array = np.ndarray

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip

BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

TEXTURE = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))

WANTED = {"x", "y", "z", "vertex_indices", "vertex_index"}.union(*TEXTURE)
"""The properties worth keeping."""

LONGEST_HEADER = 1 << 16
LONGEST_ROW = 1 << 20


@dataclass
class _Property:
    name: str
    type: str
    """numpy's letter and size, without byte order."""
    count_type: str = ""
    """The type of a list's length; empty for a plain value."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(path: Path, file: BinaryIO, empty: bool = False) -> tuple[Mesh | PointCloud, tuple[str, ...]]:
    """The surface in a PLY file and what is to be said of it; with `empty` there may be none. Raises `FileError`."""
    byte_order, elements, line = _read_header(path, file)
    body = _Bytes(path, file.tell(), file.read(), byte_order) if byte_order else _Text(path, file.read(), line)
    found: dict[str, dict[str, Any]] = {}
    for element in elements:
        if {"vertex", "face"} <= found.keys():
            break  # whatever follows is of no interest
        found[element.name] = _read_element(body, element)
    vertices = _vertices(path, found.get("vertex", {}), empty)
    faces = found.get("face", {})
    polygons = faces.get("vertex_indices", faces.get("vertex_index"))
    if polygons is None:
        if "face" in found or "tristrips" in found:
            problem = "its faces are not given as 'property list ... vertex_indices'; export them as polygons"
            raise FileError(path, problem)
        return finite_cloud(path, vertices, empty)
    if not isinstance(polygons, tuple):
        raise FileError(path, "vertex_indices must be a list property")
    if not len(polygons[0]):
        return finite_cloud(path, vertices, empty)
    return _mesh(path, vertices, found["vertex"], *polygons)


def finite_cloud(
    path: Path, points: Float[Array, "points 3"], empty: bool = False
) -> tuple[PointCloud, tuple[str, ...]]:
    """The finite ones of a file's points, and what is to be said of them. Scanners mark pixels without depth by NaN, so
    those are no fault of a cloud. Raises `FileError` where none is left, unless it may be `empty`, and for absurdly
    large ones."""
    seen = np.isfinite(points).all(axis=1)
    if not seen.any() and not empty:
        raise FileError(path, f"none of its {len(points)} points is finite")
    if not workable(points[seen]):
        raise FileError(path, "holds coordinates that are absurdly large")
    lost = int((~seen).sum())
    return PointCloud(points[seen]), (f"{lost} points that are not finite were left out",) if lost else ()


def _mesh(
    path: Path,
    vertices: Float[Array, "vertices 3"],
    columns: dict[str, Any],
    counts: Int[Array, "polygons"],
    corners: Array,
) -> tuple[Mesh, tuple[str, ...]]:
    if not workable(vertices):
        bad = int(np.flatnonzero(~(np.abs(vertices) < LARGEST).all(axis=1))[0])
        raise FileError(path, f"holds {vertices[bad].tolist()}, which is no place", f"vertex {bad}")
    wrong = np.flatnonzero(~((corners >= 0) & (corners < len(vertices)) & (corners == np.floor(corners))))
    if len(wrong):
        polygon = int(np.searchsorted(np.cumsum(counts), wrong[0], side="right"))
        raise FileError(path, f"names vertex {corners[wrong[0]]:g} of {len(vertices)}", f"face {polygon}")
    thin = int((counts < 3).sum())
    notes = (f"{thin} faces with fewer than three corners were left out",) if thin else ()
    uvs = None
    for u, v in TEXTURE:
        if u in columns and v in columns and not isinstance(columns[u], tuple) and not isinstance(columns[v], tuple):
            coordinates = np.stack([columns[u], 1.0 - columns[v].astype(float)], axis=1).astype(float)
            uvs = coordinates if workable(coordinates) else None
            break
    return Mesh(vertices, fan(corners.astype(np.int64), counts), uvs=uvs), notes


def _vertices(path: Path, columns: dict[str, Any], empty: bool) -> Float[Array, "vertices 3"]:
    axes = [columns.get(axis) for axis in "xyz"]
    if any(axis is None or isinstance(axis, tuple) for axis in axes):
        raise FileError(path, "declares no element 'vertex' with the properties x, y and z")
    if not len(axes[0]) and not empty:
        raise FileError(path, "holds no vertex")
    return np.stack(axes, axis=1).astype(np.float64)


def _read_header(path: Path, file: BinaryIO) -> tuple[str, list[_Element], int]:
    """Byte order ('' for text), elements, and the number of the first line behind the header."""
    start = file.readline(80)
    if start.strip() != b"ply":
        problem = f"is not a PLY file: it begins with {shown(start)} instead of 'ply'"
        raise FileError(path, problem if start else "is empty")
    elements: list[_Element] = []
    order, line = None, 1
    while text := file.readline(LONGEST_HEADER):
        line += 1
        words = text[:1000].decode("latin-1").split()
        if file.tell() > LONGEST_HEADER:
            break
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "end_header":
            if order is None:
                raise FileError(path, "the header names no format", f"line {line}")
            return order, elements, line + 1
        if words[0] == "format" and len(words) == 3 and words[1] in BYTE_ORDERS:
            order = BYTE_ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,15}", words[2]):
            if any(words[1] == element.name for element in elements):
                raise FileError(path, f"a second element {words[1]!r}", f"line {line}")
            elements.append(_Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and (declared := _declared(words)):
            if any(declared.name == each.name for each in elements[-1].properties):
                raise FileError(path, f"a second property {declared.name!r} of {elements[-1].name}", f"line {line}")
            elements[-1].properties.append(declared)
        else:
            raise FileError(path, f"{shown(text.strip())} is no valid line of a PLY header", f"line {line}")
    raise FileError(path, "the header does not end ('end_header' is missing)", f"line {line}")


def _declared(words: list[str]) -> _Property | None:
    if len(words) == 3 and words[1] in TYPES:
        return _Property(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[3] in TYPES and TYPES.get(words[2], "f")[0] != "f":
        return _Property(words[4], TYPES[words[3]], TYPES[words[2]])
    return None


@dataclass
class _Text:
    """The body as numbers; a value of any type is one place long."""

    path: Path
    text: bytes
    line: int
    at: int = 0

    def __post_init__(self) -> None:
        values = numbers(self.text)
        if values is None:
            raise self.bad_word()
        self.values, self.length, self.unit, self.text = values, len(values), "values", b""

    def bad_word(self) -> FileError:
        for line, text in enumerate(self.text.split(b"\n"), self.line):
            for word in text.split():
                try:
                    float(word)
                except ValueError:
                    return FileError(self.path, f"{shown(word)} is no number", f"line {line}")
        return FileError(self.path, "the numbers cannot be parsed", f"from line {self.line} on")

    def size(self, _: str) -> int:
        return 1

    def items(self, _: str, at: int, count: int) -> Array:
        return self.values[at : at + count]

    def gather(self, _: str, starts: Array, counts: Array) -> Array:
        return self.values[np.repeat(starts, counts) + _within(counts)]

    def table(self, fields: list[tuple[str, int]], rows: int) -> list[Array]:
        ends = np.cumsum([count for _, count in fields])
        table = self.values[self.at : self.at + rows * int(ends[-1])].reshape(rows, -1)
        return np.split(table, ends[:-1], axis=1)


@dataclass
class _Bytes:
    """The body as it is."""

    path: Path
    start: int
    bytes: bytes
    order: str
    at: int = 0
    unit = "bytes"

    def __post_init__(self) -> None:
        self.length = len(self.bytes)

    def size(self, type_: str) -> int:
        return int(type_[1])

    def items(self, type_: str, at: int, count: int) -> Array:
        return np.frombuffer(self.bytes, self.order + type_, count, at)

    def gather(self, type_: str, starts: Array, counts: Array) -> Array:
        size = self.size(type_)
        places = np.repeat(starts, counts) + size * _within(counts)
        return np.frombuffer(self.bytes, np.uint8)[places[:, None] + np.arange(size)].view(self.order + type_)[:, 0]

    def table(self, fields: list[tuple[str, int]], rows: int) -> list[Array]:
        row = np.dtype([(f"f{i}", self.order + type_, (count,)) for i, (type_, count) in enumerate(fields)])
        table = np.frombuffer(self.bytes, row, rows, self.at)
        return [table[name] for name in row.names]


def _within(counts: Int[Array, "lists"]) -> Int[Array, "values"]:
    """0 1 2 ... within each list."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _read_element(body: _Text | _Bytes, element: _Element) -> dict[str, Any]:
    """The element's columns by name: an array of plain values, or the lengths and the joined values of lists.

    Raises `FileError` where less is left of the file than is declared, before any memory is taken.
    """
    smallest = sum(body.size(each.count_type or each.type) for each in element.properties)
    left = body.length - body.at
    if element.count == 0:
        none = np.zeros(0)
        return {each.name: (np.zeros(0, int), none) if each.count_type else none for each in element.properties}
    if not element.properties:
        raise FileError(body.path, f"declares {element.count} of element {element.name!r} without any property")
    if element.count * smallest > left:
        needed = f"at least {element.count * smallest} {body.unit}, and holds {left} more; the file is cut off"
        raise FileError(body.path, f"declares {element.count} of element {element.name!r}, so {needed}")
    return _read_uniform(body, element) or _read_ragged(body, element)


def _read_uniform(body: _Text | _Bytes, element: _Element) -> dict[str, Any] | None:
    """All rows at once, if every list is as long as that of the first row; else None."""
    fields: list[tuple[str, int]] = []
    at = body.at
    for each in element.properties:
        count = 1
        if each.count_type:
            count = _list_length(body, element, each, 0, at)
            fields.append((each.count_type, 1))
            at += body.size(each.count_type)
        fields.append((each.type, count))
        at += count * body.size(each.type)
    size = at - body.at
    if element.count * size > body.length - body.at or size > LONGEST_ROW:
        return None
    columns: dict[str, Any] = {}
    blocks = iter(body.table(fields, element.count))
    for each in element.properties:
        block = next(blocks)
        if each.count_type:
            if (block != block[0]).any():
                return None
            values = next(blocks)
            columns[each.name] = (np.full(element.count, values.shape[1]), values.ravel())
        else:
            columns[each.name] = block[:, 0]
    body.at += element.count * size
    return columns


def _read_ragged(body: _Text | _Bytes, element: _Element) -> dict[str, Any]:
    """Row by row, since only a list's length tells where the next one begins."""
    found = {each.name: (each, array("q"), array("q")) for each in element.properties if each.name in WANTED}
    at = body.at
    for row in range(element.count):
        for each in element.properties:
            count = 1
            if each.count_type:
                count = _list_length(body, element, each, row, at)
                at += body.size(each.count_type)
            if each.name in found:
                _, starts, counts = found[each.name]
                starts.append(at)
                counts.append(count)
            at += count * body.size(each.type)
            if at > body.length:
                raise FileError(body.path, "the file is cut off here", f"{element.name} {row}")
    body.at = at
    columns: dict[str, Any] = {}
    for name, (each, starts, counts) in found.items():
        lengths = np.array(counts, dtype=np.int64)
        values = body.gather(each.type, np.array(starts, dtype=np.int64), lengths)
        columns[name] = (lengths, values) if each.count_type else values
    return columns


def _list_length(body: _Text | _Bytes, element: _Element, each: _Property, row: int, at: int) -> int:
    """The length of a list that begins at `at`, which must leave room for what it announces."""
    left = body.length - at - body.size(each.count_type)
    if left < 0:
        raise FileError(body.path, "the file is cut off here", f"{element.name} {row}")
    value = body.items(each.count_type, at, 1)[0]
    if not 0 <= value <= left or value != np.floor(value) or value * body.size(each.type) > left:
        problem = f"{each.name} announces {value:g} values where {left} {body.unit} are left"
        raise FileError(body.path, problem, f"{element.name} {row}")
    return int(value)


def fan(corners: Int[Array, "corners"], counts: Int[Array, "polygons"]) -> Int[Array, "faces 3"]:
    """Triangles of polygons given one after another; each becomes a fan about its first corner."""
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    second = first + 1 + _within(triangles)
    return np.stack([corners[first], corners[second], corners[second + 1]], axis=1)


def write_ply(file: BinaryIO, surface: Mesh | PointCloud) -> None:
    """Binary, little endian; positions in double precision."""
    points = surface.points if isinstance(surface, PointCloud) else surface.vertices
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    rows = [points]
    if isinstance(surface, Mesh):
        if surface.uvs is not None:
            header += ["property double s", "property double t"]
            rows.append(surface.uvs * [1, -1] + [0, 1])
        header += [f"element face {len(surface.faces)}", "property list uchar int vertex_indices"]
    file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
    file.write(np.concatenate(rows, axis=1).astype("<f8").tobytes())
    if isinstance(surface, Mesh):
        faces = np.empty(len(surface.faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
        faces["count"], faces["corners"] = 3, surface.faces
        file.write(faces.tobytes())


def write_points(file: BinaryIO, points: Float[Array, "points 3"]) -> None:
    """A cloud, binary, little endian, single precision: one frame of a capture."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii"))
    file.write(points.astype("<f4").tobytes())
