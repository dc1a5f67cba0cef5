"""Work that may crash, hang or fill the memory, done in a process of its own: big native parsers, fed with files from
everywhere, and programs of others.

`run_child` calls `work(*arguments)` of a module of this folder in a new Python and returns what it told (anything that
JSON holds). The child starts isolated (`-I`), in an empty folder, without the variables that could lead a library
elsewhere, under limits of memory, file size and time, and leaves with `os._exit`: wrappers of native objects may bring a
process down while they are torn down. It loads the module alone, not the packages around it, whose own imports would
double the time that a start takes; for the same reason this file imports nothing at its top that the child needs not.

`run_program` runs somebody else's program to its end, under a limit of time.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

MEMORY = 4 << 30
"""Bytes that a child may take."""
LARGEST_FILE = 2 << 30
"""Bytes of any file that a child may write."""
LARGEST_REPLY = 64 << 20
"""Bytes of what a child may tell."""
LAST_WORDS = 4096
"""Bytes at the end of its standard error that are looked at."""
PACKAGES = Path(__file__).resolve().parents[2]
START = """
import importlib, sys, types
for name in ("retarget", "retarget.io"):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = ["/".join([sys.argv[1], *name.split(".")])]
importlib.import_module("retarget.io.child").answer(*sys.argv[2:])
"""
STEERING = ("PXR_", "USD_", "TF_", "AR_", "SDF_", "PCP_", "LD_PRELOAD", "DYLD_INSERT_LIBRARIES")
"""Beginnings of environment variables by which a parser could be led to other folders, plugins and files."""
ONE_THREAD = {name: "1" for name in ("PXR_WORK_THREAD_LIMIT", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""A child is one of many, and each thread's stack counts towards its memory."""


class ChildError(Exception):
    """A child gave no result; the text says why in one line, without the file's name."""


class Refused(ChildError):
    """Raised by the work for input that it declines, and by `run_child` in turn; the text is what the user reads."""


class ChildTimeout(ChildError):
    """It was stopped after the time it had."""


class ChildFailed(ChildError):
    """It crashed, raised something, could not be started, or left without an answer."""


def run_child(module: str, arguments: Sequence[str | Path], seconds: float) -> Any:
    """What `retarget.io.<module>.work(*arguments)` tells in a process of its own; all arguments arrive as strings.

    Raises `Refused` with what the work declined, `ChildTimeout` after `seconds`, `ChildFailed` for any other end.
    """
    import tempfile

    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        reply = Path(folder) / "reply.json"
        start(reply, module, arguments, seconds)
        found = _told(reply)
    if "refused" in found:
        raise Refused(found["refused"])
    if "failed" in found:
        raise ChildFailed(found["failed"])
    return found["told"]


def _new_python(reply: Path, module: str, arguments: Sequence[str | Path], seconds: float) -> None:
    """Let a new Python answer into `reply`."""
    command = [sys.executable, "-I", "-c", START, PACKAGES, str(reply), module, *arguments]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(STEERING)}
    run_program(command, seconds, kept | ONE_THREAD)


start = _new_python
"""How children are started; `child_fork.py` has another way, for those who read thousands of files."""


def _told(reply: Path) -> dict[str, Any]:
    try:
        if reply.stat().st_size > LARGEST_REPLY:
            raise ChildFailed(f"it told more than {LARGEST_REPLY} bytes")
        found = json.loads(reply.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ChildFailed("the process stopped in the middle of its answer") from None
    return found


def run_program(command: Sequence[str | Path], seconds: float, environment: Mapping[str, str]) -> None:
    """Run a program to its end, quietly, in an empty folder.

    Raises `ChildTimeout` after `seconds`, `ChildFailed` where it cannot be started or ends with an error: with the last
    line that it wrote to standard error.
    """
    import subprocess
    import tempfile

    until = time.monotonic() + seconds
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "bufsize": 0}
        try:
            process = subprocess.Popen(list(map(str, command)), cwd=folder, env=dict(environment), **quiet)
        except OSError as error:
            raise ChildFailed(f"{command[0]} cannot be started: {error.strerror or error}") from None
        with process:
            try:
                said = _last_words(process, seconds)
                code = process.wait(max(0.0, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                raise too_late(seconds) from None
            except BaseException:  # the user's Ctrl-C, above all
                process.kill()
                raise
    if code:
        lines = said.decode(errors="replace").strip().splitlines()
        words = [line for line in lines if not line.startswith("#")]  # USD tells within such what threads it was allowed
        raise went_down(code, words[-1].strip()[:500] if words else "")


def _last_words(process: Any, seconds: float) -> bytes:
    """The end of what a process writes to standard error until that is closed or time is up.

    Waiting for the pipe rather than for the process spares the 50 ms steps in which `Popen.wait` looks after it.
    """
    import threading

    kept = bytearray()

    def listen() -> None:
        while chunk := process.stderr.read(LAST_WORDS):
            kept.extend(chunk)
            del kept[:-LAST_WORDS]

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    listener.join(seconds)
    return bytes(kept)


def too_late(seconds: float) -> ChildTimeout:
    """The error of a process that was stopped after `seconds`."""
    return ChildTimeout(f"takes longer than {seconds:g} s; it is damaged, or larger than any we know")


def went_down(code: int, last_words: str = "") -> ChildFailed:
    """The error of a process that ended with an exit code, or with a signal (below zero)."""
    return ChildFailed(f"{last_words or 'the process stopped without a word'} ({_end(code)})")


def _end(code: int) -> str:
    """A process's end in words: the signal that stopped it, or its exit code."""
    import signal

    try:
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    except ValueError:
        return f"signal {-code}"


def answer(reply: str, module: str, *arguments: str) -> None:
    """What runs in the child: do the work under limits, write what it tells into `reply`, and end the process."""
    limit()
    give(reply, module, *arguments)
    os._exit(0)


def give(reply: str, module: str, *arguments: str, limited: bool = True) -> None:
    """Do the work and write what it tells into `reply`.

    That is one JSON object: `{"told": ...}`, `{"refused": a line}` or `{"failed": a line}`. Where the module has a function
    `memory`, the work is `limited` to the bytes that this allows for its arguments, if they are fewer than `MEMORY`.
    """
    try:
        loaded = importlib.import_module(f"retarget.io.{module}")
        if limited and hasattr(loaded, "memory"):
            _limit_memory(loaded.memory(*arguments))
        found = {"told": loaded.work(*arguments)}
        text = json.dumps(found)
    except Refused as refusal:
        text = json.dumps({"refused": _one_line(refusal)})
    except Exception as error:  # whatever a broken file provokes is its fault; the caller words it
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        text = json.dumps({"failed": kind + _one_line(error)})
    with open(reply, "w", encoding="utf-8") as file:
        file.write(text)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:500]


def limit() -> None:
    """Keep this process within the memory and file size that a child may have, where the system can."""
    try:
        import resource
    except ImportError:
        return  # no such limits on this system; the caller's time limit remains
    for kind, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, LARGEST_FILE), (resource.RLIMIT_CORE, 0)):
        try:
            resource.setrlimit(kind, (most, most))
        except (ValueError, OSError):
            continue  # a stricter limit is in force already


def _limit_memory(most: int) -> None:
    """A limit within the one in force, which may be raised again for the next work."""
    try:
        import resource
    except ImportError:
        return
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
