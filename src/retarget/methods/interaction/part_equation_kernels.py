"""Compiled loops: small linear systems, a frame each. Import only where used."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS


@njit(**OPTIONS)
def _add_row(row, unknowns, count, weight, wanted, matrix, right):
    """Add weight (row · d - wanted)² to a system whose row is nonzero at the first `count` of `unknowns`, which rise."""
    for i in range(count):
        part = weight * row[i]
        right[unknowns[i]] += part * wanted
        for j in range(i + 1):
            matrix[unknowns[i], unknowns[j]] += part * row[j]


@njit(**OPTIONS)
def _solved(matrix, right, out):
    """Solve a positive definite system by Cholesky's method, from its lower triangle; overwrites both. False where it cannot."""
    size = len(right)
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = rest / matrix[j, j]
            elif rest > 0.0:
                matrix[i, i] = math.sqrt(rest)
            else:
                return False  # also where it is no number
    for i in range(size):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
        if not math.isfinite(right[i]):
            return False
    out[:] = right
    return True


@njit(**OPTIONS)
def _carriers(first, second, joints):
    """The joints that carry either part; returns how many."""
    count = 0
    for u in range(len(first)):
        if first[u] > 0.0 or second[u] > 0.0:
            joints[count] = u
            count += 1
    return count


@njit(**OPTIONS)
def solve_parts(figures, places, axes, turned, said, stiffness, first, second, levers, hands, held, out):
    """Fill `out` (frames x unknowns) with the step of every frame; zeros where its system cannot be solved.

    `figures` (frames x pairs x FIGURES) of pairs of parts; `places` (frames x joints x 3) and `axes` (frames x joints x 3 x 3: from a
    change of a joint's turn to a turn in the hips' axes); `turned` (frames x unknowns) as corrected so far; `said` (frames x pairs
    x 9): weights of touching, near and sunk in, factors of what is asked and of the depth, what is asked besides (3) and depth besides;
    `stiffness` (frames x unknowns); `first`, `second` (pairs x joints) 1 where a joint carries a part, else 0; `levers` (pairs) joints;
    `hands` (frames x numbers) as `hand_equations` leaves it, and `held` (frames) what that weighs.
    """
    joints_count = places.shape[1]
    size = 3 * joints_count
    matrix, right = np.empty((size, size)), np.empty(size)
    joints, unknowns = np.empty(joints_count, np.int64), np.empty(size, np.int64)
    rows, row = np.empty((3, size)), np.empty(size)
    own, other, lever, asked, normal, cross = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(len(figures)):
        matrix[:] = 0.0
        for i in range(size):
            matrix[i, i] = stiffness[f, i]
            right[i] = -stiffness[f, i] * turned[f, i] + held[f] * hands[f, size * (size + 1) // 2 + i]
            for j in range(i + 1):
                matrix[i, j] += held[f] * hands[f, i * (i + 1) // 2 + j]
        for p in range(figures.shape[1]):
            figure, say = figures[f, p], said[f, p]
            near, depth = figure[1], figure[14]
            if near <= 0.0 and depth <= 0.0:
                continue
            count = _carriers(first[p], second[p], joints)
            for n in range(count):
                for k in range(3):
                    unknowns[3 * n + k] = 3 * joints[n] + k
            if near > 0.0:
                weight, scale = figure[0] * say[0] + near * say[1], 1.0 / near
                for k in range(3):
                    own[k] = places[f, levers[p], k] + scale * figure[8 + k]
                    other[k] = scale * figure[11 + k]
                    asked[k] = say[3] * scale * figure[5 + k] + say[5 + k]
                for n in range(count):
                    u = joints[n]
                    for k in range(3):
                        lever[k] = first[p, u] * (own[k] - places[f, u, k]) - second[p, u] * (other[k] - places[f, u, k])
                    for k in range(3):
                        a, b = axes[f, u, :, k], 3 * n + k  # the turn that the unknown stands for, crossed with the lever
                        rows[0, b] = a[1] * lever[2] - a[2] * lever[1]
                        rows[1, b] = a[2] * lever[0] - a[0] * lever[2]
                        rows[2, b] = a[0] * lever[1] - a[1] * lever[0]
                for k in range(3):
                    _add_row(rows[k], unknowns, 3 * count, weight, asked[k], matrix, right)
            if depth > 0.0:
                length = math.sqrt(figure[16] ** 2 + figure[17] ** 2 + figure[18] ** 2)
                if length <= 0.0:
                    continue
                for k in range(3):
                    normal[k] = figure[16 + k] / length
                for n in range(count):
                    u = joints[n]
                    sign = first[p, u] - second[p, u]
                    for k in range(3):
                        lever[k] = sign * (figure[19 + k] / depth - places[f, u, k])
                    cross[0] = lever[1] * normal[2] - lever[2] * normal[1]
                    cross[1] = lever[2] * normal[0] - lever[0] * normal[2]
                    cross[2] = lever[0] * normal[1] - lever[1] * normal[0]
                    for k in range(3):
                        row[3 * n + k] = cross[0] * axes[f, u, 0, k] + cross[1] * axes[f, u, 1, k] + cross[2] * axes[f, u, 2, k]
                _add_row(row, unknowns, 3 * count, say[2], say[4] * figure[15] + say[8], matrix, right)
        _solved(matrix, right, out[f])


@njit(**OPTIONS)
def hand_equations(
    source, target, first, second, bones, carries, source_height, radii, most, roots, places, axes, out
):
    """Fill `out` (frames x numbers, zeros) with matrices (lower triangles, row by row) and right sides of distances of hands.

    `source`, `target` (frames x sensors x 3, metres); `first`, `second` (pairs) sensors; `bones` (sensors) and `carries` (bones x joints, 1
    where a joint carries a bone); `radii` of both arms; `most`, the sum of closenesses that counts as one; `roots` (frames x 3 x 4) from
    the world to the hips' axes; `places` (frames x joints x 3) and `axes` (frames x joints x 3 x 3) of turns.
    """
    count = places.shape[1]
    size = 3 * count
    triangle = size * (size + 1) // 2
    own, other, way, lever = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    row, unknowns = np.empty(size), np.empty(size, np.int64)
    reach, ratio = 2.0 * radii[0] * source_height, radii[1] / radii[0] / source_height
    for f in range(len(source)):
        total = 0.0
        for p in range(len(first)):
            i, j = first[p], second[p]
            square = 0.0
            for k in range(3):
                square += (source[f, i, k] - source[f, j, k]) ** 2
            if square >= reach * reach:
                continue
            distance = math.sqrt(square)
            weight = (1.0 - distance / reach) ** 2
            total += weight
            length = 0.0
            for k in range(3):
                own[k] = other[k] = roots[f, k, 3]
                for n in range(3):
                    own[k] += roots[f, k, n] * target[f, i, n]
                    other[k] += roots[f, k, n] * target[f, j, n]
                way[k] = own[k] - other[k]
                length += way[k] ** 2
            length = math.sqrt(length)
            for k in range(3):
                way[k] /= max(length, 1e-9)
            used = 0
            for u in range(count):
                a, b = carries[bones[i], u], carries[bones[j], u]
                if a == 0.0 and b == 0.0:
                    continue
                for k in range(3):
                    lever[k] = a * (own[k] - places[f, u, k]) - b * (other[k] - places[f, u, k])
                x = lever[1] * way[2] - lever[2] * way[1]
                y = lever[2] * way[0] - lever[0] * way[2]
                z = lever[0] * way[1] - lever[1] * way[0]
                for k in range(3):
                    row[used] = x * axes[f, u, 0, k] + y * axes[f, u, 1, k] + z * axes[f, u, 2, k]
                    unknowns[used] = 3 * u + k
                    used += 1
            wanted = ratio * distance - length
            for a in range(used):
                part, at = weight * row[a], unknowns[a] * (unknowns[a] + 1) // 2
                out[f, triangle + unknowns[a]] += part * wanted
                for b in range(a + 1):
                    out[f, at + unknowns[b]] += part * row[b]
        scale = 1.0 / max(total, most)
        for n in range(out.shape[1]):
            out[f, n] *= scale


def compile_kernels() -> None:
    """Compile what is called from Python, or load it from the cache."""
    first = np.ones((1, 1))
    solve_parts(
        np.zeros((1, 1, 22)), np.zeros((1, 1, 3)), np.zeros((1, 1, 3, 3)), np.zeros((1, 3)), np.zeros((1, 1, 9)), np.ones((1, 3)),
        first, first, np.zeros(1, dtype=np.int64), np.zeros((1, 9)), np.ones(1), np.zeros((1, 3)),
    )  # fmt: skip
    sensors, none = np.zeros((1, 1, 3), np.float32), np.zeros(1, dtype=np.int64)
    hand_equations(
        sensors, sensors, none, none, none, first, 1.0, np.ones(2), 1.0, np.zeros((1, 3, 4)), np.zeros((1, 1, 3)),
        np.zeros((1, 1, 3, 3)), np.zeros((1, 9)),
    )  # fmt: skip
