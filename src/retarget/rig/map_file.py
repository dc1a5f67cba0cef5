"""Maps between surfaces that the user already has, read from files.

    one line a vertex of the mesh: the vertex of the template it corresponds to      (.txt, .csv)
    an archive with `map`: the same as integers; or `corners` and `weights`: three vertices of the template and their shares,
    a row for every vertex of the mesh                                                          (.npz)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from retarget.errors import FileError
from retarget.geometry.closest import Places
from retarget.io.npz_arrays import open_archive

Array = np.ndarray

LARGEST = 100_000_000
"""Bytes of a text file that is read as a map."""


def read_surface_map(path: Path, template_vertices: int) -> Places:
    """For every vertex of the mesh its place on the template. Raises `FileError` for what is no such map."""
    if path.suffix.lower() == ".npz":
        places = _from_archive(path)
    elif path.suffix.lower() in (".txt", ".csv"):
        places = _vertex_to_vertex(path, _lines(path))
    else:
        raise FileError(path, "a surface map is .txt or .csv (a vertex of the template on each line), or .npz")
    if places.corners.min(initial=0) < 0 or places.corners.max(initial=0) >= template_vertices:
        worst = int(places.corners.max() if places.corners.max() >= template_vertices else places.corners.min())
        raise FileError(path, f"names vertex {worst} of the template, which has {template_vertices}")
    return places


def _lines(path: Path) -> Array:
    try:
        if path.stat().st_size > LARGEST:
            raise FileError(path, f"has {path.stat().st_size} bytes; maps of up to {LARGEST} are read")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read as a map: {error}") from None
    numbers = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            numbers.append(int(line))
        except ValueError:
            raise FileError(path, f"a vertex number is expected, found {line[:40]!r}", f"line {number}") from None
    return np.array(numbers, dtype=np.int64)


def _from_archive(path: Path) -> Places:
    archive = open_archive(path)
    if "map" in archive:
        return _vertex_to_vertex(path, archive.integers("map"))
    if "corners" not in archive or "weights" not in archive:
        raise FileError(path, "holds neither 'map' nor 'corners' and 'weights'")
    corners, weights = archive.integers("corners"), archive.numbers("weights")
    if corners.ndim != 2 or corners.shape[1] != 3 or weights.shape != corners.shape:
        raise FileError(path, f"'corners' and 'weights' must be rows of three; they are {corners.shape} and {weights.shape}")
    if len(weights) and (weights.min() < -1e-6 or np.abs(weights.sum(axis=1) - 1).max() > 1e-3):
        raise FileError(path, "'weights' must not be negative, and each row must sum to one")
    return Places(corners, weights)


def _vertex_to_vertex(path: Path, vertices: Array) -> Places:
    if vertices.ndim != 1:
        raise FileError(path, f"'map' must be one number for each vertex of the mesh; it has the shape {vertices.shape}")
    return Places(np.repeat(vertices[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(vertices), 1)))
