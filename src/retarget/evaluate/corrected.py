"""What a result does otherwise than its source's joint angles merely copied: the copy, and the joints that were turned."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from retarget.body import rotations as rot
from retarget.character import Motion
from retarget.contact.ground import intervals
from retarget.correspond.joints import Humanoid
from retarget.evaluate.take import Take
from retarget.retargeting import prepare

NOTABLE = 3.0
"""Degrees by which a joint is turned before it is told."""
MOST = 12
"""Joints that are told, those turned farthest."""


def copied_take(source: Take, result: Take) -> Take:
    """The result's body with the source's joint angles copied and nothing corrected.

    Raises `RetargetError` where the bodies do not match.
    """
    plain = prepare(source.actor, result.actor, "copy-rotations", foot_lock=False, steady=False)
    return Take(result.actor, plain.retargeter(source.motion).motion)


def turned_joints(copied: Motion, result: Motion, humanoid: Humanoid) -> Iterator[str]:
    """A sentence for each canonical joint whose local rotation differs notably, the farthest first.

    Both motions are of one skeleton, length and frame rate.
    """
    between = rot.multiply(rot.inverse(copied.rotations), result.rotations)
    degrees = np.degrees(2 * np.arctan2(np.linalg.norm(between[..., :3], axis=-1), np.abs(between[..., 3])))
    farthest = degrees.max(axis=0, initial=0.0)
    names = sorted(humanoid.joints, key=lambda name: (-farthest[humanoid.joints[name]], name))
    for name in names[:MOST]:
        turn = degrees[:, humanoid.joints[name]]
        runs = intervals(turn > NOTABLE)
        if runs:
            spells = ", ".join(
                f"{start / result.fps:.2f} to {(stop - 1) / result.fps:.2f} s" for start, stop in runs[:4]
            )
            more = f" and {len(runs) - 4} more times" if len(runs) > 4 else ""
            yield f"{name} turned by up to {turn.max():.1f} degrees: {spells}{more}"
