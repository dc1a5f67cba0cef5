"""Maps between surfaces that the user already has, read from files.

    one line a vertex of the mesh: the vertex of the template it corresponds to      (.txt, .csv)
    an archive with `map`: the same as integers; or `corners` and `weights`: three vertices of the template and their shares,
    a row for every vertex of the mesh; or a functional map with the bases that it is between         (.npz)

A functional map is the matrix `C` (functions of the mesh x functions of the template) that takes coefficients of a function
on the template to those of the same function on the mesh: pyFM's `FM` with the template as its first mesh, Musoni's
C = pinv(Phi_mesh) Pi Phi_template, whose points run the other way, from the mesh to the template. Eigenfunctions are defined
up to sign and, where eigenvalues repeat, up to a rotation, so C says nothing without its own: `mesh_basis` and
`template_basis` hold them, a row for every vertex, a column for every function, in the order of C.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from retarget.correspond.functional_map import point_map
from retarget.errors import FileError
from retarget.geometry.closest import Places
from retarget.io.npz_arrays import Archive, open_archive

Array = np.ndarray

LARGEST = 100_000_000
"""Bytes of a text file that is read as a map."""
MOST_FUNCTIONS = 1000
"""Functions of a functional map."""
MOST_LOST = 0.7
"""Share of a functional map (Frobenius) that may be missing in the one that the points read from it give: true maps of 20 to
100 functions lose .1 to .25, of dressed bodies up to .6; wrong signs, exchanged bases and other matrices .8 and more, only
transposed maps of 20 functions less."""


def read_surface_map(path: Path, template_vertices: int) -> Places:
    """For every vertex of the mesh its place on the template. Raises `FileError` for what is no such map."""
    if path.suffix.lower() == ".npz":
        places = _from_archive(path, template_vertices)
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


def _from_archive(path: Path, template_vertices: int) -> Places:
    archive = open_archive(path)
    if "map" in archive:
        return _vertex_to_vertex(path, archive.integers("map"))
    if "C" in archive:
        return _vertex_to_vertex(path, _by_functions(archive, template_vertices))
    if "corners" not in archive or "weights" not in archive:
        raise FileError(path, "holds neither 'map', nor 'corners' and 'weights', nor 'C' with its bases")
    corners, weights = archive.integers("corners"), archive.numbers("weights")
    if corners.ndim != 2 or corners.shape[1] != 3 or weights.shape != corners.shape:
        raise FileError(
            path, f"'corners' and 'weights' must be rows of three; they are {corners.shape} and {weights.shape}"
        )
    if len(weights) and (weights.min() < -1e-6 or np.abs(weights.sum(axis=1) - 1).max() > 1e-3):
        raise FileError(path, "'weights' must not be negative, and each row must sum to one")
    return Places(corners, weights)


def _by_functions(archive: Archive, template_vertices: int) -> Array:
    """The vertices of the template that a functional map takes those of the mesh to: nearest in the span of its functions.

    Raises `FileError` for a matrix without bases, bases that are not its own, and a matrix that is no map between them: one
    that points read from it do not give back.
    """
    path, bases = archive.path, ("mesh_basis", "template_basis")
    for name in bases:
        if name not in archive:
            raise FileError(path, f"'C' means nothing without the eigenfunctions it is between; {name!r} is missing")
    shapes = {name: archive.shape(name) for name in ("C", *bases)}
    for name, shape in shapes.items():
        if len(shape) != 2 or min(shape) < 1:
            raise FileError(path, f"{name!r} must have rows and columns; its shape is {shape}")
    (rows, columns), mesh, template = shapes["C"], *(shapes[name] for name in bases)
    if rows > mesh[1] or columns > template[1]:
        raise FileError(
            path,
            f"'C' ({rows} x {columns}) takes the template's functions to the mesh's; 'mesh_basis' has {mesh[1]} columns and "
            f"'template_basis' {template[1]}",
        )
    for name, (vertices, functions) in zip(bases, (mesh, template)):
        if vertices < functions:
            raise FileError(
                path, f"{name!r} must have a row for every vertex; it has {vertices} rows and {functions} columns"
            )
    if template[0] != template_vertices:
        raise FileError(path, f"'template_basis' has {template[0]} rows; the template has {template_vertices} vertices")
    if max(rows, columns) > MOST_FUNCTIONS:
        raise FileError(path, f"'C' is {rows} x {columns}; maps of up to {MOST_FUNCTIONS} functions are read")
    C = archive.numbers("C")
    phi_mesh, phi_template = archive.numbers(bases[0])[:, :rows], archive.numbers(bases[1])[:, :columns]
    found = point_map(C, phi_template, phi_mesh)
    again = np.linalg.lstsq(phi_mesh, phi_template[found], rcond=None)[0]
    lost = float(np.linalg.norm(again - C)) / max(float(np.linalg.norm(C)), 1e-300)
    if lost > MOST_LOST:
        raise FileError(
            path,
            f"'C' is no map between its bases: points read from it give back {max(0.0, 1.0 - lost):.0%} of it. Its rows are the "
            "mesh's functions, its columns the template's, in the order and with the signs of the bases",
        )
    return found


def _vertex_to_vertex(path: Path, vertices: Array) -> Places:
    if vertices.ndim != 1:
        raise FileError(
            path, f"'map' must be one number for each vertex of the mesh; it has the shape {vertices.shape}"
        )
    return Places(np.repeat(vertices[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(vertices), 1)))
