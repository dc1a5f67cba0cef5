"""Pictures that files of other formats show: which may be read, and which are taken. Read in processes of their own.

Taken are PNG and JPEG, which every reader of glTF knows, of sizes that a graphics card takes.
"""

from __future__ import annotations

import os
import struct

KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""Media types by how data begin."""
LARGEST = 64 << 20
"""Bytes of one picture."""
WIDEST = 16_384
"""Pixels of a side."""


def picture_kind(data: bytes) -> str | None:
    """The media type of a picture's data; None where it is neither PNG nor JPEG, or too large to be shown."""
    kind = next((kind for head, kind in KINDS.items() if data.startswith(head)), None)
    sides = _png_sides(data) if kind == "image/png" else _jpeg_sides(data) if kind == "image/jpeg" else None
    sound = sides is not None and 0 < min(sides) <= max(sides) <= WIDEST and len(data) <= LARGEST
    return kind if sound else None


def _png_sides(data: bytes) -> tuple[int, int] | None:
    return struct.unpack(">II", data[16:24]) if len(data) > 32 and data[12:16] == b"IHDR" else None


def _jpeg_sides(data: bytes) -> tuple[int, int] | None:
    """Height and width, from the first frame header (SOF) behind the other segments."""
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:  # fill
            place += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return struct.unpack(">HH", data[place + 5 : place + 9])
        else:
            place += 2 + struct.unpack(">H", data[place + 2 : place + 4])[0]
    return None


def is_inside(real: str, home: str) -> bool:
    """Whether a real path is `home` or lies below it."""
    return real == home or real.startswith(home.rstrip(os.sep) + os.sep)


def picture_beside(home: str, names: list[str], looked: set[str]) -> bytes | None:
    """The first of some files, by their paths from `home` (a real path), that is there and inside it; None without one.

    Nothing outside is looked at, links are followed before that is decided, and what is larger than a picture may be is
    passed over. All that were looked for go into `looked`, by their real paths.
    """
    for name in names:
        real = os.path.realpath(os.path.join(home, name)) if name and "\0" not in name else ""
        if is_inside(real, home):
            looked.add(real)
        if is_inside(real, home) and os.path.isfile(real) and os.path.getsize(real) <= LARGEST:
            with open(real, "rb") as file:
                return file.read(LARGEST + 1)
    return None
