"""What is measured, on plain arrays. Every figure's formula stands in its docstring and in `formulas.py`.

Lengths are reported in centimetres at a body height of 1.7 m, so that a child and a giant read alike.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.contact.ground import intervals

Array = np.ndarray

REFERENCE_HEIGHT = 1.7
"""Metres; the height at which lengths are quoted."""


def angle_error_degrees(
    source: Float[Array, "frames directions 3"], target: Float[Array, "frames directions 3"]
) -> Float[Array, "frames directions"]:
    """Angle between two directions: atan2(|s x t|, s · t), degrees."""
    source, target = rot.unit(source), rot.unit(target)
    sine = np.linalg.norm(np.cross(source, target), axis=-1)
    return np.degrees(np.arctan2(sine, (source * target).sum(axis=-1)))


def foot_slide_cm(
    points: Float[Array, "frames points 3"], touching: Bool[Array, "frames points"], height: float
) -> Float[Array, "contacts"]:
    """Horizontal slide of each contact: the largest horizontal distance between the point on any frame of the contact
    and its mean place over the contact, in cm at 1.7 m. One value a contact (point and interval)."""
    slides = []
    for point in range(points.shape[1]):
        for start, stop in intervals(touching[:, point]):
            path = points[start:stop, point][:, [0, 2]]
            slides.append(np.linalg.norm(path - path.mean(axis=0), axis=-1).max())
    return np.array(slides) * 100 * REFERENCE_HEIGHT / height


def floor_error_cm(
    points: Float[Array, "frames points 3"],
    touching: Bool[Array, "frames points"],
    support: Float[Array, "frames points"],
    height: float,
) -> Float[Array, "contacts"]:
    """On each frame on which some point rests: |height above its support| of the lowest resting point, cm at 1.7 m."""
    over = np.where(touching, points[..., 1] - support, np.inf).min(axis=1)
    return np.abs(over[np.isfinite(over)]) * 100 * REFERENCE_HEIGHT / height


def jerk(points: Float[Array, "frames points 3"], fps: float, leg_length: float) -> float:
    """Mean length of the third difference times fps³, over leg length (leg lengths a second cubed)."""
    if len(points) < 4:
        return 0.0
    return float(np.linalg.norm(np.diff(points, n=3, axis=0), axis=-1).mean()) * fps**3 / leg_length


def position_error_cm(a: Float[Array, "frames joints 3"], b: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean joint distance (MPJPE), cm at 1.7 m."""
    return float(np.linalg.norm(a - b, axis=-1).mean()) * 100 * REFERENCE_HEIGHT / height
