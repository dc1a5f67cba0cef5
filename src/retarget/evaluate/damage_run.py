"""Many damaged files of one format: whatever is done to one, reading it ends in a result or in one line, soon.

    python -m retarget.evaluate.damage_run SEED_FILE ... [--count 100000] [--first 0] [--name 1] [--keep FOLDER]

damages the seed files in turn (all of one suffix, each with what lies beside it), reads each result and counts. A damage is
known by its number: `--first N --count 1` repeats it, and `--keep` leaves the file. The readers work in a process of their own,
which tells what came of each number, so that whoever started it knows which one took it down; where the readers have children
in turn, for native parsers, these are forks of it (`io/child_fork.py`), where that is possible. Exit code 1 for any crash or hang.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from retarget.errors import RetargetError
from retarget.evaluate.damage import damage

SECONDS = 10.0
"""For one file; what takes longer hangs."""
STARTING = 50.0
"""For loading all that readers need, before the first file."""
SAID = ("read", "refused", "contained")


@dataclass(frozen=True)
class Outcomes:
    """What came of damaged files of one format."""

    read: int
    refused: int
    crashes: int
    """Readers that raised anything but `RetargetError`, said more than one line, or whose process went down."""
    hangs: int
    """Readers that took longer than `SECONDS`."""
    contained: int = 0
    """Of the refused, those on which a native parser went down in the process of its own that it has for this."""
    faults: tuple[str, ...] = ()
    """The number of each crash and hang, and what happened."""

    @property
    def count(self) -> int:
        return self.read + self.refused + self.crashes + self.hangs


def outcomes(
    seeds: Sequence[Path], count: int, name: str = "1", first: int = 0, tell: Callable[[str], None] = lambda line: None
) -> Outcomes:
    """Damage the seeds (files of one suffix, in folders that may be written in), each in turn, and read what comes of it in
    processes of their own."""
    found, number, faults = dict.fromkeys(SAID, 0), first, []
    crashes = hangs = 0
    while number < first + count:
        said, hung = _read_on(seeds, name, number, first + count)
        for line in said:
            if line in found:
                found[line] += 1
            else:
                crashes += 1
                faults.append(f"{number}: {line}")
                tell(faults[-1])
            number += 1
        if number < first + count:  # the file after the last one that was told took the reader down
            faults.append(f"{number}: {'hangs' if hung else 'its process went down'}")
            tell(faults[-1])
            number, crashes, hangs = number + 1, crashes + (not hung), hangs + hung
    return Outcomes(found["read"], found["refused"] + found["contained"], crashes, hangs, found["contained"], tuple(faults))


def _read_on(seeds: Sequence[Path], name: str, first: int, stop: int) -> tuple[list[str], bool]:
    """What a process says of the damages from the first on, until it ends, and whether it was ended for its silence."""
    command = [sys.executable, "-m", "retarget.evaluate.damage_run", "--readers", "--name", name]
    command += ["--first", str(first), "--count", str(stop - first), *map(str, seeds)]
    environment = os.environ | {"PXR_WORK_THREAD_LIMIT": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True, "env": environment}
    said, hung = [], threading.Event()
    with subprocess.Popen(command, start_new_session=True, **quiet) as process:

        def end() -> None:
            hung.set()
            _end(process)

        timer = threading.Timer(SECONDS + STARTING, end)
        timer.start()
        for line in process.stdout:
            timer.cancel()
            said.append(line.strip())
            timer = threading.Timer(SECONDS, end)
            timer.start()
        timer.cancel()
        _end(process)
    for left in {path for seed in seeds for path in seed.parent.glob(f"damaged-{process.pid}-*")}:
        left.unlink()
    return said, hung.is_set()


def _end(process: subprocess.Popen) -> None:
    """End readers with the children that they have."""
    if hasattr(os, "killpg"):
        import signal

        try:
            os.killpg(process.pid, signal.SIGKILL)
            return
        except ProcessLookupError:
            pass  # gone by itself
    process.kill()


def _readers(seeds: Sequence[Path], name: str, first: int, count: int) -> None:
    """Read one damaged file after the other under the limits of a child; a line each."""
    import warnings

    from retarget.io import child
    from retarget.io.child_fork import forking, in_this_process

    warnings.simplefilter("ignore")
    child.limit()
    contents = [path.read_bytes() for path in seeds]
    forks = hasattr(os, "fork")
    with in_this_process() if forks else nullcontext():
        for seed in seeds:
            read(seed)
    with forking() if forks else nullcontext():
        for number in range(first, first + count):
            seed = seeds[number % len(seeds)]
            path = seed.with_name(f"damaged-{os.getpid()}-{number}{seed.suffix}")
            path.write_bytes(damage(contents[number % len(seeds)], name, number, seed.suffix))
            try:
                print(read(path), flush=True)
            finally:
                path.unlink(missing_ok=True)


def read(path: Path) -> str:
    """What becomes of one file: 'read', 'refused', 'contained' (its parser went down), or what is wrong."""
    import traceback

    from retarget.io import load

    try:
        asset = load(path)
        if asset.clips:
            asset.motion(0)
        if not all(note.isprintable() for note in asset.notes):
            return f"noted what is no line: {asset.notes!r}"
        return "read"
    except RetargetError as error:
        if isinstance(error.__context__, MemoryError):
            return "wanted more memory than a small file can need"
        if not str(error).isprintable():
            return f"said what is no line: {str(error)!r}"
        return "contained" if "(SIG" in str(error) or "(exit code" in str(error) else "refused"
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return ascii(f"raised {type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"[:300])[1:-1]


def main() -> None:
    """The command above; with `--readers` the process that reads."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("seeds", nargs="+", type=Path, help="valid files of one suffix")
    words.add_argument("--count", type=int, default=2000)
    words.add_argument("--first", type=int, default=0)
    words.add_argument("--name", default="1", help="another name, other damage")
    words.add_argument("--keep", type=Path, help="write the damaged files into this folder, and read none")
    words.add_argument("--readers", action="store_true", help=argparse.SUPPRESS)
    asked = words.parse_args()
    if asked.readers:
        _readers(asked.seeds, asked.name, asked.first, asked.count)
    elif asked.keep:
        for number in range(asked.first, asked.first + asked.count):
            seed = asked.seeds[number % len(asked.seeds)]
            content = damage(seed.read_bytes(), asked.name, number, seed.suffix)
            (asked.keep / f"{number}{seed.suffix}").write_bytes(content)
    else:
        for seed in asked.seeds:
            if (word := read(seed)) != "read":
                sys.exit(f"{seed} is no valid file: {word}")
        started = time.perf_counter()
        found = outcomes(asked.seeds, asked.count, asked.name, asked.first, lambda line: print(line, flush=True))
        print(
            f"{asked.seeds[0].parent.name} {asked.seeds[0].suffix}: {found.count} files in {time.perf_counter() - started:.0f} s: {found.read} read, "
            f"{found.refused} refused ({found.contained} of them by a parser that went down), {found.crashes} crashes, {found.hangs} hangs"
        )
        sys.exit(bool(found.crashes or found.hangs))


if __name__ == "__main__":
    main()
