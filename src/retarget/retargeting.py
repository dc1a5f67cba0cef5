"""The verb: a motion and a character go in, the character performing the motion comes out.

    load → Character, Motion → match joints → method → Result → save
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retarget.body.skinning import rest_vertices
from retarget.character import Character, Motion
from retarget.correspond.joints import Humanoid, humanoid_from_names, match_humanoid
from retarget.errors import FileError, MatchError, RetargetError, unknown_name
from retarget.io import load, save
from retarget.io.asset import Asset, Convention
from retarget.methods import METHODS, Method, Result, Retargeter
from retarget.motion.align import Actor, make_actor


@dataclass(frozen=True)
class Hints:
    """What the user knows better than inference: joint names, up axis, unit."""

    joints: Mapping[str, str] | None = None
    """Canonical name to joint name, as in a map file; None lets matching decide."""
    up: str | None = None
    unit: float | None = None
    """Metres per unit."""


def open_asset(subject: str | Path | Asset) -> Asset:
    """The asset itself, or the file read."""
    return subject if isinstance(subject, Asset) else load(subject)


def cast(subject: str | Path | Asset | Character, hints: Hints | None = None, motion: Motion | None = None) -> Actor:
    """Match the joints of a character or skeleton and bring it into the house's space.

    `motion`, in the file's own space, shows which way the body stands. Raises `MatchError` for a body that is no
    humanoid and `FileError` for a file without skeleton.
    """
    hints = hints or Hints()
    if isinstance(subject, Character):
        character, convention = subject, Convention(1.0, "+y")
    else:
        asset = open_asset(subject)
        if asset.character is None:
            raise FileError(asset.path, f"holds a {asset.kind} without skeleton; a rigged character (glTF with a skin) or a BVH is needed")
        character, convention = asset.character, asset.convention
    humanoid = _humanoid(character, hints.joints)
    surface = rest_vertices(character) if character.skin is not None else None
    return make_actor(character, humanoid, convention, motion, up=hints.up, unit=hints.unit, rest_surface=surface)


def _humanoid(character: Character, joints: Mapping[str, str] | None) -> Humanoid:
    try:
        return humanoid_from_names(character.skeleton, joints) if joints else match_humanoid(character.skeleton)
    except MatchError as error:
        raise MatchError(f"{character.name}: {error}" if character.name else str(error), error.missing) from None


def choose_method(name: str = "auto", settings: Mapping[str, Any] | None = None) -> Method:
    """A method by name with its settings. 'auto' is the one that the table of docs/architecture.md gives for the pair."""
    if name == "auto":
        name = "copy-rotations"
    if name not in METHODS:
        raise unknown_name("method", name, METHODS, "this version")
    return METHODS[name](**(settings or {}))


@dataclass(frozen=True, eq=False)
class Production:
    """A source and a target, prepared: call it for every clip of that source."""

    source: Actor
    target: Actor
    retargeter: Retargeter

    def __call__(self, motion: Motion) -> Result:
        """Retarget one clip of the source file, given in that file's own space."""
        result = self.retargeter(self.source.house_from_file.motion(motion))
        result.stats["notes"] = [f"source: {note}" for note in self.source.notes] + [f"target: {note}" for note in self.target.notes]
        return result

    def in_file_space(self, result: Result) -> Motion:
        """The result as the target's file wants it: its own unit and axes."""
        return self.target.house_from_file.inverse().motion(result.motion)


def prepare(source: Actor, target: Actor, method: str | Method = "auto", **settings: Any) -> Production:
    """Match a source and a target once. Raises `RetargetError` for an unknown method or bodies that do not match."""
    chosen = method if isinstance(method, Method) else choose_method(method, settings)
    return Production(source, target, chosen.prepare(source, target))


def retarget(
    motion: str | Path | Motion,
    target: str | Path | Character,
    *,
    clip: str | int | None = None,
    method: str | Method = "auto",
    source_hints: Hints | None = None,
    target_hints: Hints | None = None,
    **settings: Any,
) -> Result:
    """Put a motion on a body.

    Takes files or nouns; a `Motion` or `Character` handed in is in the house's space (metres, +Y up). `clip` names the
    animation of a file with several; further keywords are settings of the method. Raises `RetargetError` (and its kin)
    for input that cannot be used.
    """
    if isinstance(motion, Motion):
        moving, source = motion, cast(Character(motion.skeleton, name="the motion's skeleton"), source_hints, motion)
    else:
        asset = load(motion)
        moving = asset.motion(clip)
        source = cast(asset, source_hints, moving)
    if len(moving) == 0:
        raise RetargetError("the motion has no frames")
    return prepare(source, cast(target, target_hints), method, **settings)(moving)


def save_result(path: str | Path, results: Sequence[Result], production: Production, original: Character, **options: Any) -> None:
    """Write retargeted clips with the target they were made for, in the target file's own space."""
    save(path, original, [production.in_file_space(result) for result in results], **options)
