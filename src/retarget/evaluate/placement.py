"""How much of a patch of contacts can be kept at once: patches that touched on the source may have other shapes and sizes on
another body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Array = np.ndarray

PLACEMENTS, FITS = 24, 6
"""Starts, and rounds of each, of the search for pairs that are kept together."""


def kept_together(
    first: Float[Array, "rows 3"], second: Float[Array, "rows 3"], limit: float, seed: int
) -> int:
    """How many of the pairs some rigid placement of the first points as a whole brings within the limit (metres), about:
    the best of `PLACEMENTS` robust fits that start at random places of the patch. A bound for any method, since no
    skeleton, and no penetration, stands in a placement's way."""
    if len(first) < 3:
        return len(first)
    random, most = np.random.default_rng(seed), 0
    for start in range(PLACEMENTS):
        about = second[random.integers(len(second))]
        weight = np.exp(-((second - about) ** 2).sum(axis=1) / (3 * limit) ** 2) if start else np.ones(len(second))
        for _ in range(FITS):
            off = np.linalg.norm(_placed(first, second, weight + 1e-6) - second, axis=1)
            most = max(most, int((off <= limit).sum()))
            weight = np.exp(-0.5 * (off / limit) ** 2)
    return most


def _placed(first: Float[Array, "rows 3"], second: Float[Array, "rows 3"], weight: Float[Array, "rows"]) -> Float[Array, "rows 3"]:
    """The first points, turned and moved as one to where they are nearest to the second (weighted least squares; Kabsch)."""
    share = weight / weight.sum()
    here, there = share @ first, share @ second
    left, _, right = np.linalg.svd((share[:, None] * (first - here)).T @ (second - there))
    mirrored = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return (first - here) @ (left @ mirrored @ right) + there
