"""A whole batch: look at the files, plan, and do what is not done yet."""

from __future__ import annotations

import re
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from retarget.batch.crew import Crew, Outcome, Task
from retarget.batch.lock import held_alone
from retarget.batch.manifest import Manifest, Record, stands
from retarget.batch.plan import Clips, Input, Job, find_inputs, plan_jobs, refuse_overwriting, unchanged
from retarget.batch.work import Settings
from retarget.errors import FileError, RetargetError
from retarget.io import check_format
from retarget.io.file_names import natural_order
from retarget.progress import Tell, untold

WORK = "retarget.batch.work:perform"
RESERVED = ("manifest.jsonl", ".batch.lock")

_TEMPORARY = re.compile(r"\..+\.[0-9]+\.tmp")
"""As writers name what is not whole yet; see `io.whole_file`."""


@dataclass(frozen=True)
class Batch:
    """What is to be done."""

    motions: Path
    characters: Path
    folder: Path
    settings: Settings = field(default_factory=Settings)
    suffix: str = ".glb"
    pages: bool = False
    """Whether each result gets a page beside it; `run_batch` is then told of a `work` that can make them."""
    processes: int = 1
    seconds: float | None = None
    """What one clip may take; None for as long as it wants."""


@dataclass(frozen=True)
class Failure:
    """What could not be done."""

    motion: str
    """Empty where the character is to blame."""
    clip: str
    character: str
    """Empty where the motion is to blame."""
    error: str


@dataclass(frozen=True)
class Summary:
    """How a batch ended."""

    done: tuple[Record, ...]
    """Lines of the manifest that stand, of this run and of earlier ones, in the order of the plan."""
    done_before: int
    """How many of them are of earlier runs."""
    failures: tuple[Failure, ...]
    passed_over: tuple[str, ...]
    """Motion files without any animation."""


def run_batch(batch: Batch, show: Callable[[int], Any] | None = None, work: str = WORK) -> Summary:
    """Put every motion onto every character, as far as that is not done yet.

    Failures are collected. `show`, given the number of steps, returns a context with a `Tell` (`progress_line`).
    `work` is what the worker processes call. Raises `RetargetError` for what cannot be begun: settings, folders,
    another run in the folder.
    """
    check_format(batch.folder / f"*{batch.suffix}")
    motions = find_inputs(batch.motions, without=batch.folder, sequences=True)
    if batch.settings.smpl_model is not None and not any(file.path.suffix.lower() == ".npz" for file in motions):
        raise RetargetError(f"--smpl-model {batch.settings.smpl_model} is for motions in .npz, and none is given")
    characters = find_inputs(batch.characters, without=batch.folder)
    for given in (batch.motions, batch.characters):
        if given.resolve() == batch.folder.resolve():
            raise FileError(batch.folder, "holds the inputs; name another folder for the results")
    try:
        batch.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(batch.folder, f"cannot be made a folder: {error.strerror or error}") from None
    with held_alone(batch.folder) as lock, Manifest(batch.folder) as manifest, _without_temporaries(batch.folder):
        with Crew(batch.processes, work, inherit=[lock]) as crew:
            run = _Run(batch, manifest, crew)
            with _shown(show, len(motions) + len(characters)) as tell:
                clips, bodies, passed_over = run.look(motions, characters, tell)
            unread = sorted(run.failures, key=lambda each: (each.character, natural_order(each.motion)))
            jobs = plan_jobs(clips, bodies, batch.suffix, RESERVED)
            refuse_overwriting(jobs, [*motions, *characters], batch.folder)
            with _shown(show, len(jobs)) as tell:
                before = run.work(jobs, tell)
    order = [job.key for job in jobs]
    done = tuple(run.done[key] for key in order if key in run.done)
    return Summary(done, before, (*unread, *run.undone(jobs)), tuple(passed_over))


@contextmanager
def _without_temporaries(folder: Path) -> Iterator[None]:
    """What writers left is taken away: before, of a run that was killed; after, of processes that this one killed."""
    remove_temporaries(folder)
    try:
        yield
    finally:
        remove_temporaries(folder)


def _shown(show: Callable[[int], Any] | None, steps: int) -> Any:
    return nullcontext(untold) if show is None else show(steps)


def remove_temporaries(folder: Path) -> None:
    """Take away what killed writers left, in and below a batch's own folder."""
    for path in folder.rglob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


class _Run:
    """One run under way: what the manifest knew, and what came since."""

    def __init__(self, batch: Batch, manifest: Manifest, crew: Crew) -> None:
        self.batch, self.manifest, self.crew = batch, manifest, crew
        self.digest = batch.settings.digest()
        self.done: dict[tuple, Record] = {}
        self.failures: list[Failure] = []
        """Files that cannot be read or serve."""
        self.errors: dict[tuple, str] = {}
        """Of jobs that failed."""
        self.hashes: dict[tuple[str, str], str] = {}
        """Of a file of the role "motions" or "characters", by role and name."""
        last = [record.get("digest") for record in manifest.records if "settings" in record][-1:]
        if last != [self.digest]:
            from retarget import __version__

            manifest.add({"settings": asdict(batch.settings), "digest": self.digest, "version": __version__})

    def look(
        self, motions: Sequence[Input], characters: Sequence[Input], tell: Tell
    ) -> tuple[list[Clips], list[Input], list[str]]:
        """Motions with their clips, characters that can serve, and motion files without animation."""
        known = {
            (record["looked"], record["file"]): record
            for record in self.manifest.records
            if "looked" in record and record.get("digest") == self.digest
        }
        seen: dict[tuple[str, str], Record] = {}
        tasks = deque()
        for role, files in (("characters", characters), ("motions", motions)):
            for file in files:
                record = known.get((role, file.name), {})
                if unchanged(file.path, record.get("stamps")):
                    seen[role, file.name] = record
                    self.hashes[role, file.name] = record["sha256"]
                    tell("", 1)
                else:
                    task = {"do": "look", "role": role, "path": str(file.path), "settings": asdict(self.batch.settings)}
                    tasks.append(task | {"file": file.name})
        tell("looking at the files")
        for outcome in self.crew.outcomes(lambda last: tasks.popleft() if tasks else None, self.batch.seconds):
            role, name = outcome.task["role"], outcome.task["file"]
            tell(f"looking at {name}", 1)
            if outcome.error is not None:
                of_motion = role == "motions"
                self._fail(outcome, [role, name])
                self.failures.append(Failure(name if of_motion else "", "", "" if of_motion else name, outcome.error))
                continue
            seen[role, name] = outcome.answer
            self.hashes[role, name] = outcome.answer["sha256"]
            line = {"looked": role, "file": name, "digest": self.digest}
            self.manifest.add(line | outcome.answer)
        read = [(file, seen["motions", file.name]) for file in motions if ("motions", file.name) in seen]
        clips = [
            Clips(file, tuple(clip[0] for clip in record["clips"]), record.get("moving", False))
            for file, record in read
            if record["clips"]
        ]
        bodies = [file for file in characters if ("characters", file.name) in seen]
        return clips, bodies, [file.name for file, record in read if not record["clips"]]

    def work(self, jobs: Sequence[Job], tell: Tell) -> int:
        """Do all jobs that are not done; returns how many were."""
        for record in self.manifest.records:
            if "done" in record:
                self.done[tuple(record["done"])] = record
        tell("checking what is there")
        self.done = {job.key: self.done[job.key] for job in jobs if self._is_done(job)}
        before = len(self.done)
        tell("", before)
        waiting = _Waiting(job for job in jobs if job.key not in self.done)
        by_key = {job.key: job for job in jobs}
        tell("starting" if before < len(jobs) else "")

        def choose(last: Task | None) -> Task | None:
            job = waiting.take(by_key.get(tuple(last.get("job", ()))) if last else None)
            return None if job is None else self._task(job)

        for outcome in self.crew.outcomes(choose, self.batch.seconds):
            job = by_key[tuple(outcome.task["job"])]
            if outcome.error is None:
                said = {"inputs": outcome.task["inputs"], "digest": self.digest, "output": job.output}
                self.done[job.key] = {"done": list(job.key), "clip": job.clip_name, **said, **outcome.answer}
                self.manifest.add(self.done[job.key])
            else:
                self._fail(outcome, list(job.key))
                self.errors[job.key] = outcome.error
            tell(job.title, 1)
        return before

    def _is_done(self, job: Job) -> bool:
        record = self.done.get(job.key, {})
        wanted = {"inputs": self._inputs(job), "digest": self.digest, "output": job.output, "clip": job.clip_name}
        same = all(record.get(name) == value for name, value in wanted.items())
        return same and stands(self.batch.folder, record, self.batch.pages)

    def _inputs(self, job: Job) -> list[str]:
        return [self.hashes["motions", job.motion.name], self.hashes["characters", job.character.name]]

    def _task(self, job: Job) -> Task:
        output = self.batch.folder.absolute() / job.output
        return {
            "do": "clip",
            "job": list(job.key),
            "motion": str(job.motion.path),
            "clip": job.clip,
            "character": str(job.character.path),
            "inputs": self._inputs(job),
            "output": str(output),
            "page": str(output.with_suffix(".html")) if self.batch.pages else None,
            "settings": asdict(self.batch.settings),
        }

    def undone(self, jobs: Sequence[Job]) -> list[Failure]:
        """The jobs that failed, in the order of the plan."""
        failed = [job for job in jobs if job.key in self.errors]
        return [Failure(job.motion.name, job.clip_name, job.character.name, self.errors[job.key]) for job in failed]

    def _fail(self, outcome: Outcome, key: list) -> None:
        self.manifest.add(
            {"failed": key, "error": outcome.error, **({"trace": outcome.trace} if outcome.trace else {})}
        )


class _Waiting:
    """Jobs not begun yet. A process goes on with its character, or with the performer of its sequence or capture, while
    there is work for it: that is ready in its memory."""

    def __init__(self, jobs: Iterable[Job]) -> None:
        self.of: dict[tuple[str, str], deque[Job]] = defaultdict(deque)
        """By what is kept for them."""
        for job in jobs:
            self.of[job.kept].append(job)
        self.served: dict[tuple[str, str], int] = dict.fromkeys(self.of, 0)
        """How many processes took up each."""

    def take(self, last: Job | None) -> Job | None:
        """The next job for a process that did `last`; where nothing that it keeps is needed, one of what few work on."""
        left = [each for each, jobs in self.of.items() if jobs]
        if not left:
            return None
        kept = None if last is None else last.kept
        if kept not in left:
            kept = min(left, key=lambda each: (self.served[each], -len(self.of[each])))
            self.served[kept] += 1
        return self.of[kept].popleft()
