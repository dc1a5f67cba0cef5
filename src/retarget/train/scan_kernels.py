"""Compiled loops: clouds as scanners see them, of posed, dressed bodies. Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

from retarget.contact.kernels import OPTIONS
from retarget.methods.scan.cloud_kernels import centre, thin

SEEN_CELL = 0.03
"""Metres between the sight lines of a virtual camera: as far apart as the samples of a body lie."""
BEHIND = 0.04
"""Metres that a point may lie behind the foremost of its sight line and still be seen."""
MANY = 30_000
"""Room for the points of a cloud, before it is thinned."""


HANGING = (False, True, False, False, True, True, False, False)
"""By the numbers of `data.GARMENTS`: of whose samples skirts and coats are made."""


@njit(fastmath=True, **OPTIONS)
def _hung(reach, span, x, y, z):
    """How far (metres) what hangs around the body stands from its axis at the height and in the direction of a sample, and the
    direction (x, z). `reach` (levels x around) and `span` are one body's of `data._skirts`."""
    dx, dz = x - span[0], z - span[1]
    away = max(np.sqrt(dx * dx + dz * dz), np.float32(1e-6))
    levels, around = reach.shape
    level = min(max((span[2] - y) / (span[2] - span[3]), np.float32(0.0)), np.float32(1.0)) * (levels - 1)
    place = (np.arctan2(dx, dz) / (2.0 * np.pi) + 0.5) * around
    low, left = min(int(level), levels - 2), int(place)
    down, right = level - low, place - left
    left, beside = left % around, (left + 1) % around
    above = reach[low, left] + right * (reach[low, beside] - reach[low, left])
    below = reach[low + 1, left] + right * (reach[low + 1, beside] - reach[low + 1, left])
    return above + down * (below - above), dx / away, dz / away, away


@njit(fastmath=True, **OPTIONS)
def _pose(
    first, count, rest, normals, columns, weights, garments, transforms, loose, wave, reach, span, turned, places, facings
):
    """Linear blend skinning of so many samples from the `first` one on, in the round, moved along their normals before by what
    is worn, and out to the skirt that hides them; `transforms` (joints x 12) by rows. `facings` only where `turned`."""
    blend = np.empty(12, dtype=np.float32)
    for i in range(count):
        s = (first + i) % len(rest)
        x, y, z = rest[s, 0], rest[s, 1], rest[s, 2]
        u, v, w = normals[s, 0], normals[s, 1], normals[s, 2]
        offset = loose[garments[s]]
        if offset > 0.0:
            folds = np.sin(wave[0] * x + wave[3]) * np.sin(wave[1] * y + wave[4]) * np.sin(wave[2] * z + wave[5])
            offset *= np.float32(0.65) + np.float32(0.35) * folds
            x, y, z = x + offset * u, y + offset * v, z + offset * w
        if span[5] < y < span[4] and HANGING[garments[s]]:
            out, u, w, away = _hung(reach, span, x, y, z)
            out, v = max(out, away), np.float32(0.0)
            x, z = span[0] + out * u, span[1] + out * w
        for entry in range(12):
            blend[entry] = 0.0
        for k in range(columns.shape[1]):
            share = weights[s, k]
            if share == 0.0:
                break
            joint = columns[s, k]
            for entry in range(12):
                blend[entry] += share * transforms[joint, entry]
        for row in range(3):
            places[i, row] = blend[4 * row] * x + blend[4 * row + 1] * y + blend[4 * row + 2] * z + blend[4 * row + 3]
            if turned:
                facings[i, row] = blend[4 * row] * u + blend[4 * row + 1] * v + blend[4 * row + 2] * w


@njit(**OPTIONS)
def _see(points, facings, count, cameras, seen):
    """Mark in `seen` what any camera (unit directions towards it, far away) sees: faces it, and lies before what else is on
    its sight line."""
    side = 128
    depth = np.empty((side, side), dtype=np.float32)
    for camera in range(len(cameras)):
        d = cameras[camera]
        ux, uz = d[2], -d[0]
        length = max(np.sqrt(ux * ux + uz * uz), 1e-9)
        ux, uz = ux / length, uz / length
        vx, vy, vz = d[1] * uz, d[2] * ux - d[0] * uz, -d[1] * ux
        depth[:] = -1e9
        for i in range(count):
            if facings[i, 0] * d[0] + facings[i, 1] * d[1] + facings[i, 2] * d[2] <= 0.05:
                continue
            a = int((points[i, 0] * ux + points[i, 2] * uz) / SEEN_CELL + side / 2)
            b = int((points[i, 0] * vx + points[i, 1] * vy + points[i, 2] * vz) / SEEN_CELL + side / 2)
            if 0 <= a < side and 0 <= b < side:
                near = points[i, 0] * d[0] + points[i, 1] * d[1] + points[i, 2] * d[2]
                depth[a, b] = max(depth[a, b], near)
        for i in range(count):
            if seen[i] or facings[i, 0] * d[0] + facings[i, 1] * d[1] + facings[i, 2] * d[2] <= 0.1:
                continue
            a = int((points[i, 0] * ux + points[i, 2] * uz) / SEEN_CELL + side / 2)
            b = int((points[i, 0] * vx + points[i, 1] * vy + points[i, 2] * vz) / SEEN_CELL + side / 2)
            near = points[i, 0] * d[0] + points[i, 1] * d[1] + points[i, 2] * d[2]
            seen[i] = 0 <= a < side and 0 <= b < side and near > depth[a, b] - BEHIND


@njit(**OPTIONS)
def scan(
    seed, rest, normals, columns, weights, garments, transforms, loose, wave, reach, span, cameras, holes, hole, noise, wanted,
    strays, floor, chance, points,
):  # fmt: skip
    """One cloud of a body, into `points`; returns how many there are.

    `rest`, `normals`, `columns`, `weights`: the body's samples at rest, in random order; `garments` what is worn there (the
    index into `loose`, metres), `wave` how it folds, `reach` and `span` what hangs around it. `cameras` (n x 3): directions to cameras, none where all is seen. `holes`
    of radius `hole`, `noise` (standard deviation) in numbers from the table `chance` (normal, 2^n of them), `wanted` points at
    most before `strays` (a share) are added anywhere, and points on the `floor` around the feet (their number).
    """
    np.random.seed(seed)
    total = len(rest)
    every = total if len(cameras) else min(wanted + wanted // 4, total)
    places = np.empty((every, 3), dtype=np.float32)
    facings = np.empty((every, 3), dtype=np.float32)
    _pose(
        np.random.randint(total), every, rest, normals, columns, weights, garments, transforms, loose, wave, reach, span,
        len(cameras) > 0, places, facings,
    )  # fmt: skip
    seen = np.ones(every, dtype=np.bool_)
    if len(cameras):
        seen[:] = False
        _see(places, facings, every, cameras, seen)
    for _ in range(holes):
        middle = np.random.randint(every)
        reach = hole * (0.5 + np.random.random())
        for i in range(every):
            away = (places[i, 0] - places[middle, 0]) ** 2 + (places[i, 1] - places[middle, 1]) ** 2 + (places[i, 2] - places[middle, 2]) ** 2
            if away < reach * reach:
                seen[i] = False
    count, thrown, mask = 0, np.random.randint(len(chance)), len(chance) - 1
    for i in range(every):
        if seen[i] and count < wanted:
            for axis in range(3):
                points[count, axis] = places[i, axis]
                if noise > 0.0:
                    points[count, axis] += noise * chance[thrown & mask]
                    thrown += 1
            count += 1
    low, high = np.full(3, 1e9), np.full(3, -1e9)
    for i in range(every):
        for axis in range(3):
            low[axis] = min(low[axis], places[i, axis])
            high[axis] = max(high[axis], places[i, axis])
    for _ in range(int(strays * count)):
        for axis in range(3):
            points[count, axis] = low[axis] - 0.3 + np.random.random() * (high[axis] - low[axis] + 0.6)
        count += 1
    if floor:
        reach, down = 0.15 + 0.45 * np.random.random(), 0.01 + 0.02 * np.random.random()
        x, z = 0.5 * (low[0] + high[0]), 0.5 * (low[2] + high[2])
        for _ in range(floor):
            around, away = 2.0 * np.pi * np.random.random(), reach * np.sqrt(np.random.random())
            points[count, 0] = x + away * np.cos(around)
            points[count, 1] = low[1] - down + noise * chance[thrown & mask]
            thrown += 1
            points[count, 2] = z + away * np.sin(around)
            count += 1
    return count


@njit(**OPTIONS)
def scan_all(
    seeds, bodies, rests, normals, columns, weights, garments, starts, ends, transforms, loose, waves, reaches, spans, cameras,
    camera_counts, holes, hole, noise, wanted, strays, floor, chance, cell, places, firsts, boxes, blocks,
):  # fmt: skip
    """Clouds of many bodies, thinned to one point a `cell`, laid out for the search about their middles, which are returned."""
    points = np.empty((MANY, 3), dtype=np.float32)
    middles = np.empty((len(seeds), 3))
    origin = np.empty(3)
    for number in range(len(seeds)):
        body, start, end = bodies[number], starts[number], ends[number]
        count = scan(
            seeds[number], rests[body, start:end], normals[body, start:end], columns[body, start:end], weights[body, start:end],
            garments[body, start:end], transforms[number], loose[number], waves[number], reaches[number],
            spans[number], cameras[number, : camera_counts[number]], holes[number], hole[number], noise[number], wanted[number], strays[number], floor[number], chance, points,
        )  # fmt: skip
        origin[:] = 0.0
        for i in range(count):
            for axis in range(3):
                origin[axis] += points[i, axis] / count
        found, blocks[number] = thin(points[:count], origin, cell, places[number], firsts[number], boxes[number])
        middles[number] = origin + centre(places[number], found, boxes[number], blocks[number])
    return middles
