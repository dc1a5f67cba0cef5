"""What a person should look at before accepting a clip: one sentence a finding, the worst first."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from retarget.contact.ground import intervals

Array = np.ndarray

MOST = 10
"""Findings that are told."""
GAP = 0.2
"""Seconds: findings of one kind closer than this are one."""


@dataclass(frozen=True)
class Problem:
    """One finding."""

    sentence: str
    severity: float
    """How many times as much as is tolerable."""
    time: float
    """Seconds, of its worst frame."""
    about: tuple[str, ...]
    """Kind and body parts: of what is said of the same, the worst is told and the others are counted."""


@dataclass(frozen=True)
class Episode:
    """Frames on which something is wrong."""

    start: int
    stop: int
    worst: int
    value: float
    """On the worst frame."""


def worst_first(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """At most `MOST` of them; what happens to the same parts several times is told once, with the other times."""
    groups: dict[tuple[str, ...], list[Problem]] = {}
    for each in sorted(problems, key=lambda each: (-each.severity, each.time, each.sentence)):
        groups.setdefault(each.about, []).append(each)
    told = [replace(first, sentence=first.sentence + _also(first, others)) for first, *others in groups.values()]
    return tuple(told[:MOST])


def _also(first: Problem, others: list[Problem]) -> str:
    times = sorted(
        {f"{each.time:.2f} s" for each in others} - {f"{first.time:.2f} s"}, key=lambda text: float(text[:-2])
    )
    if len(times) > 3:
        return f"; and {len(times)} more times"
    return f"; also at {', '.join(times)}" if times else ""


def episodes(
    values: Float[Array, "frames"], beyond: Float[Array, "frames"] | Bool[Array, "frames"], fps: float
) -> Iterator[Episode]:
    """Runs of frames where `beyond` is true, short gaps bridged, with the frame of the largest value."""
    on = np.asarray(beyond, dtype=bool)
    runs = intervals(on)
    merged: list[tuple[int, int]] = []
    for start, stop in runs:
        if merged and start - merged[-1][1] < GAP * fps:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    for start, stop in merged:
        worst = start + int(np.argmax(np.where(on[start:stop], values[start:stop], -np.inf)))
        yield Episode(start, stop, worst, float(values[worst]))


def when(episode: Episode, fps: float) -> str:
    """'from 1.30 s to 1.87 s', or 'at 1.30 s'."""
    start, end = episode.start / fps, (episode.stop - 1) / fps
    return f"at {start:.2f} s" if episode.stop - episode.start == 1 else f"from {start:.2f} s to {end:.2f} s"


def problem(sentence: str, severity: float, episode: Episode, fps: float, *about: str) -> Problem:
    """A finding on an episode."""
    return Problem(sentence, float(severity), episode.worst / fps, about)


def cm(metres: float) -> str:
    return f"{100 * metres:.1f} cm"


def spoken(part: str) -> str:
    """'leftUpperArm' as 'left upper arm'."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", part).lower()


def together(parts: Iterable[str]) -> list[str]:
    """Spoken names; both sides of one part as one plural."""
    parts = list(parts)
    plural = {"Foot": "feet", "Thigh": "thighs"}
    names: list[str] = []
    for part in parts:
        side = next((each for each in ("left", "right") if part.startswith(each)), "")
        bare = part.removeprefix(side)
        other = {"left": "right", "right": "left"}.get(side, "") + bare
        both = bool(side) and other in parts
        name = plural.get(bare, spoken(bare) + "s") if both else spoken(part)
        if name not in names:
            names.append(name)
    return names
