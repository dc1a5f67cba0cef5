"""Back from the pose to rest: the inverse of linear blend skinning, vertex by vertex.

Musoni 2021 (section 4.3) regresses the pose from joints alone, where twist is lost and rest shapes wring. Here every part's
turn is fitted to the surface, twist with it, so the way back is closed form.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.rig.fit_model import BodyState, FitModel, part_transforms

Array = np.ndarray

LEAST_DETERMINANT = 0.2
"""A blend of turns that shrinks volume to less than this (limbs bent back on themselves) is no way back; the heaviest
joint's turn is taken instead."""


def rest_from_pose(
    model: FitModel,
    state: BodyState,
    weights: Float[Array, "vertices joints"],
    posed: Float[Array, "vertices 3"],
) -> Float[Array, "vertices 3"]:
    """Where posed vertices with these weights lie at rest."""
    _, offsets = part_transforms(model, state)
    blended = np.tensordot(weights, state.turns, axes=1)
    moves = weights @ offsets
    folded = np.linalg.det(blended) < LEAST_DETERMINANT
    heaviest = weights[folded].argmax(axis=1)
    blended[folded], moves[folded] = state.turns[heaviest], offsets[heaviest]
    return np.linalg.solve(blended, (posed - moves)[..., None])[..., 0]
