"""What the subcommands do. Each returns a report: a dict for `--json`, whose `lines` are what a person reads."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from retarget.character import Motion
from retarget.errors import FileError, MatchError, RetargetError
from retarget.io import MOTION_SUFFIXES, THROUGH_BLENDER, WRITTEN_SUFFIXES, check_output, load
from retarget.io.asset import Asset
from retarget.io.presets import Preset, preset
from retarget.methods import Result, save_results
from retarget.motion.filter import cut, resample
from retarget.progress import progress_line
from retarget.retargeting import Hints, Production, cast, prepare

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
    animation_only: bool = False
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None
    target_up: str | None = None
    target_unit: float | None = None
    contacts: Path | None = None
    smpl_model: Path | None = None
    report: bool = False
    engine: str | None = None
    """The program that the results go to: a key of `io.presets.PRESETS`."""

    @property
    def preset(self) -> Preset | None:
        return None if self.engine is None else preset(self.engine)


def run_order(order: Order, progress: bool = False) -> dict[str, Any]:
    """Retarget every motion onto the target and write the results. Raises `RetargetError` for what cannot be done."""
    if order.engine is not None:
        preset(order.engine)  # an unknown one is told before any work
    files = [file for file in _motion_files(order.motions) if not _is_target_in_folder(file, order)]
    one_file_each = order.output.is_dir() or not order.output.suffix
    names = _result_files(files, order) if one_file_each else []
    if not one_file_each:
        check_output(order.output)
    source_hints, target_hints = _hints(order)
    settings = dict(order.settings)
    if order.contacts is not None:
        from retarget.contact.contact_file import read_contacts

        settings["contacts"] = read_contacts(order.contacts)
    if order.smpl_model is not None and not any(file.suffix.lower() == ".npz" for file in files):
        raise RetargetError(f"--smpl-model {order.smpl_model} is for motions in .npz, and none is given")
    target = cast(order.target, target_hints)
    if not one_file_each:
        check_output(order.output, target.original, order.animation_only)
    done, waiting = [], []
    with progress_line(progress, len(files)) as tell:
        for number, file in enumerate(files):
            tell(f"reading {file.name}")
            asset = load(file, smpl_model=order.smpl_model if file.suffix.lower() == ".npz" else None)
            for note in asset.notes:
                log.info("%s: %s", file, note)
            for clip in _wanted_clips(asset, order):
                tell(f"retargeting {file.stem}")
                motion = _trimmed(asset.motion(clip), order)
                production = prepare(cast(asset, source_hints, motion), target, order.method, **settings)
                started = time.perf_counter()
                result = production(motion)
                done.append(_report_clip(file, motion, result, production, time.perf_counter() - started))
                waiting.append(result)
            if one_file_each:
                tell(f"writing {names[number].name}")
                order.output.mkdir(parents=True, exist_ok=True)
                _write(names[number], waiting, order, done)
                waiting = []
            tell("", 1)
        if not one_file_each:
            tell(f"writing {order.output.name}")
            _write(order.output, waiting, order, done)
    lines = [line for each in done for line in [*_lines_of(each), *(correction_lines(each["stats"]) if order.report else ())]]
    return {"clips": done, "lines": lines}


def _result_files(files: list[Path], order: Order) -> list[Path]:
    """Where each result goes in the output folder. Refuses what could not be a folder, and two results of one name."""
    existing = next(path for path in (order.output, *order.output.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise FileError(
            order.output, f"cannot be made a folder: {existing} is a file; name the output file.glb, or another folder"
        )
    names: dict[Path, Path] = {}
    for file in files:
        name = order.output / f"{file.stem}_{order.target.stem}{_suffix(order)}"
        if name in names:
            raise FileError(
                name, f"two results would have this name, of {names[name]} and of {file}; rename one, or run them apart"
            )
        names[name] = file
    return list(names)


def _write(path: Path, waiting: list[Result], order: Order, done: list[dict]) -> None:
    root = order.preset.root if order.preset is not None and path.suffix.lower() == ".fbx" else ""
    save_results(path, waiting, animation_only=order.animation_only, **({"root": root} if root else {}))
    for each in done[len(done) - len(waiting) :]:
        each["output"] = str(path)


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


def _trimmed(motion: Motion, order: Order) -> Motion:
    if order.start is not None or order.end is not None:
        motion = cut(motion, order.start, order.end)
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
    for note in stats.get("stand_in", ()):
        yield f"  {note}"


def describe(path: Path, smpl_model: Path | None = None) -> dict[str, Any]:
    """What a file holds and what is inferred of it."""
    asset = load(path, smpl_model=smpl_model)
    report: dict[str, Any] = {
        "file": str(path),
        "kind": asset.kind,
        "clips": [{"name": clip.name, "frames": clip.frames, "fps": clip.fps} for clip in asset.clips],
        "stated": {"metres_per_unit": asset.convention.metres_per_unit, "up": asset.convention.up},
        "faults": list(asset.notes),
    }
    mesh = asset.character.mesh if asset.character is not None else asset.mesh
    if asset.sequence is not None:
        mesh, moving = asset.sequence.mesh, asset.sequence
        report["clips"] = [{"name": moving.name, "frames": len(moving), "fps": moving.fps}]
        low, high = moving.vertices[0].min(axis=0), moving.vertices[0].max(axis=0)
        report["size"] = [round(float(length), 4) for length in high - low]
    if mesh is not None:
        report["vertices"], report["faces"] = len(mesh.vertices), len(mesh.faces)
    if asset.points is not None:
        report["points"] = len(asset.points.points)
    if asset.character is not None:
        report |= _describe_skeleton(asset)
    report["lines"] = list(_describe_lines(report))
    return report


def _describe_skeleton(asset: Asset) -> dict[str, Any]:
    from retarget.motion.align import facing_name

    skeleton = asset.character.skeleton
    found: dict[str, Any] = {"joints": list(skeleton.names)}
    try:
        motion = asset.motion(0) if asset.clips else None
        actor = cast(asset, motion=motion)
    except MatchError as error:
        return found | {"humanoid": None, "why_not": str(error)}
    humanoid = actor.humanoid
    return found | {
        "humanoid": {
            name: {"joint": skeleton.names[joint], "confidence": round(humanoid.confidence[name], 3)}
            for name, joint in humanoid.joints.items()
        },
        "twist_joints": [skeleton.names[joint] for joint in humanoid.twists],
        "matched_by": humanoid.evidence,
        "metres_per_unit": actor.house_from_file.scale,
        "height_m": round(actor.height, 4),
        "facing_after_turning_upright": facing_name(humanoid.axes),
        "inferred": list(actor.notes),
    }


def _describe_lines(report: Mapping[str, Any]) -> Iterator[str]:
    yield f"{report['file']}: {report['kind']}"
    if "vertices" in report:
        yield f"  surface    {report['vertices']} vertices, {report['faces']} faces"
    if "size" in report:
        unit = "m" if report["stated"]["metres_per_unit"] == 1.0 else "units of the file"
        yield f"  size       {' x '.join(f'{length:.3f}' for length in report['size'])} {unit} on the first frame"
    if "points" in report:
        yield f"  points     {report['points']}"
    if "joints" in report:
        yield f"  skeleton   {len(report['joints'])} joints"
    if report.get("humanoid"):
        yield f"  height     {report['height_m']:.3f} m ({report['metres_per_unit']:g} metres per unit)"
        yield f"  facing     {report['facing_after_turning_upright']} with +y up"
        for note in report["inferred"]:
            yield f"  inferred   {note}"
        yield f"  humanoid   {len(report['humanoid'])} joints matched by {report['matched_by']}"
        for name, match in report["humanoid"].items():
            yield f"    {name:26} {match['joint']:28} {match['confidence']:.2f}"
    elif "why_not" in report:
        yield f"  humanoid   no: {report['why_not']}"
    for clip in report["clips"]:
        yield f"  clip       {clip['name']!r}: {clip['frames']} frames at {clip['fps']:g} fps"
    for fault in report["faults"]:
        yield f"  note       {fault}"


def write_joint_map(source: Path, target: Path, output: Path) -> dict[str, Any]:
    """Match two files and write the mapping."""
    from retarget.correspond.map_file import write_map

    sides = []
    for path in (source, target):
        asset = load(path)
        actor = cast(asset)
        sides += [actor.humanoid, actor.skeleton]
    write_map(output, *sides)
    shared = set(sides[0].joints) & set(sides[2].joints)
    return {"lines": [f"{output}: {len(shared)} joints shared; edit it and hand it to `retarget run --map {output}`"]}


def write_body(
    output: Path,
    preset: str | None,
    shape: Mapping[str, float],
    components: list[str],
    motion: str | None,
    plain: bool = False,
) -> dict[str, Any]:
    """Write the embedded human, still or performing an embedded motion."""
    from retarget.body.human import PRESETS, human, human_model, textured
    from retarget.errors import unknown_name
    from retarget.io import save

    check_output(output)
    finer = {}
    for text in components:
        name, equals, value = text.partition("=")
        try:
            finer[name] = float(value)
        except ValueError:
            raise RetargetError(f"--shape takes NAME=VALUE with a number, received {text!r}") from None
        if name not in human_model().detail_names:
            raise unknown_name("shape component", name, human_model().detail_names, "the embedded human")
    if preset is not None and preset not in PRESETS:
        raise unknown_name("preset", preset, PRESETS, "the embedded human")
    character = human(**(PRESETS[preset] if preset else {}) | dict(shape) | finer, name=output.stem)
    clips = []
    if motion is not None:
        from retarget.motion.library import PERFORMER, embedded_motion

        performance = embedded_motion(motion)
        clips = [prepare(cast(human(**PRESETS[PERFORMER])), cast(character))(performance).motion]
    save(output, character if plain else textured(character), clips)
    tall = float(character.mesh.vertices[:, 1].max() - character.mesh.vertices[:, 1].min())
    return {
        "lines": [
            f"{output}: {tall:.3f} m tall, {len(character.mesh.vertices)} vertices, {len(character.skeleton)} joints"
        ]
    }


def list_motions() -> dict[str, Any]:
    """Names and lengths of the embedded motions."""
    from retarget.motion.library import embedded_motion, motion_names

    clips = [embedded_motion(name) for name in motion_names()]
    return {"lines": [f"{clip.name:28} {clip.seconds:.1f} s, {len(clip)} frames at {clip.fps:g} fps" for clip in clips]}


def draw(
    files: list[Path], output: Path, frames: int, size: int, view: str, clip: str | None, smpl_model: Path | None = None
) -> dict[str, Any]:
    """Write a picture sheet, one row a file."""
    from retarget.view.picture import save_png, sheet
    from retarget.view.rows import file_row

    if output.suffix.lower() != ".png":
        raise FileError(output, "pictures are written as .png")
    models = [smpl_model if path.suffix.lower() == ".npz" else None for path in files]
    rows = [file_row(path, frames, clip, model) for path, model in zip(files, models)]
    image = sheet(rows, size=size, view=_direction(view))
    save_png(output, image)
    return {"lines": [f"{output}: {image.shape[1]} x {image.shape[0]} pixels"]}


def _direction(view: str) -> str | float:
    try:
        return float(view)
    except ValueError:
        return view
