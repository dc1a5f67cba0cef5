"""Alembic (.abc): moving surfaces, read and written by Blender in a process of its own (`alembic_child.py`).

The program that opens the meshes is Blender's importer, which takes +Y as up, as Alembic's files have it. It does not tell at
which rate the samples lie; that is read from the container itself (`ogawa.py`). The format states no unit: a file that
Blender wrote is in metres, any other in whatever its scene was. Points cross between the processes as plain floats.
"""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from retarget.character import Mesh, MeshMotion
from retarget.errors import FileError
from retarget.io.asset import Asset, Convention
from retarget.io.blender import keep, run_blender
from retarget.io.ogawa import RATES, Archive, read_archive
from retarget.io.timeline import Timeline

CHILD = Path(__file__).with_name("alembic_child.py")
LARGEST = 1 << 31
"""Bytes of vertices that are held at most."""
LARGEST_FILE = 1 << 31
"""Bytes of a file that is tried."""
LAST_FRAME = 1_048_574
"""Blender counts no further."""
CACHE = "POINTCACHE2"
"""Begins a point cache (PC2): the name, a version, points, first frame, rate and frames, then all points as floats."""


def load(path: str | Path) -> Asset:
    """Read a 'mesh sequence', or a 'mesh' where nothing is sampled more than once. All meshes become one, in the order of their
    names, placed in the world with +Y up; faces are triangles, colours and texture coordinates are left out.

    Raises `FileError` for files of other forms, faces that change, more than is kept in memory, without Blender, and where
    Blender cannot read it.
    """
    path = Path(path)
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise FileError(path, f"has {size} bytes; Alembic files of up to {LARGEST_FILE} are read")
    archive = read_archive(path)
    grid, notes = _grid(path, archive)
    with tempfile.TemporaryDirectory(prefix="retarget-") as name:
        folder = Path(name)
        files = {key: str(folder / key) for key in ("points", "faces", "reply")}
        job = {"do": "read", "file": str(path.absolute()), **files, "frames": grid.frames, "fps": grid.fps, "largest": LARGEST}
        run_blender(path, CHILD, job | {"start": grid.start * grid.fps}, folder, "read")
        told = _told(path, folder / "reply")
        vertices = np.fromfile(folder / "points", dtype=np.float32).reshape(grid.frames, told["points"], 3)
        faces = np.fromfile(folder / "faces", dtype=np.int32).reshape(-1, 3).astype(np.int64)
    by_blender = archive.metadata.get("_ai_Application") == "Blender"
    if told["meshes"] > 1:
        notes.append(f"{told['meshes']} meshes are joined into one")
    notes += [f"{each} left out: surfaces are read" for each in told["left_out"]]
    if not by_blender:
        notes.append("the file tells no unit (--unit)")
    mesh, convention = Mesh(vertices[0].astype(np.float64), faces), Convention(1.0 if by_blender else None, "+y")
    if grid.frames == 1:
        return Asset(path, "mesh", mesh=mesh, convention=convention, notes=tuple(notes))
    sequence = MeshMotion(mesh, vertices, grid.fps, told["name"] if told["meshes"] == 1 else path.stem)
    return Asset(path, "mesh sequence", sequence=sequence, convention=convention, notes=tuple(notes))


def _grid(path: Path, archive: Archive) -> tuple[Timeline, list[str]]:
    """When the file is looked at: from the first sample to the last, at the highest of its rates."""
    program = archive.metadata.get("_ai_Application") or "an unknown program"
    notes = [f"Alembic, written by {program if program.isprintable() else 'an unknown program'}"]
    grids = archive.moving()
    if not grids:
        return Timeline(0.0, 30.0, 1), notes
    rate, start = max(grid.fps for grid in grids), min(grid.start for grid in grids)
    if len({grid.fps for grid in grids}) > 1:
        notes.append(f"it is sampled at {len(grids)} rates; {rate:g} frames a second are taken")
    frames = round((max(grid.start + (grid.frames - 1) / grid.fps for grid in grids) - start) * rate) + 1
    if max(abs(start * rate), abs(start * rate + frames)) > LAST_FRAME:
        raise FileError(path, f"plays {frames} frames from {start:g} s on; frames are counted up to {LAST_FRAME}")
    return Timeline(start, rate, frames), notes


def _told(path: Path, reply: Path) -> Any:
    """What the child tells. Raises `FileError` for what it declines, and where it tells nothing."""
    try:
        found = json.loads(reply.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise FileError(path, "Blender ended without an error and without an answer") from None
    if "refused" in found:
        raise FileError(path, found["refused"])
    return found["told"]


def save(path: str | Path, motion: MeshMotion) -> None:
    """Write a mesh sequence, in metres with +Y up; the first frame is at 0 s. Colours and texture coordinates are not written.

    The file appears whole or not at all, and equal input gives equal bytes. Raises `FileError` for a mesh without faces, one
    too large to be read again, a rate that Blender has not, without Blender, and where it fails.
    """
    path = Path(path)
    if not len(motion.mesh.faces):
        raise FileError(path, "a mesh sequence without faces cannot be written as Alembic")
    if motion.vertices.nbytes > LARGEST or len(motion) > LAST_FRAME:
        raise FileError(path, f"{len(motion)} frames of {motion.vertices.shape[1]} vertices are more than an Alembic file is given here")
    if not RATES[0] <= motion.fps <= RATES[1]:
        raise FileError(path, f"{motion.fps:g} frames a second cannot be written; {RATES[0]:g} to {RATES[1]:g} can")
    with tempfile.TemporaryDirectory(prefix="retarget-") as name:
        folder = Path(name)
        files = {key: str(folder / key) for key in ("points", "faces", "cache", "reply")} | {"file": str(folder / "made.abc")}
        x, y, z = np.moveaxis(motion.vertices, -1, 0)
        places = np.stack([x, -z, y], axis=-1).astype("<f4")  # Blender's +Z is up
        places[0].tofile(files["points"])
        motion.mesh.faces.astype(np.int32).tofile(files["faces"])
        with open(files["cache"], "wb") as cache:
            cache.write(CACHE.encode().ljust(12, b"\0") + struct.pack("<iiffi", 1, places.shape[1], 0.0, 1.0, len(places)))
            places.tofile(cache)
        job = {"do": "write", **files, "frames": len(motion), "fps": motion.fps, "name": motion.name or "sequence"}
        run_blender(path, CHILD, job, folder)
        keep(path, folder / "made.abc")
