"""What the metrics stand on: the height at which lengths are quoted, arrays that belong together, rigid alignment."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.errors import RetargetError

Array = np.ndarray

REFERENCE_HEIGHT = 1.7
"""Metres; the height at which lengths are quoted."""


def at_reference_height(metres: Float[Array, "*any"] | float, height: float) -> Float[Array, "*any"] | float:
    """Lengths on a body of `height` metres as they would be on one of 1.7 m: metres 1.7 / height.

    Raises `RetargetError` for a height that is not positive.
    """
    return metres * (REFERENCE_HEIGHT / positive("height", height))


def positive(name: str, value: float) -> float:
    """`value` itself. Raises `RetargetError` naming it where it is not a positive finite number."""
    if not (np.isfinite(value) and value > 0):
        raise RetargetError(f"{name} must be positive, received {value}")
    return value


def require_alike(**arrays: Array) -> None:
    """Raises `RetargetError` unless all arrays have the shape of the first: broadcasting would measure nonsense."""
    (first, reference), *others = arrays.items()
    for name, array in others:
        if array.shape != reference.shape:
            raise RetargetError(
                f"{name} has shape {array.shape}, {first} {reference.shape}: "
                "both must have the same frames and the same points in the same order"
            )


def mean(values: Float[Array, "*any"]) -> float:
    """The mean of all values; nan, without a warning, where there are none."""
    return float(values.mean()) if values.size else float("nan")


def procrustes(
    result: Float[Array, "frames points 3"], truth: Float[Array, "frames points 3"]
) -> Float[Array, "frames points 3"]:
    """`result` moved onto `truth`, each frame by its own rotation and translation, without scale or mirroring.

    The least-squares fit of Kabsch (1976): centred on both means, H = sum_p (r_p - mean r)(t_p - mean t)^T = U S V^T,
    R = V diag(1, 1, det(V U^T)) U^T. Metres in, metres out.
    """
    require_alike(truth=truth, result=result)
    if result.shape[1] == 0:
        return result
    centre = truth.mean(axis=1, keepdims=True)
    centred = result - result.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(np.swapaxes(centred, 1, 2) @ (truth - centre))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return centred @ (u @ vt) + centre  # row vectors: (R x)^T = x^T R^T, R^T = U V^T
