"""Frames of a captured surface that are not finite, filled in from those beside them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError

Array = np.ndarray


def bridged(
    surface: Float[Array, "frames vertices 3"],
) -> tuple[Float[Array, "frames vertices 3"], Int[Array, "bridged"]]:
    """A moving surface (metres) that is finite throughout, and which of its frames had to be bridged.

    A frame of which any vertex is not finite is replaced as a whole, by the line between the nearest finite frames on either
    side; before the first and behind the last of those it repeats them. What is finite comes back as it is.

    Raises `RetargetError` where no frame is finite.
    """
    finite = is_finite(surface)
    if finite.all():
        return surface, np.zeros(0, dtype=np.int64)
    known, missing = np.flatnonzero(finite), np.flatnonzero(~finite)
    if len(known) == 0:
        raise RetargetError(
            f"none of the surface's {len(surface)} frames is finite; at least one must have all of its "
            f"{surface.shape[1]} vertices somewhere"
        )
    place = np.searchsorted(known, missing)
    before, after = known[np.maximum(place - 1, 0)], known[np.minimum(place, len(known) - 1)]
    share = np.where(after > before, (missing - before) / np.maximum(after - before, 1), 0.0)
    filled = surface.copy()
    filled[missing] = surface[before] + share[:, None, None].astype(surface.dtype) * (surface[after] - surface[before])
    return filled, missing


def is_finite(surface: Float[Array, "*frames vertices 3"]) -> Array:
    """Whether every vertex of a surface is finite; one answer a frame."""
    return np.asarray(np.isfinite(surface).all(axis=(-2, -1)))
