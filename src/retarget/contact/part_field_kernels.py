"""Compiled loops: what is near what on two bodies, part by part, for networks. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS
from retarget.contact.part_field import FIGURES

TOUCHING, NEAR = 0.04, 0.15
"""Shares of the height from which on the closeness of two parts of the source counts as nothing: narrow and wide."""
WITHIN = 0.02
"""Likewise: pairs of sensors that are farther apart than the closest by this much say nothing."""
MARGIN, SEEN = 0.012, 0.1
"""Likewise: how far apart surfaces should stay, and how far a sensor looks for the surface that it may be inside of."""
LIFTED = 0.018
"""Likewise: how far what is inside of another part on the source is asked to come out on the target, at most: as far as surfaces that
have touched may part and still do (`contact/detect.py`)."""
BENEATH = (0.75, 0.9)
"""How deep a sensor is over how far the nearest of another part is, from which on it may be inside of that, and is: beyond the rim of a
patch it is below the patch's plane and yet outside."""


@njit(**OPTIONS)
def _closest(places, own, others):
    """The smallest square of a distance between two runs of sensors of one frame."""
    best = np.float32(1e9)
    for i in range(own[0], own[1]):
        x, y, z = places[i, 0], places[i, 1], places[i, 2]
        for j in range(others[0], others[1]):
            a, b, c = x - places[j, 0], y - places[j, 1], z - places[j, 2]
            square = a * a + b * b + c * c
            if square < best:
                best = square
    return best


@njit(**OPTIONS)
def _gap(places, frames, i, others, height, outward, normal):
    """How far a sensor is outside the surface of a run of others, and how far from the nearest: what those about as near say, averaged.
    `normal` becomes theirs, averaged, by the tangent frames `outward`. Nothing within reach: as far as one looks, and farther."""
    best = 1e9
    for j in range(others[0], others[1]):
        square = 0.0
        for k in range(3):
            square += (places[i, k] - places[j, k]) ** 2
        best = min(best, square)
    shortest, span = np.sqrt(best), WITHIN * height
    normal[:] = 0.0
    if shortest >= SEEN * height:
        return shortest, shortest
    total, gap = 0.0, 0.0
    for j in range(others[0], others[1]):
        square = 0.0
        for k in range(3):
            square += (places[i, k] - places[j, k]) ** 2
        if square >= (shortest + span) ** 2:
            continue
        weight = (1.0 - (np.sqrt(square) - shortest) / span) ** 2
        total += weight
        for k in range(3):
            gap += weight * frames[j, k, 2] * (places[i, k] - places[j, k])
            normal[k] += weight * outward[j, k, 2]
    for k in range(3):
        normal[k] /= total
    return gap / total, shortest


@njit(**OPTIONS)
def _lifted(source, source_frames, target_frames, own, others, height, out):
    """Which way, on the target, the first part comes out of the second, which it is inside of on the source; as long as it should
    come out, in metres of the source."""
    deepest = 0.0
    normal = np.empty(3)
    out[:] = 0.0
    for i in range(own[0], own[1]):
        gap, shortest = _gap(source, source_frames, i, others, height, target_frames, normal)
        beneath = (-gap / max(shortest, 1e-9) - BENEATH[0]) / (BENEATH[1] - BENEATH[0])
        depth = max(0.0, -gap) * min(max(beneath, 0.0), 1.0)
        deepest = max(deepest, depth)
        for k in range(3):
            out[k] += depth * normal[k]
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for k in range(3):
        out[k] *= min(deepest, LIFTED * height) / max(length, 1e-12)


@njit(**OPTIONS)
def _asked(source, source_frames, target, target_frames, own, others, shortest, sizes, root, joint, out):
    """What the source's closest pairs ask of the target: where the first part should go against the second, and a little out of it
    where it is inside."""
    source_height, target_height = sizes
    limit = shortest + WITHIN * source_height
    ratio, total = target_height / source_height, 0.0
    move, lever, place = np.zeros(3), np.zeros(3), np.zeros(3)
    local, lift = np.empty(3), np.empty(3)
    for i in range(own[0], own[1]):
        for j in range(others[0], others[1]):
            square = 0.0
            for k in range(3):
                square += (source[i, k] - source[j, k]) ** 2
            if square >= limit * limit:
                continue
            weight = (1.0 - (np.sqrt(square) - shortest) / (WITHIN * source_height)) ** 2
            for k in range(3):
                local[k] = 0.0
                for n in range(3):
                    local[k] += source_frames[j, n, k] * (source[i, n] - source[j, n])
            total += weight
            for k in range(3):
                wanted = 0.0
                for n in range(3):
                    wanted += target_frames[j, k, n] * local[n]
                move[k] += weight * (ratio * wanted - (target[i, k] - target[j, k]))
                lever[k] += weight * (target[i, k] - joint[k])
                place[k] += weight * target[j, k]
    if shortest < TOUCHING * source_height:
        _lifted(source, source_frames, target_frames, own, others, source_height, lift)
        for k in range(3):
            move[k] += total * ratio * lift[k]
    scale = 1.0 / (max(total, 1e-9) * target_height)
    touching = max(0.0, 1.0 - shortest / (TOUCHING * source_height)) ** 2
    near = max(0.0, 1.0 - shortest / (NEAR * source_height)) ** 2
    out[0], out[1] = touching, near
    for k in range(3):
        a, b, c = 0.0, 0.0, 0.0
        for n in range(3):  # in the axes of the target's hips
            a += root[n, k] * move[n]
            b += root[n, k] * lever[n]
            c += root[n, k] * (place[n] - total * root[n, 3])
        out[2 + k] = touching * scale * a
        out[5 + k] = near * scale * a
        out[8 + k] = near * scale * b
        out[11 + k] = near * scale * c


@njit(**OPTIONS)
def _sunk(target, target_frames, own, others, height, root, out):
    """How the first part has sunk into the second on the target: how deep, which way is out, and where."""
    depth, deepest = 0.0, 0.0
    away, place = np.zeros(3), np.zeros(3)
    normal = np.empty(3)
    for i in range(own[0], own[1]):
        gap, shortest = _gap(target, target_frames, i, others, height, target_frames, normal)
        fading = min(1.0, 4.0 * max(0.0, 1.0 - shortest / (SEEN * height)))
        missing = fading * max(0.0, MARGIN - gap / height)
        depth += missing
        deepest = max(deepest, missing)
        for k in range(3):
            away[k] += missing * normal[k]
            place[k] += missing * (target[i, k] - root[k, 3]) / height
    out[14], out[15] = depth, deepest
    for k in range(3):
        for n in range(3):
            out[16 + k] += root[n, k] * away[n]
            out[19 + k] += root[n, k] * place[n]


@njit(**OPTIONS)
def part_figures(source, source_frames, target, target_frames, starts, pairs, heights, roots, joints, out):
    """Fill `out` (frames x pairs x FIGURES, zeros) for posed sensors of both bodies, in runs by bone.

    `source`, `target` (frames x sensors x 3, metres) and their tangent frames (frames x sensors x 3 x 3, world from tangent);
    `starts` (bones + 1) where the run of each bone begins; `pairs` (pairs x 2) bones; `heights` of source and target, metres;
    `roots` (frames x 3 x 4) axes and place of the target's hips; `joints` (frames x bones x 3) where the target's bones begin.
    """
    sizes = (heights[0], heights[1])
    for f in range(len(target)):
        for p in range(len(pairs)):
            a, b = pairs[p, 0], pairs[p, 1]
            own, others = (starts[a], starts[a + 1]), (starts[b], starts[b + 1])
            if own[0] == own[1] or others[0] == others[1]:
                continue
            shortest = np.sqrt(_closest(source[f], own, others))
            if shortest < NEAR * heights[0]:
                _asked(
                    source[f], source_frames[f], target[f], target_frames[f], own, others, shortest, sizes, roots[f],
                    joints[f, a], out[f, p],
                )  # fmt: skip
            if np.sqrt(_closest(target[f], own, others)) < SEEN * heights[1]:
                _sunk(target[f], target_frames[f], own, others, heights[1], roots[f], out[f, p])


def compile_kernels() -> None:
    """Compile what is called from Python, or load it from the cache."""
    places, frames = np.zeros((1, 2, 3), np.float32), np.zeros((1, 2, 3, 3), np.float32)
    part_figures(
        places, frames, places, frames, np.array([0, 1, 2]), np.array([[0, 1]]), np.ones(2), np.zeros((1, 3, 4)),
        np.zeros((1, 2, 3)), np.zeros((1, 1, FIGURES), np.float32),
    )  # fmt: skip
