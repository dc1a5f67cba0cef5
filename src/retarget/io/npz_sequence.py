"""Mesh sequences as .npz archives: `vertices` (frames, vertices, 3), `faces` (faces, 3) and, where known, `fps`."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from retarget.character import Mesh, MeshMotion
from retarget.errors import FileError, RetargetError
from retarget.geometry.bridging import bridged
from retarget.io.asset import Asset
from retarget.io.npz_arrays import Archive
from retarget.io.whole_file import written_whole

FPS = 30.0
"""Frames a second of an archive that does not say."""
STAMP = (1980, 1, 1, 0, 0, 0)
"""Time of every member: equal input gives equal files."""


def load(archive: Archive) -> Asset:
    """Read a mesh sequence; frames that are not finite are bridged, and told in the notes. Raises `FileError` where none is
    finite, for arrays of other shapes, faces that name vertices which do not exist, and a
    rate that is none."""
    shape, faces = archive.shape("vertices"), archive.shape("faces")
    if len(shape) != 3 or shape[2] != 3 or not shape[0]:
        raise archive.fail("vertices", f"must have the shape (frames, vertices, 3), received {shape}")
    if len(faces) != 2 or faces[1] != 3:
        raise archive.fail("faces", f"must have the shape (faces, 3), received {faces}")
    corners = archive.integers("faces")
    if corners.size and not 0 <= corners.min() <= corners.max() < shape[1]:
        raise archive.fail("faces", f"names vertices from {corners.min()} to {corners.max()}; there are {shape[1]}")
    fps, notes = rate_of(archive)
    try:
        places, missing = bridged(archive.numbers("vertices", holes=True))
    except RetargetError as error:
        raise error if isinstance(error, FileError) else archive.fail("vertices", str(error)) from None
    if len(missing):
        listed = ", ".join(map(str, missing[:8].tolist())) + (", ..." if len(missing) > 8 else "")
        notes.append(f"{len(missing)} of {shape[0]} frames are not finite ({listed}); they are bridged from those beside them")
    name = archive.path.stem
    sequence = MeshMotion(Mesh(places[0], corners), places.astype(np.float32), fps, name)
    return Asset(archive.path, "mesh sequence", sequence=sequence, notes=tuple(notes))


def rate_of(archive: Archive) -> tuple[float, list[str]]:
    """Frames a second that an archive states, and a note where it does not. Raises `FileError` for a rate that is
    none."""
    if "fps" not in archive:
        return FPS, [f"the archive states no frame rate; {FPS:g} a second is taken"]
    rate = archive.numbers("fps")
    if rate.size != 1 or not rate.item() > 0:
        raise archive.fail("fps", "must be one positive number")
    return float(rate.item()), []


def save(path: str | Path, motion: MeshMotion) -> None:
    """Write a mesh sequence; the file appears whole or not at all. Raises `FileError` where it cannot be written."""
    arrays = {"vertices": motion.vertices, "faces": motion.mesh.faces.astype(np.int32), "fps": np.array(motion.fps)}
    with written_whole(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(array), allow_pickle=False)
            member = zipfile.ZipInfo(f"{name}.npy", STAMP)
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, content.getvalue())
