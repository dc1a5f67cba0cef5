"""A cloud looked at four times: as it is, turned about by half, and the mirror images of both; what is found in the four is joined.

The regressor learnt all facings, but not equally well; its errors in the four are apart enough that their middle is a tenth
better, and what it finds in a mirrored cloud is exactly the mirror image. All four keep to the axes, so the search's boxes
stay boxes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from retarget.body.human import human_model
from retarget.methods.scan.features import JOINTS, Bodies, Clouds

Array = np.ndarray

SIGNS = np.array([[1, 1, 1], [-1, 1, 1], [-1, 1, -1], [1, 1, -1]], dtype=np.float32)
"""Of the axes, in each copy: the second and last are mirror images."""
CALM = 0.7
"""What the expected error of the joined joints is of the copies' own and their distance together, on the validation set."""


def fourfold(clouds: Clouds) -> Clouds:
    """Every cloud in its four copies, one after the other: copies of one cloud follow each other."""
    blocks = int(clouds.blocks.max())
    count = int(clouds.firsts[np.arange(len(clouds.blocks)), clouds.blocks].max())
    places = (clouds.places[:, None, :count] * SIGNS[:, None]).reshape(-1, count, 3)
    corners = clouds.boxes[:, None, :, :blocks] * np.tile(SIGNS, 2)[..., None]
    low, high = corners[:, :, :3], corners[:, :, 3:]
    boxes = np.concatenate([np.minimum(low, high), np.maximum(low, high)], axis=2).reshape(-1, 6, blocks)
    copies = len(SIGNS)
    firsts, found = np.repeat(clouds.firsts[:, : blocks + 1], copies, axis=0), np.repeat(clouds.blocks, copies)
    return Clouds(places, firsts, boxes, found, np.repeat(clouds.middles, copies, axis=0))


def joined(bodies: Bodies, doubts: Float[Array, "copies joints"]) -> tuple[Bodies, Float[Array, "clouds joints"]]:
    """What was found in the copies of `fourfold`, led back and joined: the median of places, the mean of turns, and of the
    expected errors with what places differ by."""
    copies = len(SIGNS)
    places = bodies.places.reshape(-1, copies, JOINTS, 3) * SIGNS[:, None]
    turns = bodies.turns.reshape(-1, copies, JOINTS, 3, 3) * SIGNS[:, None, :, None]
    doubts = doubts.reshape(-1, copies, JOINTS)
    for copy in np.flatnonzero(SIGNS.prod(axis=1) < 0):
        places[:, copy] = places[:, copy, _other_side()]
        turns[:, copy] = turns[:, copy, _other_side()] * np.array([-1, 1, 1], dtype=np.float32)
        doubts[:, copy] = doubts[:, copy, _other_side()]
    middle = np.median(places, axis=1)
    left, _, right = np.linalg.svd(turns.mean(axis=1))
    left[..., 2] *= np.linalg.det(np.matmul(left, right))[..., None]
    apart = np.linalg.norm(places - middle[:, None], axis=-1).mean(axis=1)
    return Bodies(middle, np.matmul(left, right)), CALM * (doubts.mean(axis=1) + apart)


@lru_cache(maxsize=1)
def _other_side() -> Int[Array, "joints"]:
    """The joint on the other side of each."""
    names = human_model().joint_names[:JOINTS]
    others = [
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left") for name in names
    ]
    return np.array([names.index(name) for name in others])
