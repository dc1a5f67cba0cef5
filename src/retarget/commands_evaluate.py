"""What `retarget evaluate` does (read result, source and truth, measure, draw, put the report into words) and `bench`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retarget.casting import Hints, cast
from retarget.character import Motion
from retarget.errors import FileError, RetargetError
from retarget.evaluate.report import Report, evaluate
from retarget.evaluate.take import Take
from retarget.io import load
from retarget.io.asset import Asset, Clip
from retarget.io.whole_file import check_folder, written_whole
from retarget.motion.filter import cut
from retarget.progress import progress_line


@dataclass(frozen=True)
class Question:
    """What `retarget evaluate` was asked."""

    result: Path
    source: Path
    truth: Path | None = None
    output: Path | None = None
    """The picture of curves."""
    clip: str | None = None
    source_clip: str | None = None
    truth_clip: str | None = None
    start: float | None = None
    end: float | None = None
    """The part of the source that the result was made from, seconds."""
    fps: float | None = None
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None
    """What is known of the source's file."""
    smpl_model: Path | None = None
    """The body of a source in .npz."""


SHEET_ROWS, SHEET_CELL = 4, 360
"""Rows of one sheet of a bench, and the height of a cell in pixels."""
ROWS: tuple[tuple[str, tuple[tuple[str, str, str, float], ...]], ...] = (
    ("pose", (
        ("direction_error_deg", "limb direction, off the source's", "deg", 1.0),
        ("orientation_error_deg", "palms, soles and face, off the source's", "deg", 1.0),
    )),
    ("ground", (
        ("foot_slide_cm", "foot slide over a contact", "cm", 1.0),
        ("floor_error_cm", "resting feet over or under the floor", "cm", 1.0),
    )),
    ("motion", (
        ("jerk_ratio", "jerk, result over source", "", 1.0),
        ("hand_speed_m_s", "hand speed, mean", "m/s", 1.0),
        ("hand_top_speed_m_s", "hand speed, highest", "m/s", 1.0),
        ("foot_speed_m_s", "foot speed, mean", "m/s", 1.0),
        ("foot_top_speed_m_s", "foot speed, highest", "m/s", 1.0),
    )),
    ("contact", (
        ("contacts_kept", "the source's contacts kept", "%", 100.0),
        ("penetration_percent", "limb vertices inside other parts", "%", 1.0),
        ("new_penetration_percent", "  where the source's are not", "%", 1.0),
        ("new_part_penetration_percent", "  where the source's part is clear", "%", 1.0),
        ("excess_penetration_percent", "  more than the source's", "%", 1.0),
        ("depth_mean_mm", "depth of these, mean", "mm", 1.0),
        ("depth_p95_mm", "depth of these, 95 % within", "mm", 1.0),
        ("deepest_mm", "deepest vertex", "mm", 1.0),
    )),
    ("truth", (
        ("mpjpe", "joints off the truth (MPJPE)", "mm", 1000.0),
        ("pa_mpjpe", "  aligned (PA-MPJPE)", "mm", 1000.0),
        ("acc", "acceleration error (Acc)", "mm/frame²", 1000.0),
        ("pa_acc", "  aligned (PA-Acc)", "mm/frame²", 1000.0),
        ("mse_nkn", "MSE over height, NKN", "cm", 1.0),
        ("mse_meshret", "  MeshRet", "mm", 1000.0),
        ("mse_san", "  SAN, x 1000", "", 1000.0),
        ("mse_star", "  STaR, x 1000", "", 1000.0),
        ("local_mse_nkn", "local MSE over height, NKN", "cm", 1.0),
        ("local_mse_meshret", "  MeshRet", "mm", 1000.0),
        ("local_mse_san", "  SAN, x 1000", "", 1000.0),
        ("local_mse_star", "  STaR, x 1000", "", 1000.0),
        ("end_effector_position_error_cm", "hands, feet and head off the truth", "cm", 1.0),
        ("end_effector_orientation_error_degrees", "  their turn", "deg", 1.0),
        ("mpvd", "vertices off the truth (MPVD)", "mm", 1000.0),
        ("pa_mpvd", "  aligned (PA-MPVD)", "mm", 1000.0),
        ("mdel", "edge lengths off the truth (MDEL)", "mm", 1000.0),
    )),
)  # fmt: skip
"""The printed table: figure, words, unit, and what the figure is multiplied by for that unit."""


def evaluate_files(question: Question, progress: bool = False) -> dict[str, Any]:
    """Measure a result and print the report. Raises `RetargetError` for input that cannot be used."""
    if question.output is not None:
        _check_picture(question.output)
    with progress_line(progress) as tell:
        tell("reading", 0)
        takes, clips, notes = takes_of(question)
        report = evaluate(takes["source"], takes["result"], takes.get("truth"), question.fps, tell)
        if question.output is not None:
            from retarget.view.curves import save_curves

            tell("drawing", 0)
            title = f"{question.result.name} [{clips['result']}] from {question.source.name} [{clips['source']}]"
            save_curves(question.output, report, title)
    notes += report.notes
    answer = {"result": str(question.result), "source": str(question.source), "clips": clips} | report.as_dict()
    return answer | {"notes": notes, "lines": list(_lines(question, report, clips, notes))}


def _check_picture(path: Path) -> None:
    if path.suffix.lower() != ".png":
        raise FileError(path, "pictures are written as .png")
    check_folder(path)


def takes_of(question: Question) -> tuple[dict[str, Take], dict[str, str], list[str]]:
    """Result, source and truth in metres, the names of their clips, and what was chosen for the user."""
    assets = {"result": load(question.result), "source": load(question.source, smpl_model=question.smpl_model)}
    if question.truth is not None:
        assets["truth"] = load(question.truth)
    numbers, notes = _choose_clips(assets, question)
    start, end, said = _source_part(assets, numbers, question)
    notes += said
    source_joints = target_joints = None
    if question.map_file is not None:
        from retarget.correspond.map_file import read_map

        tables = read_map(question.map_file)
        source_joints, target_joints = tables["source"] or None, tables["target"] or None
    takes, clips = {}, {}
    for who, asset in assets.items():
        motion = asset.motion(numbers[who])
        hints = Hints(source_joints, question.up, question.unit) if who == "source" else Hints(target_joints)
        actor = cast(asset, hints, motion)
        clips[who] = motion.name
        motion = actor.house_from_file.motion(motion)
        takes[who] = Take(actor, _part(motion, start, end) if who == "source" else motion)
    return takes, clips, notes


def _part(motion: Motion, start: float | None, end: float | None) -> Motion:
    return motion if start is None and end is None else cut(motion, start, end)


def _source_part(
    assets: dict[str, Asset], numbers: dict[str, str | int], question: Question
) -> tuple[float | None, float | None, list[str]]:
    """First and last second of the source to compare with, and what was chosen for the user: as asked, else what the result
    says it was made from, as far as that is a part of this source."""
    if question.start is not None or question.end is not None:
        return question.start, question.end, []
    made_from = clip_of(assets["result"], numbers["result"]).made_from
    source = clip_of(assets["source"], numbers["source"])
    if made_from is None:
        return None, None, []
    last, frame = (source.frames - 1) / source.fps, 1 / source.fps
    from_start = made_from.start < frame / 2
    if not made_from.is_of(question.source) or made_from.clip != source.name or made_from.end > last + frame / 2:
        if from_start:
            return None, None, []
        note = f"the result says it was made from {made_from}; it is compared from the start (--start, --end to choose)"
        return None, None, [note]
    if from_start and made_from.end > last - frame / 2:
        return None, None, []
    part = f"{made_from.start:.6g} to {made_from.end:.6g} s of the source"
    note = f"compared with {part}, which the result says it was made from (--start, --end to choose)"
    return made_from.start, made_from.end, [note]


def clip_of(asset: Asset, clip: str | int) -> Clip:
    """What is known of a clip by its name or number."""
    return asset.clips[clip] if isinstance(clip, int) else next(each for each in asset.clips if each.name == clip)


def _choose_clips(assets: dict[str, Asset], question: Question) -> tuple[dict[str, str | int], list[str]]:
    """The clips as named, else those that belong together: as the result says of itself, or by name; else the result's last
    (that which it plays, if its format tells) and the source's first."""
    names = {who: [clip.name for clip in asset.clips] for who, asset in assets.items()}
    chosen: dict[str, str | int] = {}
    wanted = {"result": question.clip, "source": question.source_clip, "truth": question.truth_clip}
    for who, asset in assets.items():
        if wanted[who] is not None or not names[who]:
            asset.motion(wanted[who])  # raises for a name that is not there, and for files without clips
            chosen[who] = wanted[who]
    made = [
        number
        for number, clip in enumerate(assets["result"].clips)
        if clip.made_from is not None
        and clip.made_from.is_of(question.source)
        and clip.made_from.clip in ((question.source_clip,) if question.source_clip else names["source"])
    ]
    if "result" not in chosen and made:
        chosen["result"] = assets["result"].plays if assets["result"].plays in made else made[-1]
    if "result" not in chosen:
        asked = question.source_clip or (names["source"][0] if len(names["source"]) == 1 else None)
        plays = assets["result"].plays
        chosen["result"] = plays if plays is not None and asked is None else _last_named(names["result"], asked)
    played = names["result"][chosen["result"]] if isinstance(chosen["result"], int) else chosen["result"]
    if "source" not in chosen:
        made_from = clip_of(assets["result"], chosen["result"]).made_from
        told = [made_from.clip] if made_from is not None and made_from.is_of(question.source) else []
        alike = [each for each in (*told, played, _bare(played)) if each in names["source"]]
        chosen["source"] = names["source"].index(alike[0]) if alike else 0
    if "truth" in assets and "truth" not in chosen:
        chosen["truth"] = _last_named(names["truth"], played)
    options = {"result": "--clip", "source": "--source-clip", "truth": "--truth-clip"}
    notes = [
        f"the {who} holds {len(names[who])} clips; {names[who][number]!r} is taken ({options[who]} to choose)"
        for who, number in chosen.items()
        if isinstance(number, int) and len(names[who]) > 1
    ]
    return chosen, notes


def _last_named(names: list[str], name: str | None) -> int:
    """The last clip of that name, numbered or not, since appended animations stand last; the last of all if none has it."""
    alike = [number for number, each in enumerate(names) if name in (each, _bare(each))]
    return alike[-1] if alike else len(names) - 1


def _bare(name: str) -> str:
    """A clip's name without the number that a taken name gets when it is written."""
    return re.sub(r"_\d+$", "", name)


def _lines(question: Question, report: Report, clips: dict[str, str], notes: list[str]) -> Iterator[str]:
    figures = report.figures
    yield f"{question.result} [{clips['result']}] from {question.source} [{clips['source']}]"
    yield (
        f"{figures['frames']:.0f} frames, {figures['seconds']:.2f} s at {figures['fps']:g} frames a second; "
        f"the body is {report.height:.2f} m tall, the source {report.source_height:.2f} m"
    )
    yield ""
    yield f"{'':12}{'':42}{'result':>10}{'source':>10}"
    for group, rows in ROWS:
        for key, words, unit, factor in rows:
            if key in figures:
                own, theirs = (_number(figures.get(name), factor) for name in (key, f"source_{key}"))
                theirs = theirs if f"source_{key}" in figures else ""
                yield f"{group:12}{words:42}{own:>10}{theirs:>10}  {unit}".rstrip()
                group = ""
    yield ""
    yield f"{'rests on':12}{report.facts['rests on']}"
    if "deepest" in report.facts:
        yield f"{'deepest':12}{report.facts['deepest']}"
    yield ""
    if report.problems:
        yield "Look at these, worst first:"
        yield from (f"{number:3}. {each.sentence}" for number, each in enumerate(report.problems, 1))
    else:
        yield "Nothing that needs a look was found."
    yield ""
    yield "cm and mm in the table are at a body height of 1.7 m, in sentences and curves in this body's own size"
    yield from (f"note: {note}" for note in notes)
    if question.output is not None:
        yield f"{question.output}: curves over time"


def _number(value: float | None, factor: float) -> str:
    return "-" if value is None else f"{value * factor:.2f}"


def run_bench(
    name: str,
    quick: bool,
    json_file: Path | None,
    gate: bool = False,
    progress: bool = False,
    pictures: Path | None = None,
) -> dict[str, Any]:
    """Run a bench and print its table; with `gate`, `regressions` lists what got worse than the committed baseline. Sheets
    of what was made go to the folder `pictures`, for benches that have something to show."""
    import json

    from retarget.errors import unknown_name
    from retarget.evaluate.benches import BENCHES, PICTURED, load_bench
    from retarget.evaluate.gate import bounds_of, regressions

    if name not in BENCHES:
        raise unknown_name("bench", name, BENCHES, "this version")
    if json_file is not None and not json_file.parent.is_dir():
        raise FileError(json_file, f"the folder {json_file.parent} does not exist")
    if pictures is not None and name not in PICTURED:
        raise RetargetError(f"the bench {name!r} has no pictures; {', '.join(PICTURED)} has")
    if pictures is not None and not pictures.is_dir() and (pictures.exists() or not pictures.parent.is_dir()):
        raise FileError(pictures, "is not a folder" if pictures.exists() else f"the folder {pictures.parent} does not exist")
    bounds = bounds_of(name, quick) if gate else {}
    if gate and not bounds:
        raise RetargetError(f"the bench {name!r} has no committed baseline {'with' if quick else 'without'} --quick")
    with progress_line(progress) as tell:
        if pictures is None:
            report = load_bench(name).run(quick=quick, tell=tell)
        else:
            pictures.mkdir(exist_ok=True)
            with _sheets(pictures, name) as show:
                report = load_bench(name).run(quick=quick, tell=tell, show=show)
            if report.get("energies"):
                from retarget.view.energy_curves import save_energies

                save_energies(pictures / f"{name}-energies.png", report["energies"], "Basset 2019, thin to heavy, hands on hips")
    if gate:
        worse = regressions(report["summary"], bounds)
        verdict = [f"{len(bounds)} figures within the baseline"] if not worse else ["worse than the baseline:", *worse]
        report |= {"regressions": worse, "lines": [*report["lines"], "", *verdict]}
    if json_file is not None:
        with written_whole(json_file) as file:
            file.write(json.dumps({key: value for key, value in report.items() if key != "lines"}, indent=1).encode())
    return report


@contextmanager
def _sheets(folder: Path, name: str) -> Iterator[Callable[[Any], None]]:
    """Rows drawn a few to a sheet, as they come: NAME-01.png and so on."""
    from retarget.view.picture import Row, save_png, sheet

    waiting: list[Row] = []
    number = 0

    def draw() -> None:
        nonlocal number
        number += 1
        save_png(folder / f"{name}-{number:02}.png", sheet(waiting, SHEET_CELL))
        waiting.clear()

    def show(row: Any) -> None:
        waiting.append(Row(row.label, row.mesh, row.vertices, row.captions))
        if len(waiting) == SHEET_ROWS:
            draw()

    yield show
    if waiting:
        draw()
