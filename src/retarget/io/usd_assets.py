"""Files that a written stage refers to (pictures, sounds), and the .usdz package that holds them. Runs in the child."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from typing import Any

from retarget.io.child import LARGEST_FILE
from retarget.io.pictures import is_inside
from retarget.io.usd_layers import home_of

PACKED = (".png", ".jpg", ".jpeg", ".exr", ".avif", ".m4a", ".mp3", ".wav")
"""Suffixes that a package may hold beside USD (usdz specification)."""
ALIGNED = 64
"""Every file's data in a package begin at a multiple of this many bytes."""
DATE = 0x21
"""1 January 1980, the earliest that a zip can say: no file of ours depends on when it was written."""


class Assets:
    """What becomes of the paths by which a stage names other files, when it is written elsewhere."""

    def __init__(self, packed: bool, folder: str) -> None:
        self.packed, self.folder = packed, folder
        self.files: dict[str, bytes] = {}
        """What the package has to hold, by name."""
        self._names: dict[str, str] = {}

    def add(self, name: str, data: bytes) -> str:
        """Keep data for the package; the path by which the stage names it."""
        if sum(map(len, self.files.values())) + len(data) > LARGEST_FILE:
            raise ValueError(f"its pictures have more than {LARGEST_FILE} bytes")
        self.files[name] = data
        return name

    def move(self, layer: Any, root: Any, source: str) -> None:
        """Let all paths in `layer`, a copy of `root`, lead from the new place to where they led before.

        Files inside the source's folder (its package) go into the new package.
        """
        from pxr import Sdf, UsdUtils

        beside, home = os.path.dirname(source), home_of(source)

        def moved(path: str) -> str:
            if not path or path.startswith("`") or "://" in path:
                return path
            outer, _, inner = Sdf.ComputeAssetPathRelativeToLayer(root, path).partition("[")
            real, inner = os.path.realpath(outer), inner.removesuffix("]")
            if not os.path.isabs(outer) or not os.path.isfile(real):
                return path
            if self.packed:
                return self._pack(real, inner, path) if is_inside(real, home) else path
            if not inner and os.path.samefile(beside, self.folder):
                return path
            return os.path.relpath(outer, self.folder).replace(os.sep, "/") + (f"[{inner}]" if inner else "")

        UsdUtils.ModifyAssetPaths(layer, moved)

    def _pack(self, real: str, inner: str, path: str) -> str:
        key = f"{real}[{inner}]"
        if key not in self._names:
            name = os.path.basename(inner or real)
            if not name.lower().endswith(PACKED):
                return path
            data = read_asset(real, inner)
            if data is None:
                return path
            self._names[key] = self.add(f"textures/{len(self.files)}_{name}", data)
        return self._names[key]


def read_asset(path: str, inner: str) -> bytes | None:
    """A file, or one inside a package; None where it is not there, too large, or compressed, as no package may be."""
    size = os.path.getsize(path)
    if size > LARGEST_FILE:
        return None
    if not inner:
        with open(path, "rb") as file:
            return file.read()
    with zipfile.ZipFile(path) as archive:
        try:
            entry = archive.getinfo(inner)
        except KeyError:
            return None
        stored = entry.compress_type == zipfile.ZIP_STORED and entry.file_size <= size
        return archive.read(entry) if stored else None


def write_package(output: str, layer: str, files: dict[str, bytes]) -> None:
    """A .usdz: a zip without compression, the layer first, all data aligned, the same for the same content."""
    with open(layer, "rb") as file:
        contents = {os.path.basename(layer): file.read(), **files}
    directory, place = b"", 0
    with open(output, "wb") as file:
        for name, data in contents.items():
            encoded = name.encode()
            pad = -(place + 30 + len(encoded) + 4) % ALIGNED
            extra = struct.pack("<HH", 0x1986, pad) + b"\0" * pad
            shared = (20, 0x800, 0, 0, DATE, zlib.crc32(data), len(data), len(data), len(encoded))
            local = struct.pack("<IHHHHHIIIHH", 0x04034B50, *shared, len(extra)) + encoded + extra
            file.write(local + data)
            directory += struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, 20, *shared, 0, 0, 0, 0, 0, place) + encoded
            place += len(local) + len(data)
        count = len(contents)
        file.write(directory + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, count, count, len(directory), place, 0))
