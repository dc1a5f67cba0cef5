"""What `retarget contacts` does: find the self-contacts of a performance, list them, and write the contacts file."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from retarget.body.kinematics import world_pose
from retarget.casting import Hints, cast
from retarget.character import Motion
from retarget.contact.contact_file import write_contacts
from retarget.contact.contact_list import ContactEvent, contact_events
from retarget.contact.detect import prepare_contacts
from retarget.errors import FileError, RetargetError
from retarget.io import load
from retarget.io.asset import Asset
from retarget.motion.align import Actor
from retarget.motion.filter import cut, cut_surface, resample
from retarget.motion.stand_in import fit_stand_in
from retarget.performing import cast_sequence

log = logging.getLogger("retarget")

FPS = 30.0
"""Frames a second to detect at, or the clip's own if lower."""


@dataclass(frozen=True)
class Search:
    """What `retarget contacts` was asked."""

    source: Path
    output: Path | None = None
    clip: str | None = None
    start: float | None = None
    end: float | None = None
    map_file: Path | None = None
    up: str | None = None
    unit: float | None = None
    smpl_model: Path | None = None


def find_contacts(search: Search) -> dict[str, Any]:
    """List the contacts and write the file, where one is asked for. Raises `RetargetError`."""
    if search.output is not None and search.output.resolve() == search.source.resolve():
        raise RetargetError(f"{search.output}: the contacts file would replace the source; name another")
    if search.output is not None and not search.output.absolute().parent.is_dir():
        raise FileError(search.output, f"the folder {search.output.parent} does not exist")
    joints = None
    if search.map_file is not None:
        from retarget.correspond.map_file import read_map

        joints = read_map(search.map_file)["source"] or None
    asset = load(search.source, smpl_model=search.smpl_model)
    actor, motion, notes = _performance(asset, search, Hints(joints, search.up, search.unit))
    detector = prepare_contacts(actor.character, actor.humanoid)
    events = contact_events(detector.clip(*world_pose(motion), motion.fps), motion.fps)
    if search.output is not None:
        write_contacts(search.output, events)
    listed = [asdict(event) | {"parts": list(event.parts), "decides": event.decides} for event in events]
    return {
        "source": str(search.source), "clip": motion.name, "fps": motion.fps, "contacts": listed,
        "output": None if search.output is None else str(search.output), "notes": list(notes),
        "lines": [*(f"note: {note}" for note in notes), *_lines(search, events)],
    }  # fmt: skip


def _performance(asset: Asset, search: Search, hints: Hints) -> tuple[Actor, Motion, tuple[str, ...]]:
    """Who performs what, with a surface, and notes on that. A mesh sequence gets a rig first."""
    if asset.sequence is not None:
        if search.clip is not None:
            raise FileError(asset.path, "holds one mesh sequence: --clip does not apply")
        try:
            performer = cast_sequence(cut_surface(asset.sequence, search.start, search.end), hints, asset.convention)
        except RetargetError as error:
            raise FileError(asset.path, str(error)) from None
        return performer.actor, resample(performer.motion, min(FPS, performer.motion.fps)), performer.notes
    if search.clip is None and len(asset.clips) > 1:
        first = asset.clips[0].name
        log.warning("%s holds %d clips; taking the first, %r (--clip NAME to choose)", asset.path, len(asset.clips), first)
    motion = asset.motion(search.clip if search.clip is not None else 0)
    actor = cast(asset, hints, motion)
    motion = actor.house_from_file.motion(motion)
    if search.start is not None or search.end is not None:
        motion = cut(motion, search.start, search.end)
    return _with_surface(actor, resample(motion, min(FPS, motion.fps)))


def _with_surface(actor: Actor, motion: Motion) -> tuple[Actor, Motion, tuple[str, ...]]:
    """The performer with a skin, its motion, and notes: for a bare skeleton the body that the method interaction has stand
    in for it too, so that both see the same contacts."""
    if actor.character.skin is not None:
        return actor, motion, ()
    stand_in = fit_stand_in(actor)
    return stand_in.actor, stand_in.motion(motion), stand_in.notes


def _lines(search: Search, events: Sequence[ContactEvent]) -> Iterator[str]:
    if events:
        yield "  start     end  parts                        points  distance  probability"
    for event in events:
        names = " - ".join(event.parts)
        yield (
            f"{event.start:7.2f} {event.end:7.2f}  {names:<28} {event.points:6d} {event.distance * 100:6.1f} cm"
            f"         {event.probability:.2f}  {event.decides}"
        )
    if not events:
        yield f"{search.source}: no part of the body touches another"
    if search.output is not None:
        yield f"{search.output}: {len(events)} contacts"
