"""Pairs of sensors that an interaction is read from: one on a hand, one anywhere else but on the same arm (Ye 2024,
appendix B). The paper does not say which sensors are 'body'; all others are, here."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from retarget.contact.sensor_bones import BONES
from retarget.contact.sensors import Sensors

Array = np.ndarray


def hand_pairs(source: Sensors, target: Sensors) -> tuple[Int[Array, "pairs"], Int[Array, "pairs"]]:
    """Sensors of hands, and those that each is paired with, valid on both bodies; of one layout."""
    names = np.array(BONES)[source.layout.bones]
    valid = source.valid & target.valid
    pairs = []
    for side in ("left", "right"):
        own = np.char.startswith(names, side) & (np.char.find(names, "Arm") >= 0)
        hand, shoulder = names == f"{side}Hand", names == f"{side}Shoulder"
        others = np.flatnonzero(valid & ~(own | hand | shoulder))
        first, second = np.meshgrid(np.flatnonzero(valid & hand), others, indexing="ij")
        pairs.append(np.stack([first.ravel(), second.ravel()]))
    return tuple(np.concatenate(pairs, axis=1))
