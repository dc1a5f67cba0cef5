"""Metrics of a rig that was made for a mesh, against the true one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.evaluate.metrics.basis import at_reference_height, require_alike

Array = np.ndarray


def weight_mse_x100(
    result: Float[Array, "vertices joints"], truth: Float[Array, "vertices joints"]
) -> Float[Array, "joints"]:
    """Skinning weight error of each joint: 100 mean over all vertices of (w - w_true)², no unit (Musoni 2021, table 1).

    Dense weights from 0 to 1, a column a joint. The paper prints its factor as "10e2", but its text bounds all errors by
    .017 where the table's largest is 1.64: the factor is 100. Its rows are joints and means over ten bodies.
    """
    require_alike(truth=truth, result=result)
    return 100 * ((result - truth) ** 2).mean(axis=0) if len(result) else np.full(result.shape[1], np.nan)


def joint_error_cm(
    result: Float[Array, "joints 3"], truth: Float[Array, "joints 3"], height: float
) -> Float[Array, "joints"]:
    """Distance of each joint in the rest pose from its true place, |r - t|, cm at 1.7 m. The measure is common; Musoni
    2021 reports weights only."""
    require_alike(truth=truth, result=result)
    return 100 * at_reference_height(np.linalg.norm(result - truth, axis=-1), height)
