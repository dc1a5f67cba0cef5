"""Two-bone inverse kinematics in closed form, all frames at once."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot

Array = np.ndarray


def two_bone(
    top: Float[Array, "*frames 3"],
    middle: Float[Array, "*frames 3"],
    end: Float[Array, "*frames 3"],
    goal: Float[Array, "*frames 3"],
    pole: Float[Array, "*frames 3"],
) -> tuple[Float[Array, "*frames 4"], Float[Array, "*frames 4"]]:
    """World rotations to apply to the upper and to the lower bone so that `end` reaches `goal`.

    The bend stays in the plane it has; a straight limb bends towards `pole` (a direction). Goals out of reach are
    approached along the straight line. Both rotations act on world orientations from the left; a limb that is there
    already gets identities.
    """
    upper, lower = middle - top, end - middle
    upper_length, lower_length = np.linalg.norm(upper, axis=-1), np.linalg.norm(lower, axis=-1)
    reach, span = goal - top, end - top
    shortest, longest = np.abs(upper_length - lower_length), upper_length + lower_length
    distance = np.clip(np.linalg.norm(reach, axis=-1), shortest * 1.0001 + 1e-9, longest * 0.99999)
    # The wanted place of the middle joint, in the plane of the present bend turned onto the new line.
    turn = rot.swing_between(span, reach)
    bend = rot.rotate(turn, upper)
    line = rot.unit(reach)
    aside = bend - (bend * line).sum(-1, keepdims=True) * line
    towards_pole = pole - (pole * line).sum(-1, keepdims=True) * line
    # A limb straighter than about 3 degrees has no reliable plane: fade over to the pole.
    straight = np.clip(
        1 - np.linalg.norm(aside, axis=-1, keepdims=True) / (0.05 * upper_length[..., None] + 1e-12), 0, 1
    )
    aside = rot.unit(rot.unit(aside) * (1 - straight) + rot.unit(towards_pole) * straight)
    along = (upper_length**2 + distance**2 - lower_length**2) / np.maximum(2 * distance, 1e-12)
    height = np.sqrt(np.maximum(upper_length**2 - along**2, 0))
    new_middle = top + line * along[..., None] + aside * height[..., None]
    new_end = top + line * distance[..., None]
    # One rigid turn for both bones (keeps twist), then each bone's remaining swing.
    upper_turn = rot.multiply(rot.swing_between(rot.rotate(turn, upper), new_middle - top), turn)
    lower_turn = rot.multiply(rot.swing_between(rot.rotate(turn, lower), new_end - new_middle), turn)
    return upper_turn, lower_turn
