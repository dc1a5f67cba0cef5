"""Children as forks of this process, for those who read thousands of files one after the other.

A child of `child.py` is a new Python that loads its parser: 150 ms for FBX, half a second for USD. A fork has what this
process has loaded, and serves many files before it is renewed; the work, its limits and its answer are the same, and so is
what this process reads of it. It is less apart: it shares this process's environment, and what a parser kept of the files
before. Only where there is `os.fork`, and only for a process without threads.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from retarget.io import child

RENEWED = 100
"""Files after which a fork is renewed."""


@contextmanager
def in_this_process() -> Iterator[None]:
    """Until the block ends `child.run_child` does the work here: what forks then have. Only for files known to be sound."""
    before = child.start

    def here(reply: Path, module: str, arguments: Sequence[str | Path], _: float) -> None:
        child.give(str(reply), module, *map(str, arguments), limited=False)

    child.start = here
    try:
        yield
    finally:
        child.start = before


@contextmanager
def forking() -> Iterator[None]:
    """Until the block ends `child.run_child` has forks of this process do the work."""
    fork, before = Fork(), child.start
    child.start = fork.start
    try:
        yield
    finally:
        child.start = before
        fork.end()


class Fork:
    """A fork that works on demand, if there is one."""

    def __init__(self) -> None:
        self.number = self.served = 0
        self.asks = self.hears = -1

    def start(self, reply: Path, module: str, arguments: Sequence[str | Path], seconds: float) -> None:
        """Let the fork answer into `reply`. Raises `ChildTimeout` and `ChildFailed`, as a new Python does."""
        import select

        if not self.number:
            self._begin()
        os.write(self.asks, json.dumps([str(reply), module, *map(str, arguments)]).encode() + b"\n")
        answered = late = False
        try:
            late = not select.select([self.hears], [], [], seconds)[0]
            answered = not late and os.read(self.hears, 1) == b"."
        finally:  # Ctrl-C too
            self.served += 1
            code = 0 if answered and self.served < RENEWED else self.end(not answered and not late)
        if late:
            raise child.too_late(seconds)
        if not answered:
            raise child.went_down(code)

    def end(self, by_itself: bool = False) -> int:
        """Its exit code, once it is gone."""
        if not self.number:
            return 0
        if not by_itself:
            os.kill(self.number, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(self.number, 0)[1])
        os.close(self.asks)
        os.close(self.hears)
        self.number = self.served = 0
        return code

    def _begin(self) -> None:
        asked, self.asks = os.pipe()
        self.hears, heard = os.pipe()
        self.number = os.fork()
        if self.number == 0:
            try:
                os.close(self.asks)
                os.close(self.hears)
                _serve(asked, heard)
            finally:
                os._exit(1)
        os.close(asked)
        os.close(heard)


def _serve(asked: int, heard: int) -> None:
    """The fork's part: quietly, under limits, a dot for each answer."""
    faulthandler.disable()  # a parent's would write how a fork went down into the parent's log, which is told anyway
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    child.limit()
    with open(asked, encoding="utf-8") as lines:
        for line in lines:
            child.give(*json.loads(line))
            os.write(heard, b".")
    os._exit(0)
