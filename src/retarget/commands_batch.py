"""What `retarget batch` does: every motion of a folder onto every character of another."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from retarget.batch.manifest import NAME, file_hash
from retarget.batch.run import WORK, Batch, Failure, Summary, run_batch
from retarget.batch.work import Settings, perform
from retarget.character import Motion
from retarget.commands_view import Page, Performance
from retarget.errors import FileError, RetargetError
from retarget.methods import Result
from retarget.motion.align import AXES
from retarget.motion.filter import FASTEST
from retarget.progress import progress_line
from retarget.retargeting import Production, choose_method

log = logging.getLogger("retarget")

WITH_SURFACE = (".vrm", ".abc")
"""Formats of whole bodies or their surfaces: animation alone is none of theirs."""

WIDEST = 60
"""Characters of a name in the table of failures."""
LONGEST = 160
"""Characters of a reason there; the manifest has it whole."""


def make_batch(
    motions: Path,
    characters: Path,
    folder: Path,
    *,
    jobs: int | None = None,
    timeout: float = 0.0,
    suffix: str | None = None,
    pages: bool = False,
    map_file: Path | None = None,
    contacts: Path | None = None,
    smpl_model: Path | None = None,
    **settings: Any,
) -> Batch:
    """The batch that was asked for. `settings` are those of `batch.work.Settings`; `suffix` None is the preset's, or .glb.

    Raises `RetargetError` for every setting that no job could be done with, before anything is begun.
    """
    made = Settings(
        map_file=None if map_file is None else str(map_file.absolute()),
        map_hash=_hash(map_file),
        contacts=None if contacts is None else str(contacts.absolute()),
        contacts_hash=_hash(contacts),
        smpl_model=None if smpl_model is None else str(smpl_model.absolute()),
        smpl_model_hash=_hash(smpl_model),
        **settings,
    )
    choose_method(made.method, made.for_method())
    made.hints()  # raises for a map that cannot be read
    for option, up in (("--up", made.up), ("--target-up", made.target_up)):
        if up is not None and up not in AXES:
            raise RetargetError(f"{option}: {up!r} is unknown; use one of {', '.join(AXES)}")
    for option, unit in (("--unit", made.unit), ("--target-unit", made.target_unit)):
        if unit is not None and not 0 < unit < float("inf"):
            raise RetargetError(f"{option}: must be positive metres per unit, received {unit:g}")
    if made.fps is not None and not 0 < made.fps <= FASTEST:
        raise RetargetError(f"--fps: must be positive and at most {FASTEST:g}, received {made.fps:g}")
    if smpl_model is not None:
        from retarget.io.smpl_model import open_model

        open_model(smpl_model)  # raises for one that is none
    own = ".glb" if made.preset is None else made.preset.suffix  # raises for one that there is not
    suffix = own if suffix is None else f".{suffix.lower().removeprefix('.')}"
    if made.animation_only and suffix in WITH_SURFACE:
        raise RetargetError(f"--animation-only: a {suffix} holds no animation alone; write .glb, .fbx or .bvh")
    return Batch(motions, characters, folder, made, suffix, pages, jobs or _cores(), timeout or None)


def perform_with_pages(task: dict[str, Any]) -> dict[str, Any]:
    """What worker processes call where each result gets its page."""
    return perform(task, _page)


def _page(
    page: Path, source: Path, output: Path, production: Production, clip: Motion, result: Result
) -> AbstractContextManager[Page]:
    return Performance(source, output, production, clip, result).page(page)


def _hash(path: Path | None) -> str | None:
    try:
        return None if path is None else file_hash(path)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def report_batch(batch: Batch, progress: bool = False) -> dict[str, Any]:
    """Do the batch; "failed" lists what could not be done. Raises `RetargetError` for what cannot be begun."""
    started = time.perf_counter()
    work = f"{__name__}:{perform_with_pages.__name__}" if batch.pages else WORK
    summary = run_batch(batch, lambda steps: progress_line(progress, steps), work)
    for record in summary.done:
        for note in record["notes"]:
            log.info("%s: %s", record["output"], note)
    seconds = time.perf_counter() - started
    made = len(summary.done) - summary.done_before
    return {
        "folder": str(batch.folder),
        "manifest": str(batch.folder / NAME),
        "results": len(summary.done),
        "made": made,
        "done_before": summary.done_before,
        "incomplete": [{"output": each["output"], "status": each["status"]} for each in _incomplete(summary)],
        "failed": [
            {"motion": each.motion, "clip": each.clip, "character": each.character, "error": each.error}
            for each in summary.failures
        ],
        "passed_over": list(summary.passed_over),
        "processes": batch.processes,
        "seconds": round(seconds, 2),
        "clips_per_minute": round(60 * made / seconds, 1),
        "lines": [_printable(line) for line in _lines(batch, summary, seconds)],
    }


def _incomplete(summary: Summary) -> list[dict[str, Any]]:
    return [record for record in summary.done if record["status"] != "ok"]


def _lines(batch: Batch, summary: Summary, seconds: float) -> Iterator[str]:
    made = len(summary.done) - summary.done_before
    before = f", {summary.done_before} were there before" if summary.done_before else ""
    pages = ", a page beside each" if batch.pages else ""
    yield f"{batch.folder}: {made} clips made in {seconds:.1f} s by {batch.processes} processes{before}{pages}"
    if incomplete := _incomplete(summary):
        where = f'see "status" in {batch.folder / NAME}'
        yield f"  {len(incomplete)} of all {len(summary.done)} say what could not hold: {where}"
    for name in summary.passed_over:
        yield f"  passed over: {name} holds no animation"
    if summary.failures:
        yield f"  {len(summary.failures)} failed:"
        yield from _table(summary.failures)
        yield "  start the same command again to try these once more; what is done stays"


def _table(failures: tuple[Failure, ...]) -> Iterator[str]:
    rows = [("motion", "character", "why")]
    for each in failures:
        clip = f" [{each.clip}]" if each.clip else ""
        rows.append(
            (
                _short(each.motion + clip) or "(every motion)",
                _short(each.character) or "(every one)",
                _begin(each.error),
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    for row in rows:
        yield f"    {row[0]:{widths[0]}}  {row[1]:{widths[1]}}  {row[2]}"


def _short(text: str) -> str:
    return text if len(text) <= WIDEST else f"...{text[3 - WIDEST :]}"


def _begin(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _printable(text: str) -> str:
    """Names of files may hold bytes that are no text."""
    return text.encode(errors="replace").decode()
