"""Compiled loops over clouds: thinning them to one point a cell, and the nearest point to each of many places. Import only
where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS

BLOCK = 5
"""Cells along the side of a block of neighbouring points."""
SHIFT = 0.3719
"""Of the cells, in cells: a body's plane of symmetry goes through the middle of the cloud, and must not fall between cells."""
FURTHEST = 1 << 20
"""Cells from the origin beyond which points are put together."""


@njit(**OPTIONS)
def _cell(value, origin, size):
    return np.int64(min(max(np.floor((value - origin) / size + SHIFT), -FURTHEST), FURTHEST - 1))


@njit(**OPTIONS)
def _slot(table, keys, key):
    """Where a key is, or would be, in a table of numbers (-1: empty) into `keys`."""
    mask = len(table) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = np.int64(mixed >> np.uint64(32)) & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + 1) & mask
    return slot


@njit(**OPTIONS)
def _emptied(count):
    size = 64
    while size < 2 * count:
        size *= 2
    return np.full(size, -1, dtype=np.int32)


@njit(**OPTIONS)
def thin(points, origin, size, places, firsts, boxes):
    """One point, the mean, for every cell (cubes of `size`, counted from `origin`) that holds any of `points` (n x 3).

    Written into `places` (room for n x 3, float32), relative to `origin`, in blocks of `BLOCK` cells a side: block b has
    the places from `firsts[b]` to `firsts[b + 1]`, inside the box `boxes[:, b]` (least x y z, greatest x y z). Returns how many
    places and how many blocks there are. Sums are double precision, so the order of the points shows in the last digit only.
    """
    count = len(points)
    table = _emptied(count)
    keys = np.empty(count, dtype=np.int64)
    sums = np.zeros((count, 4))
    block_keys = np.empty(count, dtype=np.int64)
    found = 0
    for i in range(count):
        a = _cell(points[i, 0], origin[0], size) + FURTHEST
        b = _cell(points[i, 1], origin[1], size) + FURTHEST
        c = _cell(points[i, 2], origin[2], size) + FURTHEST
        key = (a << 42) | (b << 21) | c
        slot = _slot(table, keys, key)
        if table[slot] < 0:
            table[slot] = found
            keys[found] = key
            block_keys[found] = ((a // BLOCK) << 42) | ((b // BLOCK) << 21) | (c // BLOCK)
            found += 1
        cell = table[slot]
        for axis in range(3):
            sums[cell, axis] += points[i, axis]
        sums[cell, 3] += 1.0
    return found, _into_blocks(sums, block_keys, found, origin, places, firsts, boxes)


@njit(**OPTIONS)
def _into_blocks(sums, block_keys, found, origin, places, firsts, boxes):
    table = _emptied(found)
    keys = np.empty(found, dtype=np.int64)
    block_of = np.empty(found, dtype=np.int32)
    sizes = np.zeros(found + 1, dtype=np.int32)
    blocks = 0
    for cell in range(found):
        slot = _slot(table, keys, block_keys[cell])
        if table[slot] < 0:
            table[slot] = blocks
            keys[blocks] = block_keys[cell]
            blocks += 1
        block_of[cell] = table[slot]
        sizes[table[slot]] += 1
    firsts[0] = 0
    for block in range(blocks):
        firsts[block + 1] = firsts[block] + sizes[block]
        sizes[block] = firsts[block]
        for axis in range(3):
            boxes[axis, block] = np.inf
            boxes[axis + 3, block] = -np.inf
    for cell in range(found):
        block = block_of[cell]
        to = sizes[block]
        sizes[block] += 1
        for axis in range(3):
            value = np.float32(sums[cell, axis] / sums[cell, 3] - origin[axis])
            places[to, axis] = value
            boxes[axis, block] = min(boxes[axis, block], value)
            boxes[axis + 3, block] = max(boxes[axis + 3, block], value)
    return blocks


@njit(**OPTIONS)
def centre(places, count, boxes, blocks):
    """Move the first `count` places, and the boxes, to the middle: the mean of the places that are not much farther (twice the
    root of the mean square) from the mean of all than most are. Returns the middle, where it was."""
    mean, middle = np.zeros(3), np.zeros(3)
    for i in range(count):
        for axis in range(3):
            mean[axis] += places[i, axis]
    mean /= max(count, 1)
    spread = 0.0
    for i in range(count):
        for axis in range(3):
            spread += (places[i, axis] - mean[axis]) ** 2
    spread /= max(count, 1)
    near = 0
    for i in range(count):
        away = 0.0
        for axis in range(3):
            away += (places[i, axis] - mean[axis]) ** 2
        if away <= 4.0 * spread:
            near += 1
            for axis in range(3):
                middle[axis] += places[i, axis]
    middle /= max(near, 1)
    for i in range(count):
        for axis in range(3):
            places[i, axis] -= middle[axis]
    for axis in range(3):
        for block in range(blocks):
            boxes[axis, block] -= middle[axis]
            boxes[axis + 3, block] -= middle[axis]
    return middle


@njit(fastmath=True, **OPTIONS)
def nearest(queries, places, firsts, boxes, blocks, found):
    """Number of the nearest of `places` to every one of `queries` (n x 3), into `found` (n). Blocks as `thin` makes them.

    Exact. Neighbouring queries should follow each other: the last answer is the first guess of the next.
    """
    away = np.empty(blocks, dtype=np.float32)
    zero, last = np.float32(0.0), 0
    for number in range(len(queries)):
        x, y, z = queries[number, 0], queries[number, 1], queries[number, 2]
        dx, dy, dz = places[last, 0] - x, places[last, 1] - y, places[last, 2] - z
        best = dx * dx + dy * dy + dz * dz
        for block in range(blocks):
            a = max(max(boxes[0, block] - x, x - boxes[3, block]), zero)
            b = max(max(boxes[1, block] - y, y - boxes[4, block]), zero)
            c = max(max(boxes[2, block] - z, z - boxes[5, block]), zero)
            away[block] = a * a + b * b + c * c
        for block in range(blocks):
            if away[block] < best:
                for i in range(firsts[block], firsts[block + 1]):
                    dx, dy, dz = places[i, 0] - x, places[i, 1] - y, places[i, 2] - z
                    distance = dx * dx + dy * dy + dz * dz
                    if distance < best:
                        best = distance
                        last = i
        found[number] = last


@njit(**OPTIONS)
def nearest_of_each(queries, places, firsts, boxes, blocks, vectors):
    """For many clouds (first axis of everything): from each query to its nearest place, into `vectors` (clouds x n x 3)."""
    found = np.empty(queries.shape[1], dtype=np.int64)
    for cloud in range(len(queries)):
        nearest(queries[cloud], places[cloud], firsts[cloud], boxes[cloud], blocks[cloud], found)
        for number in range(len(found)):
            for axis in range(3):
                vectors[cloud, number, axis] = places[cloud, found[number], axis] - queries[cloud, number, axis]


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `collide.compile_kernels` does."""
    points = np.zeros((2, 3))
    places, firsts, boxes = np.empty((2, 3), np.float32), np.empty(3, np.int32), np.empty((6, 2), np.float32)
    count, blocks = thin(points, np.zeros(3), 0.025, places, firsts, boxes)
    centre(places, count, boxes, blocks)
    queries, vectors = np.zeros((1, 1, 3), np.float32), np.empty((1, 1, 3), np.float32)
    blocks = np.array([blocks], dtype=np.int64)
    nearest_of_each(queries, places[None], firsts[None], boxes[None], blocks, vectors)
