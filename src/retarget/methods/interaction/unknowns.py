"""Corrections in one language for all rigs: what a network says, and what the solver's equations mean by it.

The solver turns each joint in the axes of the joint above it (`motion/touch/equations.py`), and these differ from rig to rig.
Here every turn is in the axes that this joint above has in the common stance of `contact/sensor_bones.py`, which are the body's own; the
hips' own turn and shift are in the hips' axes, the shift in shares of the height. Joints that a rig lacks keep their places, as zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.contact.part_field import stance_axes
from retarget.contact.sensor_bones import Stance
from retarget.contact.skin_levers import TURNING, SkinLevers
from retarget.motion.align import Actor

Array = np.ndarray

SIZE = 3 * len(TURNING) + 3
"""Numbers of a correction: a turn of every joint that may turn (radians), and the hips' shift."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """A target's joints in that language; `prepare_unknowns` makes one."""

    places: Int[Array, "turning"]
    """Index into `TURNING` of each of the solver's joints."""
    axes: Float[Array, "turning 4"]
    """Rotation from the axes of the joint above to the body's own, in the stance."""
    hips: tuple[int, int, int]
    """Its place among the solver's joints, its joint, and the joint above it (-1 for none)."""
    upright: Float[Array, "4"]
    """Rotation from the body's own axes to the hips' in the stance."""
    height: float
    joints: Int[Array, "turning"]
    """In the skeleton."""
    above: Int[Array, "turning"]
    """The joint that each hangs on; -1 for none."""

    def from_solver(
        self, x: Float[Array, "frames unknowns"], world: Float[Array, "frames joints 4"]
    ) -> Float[Array, "frames SIZE"]:
        """A solver's corrections; `world` are the copied pose's rotations."""
        mixed = np.einsum("fnm,fm->fn", self._change(world), x)
        return self._spread(mixed)

    def to_solver(
        self, turned: Float[Array, "frames SIZE"], world: Float[Array, "frames joints 4"]
    ) -> Float[Array, "frames unknowns"]:
        """Corrections as the solver has them."""
        change = self._change(world)
        change[:, -3:, -3:] *= self.height**2  # the inverse of a rotation is its transpose; of the shift's scaling it is not
        return np.einsum("fnm,fn->fm", change, turned[:, self._rows])

    def matrix(
        self, matrices: Float[Array, "frames unknowns unknowns"], world: Float[Array, "frames joints 4"]
    ) -> Float[Array, "frames SIZE SIZE"]:
        """Matrices of quadratic forms of the solver's corrections, for these: d' M d stays the same."""
        change = self._change(world)
        change[:, -3:, -3:] *= self.height**2
        mixed = np.matmul(np.matmul(change, matrices), change.transpose(0, 2, 1))
        return self._spread(self._spread(mixed).transpose(0, 2, 1)).transpose(0, 2, 1)

    def levers(
        self,
        turned: Float[Array, "frames SIZE"],
        world: Float[Array, "frames joints 4"],
        posed: tuple[Float[Array, "frames joints 4"], Float[Array, "frames joints 3"]],
    ) -> tuple[Float[Array, "frames TURNING 3"], Float[Array, "frames TURNING 3 3"]]:
        """Where turns of joints act, for the pose that `turned` makes (`posed`, its world rotations and places) of a copied one (`world`):
        places of joints from the hips in shares of the height, and what takes a small change of each turn to the turn of all that
        hangs on the joint; both in the axes of the posed hips. Joints that a rig lacks are zeros."""
        place, joint, _ = self.hips
        rotations, places = posed
        hips = self.to_hips(rotations)
        where, axes = np.zeros((len(turned), len(TURNING), 3)), np.zeros((len(turned), len(TURNING), 3, 3))
        away = (places[:, self.joints] - places[:, joint, None]) / self.height
        where[:, self.places] = away @ hips.transpose(0, 2, 1)
        parents = np.where((self.above >= 0)[:, None], rotations[:, self.above], rot.IDENTITY)
        parents = rot.multiply(parents, rot.inverse(self.axes))
        parents[:, place] = rot.multiply(world[:, joint], rot.inverse(self.upright))
        turns = turned[:, :-3].reshape(len(turned), -1, 3)[:, self.places]
        axes[:, self.places] = hips[:, None] @ rot.to_matrix(parents) @ rot.left_jacobian(turns)
        return where, axes

    def to_hips(self, world: Float[Array, "frames joints 4"]) -> Float[Array, "frames 3 3"]:
        """What takes world vectors into the axes of the hips, for poses of these world rotations."""
        return rot.to_matrix(rot.multiply(self.upright, rot.inverse(world[:, self.hips[1]])))

    def roots(self, world: Float[Array, "frames joints 4"], places: Float[Array, "frames joints 3"]) -> Float[Array, "frames 3 4"]:
        """What takes places in the world to the hips' axes, from the hips and in shares of the height: three columns and what is added."""
        turn = self.to_hips(world) / self.height
        return np.concatenate([turn, -turn @ places[:, self.hips[1], :, None]], axis=2)

    @property
    def _rows(self) -> Int[Array, "unknowns"]:
        own = (3 * self.places[:, None] + np.arange(3)).ravel()
        return np.append(own, 3 * len(TURNING) + np.arange(3))

    def _spread(self, values: Float[Array, "frames unknowns *more"]) -> Float[Array, "frames SIZE *more"]:
        full = np.zeros((len(values), SIZE, *values.shape[2:]))
        full[:, self._rows] = values
        return full

    def _change(self, world: Float[Array, "frames joints 4"]) -> Float[Array, "frames unknowns unknowns"]:
        """What takes a solver's corrections into the body's axes."""
        place, _, above = self.hips
        body = self.to_hips(world)
        change = np.zeros((len(world), 3 * len(self.places) + 3, 3 * len(self.places) + 3))
        for number, axes in enumerate(rot.to_matrix(self.axes)):
            own = slice(3 * number, 3 * number + 3)
            change[:, own, own] = axes
        own = slice(3 * place, 3 * place + 3)
        change[:, own, own] = body if above < 0 else body @ rot.to_matrix(world[:, above])
        change[:, -3:, -3:] = body / self.height
        return change


def prepare_unknowns(target: Actor, levers: SkinLevers, stance: Stance) -> Unknowns:
    """The joints that turn, of a target that was brought into the stance."""
    upright = stance_axes(target.skeleton, target.humanoid, stance)
    parents = target.skeleton.parents[levers.turning]
    axes = np.where((parents >= 0)[:, None], upright[parents], rot.IDENTITY)
    hips = target.humanoid.joints["hips"]
    place = levers.turning.tolist().index(hips)
    return Unknowns(
        np.array([TURNING.index(name) for name in levers.names]), axes,
        (place, hips, int(target.skeleton.parents[hips])), upright[hips], target.height, levers.turning, parents,
    )  # fmt: skip
