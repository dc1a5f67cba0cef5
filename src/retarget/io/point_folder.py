"""Captures as folders: one cloud, or one mesh with faces of its own, a file; no point corresponds to one of another
frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from retarget.character import Mesh, PointCloud, PointMotion
from retarget.errors import FileError, RetargetError
from retarget.geometry.sampling import sample_surface
from retarget.io import npz_clouds, obj_ply, pcd
from retarget.io.asset import Asset
from retarget.io.npz_arrays import open_archive
from retarget.io.pcd import write_pcd
from retarget.io.ply import write_points
from retarget.io.whole_file import folder_written_whole

Array = np.ndarray

FRAMES = (".obj", ".ply", ".pcd", ".npz")
"""What frames are read from."""
WRITTEN = (".ply", ".pcd")
FPS = 30.0
"""Frames a second of a folder: it says nothing of its own."""
SAMPLES = 8192
"""Points that are taken of a frame with faces."""
MOST_POINTS = 100_000
"""Points of a frame that are kept; of larger clouds a random part of so many."""
LARGEST = 1 << 31
"""Bytes that are held at most."""


def frame_files(folder: Path) -> list[Path]:
    """The files of a folder that are its frames, in no order: told by the suffix, archives by their arrays. An archive
    that cannot be opened is a frame only among others."""
    found, closed = [], []
    for file in possible_frames(folder):
        held = is_frame(file)
        if held or held is None:
            (closed if held is None else found).append(file)
    return [*found, *closed] if found else []


def possible_frames(folder: Path) -> list[Path]:
    """The files of a folder that can be frames by their suffix, in no order, without a look inside."""
    shown = (file for file in folder.iterdir() if not file.name.startswith("."))
    return [file for file in shown if file.suffix.lower() in FRAMES and file.is_file()]


def is_frame(file: Path) -> bool | None:
    """Whether one of them is a frame; None for an archive that cannot be opened."""
    if file.suffix.lower() != ".npz":
        return True
    try:
        return npz_clouds.is_frame(open_archive(file))
    except FileError:
        return None


def read_frame(file: Path) -> Mesh | PointCloud:
    """A mesh, or a cloud that may have no points. Raises `RetargetError` for a file that cannot be read."""
    suffix = file.suffix.lower()
    if suffix == ".npz":
        return npz_clouds.frame(file)
    asset = pcd.load(file, empty=True) if suffix == ".pcd" else obj_ply.load(file, empty=True)
    return asset.points if asset.mesh is None else asset.mesh


def load(path: Path, files: Sequence[Path]) -> Asset:
    """Read frames in the order given as one 'point sequence'.

    Surfaces become `SAMPLES` points each, evenly by area. A file that cannot be read, and one without a finite point,
    is a frame without points; notes name both. Raises `FileError` where more than half cannot be read, where no frame
    has a point, and for more than fits into memory.
    """
    clouds: list[Array] = []
    faults: dict[Path, RetargetError] = {}
    empty, sampled, thinned, held = [], 0, 0, 0
    for number, file in enumerate(files):
        try:
            surface = read_frame(file)
            cloud = _points(surface, number)
        except RetargetError as error:
            faults[file], surface, cloud = error, None, np.zeros((0, 3), dtype=np.float32)
        sampled += isinstance(surface, Mesh)
        thinned += isinstance(surface, PointCloud) and len(surface.points) > MOST_POINTS
        if surface is not None and not len(cloud):
            empty.append(file)
        held += cloud.nbytes
        if held > LARGEST:
            raise FileError(path, f"holds more than {LARGEST} bytes of points, more than is kept in memory at once")
        clouds.append(cloud)
    expect_most(path, len(files), faults)
    if not held:
        raise FileError(path, f"none of its {len(files)} frames has a point")
    notes = [f"{len(files)} files taken as frames at {FPS:g} a second, which a folder does not tell (--fps)"]
    if sampled:
        notes.append(f"of {sampled} frames with faces {SAMPLES} points each were taken, evenly by area")
    if thinned:
        notes.append(f"of {thinned} frames with more points {MOST_POINTS} were kept, at random")
    if empty:
        notes.append(f"{len(empty)} of {len(files)} frames are empty ({_listed([file.name for file in empty])})")
    notes += told_faults(faults, len(files), "stand as empty frames")
    return Asset(path, "point sequence", clouds=PointMotion(tuple(clouds), FPS, path.name), notes=tuple(notes))


def expect_most(path: Path, frames: int, faults: dict[Path, RetargetError]) -> None:
    """Raise `FileError` where more than half of a folder's frames cannot be read."""
    if 2 * len(faults) > frames:
        first = next(iter(faults.values()))
        raise FileError(path, f"{len(faults)} of its {frames} files cannot be read as frames; of the first: {first}")


def told_faults(faults: dict[Path, RetargetError], frames: int, what: str) -> list[str]:
    """A note on files that cannot be read, naming the first of them with their faults."""
    told = [f"{file.name}: {getattr(error, 'problem', error)}" for file, error in faults.items()]
    return [f"{len(told)} of {frames} files cannot be read and {what} ({_listed(told, 3)})"] if told else []


def save(path: str | Path, motion: PointMotion, suffix: str = ".ply") -> None:
    """Write a folder with one binary PLY or PCD file a frame, named by number, single precision; it appears whole or
    not at all.

    Raises `FileError` for another suffix, where there is such a folder or file already, and where it cannot be written.
    """
    if suffix not in WRITTEN:
        raise FileError(path, f"clouds are written as {' or '.join(WRITTEN)}, not as {suffix!r}")
    write = write_points if suffix == ".ply" else write_pcd
    digits = max(4, len(str(len(motion) - 1)))
    with folder_written_whole(path) as folder:
        for number, cloud in enumerate(motion.clouds):
            with open(folder / f"{number:0{digits}d}{suffix}", "wb") as file:
                write(file, cloud)


def _points(surface: Mesh | PointCloud, number: int) -> Float32[Array, "points 3"]:
    if isinstance(surface, Mesh):
        return sample_surface(surface.vertices, surface.faces, SAMPLES, number).astype(np.float32)
    points = surface.points.astype(np.float32)
    if len(points) <= MOST_POINTS:
        return points
    chosen = np.random.default_rng(number).choice(len(points), MOST_POINTS, replace=False)
    return points[np.sort(chosen)]


def _listed(names: list[str], most: int = 8) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")
