"""What the small subcommands do. Each returns a report: a dict for `--json`, whose `lines` are what a person reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from retarget.casting import cast
from retarget.character import PointMotion, Provenance
from retarget.errors import FileError, MatchError, RetargetError
from retarget.io import check_output, load
from retarget.io.asset import Asset, Clip
from retarget.retargeting import prepare


def describe(path: Path, smpl_model: Path | None = None) -> dict[str, Any]:
    """What a file holds and what is inferred of it."""
    asset = load(path, smpl_model=smpl_model)
    report: dict[str, Any] = {
        "file": str(path),
        "kind": asset.kind,
        "clips": [_describe_clip(clip) for clip in asset.clips],
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
    if asset.clouds is not None:
        report |= _describe_clouds(asset.clouds)
    if asset.character is not None:
        report |= _describe_skeleton(asset)
    report["lines"] = list(_describe_lines(report))
    return report


def _describe_clip(clip: Clip) -> dict[str, Any]:
    told = {"name": clip.name, "frames": clip.frames, "fps": clip.fps}
    return told if clip.made_from is None else told | {"made_from": asdict(clip.made_from)}


def _describe_clouds(moving: PointMotion) -> dict[str, Any]:
    counts = sorted(len(cloud) for cloud in moving.clouds)
    first = next((cloud for cloud in moving.clouds if len(cloud)), None)
    told = {"clips": [{"name": moving.name, "frames": len(moving), "fps": moving.fps}]}
    told |= {"points": counts[len(counts) // 2], "fewest_points": counts[0], "most_points": counts[-1]}
    told["empty_frames"] = counts.count(0)
    if first is not None:
        told["size"] = [round(float(length), 4) for length in first.max(axis=0) - first.min(axis=0)]
    return told


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
        if "most_points" in report:
            empty = f", {report['empty_frames']} frames empty" if report["empty_frames"] else ""
            usual, least, most = (report[name] for name in ("points", "fewest_points", "most_points"))
            yield f"  points     {usual} on a usual frame, {least} to {most}{empty}"
        else:
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
        made_from = f", made from {Provenance(**clip['made_from'])}" if "made_from" in clip else ""
        yield f"  clip       {clip['name']!r}: {clip['frames']} frames at {clip['fps']:g} fps{made_from}"
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
