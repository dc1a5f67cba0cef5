"""Readers of others that may crash, hang or fill the memory, run in a process of their own.

`run_child` starts this file as a program, which sets limits, loads the reader's script and calls its `convert(source,
output)`. What `convert` returns comes back as JSON; whatever goes wrong is a `ChildError`, which the caller words for its
format.

    python -I child.py READER.py SOURCE OUTPUT

Exit code 3: the reader raised, and the reason is on standard error. The end is `os._exit`, since wrappers of native
objects may bring the process down while they are torn down.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

MEMORY = 4 << 30
"""Bytes that a reader may take."""
CANNOT_READ = 3


class ChildError(Exception):
    """The reader gave no result; the text says why, in one line."""


class ChildTimeout(ChildError):
    """The reader was stopped after the time it had."""


def run_child(script: Path, source: Path, output: Path, seconds: float) -> Any:
    """Run a reader over a file; it writes `output` and what it says of the file is returned (JSON).

    Raises `ChildTimeout` after `seconds`, `ChildError` where it crashes, refuses the file or is not installed.
    """
    import subprocess

    command = [sys.executable, "-I", str(Path(__file__).resolve()), str(script), str(source), str(output)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=seconds, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        raise ChildTimeout(f"it takes longer than {seconds:g} s") from None
    if done.returncode == 0 and output.exists():
        try:
            return json.loads(done.stdout)
        except ValueError:
            raise ChildError("the reader stopped in the middle of its answer") from None
    said = done.stderr.strip().splitlines()
    raise ChildError(said[-1] if said else "the reader stopped without a word")


def main(script: str, source: str, output: str) -> None:
    """What runs in the child: limits, the reader's `convert`, its answer."""
    import runpy

    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    except (ImportError, ValueError, OSError):
        pass  # no such limits on this system; the caller's time limit remains
    try:
        found = json.dumps(runpy.run_path(script)["convert"](source, output))
    except Exception as error:  # whatever a broken file provokes is its fault; the caller words it
        sys.stderr.write(f"{type(error).__name__}: {error}"[:500].replace("\n", " "))
        sys.stderr.flush()
        os._exit(CANNOT_READ)
    sys.stdout.write(found)
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:4])
