"""One file per format, chosen by suffix. `load` reads anything; writers are chosen by the suffix of the output."""

from __future__ import annotations

import importlib
from pathlib import Path

from retarget.errors import FileError
from retarget.io.asset import Asset

# Module that reads each suffix; imported only when a file of that kind is met.
READERS = {
    ".bvh": "retarget.io.bvh",
    ".glb": "retarget.io.gltf",
    ".gltf": "retarget.io.gltf",
    ".obj": "retarget.io.obj_ply",
    ".ply": "retarget.io.obj_ply",
}


def load(path: str | Path) -> Asset:
    """Read any supported file. Raises `FileError` naming the file, the place and the cure."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise FileError(path, f"unknown suffix {suffix!r}; supported: {' '.join(sorted(READERS))}")
    if not path.exists():
        raise FileError(path, "no such file")
    if not path.is_file():
        raise FileError(path, "is not a file")
    return importlib.import_module(READERS[suffix]).load(path)
