"""Damaged files: whatever is done to one, reading it ends in a result or in one line, soon.

    python -m retarget.evaluate.damage FOLDER SUFFIX FIRST STOP

reads FOLDER/n.SUFFIX for every number and prints what came of it, so that whoever started it knows which file took it down.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.errors import RetargetError

SECONDS = 30.0
"""For one file."""


@dataclass(frozen=True)
class Outcomes:
    """What came of damaged files of one format."""

    read: int
    refused: int
    crashes: int
    """Readers that raised anything but `RetargetError`, or whose process went down."""
    hangs: int
    """Readers that took longer than `SECONDS`."""


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """The bytes with a few changed, cut out, doubled or overwritten, or cut off."""
    changed = bytearray(content)
    for _ in range(int(random.integers(1, 4))):
        place, length = int(random.integers(len(changed))), int(random.integers(1, 40))
        kind = int(random.integers(5))
        if kind == 0:
            changed[place] = int(random.integers(256))
        elif kind == 1:
            del changed[place : place + length]
        elif kind == 2:
            changed[place:place] = changed[place : place + length]
        elif kind == 3:
            changed[place : place + length] = random.bytes(length)
        elif random.random() < 0.2:
            del changed[place:]
        if not changed:
            return b""
    return bytes(changed)


def outcomes(seeds: list[Path], count: int, folder: Path, seed: int) -> Outcomes:
    """Damage the seeds (files of one suffix), each in turn, and read what comes of it in processes of their own."""
    random, suffix = np.random.default_rng(seed), seeds[0].suffix
    contents = [path.read_bytes() for path in seeds]
    for number in range(count):
        (folder / f"{number}{suffix}").write_bytes(damaged(contents[number % len(contents)], random))
    found, number = {"read": 0, "refused": 0, "raised": 0}, 0
    down = hangs = 0
    while number < count:
        said, hung = _read_on(folder, suffix, number, count)
        for word in said:
            found[word] += 1
        number += len(said)
        if number < count:  # the file after the last one that was told took the reader down
            number, down, hangs = number + 1, down + (not hung), hangs + hung
    return Outcomes(found["read"], found["refused"], found["raised"] + down, hangs)


def _read_on(folder: Path, suffix: str, first: int, stop: int) -> tuple[list[str], bool]:
    """What a process says of the files from the first on, until it ends, and whether it was ended for its silence."""
    command = [sys.executable, "-m", "retarget.evaluate.damage", str(folder), suffix, str(first), str(stop)]
    said, hung = [], threading.Event()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:

        def end() -> None:
            hung.set()
            process.kill()

        timer = threading.Timer(SECONDS + 10.0, end)
        timer.start()
        for line in process.stdout:
            timer.cancel()
            said.append(line.strip())
            timer = threading.Timer(SECONDS, end)
            timer.start()
        timer.cancel()
    return said, hung.is_set()


def main() -> None:
    """Read one file after the other; see above."""
    from retarget.io import load

    folder, suffix, first, stop = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    for number in range(first, stop):
        try:
            asset = load(folder / f"{number}{suffix}")
            if asset.clips:
                asset.motion(0)
            word = "read"
        except RetargetError:
            word = "refused"
        except Exception:
            word = "raised"
        print(word, flush=True)


if __name__ == "__main__":
    main()
