"""Any motion as BVH."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Motion, Skeleton
from retarget.errors import RetargetError
from retarget.io.whole_file import written_whole

Array = np.ndarray

BLOCK = 256
"""Frames turned into text at a time."""


def save(path: str | Path, motion: Motion, order: str = "ZXY") -> None:
    """Write a motion as BVH, in the units and axes it has.

    `order` is the order of the rotation channels. BVH knows only rest poses without rotation, so the skeleton is
    expressed anew (`with_identity_rest`): joint positions, at rest and in every frame, stay what they are. The root and
    every joint in `moved` get position channels. Angles have 6 decimals, positions at least 6 (more for skeletons
    smaller than one unit); the file appears whole or not at all.

    Raises `RetargetError` for a motion without frames, an order that is not one of the six, and joint names that a line
    of BVH cannot hold; `FileError` where the file cannot be written.
    """
    if sorted(order) != ["X", "Y", "Z"]:
        raise RetargetError(f"the rotation order must be one of XYZ XZY YXZ YZX ZXY ZYX, received {order!r}")
    if len(motion) == 0:
        raise RetargetError(f"motion {motion.name!r} has no frame; a BVH file needs at least one")
    for name in motion.skeleton.names:
        _expect_writable(name)
    motion = with_identity_rest(motion)
    decimals = _decimals(motion.skeleton)
    with written_whole(path) as file:
        file.write(_hierarchy(motion, order, decimals).encode())
        for lines in _frame_lines(motion, order, decimals):
            file.write(lines.encode("ascii"))


def with_identity_rest(motion: Motion) -> Motion:
    """The same motion on a skeleton whose rest rotations are all identity.

    With W the world rotation of a joint at rest and P its parent, a local rotation r becomes W_P r W^-1 and a local
    position p becomes W_P p: joint positions agree at rest and in every frame, and each world rotation becomes the
    turn from rest to now.
    """
    skeleton = motion.skeleton
    if np.array_equal(skeleton.rest_rotations, np.broadcast_to(rot.IDENTITY, skeleton.rest_rotations.shape)):
        return motion
    world = rest_pose(skeleton)[0]
    above = np.concatenate([rot.IDENTITY[None], world[skeleton.parents[1:]]])
    ends = {joint: rot.rotate(world[joint], end) for joint, end in (skeleton.end_offsets or {}).items()}
    upright = replace(
        skeleton,
        offsets=rot.rotate(above, skeleton.offsets),
        rest_rotations=np.broadcast_to(rot.IDENTITY, world.shape).copy(),
        end_offsets=ends or None,
    )
    return replace(
        motion,
        skeleton=upright,
        rotations=rot.multiply(rot.multiply(above, motion.rotations), rot.inverse(world)),
        translations=rot.rotate(above[list(motion.moved)], motion.translations),
    )


def _expect_writable(name: str) -> None:
    """The reader takes a name up to the line's end or a brace, without the blanks around it, as UTF-8."""
    try:
        raw = name.encode()
    except UnicodeEncodeError:
        raise RetargetError(f"joint {name!r} cannot be written: its name is not valid text; rename it") from None
    if not raw or raw != raw.strip() or any(byte < 32 or byte in b"{}" for byte in raw):
        cure = "a name is one line without braces and outer blanks; rename it"
        raise RetargetError(f"joint {name!r} cannot be written as BVH: {cure}")


def _decimals(skeleton: Skeleton) -> int:
    """Digits behind the point of a length: a millionth of the unit, or of the largest offset where that is less."""
    largest = np.abs(skeleton.offsets).max()
    return 6 if largest == 0 else int(np.clip(6 - np.floor(np.log10(largest)), 6, 15))


def _hierarchy(motion: Motion, order: str, decimals: int) -> str:
    """Everything down to the frame time. One pass in the joints' order would not do: BVH nests, so walk the tree."""
    skeleton, out = motion.skeleton, io.StringIO()
    rotation = " ".join(f"{axis}rotation" for axis in order)
    ends, moved = skeleton.end_offsets or {}, set(motion.moved)
    out.write("HIERARCHY\n")
    for joint, depth, enter in _walk(skeleton):
        tab = "\t" * min(depth, 64)
        if not enter:
            out.write(f"{tab}}}\n")
            continue
        channels = f"6 Xposition Yposition Zposition {rotation}" if joint in moved else f"3 {rotation}"
        out.write(f"{tab}{'ROOT' if joint == 0 else 'JOINT'} {skeleton.names[joint]}\n{tab}{{\n")
        out.write(f"{tab}\tOFFSET {_vector(skeleton.offsets[joint], decimals)}\n{tab}\tCHANNELS {channels}\n")
        end = ends.get(joint)
        if end is not None or joint not in skeleton.parents:  # readers expect an end below every leaf
            site = _vector(np.zeros(3) if end is None else end, decimals)
            out.write(f"{tab}\tEnd Site\n{tab}\t{{\n{tab}\t\tOFFSET {site}\n{tab}\t}}\n")
    seconds = np.format_float_positional(1 / motion.fps, precision=12, fractional=False, trim="0")
    out.write(f"MOTION\nFrames: {len(motion)}\nFrame Time: {seconds}\n")
    return out.getvalue()


def _walk(skeleton: Skeleton) -> Iterator[tuple[int, int, bool]]:
    """Joints depth first, each on the way in (True) and on the way out, with its depth."""
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint in range(len(skeleton) - 1, 0, -1):
        children[skeleton.parents[joint]].append(joint)
    stack = [(0, 0, True)]
    while stack:
        joint, depth, enter = stack.pop()
        yield joint, depth, enter
        if enter:
            stack.append((joint, depth, False))
            stack += [(child, depth + 1, True) for child in children[joint]]


def _vector(values: Float[Array, "3"], decimals: int) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in np.round(values, decimals) + 0.0)


def _frame_lines(motion: Motion, order: str, decimals: int) -> Iterator[str]:
    """The lines of numbers, a block of frames at a time, columns as the hierarchy names the joints."""
    joints = np.array([joint for joint, _, enter in _walk(motion.skeleton) if enter])
    slot = {joint: i for i, joint in enumerate(motion.moved)}
    width = 3 * (len(joints) + len(slot))
    turns, places, column = np.empty(len(joints), int), np.empty(len(slot), int), 0
    formats: list[str] = []
    for i, joint in enumerate(joints.tolist()):
        if joint in slot:
            places[slot[joint]], column = column, column + 3
            formats += [f"%.{decimals}f"] * 3
        turns[i], column = column, column + 3
        formats += ["%.6f"] * 3
    line = " ".join(formats) + "\n"
    xyz = np.arange(3)
    before = np.zeros((1, len(joints), 3))
    for start in range(0, len(motion), BLOCK):
        angles = rot.to_euler(motion.rotations[start : start + BLOCK, joints], order)
        angles = np.unwrap(np.concatenate([before, angles]), axis=0)[1:]  # a turn of 181 degrees is no jump to -179
        before = angles[-1:]
        values = np.empty((len(angles), width))
        values[:, turns[:, None] + xyz] = np.round(np.degrees(angles), 6)
        values[:, places[:, None] + xyz] = np.round(motion.translations[start : start + BLOCK], decimals)
        yield "".join(line % tuple(row) for row in (values + 0.0).tolist())  # + 0.0: no minus before zero
