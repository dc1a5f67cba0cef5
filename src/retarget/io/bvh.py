"""BVH: a skeleton in words, then one line of numbers a frame. Our own reader and writer.

The format leaves things open; this is how they are read here:

- Position channels *replace* the OFFSET, as in Blender. Below the root some exporters write what is to be *added* to it
  (MakeHuman's `tpose.bvh`). The first frame tells: where most joints would sit on top of their parents, the values
  are added. A position axis without channel keeps the offset's.
- The rest pose has identity rotations: at rest every joint sits at its OFFSET from its parent.
- The frame time is printed with few digits; where it is what a usual frame rate rounds to, that rate is meant.
- A frame is a line. Frames wrapped over several lines are understood when the numbers add up exactly.

BVH says nothing of units and axes, so neither does the `Convention` of what is returned.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal, InvalidOperation
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.character import Character, Motion
from retarget.errors import FileError
from retarget.io.asset import Asset, Clip
from retarget.io.bvh_hierarchy import Hierarchy, numbered_lines, read_hierarchy
from retarget.io.bvh_write import save
from retarget.io.decimal_text import LARGEST, number, numbers, shown, workable

__all__ = ["frames_per_second", "load", "save"]

Array = np.ndarray

# In the order of preference: a frame time printed as 0.033 means 30, not 29.97.
USUAL_RATES = tuple(map(Decimal, (
    "30 60 120 24 25 50 100 15 20 10 12 48 72 75 90 144 150 180 200 240 250 300 360 480 500 1000 "
    "29.97 59.94 23.976 119.88 47.952 239.76"
).split()))  # fmt: skip

BLOCK = 1 << 18
"""Bytes parsed at a time: the numbers of one block stay in the cache until they are rotations."""


@dataclass(frozen=True)
class _Frames:
    """Where the numbers lie in the file."""

    count: int
    fps: float
    start: int
    """Byte where the lines of numbers begin."""
    line: int
    """The number of the first of these lines."""
    end: int = 0
    """Byte behind the last frame."""


def load(path: str | Path) -> Asset:
    """Read a BVH file: skeleton and layout at once, the numbers when `read_clip` asks for them.

    A file that ends after its hierarchy is a skeleton without clips. Raises `FileError` with the line for anything that
    is not BVH, several roots, frames that are cut off, and numbers that are not finite.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            lines = numbered_lines(path, file)
            hierarchy = read_hierarchy(path, lines)
            character = Character(hierarchy.skeleton, name=path.stem)
            if not hierarchy.has_motion:
                return Asset(path, "motion", character=character, notes=hierarchy.notes)
            frames, notes = _read_header(path, file, lines)
            frames, more = _measure(path, file, frames, hierarchy)
            added = _positions_are_added(path, file, frames, hierarchy)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    notes = hierarchy.notes + notes + more
    if added:
        notes += ("position channels below the root vanish beside the offsets, so they were added to them",)
    clips = (Clip(path.stem, frames.count, frames.fps),)

    def read_clip(_: int) -> Motion:
        return _decode(path, hierarchy, frames, added)

    return Asset(path, "motion", character, clips=clips, notes=notes, read_clip=read_clip)


def frames_per_second(printed: str) -> float:
    """The frame rate that a printed frame time (seconds) means. Raises `ValueError` for what is not positive.

    >>> frames_per_second(".0083333"), frames_per_second("0.041667"), frames_per_second("0.0312")
    (120.0, 24.0, 32.05128205128205)
    """
    try:
        seconds = Decimal(printed)
    except InvalidOperation:
        raise ValueError(f"{printed!r} is not a number") from None
    if not seconds.is_finite() or not 1e-12 <= seconds <= LARGEST:
        raise ValueError(f"{printed!r} is not a positive number of seconds")
    exact = 1 / float(seconds)
    if exact == round(exact):
        return exact
    digit = Decimal(1).scaleb(int(seconds.as_tuple().exponent))
    for rate in USUAL_RATES:
        if digit < 1 / rate and seconds in [(1 / rate).quantize(digit, way) for way in (ROUND_HALF_EVEN, ROUND_DOWN)]:
            return float(rate)
    return exact


def _read_header(path: Path, file: BinaryIO, lines: Iterator[tuple[int, bytes]]) -> tuple[_Frames, tuple[str, ...]]:
    """The two lines below MOTION."""
    line, count = _header_value(path, lines, rb"\s*frames\s*:?\s*(\S+)\s*", "Frames: COUNT")
    if not re.fullmatch(rb"\+?\d{1,15}", count):
        raise FileError(path, f"the number of frames must be a whole number, received {shown(count)}", f"line {line}")
    if int(count) == 0:
        raise FileError(path, "there is no frame (Frames: 0); a skeleton alone ends before MOTION", f"line {line}")
    line, printed = _header_value(path, lines, rb"\s*frame\s*time\s*:?\s*(\S+)\s*", "Frame Time: SECONDS")
    try:
        if number(printed) is None:  # spaces of other codes are none to `float`, but would be to what follows
            raise ValueError
        fps = frames_per_second(printed[:64].decode("latin-1"))
    except ValueError:
        problem = f"the frame time must be a positive number of seconds, received {shown(printed)}"
        raise FileError(path, problem, f"line {line}") from None
    notes = ()
    if abs(fps * float(printed) - 1) > 1e-3:
        notes = (f"the frame time {shown(printed)} s was read as {fps:g} frames a second",)
    return _Frames(int(count), fps, file.tell(), line + 1), notes


def _header_value(path: Path, lines: Iterator[tuple[int, bytes]], pattern: bytes, wanted: str) -> tuple[int, bytes]:
    for line, text in lines:
        if match := re.fullmatch(pattern, text, re.IGNORECASE):
            return line, match[1]
        if text.strip():
            raise FileError(path, f"expected '{wanted}', received {shown(text.strip())}", f"line {line}")
    raise FileError(path, f"ends where '{wanted}' should stand; the file is cut off")


def _measure(path: Path, file: BinaryIO, frames: _Frames, hierarchy: Hierarchy) -> tuple[_Frames, tuple[str, ...]]:
    """Count the numbers on every line, without parsing them: where do the frames end, and are they all there?"""
    channels, joints = len(hierarchy.channels), len(hierarchy.skeleton)
    if channels == 0:
        raise FileError(path, "the hierarchy names no CHANNELS, so the frames can hold nothing", f"line {frames.line}")
    if joints > 100 * channels and joints * frames.count > 1e8:
        problem = f"{frames.count} frames of {joints} joints with {channels} channels: leave out joints that keep still"
        raise FileError(path, problem)
    seen = total = end = 0
    line, odd, last = frames.line, None, 0
    notes: tuple[str, ...] = ()
    for counts, ends in _line_counts(file, frames.start):
        filled = np.flatnonzero(counts)
        rows = filled[: frames.count - seen]
        wrong = rows[counts[rows] != channels]
        if odd is None and len(wrong):
            odd = (line + int(wrong[0]), int(counts[wrong[0]]), seen + int(np.searchsorted(rows, wrong[0])))
        if odd is None and len(rows) < len(filled):
            behind = line + int(filled[len(rows)])
            notes = (f"what follows the {frames.count} frames from line {behind} on was passed over",)
        seen, total = seen + len(rows), total + int(counts.sum())
        end = int(ends[rows[-1]]) if len(rows) else end
        last = line + int(filled[-1]) if len(filled) else last
        line += len(counts)
        if notes:
            break
    if odd is None and seen == frames.count:
        return replace(frames, end=end), notes
    if total == frames.count * channels:
        return replace(frames, end=file.seek(0, 2)), ("the frames are wrapped over several lines",)
    if odd is None:
        problem = f"declares {frames.count} frames and ends after {seen}; the file is cut off"
        raise FileError(path, problem, f"line {line}")
    place = f"line {odd[0]}"
    if odd[0] == last and odd[1] < channels:
        problem = f"ends inside frame {odd[2] + 1} of {frames.count}, after {odd[1]} of its {channels} numbers"
        raise FileError(path, problem, place)
    raise FileError(path, f"frame {odd[2] + 1} has {odd[1]} numbers; the hierarchy has {channels} channels", place)


def _line_counts(file: BinaryIO, start: int) -> Iterator[tuple[Int[Array, "lines"], Int[Array, "lines"]]]:
    """Block by block: how many words each line holds, and the byte behind each line."""
    words, blank_before, position = 0, True, start
    file.seek(start)
    while block := file.read(BLOCK):
        text = np.frombuffer(block, np.uint8)
        blank = text <= ord(" ")
        starts = np.flatnonzero(~blank & np.append(blank_before, blank[:-1]))
        breaks = np.flatnonzero(text == ord("\n"))
        before = np.searchsorted(starts, breaks)
        if len(breaks):
            yield np.diff(before, prepend=-words), position + breaks + 1
            words = len(starts) - int(before[-1])
        else:
            words += len(starts)
        blank_before, position = bool(blank[-1]), position + len(block)
    if words:
        yield np.array([words]), np.array([position])


def _values(path: Path, file: BinaryIO, frames: _Frames, channels: int) -> Iterator[Float[Array, "frames channels"]]:
    """The numbers, some frames at a time."""
    rest, text, position, done = np.empty(0), b"", frames.start, 0
    file.seek(position)
    while position < frames.end and (block := file.read(min(BLOCK, frames.end - position))):
        position += len(block)
        text += block
        last_blank = max(text.rfind(blank) for blank in (b" ", b"\n", b"\t", b"\r"))
        cut = len(text) if position == frames.end else last_blank + 1
        values = numbers(text[:cut])
        if values is None or not workable(values) or len(text) - cut > BLOCK:
            raise _bad_number(path, file, frames, position - len(text))
        text = text[cut:]
        rest = np.concatenate([rest, values])
        whole = len(rest) // channels
        if whole:
            yield rest[: whole * channels].reshape(whole, channels)
            done, rest = done + whole, rest[whole * channels :]
    if done != frames.count or len(rest):
        raise _bad_number(path, file, frames, frames.start)


def _bad_number(path: Path, file: BinaryIO, frames: _Frames, position: int) -> FileError:
    """Look again, slowly, for the first word from `position` on that is no number."""
    line = frames.line
    file.seek(frames.start)
    while file.tell() < position:
        line += file.read(min(BLOCK, position - file.tell())).count(b"\n")
    for here, text in enumerate(file, line):
        for word in text.split():
            if number(word) is None:
                return FileError(path, f"{shown(word)} is no finite number", f"line {here}")
    return FileError(path, "the numbers cannot be parsed; has the file changed while it was read?", f"line {line}")


def _positions_are_added(path: Path, file: BinaryIO, frames: _Frames, hierarchy: Hierarchy) -> bool:
    """Whether position channels below the root hold changes of the offset; see the head of this file.

    The evidence must be strong: in the first frame most of these joints would sit on top of their parents.
    """
    columns, joints, axes = _position_channels(hierarchy)
    offsets = hierarchy.skeleton.offsets[joints, axes]
    telling = (joints > 0) & (offsets != 0)
    if not telling.any():
        return False
    first = next(_values(path, file, frames, len(hierarchy.channels)))[0, columns]
    return bool(np.median(np.abs(first[telling] / offsets[telling])) < 1e-3)


def _position_channels(hierarchy: Hierarchy) -> Int[Array, "3 channels"]:
    """Column, joint and axis of each position channel."""
    channels = enumerate(hierarchy.channels)
    found = [(column, joint, axis) for column, (joint, what, axis) in channels if what == "position"]
    return np.array(found, dtype=int).reshape(-1, 3).T


def _rotation_channels(hierarchy: Hierarchy) -> list[tuple[str, Int[Array, "joints"], Int[Array, "joints axes"]]]:
    """Joints that share an order of rotation axes: the order, the joints, and their columns."""
    columns: dict[int, list[int]] = {}
    orders: dict[int, str] = {}
    for column, (joint, what, axis) in enumerate(hierarchy.channels):
        if what == "rotation":
            columns.setdefault(joint, []).append(column)
            orders[joint] = orders.get(joint, "") + "XYZ"[axis]
    groups: dict[str, list[int]] = {}
    for joint, order in orders.items():
        groups.setdefault(order, []).append(joint)
    return [(order, np.array(group), np.array([columns[joint] for joint in group])) for order, group in groups.items()]


def _decode(path: Path, hierarchy: Hierarchy, frames: _Frames, added: bool) -> Motion:
    skeleton = hierarchy.skeleton
    groups = _rotation_channels(hierarchy)
    columns, joints, axes = _position_channels(hierarchy)
    placed = np.union1d([0], joints)
    slots = 3 * np.searchsorted(placed, joints) + axes
    base = np.where(added & (joints > 0), skeleton.offsets[joints, axes], 0.0)
    rotations = np.empty((frames.count, len(skeleton), 4))
    rotations[:, list(set(range(len(skeleton))).difference(*(turned for _, turned, _ in groups)))] = rot.IDENTITY
    positions = np.broadcast_to(skeleton.offsets[placed].ravel(), (frames.count, 3 * len(placed))).copy()
    start = 0
    try:
        with open(path, "rb") as file:
            for values in _values(path, file, frames, len(hierarchy.channels)):
                stop = start + len(values)
                positions[start:stop, slots] = values[:, columns] + base
                for order, turned, angles in groups:
                    rotations[start:stop, turned] = rot.from_euler(np.radians(values[:, angles]), order)
                start = stop
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from None
    positions = positions.reshape(frames.count, len(placed), 3)
    kept = _leaves_its_offset(positions, skeleton.offsets[placed])
    return Motion(skeleton, rotations, positions[:, kept], frames.fps, tuple(placed[kept].tolist()), path.stem)


def _leaves_its_offset(
    positions: Float[Array, "frames joints 3"], offsets: Float[Array, "joints 3"]
) -> Bool[Array, "joints"]:
    """Which joints really move against their parents; the root always counts."""
    still = 1e-6 * np.abs(offsets).max()
    moves = np.abs(positions - offsets).max(axis=(0, 2)) > still
    moves[0] = True
    return moves
