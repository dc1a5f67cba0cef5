"""Compiled loops of `fit_model` and `fit`: how posed points move with every parameter. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}


@njit(**OPTIONS)
def fill_jacobian(parents, columns, weights, rest, basis, turns, offsets, joints, moved, out):
    """Write the derivatives of skinned points into `out` (points x 3 x parameters).

    `columns` and `weights` (points x influences) are the joints that move each point; `basis` (points x 3 x shapes) and `moved`
    (joints x 3 x shapes) are what a coefficient of the shape moves of a point at rest and of its part's offset. The columns of
    `out` are those of `PosedBody.jacobian`: a turn of a joint carries all that hangs on it about the joint, by the cross
    product with the weighted arm.
    """
    first = 3 * len(parents) + 3
    shapes = basis.shape[2]
    arms, blended = np.empty((len(parents), 3)), np.empty((3, 3))
    for point in range(len(rest)):
        arms[:], blended[:] = 0.0, 0.0
        for influence in range(columns.shape[1]):
            joint, weight = columns[point, influence], weights[point, influence]
            if weight == 0.0:
                continue
            x = weight * (_turned(turns, joint, 0, rest, point) + offsets[joint, 0])
            y = weight * (_turned(turns, joint, 1, rest, point) + offsets[joint, 1])
            z = weight * (_turned(turns, joint, 2, rest, point) + offsets[joint, 2])
            for a in range(3):
                for b in range(3):
                    blended[a, b] += weight * turns[joint, a, b]
            above = joint
            while above >= 0:
                arms[above, 0] += x - weight * joints[above, 0]
                arms[above, 1] += y - weight * joints[above, 1]
                arms[above, 2] += z - weight * joints[above, 2]
                above = parents[above] if above > 0 else -1
        for joint in range(len(parents)):
            x, y, z, at = arms[joint, 0], arms[joint, 1], arms[joint, 2], 3 * joint
            out[point, 0, at], out[point, 0, at + 1], out[point, 0, at + 2] = 0.0, z, -y
            out[point, 1, at], out[point, 1, at + 1], out[point, 1, at + 2] = -z, 0.0, x
            out[point, 2, at], out[point, 2, at + 1], out[point, 2, at + 2] = y, -x, 0.0
        for a in range(3):
            for b in range(3):
                out[point, a, first - 3 + b] = 1.0 if a == b else 0.0
            for shape in range(shapes):
                out[point, a, first + shape] = (
                    blended[a, 0] * basis[point, 0, shape]
                    + blended[a, 1] * basis[point, 1, shape]
                    + blended[a, 2] * basis[point, 2, shape]
                )
        for influence in range(columns.shape[1]):
            joint, weight = columns[point, influence], weights[point, influence]
            if weight != 0.0:
                for a in range(3):
                    for shape in range(shapes):
                        out[point, a, first + shape] += weight * moved[joint, a, shape]


@njit(**OPTIONS)
def _turned(turns, joint, axis, rest, point):
    return (
        turns[joint, axis, 0] * rest[point, 0]
        + turns[joint, axis, 1] * rest[point, 1]
        + turns[joint, axis, 2] * rest[point, 2]
    )


@njit(**OPTIONS)
def rooted(roots, jacobian, out):
    """Write L^T J of every point into `out` (like `jacobian`, points x 3 x parameters); `roots` are lower triangles L."""
    for point in range(len(jacobian)):
        l00, l10, l20 = roots[point, 0, 0], roots[point, 1, 0], roots[point, 2, 0]
        l11, l21, l22 = roots[point, 1, 1], roots[point, 2, 1], roots[point, 2, 2]
        for parameter in range(jacobian.shape[2]):
            x, y, z = jacobian[point, 0, parameter], jacobian[point, 1, parameter], jacobian[point, 2, parameter]
            out[point, 0, parameter] = l00 * x + l10 * y + l20 * z
            out[point, 1, parameter] = l11 * y + l21 * z
            out[point, 2, parameter] = l22 * z


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `contact.collide.compile_kernels` does."""
    one, turns, jacobian = np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 3, 7))
    parents, columns, basis = np.array([-1]), np.zeros((1, 1), dtype=np.int64), np.zeros((1, 3, 1))
    fill_jacobian(parents, columns, np.ones((1, 1)), one, basis, turns, one, one, basis, jacobian)
    rooted(turns, jacobian, jacobian)
