"""PCD, the point clouds of PCL: a header of words, then the points as text, as bytes, or as compressed bytes (version
0.7).

Positions are read, in whatever numbers they are given; colours, normals and the pose of the sensor (VIEWPOINT) are
passed over. Organised clouds (a depth picture, HEIGHT over 1) keep the points that are finite: sensors mark pixels
without depth by NaN.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from retarget.character import PointCloud
from retarget.errors import FileError
from retarget.io.asset import Asset
from retarget.io.decimal_text import numbers, shown
from retarget.io.ply import finite_cloud
from retarget.io.whole_file import written_whole

Array = np.ndarray

TYPES = {
    "I1": "i1", "I2": "i2", "I4": "i4", "I8": "i8", "U1": "u1", "U2": "u2", "U4": "u4", "U8": "u8",
    "F4": "f4", "F8": "f8",
}  # fmt: skip
WORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
ENCODINGS = ("ascii", "binary", "binary_compressed")
LONGEST_HEADER = 1 << 14
MOST_FIELDS = 256
LARGEST = 1 << 30
"""Bytes of points that are unpacked."""
DENSEST = 88
"""How many bytes one byte of LZF can stand for, at most: three bytes for a repetition of 264."""


@dataclass(frozen=True)
class _Header:
    fields: tuple[str, ...]
    types: tuple[str, ...]
    """numpy's letter and size."""
    counts: tuple[int, ...]
    points: int
    encoding: str

    @property
    def row(self) -> int:
        """Bytes of a point."""
        return sum(int(type_[1]) * count for type_, count in zip(self.types, self.counts))


def load(path: str | Path, empty: bool = False) -> Asset:
    """Read a PCD file: kind 'points'. With `empty` a cloud of no points is one, too (a frame in which nothing was
    seen).

    Raises `FileError` with the line for headers that are none, and for files that hold less than they declare.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            header = _read_header(path, file)
            points = _read_points(path, header, file.read())
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    cloud, notes = finite_cloud(path, points, empty)
    return Asset(path, "points", points=cloud, notes=notes)


def save(path: str | Path, cloud: PointCloud) -> None:
    """Write a cloud, binary, single precision. The file appears whole or not at all. Raises `FileError` where it cannot
    be written."""
    with written_whole(path) as file:
        write_pcd(file, cloud.points)


def write_pcd(file: BinaryIO, points: Float[Array, "points 3"]) -> None:
    """The bytes of a PCD file of these points."""
    header = (
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", "FIELDS x y z", "SIZE 4 4 4",
        "TYPE F F F", "COUNT 1 1 1",
        f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", "DATA binary",
    )  # fmt: skip
    file.write(("\n".join(header) + "\n").encode("ascii"))
    file.write(points.astype("<f4").tobytes())


def _read_header(path: Path, file: BinaryIO) -> _Header:
    found: dict[str, list[str]] = {}
    line = 0
    while text := file.readline(LONGEST_HEADER):
        line += 1
        words = text.decode("latin-1").split()
        if file.tell() > LONGEST_HEADER:
            break
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in WORDS:
            where = f"is not a PCD file: {shown(text.strip())} is no line of its header"
            raise FileError(path, where, f"line {line}")
        if words[0] in found:
            raise FileError(path, f"a second line {words[0]}", f"line {line}")
        found[words[0]] = words[1:]
        if words[0] == "DATA":
            return _header(path, found)
    raise FileError(path, "the header does not end ('DATA' is missing)" if line else "is empty")


def _header(path: Path, found: dict[str, list[str]]) -> _Header:
    def whole(word: str, given: list[str], highest: int) -> list[int]:
        if not all(re.fullmatch("[0-9]{1,15}", each) and int(each) <= highest for each in given):
            raise FileError(path, f"{word} must be whole numbers up to {highest}, received {' '.join(given)[:40]!r}")
        return [int(each) for each in given]

    fields = tuple(found.get("FIELDS", ()))
    if not {"x", "y", "z"} <= set(fields) or len(fields) > MOST_FIELDS:
        raise FileError(path, f"needs the fields x, y and z once each, holds {' '.join(fields)[:40]!r}", "FIELDS")
    sizes, types = found.get("SIZE", []), found.get("TYPE", [])
    counts = whole("COUNT", found.get("COUNT", ["1"] * len(fields)), 1 << 16)
    if not len(fields) == len(sizes) == len(types) == len(counts):
        raise FileError(path, f"{len(fields)} FIELDS have {len(sizes)} SIZE, {len(types)} TYPE and {len(counts)} COUNT")
    kinds = [TYPES.get(type_ + size) for type_, size in zip(types, sizes)]
    if None in kinds:
        wrong = kinds.index(None)
        raise FileError(
            path,
            f"no numbers are of TYPE {types[wrong][:20]!r} and SIZE {sizes[wrong][:20]!r}",
            f"field {fields[wrong][:20]!r}",
        )
    if any(fields.count(axis) > 1 or counts[fields.index(axis)] != 1 for axis in "xyz"):
        raise FileError(path, "needs the fields x, y and z once each, with one number", "FIELDS")
    shape = [whole(word, found.get(word, []), 10**12) for word in ("WIDTH", "HEIGHT", "POINTS")]
    if any(len(each) > 1 for each in shape) or not (shape[2] or (shape[0] and shape[1])):
        raise FileError(path, "needs one number each of WIDTH, HEIGHT and POINTS")
    points = shape[2][0] if shape[2] else shape[0][0] * shape[1][0]
    if shape[0] and shape[1] and shape[0][0] * shape[1][0] != points:
        raise FileError(path, f"declares {points} POINTS, and {shape[0][0]} x {shape[1][0]} of them")
    encoding = " ".join(found["DATA"])
    if encoding not in ENCODINGS:
        raise FileError(path, f"DATA is one of {', '.join(ENCODINGS)}, received {encoding[:40]!r}")
    return _Header(fields, tuple(kinds), tuple(counts), points, encoding)


def _read_points(path: Path, header: _Header, body: bytes) -> Float[Array, "points 3"]:
    """Positions, before any that are not finite are left out. Nothing is allocated that the file could not fill."""
    if header.points * header.row > LARGEST:
        raise FileError(path, f"declares {header.points} points of {header.row} bytes; up to {LARGEST} bytes are read")
    columns = np.cumsum((0, *header.counts))
    places = [header.fields.index(axis) for axis in "xyz"]
    if header.encoding == "ascii":
        width, values = int(columns[-1]), numbers(body)
        if values is None:
            raise FileError(path, "holds words that are no numbers behind its header")
        if len(values) < header.points * width:
            raise FileError(
                path, f"declares {header.points} points of {width} numbers, holds {len(values)} numbers; it is cut off"
            )
        table = values[: header.points * width].reshape(header.points, width)
        return np.ascontiguousarray(table[:, columns[places]])
    needed = header.points * header.row
    if header.encoding == "binary_compressed":
        body = _unpacked(path, body, needed)
    if len(body) < needed:
        raise FileError(path, f"declares {header.points} points, {needed} bytes, and holds {len(body)}; it is cut off")
    if header.encoding == "binary_compressed":  # field after field
        starts = np.cumsum(
            (0, *(int(type_[1]) * count * header.points for type_, count in zip(header.types, header.counts)))
        )
        axes = [np.frombuffer(body, "<" + header.types[k], header.points, int(starts[k])) for k in places]
    else:
        row = np.dtype(
            [(f"f{k}", "<" + type_, (count,)) for k, (type_, count) in enumerate(zip(header.types, header.counts))]
        )
        table = np.frombuffer(body, row, header.points)
        axes = [table[f"f{k}"][:, 0] for k in places]
    return np.stack(axes, axis=1).astype(np.float64)


def _unpacked(path: Path, body: bytes, needed: int) -> bytes:
    """Two sizes, and what they say unpacked."""
    packed, whole = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    if len(body) < 8 + packed:
        raise FileError(path, f"declares {packed} compressed bytes and holds {max(len(body) - 8, 0)}; it is cut off")
    if whole != needed or whole > DENSEST * packed:
        raise FileError(path, f"declares {packed} compressed bytes for {whole}, where its points take {needed}")
    found = lzf_unpacked(body[8 : 8 + packed], whole)
    if found is None:
        raise FileError(path, "its compressed points are damaged")
    return found


def lzf_unpacked(packed: bytes, size: int) -> bytes | None:
    """What LZF (Marc Lehmann's liblzf) stands for, or None where it does not stand for exactly `size` bytes.

    A byte under 32 announces so many bytes, and one more, as they are; any other a repetition: three bits of its
    length, which 7 continues in a byte more, and thirteen bits of how far back it begins.
    """
    out, at, end = bytearray(), 0, len(packed)
    while at < end:
        first = packed[at]
        at += 1
        if first < 32:
            out += packed[at : at + first + 1]
            at += first + 1
            if at > end:
                return None
        else:
            length = first >> 5
            if length == 7:
                if at >= end:
                    return None
                length += packed[at]
                at += 1
            if at >= end:
                return None
            back, length = ((first & 31) << 8) + packed[at] + 1, length + 2
            at += 1
            if back > len(out):
                return None
            start = len(out) - back
            piece = out[start : start + length]
            out += piece if len(piece) == length else (piece * (length // back + 1))[:length]
        if len(out) > size:
            return None
    return bytes(out) if len(out) == size else None
