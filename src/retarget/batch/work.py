"""One step of a batch as a pure function of files and settings: what a worker process does.

Tasks and answers are plain JSON. What is kept from one task to the next (the character, the motion file, the prepared
pair, the performer of a sequence or capture) saves time and changes no result.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from retarget.batch.manifest import file_hash
from retarget.batch.plan import content_hash, stamps
from retarget.casting import Hints, cast
from retarget.character import Motion, Provenance
from retarget.errors import RetargetError
from retarget.io import DROPPING_CLIPS, check_holds, load
from retarget.io.asset import Asset
from retarget.io.gltf_document import files_beside
from retarget.io.presets import Preset, preset
from retarget.methods import Result
from retarget.motion.align import Actor
from retarget.motion.filter import resample
from retarget.performing import Performer, ScanPerformer, cast_moving
from retarget.retargeting import Production, prepare

PageMaker = Callable[[Path, Path, Path, Production, Motion, Result], AbstractContextManager]
"""Makes the page on a result while it is written: page, motion file, output, the pair, the clip as it was read, the result.
It is handed in, since pages belong to a floor above this one."""

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
    smpl_model: str | None = None
    """The body of motions in .npz."""
    smpl_model_hash: str | None = None
    engine: str | None = None
    """The program that the results go to: a key of `io.presets.PRESETS`."""
    up: str | None = None
    unit: float | None = None
    target_up: str | None = None
    target_unit: float | None = None

    def digest(self) -> str:
        """Of everything that results depend on besides the two files; where map, contacts and model lie is not part of it."""
        from retarget import __version__

        said = asdict(replace(self, map_file=None, contacts=None, smpl_model=None)) | {"version": __version__}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]

    def for_method(self) -> dict[str, Any]:
        """The method's own settings. Raises `RetargetError` for a contacts file that cannot be read or has changed."""
        own: dict[str, Any] = {"in_place": self.in_place, "foot_lock": self.foot_lock, "steady": self.steady}
        if self.contacts is not None:
            from retarget.contact.contact_file import read_contacts

            _expect_unchanged(self.contacts, self.contacts_hash)
            own["contacts"] = read_contacts(Path(self.contacts))
        return own

    @property
    def preset(self) -> Preset | None:
        return None if self.engine is None else preset(self.engine)

    def load(self, path: Path) -> Asset:
        """A motion, or a character. Raises `RetargetError` for a model that has changed."""
        if self.smpl_model is None or path.suffix.lower() != ".npz":
            return load(path)
        _expect_unchanged(self.smpl_model, self.smpl_model_hash)
        return load(path, smpl_model=self.smpl_model)

    def rate(self, fps: float) -> float:
        """Frames a second of the result of a clip."""
        return self.fps or (fps if self.preset is None else self.preset.rate(fps))

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
        self.performing: tuple[Any, Performer | ScanPerformer | str | None] = (None, None)
        """Of the motion, where it is a sequence or capture; or why nobody performs it."""
        self.character: tuple[Any, Actor | None] = (None, None)
        self.pairs: dict[str, Production] = {}

    def asset(self, path: str, known: str, settings: Settings) -> Asset:
        """The motion file of that content. Raises `RetargetError` if it has another by now."""
        key = (path, known, settings.smpl_model_hash)
        if self.motion[0] != key:
            self.performing = (None, None)
            asset = settings.load(Path(path))
            _expect_content(asset, known)
            self.motion = (key, asset)
        return self.motion[1]

    def target(self, path: str, known: str, settings: Settings) -> Actor:
        """The character of that content, cast. Raises `RetargetError` if it has another by now, or is no humanoid."""
        key = (path, known, settings)
        if self.character[0] != key:
            self.pairs.clear()
            asset = load(path)
            _expect_content(asset, known)
            self.character = (key, cast(asset, settings.hints()[1]))
        return self.character[1]

    def performer(self, asset: Asset, settings: Settings) -> Performer | ScanPerformer:
        """Who performs the motion file that `asset` gave, a sequence or capture. Raises `RetargetError` where nobody can."""
        key, hints = (self.motion[0], settings), settings.hints()[0]
        if self.performing[0] != key:
            try:
                self.performing = (key, cast_moving(asset, hints, settings.fps))
            except RetargetError as error:
                self.performing = (key, str(error))
        if isinstance(self.performing[1], str):
            raise RetargetError(self.performing[1])
        return self.performing[1]

    def pair(self, source: Actor | Performer | ScanPerformer, target: Actor, settings: Settings) -> Production:
        """Source and target prepared; again only for a source that differs in anything but its name."""
        actor = source if isinstance(source, Actor) else source.actor
        key = f"{type(source).__name__} {_digest(actor)}"
        if key not in self.pairs:
            while len(self.pairs) >= PAIRS_KEPT:
                self.pairs.pop(next(iter(self.pairs)))
            self.pairs[key] = prepare(source, target, settings.method, **settings.for_method())
        return replace(self.pairs[key], source=actor)


def _expect_content(asset: Asset, known: str) -> None:
    if content_hash(asset.path, asset.beside) != known:
        raise RetargetError(f"{asset.path}: was changed while the batch ran; start it again")


def _digest(actor: Actor) -> str:
    """Equal for actors that a method cannot tell apart."""
    import pickle

    character, humanoid = actor.character, actor.humanoid
    seen = [asdict(humanoid), asdict(actor.house_from_file), actor.height, actor.soles, asdict(character.skeleton)]
    if character.skin is not None:
        seen += [asdict(replace(character.mesh, materials=(), face_materials=None)), asdict(character.skin)]
    return hashlib.sha256(pickle.dumps(seen)).hexdigest()


_BENCH = Bench()


def perform(task: dict[str, Any], page: PageMaker | None = None) -> dict[str, Any]:
    """Do one task of a batch in this process; by the word under "do". `page` makes what the task's "page" names."""
    settings = Settings(**task["settings"])
    if task["do"] == "look":
        return look(Path(task["path"]), task["role"], settings)
    return retarget_clip(task, settings, _BENCH, page)


def look(path: Path, role: str, settings: Settings) -> dict[str, Any]:
    """What a file is good for: hash and clips, and the stamps of all that was read. Raises `RetargetError` if it cannot be
    read, or as one of the "characters" has no human in it or holds a mesh sequence."""
    own = stamps(path)
    asset = settings.load(path) if role == "motions" else load(path)
    if role == "characters":
        cast(asset, settings.hints()[1])
        asset.expect_joints()
    moving = asset.sequence or asset.clouds
    clips = [[clip.name, clip.frames, clip.fps] for clip in asset.clips]
    if moving is not None:
        clips = [[moving.name, len(moving), moving.fps]]
    # The file's own stamp is from before it was read: if it changed meanwhile, the next run looks again.
    own += stamps(path, asset.beside)[1:]
    known = content_hash(path, asset.beside)
    return {"stamps": own, "sha256": known, "clips": clips, "moving": moving is not None}


def retarget_clip(
    task: dict[str, Any], settings: Settings, bench: Bench, page: PageMaker | None = None
) -> dict[str, Any]:
    """Put a clip on a character and write the result, and the page on it where the task wants one: whole or not at all.

    The task names "motion", "clip" (number), "character", "inputs" (hash of each), "output" and "page" (or None). The answer
    describes the output and what lies beside it. A sequence or capture has the frames it has: `Settings.fps` is their rate.
    Raises `RetargetError` (and its kin) where it cannot be done.
    """
    started = time.perf_counter()
    asset = bench.asset(task["motion"], task["inputs"][0], settings)
    moving = asset.sequence is not None or asset.clouds is not None
    if not moving:
        clip = asset.motion(task["clip"])
        if not len(clip):
            raise RetargetError(f"{asset.path}: the clip {clip.name!r} has no frames")
        motion = resample(clip, settings.rate(clip.fps))
    target = bench.target(task["character"], task["inputs"][1], settings)
    output = Path(task["output"])
    check_holds(output, target.original, settings.animation_only)
    if moving:
        source = bench.performer(asset, settings)
        clip = motion = source.motion
    else:
        source = cast(asset, settings.hints()[0], motion)
    production = bench.pair(source, target, settings)
    surface = source.surface if isinstance(source, Performer) else None
    result = production(motion, Provenance.whole(asset.path, clip), surface)
    output.parent.mkdir(parents=True, exist_ok=True)
    with nullcontext() if page is None else page(Path(task["page"]), asset.path, output, production, clip, result):
        result.save(output, animation_only=settings.animation_only, **_options(output, settings))
    return {
        "bytes": output.stat().st_size,
        "sha256": file_hash(output),
        "beside": [_known(output.parent, name) for name in _beside(output)],
        "page": None if page is None else _known(output.parent, Path(task["page"]).name),
        "frames": len(motion),
        "fps": motion.fps,
        "status": result.status,
        "notes": [*(f"source: {note}" for note in asset.notes if moving), *result.stats["notes"]],
        "seconds": round(time.perf_counter() - started, 3),
    }


def _beside(output: Path) -> list[str]:
    """Names of the files that a result refers to."""
    if output.suffix.lower() != ".gltf":
        return []
    files = files_beside(output, json.loads(output.read_bytes()))
    return [name for name, size, _ in stamps(output, files)[1:] if size is not None]


def _known(folder: Path, name: str) -> list:
    path = folder / name
    return [name, path.stat().st_size, file_hash(path)]


def _options(output: Path, settings: Settings) -> dict[str, Any]:
    """The writer's own: a result holds its one clip, and what moves it in the program that it goes to."""
    suffix = output.suffix.lower()
    options: dict[str, Any] = {"keep_clips": False} if suffix in DROPPING_CLIPS else {}
    if suffix == ".fbx" and settings.preset is not None:
        options["root"] = settings.preset.root
    return options
