"""USD (.usd, .usda, .usdc, .usdz), read by usd-core in a process of its own and taken as the glTF it would be.

usd-core is the optional extra `usd`. It is a large native parser, and fetches by itself what a file refers to; so
`usd_child.py` runs under limits of memory and time, opens nothing outside the file's folder, and writes a GLB. From
there on one reader interprets bind poses, scales, clips and weights. What is written is the stage that was read, with
the new animation in it, or a new one (`usd_write.py`).
"""

from __future__ import annotations

import importlib.util
import tempfile
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from retarget.character import MeshMotion
from retarget.errors import FileError
from retarget.io import gltf
from retarget.io.asset import Asset, Convention
from retarget.io.child import ChildError, ChildFailed, run_child
from retarget.io.gltf_document import read_document
from retarget.io.gltf_nodes import GltfOrigin

SECONDS = 120.0
"""How long reading may take."""
LARGEST = 1 << 30
"""Bytes of a file that is tried."""


@dataclass(frozen=True, eq=False)
class UsdOrigin(GltfOrigin):
    """What a character remembers of the USD file it came from: the glTF it was taken as, and the stage itself."""

    source: Path
    stamp: tuple[int, int]
    """Size and time of the last change of the source, when it was read."""
    skeleton_path: str
    """The skeleton's prim."""
    tokens: dict[int, str]
    """The joint (as USD names it) behind each node of the document; other nodes are prims."""


def load(path: str | Path) -> Asset:
    """Read a USD file: the skeleton that moves most, its meshes with base colours, its animations by name.

    Units and axes are the file's own, brought to metres with +Y up; a file that states no unit is in centimetres, as
    the format says. Blend shapes and meshes that no skeleton moves are left out, with a note; in a stage without skeleton
    they are one mesh, and a 'mesh sequence' where their points or places are sampled over time. Raises `FileError` for
    what cannot be read, is too large, takes too long, or refers to layers outside its folder.
    """
    path = Path(path)
    require_usd(path)
    state = path.stat()
    if state.st_size > LARGEST:
        raise FileError(path, f"has {state.st_size} bytes; USD files of up to {LARGEST} are read")
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        output = Path(folder) / "converted.glb"
        try:
            told = run_child("usd_child", [path.absolute(), output], SECONDS)
        except ChildFailed as failure:
            raise FileError(path, f"cannot be read as USD ({failure}); export it again, or as GLB") from None
        except ChildError as error:
            raise FileError(path, str(error)) from None
        document = replace(read_document(output), path=path)
        asset = gltf.from_document(document)
        if told.get("sequence"):
            asset = _moving(asset, Path(f"{output}.points"), told["sequence"])
    if asset.character is not None:
        known = {each.name: getattr(asset.character.origin, each.name) for each in fields(GltfOrigin)}
        tokens = {int(node): token for node, token in told["joints"].items()}
        stamp = (state.st_size, state.st_mtime_ns)
        origin = UsdOrigin(**known, source=path.absolute(), stamp=stamp, skeleton_path=told["skeleton"], tokens=tokens)
        asset = replace(asset, character=replace(asset.character, origin=origin))
    stated = "" if told["unit_stated"] else " (it states none)"
    said = f"USD, {told['unit_m']:g} m a unit{stated}, up {told['up']}, {told['rate']:g} time codes a second"
    convention = Convention(1.0 if told["unit_stated"] else None, "+y")
    plays = 0 if asset.clips and told.get("bound") == asset.clips[0].name else None
    beside = tuple(map(Path, told["beside"]))
    return replace(asset, convention=convention, beside=beside, plays=plays, notes=(said, *told["notes"], *asset.notes))


def _moving(asset: Asset, points: Path, held: dict[str, Any]) -> Asset:
    """The mesh sequence of a stage whose meshes move without a skeleton."""
    vertices = np.fromfile(points, dtype=np.float32).reshape(held["frames"], held["points"], 3)
    notes = [f"{held['meshes']} meshes are joined into one"] if held["meshes"] > 1 else []
    mesh = replace(asset.mesh, vertices=vertices[0].astype(np.float64))
    sequence = MeshMotion(mesh, vertices, held["fps"], held["name"])
    return replace(asset, kind="mesh sequence", mesh=None, sequence=sequence, notes=(*notes, *asset.notes))


def save(path: str | Path, *arguments: Any, **options: Any) -> None:
    """Write a character with its motions; see `usd_write.save`."""
    from retarget.io import usd_write

    usd_write.save(path, *arguments, **options)


def require_usd(path: Path) -> None:
    """Raises `FileError` where usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise FileError(path, "USD needs the package usd-core: pip install retarget[usd]")
