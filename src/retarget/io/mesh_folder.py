"""Mesh sequences as folders: one OBJ or PLY file a frame, all with the same faces. Folders of other frames are
captures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from retarget.character import Mesh, MeshMotion
from retarget.errors import FileError, RetargetError
from retarget.geometry.bridging import bridged
from retarget.io import MOTION_SUFFIXES, obj_ply, point_folder
from retarget.io.asset import Asset
from retarget.io.point_folder import FPS, FRAMES
from retarget.io.whole_file import folder_written_whole

WRITTEN = (".obj", ".ply")
LARGEST = 1 << 31
"""Bytes of vertices that are held at most."""


def load(path: str | Path) -> Asset:
    """Read a folder of OBJ, PLY, PCD or NPZ files, in natural order (frame_2 before frame_10): as one 'mesh sequence'
    where all frames share one set of faces, else as a 'point sequence' (`point_folder`).

    Files that cannot be read are bridged, and told in the notes. Raises `FileError` for a folder without such files,
    where more than half of them cannot be read, and for more than fits into memory.
    """
    path = Path(path)
    files = sorted(point_folder.frame_files(path), key=lambda file: natural(file.name))
    if not files:
        archives = len(point_folder.possible_frames(path))
        why = f"; none of its {archives} archives can be read as a frame" if archives else ""
        raise FileError(path, f"the folder holds no frames ({', '.join(FRAMES)}){why}")
    first, faults, places = None, {}, np.zeros(0)
    for number, file in enumerate(files):
        try:
            mesh = point_folder.read_frame(file)
        except RetargetError as error:
            faults[file] = error
            continue
        if not isinstance(mesh, Mesh) or first is not None and not _alike(mesh, first):
            return point_folder.load(path, files)
        if first is None:
            first, vertices = mesh, len(mesh.vertices)
            if 12 * vertices * len(files) > LARGEST:
                raise FileError(
                    path, f"holds {len(files)} frames of {vertices} vertices, more than is kept in memory at once"
                )
            places = np.full((len(files), vertices, 3), np.nan, dtype=np.float32)
        places[number] = mesh.vertices
    point_folder.expect_most(path, len(files), faults)
    places, _ = bridged(places)
    note = f"{len(files)} files taken as frames at {FPS:g} a second, which a folder does not tell (--fps)"
    notes = (note, *point_folder.told_faults(faults, len(files), "are bridged from those beside them"))
    moving = MeshMotion(replace(first, vertices=places[0].astype(np.float64)), places, FPS, path.name)
    return Asset(path, "mesh sequence", sequence=moving, notes=notes)


def _alike(mesh: Mesh, first: Mesh) -> bool:
    return len(mesh.vertices) == len(first.vertices) and np.array_equal(mesh.faces, first.faces)


def holds_frames(path: Path) -> bool:
    """Whether a folder holds the frames of a sequence, of meshes or of points."""
    return bool(point_folder.frame_files(path))


def is_one_motion(path: Path) -> bool:
    """Whether a folder as a whole is a motion: it holds frames, and no file that is a motion of its own."""
    own = [file for file in path.iterdir() if file.suffix.lower() in MOTION_SUFFIXES and not file.name.startswith(".")]
    archives = [file for file in own if file.suffix.lower() == ".npz"]
    if len(archives) < len(own) or any(point_folder.is_frame(file) is False for file in archives):
        return False
    return holds_frames(path)


def expect_no_frames(path: Path) -> None:
    """Raises `FileError` for a folder of frames where motions of joints are looked for, saying what can be done with
    it."""
    if holds_frames(path):
        cure = "as a mesh sequence or capture `retarget run` takes it, `info` and `picture` show it, "
        cure += "`convert` writes it in other formats"
        raise FileError(path, f"the folder holds frames ({', '.join(FRAMES)}) and no motion of joints; {cure}")


def save(path: str | Path, motion: MeshMotion, suffix: str = ".ply") -> None:
    """Write a folder with one file a frame, named by number. The folder appears whole or not at all.

    Raises `FileError` for a suffix that is neither .obj nor .ply, where there is such a folder or file already, and
    where it cannot be written.
    """
    path = Path(path)
    if suffix not in WRITTEN:
        raise FileError(path, f"frames are written as .obj or .ply, not as {suffix!r}")
    digits = max(4, len(str(len(motion) - 1)))
    with folder_written_whole(path) as folder:
        for number in range(len(motion)):
            frame = replace(motion.mesh, vertices=motion.vertices[number].astype(np.float64))
            obj_ply.save(folder / f"{number:0{digits}d}{suffix}", frame)


def natural(name: str) -> list[tuple[int, int | str]]:
    """A key that sorts names as people count: numbers by value, text by letters."""
    return [(0, int(part)) if part.isdigit() else (1, part.lower()) for part in re.split(r"([0-9]+)", name) if part]
