"""Skirts and coats: what hangs around a body is no skin, and is left out of what the body is fitted to.

To a fit cloth that hangs 10 to 30 cm off the legs is a larger body with its knees apart: bodies came out by a quarter too tall,
even from the true pose. So where a body is believed to be (a regressor's guess), points far outside its legs and hips are
looked at: a limb that is elsewhere leaves them on one side, a garment on most sides. Ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.body.human import human_model
from retarget.methods.scan.cloud import binned
from retarget.methods.scan.fit import FAR, Posed, relative_size
from retarget.methods.scan.scan_body import ScanBody, ShapedBody
from retarget.rig.fit_model import BodyState

Array = np.ndarray

CLEAR, WIDE = 0.05, 0.1
"""Metres outside the skin of an adult from which on points are of what hangs around it, where something does, and from which on
they say that something does. Clothes that are worn close reach to .04, and where a guess errs skin lies 5 to 10 cm off."""
DEEP = 0.9
"""Lengths of a leg below the hips down to which something may hang."""
SIDES, FULL, MOST_SIDES = 8, 0.02, 4
"""Directions around the hips; the share of all hanging points that makes one of them full; how many must be."""
LEAST = 0.06
"""Share of the cloud that hangs so wide where anything does."""
LONGER, SURELY = 1.08, 5
"""Legs that come out so many times as long as a regressor saw them, on average over so many looks and more, have grown into the
cloth: it errs by up to a fifth there, fits by up to a half."""


@dataclass(frozen=True, eq=False)
class Cloth:
    """What is known of a body around which cloth hangs."""

    told: Float[Array, "shapes"]
    """Mean of the shapes that a regressor saw: what is inside the cloth it has learnt."""
    fitted: Float[Array, "shapes"]
    """Mean of the shapes that were fitted meanwhile."""
    looks: int = 1
    """How many there were."""
    overgrown: bool = False
    """Whether the fit has grown into the cloth: from then on the shape is what was told."""

    def after(self, body: ScanBody, told: Float[Array, "shapes"], fitted: Float[Array, "shapes"]) -> Cloth:
        """The same after one more look, and one more fit's shape."""
        looks = self.looks + 1
        told, fitted = self.told + (told - self.told) / looks, self.fitted + (fitted - self.fitted) / looks
        long, short = (_leg_length(body.rest_joints(shape)) for shape in (fitted, told))
        return Cloth(told, fitted, looks, self.overgrown or (looks >= SURELY and long > LONGER * short))


def skin_only(
    body: ScanBody, states: Sequence[BodyState], cloud: Float[Array, "points 3"], shaped: ShapedBody | None = None
) -> Float[Array, "kept 3"]:
    """A cloud without what hangs around the hips and legs of a body in about one of these states, whichever it is; the cloud
    itself where nothing does. `shaped`, the body in a shape near theirs, saves making it."""
    state, away = states[0], np.full(len(cloud), np.inf)
    shaped = shaped or body.shaped(state.shape)
    for each in states:
        away = np.minimum(away, _away(body, each, cloud, body.reshaped(shaped, each.shape)))
        wide = away > WIDE
        if not wide.sum() > LEAST * len(cloud):
            return cloud
    across = (cloud[wide] - state.root) @ state.turns[0]
    angle = np.arctan2(across[:, 0], across[:, 2])
    sides = np.bincount(((angle / (2 * np.pi) + 0.5) * SIDES).astype(np.int64) % SIDES, minlength=SIDES)
    if (sides > FULL * wide.sum()).sum() < MOST_SIDES:
        return cloud
    return cloud[away <= CLEAR]


def _away(body: ScanBody, state: BodyState, cloud: Array, shaped: ShapedBody) -> Float[Array, "points"]:
    """How far points lie outside the skin, in metres of an adult, from the waist to the ankles; hands, which hang there too, are
    skin. 0 for all others."""
    posed, size = Posed.of(body, shaped, state), relative_size(state)
    to_body, squares = binned(posed.points).nearest(cloud, FAR)
    near = np.maximum(to_body, 0)
    away = cloud - posed.points[near]
    outside = (away * posed.normals[near]).sum(axis=1) > 0.0
    leg = _leg_length(posed.joints)
    down = (cloud - state.root) @ -state.turns[0][:, 1]
    below = (down > -0.3 * leg) & (down < DEEP * leg)
    distance = np.where(to_body < 0, FAR, np.sqrt(np.where(to_body < 0, 0.0, squares)))
    return np.where(below & (outside | (to_body < 0)), distance / size, 0.0)


def _leg_length(joints: Float[Array, "joints 3"]) -> float:
    return float(np.linalg.norm(np.diff(joints[_leg()], axis=0), axis=1).sum())


@lru_cache(maxsize=1)
def _leg() -> list[int]:
    return [human_model().joint_names.index(name) for name in ("leftUpperLeg", "leftLowerLeg", "leftFoot")]
