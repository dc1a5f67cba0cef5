"""A GLB in the making, by readers of other formats that work in a process of their own: numpy and no more.

What is written here is read by `gltf_document.py`, which believes none of it.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

FLOAT, UNSIGNED, SHORT = 5126, 5125, 5123
"""Component types of glTF."""
MOST_KEYS = 40_000_000
"""Transforms of all takes of a file together; more is no animation that anyone made."""
STILL = 1e-7
"""Change of a transform's numbers below which it does not move."""

PROVENANCE_KEY = "retarget"
"""Where the extras of an animation say what it was made from (`provenance.py`)."""


class Glb:
    """A GLB in the making."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.parts: list[bytes] = []
        self.size = 0

    def append(self, kind: str, entry: dict[str, Any]) -> int:
        """Number of a new entry."""
        self.json.setdefault(kind, []).append(entry)
        return len(self.json[kind]) - 1

    def add_view(self, data: bytes) -> int:
        """Number of a new buffer view."""
        view = self.append("bufferViews", {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)})
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.parts[-1])
        return view

    def add(self, array: np.ndarray, kind: str, component: int, bounds: bool = False) -> int:
        """Number of a new accessor over the rows of an array."""
        view = self.add_view(np.ascontiguousarray(array).tobytes())
        accessor = {"bufferView": view, "componentType": component, "count": len(array), "type": kind}
        if bounds and len(array):
            rows = np.asarray(array).reshape(len(array), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.append("accessors", accessor)

    def add_moves(self, rows: np.ndarray, moves: np.ndarray, count: int) -> int:
        """Number of a new accessor of `count` vectors, zero but for some rows (ascending), which are `moves`."""
        moves = np.ascontiguousarray(moves, dtype=np.float32)
        if 16 * len(rows) >= 12 * count:
            dense = np.zeros((count, 3), np.float32)
            dense[rows] = moves
            return self.add(dense, "VEC3", FLOAT, bounds=True)
        ends = np.concatenate([moves, np.zeros((1, 3), np.float32)])
        accessor: dict[str, Any] = {
            "componentType": FLOAT, "count": count, "type": "VEC3",
            "min": ends.min(axis=0).tolist(), "max": ends.max(axis=0).tolist(),
        }  # fmt: skip
        if len(rows):
            indices, values = self.add_view(rows.astype(np.uint32).tobytes()), self.add_view(moves.tobytes())
            accessor["sparse"] = {
                "count": len(rows), "indices": {"bufferView": indices, "componentType": UNSIGNED},
                "values": {"bufferView": values},
            }  # fmt: skip
        return self.append("accessors", accessor)

    def add_influences(self, joints: np.ndarray, weights: np.ndarray) -> dict[str, int]:
        """Accessors of joints and weights (vertices, a multiple of four), by the names of their attributes."""
        attributes = {}
        for start in range(0, joints.shape[1], 4):
            own = slice(start, start + 4)
            attributes[f"JOINTS_{start // 4}"] = self.add(joints[:, own].astype(np.uint16), "VEC4", SHORT)
            attributes[f"WEIGHTS_{start // 4}"] = self.add(weights[:, own].astype(np.float32), "VEC4", FLOAT)
        return attributes

    def add_picture(self, data: bytes, kind: str) -> int:
        """Number of a new texture that shows a picture of that media type."""
        image = self.append("images", {"bufferView": self.add_view(data), "mimeType": kind})
        return self.append("textures", {"source": image})

    def write(self, path: str) -> None:
        if self.size:
            self.json["buffers"] = [{"byteLength": self.size}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        with open(path, "wb") as file:
            whole = 12 + 8 + len(text) + (8 + self.size if self.size else 0)
            file.write(struct.pack("<4sII", b"glTF", 2, whole) + struct.pack("<I4s", len(text), b"JSON") + text)
            if self.size:
                file.write(struct.pack("<I4s", self.size, b"BIN\0") + b"".join(self.parts))


def fan_triangles(counts: np.ndarray, first: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons, as fans from their first corners, and the polygon of each; in the polygons' order."""
    each = np.maximum(counts - 2, 0)
    owners = np.repeat(np.arange(len(counts)), each)
    step = np.arange(len(owners)) - np.repeat(np.cumsum(each) - each, each)
    start = first[owners]
    return np.stack([corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1), owners
