"""Contacts of a clip as a short list that a person can read: which parts touch, from when to when, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from retarget.contact.detect import Contacts
from retarget.contact.parts import PARTS

BRIDGE = 0.25
"""Seconds: a pair of parts that lets go for less is one event."""


@dataclass(frozen=True)
class ContactEvent:
    """Two parts of a body that touch for a while."""

    parts: tuple[str, str]
    """Names among `contact.parts.PARTS`; hands first, then limbs, then the trunk."""
    start: float
    """Seconds of the first frame, from the start of the clip."""
    end: float
    """Seconds of the last frame."""
    points: int
    """Different vertices that touch, of either part."""
    distance: float
    """The least, signed, metres; negative where the parts are inside each other."""
    probability: float
    """How likely the pose means it (1) and the body's girth does not make it (0); the mean over rows."""

    @property
    def decides(self) -> str:
        """'pose' or 'girth': what the contact comes from, more likely."""
        return "pose" if self.probability >= 0.5 else "girth"


def contact_events(contacts: Contacts, fps: float) -> list[ContactEvent]:
    """Events by time, then by pair."""
    own = contacts.tracks.own_part[contacts.track]
    key = np.minimum(own, contacts.part) * len(PARTS) + np.maximum(own, contacts.part)
    probability = contacts.tracks.pose_probability[contacts.track]
    events = []
    for pair in np.unique(key):
        rows = np.flatnonzero(key == pair)  # in the order of frames
        frames = contacts.frame[rows]
        breaks = np.flatnonzero(np.diff(frames) - 1 > BRIDGE * fps) + 1
        for group in np.split(rows, breaks):
            start, end = contacts.frame[group[[0, -1]]] / fps
            events.append(
                ContactEvent(
                    ordered_parts(PARTS[pair // len(PARTS)], PARTS[pair % len(PARTS)]), float(start), float(end),
                    len(np.unique(contacts.vertex[group])), float(contacts.distance[group].min()),
                    float(probability[group].mean()),
                )
            )  # fmt: skip
    return sorted(events, key=lambda event: (event.start, event.end, event.parts))


def ordered_parts(one: str, other: str) -> tuple[str, str]:
    """A pair in the order that events name it."""
    first, second = sorted((one, other), key=lambda name: (not name.endswith("Hand"), -PARTS.index(name)))
    return first, second
