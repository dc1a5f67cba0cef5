"""What `retarget convert` does: a file in another format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from retarget.body import rotations as rot
from retarget.casting import Hints, cast
from retarget.character import Motion
from retarget.commands_sequence import SEQUENCE_SUFFIXES, convert_sequence
from retarget.errors import FileError, MatchError, RetargetError
from retarget.io import DROPPING_CLIPS, ONE_CLIP, WRITTEN_SUFFIXES, check_format, check_holds, keeps_file, load, save
from retarget.io.asset import Asset
from retarget.io.file_names import distinct, portable
from retarget.io.whole_file import check_folder
from retarget.motion.align import AXES, Similarity
from retarget.motion.filter import resample

SURFACE_SUFFIXES = (".obj", ".ply", ".pcd")
"""Formats of still surfaces and points."""
EACH = "{clip}"
"""In the name of the output: a file for each clip."""


@dataclass(frozen=True)
class Conversion:
    """What `retarget convert` was asked."""

    file: Path
    output: Path
    clip: str | None = None
    fps: float | None = None
    up: str | None = None
    unit: float | None = None
    smpl_model: Path | None = None


def convert_file(order: Conversion) -> dict[str, Any]:
    """Write what a file holds in the format of the output's suffix. Raises `RetargetError` for what cannot be.

    glTF is written in metres with +Y up: as the file states, as `order` says, or as its body shows. BVH and surfaces
    have no unit: they keep the file's own, unless `order` tells it. A glTF, VRM or FBX character is not taken apart where
    glTF is written, nor a USD character where USD is: its file is kept as it is, as far as its clips and its space are.
    """
    output = order.output
    if EACH in str(output.parent):
        raise FileError(output, f"{EACH} stands in the name of a file, not of a folder")
    sequence = output.suffix.lower() in SEQUENCE_SUFFIXES and EACH not in output.name
    if output.is_dir():
        raise FileError(output, f"is a folder; name a file in it, or {output / EACH}.bvh for a file each clip")
    if output.suffix.lower() not in (*WRITTEN_SUFFIXES, *SURFACE_SUFFIXES) and not sequence:
        forms = f"{', '.join(WRITTEN_SUFFIXES)}, .obj, .ply or .pcd for a still surface, "
        forms += ".npz or a new folder for a moving one"
        raise FileError(output, f"cannot write {output.suffix or 'a file without suffix'!r}; use {forms}")
    if EACH not in output.name:
        check_folder(output)
    _expect_other_file(order.file, output)
    if output.suffix.lower() in WRITTEN_SUFFIXES:
        check_format(output)
    if order.up is not None and order.up not in AXES:
        raise RetargetError(f"up axis {order.up!r} is unknown; use one of {', '.join(AXES)}")
    if order.unit is not None and not 0 < order.unit < float("inf"):
        raise RetargetError(f"unit must be positive metres per unit, received {order.unit:g}")
    asset = load(order.file, smpl_model=order.smpl_model)
    if sequence or asset.sequence is not None or asset.clouds is not None:
        space, notes = _space(asset, order, keep=asset.sequence is None or output.suffix.lower() in (*SEQUENCE_SUFFIXES, *SURFACE_SUFFIXES, ".bvh"))
        moving, size = convert_sequence(asset, output, order.clip, order.fps, space)
        return _report(asset, [(output, [(moving.name, len(moving), moving.fps)])], [*asset.notes, *notes], size)
    _expect_fitting(asset, output)
    if asset.character is None:
        return _convert_surface(asset, order)
    return _convert_character(asset, order)


def _expect_other_file(file: Path, output: Path) -> None:
    if output.resolve() == file.resolve() or (output.exists() and file.exists() and output.samefile(file)):
        raise FileError(output, "is the file that is read; name another")


def _expect_fitting(asset: Asset, output: Path) -> None:
    """Refuse kinds that the format of the output cannot hold, and a .bin that would replace one that is read."""
    surface = output.suffix.lower() in SURFACE_SUFFIXES
    if asset.character is None and not surface:
        forms = f"{'.obj or .ply' if asset.points is None else '.ply or .pcd'}; a {output.suffix} needs a skeleton"
        raise FileError(output, f"{asset.path.name} holds a {asset.kind} without skeleton, which is written as {forms}")
    if asset.character is not None and surface:
        held = "an animated body" if asset.clips else "a body with a skeleton"
        forms = ", ".join(WRITTEN_SUFFIXES)
        raise FileError(output, f"is for still surfaces, but {asset.path.name} holds {held}; write it as {forms}")
    if asset.points is not None and output.suffix.lower() == ".obj":
        raise FileError(output, f"{asset.path.name} holds points without faces; write them as .ply or .pcd")
    if asset.mesh is not None and output.suffix.lower() == ".pcd":
        raise FileError(output, f"{asset.path.name} holds a surface, and .pcd has no faces; write it as .ply or .obj")
    document = getattr(getattr(asset.character, "origin", None), "document", None)
    if output.suffix.lower() == ".gltf" and document is not None:
        beside = output.with_suffix(".bin").resolve()
        uris = [entry.get("uri", "") for entry in document.json.get("buffers", ())]
        from urllib.parse import unquote

        if any((asset.path.parent / unquote(uri)).resolve() == beside for uri in uris if uri[:5].lower() != "data:"):
            raise FileError(output, f"would replace {beside.name}, which {asset.path.name} reads; name another")


def _convert_surface(asset: Asset, order: Conversion) -> dict[str, Any]:
    from retarget.io import obj_ply

    if order.clip is not None or order.fps is not None:
        raise FileError(order.file, "holds no animation: --clip and --fps do not apply")
    if EACH in order.output.name:
        raise FileError(order.file, f"holds no animation: {EACH} does not apply")
    space, notes = _space(asset, order, keep=True)
    surface = asset.mesh if asset.mesh is not None else asset.points
    if space is not None:
        where = "vertices" if asset.mesh is not None else "points"
        surface = replace(surface, **{where: space.points(getattr(surface, where))})
    obj_ply.save(order.output, surface)
    size = f"{len(surface.vertices)} vertices" if asset.mesh is not None else f"{len(surface.points)} points"
    return _report(asset, [(order.output, [])], notes, size)


def _convert_character(asset: Asset, order: Conversion) -> dict[str, Any]:
    suffix = order.output.suffix.lower()
    chosen = _chosen_clips(asset, order)
    check_holds(order.output, asset.character, False)
    space, notes = _space(asset, order, keep=suffix == ".bvh")
    character = asset.character if space is None else space.character(asset.character)

    def motion(number: int) -> Motion:
        read = asset.motion(number)
        read = read if space is None else space.motion(read)
        return read if order.fps is None else resample(read, order.fps)

    if EACH in order.output.name:
        names = [portable(asset.clips[number].name or f"clip {number + 1}") for number in chosen]
        stem = order.output.stem
        files = [
            order.output.parent / name
            for name in distinct([[stem.replace(EACH, name)] for name in names], order.output.suffix)
        ]
        for file in files:
            _expect_other_file(order.file, file)
        _make_folder(order.output.parent)
        parts = [(file, [number]) for file, number in zip(files, chosen)]
    else:
        parts = [(order.output, chosen)]
    untouched = keeps_file(order.output, character) and order.clip is None and order.fps is None
    written = []
    for file, numbers in parts:
        whole = untouched and EACH not in order.output.name
        motions = [] if whole else [motion(number) for number in numbers]
        save(file, character, motions, **({"keep_clips": whole} if suffix in DROPPING_CLIPS else {}))
        clips = [asset.clips[number] for number in numbers]
        if whole:
            written.append((file, [(clip.name, clip.frames, clip.fps) for clip in clips]))
        else:
            written.append((file, [(each.name, len(each), each.fps) for each in motions]))
    return _report(asset, written, notes, f"{len(character.skeleton)} joints")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made a folder: {error.strerror or error}") from None


def _chosen_clips(asset: Asset, order: Conversion) -> list[int]:
    """Numbers of the clips to write. Raises `RetargetError` where the output cannot hold them."""
    names, suffix = [clip.name for clip in asset.clips], order.output.suffix.lower()
    if order.clip is not None:
        asset.motion(order.clip)  # raises, naming the nearest
        return [names.index(order.clip)]
    chosen = list(range(len(names)))
    each = EACH in order.output.name
    one = suffix in ONE_CLIP
    if not chosen and (one or each):
        raise FileError(
            asset.path, f"holds no animation, and {suffix} cannot be without" if one else "holds no animation"
        )
    if one and len(chosen) > 1 and not each:
        listed = ", ".join(map(repr, names[:3])) + (", ..." if len(names) > 3 else "")
        pattern = order.output.with_name(f"{order.output.stem}_{EACH}{suffix}")
        cure = f"choose one with --clip NAME, or write a file each: '{pattern}'"
        raise FileError(asset.path, f"holds {len(chosen)} clips ({listed}), and {suffix} holds one; {cure}")
    return chosen


def _space(asset: Asset, order: Conversion, keep: bool) -> tuple[Similarity | None, list[str]]:
    """What leads from the file's space to metres with +Y up, None where nothing does; and what was inferred.

    With `keep` (formats without unit) only what `order` says counts: all else stays the file's own.
    """
    up, unit, notes = order.up, order.unit, []
    if not keep:
        up, unit = up or asset.convention.up, unit or asset.convention.metres_per_unit
        if up is None or unit is None:
            up, unit, notes = _inferred(asset, up, unit)
    turn = rot.IDENTITY if up is None else rot.swing_between(AXES[up], AXES["+y"])
    space = Similarity(turn, 1.0 if unit is None else float(unit))
    return (None if space.scale == 1.0 and up in (None, "+y") else space), notes


def _inferred(asset: Asset, up: str | None, unit: float | None) -> tuple[str, float, list[str]]:
    """Up axis and unit as the body shows them."""
    import numpy as np

    wanted = " and ".join(option for option, known in (("--up", up), ("--unit", unit)) if known is None)
    if asset.sequence is not None:
        raise FileError(asset.path, f"does not tell its space, and a mesh sequence has no joints that show it; give {wanted}")
    try:
        actor = cast(asset, Hints(None, up, unit), asset.motion(0) if asset.clips else None)
    except MatchError as error:
        raise FileError(
            asset.path, f"does not tell its space, and its body does not show it; give {wanted} ({error})"
        ) from None
    back = rot.rotate(rot.inverse(actor.house_from_file.rotation), AXES["+y"])
    name = min(AXES, key=lambda each: float(np.abs(AXES[each] - back).max()))
    return up or name, unit or actor.house_from_file.scale, list(actor.notes)


def _report(asset: Asset, written: list, notes: list[str], size: str) -> dict[str, Any]:
    files = [
        {"output": str(file), "clips": [{"name": name, "frames": frames, "fps": fps} for name, frames, fps in clips]}
        for file, clips in written
    ]
    return {"file": str(asset.path), "files": files, "inferred": notes, "lines": list(_lines(files, notes, size))}


def _lines(files: list[dict[str, Any]], notes: list[str], size: str) -> Iterator[str]:
    for each in files:
        clips = each["clips"]
        if len(clips) == 1:
            told = f", {clips[0]['name']!r}: {clips[0]['frames']} frames at {clips[0]['fps']:g} fps"
        else:
            told = f", {len(clips)} clips" if clips else ""
        yield f"{each['output']}: {size}{told}"
    for note in notes:
        yield f"  {note}"
