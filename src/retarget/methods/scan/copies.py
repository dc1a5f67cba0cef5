"""A cloud looked at four times: as it is, turned about by half, and the mirror images of both; what is found in the four is joined.

The regressor learnt all facings, but not equally well; its errors in the four are apart enough that their mean is a tenth
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
LEAST_DOUBT = 1e-4
"""Metres, so that no copy counts for everything."""
CALM = 0.8
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
    """What was found in the copies of `fourfold`, led back and joined: means, in which a joint of a small expected error counts
    for more, and expected errors of these, from the copies' own and what their places differ by."""
    copies = len(SIGNS)
    places = bodies.places.reshape(-1, copies, JOINTS, 3) * SIGNS[:, None]
    turns = bodies.turns.reshape(-1, copies, JOINTS, 3, 3) * SIGNS[:, None, :, None]
    doubts = doubts.reshape(-1, copies, JOINTS)
    for copy in np.flatnonzero(SIGNS.prod(axis=1) < 0):
        places[:, copy] = places[:, copy, _other_side()]
        turns[:, copy] = turns[:, copy, _other_side()] * np.array([-1, 1, 1], dtype=np.float32)
        doubts[:, copy] = doubts[:, copy, _other_side()]
    shares = np.maximum(doubts, LEAST_DOUBT) ** -4.0
    shares /= shares.sum(axis=1, keepdims=True)
    middle = (shares[..., None] * places).sum(axis=1)
    left, _, right = np.linalg.svd((shares[..., None, None] * turns).sum(axis=1))
    left[..., 2] *= np.linalg.det(np.matmul(left, right))[..., None]
    apart = np.linalg.norm(places - middle[:, None], axis=-1)
    return Bodies(middle, np.matmul(left, right)), CALM * (shares * (doubts + apart)).sum(axis=1)


@lru_cache(maxsize=1)
def _other_side() -> Int[Array, "joints"]:
    """The joint on the other side of each."""
    names = human_model().joint_names[:JOINTS]
    others = [
        name.replace("left", "right") if name.startswith("left") else name.replace("right", "left") for name in names
    ]
    return np.array([names.index(name) for name in others])
