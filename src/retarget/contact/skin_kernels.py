"""Compiled loops: one pose of a skinned body, all of it or a few points. For solvers, which pose one body again and again;
whole clips are faster through `body.skinning`. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS


@njit(**OPTIONS)
def multiply(a, b, out):
    """Quaternion product (xyzw)."""
    ax, ay, az, aw = a[0], a[1], a[2], a[3]
    bx, by, bz, bw = b[0], b[1], b[2], b[3]
    out[0] = aw * bx + ax * bw + ay * bz - az * by
    out[1] = aw * by - ax * bz + ay * bw + az * bx
    out[2] = aw * bz + ax * by - ay * bx + az * bw
    out[3] = aw * bw - ax * bx - ay * by - az * bz


@njit(**OPTIONS)
def _matrix(q, out):
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@njit(**OPTIONS)
def pose_joints(parents, rotations, offsets, turning, turns, world, places):
    """World rotations (joints x 4) and places (joints x 3) of local rotations and offsets, with the `turns` (rotation
    vectors in the parent's frame) of the joints `turning` on top of their local rotations. Parents come first."""
    turn = np.zeros((len(parents), 4))
    turn[:, 3] = 1.0
    for number in range(len(turning)):
        x, y, z = turns[number, 0], turns[number, 1], turns[number, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        share = np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
        joint = turning[number]
        turn[joint, 0], turn[joint, 1], turn[joint, 2] = share * x, share * y, share * z
        turn[joint, 3] = np.cos(0.5 * angle)
    local, matrix = np.empty(4), np.empty((3, 3))
    for joint in range(len(parents)):
        multiply(turn[joint], rotations[joint], local)
        above = parents[joint]
        if above < 0:
            world[joint], places[joint] = local, offsets[joint]
            continue
        multiply(world[above], local, world[joint])
        _matrix(world[above], matrix)
        for i in range(3):
            places[joint, i] = (
                places[above, i]
                + matrix[i, 0] * offsets[joint, 0]
                + matrix[i, 1] * offsets[joint, 1]
                + matrix[i, 2] * offsets[joint, 2]
            )


@njit(**OPTIONS)
def pose_skin(world, places, column_joints, binds, columns, weights, rest, out):
    """Posed vertices by linear blend skinning; `binds` (columns x 3 x 4) are joint-from-mesh, weights come heaviest first."""
    moves = np.empty((len(column_joints), 3, 4))
    matrix = np.empty((3, 3))
    for column in range(len(column_joints)):
        joint = column_joints[column]
        _matrix(world[joint], matrix)
        for i in range(3):
            for j in range(4):
                moves[column, i, j] = (
                    matrix[i, 0] * binds[column, 0, j]
                    + matrix[i, 1] * binds[column, 1, j]
                    + matrix[i, 2] * binds[column, 2, j]
                )
            moves[column, i, 3] += places[joint, i]
    for vertex in range(len(rest)):
        x, y, z = rest[vertex, 0], rest[vertex, 1], rest[vertex, 2]
        px, py, pz = 0.0, 0.0, 0.0
        for place in range(columns.shape[1]):
            weight = weights[vertex, place]
            if weight == 0.0:
                break
            m = moves[columns[vertex, place]]
            px += weight * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
            py += weight * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
            pz += weight * (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
        out[vertex, 0], out[vertex, 1], out[vertex, 2] = px, py, pz


@njit(**OPTIONS)
def _placed(moves, columns, weights, rest, vertex, out):
    """One vertex of a body, posed."""
    x, y, z = rest[vertex, 0], rest[vertex, 1], rest[vertex, 2]
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    for place in range(columns.shape[1]):
        weight = weights[vertex, place]
        if weight == 0.0:
            continue
        m = moves[columns[vertex, place]]
        for i in range(3):
            out[i] += weight * (m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + m[i, 3])


@njit(**OPTIONS)
def touching_share(moves, columns, weights, bodies, first, second, shares, normals, threshold, out):
    """For pairs of a vertex and a point of three others: the share of `bodies` (bodies x vertices x 3, at rest, on one
    skeleton) on which they still meet in the pose `moves` (columns x 3 x 4): in full up to a gap of one threshold, not at
    all from three on. What is inside along the normal has no gap."""
    point, corner, way = np.empty(3), np.empty(3), np.empty(3)
    for pair in range(len(first)):
        total = 0.0
        for body in range(len(bodies)):
            rest = bodies[body]
            _placed(moves, columns, weights, rest, first[pair], point)
            way[:] = point
            for k in range(3):
                _placed(moves, columns, weights, rest, second[pair, k], corner)
                for i in range(3):
                    way[i] -= shares[pair, k] * corner[i]
            out_by = way[0] * normals[pair, 0] + way[1] * normals[pair, 1] + way[2] * normals[pair, 2]
            aside = 0.0
            for i in range(3):
                aside += (way[i] - out_by * normals[pair, i]) ** 2
            gap = np.sqrt(max(out_by, 0.0) ** 2 + aside)
            total += min(max((3.0 - gap / threshold) / 2.0, 0.0), 1.0)
        out[pair] = total / len(bodies)


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `collide.compile_kernels` does."""
    world, places, vertices = np.empty((1, 4)), np.empty((1, 3)), np.empty((1, 3))
    rotations, none = np.array([[0.0, 0, 0, 1]]), np.zeros((1, 3))
    pose_joints(np.array([-1]), rotations, none, np.array([0]), none, world, places)
    pose_skin(
        world, places, np.zeros(1, int), np.eye(4)[None, :3].copy(), np.zeros((1, 1), np.int32), np.ones((1, 1)), none,
        vertices,
    )  # fmt: skip
    zero = np.zeros(1, dtype=np.int64)
    touching_share(
        np.eye(4)[None, :3].copy(), np.zeros((1, 1), dtype=np.int64), np.ones((1, 1)), none[None], zero,
        np.zeros((1, 3), dtype=np.int64), none, none, 1.0, np.empty(1),
    )  # fmt: skip
