"""One file per format, chosen by suffix. `load` reads anything; writers are chosen by the suffix of the output."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from retarget.character import Character, MeshMotion, Motion, PointMotion
from retarget.errors import FileError, RetargetError
from retarget.io.asset import Asset
from retarget.io.whole_file import check_folder, check_new_folder

# Module that reads each suffix; imported only when a file of that kind is met.
READERS = {
    ".abc": "retarget.io.alembic",
    ".bvh": "retarget.io.bvh",
    ".fbx": "retarget.io.fbx",
    ".glb": "retarget.io.gltf",
    ".gltf": "retarget.io.gltf",
    ".npz": "retarget.io.npz",
    ".obj": "retarget.io.obj_ply",
    ".pcd": "retarget.io.pcd",
    ".ply": "retarget.io.obj_ply",
    ".usd": "retarget.io.usd",
    ".usda": "retarget.io.usd",
    ".usdc": "retarget.io.usd",
    ".usdz": "retarget.io.usd",
    ".vrm": "retarget.io.gltf",
    ".vrma": "retarget.io.gltf",
}
MOTION_SUFFIXES = (".bvh", ".fbx", ".glb", ".gltf", ".npz", ".usd", ".usda", ".usdc", ".usdz", ".vrm", ".vrma")
"""Formats that can hold animation."""
WRITERS = {
    ".bvh": "retarget.io.bvh",
    ".glb": "retarget.io.gltf",
    ".gltf": "retarget.io.gltf",
    ".vrm": "retarget.io.gltf",
    ".usd": "retarget.io.usd",
    ".usda": "retarget.io.usd",
    ".usdc": "retarget.io.usd",
    ".usdz": "retarget.io.usd",
    ".fbx": "retarget.io.blender",
    ".abc": "retarget.io.blender",
}
"""Module that writes each suffix."""
WRITTEN_SUFFIXES = tuple(WRITERS)
THROUGH_BLENDER = (".fbx", ".abc")
"""Those that Blender writes, where there is one."""
ONE_CLIP = (".bvh", ".abc")
"""Those that hold one clip."""
DROPPING_CLIPS = (".glb", ".gltf", ".vrm", ".usd", ".usda", ".usdc", ".usdz")
"""Those whose writers keep the file that a character came from, unless `keep_clips=False` leaves out the clips it had."""


def load(path: str | Path, *, smpl_model: str | Path | None = None) -> Asset:
    """Read any supported file. Raises `FileError` naming the file, the place and the cure, one that does not fit into the memory too.

    `smpl_model` is the body that performs an SMPL-family motion (.npz): the user's own model file.
    """
    path = Path(path)
    try:
        return _read(path, smpl_model)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise FileError(path, "needs more memory than there is") from None
    except FileError:
        raise
    except RetargetError as error:  # a noun refused what the file holds
        raise FileError(path, str(error)) from None


def _read(path: Path, smpl_model: str | Path | None) -> Asset:
    suffix = path.suffix.lower()
    if not path.exists():
        raise FileError(path, "no such file")
    if smpl_model is not None and suffix != ".npz":
        raise FileError(path, "an SMPL model is given for motions in .npz only")
    if path.is_dir():
        return importlib.import_module("retarget.io.mesh_folder").load(path)
    if suffix in (".pkl", ".pickle"):
        raise FileError(path, "pickles are not read, since they run code; save what it holds as .npz (numpy.savez)")
    if suffix not in READERS:
        raise FileError(path, f"unknown suffix {suffix!r}; supported: {' '.join(sorted(READERS))}")
    if not path.is_file():
        raise FileError(path, "is not a file")
    options = {} if smpl_model is None else {"smpl_model": smpl_model}
    return importlib.import_module(READERS[suffix]).load(path, **options)


def save(
    path: str | Path, character: Character, motions: Sequence[Motion], *, animation_only: bool = False, **options: Any
) -> None:
    """Write a character with its motions (glTF, VRM, USD, FBX), one motion alone (BVH), or the surface that it moves (Alembic).
    `options` are the writer's own: see `save` of the modules in `WRITERS`.

    The file appears whole or not at all. Raises `FileError` for a suffix that cannot hold it, for a folder that cannot be
    written, and where a program that the writer needs is not there.
    """
    path = Path(path)
    check_output(path)
    suffix = path.suffix.lower()
    writer = importlib.import_module(WRITERS[suffix])
    try:
        if suffix == ".bvh":
            if len(motions) != 1:
                raise FileError(
                    path, f"a BVH file holds one clip, received {len(motions)}; write one file a clip, or a .glb"
                )
            writer.save(path, motions[0])
        else:
            writer.save(path, character, motions, animation_only=animation_only, **options)
    except OSError as error:
        raise FileError(path, f"cannot be written: {error.strerror or error}") from None


def save_sequence(path: str | Path, motion: MeshMotion | PointMotion, tracked: bool = False) -> None:
    """Write a mesh sequence as glTF (.glb, .gltf; frames as morph targets), USD (time samples), Alembic (.abc), an archive (.npz), or
    a folder of PLY files (no suffix); a point sequence as the last two, and as glTF where its points are `tracked`: each frame has the
    same ones, in the same order.

    The file, or folder, appears whole or not at all. Raises `FileError` for other suffixes and where it cannot be written.
    """
    path = Path(path)
    check_sequence_output(path, isinstance(motion, PointMotion), tracked)
    if isinstance(motion, PointMotion) and path.suffix.lower() in (".glb", ".gltf"):
        importlib.import_module("retarget.io.gltf_morph").save_points(path, motion)
    elif isinstance(motion, PointMotion):
        importlib.import_module(f"retarget.io.{'npz_clouds' if path.suffix else 'point_folder'}").save(path, motion)
    elif path.suffix.lower() in (".glb", ".gltf"):
        importlib.import_module("retarget.io.gltf_morph").save_sequence(path, motion)
    elif WRITERS.get(path.suffix.lower()) == "retarget.io.usd":
        importlib.import_module("retarget.io.usd_sequence").save(path, motion)
    elif path.suffix.lower() == ".npz":
        importlib.import_module("retarget.io.npz_sequence").save(path, motion)
    elif path.suffix.lower() == ".abc":
        importlib.import_module("retarget.io.alembic").save(path, motion)
    else:
        importlib.import_module("retarget.io.mesh_folder").save(path, motion)


def check_sequence_output(path: str | Path, points: bool = False, tracked: bool = False) -> None:
    """Refuse an output that could not hold a mesh sequence, or one of `points` (`tracked` or not), before any work is done.
    Raises `FileError`."""
    path = Path(path)
    suffix = path.suffix.lower()
    if points:
        if suffix not in ("", ".npz", *((".glb", ".gltf") if tracked else ())):
            forms = f"as {'.glb, .gltf, ' if tracked else ''}.npz or a folder (a name without suffix)"
            raise FileError(path, f"a point sequence is written {forms}, not as {path.suffix!r}")
        check_folder(path) if suffix else check_new_folder(path)
    elif suffix and suffix not in (".glb", ".gltf", ".npz", ".abc") and WRITERS.get(suffix) != "retarget.io.usd":
        raise FileError(path, f"a mesh sequence is written as .glb, .gltf, .npz or a folder, as USD or Alembic, not as {path.suffix!r}")


def check_format(path: Path) -> None:
    """Refuse a suffix that this installation cannot write, whatever is to be written. Raises `FileError`."""
    if path.suffix.lower() not in WRITTEN_SUFFIXES:
        raise FileError(
            path, f"cannot write {path.suffix or 'a file without suffix'!r}; use {', '.join(WRITTEN_SUFFIXES)}"
        )
    if WRITERS[path.suffix.lower()] == "retarget.io.usd":
        importlib.import_module("retarget.io.usd").require_usd(path)
    if path.suffix.lower() in THROUGH_BLENDER:
        importlib.import_module("retarget.io.blender").blender(path)


def check_output(path: str | Path, character: Character | None = None, animation_only: bool = False) -> None:
    """Refuse an output that could not be written, or could not hold the character, before any work is done. Raises
    `FileError`."""
    path = Path(path)
    check_format(path)
    if path.is_dir():
        raise FileError(path, "is a folder")
    check_folder(path)
    if character is not None:
        check_holds(path, character, animation_only)


def keeps_file(path: Path, character: Character) -> bool:
    """Whether the format of `path` is written as the file that the character came from, with all clips that it had."""
    writer = WRITERS.get(path.suffix.lower())
    if character.origin is None or writer not in ("retarget.io.gltf", "retarget.io.usd"):
        return False
    module = importlib.import_module(writer)
    return isinstance(character.origin, module.GltfOrigin if writer == "retarget.io.gltf" else module.UsdOrigin)


def check_holds(path: Path, character: Character, animation_only: bool) -> None:
    """Refuse a format that cannot hold the character. Raises `FileError`."""
    if path.suffix.lower() == ".vrm":
        importlib.import_module("retarget.io.gltf_write").check_holds(path, character, animation_only)
    if path.suffix.lower() == ".abc" and (animation_only or character.skin is None):
        raise FileError(path, "an Alembic file holds moving surfaces, and there is none to write; use .glb, .fbx or .bvh")
