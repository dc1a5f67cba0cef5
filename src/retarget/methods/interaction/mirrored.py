"""The mirror image of what the interaction network sees and says: every pair of bodies that stand for a symmetric kind is two.

A mirrored vector changes the sign of its first number, a turn (rotation vector) those of the others; left and right change places.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.part_field import FIGURES, PAIRS, QUARTERS
from retarget.contact.sensor_bones import BONES
from retarget.contact.skin_levers import TURNING
from retarget.methods.interaction.hand_distances import TRIANGLE
from retarget.methods.interaction.part_equations import HELD, PAIRED, ROWS, SAYS, STIFF, TURNED
from retarget.methods.interaction.unknowns import SIZE

Array = np.ndarray

VECTOR, TURN = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Mirror:
    """Which number of a row comes from where, and with which sign."""

    rows: Int[Array, "numbers"]
    signs: Float[Array, "numbers"]

    def __call__(self, values: Float[Array, "frames numbers"]) -> Float[Array, "frames numbers"]:
        """Mirrored rows."""
        return values[:, self.rows] * self.signs.astype(values.dtype)

    def beginning(self, count: int) -> Mirror:
        """Of the first numbers alone, whose images are among themselves."""
        return Mirror(self.rows[:count], self.signs[:count])


def _other(name: str) -> str:
    if name.startswith("left"):
        return "right" + name[4:]
    return "left" + name[5:] if name.startswith("right") else name


@lru_cache(maxsize=1)
def mirror_of_turned() -> Mirror:
    """Of corrections (`methods/interaction/unknowns.py`)."""
    joints = [TURNING.index(_other(name)) for name in TURNING]
    rows = np.append((3 * np.array(joints)[:, None] + np.arange(3)).ravel(), 3 * len(TURNING) + np.arange(3))
    return Mirror(rows, np.append(np.tile(TURN, len(TURNING)), VECTOR))


@lru_cache(maxsize=1)
def mirror_of_features() -> Mirror:
    """Of what a look sees: the figures of pairs, turns of bones, where up is, girths of both bodies, the correction; and of where
    turns act and what distances ask."""
    rows, signs = [], []

    def add(own: Array, sign: Array) -> None:
        rows.append(np.asarray(own).ravel())
        signs.append(np.broadcast_to(sign, np.shape(own)).ravel())

    place = {pair: number for number, pair in enumerate(PAIRS)}
    pairs = np.array([place[_other(own), _other(part)] for own, part in PAIRS])
    one = np.ones(2)
    add(FIGURES * pairs[:, None] + np.arange(FIGURES), np.concatenate([one, *[VECTOR] * 4, one, *[VECTOR] * 2]))
    start = FIGURES * len(PAIRS)
    bones = np.array([BONES.index(_other(name)) for name in BONES])
    add(start + 6 * (bones[1:, None] - 1) + np.arange(6), (VECTOR[:, None] * VECTOR[:2]).ravel())
    start += 6 * (len(BONES) - 1)
    add(start + np.arange(3), VECTOR)
    start += 3
    quarters = np.append(0, 1 + (-np.arange(QUARTERS)) % QUARTERS)
    for _ in range(2):
        add(start + (1 + QUARTERS) * bones[:, None] + quarters, np.ones(1))
        start += (1 + QUARTERS) * len(BONES)
    turned = mirror_of_turned()
    add(start + turned.rows, turned.signs)
    start += SIZE
    joints = turned.rows[: 3 * len(TURNING) : 3] // 3
    add(start + 3 * joints[:, None] + np.arange(3), VECTOR)
    start += 3 * len(TURNING)
    add(start + 9 * joints[:, None] + np.arange(9), np.outer(TURN, TURN).ravel())
    start += 9 * len(TURNING)
    unknowns, sign = _unknowns()
    row, column = np.tril_indices(len(ROWS))
    high, low = np.maximum(unknowns[row], unknowns[column]), np.minimum(unknowns[row], unknowns[column])
    add(start + high * (high + 1) // 2 + low, sign[row] * sign[column])
    add(start + TRIANGLE + unknowns, sign)
    return Mirror(np.concatenate(rows), np.concatenate(signs))


@lru_cache(maxsize=1)
def mirror_of_said() -> Mirror:
    """Of what a network says (`part_equations.SAID`)."""
    turned, place = mirror_of_turned(), {pair: number for number, pair in enumerate(PAIRS)}
    pairs = np.array([place[_other(own), _other(part)] for own, part in PAIRS])
    own = np.ones(SAYS)
    own[5:8] = VECTOR
    unknowns, _ = _unknowns()
    rows = turned.rows, PAIRED.start + (SAYS * pairs[:, None] + np.arange(SAYS)).ravel(), STIFF.start + unknowns, [HELD]
    return Mirror(np.concatenate(rows), np.concatenate([turned.signs, np.tile(own, len(PAIRS)), np.ones(len(unknowns) + 1)]))


def _unknowns() -> tuple[Int[Array, "rows"], Float[Array, "rows"]]:
    """Where the mirror image of each unknown of the equations is among them, and its sign."""
    joints = np.array([TURNED.index(_other(name)) for name in TURNED])
    return (3 * joints[:, None] + np.arange(3)).ravel(), np.tile(TURN, len(TURNED))
