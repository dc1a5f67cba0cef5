"""What `retarget run` does: motions onto a character, and the page on the result beside it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from retarget.casting import Hints, cast
from retarget.character import Motion, Provenance
from retarget.commands_view import Page, Performance, check_page
from retarget.errors import FileError, RetargetError
from retarget.io import (
    MOTION_SUFFIXES,
    ONE_CLIP,
    THROUGH_BLENDER,
    WRITTEN_SUFFIXES,
    check_output,
    check_sequence_output,
    load,
)
from retarget.io.asset import Asset
from retarget.io.mesh_folder import is_one_motion
from retarget.io.presets import Preset, preset
from retarget.methods import Result, save_results
from retarget.motion.filter import cut, resample
from retarget.performing import Performer, ScanPerformer, cast_moving
from retarget.progress import Tell, progress_line
from retarget.retargeting import Production, prepare

log = logging.getLogger("retarget")


@dataclass(frozen=True)
class Order:
    """What `retarget run` was asked for."""

    motions: tuple[Path, ...]
    target: Path
    output: Path
    clip: str | None = None
    all_clips: bool = False
    start: float | None = None
    end: float | None = None
    fps: float | None = None
    method: str = "auto"
    settings: Mapping[str, Any] = field(default_factory=dict)
    repair_contacts: bool = True
    """Whether 'auto' may be a method that looks after contacts."""
    animation_only: bool = False
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None
    target_up: str | None = None
    target_unit: float | None = None
    contacts: Path | None = None
    smpl_model: Path | None = None
    report: bool = False
    """Tell what was corrected."""
    surface: bool = False
    """Write the moving surface itself, without a skeleton."""
    page: Path | None = None
    """Where to write the page on the only result."""
    engine: str | None = None
    """The program that the results go to: a key of `io.presets.PRESETS`."""

    @property
    def preset(self) -> Preset | None:
        return None if self.engine is None else preset(self.engine)


def run_order(order: Order, progress: bool = False) -> dict[str, Any]:
    """Retarget every motion onto the target and write the results. Raises `RetargetError` for what cannot be done."""
    files = [file for file in _motion_files(order.motions) if not _is_target_in_folder(file, order)]
    one_file_each = not order.surface and (order.output.is_dir() or not order.output.suffix)
    outputs = _result_files(files, order) if one_file_each else [order.output] * len(files)
    _expect_possible(order, files, outputs, one_file_each)
    method = _method(order)
    source_hints, target_hints = _hints(order)
    settings = dict(order.settings)
    if order.contacts is not None:
        from retarget.contact.contact_file import read_contacts

        settings["contacts"] = read_contacts(order.contacts)
    done, waiting, performance, page = [], [], None, None
    with progress_line(progress, len(files)) as tell:
        target = cast(order.target, target_hints, tell=lambda doing, _: tell(doing))
        if order.surface:
            check_sequence_output(order.output, target.cloud is not None, tracked=True)
        elif not one_file_each:
            check_output(order.output, target.original, order.animation_only)
        for file, output in zip(files, outputs):
            tell(f"reading {file.name}")
            asset = load(file, smpl_model=order.smpl_model if file.suffix.lower() == ".npz" else None)
            for note in asset.notes:
                log.info("%s: %s", file, note)
            performer = _performer(asset, order, source_hints, tell)
            wanted = [0] if performer is not None else _wanted_clips(asset, order)
            if order.page is not None:
                _expect_one(order.page, len(wanted), "clips")
            if not one_file_each:
                _expect_room(order, len(waiting) + len(wanted))
            for clip in wanted:
                tell(f"retargeting {file.stem}")
                if performer is not None:
                    motion = part = replace(performer.motion, made_from=_sequence_part(file, performer.motion, order))
                    production = prepare(performer, target, method, **settings)
                else:
                    part = _part(file, asset.motion(clip), order)
                    motion = _at_rate(part, order)
                    production = prepare(cast(asset, source_hints, motion), target, method, **settings)
                started = time.perf_counter()
                result = production(motion, part.made_from, performer.surface if isinstance(performer, Performer) else None)
                performance = Performance(file, output, production, part, result)
                done.append(_report_clip(file, motion, result, production, time.perf_counter() - started))
                waiting.append(result)
            if one_file_each:
                tell(f"writing {output.name}")
                order.output.mkdir(parents=True, exist_ok=True)
                page = _write(output, waiting, order, done, performance, tell)
                waiting = []
            tell("", 1)
        if not one_file_each:
            tell(f"writing {order.output.name}")
            page = _write(order.output, waiting, order, done, performance, tell)
    lines = []
    for each in done:
        lines += [*_lines_of(each), *(correction_lines(each["stats"]) if order.report else ())]
    if page is None:
        return {"clips": done, "lines": lines}
    return {"clips": done, "page": page.as_dict(), "lines": [*lines, *page.lines]}


def _expect_possible(order: Order, files: list[Path], outputs: list[Path], one_file_each: bool) -> None:
    """Refuse, before any work, what would come to nothing or cost the user a file."""
    if not files:
        raise FileError(order.motions[0], "holds no motion besides the character")
    if order.engine is not None:
        preset(order.engine)
    if order.clip is not None and order.all_clips:
        raise RetargetError(f"--clip {order.clip} and --all-clips contradict each other; give one of them")
    if order.smpl_model is not None and not any(file.suffix.lower() == ".npz" for file in files):
        raise RetargetError(f"--smpl-model {order.smpl_model} is for motions in .npz, and none is given")
    if order.surface:
        _expect_surface(order, len(files))
    elif not one_file_each:
        check_output(order.output)
        _expect_room(order, len(files))
    if order.page is not None:
        check_page(order.page, order.output if one_file_each else None)
        _expect_one(order.page, len(files), "motions")
    _expect_other_files(outputs, [*files, order.target])


def _method(order: Order) -> str:
    """The method's name. Raises `RetargetError` for one that looks after contacts where that is not wanted."""
    if order.repair_contacts:
        return order.method
    if order.method not in ("auto", "copy-rotations") or order.contacts is not None:
        other = f"--method {order.method}" if order.contacts is None else f"--contacts {order.contacts}"
        raise RetargetError(f"--no-repair-contacts and {other} contradict each other; give one of them")
    return "copy-rotations"


def _expect_surface(order: Order, count: int) -> None:
    """Refuse what cannot be written as one moving surface."""
    if count != 1 or order.all_clips:
        raise RetargetError("--surface writes one moving surface; give one motion, and not --all-clips")
    for given, name in ((order.page, "--report"), (order.engine, "--for"), (order.animation_only or None, "--animation-only")):
        if given is not None:
            raise RetargetError(f"--surface writes no skeleton, so that {name} does not apply")
    check_sequence_output(order.output)


def _performer(asset: Asset, order: Order, hints: Hints, tell: Tell) -> Performer | ScanPerformer | None:
    """Who performs a mesh sequence or a capture; None for what has joints. Its rate is `--fps`, which folders do not tell."""
    if (asset.sequence or asset.clouds) is not None and order.clip is not None:
        raise FileError(asset.path, f"holds one {asset.kind}: --clip does not apply")
    return cast_moving(asset, hints, order.fps, order.start, order.end, tell=lambda what, _=0: tell(what))


def _expect_other_files(outputs: list[Path], inputs: list[Path]) -> None:
    read = {path.resolve(): path for path in inputs}
    for output in outputs:
        if output.resolve() in read:
            raise FileError(output, "is read, as motion or character, and would be replaced; name another file")


def _expect_one(page: Path, count: int, what: str) -> None:
    if count != 1:
        cure = "give one (--clip NAME of a file with several), or let `retarget batch --report` write a page each"
        raise FileError(page, f"is a page on one result, but {count} {what} are to be retargeted; {cure}")


def _expect_room(order: Order, clips: int) -> None:
    """Refuse more clips than the output's format holds, before any of them is retargeted."""
    if clips > 1 and order.output.suffix.lower() in ONE_CLIP:
        form = order.output.suffix.lower()
        cure = "choose one (--clip NAME of a file with several), or name a .glb, or a folder for a file each motion"
        raise FileError(order.output, f"a {form} file holds one clip, and {clips} are to be written; {cure}")


def _result_files(files: list[Path], order: Order) -> list[Path]:
    """Where each result goes in the output folder. Refuses what could not be a folder, and two results of one name."""
    existing = next(path for path in (order.output, *order.output.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise FileError(
            order.output, f"cannot be made a folder: {existing} is a file; name the output file.glb, or another folder"
        )
    names: dict[Path, Path] = {}
    for file in files:
        own = file.name if file.is_dir() else file.stem
        name = order.output / f"{own}_{order.target.stem}{_suffix(order)}"
        if name in names:
            raise FileError(
                name, f"two results would have this name, of {names[name]} and of {file}; rename one, or run them apart"
            )
        names[name] = file
    return list(names)


def _write(
    path: Path, waiting: list[Result], order: Order, done: list[dict], performance: Performance | None, tell: Tell
) -> Page | None:
    """The file, and the page if one is wanted: both, or neither where one of them fails."""
    if order.surface:
        waiting[0].save_surface(path)
        done[-1]["output"] = str(path)
        return None
    root = order.preset.root if order.preset is not None and path.suffix.lower() == ".fbx" else ""
    with nullcontext(None) if order.page is None else performance.page(order.page, tell) as page:
        save_results(path, waiting, animation_only=order.animation_only, **({"root": root} if root else {}))
    for each in done[len(done) - len(waiting) :]:
        each["output"] = str(path)
    return page


def _suffix(order: Order) -> str:
    """Of files that have no name: the preset's, else the target's own, where that needs no other program to be written."""
    if order.preset is not None:
        return order.preset.suffix
    own = order.target.suffix.lower()
    if own == ".vrm" and order.animation_only:  # joints alone are no VRM
        return ".glb"
    return own if own in WRITTEN_SUFFIXES and own not in THROUGH_BLENDER else ".glb"


def _motion_files(inputs: tuple[Path, ...]) -> Iterator[Path]:
    for path in inputs:
        if path.is_dir():
            if is_one_motion(path):
                yield path
                continue
            found = sorted(file for file in path.iterdir() if file.suffix.lower() in MOTION_SUFFIXES)
            if not found:
                raise FileError(path, f"the folder holds no motion ({', '.join(MOTION_SUFFIXES)})")
            yield from found
        else:
            yield path


def _is_target_in_folder(file: Path, order: Order) -> bool:
    """A folder of motions may hold the character as well; named by itself it is a motion like any other."""
    return file not in order.motions and file.resolve() == order.target.resolve()


def _hints(order: Order) -> tuple[Hints, Hints]:
    source_joints = target_joints = None
    if order.map_file is not None:
        from retarget.correspond.map_file import read_map

        tables = read_map(order.map_file)
        source_joints, target_joints = tables["source"] or None, tables["target"] or None
    return Hints(source_joints, order.up, order.unit), Hints(target_joints, order.target_up, order.target_unit)


def _wanted_clips(asset: Asset, order: Order) -> list[int]:
    names = [clip.name for clip in asset.clips]
    if order.clip is not None:
        asset_motion_names = [name for name in names if name == order.clip]
        if not asset_motion_names:
            asset.motion(order.clip)  # raises, naming the nearest
        return [names.index(order.clip)]
    if order.all_clips and names:
        return list(range(len(names)))
    if len(names) > 1:
        log.warning(
            "%s holds %d clips; taking the first, %r (--clip NAME or --all-clips to choose)",
            asset.path,
            len(names),
            names[0],
        )
    return [0]


def _sequence_part(file: Path, motion: Motion, order: Order) -> Provenance:
    """What of a mesh sequence was taken, in its own seconds."""
    start = math.ceil((order.start or 0.0) * motion.fps - 1e-9) / motion.fps
    return replace(Provenance.whole(file, motion), start=start, end=start + motion.seconds)


def _part(file: Path, motion: Motion, order: Order) -> Motion:
    """What is taken of a clip, which remembers where it was taken from."""
    motion = replace(motion, made_from=Provenance.whole(file, motion))
    if order.start is None and order.end is None:
        return motion
    try:
        return cut(motion, order.start, order.end)
    except RetargetError as error:
        raise FileError(file, f"clip {motion.name!r}: {error}") from None


def _at_rate(motion: Motion, order: Order) -> Motion:
    fps = order.fps if order.fps is not None or order.preset is None else order.preset.rate(motion.fps)
    return motion if fps is None or fps == motion.fps else resample(motion, fps)


def _report_clip(file: Path, motion: Motion, result: Result, production: Production, seconds: float) -> dict[str, Any]:
    matched = lambda actor: {name: actor.skeleton.names[joint] for name, joint in actor.humanoid.joints.items()}  # noqa: E731
    for note in result.stats["notes"]:
        log.info("%s: %s", file, note)
    for entry in result.stats.get("contacts_file_without_effect", ()):
        log.warning("%s [%s]: nothing in this clip for the contacts file's %s", file, motion.name, entry)
    return {
        "motion": str(file),
        "clip": motion.name,
        "frames": len(motion),
        "fps": motion.fps,
        "status": result.status,
        "solve_seconds": round(seconds, 4),
        "source_joints": matched(production.source),
        "target_joints": matched(production.target),
        "stats": result.stats,
    }


def _lines_of(clip: Mapping[str, Any]) -> list[str]:
    seconds = (clip["frames"] - 1) / clip["fps"]
    line = f"{clip['motion']} [{clip['clip']}] -> {clip['output']}: {clip['frames']} frames, {seconds:.2f} s at {clip['fps']:g} fps"
    return [line if clip["status"] == "ok" else f"{line} ({clip['status']})"]


def correction_lines(stats: Mapping[str, Any]) -> Iterator[str]:
    """What the interaction method corrected and what it could not, for people."""
    for row in stats.get("corrections", ()):
        yield f"  {row['joint']} turned by up to {row['degrees']:.1f} degrees from {row['start']:.2f} to {row['end']:.2f} s"
    for name, words in (("still_inside", "still inside"), ("not_reached", "does not reach")):
        for row in stats.get(name, ()):
            yield f"  {row['parts'][0]} {words} {row['parts'][1]}: {row['cm']:.1f} cm at {row['at']:.2f} s"
    if stats.get("source_inside_itself_cm", 0) >= 0.5:
        yield f"  the source is up to {stats['source_inside_itself_cm']:.1f} cm inside itself; that may stay, no deeper"
    if stats.get("contacts_of_its_girth"):
        whole, girth = stats["contacts_of_the_source"], stats["contacts_of_its_girth"]
        gone = stats.get("contacts_let_go", girth)
        pull = "they do not pull" if gone == girth else f"{gone}, where the target is slimmer, do not pull"
        yield f"  {girth} of {whole} points that touch do so by the source's girth, not by its pose: {pull}"
    for note in stats.get("stand_in", ()):
        yield f"  {note}"
