"""Compiled loops: normal equations of point pairs on a skinned body, for solvers. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS

STILL = 0.003
"""Metres: a joint that moves both points of a pair nearly alike has so short a lever, and is left out of that pair."""


@njit(**OPTIONS)
def _carried(vertices, shares, row, joints, weights, carried):
    """Set `carried` (joints) to how much of a point each joint carries; the point lies between `vertices[row]`."""
    carried[:] = 0.0
    for corner in range(vertices.shape[1]):
        share = shares[row, corner]
        if share == 0.0:
            continue
        vertex = vertices[row, corner]
        for place in range(joints.shape[1]):
            joint = joints[vertex, place]
            if joint < 0:
                break
            carried[joint] += share * weights[vertex, place]


@njit(**OPTIONS)
def add_pairs(
    first, first_shares, first_points, second, second_shares, second_points,
    normals, wanted, along, across, joints, weights, places, matrix, right,
):  # fmt: skip
    """Add the normal equations of point pairs to the lower triangle of `matrix` and to `right` (3 x joints, or more).

    Pair n joins the points first_points[n] and second_points[n], which lie between the vertices first[n] and second[n]
    with shares; the difference first - second should change by wanted[n]. Its part along normals[n] weighs along[n], the
    rest across[n]. `places` are the joints' own. Unknowns are turns about the world's axes, three a joint.
    """
    count = len(places)
    here, there = np.empty(count), np.empty(count)
    used = np.empty(count, dtype=np.int32)
    lever = np.empty((count, 3))
    axes, rows = np.empty((3, 3)), np.empty((3, 3 * count))
    for pair in range(len(first)):
        if along[pair] == 0.0 and across[pair] == 0.0:
            continue
        _carried(first, first_shares, pair, joints, weights, here)
        _carried(second, second_shares, pair, joints, weights, there)
        px, py, pz = first_points[pair, 0], first_points[pair, 1], first_points[pair, 2]
        qx, qy, qz = second_points[pair, 0], second_points[pair, 1], second_points[pair, 2]
        number = 0
        for joint in range(count):
            a, b = here[joint], there[joint]
            if a == 0.0 and b == 0.0:
                continue
            x, y, z = places[joint, 0], places[joint, 1], places[joint, 2]
            lx, ly, lz = a * (px - x) - b * (qx - x), a * (py - y) - b * (qy - y), a * (pz - z) - b * (qz - z)
            if abs(lx) + abs(ly) + abs(lz) > STILL:
                used[number] = joint
                lever[number, 0], lever[number, 1], lever[number, 2] = lx, ly, lz
                number += 1
        directions = _axes(normals, pair, across[pair] > 0.0, axes)
        for axis in range(directions):
            ax, ay, az = axes[axis, 0], axes[axis, 1], axes[axis, 2]
            for place in range(number):
                lx, ly, lz = lever[place, 0], lever[place, 1], lever[place, 2]
                rows[axis, 3 * place] = ly * az - lz * ay
                rows[axis, 3 * place + 1] = lz * ax - lx * az
                rows[axis, 3 * place + 2] = lx * ay - ly * ax
        for axis in range(directions):
            weight = along[pair] if axis == 0 else across[pair]
            residual = 0.0
            for i in range(3):
                residual += wanted[pair, i] * axes[axis, i]
            for place in range(number):
                row = 3 * used[place]
                for i in range(3):
                    value = weight * rows[axis, 3 * place + i]
                    right[row + i] += value * residual
                    for other in range(place + 1):
                        column = 3 * used[other]
                        matrix[row + i, column] += value * rows[axis, 3 * other]
                        matrix[row + i, column + 1] += value * rows[axis, 3 * other + 1]
                        matrix[row + i, column + 2] += value * rows[axis, 3 * other + 2]


@njit(**OPTIONS)
def _axes(normals, pair, all_three, axes):
    """Write the normal, and two directions across it, into `axes`; returns how many."""
    nx, ny, nz = normals[pair, 0], normals[pair, 1], normals[pair, 2]
    axes[0, 0], axes[0, 1], axes[0, 2] = nx, ny, nz
    if not all_three:
        return 1
    if abs(nx) < 0.9:
        tx, ty, tz = 0.0, nz, -ny
    else:
        tx, ty, tz = -nz, 0.0, nx
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    axes[1, 0], axes[1, 1], axes[1, 2] = tx, ty, tz
    axes[2, 0], axes[2, 1], axes[2, 2] = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
    return 3


@njit(**OPTIONS)
def place_pairs(
    vertices, first, first_shares, second, second_shares, faces, gap, slack, farthest, points, touched, normals, wanted
):  # fmt: skip
    """For pairs that should touch: the first point; the place `gap` above the second, along the skin's normal there (of the
    corners `faces[n]`), which goes along with the skin; and how the first should move to be in that place. What is off by
    less than `slack` is left, and by more than `farthest` pulls no more than that: it may be out of reach."""
    for pair in range(len(first)):
        for axis in range(3):
            points[pair, axis] = 0.0
            touched[pair, axis] = 0.0
        for corner in range(first.shape[1]):
            for axis in range(3):
                points[pair, axis] += first_shares[pair, corner] * vertices[first[pair, corner], axis]
        for corner in range(second.shape[1]):
            for axis in range(3):
                touched[pair, axis] += second_shares[pair, corner] * vertices[second[pair, corner], axis]
        i, j, k = faces[pair, 0], faces[pair, 1], faces[pair, 2]
        ax, ay, az = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
        bx, by, bz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = max(np.sqrt(nx * nx + ny * ny + nz * nz), 1e-300)
        normals[pair, 0], normals[pair, 1], normals[pair, 2] = nx / length, ny / length, nz / length
        off = 0.0
        for axis in range(3):
            touched[pair, axis] += gap[pair] * normals[pair, axis]
            wanted[pair, axis] = touched[pair, axis] - points[pair, axis]
            off += wanted[pair, axis] ** 2
        off = max(np.sqrt(off), 1e-12)
        share = max(0.0, 1.0 - slack / off) * min(1.0, farthest / off)
        for axis in range(3):
            wanted[pair, axis] *= share


@njit(**OPTIONS)
def add_points(points, wanted, weights, carried, places, matrix, right):
    """Add the normal equations of points that hang on joints rigidly: point n should move by wanted[n], with weights[n].
    `carried` (points x joints) says which joints carry each. Behind three unknowns a joint, the last three of the system
    are a shift of the whole body."""
    count = len(places)
    size = 3 * count + 3
    rows = np.zeros((3, size))
    for number in range(len(points)):
        weight = weights[number]
        if weight == 0.0:
            continue
        rows[:] = 0.0
        for joint in range(count):
            if not carried[number, joint]:
                continue
            x = points[number, 0] - places[joint, 0]
            y = points[number, 1] - places[joint, 1]
            z = points[number, 2] - places[joint, 2]
            place = 3 * joint
            rows[0, place + 1], rows[0, place + 2] = z, -y  # w x lever, by the axes of the world
            rows[1, place], rows[1, place + 2] = -z, x
            rows[2, place], rows[2, place + 1] = y, -x
        for axis in range(3):
            rows[axis, 3 * count + axis] = 1.0
            for row in range(size):
                value = weight * rows[axis, row]
                if value != 0.0:
                    right[row] += value * wanted[number, axis]
                    for column in range(row + 1):
                        matrix[row, column] += value * rows[axis, column]


@njit(**OPTIONS)
def add_orientations(world, wanted, joints, weights, carried, matrix, right):
    """Add the normal equations of joints whose world rotation (joints x 4) should become `wanted`; `joints` are their
    places in the skeleton, `carried` (of them x turning joints) says which turns turn them."""
    for number in range(len(joints)):
        weight = weights[number]
        if weight == 0.0:
            continue
        a, b = wanted[number], world[joints[number]]  # a b^-1
        w = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        x = -a[3] * b[0] + a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
        y = -a[3] * b[1] + a[0] * b[2] + a[1] * b[3] - a[2] * b[0]
        z = -a[3] * b[2] - a[0] * b[1] + a[1] * b[0] + a[2] * b[3]
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        sine = np.sqrt(x * x + y * y + z * z)
        scale = 2.0 * np.arctan2(sine, w) / sine if sine > 1e-12 else 2.0
        turn = (scale * x, scale * y, scale * z)
        for joint in range(carried.shape[1]):
            if carried[number, joint]:
                for axis in range(3):
                    right[3 * joint + axis] += weight * turn[axis]
                for other in range(joint + 1):
                    if carried[number, other]:
                        for axis in range(3):
                            matrix[3 * joint + axis, 3 * other + axis] += weight


@njit(**OPTIONS)
def mirror_lower(matrix):
    """Copy the lower triangle of a symmetric matrix, given by blocks of three, to the upper one."""
    for row in range(len(matrix)):
        for column in range(row):
            matrix[column, row] = matrix[row, column]


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `collide.compile_kernels` does."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    corners, shares = np.zeros((1, 3), dtype=np.int64), np.ones((1, 3)) / 3
    points, touched, normals, wanted = np.empty((4, 1, 3))
    one = np.ones(1)
    place_pairs(
        vertices, corners, shares, corners, shares, np.arange(3)[None], one, 0.1, 1.0, points, touched, normals, wanted
    )
    matrix = np.zeros((3, 3))
    add_pairs(
        corners, shares, points, corners, shares, touched, normals, wanted, one, one,
        np.zeros((3, 1), dtype=np.int32), np.ones((3, 1)), vertices[:1], matrix, np.zeros(3),
    )  # fmt: skip
    matrix, right, carried = np.zeros((6, 6)), np.zeros(6), np.ones((1, 1), dtype=np.bool_)
    add_points(points, wanted, one, carried, vertices[:1], matrix, right)
    rotations = np.array([[0.0, 0, 0, 1]])
    add_orientations(rotations, rotations, np.zeros(1, dtype=np.int64), one, carried, matrix, right)
    mirror_lower(matrix)
