"""Metrics of touch: contacts kept and gained, vertices inside other parts of the body.

Depths come from the exact collision test: metres below the surface of a part that the vertex does not belong to, zero,
negative or nan where it is outside. A vertex penetrates when it is deeper than 1 mm (ours: skin on skin is contact, and
exact tests agree on what is deeper).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.errors import RetargetError
from retarget.evaluate.metrics.basis import at_reference_height, mean, positive, require_alike

Array = np.ndarray

DEEPER_THAN = 0.001
"""Metres; shallower vertices do not count as penetrating."""
SLACK = 1.5
"""A contact is kept within so many thresholds, and not yet gained where the source is within as many."""


def contact_error(
    source_distance: Float[Array, "frames pairs"],
    target_distance: Float[Array, "frames pairs"],
    source_radius: float,
    target_radius: float,
    two_sided: bool = False,
) -> float:
    """Contact error of Ye 2024 (appendix B): mean over pairs and frames of (|d_A|/R_A - |d_B|/R_B)², no unit.

    A pair is a sensor on a hand and one on the body; |d| are their distances (metres) on source A and target B, R the
    radius of each one's arm. A pair counts on the frames on which the source's distance is below its arm's diameter
    2 R_A, nan where none is; give nan as source distance where a sensor misses. Its error is zero unless the retargeted distance exceeds the source's, |d_B|/R_B >
    |d_A|/R_A, as the paper's prose says; the equation printed beside it has the opposite inequality, which would
    charge a hand for coming closer and never for losing touch. `two_sided` charges both (ours).
    The paper does not say over what the error is averaged; over all counted pairs, also those without error, is ours.
    """
    require_alike(source_distance=source_distance, target_distance=target_distance)
    counted = source_distance < 2 * positive("source_radius", source_radius)
    gap = (target_distance / positive("target_radius", target_radius) - source_distance / source_radius)[counted]
    return mean((gap if two_sided else np.maximum(gap, 0)) ** 2)


def contacts_kept(
    first: Float[Array, "frames pairs 3"],
    second: Float[Array, "frames pairs 3"],
    valid: Bool[Array, "frames pairs"],
    threshold: float,
) -> float:
    """Share of the source's contacts that the result keeps: of the valid pairs, those with |first - second| <= 1.5
    threshold; 0 to 1, nan where there is none. Our measure, after the contacts of Basset 2019 (section 4.3).

    `first` and `second` are the two places of each source contact on the target's posed surface, carried there by the
    true correspondence or by sensors; `valid` says on which frames the source touches there and both places exist on
    the target; `threshold` is the distance of a contact on the target, metres.
    """
    require_alike(first=first, second=second)
    require_alike(first=first[..., 0], valid=valid)
    near = np.linalg.norm(first - second, axis=-1) <= SLACK * positive("threshold", threshold)
    return mean(near[valid].astype(np.float64))


def contacts_gained(
    source_distance: Float[Array, "frames pairs"],
    target_distance: Float[Array, "frames pairs"],
    valid: Bool[Array, "frames pairs"],
    source_threshold: float,
    target_threshold: float,
    morphology: Float[Array, "frames pairs"] | None = None,
) -> float:
    """Share of the result's contacts that the source does not have: of the valid pairs with |d_B| <= threshold_B, those
    with |d_A| > 1.5 threshold_A; 0 to 1, nan where the result touches nowhere. Ours (Basset 2019, section 7.4, asks which
    contacts belong to the body).

    Pairs are places that may touch on the target, their distance on the result and that of the same places carried to
    the source, metres. With `morphology`, the probability that each contact comes from the body and not from the pose,
    a gained contact counts by that much: contacts gained by morphology.
    """
    require_alike(source_distance=source_distance, target_distance=target_distance, valid=valid)
    touching = valid & (target_distance <= positive("target_threshold", target_threshold))
    gained = (source_distance > SLACK * positive("source_threshold", source_threshold)).astype(np.float64)
    if morphology is not None:
        require_alike(source_distance=source_distance, morphology=morphology)
        gained = gained * morphology
    return mean(gained[touching])


def penetration_percent(
    depth: Float[Array, "frames vertices"], limb: Bool[Array, "vertices"], deeper_than: float = DEEPER_THAN
) -> Float[Array, "frames"]:
    """Penetrating limb vertices on each frame: 100 #(limb vertices deeper than 1 mm) / #(limb vertices), per cent.

    Ye 2024 (appendix B) counts arm and hand vertices against the body; which vertices are `limb` is the caller's to say.
    The paper names no inside test and no least depth; 1 mm is ours. Raises `RetargetError` for a mask without vertex.
    """
    return _percent((depth > deeper_than), limb)


def part_penetration_percent(
    depth: Float[Array, "frames vertices"], part: Int[Array, "vertices"], parts: int, deeper_than: float = DEEPER_THAN
) -> Float[Array, "frames parts"]:
    """The same within each part: 100 #(vertices of the part deeper than 1 mm) / #(vertices of the part), per cent.

    `part` numbers each vertex's part from 0, -1 for vertices that do not count. A part without vertices reads 0.
    """
    if part.size and not -1 <= part.min() <= part.max() < parts:
        raise RetargetError(f"vertices name parts from {part.min()} to {part.max()}; right are -1 to {parts - 1}")
    members = (part[:, None] == np.arange(parts)).astype(np.float64)
    return 100 * ((depth > deeper_than) @ members) / np.maximum(members.sum(axis=0), 1)


def new_penetration_percent(
    depth: Float[Array, "frames vertices"],
    source_depth: Float[Array, "frames vertices"],
    limb: Bool[Array, "vertices"],
    deeper_than: float = DEEPER_THAN,
) -> Float[Array, "frames"]:
    """Penetration that the source does not have: 100 #(limb vertices deeper than 1 mm in the result and not in the
    source) / #(limb vertices) on each frame, per cent (ours).

    Vertices of both must correspond: one topology, or `source_depth[:, target_to_source]`. For bodies that share neither
    vertices nor a trusted map use `new_part_penetration_percent`.
    """
    require_alike(depth=depth, source_depth=source_depth)
    return _percent((depth > deeper_than) & ~(source_depth > deeper_than), limb)


def new_part_penetration_percent(
    result: Float[Array, "frames parts"], source: Float[Array, "frames parts"]
) -> Float[Array, "frames parts"]:
    """New penetration between bodies with different vertices: a part's `part_penetration_percent` on the frames on which
    the same part of the source does not penetrate at all, else 0, per cent (ours).

    Coarser than by vertex: where the source's part penetrates by one vertex, nothing of the result's counts as new.
    """
    require_alike(result=result, source=source)
    return np.where(source > 0, 0.0, result)


def excess_penetration_percent(
    result: Float[Array, "frames *parts"], source: Float[Array, "frames *parts"]
) -> Float[Array, "frames *parts"]:
    """Penetration beyond the source's: max(result - source, 0) on each frame, in points of per cent (ours).

    Works on the percentages of either body (`penetration_percent`), so vertices need not correspond; frames on which the
    result is better than its source do not pay for others. On `part_penetration_percent` neither do parts.
    """
    require_alike(result=result, source=source)
    return np.maximum(result - source, 0.0)


def depth_mean_mm(
    depth: Float[Array, "frames vertices"],
    limb: Bool[Array, "vertices"],
    height: float,
    deeper_than: float = DEEPER_THAN,
) -> float:
    """Mean depth of the penetrating limb vertices (deeper than 1 mm) of all frames together, mm at 1.7 m; 0 where none
    penetrates (ours)."""
    depths = _penetrating(depth, limb, deeper_than)
    return 1000 * at_reference_height(float(depths.mean()) if depths.size else 0.0, height)


def depth_p95_mm(
    depth: Float[Array, "frames vertices"],
    limb: Bool[Array, "vertices"],
    height: float,
    deeper_than: float = DEEPER_THAN,
) -> float:
    """Depth that 95 % of the penetrating limb vertices (deeper than 1 mm) of all frames together do not exceed, linear
    between neighbours, mm at 1.7 m; 0 where none penetrates (ours)."""
    depths = _penetrating(depth, limb, deeper_than)
    return 1000 * at_reference_height(float(np.percentile(depths, 95)) if depths.size else 0.0, height)


def _penetrating(
    depth: Float[Array, "frames vertices"], limb: Bool[Array, "vertices"], deeper_than: float
) -> Float[Array, "penetrating"]:
    depths = depth[:, limb]
    return depths[depths > deeper_than]


def _percent(counted: Bool[Array, "frames vertices"], limb: Bool[Array, "vertices"]) -> Float[Array, "frames"]:
    if not limb.any():
        raise RetargetError("the limb mask marks no vertex; penetration is a share of limb vertices")
    return 100 * counted[:, limb].mean(axis=1)
