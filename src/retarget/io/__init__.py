"""One file per format, chosen by suffix. `load` reads anything; writers are chosen by the suffix of the output."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from retarget.character import Character, Motion
from retarget.errors import FileError, RetargetError
from retarget.io.asset import Asset

# Module that reads each suffix; imported only when a file of that kind is met.
READERS = {
    ".bvh": "retarget.io.bvh",
    ".fbx": "retarget.io.fbx",
    ".glb": "retarget.io.gltf",
    ".gltf": "retarget.io.gltf",
    ".obj": "retarget.io.obj_ply",
    ".ply": "retarget.io.obj_ply",
    ".vrm": "retarget.io.gltf",
    ".vrma": "retarget.io.gltf",
}
MOTION_SUFFIXES = (".bvh", ".fbx", ".glb", ".gltf", ".vrm", ".vrma")
"""Formats that can hold animation."""
WRITTEN_SUFFIXES = (".bvh", ".glb", ".gltf", ".vrm")
"""Those of them that are written."""


def load(path: str | Path) -> Asset:
    """Read any supported file. Raises `FileError` naming the file, the place and the cure."""
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.exists():
        raise FileError(path, "no such file")
    if suffix not in READERS:
        raise FileError(path, f"unknown suffix {suffix!r}; supported: {' '.join(sorted(READERS))}")
    if not path.is_file():
        raise FileError(path, "is not a file")
    try:
        return importlib.import_module(READERS[suffix]).load(path)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    except FileError:
        raise
    except RetargetError as error:  # a noun refused what the file holds
        raise FileError(path, str(error)) from None


def save(
    path: str | Path, character: Character, motions: Sequence[Motion], *, animation_only: bool = False, **options: Any
) -> None:
    """Write a character with its motions (glTF, VRM), or one motion alone (BVH).

    The file appears whole or not at all. Raises `FileError` for a suffix that cannot hold it or a folder that cannot be
    written.
    """
    path = Path(path)
    check_output(path)
    try:
        if path.suffix.lower() == ".bvh":
            if len(motions) != 1:
                raise FileError(
                    path, f"a BVH file holds one clip, received {len(motions)}; write one file a clip, or a .glb"
                )
            importlib.import_module("retarget.io.bvh").save(path, motions[0])
        else:
            importlib.import_module("retarget.io.gltf").save(
                path, character, motions, animation_only=animation_only, **options
            )
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None


def check_output(path: str | Path, character: Character | None = None, animation_only: bool = False) -> None:
    """Refuse an output that could not be written, or could not hold the character, before any work is done. Raises
    `FileError`."""
    path = Path(path)
    if path.suffix.lower() not in WRITTEN_SUFFIXES:
        raise FileError(
            path, f"cannot write {path.suffix or 'a file without suffix'!r}; use {', '.join(WRITTEN_SUFFIXES)}"
        )
    if path.is_dir():
        raise FileError(path, "is a folder")
    if not path.parent.is_dir():
        raise FileError(path, f"the folder {path.parent} does not exist")
    if character is not None and path.suffix.lower() == ".vrm":
        importlib.import_module("retarget.io.gltf_write").check_holds(path, character, animation_only)
