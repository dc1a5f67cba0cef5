"""How far hands are from what is near them, as equations: Ye 2024's contact error, to both sides, to first order.

A sensor of a hand that is nearer to another sensor on the performer than its arm is thick should be as far from it on the target, in radii of
the arm. All such pairs of a frame make one matrix and one right side in the turns of the body's joints (`part_equations.ROWS`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.near_sensors import hand_pairs
from retarget.contact.part_field import QUARTERS, PartField
from retarget.contact.sensor_bones import BONES, SIDES
from retarget.contact.sensors import Sensors
from retarget.methods.interaction.part_equations import JOINTS, ROWS, TURNED, carrying
from retarget.motion.touch.equations import MOST_NEAR

Array = np.ndarray

TRIANGLE = len(ROWS) * (len(ROWS) + 1) // 2
ASKED = TRIANGLE + len(ROWS)
"""Numbers of a frame: the lower triangle of its matrix, row by row, and its right side."""
_CARRIES = np.array([[float(name in carrying(bone)) for name in TURNED] for bone in BONES])


@dataclass(frozen=True, eq=False)
class HandDistances:
    """A matched pair of bodies; `prepare_hand_distances` makes one."""

    pairs: tuple[Int[Array, "pairs"], Int[Array, "pairs"]]
    """A sensor of a hand and another, among those that are used."""
    bones: Int[Array, "used"]
    radii: Float[Array, "2"]
    """Of the arms of performer and target, in shares of their heights."""
    heights: Float[Array, "2"]

    def equations(
        self,
        source: Float[Array, "frames used 3"],
        target: Float[Array, "frames used 3"],
        roots: Float[Array, "frames 3 4"],
        places: Float[Array, "frames turning 3"],
        axes: Float[Array, "frames turning 3 3"],
    ) -> Float[Array, "frames ASKED"]:
        """Of posed sensors of both (metres). `roots` take the world to the hips' axes (shares of the height): three columns and what is
        added; `places` and `axes` are those of `Unknowns.levers`. Pairs weigh one where they touch and less the farther they are, together at
        most one (a few pairs less); lengths are shares of the height."""
        from retarget.methods.interaction.part_equation_kernels import hand_equations

        out = np.zeros((len(source), ASKED))
        hand_equations(
            source, target, *self.pairs, self.bones, _CARRIES, self.heights[0], self.radii, MOST_NEAR, roots,
            np.ascontiguousarray(places[:, JOINTS]), np.ascontiguousarray(axes[:, JOINTS]), out,
        )  # fmt: skip
        return out


def prepare_hand_distances(field: PartField, sensors: tuple[Sensors, Sensors]) -> HandDistances:
    """Of a matched pair of bodies; the arms' radii as the field's girths have them."""
    place = np.full(len(sensors[0].valid), -1)
    place[field.used] = np.arange(len(field.used))
    girths = field.girths.reshape(2, len(BONES), 1 + QUARTERS)[..., 1:].astype(np.float64)
    arms = [BONES.index(f"{side}{part}") for side in SIDES for part in ("UpperArm", "LowerArm")]
    first, second = hand_pairs(*sensors)
    return HandDistances(
        (place[first], place[second]), sensors[0].layout.bones[field.used], girths[:, arms].mean(axis=(1, 2)), field.heights
    )


def matrix_of(asked: Float[Array, "frames ASKED"]) -> tuple[Float[Array, "frames rows rows"], Float[Array, "frames rows"]]:
    """Matrices and right sides."""
    rows, columns = np.tril_indices(len(ROWS))
    matrix = np.zeros((len(asked), len(ROWS), len(ROWS)), dtype=asked.dtype)
    matrix[:, rows, columns] = matrix[:, columns, rows] = asked[:, :TRIANGLE]
    return matrix, asked[:, TRIANGLE:]
