"""The contacts file: TOML that lists the self-contacts of a performance, to keep, release, weaken or add some."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retarget.contact.contact_list import ContactEvent
from retarget.contact.parts import PARTS
from retarget.errors import FileError, unknown_name
from retarget.io.whole_file import written_whole

DOES = ("auto", "keep", "release", "add")
STRONGEST = 10.0
FARTHEST = 1e6
"""Seconds and metres that no file means to exceed."""
LARGEST = 1_000_000
"""Bytes; a longer file is none of ours."""
KEYS = ("parts", "start", "end", "does", "strength", "gap", "probability", "points")
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
    """What shall become of the contacts of a pair of parts over a stretch of time."""

    parts: tuple[str, str]
    start: float | None = None
    """Seconds; None from the first frame."""
    end: float | None = None
    """Seconds; None to the last frame."""
    does: str = "auto"
    strength: float = 1.0
    gap: float = 0.0
    """Metres, for 'add'."""


@dataclass(frozen=True)
class ContactEdits:
    """A contacts file as read; hashable, so that it can be a setting of a method."""

    edits: tuple[ContactEdit, ...] = ()
    strength: tuple[tuple[str, float], ...] = ()
    """Names with their strength: groups and parts of `GROUPS`, and kinds of `KINDS`."""

    def kind(self, name: str) -> float:
        """Strength of 'pose', 'girth' or 'ground'."""
        return dict(self.strength).get(name, KINDS[name])

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
    known = (*(name for name in GROUPS if name not in PARTS), *KINDS, *PARTS)
    for name, value in strength.items():
        if name not in known:
            problem = str(unknown_name("name", name, known, "what has a strength")).split("; ")
            raise FileError(path, "; ".join([*problem[:-1], f"{len(known)} in all: {', '.join(known)}"]), "[strength]")
        _number(path, "[strength]", name, value, STRONGEST)
    edits = tuple(_edit(path, f"[[contact]] {number}", row) for number, row in enumerate(rows, 1))
    return ContactEdits(edits, tuple((name, float(value)) for name, value in strength.items()))


def _edit(path: Path, place: str, row: dict[str, Any]) -> ContactEdit:
    for key in row:
        if key not in KEYS:
            raise FileError(path, str(unknown_name("key", key, KEYS, "a contact")), place)
    parts, does = row.get("parts"), row.get("does", "auto")
    if not isinstance(parts, list) or len(parts) != 2 or not all(isinstance(part, str) for part in parts):
        example = '["leftHand", "abdomen"]'
        raise FileError(path, f"parts must be two names, such as {example}; received {_shown(parts)}", place)
    for part in parts:
        if part not in PARTS:
            raise FileError(path, str(unknown_name("part", part, PARTS, "the body")), place)
    if parts[0] == parts[1]:
        raise FileError(path, f"a part cannot touch itself; received {parts[0]!r} twice", place)
    if does not in DOES:
        raise FileError(path, f"does must be one of {', '.join(DOES)}; received {_shown(does)}", place)
    if "gap" in row and does != "add":
        raise FileError(path, f'gap goes with does = "add" only; received does = "{does}"', place)
    given = {key: _number(path, place, key, row[key]) for key in ("start", "end", "gap") if key in row}
    if given.get("start", 0.0) > given.get("end", math.inf):
        raise FileError(path, f"start must not be after end; received {given['start']:g} and {given['end']:g}", place)
    strength = _number(path, place, "strength", row.get("strength", 1.0), STRONGEST)
    return ContactEdit((parts[0], parts[1]), does=does, strength=strength, **given)


def _number(path: Path, place: str, name: str, value: Any, most: float = FARTHEST) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FileError(path, f"{name} must be a number; received {_shown(value)}", place)
    if not 0.0 <= value <= most:
        raise FileError(path, f"{name} must be from 0 to {most:g}; received {_shown(value)}", place)
    return float(value)


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
