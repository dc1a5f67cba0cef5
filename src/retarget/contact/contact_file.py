"""The contacts file: TOML that lists the self-contacts of a performance, to keep, release, weaken or add some."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any

from retarget.contact.contact_list import ContactEvent
from retarget.contact.parts import PARTS
from retarget.errors import FileError, RetargetError, unknown_name
from retarget.io.whole_file import written_whole

DOES = ("auto", "keep", "release", "add")
STRONGEST = 10.0
FARTHEST = 1e6
"""Seconds and metres that no file means to exceed."""
LARGEST = 1_000_000
"""Bytes; a longer file is none of ours."""
KEYS = ("parts", "clip", "start", "end", "does", "strength", "gap", "probability", "points")
TABLES = ("contact", "strength")
KINDS = {"pose": 1.0, "girth": 0.0, "ground": 1.0}
"""Strength of each kind where a file says nothing."""
_ARM, _LEG = ("UpperArm", "Forearm", "Hand"), ("Thigh", "Shin", "Foot")
GROUPS: dict[str, tuple[str, ...]] = {
    "leftArm": tuple(f"left{part}" for part in _ARM), "rightArm": tuple(f"right{part}" for part in _ARM),
    "leftLeg": tuple(f"left{part}" for part in _LEG), "rightLeg": tuple(f"right{part}" for part in _LEG),
    "arms": tuple(f"{side}{part}" for side in ("left", "right") for part in _ARM),
    "legs": tuple(f"{side}{part}" for side in ("left", "right") for part in _LEG),
    "hands": ("leftHand", "rightHand"), "feet": ("leftFoot", "rightFoot"),
    "trunk": ("chest", "abdomen", "pelvis"),
    **{part: (part,) for part in PARTS},
}  # fmt: skip
"""What a line of [strength] names: groups of parts, or one part."""

HEAD = """\
# Contacts of the body with itself. Give this file to `retarget run ... --method interaction --contacts FILE`.
#
# parts        the two parts that touch: {parts}
# clip         name of the only clip that the entry is for, where a file holds several (left out: every clip)
# start, end   seconds from the start of what was taken of the clip; leave both out for all of it
# does         "auto": as probable as the pose means it; "keep": certainly; "release": not at all;
#              "add": the parts shall touch though they do not in the source
# strength     0 to 10, multiplies how much the contact counts
# gap          metres between the parts, with "add" only (0: they touch)
# probability, points   for information: how likely the pose means it, and how many points of the skin touch
# Where two entries speak of one moment of one pair, the later one counts. What is in no entry is "auto".

[strength]  # each line multiplies the contacts that one of its parts takes part in, once
# arms = 0.5   # {groups}, or a part
# pose = 1.0   # contacts that the pose means
# girth = 0.0  # contacts that the body's girth makes ("auto" only)
# ground = 1.0
"""


@dataclass(frozen=True)
class ContactEdit:
    """What shall become of the contacts of a pair of parts over a stretch of time. Raises `RetargetError` for what makes no
    sense."""

    parts: tuple[str, str]
    start: float | None = None
    """Seconds; None from the first frame."""
    end: float | None = None
    """Seconds; None to the last frame."""
    does: str = "auto"
    strength: float = 1.0
    gap: float = 0.0
    """Metres, for 'add'."""
    clip: str | None = None
    """Name of the only clip that it is for; None for every one."""

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise unknown_name("part", part, PARTS, "the body")
        if len(self.parts) != 2 or self.parts[0] == self.parts[1]:
            raise RetargetError(f"two parts touch, and a part cannot touch itself; received {', '.join(self.parts)}")
        if self.does not in DOES:
            raise RetargetError(f"does must be one of {', '.join(DOES)}; received {_shown(self.does)}")
        for name in ("start", "end", "gap"):
            if getattr(self, name) is not None:
                _check_range(name, getattr(self, name), FARTHEST)
        _check_range("strength", self.strength, STRONGEST)
        if self.gap and self.does != "add":
            raise RetargetError(f'gap goes with does = "add" only; received does = "{self.does}"')
        if (self.start or 0.0) > (math.inf if self.end is None else self.end):
            raise RetargetError(f"start must not be after end; received {self.start:g} and {self.end:g}")


@dataclass(frozen=True)
class ContactEdits:
    """A contacts file as read; hashable, so that it can be a setting of a method. Raises `RetargetError` for a strength of
    what has none, or that is out of range."""

    edits: tuple[ContactEdit, ...] = ()
    strength: tuple[tuple[str, float], ...] = ()
    """Names with their strength: groups and parts of `GROUPS`, and kinds of `KINDS`."""

    def __post_init__(self) -> None:
        known = (*(name for name in GROUPS if name not in PARTS), *KINDS, *PARTS)
        for name, value in self.strength:
            if name not in known:
                problem = str(unknown_name("name", name, known, "what has a strength")).split("; ")
                raise RetargetError("; ".join([*problem[:-1], f"{len(known)} in all: {', '.join(known)}"]))
            _check_range(name, value, STRONGEST)

    def of_clip(self, name: str) -> ContactEdits:
        """Those that are for the clip of that name."""
        return replace(self, edits=tuple(edit for edit in self.edits if edit.clip in (None, name)))

    def kind(self, name: str) -> float:
        """Strength of 'pose', 'girth' or 'ground'."""
        return dict(self.strength).get(name, KINDS[name])

    def speaks_of(self, name: str) -> bool:
        """Whether a strength of 'pose', 'girth' or 'ground' is given."""
        return name in dict(self.strength)

    def of_pair(self, parts: Collection[str]) -> float:
        """What the lines of groups and parts multiply a contact of two parts with: each line in which one of the two takes
        part, once."""
        lines = (value for name, value in self.strength if set(GROUPS.get(name, ())) & set(parts))
        return math.prod(lines, start=1.0)


def read_contacts(path: str | Path) -> ContactEdits:
    """Read a contacts file. Raises `FileError` with the place of what is wrong."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    path = Path(path)
    try:
        size = path.stat().st_size
        content = tomllib.loads(path.read_text(encoding="utf-8")) if size <= LARGEST else None
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise FileError(path, "is not UTF-8 text", f"byte {error.start}") from None
    except (ValueError, RecursionError) as error:  # ValueError: besides bad TOML, a number of thousands of digits
        raise FileError(path, f"is not valid TOML: {error}") from None
    if content is None:
        raise FileError(path, f"has {size} bytes, more than {LARGEST}; this is no contacts file")
    for table in content:
        if table not in TABLES:
            raise FileError(path, str(unknown_name("table", table, TABLES, "a contacts file")))
    rows, strength = content.get("contact", []), content.get("strength", {})
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise FileError(path, "entries must be tables, written [[contact]]", "contact")
    if not isinstance(strength, dict):
        raise FileError(path, f"strength must be a table, written [strength]; received {_shown(strength)}")
    edits = tuple(_edit(path, f"[[contact]] {number}", row) for number, row in enumerate(rows, 1))
    known = tuple((name, _number(path, "[strength]", name, value)) for name, value in strength.items())
    try:
        return ContactEdits(edits, known)
    except RetargetError as error:
        raise FileError(path, str(error), "[strength]") from None


def _edit(path: Path, place: str, row: dict[str, Any]) -> ContactEdit:
    for key in row:
        if key not in KEYS:
            raise FileError(path, str(unknown_name("key", key, KEYS, "a contact")), place)
    parts, clip = row.get("parts"), row.get("clip")
    if not isinstance(parts, list) or len(parts) != 2 or not all(isinstance(part, str) for part in parts):
        example = '["leftHand", "abdomen"]'
        raise FileError(path, f"parts must be two names, such as {example}; received {_shown(parts)}", place)
    if not isinstance(clip, (str, NoneType)):
        raise FileError(path, f"clip must be the name of one; received {_shown(clip)}", place)
    does = row.get("does", "auto")
    if not isinstance(does, str):
        raise FileError(path, f"does must be one of {', '.join(DOES)}; received {_shown(does)}", place)
    given = {key: _number(path, place, key, row[key]) for key in ("start", "end", "strength", "gap") if key in row}
    try:
        return ContactEdit((parts[0], parts[1]), does=does, clip=clip, **given)
    except RetargetError as error:
        raise FileError(path, str(error), place) from None


def _number(path: Path, place: str, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FileError(path, f"{name} must be a number; received {_shown(value)}", place)
    try:
        return float(value)
    except OverflowError:
        raise FileError(path, f"{name} must be from 0; received {_shown(value)}", place) from None


def _check_range(name: str, value: float, most: float) -> None:
    if not 0.0 <= value <= most:
        raise RetargetError(f"{name} must be from 0 to {most:g}; received {value:g}")


def _shown(value: Any) -> str:
    """A value in a message, shortened."""
    try:
        text = repr(value)
    except ValueError:  # thousands of digits
        return "a number too large to print"
    return text if len(text) <= 80 else f"{text[:77]}..."


def write_contacts(path: str | Path, events: Sequence[ContactEvent]) -> None:
    """Write events as entries that change nothing, to be edited. Raises `FileError`."""
    groups = ", ".join(name for name in GROUPS if name not in PARTS)
    lines = [HEAD.format(parts=", ".join(PARTS), groups=groups)]
    for event in events:
        lines += [
            "[[contact]]",
            f'parts = ["{event.parts[0]}", "{event.parts[1]}"]',
            f"start = {event.start:.3f}",
            f"end = {event.end:.3f}",
            'does = "auto"',
            "strength = 1.0",
            f"probability = {event.probability:.2f}  # decided by {event.decides}",
            f"points = {event.points}",
            "",
        ]
    with written_whole(path) as file:
        file.write("\n".join(lines).encode())
