"""Who is put onto whom, and where the results go."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from retarget.errors import FileError, RetargetError
from retarget.io import MOTION_SUFFIXES
from retarget.io.file_names import distinct, natural_order, portable
from retarget.io.mesh_folder import expect_no_frames

Key = tuple[str, int, str]
"""A job: motion, number of its clip, character; files by their names below the folders given."""


@dataclass(frozen=True)
class Input:
    """A file that takes part."""

    path: Path
    """Absolute."""
    name: str
    """Below the folder that was given, '/' between the parts: what it is called everywhere."""


@dataclass(frozen=True)
class Clips:
    """A motion file and the clips it holds."""

    file: Input
    names: tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """One clip onto one character."""

    motion: Input
    clip: int
    clip_name: str
    character: Input
    output: str
    """Below the output folder."""

    @property
    def key(self) -> Key:
        return self.motion.name, self.clip, self.character.name

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.motion.name} [{self.clip_name}] -> {self.character.name}"


def find_inputs(given: Path, without: Path) -> list[Input]:
    """The file itself, or all files of a folder that can hold a skeleton, at any depth, in natural order.

    Hidden files and folders, and what lies in the folder `without`, are passed over; links to folders are not followed.
    Raises `FileError` where there is nothing.
    """
    if given.is_file():
        return [Input(given.absolute(), given.name)]
    if not given.is_dir():
        raise FileError(given, "no such file or folder")
    without, found = without.resolve(), []
    for place, folders, files in os.walk(given.absolute(), onerror=_refuse):
        folders[:] = [name for name in folders if not name.startswith(".") and Path(place, name).resolve() != without]
        paths = [Path(place, name) for name in files if not name.startswith(".")]
        found += [path for path in paths if path.suffix.lower() in MOTION_SUFFIXES and path.is_file()]
    if not found:
        expect_no_frames(given)
        raise FileError(given, f"the folder holds no file with a skeleton ({', '.join(MOTION_SUFFIXES)})")
    inputs = [Input(path, path.relative_to(given.absolute()).as_posix()) for path in found]
    return sorted(inputs, key=lambda each: [natural_order(part) for part in each.name.split("/")])


def _refuse(error: OSError) -> None:
    raise FileError(error.filename, f"cannot be read: {error.strerror or error}")


def stamps(path: Path, beside: Sequence[Path] = ()) -> list[list]:
    """Name below its folder, bytes and time of change of a file and of those that were looked for while it was read; None for
    what is not there. Alike means unchanged."""
    return [_stamp(name, path.parent / name) for name in _names(path, beside)]


def unchanged(path: Path, marks: Any) -> bool:
    """Whether a file, and what was looked for while it was read, are as they were when `stamps` gave `marks`."""
    try:
        return [_stamp(name, path.parent / name) for name, _, _ in marks] == marks and marks[0][0] == path.name
    except (TypeError, ValueError, IndexError, OSError):  # not ours, or just taken away
        return False


def content_hash(path: Path, beside: Sequence[Path] = ()) -> str:
    """SHA-256 over the same files; those that are not there count as such."""
    import hashlib

    from retarget.batch.manifest import file_hash

    files = [path.parent / name for name in _names(path, beside)]
    hashes = [file_hash(file) if os.path.isfile(file) else "" for file in files]
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _names(path: Path, beside: Sequence[Path]) -> list[str]:
    """Below the file's folder: its own, then the others, sorted."""
    folder = path.parent.resolve()
    return [path.name, *sorted({file.relative_to(folder).as_posix() for file in beside})]


def _stamp(name: str, path: Path) -> list:
    if not os.path.isfile(path):  # where a name is too long, too
        return [name, None, None]
    return [name, path.stat().st_size, path.stat().st_mtime_ns]


def plan_jobs(motions: Sequence[Clips], characters: Sequence[Input], suffix: str, reserved: Sequence[str]) -> list[Job]:
    """Every clip onto every character, character by character.

    A result is called CHARACTER/MOTION.glb, of a file with several clips CHARACTER/MOTION/CLIP.glb, with the folders
    that the files lie in below those given. Names that would meet (walk.bvh and Walk.fbx, clips of one name) are told
    apart by the file's suffix, then by numbers; names depend on the inputs only. A file is not put onto itself.
    """
    bodies = distinct([_choices(each.name) for each in characters])
    pairs, wanted = [], []
    for character, body in zip(characters, bodies):
        for motion in motions:
            if os.path.samefile(motion.file.path, character.path):
                continue
            for clip, name in enumerate(motion.names):
                pairs.append((motion.file, clip, name, character))
                inner = f"/{portable(name or f'clip {clip + 1}')}" if len(motion.names) > 1 else ""
                wanted.append([f"{body}/{choice}{inner}" for choice in _choices(motion.file.name)])
    outputs = distinct(wanted, suffix, taken=reserved)
    return [Job(*pair, output) for pair, output in zip(pairs, outputs)]


def _choices(name: str) -> tuple[str, str]:
    """What the result of a file would be called: as the file, or with its suffix as a part of the name."""
    path = PurePosixPath(name)
    folders = [portable(part) for part in path.parts[:-1]]
    return tuple("/".join([*folders, portable(last)]) for last in (path.stem, f"{path.stem}_{path.suffix[1:].lower()}"))


def refuse_overwriting(jobs: Sequence[Job], inputs: Sequence[Input], folder: Path) -> None:
    """Raises `RetargetError` where a result would replace a file that is read."""
    read = {each.path.resolve() for each in inputs}
    for job in jobs:
        if (folder / job.output).resolve() in read:
            raise RetargetError(f"{folder / job.output} is read and would be written; name another output folder")
