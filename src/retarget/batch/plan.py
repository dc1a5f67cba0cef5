"""Who is put onto whom, and where the results go."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from retarget.errors import FileError, RetargetError
from retarget.io import MOTION_SUFFIXES
from retarget.io.file_names import distinct, natural_order, portable

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
        raise FileError(given, f"the folder holds no file with a skeleton ({', '.join(MOTION_SUFFIXES)})")
    inputs = [Input(path, path.relative_to(given.absolute()).as_posix()) for path in found]
    return sorted(inputs, key=lambda each: [natural_order(part) for part in each.name.split("/")])


def _refuse(error: OSError) -> None:
    raise FileError(error.filename, f"cannot be read: {error.strerror or error}")


def stamps(file: Input) -> list[list]:
    """Name below its folder, bytes and time of change of a file and, of a .gltf, of the files it refers to: alike means
    unchanged."""
    from retarget.io.gltf_document import resource_file

    folder = file.path.parent.resolve()
    paths = {file.path.name: file.path}
    if file.path.suffix.lower() == ".gltf":
        for uri in _uris(file.path):
            try:
                found = resource_file(file.path, uri, "")
            except FileError:  # reading it will say so
                continue
            paths[found.relative_to(folder).as_posix()] = found
    return [[name, path.stat().st_size, path.stat().st_mtime_ns] for name, path in paths.items()]


def content_hash(file: Input) -> str:
    """SHA-256 over the same files."""
    import hashlib

    from retarget.batch.manifest import file_hash

    folder = file.path.parent
    return hashlib.sha256("".join(file_hash(folder / name) for name, _, _ in stamps(file)).encode()).hexdigest()


def _uris(path: Path) -> list[str]:
    try:
        document = json.loads(path.read_bytes())
        entries = [*document.get("buffers", ()), *document.get("images", ())]
        uris = [entry["uri"] for entry in entries if "uri" in entry]
        return [uri for uri in uris if isinstance(uri, str) and uri[:5].lower() != "data:"]
    except (OSError, ValueError, RecursionError, AttributeError, TypeError):
        return []


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
