"""Point clouds as .npz archives.

A capture is `points` (all points of all frames, 3) with `counts` (points of each frame), or `points` (frames, points,
3), and `fps`; one cloud is `points` (points, 3).

Points that are not finite are left out. A frame may have none.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from retarget.character import Mesh, PointCloud, PointMotion
from retarget.errors import FileError
from retarget.io.asset import Asset
from retarget.io.npz_arrays import MOST_VALUES, Archive, open_archive
from retarget.io.npz_sequence import STAMP, rate_of
from retarget.io.whole_file import written_whole

Array = np.ndarray


def load(archive: Archive) -> Asset:
    """Read a capture, or one cloud. Raises `FileError` for arrays of other shapes, counts that do not fit their points,
    a rate that is none, and where no point is finite."""
    shape = archive.shape("points")
    if "counts" not in archive and len(shape) == 2:
        cloud, notes = _cloud(archive)
        if not len(cloud.points):
            raise archive.fail("points", f"none of its {shape[0]} points is finite")
        return Asset(archive.path, "points", points=cloud, notes=notes)
    if shape[-1:] != (3,) or len(shape) != (2 if "counts" in archive else 3):
        wanted = "(points, 3) beside counts, or (frames, points, 3)"
        raise archive.fail("points", f"must have the shape {wanted}, received {shape}")
    if "counts" in archive:
        counts = archive.integers("counts")
        if (
            counts.ndim != 1
            or not len(counts)
            or counts.min() < 0
            or counts.max() > shape[0]
            or counts.sum() != shape[0]
        ):
            raise archive.fail("counts", f"must say how many of the {shape[0]} points belong to each frame")
    else:
        counts = np.full(shape[0], shape[1])
    points = archive.numbers("points", holes=True).astype(np.float32).reshape(-1, 3)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise archive.fail("points", f"none of its {len(points)} points is finite")
    clouds = [
        cloud[seen] for cloud, seen in zip(*(np.split(each, np.cumsum(counts)[:-1]) for each in (points, finite)))
    ]
    fps, notes = rate_of(archive)
    if lost := int((~finite).sum()):
        notes.append(f"{lost} points that are not finite were left out")
    if none := sum(not len(cloud) for cloud in clouds):
        notes.append(f"{none} of {len(clouds)} frames are empty")
    capture = PointMotion(tuple(clouds), fps, archive.path.stem)
    return Asset(archive.path, "point sequence", clouds=capture, notes=tuple(notes))


def frame(path: Path) -> Mesh | PointCloud:
    """One frame of a folder: `points` (points, 3), or `vertices` (vertices, 3) with `faces`. Raises `FileError`."""
    archive = open_archive(path)
    if not is_frame(archive):
        raise FileError(
            path, "is no frame: it needs points (points, 3), or vertices (vertices, 3) with faces (faces, 3)"
        )
    if "points" in archive:
        return _cloud(archive)[0]
    faces = archive.integers("faces")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise archive.fail("faces", f"must have the shape (faces, 3), received {faces.shape}")
    return Mesh(archive.numbers("vertices"), faces)


def is_frame(archive: Archive) -> bool:
    """Whether an archive holds one frame of a folder, told by its arrays."""
    held = "points" if "points" in archive else "vertices" if "faces" in archive and "vertices" in archive else ""
    return (
        bool(held)
        and "counts" not in archive
        and len(archive.entries[held].shape) == 2
        and archive.entries[held].shape[1] == 3
    )


def _cloud(archive: Archive) -> tuple[PointCloud, tuple[str, ...]]:
    points = archive.numbers("points", holes=True)
    if points.ndim != 2 or points.shape[1] != 3:
        raise archive.fail("points", f"must have the shape (points, 3), received {points.shape}")
    finite = np.isfinite(points).all(axis=1)
    lost = int((~finite).sum())
    return PointCloud(points[finite]), (f"{lost} points that are not finite were left out",) if lost else ()


def save(path: str | Path, motion: PointMotion) -> None:
    """Write a capture, single precision; equal input gives equal bytes. The file appears whole or not at all. Raises
    `FileError` for more points than archives are read with, and where it cannot be written."""
    counts = np.array([len(cloud) for cloud in motion.clouds], dtype=np.int32)
    if 3 * int(counts.sum()) > MOST_VALUES:
        raise FileError(
            path, f"{counts.sum()} points are more than an archive holds ({MOST_VALUES // 3}); write a folder"
        )
    arrays = {"points": np.concatenate(motion.clouds), "counts": counts, "fps": np.array(motion.fps)}
    with written_whole(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(array), allow_pickle=False)
            member = zipfile.ZipInfo(f"{name}.npy", STAMP)
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, content.getvalue())
