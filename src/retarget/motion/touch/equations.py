"""One pose of the target as a least-squares problem: what its joints would have to do, to first order.

Unknowns are, for every turning joint, a rotation vector in its parent's frame on top of its copied local rotation (radians),
and a shift of the hips (metres): `x` of 3 joints + 3 numbers. Terms: contacts of the source along the normal and across it,
repulsion of what penetrates (point to plane, every vertex), resting points and end effectors as they were copied, joint
limits. Every Jacobian is analytic (`contact/pair_kernels.py`). After Ye 2024's aim, by a solver of our own; the paper
trains a network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.character import Skeleton
from retarget.contact.collide import Collider, prepare_collider
from retarget.contact.sensors import Sensors
from retarget.contact.skin_levers import SkinLevers, prepare_levers
from retarget.contact.support import SupportLimb, support_limbs
from retarget.motion.align import Actor
from retarget.motion.limits import LimitBounds, joint_limits, stack_limits
from retarget.motion.touch.goals import FrameGoals, FrameSurface

Array = np.ndarray

TALL = 1.7
"""Height (metres) of the bodies that weights and lengths in metres are meant for; on others they are in proportion."""
MARGIN = 0.0018
"""Share of the height that surfaces keep apart."""
MOST_CONTACT, MOST_REPULSION, MOST_NEAR = 100.0, 250.0, 30.0
"""The sum of weights (before the terms' own) that all contacts, all penetrating vertices and all near pairs have at most: a
large patch must not outweigh everything else."""
SLACK = 0.1
"""Thresholds that a contact may be off without being pulled."""
FARTHEST = 4.0
"""Thresholds that a contact may be off before its pull stops growing."""
EFFECTORS = ("leftHand", "rightHand", "head", "leftFoot", "rightFoot")
"""Joints whose orientation should stay as copied, as far as contacts allow."""


@dataclass(frozen=True)
class Weights:
    """What each term weighs; residuals are radians, and metres on a body as tall as `TALL`. Ours, measured on the seen half of the
    benchmark set."""

    contact: float = 9.0
    """A contact, along its normal."""
    across: float = 6.0
    """A contact, across it."""
    repulsion: float = 12.0
    """A penetrating vertex."""
    support: float = 300.0
    """A heel, a ball of the foot or a palm that rests on the ground."""
    swinging: float = 1.0
    """A heel or a ball of the foot that does not."""
    reaching: float = 0.2
    """A palm that does not: where a belly only pushes an arm out, the hand stays where it was copied to."""
    near: float = 36.0
    """A pair of sensors that are near each other on the source: their distance in radii of the arm."""
    orientation: float = 0.01
    """The orientation of an end effector."""
    limits: float = 300.0
    """What a joint is beyond its limits, further than in the copied pose."""

    def sized(self, height: float) -> Weights:
        """The same for residuals in metres on a body so tall: a body must not be corrected otherwise for its file's unit."""
        metric = ("contact", "across", "repulsion", "support", "swinging", "reaching", "near")
        return replace(self, **{name: getattr(self, name) * (TALL / height) ** 2 for name in metric})


@dataclass(frozen=True, eq=False)
class PosedBody:
    """The target in one pose."""

    world: Float[Array, "joints 4"]
    places: Float[Array, "joints 3"]
    vertices: Float[Array, "vertices 3"]


@dataclass(frozen=True, eq=False)
class Linearised:
    """E(at + d) ≈ E(at) - right · d + 1/2 d · matrix d."""

    at: Float[Array, "unknowns"]
    matrix: Float[Array, "unknowns unknowns"]
    right: Float[Array, "unknowns"]
    penetrating: int
    """Vertices nearer to another part than the margin."""
    deepest: float
    """How far the deepest of them is inside, beyond what it may, metres."""

    def times(self, factor: float) -> Linearised:
        """The same, weighing more against all that is not of this pose alone."""
        return replace(self, matrix=factor * self.matrix, right=factor * self.right)


@dataclass(frozen=True, eq=False)
class PoseEquations:
    """A target prepared for solving; `prepare_equations` makes one."""

    actor: Actor
    weights: Weights
    collider: Collider
    levers: SkinLevers
    limbs: tuple[SupportLimb, ...]
    effectors: Int[Array, "effectors"]
    """Joints in the skeleton."""
    turns_effector: Bool[Array, "effectors turning"]
    carries_point: Bool[Array, "points turning"]
    """Which turning joints carry each support point: heels and balls, then palms."""
    threshold: float
    """Metres within which skin touches."""
    sensors: Int[Array, "sensors 3"]
    """Vertices that each sensor lies between."""
    sensor_shares: Float[Array, "sensors 3"]
    columns: Int[Array, "vertices influences"]
    shares: Float[Array, "vertices influences"]
    binds: Float[Array, "columns 3 4"]
    hips: int
    """The joint that a shift moves."""
    limits: LimitBounds
    turns_limited: Bool[Array, "limits turning"]
    """Which turning joints turn a limited joint against what carries it."""

    @property
    def skeleton(self) -> Skeleton:
        return self.actor.skeleton

    @property
    def size(self) -> int:
        """Unknowns of a pose."""
        return 3 * len(self.levers.turning) + 3

    @cached_property
    def nothing(self) -> Linearised:
        """Of a pose that nothing is asked of."""
        return Linearised(np.zeros(self.size), np.zeros((self.size, self.size)), np.zeros(self.size), 0, 0.0)

    def pose(
        self,
        copied: Float[Array, "joints 4"],
        offsets: Float[Array, "joints 3"],
        x: Float[Array, "unknowns"],
        surface: FrameSurface | None = None,
    ) -> PosedBody:
        """The body in its copied pose (local rotations and offsets) with `x` on top; a `surface` takes the place of the
        skin at rest."""
        from retarget.contact import skin_kernels

        skin, skeleton = self.actor.character.skin, self.skeleton
        binds, bound = (self.binds, self.actor.character.mesh.vertices) if surface is None else surface.doubles
        world, places = np.empty((len(skeleton), 4)), np.empty((len(skeleton), 3))
        vertices = np.empty((len(self.columns), 3))
        turns = x[:-3].reshape(-1, 3)
        skin_kernels.pose_joints(skeleton.parents, copied, offsets, self.levers.turning, turns, world, places)
        places += x[-3:]
        skin_kernels.pose_skin(
            world, places, skin.joints, binds, self.columns, self.shares, bound, vertices
        )  # fmt: skip
        return PosedBody(world, places, vertices)

    def linearise(
        self,
        copied: Float[Array, "joints 4"],
        offsets: Float[Array, "joints 3"],
        goals: FrameGoals,
        x: Float[Array, "unknowns"],
    ) -> Linearised:
        """The normal equations of one pose at `x`."""
        from retarget.contact import pair_kernels

        body = self.pose(copied, offsets, x, goals.surface)
        matrix, right = np.zeros((self.size, self.size)), np.zeros(self.size)
        places = body.places[self.levers.turning]
        self._add_contacts(body, goals, places, matrix, right)
        self._add_near(body, goals, places, matrix, right)
        penetrating, deepest = self._add_repulsion(body, goals, places, matrix, right)
        points = self._support(body)
        weights = self.weights.support * goals.resting
        weights[: 2 * LEGS] = np.maximum(weights[: 2 * LEGS], self.weights.swinging)
        weights[2 * LEGS :] = np.maximum(weights[2 * LEGS :], self.weights.reaching)
        pair_kernels.add_points(points, goals.support - points, weights, self.carries_point, places, matrix, right)
        pair_kernels.add_orientations(
            body.world, goals.effectors, self.effectors, np.full(len(self.effectors), self.weights.orientation),
            self.turns_effector, matrix, right,
        )  # fmt: skip
        self._add_limits(body, goals, matrix, right)
        pair_kernels.mirror_lower(matrix)
        parents = self.skeleton.parents[self.levers.turning]
        above = np.where((parents >= 0)[:, None], body.world[parents], rot.IDENTITY)
        change = _world_from_turns(above, x)
        return Linearised(x, change.T @ matrix @ change, change.T @ right, penetrating, deepest)

    def _add_contacts(self, body: PosedBody, goals: FrameGoals, places: Array, matrix: Array, right: Array) -> None:
        from retarget.contact import pair_kernels

        count = len(goals.weight)
        if not goals.weight.any() or not (self.weights.contact or self.weights.across):
            return
        points, touched, normals, wanted = np.empty((4, count, 3))
        first, second = (goals.first, goals.first_shares), (goals.second, goals.second_shares)
        pair_kernels.place_pairs(
            body.vertices, *first, *second, goals.faces, goals.gap, SLACK * self.threshold,
            FARTHEST * self.threshold, points, touched, normals, wanted,
        )  # fmt: skip
        weight = goals.weight * goals.count
        weight *= min(1.0, MOST_CONTACT / max(float(weight.sum()), 1e-12))
        pair_kernels.add_pairs(
            *first, points, *second, touched, normals, wanted, self.weights.contact * weight,
            self.weights.across * weight, self.levers.joints, self.levers.weights, places, matrix, right,
        )  # fmt: skip

    def _add_near(self, body: PosedBody, goals: FrameGoals, places: Array, matrix: Array, right: Array) -> None:
        from retarget.contact import pair_kernels

        total = float(goals.closeness.sum())
        if total == 0.0 or not self.weights.near:
            return
        first, second = ((self.sensors[own], self.sensor_shares[own]) for own in goals.near)
        points, others = (np.einsum("pc,pci->pi", shares, body.vertices[corners]) for corners, shares in (first, second))
        way = points - others
        distance = np.linalg.norm(way, axis=1)
        direction = way / np.maximum(distance, 1e-9)[:, None]
        weight = goals.closeness * self.weights.near * min(1.0, MOST_NEAR / total)
        pair_kernels.add_pairs(
            *first, points, *second, others, direction, (goals.apart - distance)[:, None] * direction, weight,
            np.zeros(len(weight)), self.levers.joints, self.levers.weights, places, matrix, right,
        )  # fmt: skip

    def _add_repulsion(self, body: PosedBody, goals: FrameGoals, places: Array, matrix: Array, right: Array) -> tuple[int, float]:
        from retarget.contact import pair_kernels

        if not self.weights.repulsion:
            return 0, 0.0
        margin = MARGIN * self.actor.height
        near = self.collider.pairs(body.vertices, margin)
        missing = margin - near.distance
        if len(goals.sunk):
            allowed = np.zeros(len(body.vertices))
            allowed[goals.sunk] = goals.depth
            missing -= allowed[near.vertex]
        rows = np.flatnonzero(missing > 0)
        count = len(rows)
        if count:
            weight = np.full(count, self.weights.repulsion * min(1.0, MOST_REPULSION / count))
            vertex, normal = near.vertex[rows], near.normal[rows]
            pair_kernels.add_pairs(
                vertex[:, None], np.ones((count, 1)), body.vertices[vertex],
                self.actor.character.mesh.faces[near.face[rows]], near.barycentric[rows], near.point[rows], normal,
                missing[rows, None] * normal, weight, np.zeros(count),
                self.levers.joints, self.levers.weights, places, matrix, right,
            )  # fmt: skip
        return count, max(float(missing.max(initial=0.0)) - margin, 0.0)

    def _add_limits(self, body: PosedBody, goals: FrameGoals, matrix: Array, right: Array) -> None:
        from retarget.contact import pair_kernels
        from retarget.motion import limit_kernels

        limits, wanted = self.limits, np.empty((len(self.limits.joints), 4))
        beyond = limit_kernels.nearest_within(
            body.world, limits.joints, limits.carriers, limits.frames, limits.carrier_frames, limits.axes, limits.hinges,
            goals.allowed, wanted,
        )  # fmt: skip
        if beyond.any():
            pair_kernels.add_orientations(
                body.world, wanted, limits.joints, self.weights.limits * beyond, self.turns_limited, matrix, right
            )

    def _support(self, body: PosedBody) -> Float[Array, "points 3"]:
        """Places of heels, balls and palms."""
        return np.concatenate(
            [
                body.places[limb.joints[2]] + rot.rotate(body.world[limb.joints[2]][None], limb.points)
                for limb in self.limbs
            ]
        )


LEGS = 2
"""The first two support limbs are the legs, with two points each."""


def prepare_equations(actor: Actor, weights: Weights, threshold: float, sensors: Sensors) -> PoseEquations:
    """Prepare a target with a surface. Raises `RetargetError` for one without."""
    character, humanoid, skeleton = actor.character, actor.humanoid, actor.skeleton
    collider, levers = prepare_collider(character, humanoid), prepare_levers(character, humanoid)
    limits = stack_limits(joint_limits(actor))
    limbs = support_limbs(character, humanoid)
    place = {joint: number for number, joint in enumerate(levers.turning.tolist())}
    effectors = [humanoid.joints[name] for name in EFFECTORS if name in humanoid.joints]
    ends = [limb.joints[2] for limb in limbs for _ in limb.points]
    skin = character.skin
    order = np.argsort(-skin.weights, axis=1, kind="stable")
    return PoseEquations(
        actor,
        weights.sized(actor.height),
        collider,
        levers,
        limbs,
        np.array(effectors),
        np.ascontiguousarray(levers.above[:, [place[joint] for joint in effectors]].T),
        np.ascontiguousarray(levers.above[:, [place[joint] for joint in ends]].T),
        threshold,
        np.where(sensors.valid[:, None], character.mesh.faces[sensors.faces], 0),
        sensors.barycentrics,
        np.take_along_axis(skin.columns, order, axis=1).astype(np.int32),
        np.ascontiguousarray(np.take_along_axis(skin.weights, order, axis=1)),
        np.ascontiguousarray(skin.inverse_binds[:, :3]),
        humanoid.joints["hips"],
        limits,
        np.ascontiguousarray(_carrying(levers, skeleton, limits.joints) & ~_carrying(levers, skeleton, limits.carriers)),
    )


def _carrying(levers: SkinLevers, skeleton: Skeleton, joints: Int[Array, "joints"]) -> Bool[Array, "joints turning"]:
    """Which turning joints carry each joint (or are it)."""
    carries = np.zeros((len(joints), len(levers.turning)), dtype=bool)
    for row, joint in zip(carries, joints.tolist()):
        while joint >= 0:
            row |= levers.turning == joint
            joint = int(skeleton.parents[joint])
    return carries


def _world_from_turns(above: Float[Array, "turning 4"], x: Float[Array, "unknowns"]) -> Float[Array, "unknowns unknowns"]:
    """How turns about the world's axes follow from changes of the rotation vectors: with R the world rotation of what a joint
    hangs on and J the left Jacobian of exp, exp(turn + d) = exp(J d) exp(turn), which turns the world by R J d. The shift
    stays."""
    blocks = rot.to_matrix(above) @ rot.left_jacobian(x[:-3].reshape(-1, 3))
    change = np.zeros((len(x), len(x)))
    for number, block in enumerate(blocks):
        change[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = block
    change[-3:, -3:] = np.eye(3)
    return change
