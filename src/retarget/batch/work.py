"""One step of a batch as a pure function of files and settings: what a worker process does.

Tasks and answers are plain JSON. What is kept from one task to the next (the character, the motion file, the prepared
pair) saves time and changes no result.
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from retarget.batch.manifest import file_hash
from retarget.batch.plan import Input, content_hash
from retarget.errors import RetargetError
from retarget.io import load
from retarget.io.asset import Asset
from retarget.motion.align import Actor
from retarget.motion.filter import resample
from retarget.retargeting import Hints, Production, cast, prepare

PAIRS_KEPT = 4
"""Prepared pairs of one character; motions of one folder mostly share one skeleton."""


@dataclass(frozen=True)
class Settings:
    """How every clip is put onto every character; as the options of `retarget run`."""

    method: str = "auto"
    fps: float | None = None
    in_place: bool = False
    foot_lock: bool = True
    steady: bool = True
    animation_only: bool = False
    map_file: str | None = None
    map_hash: str | None = None
    """Of its content when the run began."""
    contacts: str | None = None
    contacts_hash: str | None = None
    up: str | None = None
    unit: float | None = None
    target_up: str | None = None
    target_unit: float | None = None

    def digest(self) -> str:
        """Of everything that results depend on besides the two files; where map and contacts lie is not part of it."""
        from retarget import __version__

        said = asdict(replace(self, map_file=None, contacts=None)) | {"version": __version__}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]

    def for_method(self) -> dict[str, Any]:
        """The method's own settings. Raises `RetargetError` for a contacts file that cannot be read or has changed."""
        own: dict[str, Any] = {"in_place": self.in_place, "foot_lock": self.foot_lock, "steady": self.steady}
        if self.contacts is not None:
            from retarget.contact.contact_file import read_contacts

            _expect_unchanged(self.contacts, self.contacts_hash)
            own["contacts"] = read_contacts(Path(self.contacts))
        return own

    def hints(self) -> tuple[Hints, Hints]:
        """Of motions and of characters. Raises `RetargetError` for a map file that cannot be read or has changed."""
        source_joints = target_joints = None
        if self.map_file is not None:
            from retarget.correspond.map_file import read_map

            _expect_unchanged(self.map_file, self.map_hash)
            tables = read_map(Path(self.map_file))
            source_joints, target_joints = tables["source"] or None, tables["target"] or None
        return Hints(source_joints, self.up, self.unit), Hints(target_joints, self.target_up, self.target_unit)


def _expect_unchanged(path: str, known: str | None) -> None:
    if file_hash(Path(path)) != known:
        raise RetargetError(f"{path}: was changed while the batch ran; start it again")


class Bench:
    """What lies ready from one task to the next."""

    def __init__(self) -> None:
        self.motion: tuple[Any, Asset | None] = (None, None)
        self.character: tuple[Any, Actor | None] = (None, None)
        self.pairs: dict[str, Production] = {}

    def asset(self, path: str, known: str) -> Asset:
        """The motion file of that content. Raises `RetargetError` if it has another by now."""
        if self.motion[0] != (path, known):
            self.motion = ((path, known), _load(path, known))
        return self.motion[1]

    def target(self, path: str, known: str, settings: Settings) -> Actor:
        """The character of that content, cast. Raises `RetargetError` if it has another by now, or is no humanoid."""
        key = (path, known, settings)
        if self.character[0] != key:
            self.pairs.clear()
            self.character = (key, cast(_load(path, known), settings.hints()[1]))
        return self.character[1]

    def pair(self, source: Actor, target: Actor, settings: Settings) -> Production:
        """Source and target prepared; again only for a source that differs in anything but its name."""
        key = _digest(source)
        if key not in self.pairs:
            while len(self.pairs) >= PAIRS_KEPT:
                self.pairs.pop(next(iter(self.pairs)))
            self.pairs[key] = prepare(source, target, settings.method, **settings.for_method())
        return replace(self.pairs[key], source=source)


def _load(path: str, known: str) -> Asset:
    if content_hash(Input(Path(path), path)) != known:
        raise RetargetError(f"{path}: was changed while the batch ran; start it again")
    return load(path)


def _digest(actor: Actor) -> str:
    """Equal for actors that a method cannot tell apart."""
    import pickle

    character, humanoid = actor.character, actor.humanoid
    seen = [asdict(humanoid), asdict(actor.house_from_file), actor.height, actor.soles, asdict(character.skeleton)]
    if character.skin is not None:
        seen += [asdict(replace(character.mesh, materials=(), face_materials=None)), asdict(character.skin)]
    return hashlib.sha256(pickle.dumps(seen)).hexdigest()


_BENCH = Bench()


def perform(task: dict[str, Any]) -> dict[str, Any]:
    """Do one task of a batch in this process; by the word under "do"."""
    settings = Settings(**task["settings"])
    if task["do"] == "look":
        return look(Path(task["path"]), task["role"], settings)
    return retarget_clip(task, settings, _BENCH)


def look(path: Path, role: str, settings: Settings) -> dict[str, Any]:
    """What a file is good for: hash and clips. Raises `RetargetError` if it cannot be read, or as one of the
    "characters" has no human in it."""
    known = content_hash(Input(path, path.name))
    asset = load(path)
    if role == "characters":
        cast(asset, settings.hints()[1])
    return {"sha256": known, "clips": [[clip.name, clip.frames, clip.fps] for clip in asset.clips]}


def retarget_clip(task: dict[str, Any], settings: Settings, bench: Bench) -> dict[str, Any]:
    """Put a clip on a character and write the result, whole or not at all.

    The task names "motion", "clip" (number), "character", "inputs" (hash of each) and "output". The answer describes
    the output. Raises `RetargetError` (and its kin) where it cannot be done.
    """
    started = time.perf_counter()
    asset = bench.asset(task["motion"], task["inputs"][0])
    motion = asset.motion(task["clip"])
    if settings.fps is not None and len(motion):
        motion = resample(motion, settings.fps)
    if not len(motion):
        raise RetargetError(f"{asset.path}: the clip {motion.name!r} has no frames")
    target = bench.target(task["character"], task["inputs"][1], settings)
    source = cast(asset, settings.hints()[0], motion)
    result = bench.pair(source, target, settings)(motion)
    output = Path(task["output"])
    output.parent.mkdir(parents=True, exist_ok=True)
    own = {"keep_clips": False} if output.suffix.lower() == ".glb" else {}
    result.save(output, animation_only=settings.animation_only, **own)
    return {
        "bytes": output.stat().st_size,
        "sha256": file_hash(output),
        "frames": len(motion),
        "fps": motion.fps,
        "status": result.status,
        "notes": list(result.stats["notes"]),
        "seconds": round(time.perf_counter() - started, 3),
    }
