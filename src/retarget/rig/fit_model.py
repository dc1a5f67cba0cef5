"""A body that can be fitted: rest surface and joints that depend linearly on shape coefficients, posed by skinning.

Points and their derivatives by every turn, move and coefficient are closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class FitModel:
    """What a fit knows of the template, at chosen points of its surface."""

    parents: Int[Array, "joints"]
    """Parents come before their children; joint 0 is the root."""
    points: Float[Array, "points 3"]
    """At rest, in the mean shape."""
    normals: Float[Array, "points 3"]
    joints: Float[Array, "joints 3"]
    """At rest, in the mean shape."""
    weights: Float[Array, "points joints"]
    """Skinning weights."""
    point_basis: Float[Array, "shapes points 3"]
    """How points move with each coefficient of the shape."""
    joint_basis: Float[Array, "shapes joints 3"]
    spread: Float[Array, "shapes"]
    """How far each coefficient is expected to go: one standard deviation."""
    usual: Float[Array, "shapes"]
    """The shape that coefficients are expected around."""
    bends: Float[Array, "joints 3"]
    """Rotation vectors that the joints' turns from their parents are expected around, in the rest pose's axes."""
    fingers: int
    """Joints from this one on are fingers."""

    def around(self, shape: Float[Array, "shapes"]) -> FitModel:
        """The same body, expected to be near another shape."""
        return replace(self, usual=shape)

    def at(self, chosen: Int[Array, "chosen"] | slice) -> FitModel:
        """The same body at some of its points."""
        return replace(
            self,
            points=self.points[chosen],
            normals=self.normals[chosen],
            weights=self.weights[chosen],
            point_basis=np.ascontiguousarray(self.point_basis[:, chosen]),  # else every product begins with a copy
        )

    @cached_property
    def basis_by_point(self) -> Float[Array, "points 3 shapes"]:
        """`point_basis`, points first."""
        return np.ascontiguousarray(self.point_basis.transpose(1, 2, 0))

    @cached_property
    def influences(self) -> tuple[Int[Array, "points influences"], Float[Array, "points influences"]]:
        """`weights`, row by row without what is nought: joints in order, then as many of nought as make rows equally long."""
        count = max(1, int((self.weights != 0.0).sum(axis=1).max(initial=0)))
        columns = np.argsort(self.weights == 0.0, axis=1, kind="stable")[:, :count]
        return np.ascontiguousarray(columns), np.take_along_axis(self.weights, columns, axis=1)

    @cached_property
    def inertia(self) -> Float[Array, "joints"]:
        """How much a turn of each joint moves the points at rest: their mean squared distance from it, by weight, over all that
        hangs on it (m²)."""
        arms = ((self.points[:, None] - self.joints) ** 2).sum(axis=2)
        return ((self.weights @ hangs_on(self.parents).T) * arms).mean(axis=0)

    def points_of(self, shape: Float[Array, "shapes"]) -> Float[Array, "points 3"]:
        """Points at rest in a shape."""
        return self.points + np.tensordot(shape, self.point_basis, axes=1)

    def joints_of(self, shape: Float[Array, "shapes"]) -> Float[Array, "joints 3"]:
        """Joints at rest in a shape."""
        return self.joints + np.tensordot(shape, self.joint_basis, axes=1)


@dataclass(frozen=True, eq=False)
class BodyState:
    """A shape in a pose."""

    shape: Float[Array, "shapes"]
    turns: Float[Array, "joints 3 3"]
    """Rotation of each joint's part from rest, in the world."""
    root: Float[Array, "3"]
    """Place of the first joint."""


@dataclass(frozen=True, eq=False)
class PosedBody:
    """Where a state puts points, normals and joints, and how points move with it."""

    points: Float[Array, "points 3"]
    normals: Float[Array, "points 3"]
    joints: Float[Array, "joints 3"]
    jacobian: Float[Array, "points 3 parameters"] | None
    """By the turns of the joints (about world axes, three a joint), the root's move, and the coefficients of the shape."""


def hangs_on(parents: Int[Array, "joints"]) -> Float[Array, "joints joints"]:
    """1 in row a, column d, where joint d is joint a or hangs on it; else 0."""
    below = np.eye(len(parents))
    for joint in range(len(parents) - 1, 0, -1):
        below[parents[joint]] = np.maximum(below[parents[joint]], below[joint])
    return below


def part_transforms(model: FitModel, state: BodyState) -> tuple[Float[Array, "joints 3"], Float[Array, "joints 3"]]:
    """Places of the joints, and what each part's rigid move adds after its turn."""
    rest = model.joints_of(state.shape)
    joints = np.empty_like(rest)
    joints[0] = state.root
    for joint in range(1, len(rest)):
        above = model.parents[joint]
        joints[joint] = joints[above] + state.turns[above] @ (rest[joint] - rest[above])
    return joints, joints - np.einsum("jab,jb->ja", state.turns, rest)


def pose_body(model: FitModel, state: BodyState, derivatives: bool = False) -> PosedBody:
    """Linear blend skinning of a shape."""
    rest = model.points_of(state.shape)
    joints, offsets = part_transforms(model, state)
    blended = np.tensordot(model.weights, state.turns, axes=1)
    points = np.einsum("pab,pb->pa", blended, rest) + model.weights @ offsets
    normals = rot.unit(np.einsum("pab,pb->pa", blended, model.normals))
    if not derivatives:
        return PosedBody(points, normals, joints, None)
    from retarget.rig.fit_kernels import fill_jacobian

    columns, weights = model.influences
    jacobian = np.empty((len(points), 3, 3 * len(joints) + 3 + len(model.spread)))
    fill_jacobian(
        model.parents, columns, weights, rest, model.basis_by_point, state.turns, offsets, joints, _moved(model, state), jacobian
    )
    return PosedBody(points, normals, joints, jacobian)


def _moved(model: FitModel, state: BodyState) -> Float[Array, "joints 3 shapes"]:
    """How the offset of each part's rigid move changes with a coefficient of the shape."""
    basis = model.joint_basis.transpose(1, 2, 0)
    placed = np.zeros(basis.shape)
    for joint in range(1, len(model.parents)):
        above = model.parents[joint]
        placed[joint] = placed[above] + state.turns[above] @ (basis[joint] - basis[above])
    return placed - state.turns @ basis


def moved_state(state: BodyState, step: Float[Array, "parameters"], parents: Int[Array, "joints"]) -> BodyState:
    """The state after a step in the parameters of `PosedBody.jacobian`: what hangs on a joint turns with it."""
    count = len(parents)
    own = rot.to_matrix(rot.from_rotation_vector(step[: 3 * count].reshape(count, 3)))
    turns = own.copy()
    for joint in range(1, count):
        turns[joint] = turns[parents[joint]] @ own[joint]
    return BodyState(
        state.shape + step[3 * count + 3 :], turns @ state.turns, state.root + step[3 * count : 3 * count + 3]
    )


def part_shapes(
    parents: Int[Array, "joints"],
    points: Float[Array, "points 3"],
    joints: Float[Array, "joints 3"],
    weights: Float[Array, "points joints"],
    groups: list[list[int]],
) -> tuple[Float[Array, "shapes points 3"], Float[Array, "shapes joints 3"]]:
    """Two shapes for each group of joints (one joint, or a left and a right one): their parts larger about the joint, with
    what hangs on them carried along; and their parts thicker about the bone. Ours, for bodies of any proportions."""
    below = hangs_on(parents) > 0
    moved, shifted = [], []
    for group in groups:
        larger, thicker, apart = np.zeros_like(points), np.zeros_like(points), np.zeros_like(joints)
        for joint in group:
            arms = points - joints[joint]
            larger += weights[:, joint, None] * arms
            ends = np.flatnonzero(parents == joint)
            for child in ends:
                bone = joints[child] - joints[joint]
                larger += weights[:, below[child]].sum(axis=1)[:, None] * bone
                apart[below[child]] += bone
            middle = weights[:, joint] @ points / max(float(weights[:, joint].sum()), 1e-12)
            axis = rot.unit((joints[ends].mean(axis=0) if len(ends) else middle) - joints[joint])
            thicker += weights[:, joint, None] * (arms - (arms @ axis)[:, None] * axis)
        moved += [larger, thicker]
        shifted += [apart, np.zeros_like(joints)]
    return np.stack(moved), np.stack(shifted)
