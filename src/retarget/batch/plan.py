"""Who is put onto whom, and where the results go."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from retarget.batch.manifest import file_hash
from retarget.errors import FileError, RetargetError
from retarget.io import MOTION_SUFFIXES
from retarget.io.file_names import distinct, natural_order, portable
from retarget.io.mesh_folder import expect_no_frames, is_one_motion
from retarget.io.point_folder import FRAMES, frame_files, possible_frames

Key = tuple[str, int, str]
"""A job: motion, number of its clip, character; files by their names below the folders given."""


@dataclass(frozen=True)
class Input:
    """A file that takes part, or a folder whose files are the frames of one motion."""

    path: Path
    """Absolute."""
    name: str
    """Below the folder that was given, '/' between the parts: what it is called everywhere."""
    is_folder: bool = False


@dataclass(frozen=True)
class Clips:
    """A motion file and the clips it holds."""

    file: Input
    names: tuple[str, ...]
    moving: bool = False
    """Whether it is a mesh sequence or capture, whose performer is to be made first."""


@dataclass(frozen=True)
class Job:
    """One clip onto one character."""

    motion: Input
    clip: int
    clip_name: str
    character: Input
    output: str
    """Below the output folder."""
    moving: bool = False
    """As of its `Clips`."""

    @property
    def key(self) -> Key:
        return self.motion.name, self.clip, self.character.name

    @property
    def kept(self) -> tuple[str, str]:
        """What takes longest to make ready for it: the performer of a sequence or capture, else the character."""
        return ("motion", self.motion.name) if self.moving else ("character", self.character.name)

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.motion.name} [{self.clip_name}] -> {self.character.name}"


def find_inputs(given: Path, without: Path, sequences: bool = False) -> list[Input]:
    """The file itself, or all files of a folder that can hold a skeleton, at any depth, in natural order.

    With `sequences` a folder that is one motion (`is_one_motion`) counts as one, the given folder too, and its files
    do not; folders in it are searched like others. Hidden files and folders, and what lies in the folder `without`, are
    passed over; links to folders are not followed. Raises `FileError` where there is nothing.
    """
    if given.is_file():
        return [Input(given.absolute(), given.name)]
    if not given.is_dir():
        raise FileError(given, "no such file or folder")
    top = given.resolve() if given.name == ".." else given.absolute()
    without, found, whole = without.resolve(), [], []
    for place, folders, files in os.walk(top, onerror=_refuse):
        folders[:] = [name for name in folders if not name.startswith(".") and Path(place, name).resolve() != without]
        frames = len(frame_files(Path(place))) if sequences and is_one_motion(Path(place)) else 0
        if frames > 1 or (frames and Path(place) == top):  # a mesh alone in a folder within is no motion
            whole.append(Path(place))
            continue
        paths = [Path(place, name) for name in files if not name.startswith(".")]
        found += [path for path in paths if path.suffix.lower() in MOTION_SUFFIXES and path.is_file()]
    if not found and not whole:
        if sequences:
            forms = f"no file of one ({', '.join(MOTION_SUFFIXES)}) and no frames ({', '.join(FRAMES)})"
            raise FileError(given, f"the folder holds no motion: {forms}")
        expect_no_frames(given)
        raise FileError(given, f"the folder holds no file with a skeleton ({', '.join(MOTION_SUFFIXES)})")
    inputs = [Input(path, path.relative_to(top).as_posix()) for path in found]
    inputs += [Input(path, path.relative_to(top).as_posix(), is_folder=True) for path in whole if path != top]
    if top in whole:
        alike = top.name in {each.name for each in inputs}
        inputs.append(Input(top, f"./{top.name}" if alike else top.name, is_folder=True))
    return sorted(inputs, key=lambda each: [natural_order(part) for part in each.name.split("/")])


def _refuse(error: OSError) -> None:
    raise FileError(error.filename, f"cannot be read: {error.strerror or error}")


def stamps(path: Path, beside: Sequence[Path] = ()) -> list[list]:
    """Name below its folder, bytes and time of change of a file and of those that were looked for while it was read;
    None for what is not there. Of a folder, all bytes of its frames, and a hash over the stamps of each. Alike means unchanged."""
    return [_stamp(path, name) for name in _names(path, beside)]


def unchanged(path: Path, marks: Any) -> bool:
    """Whether a file, and what was looked for while it was read, are as they were when `stamps` gave `marks`."""
    try:
        return [_stamp(path, name) for name, _, _ in marks] == marks and marks[0][0] == path.name
    except (TypeError, ValueError, IndexError, OSError):  # not ours, or just taken away
        return False


def content_hash(path: Path, beside: Sequence[Path] = ()) -> str:
    """SHA-256 over the same files; those that are not there count as such. Of a folder, over its frames and their names."""
    if path.is_dir():
        return _digest([[file.name, file_hash(file)] for file in _frames(path)])
    files = [path.parent / name for name in _names(path, beside)]
    hashes = [file_hash(file) if os.path.isfile(file) else "" for file in files]
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _names(path: Path, beside: Sequence[Path]) -> list[str]:
    """Below the file's folder: its own, then the others, sorted."""
    folder = path.parent.resolve()
    return [path.name, *sorted({file.relative_to(folder).as_posix() for file in beside})]


def _stamp(path: Path, name: str) -> list:
    """Of the input itself, or of a file beside it."""
    file = path.parent / name
    if name == path.name and path.is_dir():
        frames = [[frame.name, frame.stat().st_size, frame.stat().st_mtime_ns] for frame in _frames(path)]
        return [name, sum(size for _, size, _ in frames), _digest(frames)]
    if not os.path.isfile(file):  # where a name is too long, too
        return [name, None, None]
    return [name, file.stat().st_size, file.stat().st_mtime_ns]


def _frames(folder: Path) -> list[Path]:
    return sorted(possible_frames(folder))


def _digest(said: list) -> str:
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


def plan_jobs(motions: Sequence[Clips], characters: Sequence[Input], suffix: str, reserved: Sequence[str]) -> list[Job]:
    """Every clip onto every character, character by character.

    A result is called CHARACTER/MOTION.glb, of a file with several clips CHARACTER/MOTION/CLIP.glb, with the folders
    that the files lie in below those given. Names that would meet (walk.bvh and Walk.fbx, clips of one name) are told
    apart by the file's suffix, then by numbers; names depend on the inputs only. A file is not put onto itself.
    """
    bodies = distinct([_choices(each) for each in characters])
    pairs, wanted = [], []
    for character, body in zip(characters, bodies):
        for motion in motions:
            if os.path.samefile(motion.file.path, character.path):
                continue
            for clip, name in enumerate(motion.names):
                pairs.append((motion, clip, name, character))
                inner = f"/{portable(name or f'clip {clip + 1}')}" if len(motion.names) > 1 else ""
                wanted.append([f"{body}/{choice}{inner}" for choice in _choices(motion.file)])
    outputs = distinct(wanted, suffix, taken=reserved)
    return [
        Job(motion.file, clip, name, character, output, motion.moving)
        for (motion, clip, name, character), output in zip(pairs, outputs)
    ]


def _choices(of: Input) -> tuple[str, ...]:
    """What the result of a file would be called: as the file, or with its suffix as a part of the name. The name of a folder
    has no suffix."""
    path = PurePosixPath(of.name)
    folders = [portable(part) for part in path.parts[:-1]]
    names = (path.name,) if of.is_folder else (path.stem, f"{path.stem}_{path.suffix[1:].lower()}")
    return tuple("/".join([*folders, portable(last)]) for last in names)


def refuse_overwriting(jobs: Sequence[Job], inputs: Sequence[Input], folder: Path) -> None:
    """Raises `RetargetError` where a result would replace a file that is read, or lie among the frames of a motion."""
    read = {each.path.resolve() for each in inputs}
    for job in jobs:
        output = (folder / job.output).resolve()
        if output in read:
            raise RetargetError(f"{folder / job.output} is read and would be written; name another output folder")
        if output.parent in read:
            raise RetargetError(f"{folder / job.output} would lie among frames that are read; name another output folder")
