"""Parts of readers and writers that run in a process of their own: big native parsers, fed with files from everywhere.

The parent runs `run_child` with the module and what it is to work on; in the child `answer` sets the limits, calls the
work, and leaves with `os._exit`, so that nothing that a library does at exit matters. What the child found is one JSON
file: `{"told": ...}`, `{"refused": a line}` for input that the work itself declined, `{"failed": a line}` for the rest.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from retarget.errors import FileError

MEMORY = 4 << 30
"""Bytes that a child may take."""
LARGEST_FILE = 2 << 30
"""Bytes of any file that a child may write."""
PACKAGES = Path(__file__).resolve().parents[2]
START = (
    "import importlib, sys; sys.path.insert(0, sys.argv[1]); importlib.import_module(sys.argv[2]).main(*sys.argv[3:])"
)
STEERING = ("PXR_", "USD_", "TF_", "AR_", "SDF_", "PCP_")
"""Beginnings of environment variables by which USD could be led to other folders, plugins and files."""


class Refused(Exception):
    """Raised by the work in the child for input that it declines; the text is what the user reads."""


class ChildFailed(Exception):
    """The child gave no result; the text is the reason, without the file's name."""


def run_child(path: Path, module: str, arguments: Sequence[str], seconds: float) -> dict[str, Any]:
    """What `module.main(*arguments, reply)` tells in a process of its own.

    It starts in an empty folder, with nothing of the environment that could lead it elsewhere. Raises `FileError` about
    `path` with what the work declined, or for one that takes longer than `seconds`; `ChildFailed` for any other end.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith(STEERING)}
    environment["PXR_WORK_THREAD_LIMIT"] = "1"
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        reply = Path(folder) / "reply.json"
        command = [sys.executable, "-I", "-c", START, str(PACKAGES), module, *arguments, str(reply)]
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        try:
            subprocess.run(command, timeout=seconds, cwd=folder, env=environment, **quiet)
        except subprocess.TimeoutExpired:
            problem = f"takes longer than {seconds:g} s; it is damaged, or larger than any we know"
            raise FileError(path, problem) from None
        try:
            found = json.loads(reply.read_text())
        except (OSError, ValueError):
            raise ChildFailed("the process stopped without a word") from None
    if "refused" in found:
        raise FileError(path, found["refused"])
    if "failed" in found:
        raise ChildFailed(found["failed"])
    return found["told"]


def answer(reply: str, work: Callable[[], dict[str, Any]]) -> None:
    """Call the work under limits, write what it found into `reply`, and end the process."""
    limit()
    try:
        found = {"told": work()}
    except Refused as refusal:
        found = {"refused": _one_line(refusal)}
    except Exception as error:  # whatever a broken file provokes is its fault; the caller words it
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        found = {"failed": kind + _one_line(error)}
    with open(reply, "w") as file:
        json.dump(found, file)
    os._exit(0)


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
