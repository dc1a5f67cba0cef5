"""Arrays of an .npz file, read with care: a zip of .npy members from anywhere on the internet.

`numpy.load` takes memory for whatever a header declares and decides late that an array is pickled. Here the directory
of the zip and the header of every array are read first; an array's bytes are read only where declared shape, member
size and file size agree. Pickled objects are never read, since a pickle runs code.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.errors import FileError
from retarget.io.decimal_text import workable

Array = np.ndarray

LARGEST = 1 << 29
"""Bytes of an array that is read: an hour at 120 frames a second, or 800 shape components of SMPL-X."""
MOST_VALUES = 1 << 26
"""Values of an array that is read: small integers grow to eight bytes each."""
LONGEST_HEADER = 10_000
"""Bytes of an array's header."""
DENSEST = 1040
"""How many bytes one byte of a deflated member can stand for, at most (its longest match is 258 bytes for 2 bits)."""
DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, NotImplementedError, ValueError,
    OverflowError, OSError,
)  # fmt: skip
"""What reading a damaged zip raises."""
FIELDS = re.compile(
    rb"^\{(?=.*'descr': *'(?P<dtype>[^']*)')(?=.*'fortran_order': *(?P<fortran>True|False))"
    rb"(?=.*'shape': *\((?P<shape>[0-9L, ]*)\)).*\}\s*$"
)
"""The header of a plain array, a Python dictionary in one line; a structured array has a list for its `descr`."""


@dataclass(frozen=True)
class Entry:
    """One array of the archive, as its header declares it."""

    member: str
    shape: tuple[int, ...]
    dtype: np.dtype | None
    """None for what is not a plain array of numbers or text."""
    fortran: bool
    start: int
    """Bytes of the header."""
    problem: str = ""
    """Why it cannot be read."""


@dataclass(frozen=True)
class Archive:
    """The arrays of one file by name; nothing is in memory yet."""

    path: Path
    entries: Mapping[str, Entry]

    def __contains__(self, name: str) -> bool:
        return name in self.entries

    def first(self, *names: str) -> str | None:
        """The first of these names that the file holds."""
        return next((name for name in names if name in self.entries), None)

    def shape(self, name: str) -> tuple[int, ...]:
        """Declared shape. Raises `FileError` for an array that could not be read."""
        return self._sound(name).shape

    def numbers(self, name: str, holes: bool = False) -> Array:
        """An array of numbers as float64. Raises `FileError` for anything else, and for values that are not finite unless there
        may be `holes`."""
        raw = self._read(name)
        if raw.dtype.kind not in "fiu":
            raise self.fail(name, f"must hold numbers, holds {raw.dtype}")
        values = raw.astype(np.float64)
        if not workable(values[np.isfinite(values)] if holes else values):
            raise self.fail(name, "holds numbers that are not finite, or absurdly large")
        return values

    def integers(self, name: str) -> Array:
        """An array of integers as int64; unsigned ones beyond its range become negative. Raises `FileError` for
        others."""
        raw = self._read(name)
        if raw.dtype.kind not in "iu":
            raise self.fail(name, f"must hold integers, holds {raw.dtype}")
        return raw.astype(np.int64)

    def text(self, name: str) -> str | None:
        """The one text that an array holds; None for anything else. What is only a hint may come in any form."""
        entry = self.entries[name]
        if entry.problem or entry.dtype is None or entry.dtype.kind not in "SU" or math.prod(entry.shape) != 1:
            return None
        wide = "utf-32-be" if entry.dtype.byteorder == ">" else "utf-32-le"
        try:  # decoded by hand: numpy makes strings of numbers that are no characters, which end the interpreter
            value = self._read(name).tobytes().decode(wide if entry.dtype.kind == "U" else "ascii").rstrip("\0")
        except ValueError:  # damaged, or no text in a known code
            return None
        return value if value.isprintable() else None

    def fail(self, name: str, problem: str) -> FileError:
        return FileError(self.path, problem, name)

    def _sound(self, name: str) -> Entry:
        entry = self.entries[name]
        if entry.problem:
            raise self.fail(name, entry.problem)
        return entry

    def _read(self, name: str) -> Array:
        entry = self._sound(name)
        size = math.prod(entry.shape) * entry.dtype.itemsize
        try:
            with zipfile.ZipFile(self.path) as file, file.open(entry.member) as member:
                member.read(entry.start)
                raw = member.read(size)
                if len(raw) != size or member.read(1):
                    raise EOFError
        except DAMAGED:
            raise self.fail(name, "is damaged") from None
        return np.frombuffer(raw, entry.dtype).reshape(entry.shape, order="F" if entry.fortran else "C")


def open_archive(path: str | Path) -> Archive:
    """The directory of an .npz file and the headers of its arrays. Raises `FileError` for what is no such file."""
    path = Path(path)
    entries: dict[str, Entry] = {}
    try:
        size = path.stat().st_size
        with zipfile.ZipFile(path) as file:
            for info in file.infolist():
                name = info.filename.removesuffix(".npy")
                if name == info.filename:
                    continue
                if name in entries:
                    raise FileError(path, f"holds {name!r} twice")
                entries[name] = _entry(file, info, size)
    except FileError:
        raise
    except DAMAGED:
        raise FileError(path, "is no .npz file (a zip of arrays), or is damaged") from None
    return Archive(path, entries)


def _entry(file: zipfile.ZipFile, info: zipfile.ZipInfo, size: int) -> Entry:
    """What a member declares, or why it cannot be read."""

    def refused(problem: str) -> Entry:
        return Entry(info.filename, (), None, False, 0, problem)

    if info.flag_bits & 1:
        return refused("is encrypted")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return refused("is compressed in a way that numpy does not write")
    densest = 1 if info.compress_type == zipfile.ZIP_STORED else DENSEST
    if info.compress_size > size or info.file_size > densest * info.compress_size:
        return refused(f"declares {info.file_size} bytes, more than the file can hold")
    if info.file_size > LARGEST:
        return refused(f"has {info.file_size} bytes; arrays of up to {LARGEST} are read")
    try:
        with file.open(info) as member:
            start = member.read(8)
            if start[:6] != b"\x93NUMPY" or start[6:7] not in (b"\x01", b"\x02", b"\x03"):
                return refused("is no numpy array")
            wide = 2 if start[6] == 1 else 4
            length = int.from_bytes(member.read(wide), "little")
            if length > LONGEST_HEADER:
                return refused(f"has a header of {length} bytes; numpy's are shorter")
            header = member.read(length)
    except DAMAGED:
        return refused("is damaged")
    found = FIELDS.match(header.replace(b"\n", b" "))
    if not found:
        return refused("is not a plain array of numbers or text")
    try:
        dtype = np.dtype(found["dtype"].decode("ascii"))
        shape = tuple(int(each.strip(b"L ")) for each in found["shape"].split(b",") if each.strip())
    except (TypeError, ValueError, SyntaxError):
        return refused("has a header that numpy does not write")
    if math.prod(shape) > MOST_VALUES:
        return refused(f"declares {math.prod(shape)} values; arrays of up to {MOST_VALUES} are read")
    if dtype.hasobject:
        return refused("holds Python objects (pickled), which are not read since they run code; save plain arrays")
    begin = 8 + wide + length
    if math.prod(shape) * dtype.itemsize != info.file_size - begin:
        return refused(f"declares the shape {shape}, which does not fit its {info.file_size - begin} bytes")
    return Entry(info.filename, shape, dtype, found["fortran"] == b"True", begin)
