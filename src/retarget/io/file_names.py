"""Names of files that are made by the dozen: written anywhere, sorted as people count, and no two alike."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence

LONGEST = 120
"""Bytes of one name, without suffix; file systems take 255, and a temporary name is longer than the final one."""

_FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f\ud800-\udfff]')
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def natural_order(name: str) -> tuple:
    """Sort key: numbers by their value (walk2 before walk10), case last."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return tuple((int(part), "") if place % 2 else (0, part) for place, part in enumerate(parts)), name


def portable(name: str) -> str:
    """The name as every file system takes it: one part of a path, without characters that Windows refuses, not hidden.

    Not unique; see `distinct`.
    """
    name = _FORBIDDEN.sub("_", unicodedata.normalize("NFC", name))
    name = name.encode()[:LONGEST].decode(errors="ignore").rstrip(". ")
    name = "_" + name[1:] if name[:1] in (".", " ") else name
    return f"_{name}" if not name or _RESERVED.fullmatch(name) else name


def distinct(wanted: Sequence[Sequence[str]], suffix: str = "", taken: Iterable[str] = ()) -> list[str]:
    """One path for each, `suffix` included, no two alike even where case does not count.

    `wanted` lists for each the names it would take, '/' between the parts, the best first. Who alone wants a name as
    its best gets it; the others take a further choice, or a number, in the order given. No path is in `taken`, and none
    is a folder of another. The outcome depends on the arguments only.
    """
    used = {_folded(name) for name in taken}
    for choices in wanted:
        for choice in choices:
            parts = _folded(choice).split("/")
            used |= {"/".join(parts[:depth]) for depth in range(1, len(parts))}
    asked = Counter(_folded(choices[0]) for choices in wanted)
    chosen: list[str | None] = []
    for choices in wanted:
        first = choices[0] + suffix
        alone = asked[_folded(choices[0])] == 1 and _folded(first) not in used
        chosen.append(first if alone else None)
    used |= {_folded(name) for name in chosen if name is not None}
    for place, choices in enumerate(wanted):
        if chosen[place] is None:
            chosen[place] = next(name for name in _further(choices, suffix) if _folded(name) not in used)
            used.add(_folded(chosen[place]))
    return chosen


def _further(choices: Sequence[str], suffix: str) -> Iterable[str]:
    yield from (choice + suffix for choice in (choices[1:] or choices))
    number = 2
    while True:
        yield f"{choices[0]}_{number}{suffix}"
        number += 1


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
