"""The embedded motions: walks, leaps and self-contacts, made by the project itself for the embedded human.

`tools/build_motions.py` makes `library.npz`; `docs/motions.md` says what each motion shows. Contacts are true on the
skin of the performer: hands lie on it, soles on the floor.

    >>> motion = embedded_motion("walk")
    >>> motion.fps
    30.0
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from retarget.body.human import PRESETS, human
from retarget.character import Character, Motion
from retarget.errors import unknown_name

PERFORMER = "thin"
"""The preset of the embedded human whose motions these are."""
FILE = Path(__file__).with_name("library.npz")


@dataclass(frozen=True)
class StatedContact:
    """Two parts of the performer's body, or a foot and the floor, that touch for a while."""

    start: float
    end: float
    """Seconds; the contact is closed at both."""
    part: str
    """A part of the embedded human, such as 'leftHand'."""
    other: str
    """Another part, or 'floor'."""


@lru_cache(maxsize=1)
def performer() -> Character:
    """The embedded human that performs."""
    return human(name=PERFORMER, **PRESETS[PERFORMER])


@lru_cache(maxsize=1)
def motion_names() -> tuple[str, ...]:
    """Names of all embedded motions."""
    with np.load(FILE) as archive:
        return tuple(name.removesuffix("/hips") for name in archive.files if name.endswith("/hips"))


def embedded_motion(name: str) -> Motion:
    """One embedded motion over the performer's skeleton. Raises `RetargetError` for an unknown name."""
    stored = _stored(name)
    return Motion(
        performer().skeleton,
        stored["rotations"].astype(np.float64),
        stored["hips"][:, None],
        float(stored["fps"]),
        name=name,
    )


def embedded_contacts(name: str) -> tuple[StatedContact, ...]:
    """What touches what when in an embedded motion. Raises `RetargetError` for an unknown name."""
    stored = _stored(name)
    rows = zip(stored["contact_times"].tolist(), stored["contact_parts"].tolist(), strict=True)
    return tuple(StatedContact(*times, *parts) for times, parts in rows)


def _stored(name: str) -> dict[str, np.ndarray]:
    if name not in motion_names():
        raise unknown_name("motion", name, motion_names(), "the embedded library")
    with np.load(FILE) as archive:
        stored = {key: archive[f"{name}/{key}"] for key in ("rotations", "hips", "contact_times", "contact_parts")}
        return stored | {"fps": archive["fps"]}
