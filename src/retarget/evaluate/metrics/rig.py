"""Metrics of a rig that was made for a mesh, against the true one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from retarget.evaluate.metrics.basis import at_reference_height, positive, procrustes, require_alike

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
    """Distance of each joint from its true place in the same pose, |r - t|, cm at 1.7 m. The measure is common; Musoni
    2021 reports weights only."""
    require_alike(truth=truth, result=result)
    return 100 * at_reference_height(np.linalg.norm(result - truth, axis=-1), height)


def rest_vertex_error_cm(
    result: Float[Array, "vertices 3"], truth: Float[Array, "vertices 3"], height: float
) -> Float[Array, "vertices"]:
    """Distance of each vertex at rest from its true place after both were laid onto each other by the best turn and move,
    without scale: |P(r) - t|, cm at 1.7 m. Ours: Musoni 2021 shows rest poses as pictures (figure 6)."""
    return 100 * at_reference_height(np.linalg.norm(procrustes(result[None], truth[None])[0] - truth, axis=-1), height)


def registration_mm(
    result: Float[Array, "vertices 3"], truth: Float[Array, "vertices 3"], height: float
) -> Float[Array, "vertices"]:
    """Distance of each vertex of the template laid onto a mesh from its true place there, |r - t|, mm at 1.7 m."""
    require_alike(truth=truth, result=result)
    return 1000 * at_reference_height(np.linalg.norm(result - truth, axis=-1), height)


def map_error_percent(
    result: Float[Array, "vertices 3"], truth: Float[Array, "vertices 3"], height: float
) -> Float[Array, "vertices"]:
    """Distance on the template at rest between the place that a vertex is mapped to and its true one, 100 |r - t| / h, per
    cent of the template's height. Through space: for most pairs about as long as along the skin, and no shorter for those
    that matter (a left hand from a right one)."""
    require_alike(truth=truth, result=result)
    return 100 * np.linalg.norm(result - truth, axis=-1) / positive("height", height)


def flipped_percent(
    result: Float[Array, "vertices 3"],
    truth: Float[Array, "vertices 3"],
    mirrored: Float[Array, "vertices 3"],
    apart: float,
) -> float:
    """100 x share of vertices mapped nearer to the mirror image of their true place than to the place itself, among all;
    those whose image is nearer than `apart` to the place (the midline) never count. nan without vertices."""
    require_alike(truth=truth, result=result, mirrored=mirrored)
    far = np.linalg.norm(mirrored - truth, axis=-1) > apart
    nearer = np.linalg.norm(result - mirrored, axis=-1) < np.linalg.norm(result - truth, axis=-1)
    return 100 * float((far & nearer).mean()) if len(truth) else float("nan")


def torn_percent(
    result: Float[Array, "vertices 3"],
    posed: Float[Array, "vertices 3"],
    edges: Int[Array, "edges 2"],
    height: float,
) -> float:
    """100 x share of edges that are longer at rest (`result`) than twice their length in the pose plus 3 % of the height: an
    arm that took a piece of the hip along. nan without edges. Both in the unit of `height`."""
    require_alike(posed=posed, result=result)
    before, after = (np.linalg.norm(each[edges[:, 0]] - each[edges[:, 1]], axis=1) for each in (posed, result))
    torn = after > 2 * before + 0.03 * positive("height", height)
    return 100 * float(torn.mean()) if len(edges) else float("nan")
