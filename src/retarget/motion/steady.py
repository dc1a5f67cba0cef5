"""Take back the shake that longer limbs make of captured noise.

Copied angles move a hand in proportion to the arm. On a body with long arms and a big head over short legs the tremble of
a capture becomes two to three times as large against the size of its steps. The lightest low-pass that brings it back to
what the source showed is applied to the whole body, so that limbs stay in time with each other; a body of the source's
proportions is left exactly as copied. Ours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.motion.filter import gaussian

Array = np.ndarray

END_JOINTS = ("hips", "head", "leftHand", "rightHand", "leftFoot", "rightFoot")
LONGEST_SIGMA = 0.025
"""Seconds. Standard deviation of the strongest filter: it halves 7.5 Hz, and leaves a 2 Hz swing 95 % of its height."""
FINENESS = 8
"""Strengths that are told apart, in equal steps to the longest."""
STEP = 1 / 30
"""Seconds between the places whose third difference is the shake: what shows at thirty frames a second."""
MORE_SHAKE = 1.1
"""Times the source's shake that a result may show before it is filtered."""
STILL = 0.05
"""Leg lengths a second cubed below which a motion has no shake to compare with."""


def shake(points: Float[Array, "frames points 3"], fps: float, leg_length: float) -> float:
    """Mean length of the points' third difference over `STEP`, in leg lengths a second cubed."""
    stride = max(1, round(STEP * fps))
    if len(points) <= 3 * stride:
        return 0.0
    third = (
        points[3 * stride :] - points[: -3 * stride] - 3 * (points[2 * stride : -stride] - points[stride : -2 * stride])
    )
    return float(np.linalg.norm(third, axis=-1).mean()) * (fps / stride) ** 3 / leg_length


def low_pass(
    rotations: Float[Array, "frames joints 4"], path: Float[Array, "frames 3"], sigma: float
) -> tuple[Float[Array, "frames joints 4"], Float[Array, "frames 3"]]:
    """World rotations and a path through a Gaussian of `sigma` frames."""
    return rot.normalise(gaussian(rot.continuous(rotations), sigma)), gaussian(path, sigma)


def lightest(measure: Callable[[float], float], allowed: float, longest: float) -> float:
    """The least of nothing and `FINENESS` equal steps up to `longest` at which `measure` is within `allowed`; `longest` if
    none is. `measure` falls as its argument grows; it is called 1 + log2(FINENESS) times at most.
    """
    if measure(0.0) <= allowed:
        return 0.0
    low, high = 0, FINENESS  # `low` is known to be too little
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if measure(middle / FINENESS * longest) <= allowed else (middle, high)
    return high / FINENESS * longest
