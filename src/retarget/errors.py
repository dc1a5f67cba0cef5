"""The small family of mistakes a user can make; everything else is a bug of ours.

A `RetargetError` says what was wrong, what was received and what would be right, in one line that the command
line prints as it is (exit code 2).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class RetargetError(ValueError):
    """Something the caller handed in cannot be used; the message says how to mend it.

    The text is one line of characters that can be shown: names in files, and of files, may hold line ends and the codes by
    which terminals are steered, which are written as escapes.

    >>> str(RetargetError("no joint 'a\\n\\x1b[2J'"))
    "no joint 'a\\\\n\\\\x1b[2J'"
    """

    def __str__(self) -> str:
        text = super().__str__()
        return text if text.isprintable() else "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


class FileError(RetargetError):
    """A file cannot be read or written as asked.

    `place` says where in the file ("line 12", "byte 840", "animations[3].channels[0]"); it may be empty.
    """

    def __init__(self, path: str | Path | None, problem: str, place: str = "") -> None:
        self.path, self.problem, self.place = path, problem, place
        where = ", ".join(str(part) for part in (path, place) if part)
        super().__init__(f"{where}: {problem}" if where else problem)


class MatchError(RetargetError):
    """Two bodies cannot be brought into correspondence; `missing` lists the canonical joints without a partner."""

    def __init__(self, problem: str, missing: Iterable[str] = ()) -> None:
        self.missing = tuple(missing)
        super().__init__(problem)


def unknown_name(kind: str, name: str, known: Iterable[str], where: str) -> RetargetError:
    """The error for a name that does not exist: the nearest ones, then how many there are.

    >>> str(unknown_name("joint", "LeftHandd", ["LeftHand", "Head"], "the skeleton"))
    "joint 'LeftHandd' is not in the skeleton; nearest: 'LeftHand'; 2 in all: LeftHand, Head"
    """
    known = list(known)
    nearest = difflib.get_close_matches(name, known, n=2, cutoff=0.4)
    hint = f"; nearest: {', '.join(map(repr, nearest))}" if nearest else ""
    listed = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return RetargetError(f"{kind} {name!r} is not in {where}{hint}; {len(known)} in all: {listed}")
