"""Points of a surface, evenly by area."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.geometry.topology import areas

Array = np.ndarray


def sample_surface(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], count: int, seed: int | Sequence[int] = 0
) -> Float[Array, "count 3"]:
    """Random points on a surface, every piece of which gets as many as its area deserves (units of the vertices).

    The vertices of a mesh lie dense where its maker wanted detail (head, hands), which no scanner knows of. The same
    seed gives the same points. Raises `RetargetError` for a surface without area.
    """
    size = areas(vertices, faces)
    total = np.cumsum(size)
    if not len(faces) or not total[-1] > 0:
        raise RetargetError(f"a surface of {len(faces)} faces has no area to take points from")
    draw = np.random.default_rng(seed)
    face = np.minimum(np.searchsorted(total, draw.random(count) * total[-1], side="right"), len(faces) - 1)
    # Even over a triangle by a square root and a share: Osada et al. 2002, section 3.
    root, share = np.sqrt(draw.random(count)), draw.random(count)
    a, b, c = (vertices[faces[face, corner]] for corner in range(3))
    return (1 - root)[:, None] * a + (root * (1 - share))[:, None] * b + (root * share)[:, None] * c
