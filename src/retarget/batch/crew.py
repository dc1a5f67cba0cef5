"""Processes that each do one task at a time, and may crash or hang without harm to the others.

A pool of the standard library breaks as a whole where one process dies, and does not say whose task it was. Here each
process has its own pipes: who dies or takes too long is known, is replaced, and the rest goes on. Tasks and answers are
JSON, so nothing but files and settings can travel.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from retarget.errors import RetargetError

Task = dict[str, Any]

PROGRAM = """import json, sys
sys.path[:] = json.loads(sys.argv[1])
from retarget.batch.worker import serve
serve(sys.argv[2])"""
"""What a process runs: the same code as this one, whatever main module and working directory there are."""

STARTING = 120.0
"""Seconds that a process may take to load what it works with; not counted as time of its first task."""


@dataclass(frozen=True)
class Outcome:
    """What became of one task: an answer, or why there is none."""

    task: Task
    answer: Any = None
    error: str | None = None
    """One line; None where all went well."""
    trace: str = ""
    """Where an unexpected exception came from."""


class Crew:
    """A number of processes that call one function, `work` ("module:function"), on tasks. Use it in a `with` block.

    The processes start when there is something to do and end with the block, or with this process, however it ends:
    each watches its input. `inherit` are file descriptors that they hold open as long as they live (POSIX).
    """

    def __init__(self, size: int, work: str, inherit: Sequence[int] = ()) -> None:
        self.work, self.inherit = work, tuple(inherit)
        self.members: list[_Member | None] = [None] * size
        self.heard: queue.Queue[tuple[_Member, dict | None]] = queue.Queue()

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *exception: Any) -> None:
        for member in self.members:
            if member is not None:
                member.end()

    def outcomes(self, choose: Callable[[Task | None], Task | None], seconds: float | None = None) -> Iterator[Outcome]:
        """Do tasks until `choose` has none; each outcome as it comes.

        `choose` is called with the last task of the process that is free (None for a new one) and returns its next, or
        None. A task that takes more than `seconds` is given up and its process killed. Raises `RetargetError` where
        processes cannot be started at all.
        """
        while True:
            for place, member in enumerate(self.members):
                if member is None or member.task is None:
                    task = choose(None if member is None else member.last)
                    if task is not None:
                        member = self.members[place] = member or _Member(self.work, self.inherit, self.heard)
                        member.give(task, seconds)
            if not any(member is not None and member.task is not None for member in self.members):
                return
            yield from self._next()

    def _next(self) -> Iterator[Outcome]:
        """At most one outcome: an answer that came, a process that ended, or one whose time is up."""
        due = min(member.due for member in self.members if member is not None and member.task is not None)
        try:
            wait = None if due == float("inf") else max(0.0, due - time.monotonic())
            member, message = self.heard.get(timeout=wait)
        except queue.Empty:
            late = [each for each in self.members if each and each.task is not None and each.due <= time.monotonic()]
            for member in late[:1]:
                self._dismiss(member)
                yield Outcome(member.task, error=f"took longer than {member.seconds:g} s and was given up")
            return
        if member not in self.members:  # the last words of one that was dismissed
            return
        if message is None:
            self._dismiss(member)
            if not member.ready:
                raise RetargetError(f"a worker process cannot start ({member.last_words()})")
            if member.task is not None:
                yield Outcome(member.task, error=f"its process stopped ({member.last_words()})")
        elif "ready" in message:
            member.ready = True
            member.begin()
        else:
            task, member.task, member.last = member.task, None, member.task
            yield Outcome(task, message.get("answer"), message.get("error"), message.get("trace", ""))

    def _dismiss(self, member: _Member) -> None:
        member.end()
        self.members[self.members.index(member)] = None


class _Member:
    """One process and what it is doing."""

    def __init__(self, work: str, inherit: tuple[int, ...], heard: queue.Queue) -> None:
        self.task: Task | None = None
        self.last: Task | None = None
        self.ready = False
        self.due = self.seconds = float("inf")
        self.errors = tempfile.TemporaryFile()
        with _interrupts_held_back():
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, json.dumps(sys.path), work],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.errors,
                **({"pass_fds": inherit} if os.name == "posix" else {}),
            )
        threading.Thread(target=self._listen, args=(heard,), daemon=True).start()

    def give(self, task: Task, seconds: float | None) -> None:
        self.task, self.seconds = task, seconds or float("inf")
        self.begin(0.0 if self.ready else STARTING)
        try:
            self.process.stdin.write(json.dumps(task).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:  # it is dead; the end of its output will say so
            pass

    def begin(self, later: float = 0.0) -> None:
        """The time of its task runs from now on, or from some seconds later."""
        self.due = time.monotonic() + self.seconds + later

    def _listen(self, heard: queue.Queue) -> None:
        with self.process.stdout as answers:
            for line in answers:
                if not line.endswith(b"\n"):
                    break  # died in the middle of a word
                heard.put((self, json.loads(line)))
        heard.put((self, None))

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        try:
            self.process.stdin.close()
        except OSError:
            pass

    def last_words(self) -> str:
        code = self.process.returncode
        how = f"exit code {code}"
        if code < 0:
            how = f"signal {-code}, {signal.Signals(-code).name}" if -code in set(signal.Signals) else f"signal {-code}"
        self.errors.seek(max(0, self.errors.seek(0, os.SEEK_END) - 4096))
        said = self.errors.read().decode(errors="replace").strip().splitlines()
        return f"{how}: {said[-1].strip()}" if said else how


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal: those started meanwhile are born deaf to it; here it comes later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
