"""Compiled loops of the scan tracker: thin a cloud, pose the body, find what is near, derivatives of points along their
normals. Import only where used.

Points are binned into cubic cells in the order of a counting sort: `starts` (cells + 1) are the first places in `order` of each
cell, `low` the corner of the first cell, `dims` how many there are along each axis.
"""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}

LOOSE = 0.6
"""Share of the reach at which what lies outside the skin, as clothes and hair do, counts for half of what lies inside."""


@njit(**OPTIONS)
def voxel_means(points, low, cell, dims, out):
    """Write the mean of the points in each cubic cell into `out`, cell by cell; returns how many cells hold any."""
    sums = np.zeros((dims[0] * dims[1] * dims[2], 4))
    for p in range(len(points)):
        at = 0
        for axis in range(3):
            place = min(max(int((points[p, axis] - low[axis]) / cell), 0), dims[axis] - 1)
            at = at * dims[axis] + place
        for axis in range(3):
            sums[at, axis] += points[p, axis]
        sums[at, 3] += 1.0
    count = 0
    for at in range(len(sums)):
        if sums[at, 3] > 0.0:
            for axis in range(3):
                out[count, axis] = sums[at, axis] / sums[at, 3]
            count += 1
    return count


@njit(**OPTIONS)
def extent(points, low, high):
    """Write the corners of the box around points."""
    low[:], high[:] = np.inf, -np.inf
    for p in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[p, axis])
            high[axis] = max(high[axis], points[p, axis])


@njit(**OPTIONS)
def fill_bins(points, low, cell, dims, starts, order):
    """Bin points; those outside go to the nearest cell of the rim."""
    starts[:] = 0
    cells = np.empty(len(points), dtype=np.int32)
    for p in range(len(points)):
        at = 0
        for axis in range(3):
            place = min(max(int((points[p, axis] - low[axis]) / cell), 0), dims[axis] - 1)
            at = at * dims[axis] + place
        cells[p] = at
        starts[at + 1] += 1
    for at in range(len(starts) - 1):
        starts[at + 1] += starts[at]
    room = starts[:-1].copy()
    for p in range(len(points)):
        order[room[cells[p]]] = p
        room[cells[p]] += 1


@njit(**OPTIONS)
def nearest(queries, points, low, cell, dims, starts, order, rings, found, squares):
    """For every query the nearest binned point within `rings` cells around its own, and the squared distance; -1 where there is
    none. `points` lie cell by cell, `order` are their numbers. Rings are looked at from the inside out, until no farther one can
    hold a nearer point; of equally near ones the first number is taken."""
    middle, inside = np.empty(3, dtype=np.int64), np.empty(3)
    for q in range(len(queries)):
        best, at = np.inf, -1
        wall = cell
        for axis in range(3):
            place = (queries[q, axis] - low[axis]) / cell
            middle[axis] = int(np.floor(place))
            inside[axis] = cell * (place - middle[axis])
            wall = min(wall, inside[axis], cell - inside[axis])
        for ring in range(rings + 1):
            reached = (ring - 1) * cell + wall  # a point in this ring is no nearer than this
            if ring > 0 and best <= reached * reached:
                break
            first, last = max(middle[2] - ring, 0), min(middle[2] + ring, dims[2] - 1)
            for i in range(max(middle[0] - ring, 0), min(middle[0] + ring, dims[0] - 1) + 1):
                aside = _beyond(i - middle[0], inside[0], cell)
                for j in range(max(middle[1] - ring, 0), min(middle[1] + ring, dims[1] - 1) + 1):
                    over = _beyond(j - middle[1], inside[1], cell)
                    if aside * aside + over * over > best:
                        continue
                    row = (i * dims[1] + j) * dims[2]
                    if ring == 0 or abs(i - middle[0]) == ring or abs(j - middle[1]) == ring:
                        if first <= last:
                            begin, end = starts[row + first], starts[row + last + 1]
                            best, at = _nearest_of(queries, q, points, order, begin, end, best, at)
                        continue
                    for k in (middle[2] - ring, middle[2] + ring):
                        if 0 <= k < dims[2]:
                            begin, end = starts[row + k], starts[row + k + 1]
                            best, at = _nearest_of(queries, q, points, order, begin, end, best, at)
        found[q], squares[q] = at, best


@njit(**OPTIONS)
def _beyond(cells, inside, cell):
    """How far a cell so many cells away begins, from a place that lies so far inside its own."""
    if cells > 0:
        return cells * cell - inside
    return inside - (cells + 1) * cell if cells < 0 else 0.0


@njit(**OPTIONS)
def _nearest_of(queries, q, points, order, begin, end, best, at):
    for place in range(begin, end):
        a, b, c = points[place, 0] - queries[q, 0], points[place, 1] - queries[q, 1], points[place, 2] - queries[q, 2]
        square = a * a + b * b + c * c
        if square < best or (square == best and order[place] < at):
            best, at = square, order[place]
    return best, at


@njit(**OPTIONS)
def place_joints(parents, rest, turns, root, joints, offsets):
    """Places of joints at world-from-rest turns, and what each part's rigid move adds after its turn (`part_transforms`)."""
    for j in range(len(parents)):
        above = parents[j]
        for a in range(3):
            if above < 0:
                joints[j, a] = root[a]
            else:
                value = joints[above, a]
                for b in range(3):
                    value += turns[above, a, b] * (rest[j, b] - rest[above, b])
                joints[j, a] = value
        for a in range(3):
            value = joints[j, a]
            for b in range(3):
                value -= turns[j, a, b] * rest[j, b]
            offsets[j, a] = value


@njit(**OPTIONS)
def pose_points(rest, rest_normals, columns, weights, turns, offsets, points, normals):
    """Linear blend skinning of points and of their normals, which come out with length one."""
    m = np.empty((3, 4))
    for v in range(len(rest)):
        m[:] = 0.0
        for c in range(columns.shape[1]):
            w = weights[v, c]
            if w == 0.0:
                continue
            j = columns[v, c]
            for a in range(3):
                for b in range(3):
                    m[a, b] += w * turns[j, a, b]
                m[a, 3] += w * offsets[j, a]
        length = 0.0
        for a in range(3):
            points[v, a] = m[a, 0] * rest[v, 0] + m[a, 1] * rest[v, 1] + m[a, 2] * rest[v, 2] + m[a, 3]
            n = m[a, 0] * rest_normals[v, 0] + m[a, 1] * rest_normals[v, 1] + m[a, 2] * rest_normals[v, 2]
            normals[v, a] = n
            length += n * n
        length = 1.0 / max(np.sqrt(length), 1e-12)
        for a in range(3):
            normals[v, a] *= length


@njit(**OPTIONS)
def gather(points, normals, say, cloud, to_body, to_body_squares, to_cloud, to_cloud_squares, reach, seen, weight, force):
    """Sum, for every point of the body, the weights of the pairs that pull it and their distances along its normal.

    `to_body` is for each point of the cloud the nearest of the body, `to_cloud` for each of the first points of the body the
    nearest of the cloud. Weights are Geman and McClure's. A point of the body only looks for the cloud where the cloud looks
    back at the same patch of skin: what a hole or the far side of a half view hides pulls nothing. `seen` says which do.
    Returns the sum of the weights of the cloud, and of its weighted squared distances along the normals.
    """
    weight[:] = 0.0
    force[:] = 0.0
    total, squares = 0.0, 0.0
    for q in range(len(cloud)):
        v = to_body[q]
        if v < 0:
            continue
        along = 0.0
        for a in range(3):
            along += normals[v, a] * (cloud[q, a] - points[v, a])
        w = say[v] / (1.0 + to_body_squares[q] / (reach * reach)) ** 2
        if along > 0.0:
            w /= 1.0 + (along / (LOOSE * reach)) ** 2
        weight[v] += w
        force[v] += w * along
        total += w
        squares += w * along * along
    share = len(cloud) / max(len(to_cloud), 1)
    for v in range(len(to_cloud)):
        q = to_cloud[v]
        seen[v] = False
        if q < 0 or to_body[q] < 0:
            continue
        u = to_body[q]
        along, facing, apart = 0.0, 0.0, 0.0
        for a in range(3):
            along += normals[v, a] * (cloud[q, a] - points[v, a])
            facing += normals[v, a] * normals[u, a]
            apart += (points[v, a] - points[u, a]) ** 2
        across = max(to_cloud_squares[v] - along * along, 0.0)
        if facing < 0.3 or apart > 0.07 * 0.07:
            continue
        seen[v] = True
        w = say[v] * share / (1.0 + to_cloud_squares[v] / (reach * reach)) ** 2 / (1.0 + across / (0.03 * 0.03)) ** 2
        weight[v] += w
        force[v] += w * along
    return total, squares


@njit(**OPTIONS)
def carried_shapes(parents, joint_basis, turns, moved):
    """How each part's offset moves with each coefficient of the shape (joints x 3 x shapes), joint basis likewise."""
    shapes = joint_basis.shape[2]
    for j in range(len(parents)):
        above = parents[j]
        for a in range(3):
            for k in range(shapes):
                moved[j, a, k] = 0.0
            if above < 0:
                continue
            for k in range(shapes):
                moved[j, a, k] = moved[above, a, k]
            for b in range(3):
                t = turns[above, a, b]
                for k in range(shapes):
                    moved[j, a, k] += t * (joint_basis[j, b, k] - joint_basis[above, b, k])
    for j in range(len(parents)):
        for a in range(3):
            for b in range(3):
                t = turns[j, a, b]
                for k in range(shapes):
                    moved[j, a, k] -= t * joint_basis[j, b, k]


@njit(**OPTIONS)
def fill_rows(
    chosen, scale, directions, parents, rest, columns, weights, turns, offsets, joints, basis, moved, rows
):  # fmt: skip
    """Derivatives of chosen points along directions (one a point), each row times its `scale`: by the turns of the joints about
    world axes, the root's move, and the coefficients of the shape as far as `rows` is wide (`PosedBody.jacobian`)."""
    count = len(parents)
    shapes = rows.shape[1] - 3 * count - 3
    own, back = np.empty(3), np.empty(3)
    for r in range(len(chosen)):
        v, row, s = chosen[r], rows[r], scale[r]
        row[:] = 0.0
        n = directions[v]
        back[:] = 0.0
        for c in range(columns.shape[1]):
            w = weights[v, c] * s
            if w == 0.0:
                continue
            j = columns[v, c]
            for a in range(3):
                own[a] = offsets[j, a]
                for b in range(3):
                    own[a] += turns[j, a, b] * rest[v, b]
                    back[b] += w * turns[j, a, b] * n[a]
            at = j
            while at >= 0:
                x, y, z = own[0] - joints[at, 0], own[1] - joints[at, 1], own[2] - joints[at, 2]
                row[3 * at] += w * (y * n[2] - z * n[1])
                row[3 * at + 1] += w * (z * n[0] - x * n[2])
                row[3 * at + 2] += w * (x * n[1] - y * n[0])
                at = parents[at]
            for a in range(3):
                t = w * n[a]
                for k in range(shapes):
                    row[3 * count + 3 + k] += t * moved[j, a, k]
        for a in range(3):
            row[3 * count + a] = s * n[a]
            t = back[a]
            for k in range(shapes):
                row[3 * count + 3 + k] += t * basis[v, a, k]


@njit(**OPTIONS)
def _turn_matrix(x, y, z, m):
    """The rotation matrix of a rotation vector."""
    angle = np.sqrt(x * x + y * y + z * z)
    if angle > 1e-9:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    else:
        a, b = 1.0, 0.5
    m[0, 0], m[0, 1], m[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    m[1, 0], m[1, 1], m[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    m[2, 0], m[2, 1], m[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)


@njit(**OPTIONS)
def turn_joints(parents, step, turns, out):
    """World turns after a step (three a joint, about world axes): what hangs on a joint turns with it (`moved_state`)."""
    count = len(parents)
    total, own = np.empty((count, 3, 3)), np.empty((3, 3))
    for j in range(count):
        _turn_matrix(step[3 * j], step[3 * j + 1], step[3 * j + 2], own)
        above = parents[j]
        for a in range(3):
            for b in range(3):
                if above < 0:
                    total[j, a, b] = own[a, b]
                else:
                    total[j, a, b] = 0.0
                    for c in range(3):
                        total[j, a, b] += total[above, a, c] * own[c, b]
        for a in range(3):
            for b in range(3):
                out[j, a, b] = 0.0
                for c in range(3):
                    out[j, a, b] += total[j, a, c] * turns[j, c, b]


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `contact.collide.compile_kernels` does."""
    from retarget.methods.scan.scan_body import scan_body
    from retarget.methods.scan.tracker import Tracker

    Tracker().step(scan_body().vertices)
