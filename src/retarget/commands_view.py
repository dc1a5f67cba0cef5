"""What `retarget view` and `retarget report` do: read who is shown, measure, and show it in a browser or on one page."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from retarget.casting import Hints, cast
from retarget.character import Motion
from retarget.commands_evaluate import ROWS, Question, takes_of
from retarget.errors import FileError, RetargetError
from retarget.evaluate.corrected import copied_take, turned_joints
from retarget.evaluate.report import Report, evaluate
from retarget.evaluate.take import Take, on_one_clock
from retarget.io import load
from retarget.io.whole_file import check_folder
from retarget.methods import Result
from retarget.motion.filter import cut
from retarget.progress import Tell, progress_line, untold
from retarget.retargeting import Production
from retarget.view.report_page import Sheet, page_about_to_stand
from retarget.view.stage import StageBody, stage_body

PAGE_SUFFIXES = (".html", ".htm")
FIRST_ROWS = ("contacts_kept", "penetration_percent", "foot_slide_cm")
"""The figures that correction is for."""
ALONE = ("foot_slide_cm", "hand_speed", "hand_top", "foot_speed", "foot_top", "penetration", "depth", "deepest")
"""Beginnings of the figures that speak of a result without its source."""


@dataclass(frozen=True)
class Showing:
    """Whom `retarget view` and `retarget report` were asked to show."""

    result: Path
    sources: tuple[Path, ...] = ()
    clip: str | None = None
    source_clip: str | None = None
    start: float | None = None
    end: float | None = None
    """The part of the sources that the result was made from, seconds."""
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None
    """What is known of the sources' files."""
    smpl_model: Path | None = None
    """The body of sources in .npz."""

    def question(self, source: Path) -> Question:
        """The same of one source, as `retarget evaluate` asks it."""
        return Question(
            self.result, source, clip=self.clip, source_clip=self.source_clip, start=self.start, end=self.end,
            map_file=self.map_file, up=self.up, unit=self.unit,
            smpl_model=self.smpl_model if source.suffix.lower() == ".npz" else None,
        )  # fmt: skip


@dataclass(frozen=True)
class Cast:
    """Who performs, on one clock: the result first."""

    takes: dict[str, Take]
    """By label."""
    notes: list[str]


def write_report(showing: Showing, output: Path, progress: bool = False) -> dict[str, Any]:
    """Write the page on a result. Raises `RetargetError` for input that cannot be used."""
    check_page(output)
    if len(showing.sources) > 1:
        raise RetargetError(f"a report is on one result and one source; received {len(showing.sources)} sources")
    with progress_line(progress) as tell:
        tell("reading", 0)
        performers = performers_of(showing)
        title = " from ".join([showing.result.name, *(path.name for path in showing.sources)])
        with page_on(performers, title, output, tell) as page:
            pass
    return page.as_dict() | {"lines": page.lines}


def check_page(path: Path, folder: Path | None = None) -> None:
    """Raise `FileError` unless a page can be written there. `folder` is one that will be made before."""
    if path.suffix.lower() not in PAGE_SUFFIXES:
        raise FileError(path, "reports are written as .html")
    if path.is_dir():
        raise FileError(path, "is a folder")
    if folder is None or folder.is_dir() or path.absolute().parent != folder.absolute():
        check_folder(path)


@dataclass(frozen=True)
class Page:
    """A page that was made."""

    output: Path
    bytes: int
    frames: int
    bodies: int
    seconds: float
    """What making it took."""
    notes: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        bodies = "1 body" if self.bodies == 1 else f"{self.bodies} bodies"
        told = f"{self.bytes / 1e6:.1f} MB, {self.frames} frames, {bodies}, made in {self.seconds:.1f} s"
        return [f"{self.output}: {told}", *(f"note: {note}" for note in self.notes)]

    def as_dict(self) -> dict[str, Any]:
        told = {"output": str(self.output), "bytes": self.bytes, "seconds": round(self.seconds, 2)}
        return told | {"notes": list(self.notes)}


@contextmanager
def page_on(
    performers: Cast,
    title: str,
    output: Path,
    tell: Tell = untold,
    decided: Sequence[str] = (),
    warned: Sequence[str] = (),
) -> Iterator[Page]:
    """Measure and make the page on a result and the one source it has at most; it takes its place when the block ends well.

    `decided` and `warned` are sentences on how the result was made, where that is known. Raises `RetargetError`.
    """
    started = time.perf_counter()
    result, *sources = performers.takes.values()
    source = sources[0] if sources else None
    report = evaluate(source or result, result, tell=tell)
    before, turned, copy_note = _before(source, result, tell)
    report_of = {label: report.tracks.get(who) for label, who in zip(performers.takes, ("result", "source"))}
    tell("preparing the scene", 0)
    bodies = [stage_body(label, take, report_of[label]) for label, take in performers.takes.items()]
    tell("writing", 0)
    notes = [*performers.notes, *copy_note, *report.notes, *(note for body in bodies for note in body.notes)]
    sheet = _sheet(title, report, before, turned, bodies, decided, [*warned, *notes])
    shown = report if source else _alone(report)
    with page_about_to_stand(output, sheet, bodies, shown, before) as size:
        yield Page(output, size, len(result), len(bodies), time.perf_counter() - started, tuple(notes))


@dataclass(frozen=True, eq=False)
class Performance:
    """A clip that was retargeted in this process: what a page needs of it, without reading anything."""

    source: Path
    output: Path
    production: Production
    part: Motion
    """What was taken of the source's clip, at its own rate, in its file's space."""
    result: Result

    def page(self, output: Path, tell: Tell = untold) -> AbstractContextManager[Page]:
        """The page on it; as `page_on`."""
        source = self.production.source
        takes = {
            "result: " + _named(self.output, self.result.motion.name): Take(self.result.target, self.result.motion),
            "source: " + _named(self.source, self.part.name): Take(source, source.house_from_file.motion(self.part)),
        }
        together, notes = on_one_clock(takes)
        performers = Cast(dict(zip(takes, together)), notes)
        made_from = self.result.motion.made_from
        decided = [self.production.method, *([] if made_from is None else [f"made from {made_from}"])]
        warned = [*self.production.notes, *([] if self.result.status == "ok" else [self.result.status])]
        return page_on(performers, f"{self.output.name} from {self.source.name}", output, tell, decided, warned)


def performers_of(showing: Showing) -> Cast:
    """Read the result and its sources, in metres with +Y up, at one frame rate and of one length."""
    takes: dict[str, Take] = {}
    notes: list[str] = []
    for number, source in enumerate(showing.sources):
        found, clips, said = takes_of(showing.question(source))
        label = "source" if len(showing.sources) == 1 else f"source {number + 1}"
        takes.setdefault("result: " + _named(showing.result, clips["result"]), found["result"])
        takes[f"{label}: {_named(source, clips['source'])}"] = found["source"]
        notes += [note for note in said if note not in notes]
    if not showing.sources:
        takes, notes = _alone_take(showing)
    together, said = on_one_clock(takes)
    return Cast(dict(zip(takes, together)), notes + said)


def _alone_take(showing: Showing) -> tuple[dict[str, Take], list[str]]:
    asset = load(showing.result)
    number = showing.clip if showing.clip is not None or not asset.clips else len(asset.clips) - 1
    motion = asset.motion(number)
    joints = None
    if showing.map_file is not None:
        from retarget.correspond.map_file import read_map

        joints = read_map(showing.map_file)["target"] or None
    actor = cast(asset, Hints(joints), motion)
    shown = actor.house_from_file.motion(motion)
    if showing.start is not None or showing.end is not None:
        shown = cut(shown, showing.start, showing.end)
    several = showing.clip is None and len(asset.clips) > 1
    notes = (
        [f"the result holds {len(asset.clips)} clips; {motion.name!r} is taken (--clip to choose)"] if several else []
    )
    return {"result: " + _named(showing.result, motion.name): Take(actor, shown)}, notes


def _named(path: Path, clip: str) -> str:
    return path.name if clip in ("", path.stem) else f"{path.name} [{clip}]"


def _before(source: Take | None, result: Take, tell: Tell) -> tuple[Report | None, list[str], list[str]]:
    """The copied joint angles measured like the result, what the result turned beyond them, and why there is none."""
    if source is None:
        return None, [], []
    try:
        copied = copied_take(source, result)
    except RetargetError as error:
        return None, [], [f"what was corrected is not known: {error}"]
    turned = list(turned_joints(copied.motion, result.motion, result.actor.humanoid))
    return evaluate(source, copied, tell=lambda doing, n=0: tell(f"uncorrected {doing}", n)), turned, []


def _alone(report: Report) -> Report:
    """A report without what it says of a source, for a result that was measured against itself."""
    figures = {
        name: value
        for name, value in report.figures.items()
        if name in ("frames", "seconds", "fps") or name.startswith(ALONE)
    }
    curves = {
        name: curve for name, curve in report.curves.items() if "/source/" not in name and not name.endswith("/source")
    }
    return replace(report, figures=figures, curves=curves)


def _sheet(
    title: str,
    report: Report,
    before: Report | None,
    turned: list[str],
    bodies: list[StageBody],
    decided: Sequence[str],
    notes: list[str],
) -> Sheet:
    alone = len(bodies) == 1
    columns: list[tuple[str, Callable[[str], Any]]] = [("result", report.figures.get)]
    if before is not None:
        columns.insert(0, ("copied only", before.figures.get))
    if not alone:
        columns.append(("source", lambda key: report.figures.get(f"source_{key}")))
    told = _alone(report).figures if alone else report.figures
    figures = report.figures
    source = "" if alone else f", the source {report.source_height:.2f} m"
    subtitle = (
        f"{figures['frames']:.0f} frames, {figures['seconds']:.2f} s at {figures['fps']:g} frames a second; "
        f"the body is {report.height:.2f} m tall{source}. It rests on: {report.facts['rests on']}."
    )
    if "deepest" in report.facts:
        subtitle += f" Deepest in itself: {report.facts['deepest']}."
    return Sheet(
        title,
        subtitle,
        tuple(head for head, _ in columns),
        tuple(_rows(columns, told)),
        report.problems,
        tuple([*_gained(report, before), *turned]),
        (*decided, *_inferred(bodies)),
        tuple(notes),
    )


def _rows(columns: list, told: dict[str, Any]) -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    for group, rows in ROWS:
        for key, words, unit, factor in rows:
            if told.get(key) is not None:
                values = [figure(key) for _, figure in columns]
                yield group, words, tuple("" if each is None else f"{each * factor:.2f}" for each in values), unit
                group = ""


def _gained(report: Report, before: Report | None) -> Iterator[str]:
    """The figures that correction is for, before and after."""
    if before is None:
        return
    words = {key: (text, unit, factor) for _, rows in ROWS for key, text, unit, factor in rows}
    for key in FIRST_ROWS:
        values = [each.figures.get(key) for each in (before, report)]
        if None not in values:
            text, unit, factor = words[key]
            first, second = (value * factor for value in values)
            yield f"{text}: {first:.2f} {unit} with joint angles copied, {second:.2f} {unit} in the result"


def _inferred(bodies: list[StageBody]) -> Iterator[str]:
    for body in bodies:
        actor = body.take.actor
        who = body.label.split(":")[0]
        yield (
            f"{who}: {actor.height:.3f} m tall, {actor.house_from_file.scale:g} metres per unit of the file; "
            f"{len(actor.skeleton)} joints, {len(actor.humanoid.joints)} of them matched by {actor.humanoid.evidence}"
        )
        yield from (f"{who}: {note}" for note in actor.notes)


def _telling(tell: Tell, who: str) -> Tell:
    return lambda doing, finished=0: tell(f"{who}: {doing}", finished)


def view_files(showing: Showing, port: int | None = None, open_browser: bool = True, progress: bool = False) -> None:
    """Show bodies in a browser until Ctrl-C. Raises `RetargetError` for input that cannot be used, without viser, and for
    a port that is taken."""
    from retarget.view.live_server import require_viser
    from retarget.view.viewer import Viewer

    require_viser()  # said before minutes of reading
    with progress_line(progress) as tell:
        tell("reading", 0)
        performers = performers_of(showing)
        bodies = [
            stage_body(label, take, tell=_telling(tell, label.split(":")[0]))
            for label, take in performers.takes.items()
        ]
    for note in [*performers.notes, *(note for body in bodies for note in body.notes)]:
        print(f"note: {note}")
    viewer = Viewer(bodies, port)
    try:
        print(f"{viewer.address} (Ctrl-C ends)", flush=True)
        if open_browser:
            import webbrowser

            webbrowser.open(viewer.address)
        viewer.play()
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        viewer.close()
