"""The container of Alembic files (Ogawa): what it says of its times and of the program that wrote it, without any library.

A file is a tree of groups and data: 16 bytes of header with the place of the root group, a group is a count and the places of
its children, data are a length and bytes. The root's fourth child is text (`key=value;`), its fifth the time samplings. The
layout is that of Alembic's own writer (AbcCoreOgawa, `WriteTimeSampling`); the meshes in the third child are left to Blender.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from retarget.errors import FileError
from retarget.io.timeline import USUAL_RATES, Timeline, timeline

MAGIC, HDF5 = b"Ogawa", b"\x89HDF"
FINISHED = 0xFF
"""The sixth byte of a file that its writer has closed."""
IS_DATA = 1 << 63
"""In the place of a child: it is data, not a group."""
METADATA, SAMPLINGS, ROOT_CHILDREN = 3, 4, 6
LARGEST_DATA = 16 << 20
"""Bytes of metadata or time samplings that are read; files have some hundred."""
ACYCLIC = np.finfo(np.float64).max / 32.0
"""Seconds a cycle that stand for none: each sample has its own time."""
MOST_SAMPLES = 1_000_000
ENOUGH_CYCLES = 1000
RATES = (0.01, 10_000.0)
"""Frames a second that are believed."""
DATE = b"_ai_DateWritten="
NO_DATE = b"Thu Jan  1 00:00:00 1970"


@dataclass(frozen=True, eq=False)
class Sampling:
    """When the samples of some properties are."""

    count: int
    """Samples of the property that has the most."""
    cycle: float
    """Seconds after which `times` begin anew; `ACYCLIC` where they never do."""
    times: np.ndarray
    """(times,) seconds, rising."""

    @property
    def grid(self) -> Timeline:
        """The even grid of the samples. Uniform ones keep their own rate, usual ones without the error of single precision."""
        if self.cycle < ACYCLIC and len(self.times) == 1:
            rate = 1.0 / self.cycle
            usual = next((each for each in USUAL_RATES if abs(each - rate) < 5e-7 * rate), round(rate, 5))
            return Timeline(float(self.times[0]), usual, self.count)
        whole, rest = divmod(self.count - 1, len(self.times))
        last = whole * self.cycle + self.times[rest]
        first_cycles = np.arange(min(whole + 1, ENOUGH_CYCLES))[:, None] * self.cycle  # they show the rate of all
        grid = timeline((first_cycles + self.times).reshape(-1)[: self.count])
        return replace(grid, frames=int(np.ceil((last - grid.start) * grid.fps - 0.02)) + 1)


@dataclass(frozen=True, eq=False)
class Archive:
    """What an Alembic file says of itself."""

    metadata: Mapping[str, str]
    samplings: tuple[Sampling, ...]

    def moving(self) -> list[Timeline]:
        """The grids of what has more than one sample, different ones once."""
        grids = [each.grid for each in self.samplings if each.count > 1]
        return list({(grid.start, grid.fps, grid.frames): grid for grid in grids}.values())


def read_archive(path: str | Path) -> Archive:
    """Read metadata and time samplings. Raises `FileError` for files of other forms, damaged ones, times that do not rise, and
    more samples or rates than can be meant."""
    path = Path(path)
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        _, text = _root_data(path, file, size, METADATA)
        _, times = _root_data(path, file, size, SAMPLINGS)
    pairs = (each.partition("=") for each in text.decode("utf-8", "replace").split(";"))
    return Archive({key: value for key, _, value in pairs if key}, tuple(_samplings(path, times)))


def erase_date(path: str | Path) -> None:
    """Overwrite the time of day at which a file was written: equal input gives equal files. Raises `FileError` for a damaged one."""
    with open(path, "r+b") as file:
        start, text = _root_data(Path(path), file, os.fstat(file.fileno()).st_size, METADATA)
        place = text.find(DATE)
        if place >= 0:
            place += len(DATE)
            length = (text + b";").index(b";", place) - place
            file.seek(start + place)
            file.write(NO_DATE.ljust(length)[:length])


def _root_data(path: Path, file: BinaryIO, size: int, child: int) -> tuple[int, bytes]:
    """Where a child of the root group begins, and its bytes."""
    header = _bytes_at(path, file, size, 0, min(16, size))
    if header.startswith(HDF5):
        raise FileError(path, "is an Alembic file of the old form (HDF5); export it again as Ogawa, the form since Alembic 1.5")
    if len(header) < 16 or not header.startswith(MAGIC):
        raise FileError(path, "is no Alembic file: it does not begin with 'Ogawa'")
    if header[5] != FINISHED:
        raise FileError(path, "was not finished by the program that wrote it; export it again")
    root = int.from_bytes(header[8:], "little")
    count = int.from_bytes(_bytes_at(path, file, size, root, 8), "little")
    if count < ROOT_CHILDREN:
        raise FileError(path, f"is damaged: its root has {count} parts instead of {ROOT_CHILDREN}", f"byte {root}")
    place = int.from_bytes(_bytes_at(path, file, size, root + 8 * (1 + child), 8), "little")
    if not place & IS_DATA:
        raise FileError(path, f"is damaged: part {child} of its root is no data", f"byte {root}")
    start = place & ~IS_DATA
    if not start:  # data of no length have no place
        return 0, b""
    length = int.from_bytes(_bytes_at(path, file, size, start, 8), "little")
    if length > LARGEST_DATA:
        raise FileError(path, f"is damaged: part {child} of its root has {length} bytes", f"byte {start}")
    return start + 8, _bytes_at(path, file, size, start + 8, length)


def _bytes_at(path: Path, file: BinaryIO, size: int, start: int, length: int) -> bytes:
    if start + length > size:
        raise FileError(path, f"is cut off or damaged: it has {size} bytes and refers to byte {start + length}", f"byte {start}")
    file.seek(start)
    return file.read(length)


def _samplings(path: Path, data: bytes) -> Iterator[Sampling]:
    at = number = 0
    while at < len(data):
        place = f"time sampling {number}"
        if at + 16 > len(data):
            raise FileError(path, "is damaged: it ends early", place)
        count, cycle, held = struct.unpack_from("<IdI", data, at)
        at, number = at + 16, number + 1
        if not held or at + 8 * held > len(data):
            raise FileError(path, f"is damaged: it says that it has {held} times", place)
        times = np.frombuffer(data, "<f8", held, at).astype(np.float64)
        at += 8 * held
        if not (np.abs(times) < 1e9).all() or (np.diff(times) <= 0).any() or not cycle > 0:
            raise FileError(path, "has times that do not rise", place)
        if count > MOST_SAMPLES or (cycle >= ACYCLIC and count > held):
            raise FileError(path, f"has {count} samples; at most {MOST_SAMPLES} are read, each with a time", place)
        if cycle < ACYCLIC and count > 1:
            rate = held / cycle
            if not RATES[0] <= rate <= RATES[1] or times[-1] - times[0] >= cycle:
                raise FileError(path, f"has {held} times in a cycle of {cycle:g} s, which is no frame rate", place)
        yield Sampling(count, float(cycle), times)
