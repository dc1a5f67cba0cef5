"""Mesh sequences as USD: one mesh whose points are sampled on every frame. usd-core works in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from retarget.character import MeshMotion
from retarget.errors import FileError
from retarget.io.usd import require_usd
from retarget.io.usd_points import LARGEST
from retarget.io.usd_write import identifier, run_write, surface_arrays


def save(path: str | Path, motion: MeshMotion) -> None:
    """Write a mesh sequence as .usda (text), .usdc and .usd (binary), or .usdz (a package), in metres with +Y up.

    A time code is a frame, the first is 0. Base colours and texture coordinates come along, pictures into a .usdz only.
    The file appears whole or not at all, and equal input gives equal bytes. Raises `FileError` for a mesh without faces,
    one too large to be read again, without usd-core, and where the file cannot be written.
    """
    path = Path(path)
    require_usd(path)
    if not len(motion.mesh.faces):
        raise FileError(path, "a mesh sequence without faces cannot be written as USD")
    if motion.vertices.nbytes > LARGEST:
        raise FileError(path, f"{len(motion)} frames of {motion.vertices.shape[1]} vertices are more than a USD file is given here")
    arrays = {"frames": np.ascontiguousarray(motion.vertices)}
    order: dict[str, Any] = {"suffix": path.suffix.lower(), "stem": identifier(path.stem), "fps": motion.fps}
    order |= {"folder": str(path.parent.absolute()), "title": motion.name or "sequence"}
    order["name"] = identifier(order["title"])
    order["materials"] = surface_arrays(motion.mesh, motion.vertices[0], arrays)
    run_write(path, order, arrays)
