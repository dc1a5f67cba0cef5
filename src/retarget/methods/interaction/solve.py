"""One pose made to touch what it should and nothing else: damped Gauss-Newton over the turns of the upper body's joints.

Terms: contacts of the source (along the normal and across it), repulsion of what penetrates (point to plane, every
vertex), closeness to the copied pose, closeness to the frame before. All by analytic Jacobians (`contact/pair_kernels.py`). After
Ye 2024's aim, by a solver of our own; the paper trains a network.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.body.skinning import Skinner
from retarget.character import Skeleton
from retarget.contact.collide import Collider
from retarget.contact.skin_levers import SkinLevers

Array = np.ndarray

ROUNDS = 2
"""Gauss-Newton steps a frame; frames are warm-started, and one step is nearly as good."""
MARGIN = 0.0018
"""Share of the height that surfaces keep apart."""
CONTACT, ACROSS, REPULSION = 3.0, 1.0, 6.0
"""Weights of a contact along and across its normal, and of a penetrating vertex."""
MOST_CONTACT, MOST_REPULSION = 60.0, 150.0
"""The sum of weights (before those above) that all contacts, and all penetrating vertices, have at most: a large patch
must not outweigh everything else."""
PRIOR = 0.015
"""Weight of closeness to the copied pose, times the joint's stiffness."""
STEADY = 0.02
"""The same for the frame before."""
STIFFNESS = {"spine": 15.0, "chest": 15.0, "upperChest": 15.0, "neck": 4.0, "head": 4.0, "Shoulder": 2.0, "Hand": 2.0}
"""Of each joint against being turned; 1 for those not named."""
LONGEST_TURN = 0.25
"""Radians that a joint turns in one step at most."""
SLACK = 0.2
"""Thresholds that a contact may be off without being pulled."""


@dataclass(frozen=True, eq=False)
class FrameContacts:
    """What should touch on one frame, on the target's own vertices."""

    first: Int[Array, "contacts"]
    second: Int[Array, "contacts 3"]
    shares: Float[Array, "contacts 3"]
    gap: Float[Array, "contacts"]
    """How far apart along the second's normal, metres."""
    weight: Float[Array, "contacts"]


@dataclass(frozen=True, eq=False)
class PoseSolver:
    """A target prepared for solving."""

    skeleton: Skeleton
    faces: Int[Array, "faces 3"]
    skinner: Skinner
    collider: Collider
    levers: SkinLevers
    height: float
    threshold: float
    """Metres within which skin touches."""

    @property
    def stiffness(self) -> Float[Array, "turning"]:
        names = (name.removeprefix("left").removeprefix("right") for name in self.levers.names)
        return np.array([STIFFNESS.get(name, 1.0) for name in names])

    def frame(
        self,
        copied: Float[Array, "joints 4"],
        offsets: Float[Array, "joints 3"],
        contacts: FrameContacts,
        before: Float[Array, "turning 3"],
    ) -> Float[Array, "turning 3"]:
        """The turns (rotation vectors on top of the copied local rotations, radians) that mend one pose. `before` are the
        last frame's, from which it starts."""
        turns, stiff = before.copy(), np.repeat(self.stiffness, 3)
        for _ in range(ROUNDS):
            rotations, positions = forward(self.skeleton.parents, self.turned(copied, turns), offsets)
            vertices = self.skinner.vertices(rotations[None], positions[None])[0].astype(np.float64)
            matrix, right = self._equations(vertices, positions, contacts)
            world = rotations[self.levers.turning]
            matrix[np.diag_indices(len(matrix))] += (PRIOR + STEADY) * stiff + 1e-6
            right -= stiff * (PRIOR * rot.rotate(world, turns) + STEADY * rot.rotate(world, turns - before)).ravel()
            step = np.linalg.solve(matrix, right).reshape(-1, 3)
            longest = float(np.linalg.norm(step, axis=1).max())
            step *= min(1.0, LONGEST_TURN / max(longest, 1e-12))
            own = rot.from_rotation_vector(rot.rotate(rot.inverse(world), step))
            turns = rot.to_rotation_vector(rot.multiply(rot.from_rotation_vector(turns), own))
            if longest < 1e-4:
                break
        return turns

    def turned(
        self, copied: Float[Array, "*frames joints 4"], turns: Float[Array, "*frames turning 3"]
    ) -> Float[Array, "*frames joints 4"]:
        """Local rotations with the turns on top."""
        local = copied.copy()
        turning = self.levers.turning
        local[..., turning, :] = rot.multiply(local[..., turning, :], rot.from_rotation_vector(turns))
        return local

    def _equations(
        self, vertices: Float[Array, "vertices 3"], positions: Float[Array, "joints 3"], contacts: FrameContacts
    ) -> tuple[Array, Array]:
        from retarget.contact import pair_kernels

        size = 3 * len(self.levers.turning)
        matrix, right = np.zeros((size, size)), np.zeros(size)
        skin = (
            vertices, self.levers.joints, self.levers.weights, positions[self.levers.turning], self.levers.parents,
            matrix, right,
        )  # fmt: skip
        if len(contacts.first):
            corners = vertices[contacts.second]
            normals = rot.unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
            apart = vertices[contacts.first] - (contacts.shares[:, :, None] * corners).sum(axis=1)
            wanted = contacts.gap[:, None] * normals - apart
            off = np.linalg.norm(wanted, axis=1)
            wanted *= np.maximum(0.0, 1.0 - SLACK * self.threshold / np.maximum(off, 1e-12))[:, None]
            weight = contacts.weight * min(1.0, MOST_CONTACT / max(float(contacts.weight.sum()), 1e-12))
            pair_kernels.add_pairs(
                contacts.first,
                contacts.second,
                contacts.shares,
                normals,
                wanted,
                CONTACT * weight,
                ACROSS * weight,
                *skin,
            )
        margin = MARGIN * self.height
        near = self.collider.pairs(vertices, margin)
        if len(near.vertex):
            weight = np.full(len(near.vertex), REPULSION * min(1.0, MOST_REPULSION / len(near.vertex)))
            pair_kernels.add_pairs(
                near.vertex, self.faces[near.face], near.barycentric, near.normal,
                (margin - near.distance)[:, None] * near.normal, weight, np.zeros(len(weight)), *skin,
            )  # fmt: skip
        pair_kernels.mirror_lower(matrix)
        return matrix, right
