"""Frames on which a result has no fault of touch: nothing to mend, so nothing should change."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.evaluate import metrics
from retarget.evaluate.touch import SourceTouch, TouchJudge

Array = np.ndarray


def faultless_frames(
    touch: SourceTouch, judge: TouchJudge, result: Motion, countable: Bool[Array, "tracks"] | None
) -> Bool[Array, "frames"]:
    """Frames on which no limb vertex penetrates beyond the source's share and every counted contact of the pose is kept."""
    depth = judge.collider.depths(judge.skinner.vertices(*world_pose(result)))
    percent = metrics.penetration_percent(depth, judge.collider.parts.limb_vertices)
    in_source = metrics.penetration_percent(touch.depth, touch.parts.limb_vertices)
    good = percent <= in_source + 1e-9
    lost, frame = judge.lost(touch, result, countable)
    good[frame[lost]] = False
    return good
