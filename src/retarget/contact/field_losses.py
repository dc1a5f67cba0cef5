"""How far two bodies' interaction fields are apart: the loss of Ye 2024, the same with lengths, and R2ET's of distances."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from retarget.contact.interaction_field import FieldPlan, dot, interaction_field, require_positions, stretches
from retarget.errors import RetargetError

Array = np.ndarray

HELD = 500_000
"""Entries held at a time when whole clips are compared: bounds the memory."""


def cosines(a: Float[Array, "*pairs 3"], b: Float[Array, "*pairs 3"]) -> Float[Array, "*pairs"]:
    """Cosine of the angle between vectors; 0 where one of them is zero."""
    lengths = np.sqrt(dot(a, a)) * np.sqrt(dot(b, b))
    return np.divide(dot(a, b), lengths, out=np.zeros_like(lengths), where=lengths > 0)


def cosine_loss(
    source_field: Float[Array, "frames rows targets 3"],
    target_field: Float[Array, "frames rows targets 3"],
    mask: Bool[Array, "frames rows targets"],
) -> float:
    """-(1/T) sum of cos(d_A, d_B) over the entries of the mask (Ye 2024, the DMI loss): a sum over pairs, a mean
    over frames; blind to length. 0 for no frame."""
    total = np.sum(cosines(source_field, target_field), where=mask, dtype=np.float64)
    return float(-total / max(1, len(mask)))


def vector_loss(
    source_field: Float[Array, "frames rows targets 3"],
    target_field: Float[Array, "frames rows targets 3"],
    mask: Bool[Array, "frames rows targets"],
    source_size: Float[Array, "rows"] | float,
    target_size: Float[Array, "rows"] | float,
) -> float:
    """(1/T) sum of |d_A / s_A - d_B / s_B|² over the entries of the mask: ours, which sees lengths too.

    Sizes are metres: limb radii (`FieldPlan.radii`, one a row) or body heights. 0 for no frame.
    """
    gap, other = (
        field * (1.0 / np.asarray(size, dtype=field.dtype))[..., None, None]
        for field, size in ((source_field, source_size), (target_field, target_size))
    )
    gap -= other
    return float(np.sum(dot(gap, gap), where=mask, dtype=np.float64) / max(1, len(mask)))


def distance_shares(points: Float[Array, "frames points 3"]) -> Float[Array, "frames points points"]:
    """Distances between all points, each row divided by its sum (R2ET's normalised distance matrix); rows of zeros stay."""
    away = points[:, :, None] - points[:, None]
    distances = np.sqrt(dot(away, away))
    total = distances.sum(axis=-1, keepdims=True)
    return np.divide(distances, total, out=np.zeros_like(distances), where=total > 0)


def distance_matrix_loss(
    source_points: Float[Array, "frames points 3"], target_points: Float[Array, "frames points 3"]
) -> float:
    """R2ET's semantic loss (Zhang 2023): squared difference of the two bodies' `distance_shares`, summed over the matrix,
    mean over frames. R2ET takes joints and divides by height first, which the division of each row by its sum undoes.
    """
    total = 0.0
    for now in stretches(len(source_points), HELD // max(1, source_points.shape[1] ** 2)):
        gap = distance_shares(source_points[now]) - distance_shares(target_points[now])
        total += float(np.sum(gap**2, dtype=np.float64))
    return total / max(1, len(source_points))


def field_losses(
    plan: FieldPlan,
    source: tuple[Float[Array, "frames sensors 3"], Float[Array, "frames sensors 3 3"]],
    target: tuple[Float[Array, "other_frames others 3"], Float[Array, "other_frames others 3 3"]],
) -> dict[str, float]:
    """Compare two clips (positions and frames of a `SensorSkinner`) without ever holding their whole fields: 'cosine'
    (`cosine_loss`), 'by_radius' and 'by_height' (`vector_loss` in limb radii and body heights), and 'pairs', how many
    are compared a frame: the least that 'cosine' can be is minus that.

    Raises `RetargetError` for clips of different lengths and as `FieldPlan.select` does.
    """
    require_positions(target[0], len(plan.layout))
    if len(source[0]) != len(target[0]):
        raise RetargetError(f"clips are compared frame by frame; received {len(source[0])} and {len(target[0])} frames")
    sums = {"cosine": 0.0, "by_radius": 0.0, "by_height": 0.0, "pairs": 0.0}
    for now in stretches(len(source[0]), HELD // max(1, plan.exists.size)):
        chosen = plan.select(source[0][now])
        here = interaction_field(source[0][now], source[1][now], chosen.observers, chosen.targets, chosen.source)
        there = interaction_field(target[0][now], target[1][now], chosen.observers, chosen.targets, chosen.both)
        count = len(chosen.both)
        sums["cosine"] += count * cosine_loss(here, there, chosen.both)
        sums["by_radius"] += count * vector_loss(here, there, chosen.both, *plan.radii)
        sums["by_height"] += count * vector_loss(here, there, chosen.both, *plan.heights)
        sums["pairs"] += int(np.count_nonzero(chosen.both))
    return {name: total / max(1, len(source[0])) for name, total in sums.items()}
