"""FBX, read by ufbx in a process of its own and taken as the glTF it would be.

The binding of ufbx can take the whole process down with it, and FBX files come from everywhere: `fbx_child.py` runs under
limits of memory and time (`child.py`), writes a GLB, and what it cannot read is one line here. From there on the file is a
glTF document: one reader interprets bind poses, scales, clips and weights, and a result is written as GLB with the character
as it was.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from retarget.errors import FileError
from retarget.io import gltf
from retarget.io.asset import Asset
from retarget.io.child import ChildError, ChildFailed, run_child
from retarget.io.gltf_document import read_document

SECONDS = 120.0
"""How long reading may take."""
LARGEST = 1 << 30
"""Bytes of a file that is tried."""


def load(path: str | Path) -> Asset:
    """Read an .fbx file, ASCII or binary: meshes with base colours and their pictures, skeleton, skin, blend shapes, and every
    animation stack by its name, sampled at the file's frame rate. Units and axes are the file's own, brought to metres with +Y up; other textures than
    base colours and normal maps, and cameras, are left out. Raises `FileError` for what cannot be read, is too large, or takes too long."""
    path = Path(path)
    size = path.stat().st_size
    if size > LARGEST:
        raise FileError(path, f"has {size} bytes; FBX files of up to {LARGEST} are read")
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        output = Path(folder) / "converted.glb"
        told = _convert(path, output)
        document = replace(read_document(output), path=path)
    asset = gltf.from_document(document)
    up = "" if told["up"].lower() == "unknown" else f"up {told['up'].lower()}, "
    said = f"FBX {told['version'] / 1000:g}, {told['unit_m']:g} m a unit, {up}{told['fps']:g} frames a second"
    beside = tuple(map(Path, told["beside"]))
    return replace(asset, beside=beside, notes=(said, *told["notes"], *asset.notes))


def _convert(path: Path, output: Path) -> dict[str, Any]:
    """Run the child; returns what it says of the file."""
    try:
        return run_child("fbx_child", [path.absolute(), output], SECONDS)
    except ChildFailed as error:
        problem = f"cannot be read as FBX ({error}); export it again, as binary FBX 7.4 or as GLB"
        if "No module named 'ufbx'" in str(error):
            problem = "needs the package ufbx to be read: pip install ufbx==0.0.5"
    except ChildError as error:
        problem = str(error)
    raise FileError(path, problem)
