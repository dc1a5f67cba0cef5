"""The body drawn into a cloud: Gauss-Newton over turns, place and shape, points of the skin along their normals.

Pairs go both ways: every point of the cloud draws the nearest skin, and skin that the cloud shows looks for the cloud. What
is expected of the pose (`Expected`) enters the same equations, as in a Kalman filter's update.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.methods.scan.cloud import Bins, binned
from retarget.methods.scan.scan_body import ScanBody, ShapedBody
from retarget.rig.fit_model import BodyState

Array = np.ndarray

NOISE = 0.02
"""Metres that a pair of points is taken to be off. More than scanners are: neighbouring points err alike."""
SAID_BACK = 700
"""Points of the skin, the first of the spread ones, that look for the cloud."""
FAR = 0.25
"""Metres within which neighbours are looked for."""
SMALLEST = 0.3
"""Size over an adult's below which nobody is taken to be."""
NEAR = 0.05
"""Metres within which a point of the cloud is explained."""
COMMON, WILD = 2.0, 300.0
"""Standard deviations within which the shapes of people lie, and how stiffly what lies beyond is drawn back."""
LARGEST_TURN = 0.5
"""Radians in one step."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known of a pose before its cloud is looked at. Precisions are inverse squares of standard deviations."""

    turns: Float[Array, "joints 3 3"]
    """Parent-from-joint turns from rest; the root's in the world."""
    turn_precision: Float[Array, "joints"]
    usual_precision: Float[Array, "joints 3 3"]
    """Of turns from the parent in rest pose, about the parent's axes: what is usual of a joint."""
    root: Float[Array, "3"]
    root_precision: float
    shape: Float[Array, "shapes"]
    shape_precision: Float[Array, "shapes shapes"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A body in a cloud."""

    state: BodyState
    information: Float[Array, "parameters parameters"]
    """What the pairs of the last round say, in the order of `PosedBody.jacobian`; without the shape where that was held."""
    distance: float
    """Metres, root mean square along normals over what is explained."""
    explained: float
    """Share of the cloud within `NEAR` of the skin."""
    seen: float
    """Share of the skin that the cloud shows."""
    shown: Bool[Array, "points"]
    """Which of the first `SAID_BACK` points of the skin the cloud shows."""
    astray: Bool[Array, "cloud"]
    """Which points of the cloud are not within `NEAR` of the skin."""
    strain: float
    """Standard deviations, all joints taken together, that the pose is away from rest (`usual`)."""


def relative_turns(body: ScanBody, turns: Float[Array, "joints 3 3"]) -> Float[Array, "joints 3 3"]:
    """Parent-from-joint turns of world turns; the root's stay."""
    relative = turns.copy()
    relative[1:] = np.matmul(turns[body.parents[1:]].transpose(0, 2, 1), turns[1:])
    return relative


def world_turns(body: ScanBody, relative: Float[Array, "joints 3 3"]) -> Float[Array, "joints 3 3"]:
    """World turns of parent-from-joint turns."""
    turns = relative.copy()
    for joint in range(1, len(turns)):
        turns[joint] = turns[body.parents[joint]] @ relative[joint]
    return turns


def rotation_vectors(turns: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Axis times angle of rotation matrices, radians."""
    return rot.to_rotation_vector(rot.from_matrix(turns))


def turn_matrices(vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of axes times angles."""
    return rot.to_matrix(rot.from_rotation_vector(vectors))


def relative_size(state: BodyState) -> float:
    """A body's size over an adult's, at most 1: limbs of a toddler lie within what is one limb of an adult, so lengths by which
    a fit judges are as much shorter."""
    return float(np.clip(1.0 + state.shape[-1], SMALLEST, 1.0))


def fit_cloud(
    body: ScanBody,
    state: BodyState,
    cloud: Bins,
    expected: Expected,
    reaches: Sequence[float],
    shaping: bool,
    shaped: ShapedBody | None = None,
    across: float = 0.0,
) -> Fit:
    """Draw the body into the cloud, a round for every reach (metres at which a distance begins to count for less).

    `shaping` frees the shape; else `shaped`, the body in the state's shape, saves making it. `across` is the weight of pulls
    along the skin, which far starts need; along normals it is 1.
    """
    import retarget.methods.scan.fit_kernels as kernels

    count, size = len(body.parents), relative_size(state)
    room = Room.of(body, len(cloud.points))
    shaped = shaped or body.shaped(state.shape)
    information = np.zeros((0, 0))
    wide = 3 * count + 3 + (body.shapes if shaping else 0)
    for reach in reaches:
        posed = Posed.of(body, shaped, state)
        skin = binned(posed.points)
        to_body, body_squares = skin.nearest(cloud.points, FAR)
        to_cloud, cloud_squares = cloud.nearest(posed.points[:SAID_BACK], FAR)
        kernels.gather(
            posed.points, posed.normals, body.say, cloud.points, to_body, body_squares, to_cloud, cloud_squares, size * reach,
            room.seen, room.weight, room.force,
        )  # fmt: skip
        chosen = np.flatnonzero(room.weight > 1e-6)
        heavy = np.sqrt(room.weight[chosen]) / (size * NOISE)
        rows = np.empty((len(chosen), wide))
        if shaping:
            kernels.carried_shapes(body.parents, body.joint_shapes, state.turns, room.moved)
        kernels.fill_rows(
            chosen, heavy, posed.normals, body.parents, shaped.points, body.point_columns, body.point_weights, state.turns,
            posed.offsets, posed.joints, body.point_basis, room.moved, rows,
        )  # fmt: skip
        information = rows.T @ rows
        gradient = rows.T @ (room.force[chosen] / room.weight[chosen] * heavy)
        if across:
            _pull_across(body, shaped, state, posed, room, cloud.points, to_body, size * reach, across, information, gradient)
        state = _step(body, state, information, gradient, expected, shaping)
        if shaping:
            shaped = body.reshaped(shaped, state.shape)
    return _judged(body, shaped, state, cloud, information, expected)


def _rigid(turns: Float[Array, "joints 3 3"]) -> Float[Array, "joints 3 3"]:
    """Matrices that are nearly rotations made so (a step of Newton's towards the polar factor): rounding errors multiply from frame to
    frame along the chains of joints, and after ten seconds the body was torn apart."""
    return 0.5 * np.matmul(turns, 3.0 * np.eye(3) - np.matmul(turns.transpose(0, 2, 1), turns))


@dataclass(frozen=True, eq=False)
class Room:
    """Arrays that compiled loops work in."""

    seen: Bool[Array, "_"]
    weight: Float[Array, "points"]
    force: Float[Array, "points"]
    moved: Float[Array, "joints 3 shapes"]

    @classmethod
    def of(cls, body: ScanBody, cloud: int) -> Room:
        points, back = len(body.chosen), min(SAID_BACK, len(body.chosen))
        moved = np.zeros((len(body.parents), 3, body.shapes))
        return cls(np.zeros(back, dtype=bool), np.empty(points), np.empty(points), moved)


@dataclass(frozen=True, eq=False)
class Posed:
    """The body's points in a pose."""

    points: Float[Array, "points 3"]
    normals: Float[Array, "points 3"]
    joints: Float[Array, "joints 3"]
    offsets: Float[Array, "joints 3"]

    @classmethod
    def of(cls, body: ScanBody, shaped: ShapedBody, state: BodyState) -> Posed:
        import retarget.methods.scan.fit_kernels as kernels

        joints, offsets = np.empty_like(shaped.joints), np.empty_like(shaped.joints)
        kernels.place_joints(body.parents, shaped.joints, state.turns, state.root, joints, offsets)
        points, normals = np.empty_like(shaped.points), np.empty_like(shaped.points)
        kernels.pose_points(
            shaped.points, shaped.normals, body.point_columns, body.point_weights, state.turns, offsets, points, normals
        )
        return cls(points, normals, joints, offsets)


def _strain(body: ScanBody, state: BodyState, expected: Expected) -> float:
    beside = rotation_vectors(relative_turns(body, state.turns))
    return float(np.sqrt(np.einsum("ja,jab,jb->", beside, expected.usual_precision, beside)))


def _judged(
    body: ScanBody, shaped: ShapedBody, state: BodyState, cloud: Bins, information: Array, expected: Expected
) -> Fit:
    import retarget.methods.scan.fit_kernels as kernels

    posed, room = Posed.of(body, shaped, state), Room.of(body, len(cloud.points))
    close = relative_size(state) * NEAR
    to_body, squares = binned(posed.points).nearest(cloud.points, FAR)
    to_cloud, back = cloud.nearest(posed.points[:SAID_BACK], FAR)
    total, along = kernels.gather(
        posed.points, posed.normals, body.say, cloud.points, to_body, squares, to_cloud, back, close,
        room.seen, room.weight, room.force,
    )  # fmt: skip
    astray = squares >= close**2
    near = 1.0 - float(astray.mean()) if len(squares) else 0.0
    shown = room.seen & (back < close**2)
    distance = float(np.sqrt(along / max(total, 1e-9)))
    strain = _strain(body, state, expected)
    return Fit(state, information, distance, near, float(shown.mean()), shown, astray, strain)


def _pull_across(
    body: ScanBody, shaped: ShapedBody, state: BodyState, posed: Posed, room: Room, cloud: Array, to_body: Array,
    reach: float, across: float, information: Array, gradient: Array,
) -> None:  # fmt: skip
    """Add, in place, pulls of the cloud's points in all three directions, lightly."""
    import retarget.methods.scan.fit_kernels as kernels

    told = np.flatnonzero(to_body >= 0)
    away = cloud[told] - posed.points[to_body[told]]
    weight = body.say[to_body[told]] / (1.0 + (away**2).sum(axis=1) / reach**2) ** 2
    chosen = np.ascontiguousarray(to_body[told].astype(np.int64))
    heavy = np.sqrt(across * weight) / (relative_size(state) * NOISE)
    rows = np.empty((len(chosen), information.shape[1]))
    for axis in range(3):
        direction = np.broadcast_to(np.eye(3)[axis], posed.points.shape).copy()
        kernels.fill_rows(
            chosen, heavy, direction, body.parents, shaped.points, body.point_columns, body.point_weights, state.turns,
            posed.offsets, posed.joints, body.point_basis, room.moved, rows,
        )  # fmt: skip
        information += rows.T @ rows
        gradient += rows.T @ (away[:, axis] * heavy)


def _step(
    body: ScanBody, state: BodyState, information: Array, gradient: Array, expected: Expected, shaping: bool
) -> BodyState:
    """Add what is expected, solve, and move."""
    import retarget.methods.scan.fit_kernels as kernels

    count = len(body.parents)
    matrix, wanted = information.copy(), gradient.copy()
    relative = relative_turns(body, state.turns)
    carriers = np.concatenate([np.eye(3)[None], state.turns[body.parents[1:]]])
    beside = rotation_vectors(np.concatenate([np.matmul(relative, expected.turns.transpose(0, 2, 1)), relative]))
    precision = expected.usual_precision + expected.turn_precision[:, None, None] * np.eye(3)
    pull = expected.turn_precision[:, None] * beside[:count] + np.einsum("jab,jb->ja", expected.usual_precision, beside[count:])
    wanted[: 3 * count] -= np.einsum("jab,jb->ja", carriers, pull).ravel()
    blocks = np.matmul(np.matmul(carriers, precision), carriers.transpose(0, 2, 1))
    for joint in range(count):
        matrix[3 * joint : 3 * joint + 3, 3 * joint : 3 * joint + 3] += blocks[joint]
    place = slice(3 * count, 3 * count + 3)
    matrix[place, place] += expected.root_precision * np.eye(3)
    wanted[place] -= expected.root_precision * (state.root - expected.root)
    if shaping:
        matrix[3 * count + 3 :, 3 * count + 3 :] += expected.shape_precision
        wanted[3 * count + 3 :] -= expected.shape_precision @ (state.shape - expected.shape)
        wild = WILD * np.maximum((state.shape / (COMMON * body.spread)) ** 2 - 1.0, 0.0) / body.spread**2
        wild[-1] = 0.0  # size alone: infants are far smaller than most, and as common
        matrix[3 * count + 3 :, 3 * count + 3 :] += np.diag(wild)
        wanted[3 * count + 3 :] -= wild * state.shape
    matrix[np.diag_indices_from(matrix)] += 1e-3
    step = np.linalg.solve(matrix, wanted)
    step *= min(1.0, LARGEST_TURN / max(np.abs(step[: 3 * count]).max(), 1e-12))
    turns = np.empty_like(state.turns)
    kernels.turn_joints(body.parents, step, state.turns, turns)
    turns = _rigid(turns)
    shape = state.shape + step[3 * count + 3 :] if shaping else state.shape
    return BodyState(shape, turns, state.root + step[place])
