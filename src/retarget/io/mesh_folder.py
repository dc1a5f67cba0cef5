"""Mesh sequences as folders: one OBJ or PLY file a frame, all with the same faces."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from retarget.character import MeshMotion
from retarget.errors import FileError
from retarget.io import obj_ply
from retarget.io.asset import Asset

FRAMES = {".obj", ".ply"}
FPS = 30.0
"""Frames a second of a folder: it says nothing of its own."""
LARGEST = 1 << 31
"""Bytes of vertices that are held at most."""


def load(path: str | Path) -> Asset:
    """Read a folder of OBJ or PLY files as one 'mesh sequence', in natural order (frame_2 before frame_10).

    Raises `FileError` for a folder without such files, frames that have no faces or other faces than the first, and more
    than fits into memory.
    """
    path = Path(path)
    files = sorted((file for file in path.iterdir() if _is_frame(file)), key=lambda file: natural(file.name))
    if not files:
        raise FileError(path, "the folder holds no .obj or .ply files")
    first = _frame(files[0])
    vertices = len(first.vertices)
    if 12 * vertices * len(files) > LARGEST:
        raise FileError(path, f"holds {len(files)} frames of {vertices} vertices, more than is kept in memory at once")
    places = np.empty((len(files), vertices, 3), dtype=np.float32)
    places[0] = first.vertices
    for number, file in enumerate(files[1:], start=1):
        mesh = _frame(file)
        if len(mesh.vertices) != vertices or not np.array_equal(mesh.faces, first.faces):
            raise FileError(
                file, f"has other faces than {files[0].name}: the frames of a mesh sequence are one mesh; scans are not read yet"
            )
        places[number] = mesh.vertices
    note = f"{len(files)} files taken as frames at {FPS:g} a second, which a folder does not tell (--fps)"
    return Asset(path, "mesh sequence", sequence=MeshMotion(first, places, FPS, path.name), notes=(note,))


def holds_frames(path: Path) -> bool:
    """Whether a folder holds the frames of a mesh sequence."""
    return any(map(_is_frame, path.iterdir()))


def expect_no_frames(path: Path) -> None:
    """Raises `FileError` for a folder of frames where motions of joints are looked for, saying what can be done with it."""
    if holds_frames(path):
        cure = "as a mesh sequence `retarget run` takes it, `info` and `picture` show it, `convert` writes it in other formats"
        raise FileError(path, f"the folder holds .obj or .ply files and no motion of joints; {cure}")


def save(path: str | Path, motion: MeshMotion, suffix: str = ".ply") -> None:
    """Write a folder with one file a frame, named by number. The folder appears whole or not at all.

    Raises `FileError` for a suffix that is neither .obj nor .ply, where there is such a folder or file already, and where it
    cannot be written.
    """
    path = Path(path)
    if suffix not in FRAMES:
        raise FileError(path, f"frames are written as .obj or .ply, not as {suffix!r}")
    if path.exists():
        raise FileError(path, "is there already; frames of two sequences in one folder would be mixed")
    if not path.parent.is_dir():
        raise FileError(path, f"the folder {path.parent} does not exist")
    digits = max(4, len(str(len(motion) - 1)))
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent))
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    try:
        for number in range(len(motion)):
            frame = replace(motion.mesh, vertices=motion.vertices[number].astype(np.float64))
            obj_ply.save(made / f"{number:0{digits}d}{suffix}", frame)
        made.chmod(0o755)
        os.rename(made, path)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def natural(name: str) -> list[tuple[int, int | str]]:
    """A key that sorts names as people count: numbers by value, text by letters."""
    return [(0, int(part)) if part.isdigit() else (1, part.lower()) for part in re.split(r"([0-9]+)", name) if part]


def _is_frame(file: Path) -> bool:
    return file.suffix.lower() in FRAMES and file.is_file() and not file.name.startswith(".")


def _frame(file: Path):
    mesh = obj_ply.load(file).mesh
    if mesh is None:
        raise FileError(file, "has no faces; the frames of a mesh sequence are meshes, scans are not read yet")
    return mesh
