"""Compiled loops: normal equations of point pairs on a skinned body, for solvers. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS

STILL = 0.003
"""Metres: a joint that moves both points of a pair nearly alike has so short a lever, and is left out of that pair."""


@njit(**OPTIONS)
def _add_lever(vertex, share, vertices, joints, weights, places, parents, lever, active):
    """Add, to `lever` (joints x 3), how a share of a skinned vertex moves when joints turn: a turn w of joint j moves it by
    w x lever[j]. A joint carries what hangs on it and on all joints below; within a blend the vertex's own place stands in
    for its places in each joint's frame."""
    x, y, z = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
    for influence in range(joints.shape[1]):
        weight = weights[vertex, influence] * share
        if weight == 0.0:
            continue
        joint = joints[vertex, influence]
        while joint >= 0:
            lever[joint, 0] += weight * (x - places[joint, 0])
            lever[joint, 1] += weight * (y - places[joint, 1])
            lever[joint, 2] += weight * (z - places[joint, 2])
            active[joint] = True
            joint = parents[joint]


@njit(**OPTIONS)
def add_pairs(
    first, second, shares, normals, wanted, along, across,
    vertices, joints, weights, places, parents, matrix, right,
):  # fmt: skip
    """Add the normal equations of point pairs to `matrix` (3 joints x 3 joints) and `right`.

    Pair n joins vertex first[n] to the point of three vertices second[n] with shares[n]; the difference of their places
    should change by wanted[n]. The part along normals[n] weighs along[n], the rest across[n].
    """
    count = len(parents)
    lever = np.zeros((count, 3))
    active = np.zeros(count, dtype=np.bool_)
    used = np.empty(count, dtype=np.int32)
    rows = np.empty((3, count, 3))
    axes = np.empty((3, 3))
    for pair in range(len(first)):
        if along[pair] == 0.0 and across[pair] == 0.0:
            continue
        lever[:], active[:] = 0.0, False
        _add_lever(first[pair], 1.0, vertices, joints, weights, places, parents, lever, active)
        for corner in range(3):
            share = -shares[pair, corner]
            _add_lever(second[pair, corner], share, vertices, joints, weights, places, parents, lever, active)
        number = 0
        for joint in range(count):
            if active[joint] and abs(lever[joint, 0]) + abs(lever[joint, 1]) + abs(lever[joint, 2]) > STILL:
                used[number] = joint
                number += 1
        nx, ny, nz = normals[pair, 0], normals[pair, 1], normals[pair, 2]
        axes[0, 0], axes[0, 1], axes[0, 2] = nx, ny, nz
        directions = 1
        if across[pair] > 0.0:
            directions = 3
            if abs(nx) < 0.9:
                tx, ty, tz = 0.0, nz, -ny
            else:
                tx, ty, tz = -nz, 0.0, nx
            length = np.sqrt(tx * tx + ty * ty + tz * tz)
            tx, ty, tz = tx / length, ty / length, tz / length
            axes[1, 0], axes[1, 1], axes[1, 2] = tx, ty, tz
            axes[2, 0], axes[2, 1], axes[2, 2] = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        for axis in range(directions):
            ax, ay, az = axes[axis, 0], axes[axis, 1], axes[axis, 2]
            weight = along[pair] if axis == 0 else across[pair]
            residual = wanted[pair, 0] * ax + wanted[pair, 1] * ay + wanted[pair, 2] * az
            for place in range(number):
                joint = used[place]
                lx, ly, lz = lever[joint, 0], lever[joint, 1], lever[joint, 2]
                rows[axis, place, 0] = ly * az - lz * ay
                rows[axis, place, 1] = lz * ax - lx * az
                rows[axis, place, 2] = lx * ay - ly * ax
            for place in range(number):
                row = 3 * used[place]
                for i in range(3):
                    value = weight * rows[axis, place, i]
                    right[row + i] += value * residual
                    for other in range(place + 1):
                        column = 3 * used[other]
                        for j in range(3):
                            matrix[row + i, column + j] += value * rows[axis, other, j]


@njit(**OPTIONS)
def mirror_lower(matrix):
    """Copy the lower blocks of a symmetric matrix to the upper ones."""
    for row in range(len(matrix)):
        for column in range(row):
            matrix[column, row] = matrix[row, column]


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `collide.compile_kernels` does."""
    one, none = np.ones(1), np.zeros((1, 3))
    matrix = np.zeros((3, 3))
    add_pairs(
        np.zeros(1, dtype=np.int64), np.zeros((1, 3), dtype=np.int64), none, np.ones((1, 3)), none, one, one,
        none, np.zeros((1, 1), dtype=np.int32), np.ones((1, 1)), none, np.array([-1], dtype=np.int32), matrix, np.zeros(3),
    )  # fmt: skip
    mirror_lower(matrix)
