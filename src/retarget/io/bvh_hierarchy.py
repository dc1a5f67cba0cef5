"""The HIERARCHY of a BVH file: words and braces to a skeleton and the list of its channels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from retarget.character import Skeleton
from retarget.errors import FileError
from retarget.io.asset import MOST_JOINTS
from retarget.io.decimal_text import number, shown

LONGEST_LINE = 1 << 16

CHANNEL = re.compile(rb"([XYZ])(POSITION|ROTATION)")

END_SITE = -1  # stands on the stack of open braces in the place of a joint


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """What stands above MOTION."""

    skeleton: Skeleton
    channels: tuple[tuple[int, str, int], ...]
    """Joint, 'position' or 'rotation', and axis (0 1 2) of each number of a frame, in the file's order."""
    has_motion: bool
    notes: tuple[str, ...]


def numbered_lines(path: Path, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """The lines of a file with their numbers, from 1. Raises `FileError` for a line longer than words ever are."""
    line = 0
    while text := file.readline(LONGEST_LINE):
        line += 1
        if len(text) == LONGEST_LINE:
            problem = f"a line of more than {LONGEST_LINE} characters; this is not a BVH hierarchy"
            raise FileError(path, problem, f"line {line}")
        yield line, text.removeprefix(b"\xef\xbb\xbf") if line == 1 else text


def read_hierarchy(path: Path, lines: Iterator[tuple[int, bytes]]) -> Hierarchy:
    """Read up to the word MOTION or the end of the file. Raises `FileError` with the line."""
    start = next(((line, text.strip()) for line, text in lines if text.strip()), None)
    if start is None:
        raise FileError(path, "is empty")
    if start[1].upper() != b"HIERARCHY":
        problem = f"is not a BVH file: it begins with {shown(start[1])} instead of 'HIERARCHY'"
        raise FileError(path, problem, f"line {start[0]}")
    builder = _Builder(path)
    for line, text in lines:
        for piece in re.split(rb"([{}])", text):
            if piece := piece.strip():
                builder.line = line
                if piece.split(None, 1)[0].upper() == b"MOTION" and builder.opening is None:
                    return builder.finished(has_motion=True)
                builder.take(piece)
    return builder.finished(has_motion=False)


@dataclass
class _Builder:
    """Takes one statement after another. A stack instead of recursion: no depth of nesting is a danger."""

    path: Path
    line: int = 1
    names: list[bytes] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float] | None] = field(default_factory=list)
    declared: list[bool] = field(default_factory=list)
    channels: list[tuple[int, str, int]] = field(default_factory=list)
    ends: dict[int, list[list[float]]] = field(default_factory=dict)
    open: list[int] = field(default_factory=list)
    opening: int | None = None
    """The joint (or end site) whose opening brace must come next."""

    def fault(self, problem: str) -> FileError:
        return FileError(self.path, problem, f"line {self.line}")

    def take(self, piece: bytes) -> None:
        keyword, *rest = piece.split(None, 1)
        argument = rest[0] if rest else b""
        statement = self.STATEMENTS.get(keyword.upper())
        if statement is None:
            known = "ROOT JOINT OFFSET CHANNELS End Site { } MOTION"
            raise self.fault(f"{shown(keyword)} is no word of a BVH hierarchy ({known})")
        if self.opening is not None and keyword != b"{":
            raise self.fault(f"expected '{{' after {self.what(self.opening)}, received {shown(piece)}")
        statement(self, argument)

    def what(self, joint: int) -> str:
        return "the end site" if joint == END_SITE else f"joint {shown(self.names[joint])}"

    def root(self, name: bytes) -> None:
        if self.names:
            raise self.fault(
                f"a second ROOT {shown(name)} beside {shown(self.names[0])}: one file may hold one skeleton; "
                "split it into one file a root, or make it a JOINT"
            )
        self.add(name, -1)

    def joint(self, name: bytes) -> None:
        if not self.open:
            raise self.fault(f"JOINT {shown(name)} stands outside the braces of a ROOT")
        if self.open[-1] == END_SITE:
            raise self.fault(f"JOINT {shown(name)} stands inside an End Site")
        self.add(name, self.open[-1])

    def add(self, name: bytes, parent: int) -> None:
        if not name:
            raise self.fault("a joint without a name")
        if len(self.names) == MOST_JOINTS:
            raise self.fault(f"more than {MOST_JOINTS} joints; this is no skeleton")
        self.opening = len(self.names)
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append(None)
        self.declared.append(False)

    def end_site(self, _: bytes) -> None:
        if not self.open or self.open[-1] == END_SITE:
            raise self.fault("an End Site outside a joint")
        self.opening = END_SITE

    def opened(self, _: bytes) -> None:
        if self.opening is None:
            raise self.fault("'{' without a ROOT, JOINT or End Site before it")
        if self.opening == END_SITE:
            self.ends.setdefault(self.open[-1], []).append([])
        self.open.append(self.opening)
        self.opening = None

    def closed(self, _: bytes) -> None:
        if not self.open:
            raise self.fault("'}' closes nothing")
        joint = self.open.pop()
        if not (self.ends[self.open[-1]][-1] if joint == END_SITE else self.offsets[joint]):
            raise self.fault(f"{self.what(joint)} has no OFFSET")

    def offset(self, argument: bytes) -> None:
        values = [number(token) for token in argument.split()]
        if len(values) != 3 or None in values:
            raise self.fault(f"OFFSET takes three finite numbers, received {shown(argument)}")
        if not self.open:
            raise self.fault("OFFSET stands outside a joint")
        joint = self.open[-1]
        if self.ends[self.open[-2]][-1] if joint == END_SITE else self.offsets[joint]:
            raise self.fault(f"a second OFFSET in {self.what(joint)}")
        if joint == END_SITE:
            self.ends[self.open[-2]][-1] = values
        else:
            self.offsets[joint] = values

    def channel_names(self, argument: bytes) -> None:
        if not self.open or self.open[-1] == END_SITE:
            raise self.fault("CHANNELS stands outside a joint")
        joint = self.open[-1]
        count, *names = argument.split() or [b""]
        if count != str(len(names)).encode():
            raise self.fault(f"CHANNELS gives the count {shown(count)} and then {len(names)} names")
        matches = [CHANNEL.fullmatch(name.upper()) for name in names]
        if None in matches:
            raise self.fault(f"{shown(names[matches.index(None)])} is no channel; those are Xposition ... Zrotation")
        channels = [(joint, match[2].decode().lower(), b"XYZ".index(match[1])) for match in matches]
        if len(set(channels)) < len(channels) or self.declared[joint]:
            raise self.fault(f"a channel of {self.what(joint)} is named twice")
        self.declared[joint] = True
        self.channels += channels

    STATEMENTS = {
        b"ROOT": root,
        b"JOINT": joint,
        b"END": end_site,
        b"{": opened,
        b"}": closed,
        b"OFFSET": offset,
        b"CHANNELS": channel_names,
    }

    def finished(self, has_motion: bool) -> Hierarchy:
        if self.open or self.opening is not None:
            inside = self.what(self.opening if self.opening is not None else self.open[-1])
            missing = f"{len(self.open)} closing braces are missing" if has_motion else "the file is cut off"
            raise self.fault(f"the hierarchy ends inside {inside}; {missing}")
        if not self.names:
            raise self.fault("the hierarchy has no ROOT")
        names, notes = _unique(self.names)
        notes += self.oddities(names)
        ends = {joint: np.array(sites[0]) for joint, sites in self.ends.items() if any(sites[0])}
        rest_rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1))
        skeleton = Skeleton(tuple(names), np.array(self.parents), np.array(self.offsets), rest_rotations, ends or None)
        return Hierarchy(skeleton, tuple(self.channels), has_motion, tuple(notes))

    def oddities(self, names: list[str]) -> Iterator[str]:
        """What is legal but worth a word."""
        short = [name for name, offset in zip(names[1:], self.offsets[1:], strict=True) if not any(offset)]
        still = [name for name, declared in zip(names, self.declared, strict=True) if not declared]
        forked = [names[joint] for joint, sites in self.ends.items() if len(sites) > 1]
        if short:
            yield f"{len(short)} bones have length zero: {_some(short)}"
        if still:
            yield f"{len(still)} joints have no CHANNELS and keep still: {_some(still)}"
        if forked:
            yield f"{len(forked)} joints have several End Sites, of which the first was kept: {_some(forked)}"


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")


def _unique(raw: list[bytes]) -> tuple[list[str], list[str]]:
    """Names as text, those that appear again with a number behind; and the note that says so."""
    names, taken, count, renamed = [], set(), {}, []
    reserved = set(raw)
    for bytes_ in raw:
        try:
            name = bytes_.decode("utf-8")
        except UnicodeDecodeError:
            name = bytes_.decode("latin-1")
        unique = name
        while unique in taken or (unique is not name and unique.encode() in reserved):
            count[name] = count.get(name, 1) + 1
            unique = f"{name}_{count[name]}"
        if unique != name:
            renamed.append(unique)
        taken.add(unique)
        names.append(unique)
    note = f"{len(renamed)} joints had the name of another and were numbered: {_some(renamed)}"
    return names, [note] if renamed else []
