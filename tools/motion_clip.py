"""A finished clip: rotations, the path of the hips, and what touches what when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from motion_body import SIDES, Performer
from motion_pose import Channels, pose
from motion_time import FPS

from retarget.body import rotations as rot

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Clip:
    """What the library stores of one motion."""

    name: str
    rotations: Array
    """(frames, joints, 4), neighbouring frames with the same sign."""
    hips: Array
    """(frames, 3), metres."""
    contacts: tuple[tuple[float, float, str, str], ...]
    """(start, end, part, part): seconds in which two body parts, or a foot and the 'floor', touch."""

    @classmethod
    def of(cls, performer: Performer, name: str, act: Channels, planted: dict[str, Array], touches: list[tuple[float, float, str, str]]) -> Clip:
        """The clip of some channels; feet touch the floor where they are planted."""
        rotations, hips = pose(performer, act)
        feet = [(a / FPS, b / FPS, side + "Foot", "floor") for side in SIDES for a, b in runs(planted[side])]
        return cls(name, rot.continuous(rotations), hips, tuple(touches) + tuple(feet))


def runs(flags: Array) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
