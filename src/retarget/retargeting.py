"""The verb: a motion and a character go in, the character performing the motion comes out.

load → Character, Motion → match joints → method → Result → save
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.casting import Hints, cast, open_asset
from retarget.character import Character, Mesh, MeshMotion, Motion, PointCloud, PointMotion, Provenance
from retarget.errors import RetargetError, unknown_name
from retarget.io.asset import Asset
from retarget.methods import METHODS, Method, Result, Retargeter
from retarget.motion.align import Actor, with_grafts
from retarget.performing import Performer, ScanPerformer, cast_scan, cast_sequence

Array = np.ndarray
log = logging.getLogger("retarget")


def choose_method(name: str = "auto", settings: Mapping[str, Any] | None = None) -> Method:
    """A method by name with its settings; 'auto' is the one for a target with a surface (`prepare` knows better).

    Raises `RetargetError` for a method or a setting that does not exist.
    """
    if name == "auto":
        name = "interaction"
    if name not in METHODS:
        raise unknown_name("method", name, METHODS, "this version")
    known = [each.name for each in fields(METHODS[name])]
    for setting in settings or {}:
        if setting not in known:
            raise unknown_name("setting", setting, known, f"the method {name}")
    return METHODS[name](**(settings or {}))


@dataclass(frozen=True, eq=False)
class Production:
    """A source and a target, prepared: call it for every clip of that source."""

    source: Actor
    target: Actor
    retargeter: Retargeter
    """Works in metres with +Y up on both sides; call this to skip the source file's unit and axes."""
    notes: tuple[str, ...] = ()
    """What was decided for the pair."""
    method: str = ""
    """Which method works, and why that one: a sentence."""

    def __call__(
        self,
        motion: Motion,
        made_from: Provenance | None = None,
        surface: Float[Array, "frames vertices 3"] | None = None,
    ) -> Result:
        """Retarget one clip of the source, given in the source file's own unit and axes.

        `made_from` says where that clip was taken from; the result's file then says it too. `surface`, in metres with +Y up,
        is how the source's vertices move, for methods that look at more than its skin tells.
        """
        seen = {"surface": surface} if surface is not None and self.retargeter.takes_surface else {}
        result = self.retargeter(self.source.house_from_file.motion(motion), **seen)
        result = replace(result, motion=replace(result.motion, made_from=made_from))
        notes = [f"source: {note}" for note in self.source.notes] + [f"target: {note}" for note in self.target.notes]
        return replace(result, stats=result.stats | {"notes": [*self.notes, *notes]})


def prepare(source: Actor | Performer | ScanPerformer, target: Actor, method: str | Method = "auto", **settings: Any) -> Production:
    """Match a source and a target once, for many clips.

    Settings are the method's fields (`CopyRotations`: foot_lock, steady, limits, in_place). 'auto' is interaction for a
    target with a surface (shape transfer where a moving surface performs) and copy-rotations for one without; where a surface
    cannot serve (no part of it is body, whole limbs are missing), 'auto' copies rotations and says so. A capture's performer is an
    embedded human: one of another shape gets equal rotations, unless `one_rig` says otherwise. Raises `RetargetError`
    for an unknown method or setting, or bodies that do not match.
    """
    target, moving = with_grafts(target), isinstance(source, Performer)
    if isinstance(source, ScanPerformer):
        settings = {"one_rig": True} | settings
    source = source if isinstance(source, Actor) else source.actor
    if method != "auto":
        chosen = method if isinstance(method, Method) else choose_method(method, settings)
        said = f"method: {_method_name(chosen)}, as asked"
        return Production(source, target, chosen.prepare(source, target), method=said)
    plain = choose_method("copy-rotations", {name: settings[name] for name in settings if name != "contacts"})
    if target.character.skin is None:
        said = "method: copy-rotations, since the character has no surface that could touch itself"
        return Production(source, target, plain.prepare(source, target), method=said)
    touching = choose_method("shape-transfer" if moving else "auto", settings)
    try:
        why = "the source is a moving surface" if moving else "the character has a surface that can touch itself"
        said = f"method: {_method_name(touching)}, since {why}"
        return Production(source, target, touching.prepare(source, target), method=said)
    except RetargetError as error:
        prepared = plain.prepare(source, target)  # raises where the bodies do not match at all
        note = f"contacts are not looked after, rotations are copied: {error}"
        log.warning("%s", note)
        said = "method: copy-rotations, since the character's surface cannot serve"
        return Production(source, target, prepared, (note,), said)


def _method_name(method: Method) -> str:
    return next((name for name, each in METHODS.items() if type(method) is each), type(method).__name__)


def retarget(
    motion: str | Path | Asset | Motion | MeshMotion | PointMotion,
    target: str | Path | Asset | Character | Mesh | PointCloud,
    *,
    source: str | Path | Asset | Character | None = None,
    clip: str | int | None = None,
    method: str | Method = "auto",
    source_hints: Hints | None = None,
    target_hints: Hints | None = None,
    **settings: Any,
) -> Result:
    """Put a motion on a body; `.save(path)` writes it.

    Takes files, assets or nouns; a `Motion` or `Character` handed in is in metres with +Y up. A mesh sequence gets a rig first
    (`performing.cast_sequence`), a capture an actor that follows its clouds (`performing.cast_scan`). `source` is the body that
    performs the motion, where the motion's own file has none. `clip` names the animation of a file with several. Further
    keywords are settings of the method (`prepare`). The result is in metres; saving leads it back into the target file's
    own unit and axes. Raises `RetargetError` (and its kin) for input that cannot be used.
    """
    if isinstance(motion, (str, Path)):
        motion = open_asset(motion)
    if isinstance(motion, MeshMotion) or (isinstance(motion, Asset) and motion.sequence is not None):
        if source is not None or clip is not None:
            raise RetargetError("a mesh sequence is its own performer and has one clip: source and clip do not apply")
        sequence, convention = (
            (motion, None) if isinstance(motion, MeshMotion) else (motion.sequence, motion.convention)
        )
        seen = cast_sequence(sequence, source_hints, convention)
        production = prepare(seen, cast(target, target_hints), method, **settings)
        return production(seen.motion, surface=seen.surface)
    if isinstance(motion, PointMotion) or (isinstance(motion, Asset) and motion.clouds is not None):
        if source is not None or clip is not None:
            raise RetargetError("a capture is its own performer and has one clip: source and clip do not apply")
        clouds, convention = (motion, None) if isinstance(motion, PointMotion) else (motion.clouds, motion.convention)
        followed = cast_scan(clouds, source_hints, convention)
        return prepare(followed, cast(target, target_hints), method, **settings)(followed.motion)
    if isinstance(motion, Motion):
        moving, performer = motion, source if source is not None else Character(motion.skeleton, name="the motion")
        made_from = None
    else:
        asset = open_asset(motion)
        moving, performer = asset.motion(clip), source if source is not None else asset
        made_from = Provenance.whole(asset.path, moving)
    if len(moving) == 0:
        raise RetargetError("the motion has no frames")
    performing = cast(performer, source_hints, moving)
    return prepare(performing, cast(target, target_hints), method, **settings)(moving, made_from)
