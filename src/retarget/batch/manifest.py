"""What a run has done, one JSON object a line: the file that makes it resumable.

    {"settings": {…}, "digest": "…", "version": "0.1.0"}            a run began; the digest is of settings and version
    {"looked": "motions" or "characters", "file": "a/walk.bvh", "stamps": [[name, bytes, mtime_ns], …], "sha256": "…",
     "digest": "…", "clips": [[name, frames, fps], …],
     "moving": false}                                               a file can serve, moving: as a mesh sequence or capture;
                                                                    null for bytes and time: looked for, and not there;
                                                                    a folder of frames has a hash in the place of a time
    {"done": [motion, clip number, character], "inputs": [sha256, sha256], "digest": "…", "output": "…", "bytes": 1,
     "sha256": "…", "beside": [[name, bytes, sha256], …], "page": [name, bytes, sha256] or null, "clip": "…", "frames": 1,
     "fps": 30.0, "status": "ok", "notes": […], "seconds": 0.1}     beside: the files that the output refers to
    {"failed": [motion, clip number, character] or [role, file], "error": "…", "trace": "…"}

Later lines count more. A line is added when what it says is true on the disk, in one write; a process that is killed can
only leave the last line torn.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from retarget.errors import FileError

NAME = "manifest.jsonl"

Record = dict[str, Any]


class Manifest:
    """The manifest of a folder, open to be added to. Use it in a `with` block.

    A torn last line is taken away on opening. `records` are those it held then. Raises `FileError` where the file
    cannot be read or written.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        try:
            self._file = open(self.path, "ab+")
            self._file.seek(0)
            data = self._file.read()
            whole = _whole_lines(data)
            if len(whole) < len(data):
                self._file.truncate(len(whole))
            elif data and not data.endswith(b"\n"):
                self._file.write(b"\n")
            self._file.flush()
        except OSError as error:
            raise FileError(self.path, f"cannot be written: {error.strerror or error}") from None
        self.records = list(_parsed(whole))

    def __enter__(self) -> Manifest:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._file.close()

    def add(self, record: Record) -> None:
        """One line more, on the disk when this returns."""
        try:
            self._file.write(json.dumps(record, separators=(",", ":")).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FileError(self.path, f"cannot be written: {error.strerror or error}") from None


def _whole_lines(data: bytes) -> bytes:
    """Without a last line that has no end, unless it lacks nothing else."""
    end = data.rfind(b"\n") + 1
    return data if any(_parsed(data[end:])) else data[:end]


def _parsed(data: bytes) -> Iterator[Record]:
    for line in data.splitlines():
        try:
            record = json.loads(line)
        except (ValueError, RecursionError):  # torn, and not ours to mend
            continue
        if isinstance(record, dict):
            yield record


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def stands(folder: Path, record: Record, page: bool = False) -> bool:
    """Whether the output of a 'done' line and the files it refers to are there, with the sizes and hashes they had; and its
    page, if that is wanted."""
    try:
        path = folder / record["output"]
        files = [(path, record["bytes"], record["sha256"])]
        others = [*record["beside"], *([record["page"]] if page else [])]
        files += [(path.parent / name, size, known) for name, size, known in others]
        return all(path.stat().st_size == size and file_hash(path) == known for path, size, known in files)
    except (OSError, KeyError, TypeError, ValueError):
        return False
