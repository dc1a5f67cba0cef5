"""Compiled loops of `collide`: boxes over faces, nearest point of a surface, parity of rays. Import only where used.

Compiled on first use and cached on disk (about ten seconds, once); every kernel releases the interpreter's lock, so that
threads of Python share the work. Places are double precision throughout.
"""

from __future__ import annotations

import numpy as np
from numba import njit

BLOCK = 32
"""Candidates that are dismissed together."""
MOST_SIDE = 64
MOST_CELLS = MOST_SIDE * MOST_SIDE
"""Cells of a shadow grid."""

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}


@njit(**OPTIONS)
def refit(points, faces, lefts, firsts, counts, low, high):
    """Boxes of a hierarchy whose parents come before their children; `low`, `high` (nodes x 3) are overwritten."""
    for node in range(len(lefts) - 1, -1, -1):
        left = lefts[node]
        if left >= 0:
            for axis in range(3):
                low[node, axis] = min(low[left, axis], low[left + 1, axis])
                high[node, axis] = max(high[left, axis], high[left + 1, axis])
            continue
        for axis in range(3):
            least, most = np.inf, -np.inf
            for face in range(firsts[node], firsts[node] + counts[node]):
                for corner in range(3):
                    value = points[faces[face, corner], axis]
                    least, most = min(least, value), max(most, value)
            low[node, axis], high[node, axis] = least, most


@njit(**OPTIONS)
def _nearest_on_triangle(x, y, z, points, faces, face):
    """Barycentric coordinates (of b and c) of the point of a triangle nearest to a point (Ericson 2005, section 5.1.5),
    and its squared distance."""
    v, w = _nearest_coordinates(x, y, z, points, faces[face, 0], faces[face, 1], faces[face, 2])
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    u = 1.0 - v - w
    gap_x = u * points[i, 0] + v * points[j, 0] + w * points[k, 0] - x
    gap_y = u * points[i, 1] + v * points[j, 1] + w * points[k, 1] - y
    gap_z = u * points[i, 2] + v * points[j, 2] + w * points[k, 2] - z
    return v, w, gap_x * gap_x + gap_y * gap_y + gap_z * gap_z


@njit(**OPTIONS)
def _nearest_coordinates(x, y, z, points, i, j, k):
    ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
    bx, by, bz = points[j, 0], points[j, 1], points[j, 2]
    cx, cy, cz = points[k, 0], points[k, 1], points[k, 2]
    abx, aby, abz = bx - ax, by - ay, bz - az
    acx, acy, acz = cx - ax, cy - ay, cz - az
    apx, apy, apz = x - ax, y - ay, z - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bpx, bpy, bpz = x - bx, y - by, z - bz
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return (d1 / (d1 - d3) if d1 > d3 else 0.0), 0.0
    cpx, cpy, cpz = x - cx, y - cy, z - cz
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, (d2 / (d2 - d6) if d2 > d6 else 0.0)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        along = (d4 - d3) / ((d4 - d3) + (d5 - d6)) if (d4 - d3) + (d5 - d6) > 0.0 else 0.0
        return 1.0 - along, along
    total = va + vb + vc
    if total <= 0.0:
        return 0.0, 0.0
    return vb / total, vc / total


@njit(**OPTIONS)
def _box_distance(x, y, z, low, high, node):
    """Squared distance from a point to a node's box. (Scalars throughout: views of rows cost more than the arithmetic.)"""
    gap_x = max(low[node, 0] - x, x - high[node, 0], 0.0)
    gap_y = max(low[node, 1] - y, y - high[node, 1], 0.0)
    gap_z = max(low[node, 2] - z, z - high[node, 2], 0.0)
    return gap_x * gap_x + gap_y * gap_y + gap_z * gap_z


@njit(**OPTIONS)
def _boxes_distance(low, high, other_low, other_high):
    """Squared distance between two boxes."""
    total = 0.0
    for axis in range(3):
        gap = max(other_low[axis] - high[axis], low[axis] - other_high[axis], 0.0)
        total += gap * gap
    return total


@njit(**OPTIONS)
def _nearest(x, y, z, root, points, faces, lefts, firsts, counts, low, high, bound, guess, stack):
    """(squared distance, face, barycentrics of its second and third corner) of the nearest point;
    face -1 where none is nearer than `bound`. `guess` is a face that may be near, or -1."""
    best, best_face, best_v, best_w = bound, -1, 0.0, 0.0
    if guess >= 0:
        v, w, total = _nearest_on_triangle(x, y, z, points, faces, guess)
        if total < best:
            best, best_face, best_v, best_w = total, guess, v, w
    top = 0
    stack[0] = root
    while top >= 0:
        node = stack[top]
        top -= 1
        if _box_distance(x, y, z, low, high, node) >= best:
            continue
        left = lefts[node]
        if left >= 0:
            to_left, to_right = _box_distance(x, y, z, low, high, left), _box_distance(x, y, z, low, high, left + 1)
            near, far = (left, left + 1) if to_left <= to_right else (left + 1, left)
            if max(to_left, to_right) < best:
                top += 1
                stack[top] = far
            if min(to_left, to_right) < best:
                top += 1
                stack[top] = near
            continue
        for face in range(firsts[node], firsts[node] + counts[node]):
            v, w, total = _nearest_on_triangle(x, y, z, points, faces, face)
            if total < best:
                best, best_face, best_v, best_w = total, face, v, w
    return best, best_face, best_v, best_w


@njit(**OPTIONS)
def rim_centres(points, rims, starts, first):
    """Centroid of each rim's vertices, written from row `first` of the points on."""
    for rim in range(len(starts) - 1):
        for axis in range(3):
            total = 0.0
            for place in range(starts[rim], starts[rim + 1]):
                total += points[rims[place], axis]
            points[first + rim, axis] = total / (starts[rim + 1] - starts[rim])


@njit(**OPTIONS)
def _steps(low, high, side):
    """Cells a metre; none where all lies on one line."""
    return side / (high - low) if high > low else 0.0


@njit(**OPTIONS)
def _cell(value, low, steps, side):
    """Cell of a value along one side of a grid, the border cells for what lies beyond."""
    place = (value - low) * steps
    if place <= 0.0:
        return 0
    return side - 1 if place >= side else int(place)


@njit(**OPTIONS)
def _faces_over(root, lefts, firsts, counts, low, high, fans, stop, left, right, down, up, stack):
    """Skin triangles whose boxes touch a rectangle of the x-y plane, and all fans (from `fans` to `stop`)."""
    chosen = np.empty(stop - firsts[root], dtype=np.int32)
    count, top = 0, 0
    stack[0] = root
    while top >= 0:
        node = stack[top]
        top -= 1
        if low[node, 0] > right or high[node, 0] < left or low[node, 1] > up or high[node, 1] < down:
            continue
        if lefts[node] >= 0:
            stack[top + 1], stack[top + 2] = lefts[node], lefts[node] + 1
            top += 2
            continue
        for face in range(firsts[node], firsts[node] + counts[node]):
            chosen[count] = face
            count += 1
    for face in range(fans, stop):
        chosen[count] = face
        count += 1
    return chosen[:count]


@njit(**OPTIONS)
def _shadow_grid(points, faces, chosen, left, right, down, up, side, cells):
    """Triangles whose shadows in the x-y plane may touch the cells of a square grid over a rectangle. `cells` (side² + 1)
    becomes the start of each cell's entries; returns the entries."""
    step_x, step_y = _steps(left, right, side), _steps(down, up, side)
    count = 0
    boxes = np.empty((len(chosen), 5), dtype=np.int32)
    for cell in range(side * side + 1):
        cells[cell] = 0
    for face in chosen:
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        least_x = min(points[i, 0], points[j, 0], points[k, 0])
        most_x = max(points[i, 0], points[j, 0], points[k, 0])
        least_y = min(points[i, 1], points[j, 1], points[k, 1])
        most_y = max(points[i, 1], points[j, 1], points[k, 1])
        if least_x > right or most_x < left or least_y > up or most_y < down:
            continue
        boxes[count, 0], boxes[count, 1] = _cell(least_x, left, step_x, side), _cell(most_x, left, step_x, side)
        boxes[count, 2], boxes[count, 3] = _cell(least_y, down, step_y, side), _cell(most_y, down, step_y, side)
        boxes[count, 4] = face
        for row in range(boxes[count, 2], boxes[count, 3] + 1):
            for column in range(boxes[count, 0], boxes[count, 1] + 1):
                cells[row * side + column + 1] += 1
        count += 1
    for cell in range(side * side):
        cells[cell + 1] += cells[cell]
    entries = np.empty(cells[side * side], dtype=np.int32)
    filled = cells[:-1].copy()
    for number in range(count):
        for row in range(boxes[number, 2], boxes[number, 3] + 1):
            for column in range(boxes[number, 0], boxes[number, 1] + 1):
                entries[filled[row * side + column]] = boxes[number, 4]
                filled[row * side + column] += 1
    return entries


@njit(**OPTIONS)
def _crosses(points, i, j, x, y):
    """Whether the edge i-j, seen along z, crosses the ray that leaves (x, y) towards +x. Both faces of an edge get the same
    answer: the ends are taken in the order of their indices."""
    if i > j:
        i, j = j, i
    x_i, y_i, x_j, y_j = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
    if (y_i > y) == (y_j > y):
        return False
    return x < x_i + (y - y_i) * (x_j - x_i) / (y_j - y_i)


@njit(**OPTIONS)
def _is_inside(x, y, z, points, faces, cells, entries, left, right, down, up, side):
    """Whether a ray from p along +z crosses a closed surface an odd number of times."""
    column, row = _cell(x, left, _steps(left, right, side), side), _cell(y, down, _steps(down, up, side), side)
    cell = row * side + column
    odd = False
    for place in range(cells[cell], cells[cell + 1]):
        face = entries[place]
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        if not (_crosses(points, i, j, x, y) ^ _crosses(points, j, k, x, y) ^ _crosses(points, k, i, x, y)):
            continue
        least = min(points[i, 2], points[j, 2], points[k, 2])
        most = max(points[i, 2], points[j, 2], points[k, 2])
        if z >= most:
            continue
        if z >= least:
            abx, aby, abz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            acx, acy, acz = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1], points[k, 2] - points[i, 2]
            normal_z = abx * acy - aby * acx
            if normal_z == 0.0:
                continue  # seen edge-on: the other faces of the surface decide
            normal_x, normal_y = aby * acz - abz * acy, abz * acx - abx * acz
            hit = points[i, 2] - ((x - points[i, 0]) * normal_x + (y - points[i, 1]) * normal_y) / normal_z
            if z >= min(max(hit, least), most):
                continue
        odd = not odd
    return odd


@njit(**OPTIONS)
def near_pairs(
    points, candidates, excluded, blocks_excluded, faces, starts, skin_stops, roots, lefts, firsts, counts, low, high, reach,
    out_vertex, out_solid, out_face, out_v, out_w, out_distance,
):  # fmt: skip
    """Signed distance of every candidate to every solid it is not excluded from: all that are inside, and those outside
    within `reach`. Fills the outputs up to their length; returns how many pairs there are.

    Candidates come in blocks of `BLOCK` neighbours: most blocks are dismissed as a whole, by their boxes or because all of
    their vertices are excluded."""
    blocks = len(blocks_excluded)
    block_low, block_high = np.full((blocks, 3), np.inf), np.full((blocks, 3), -np.inf)
    for number in range(len(candidates)):
        block = number // BLOCK
        for axis in range(3):
            value = points[candidates[number], axis]
            block_low[block, axis] = min(block_low[block, axis], value)
            block_high[block, axis] = max(block_high[block, axis], value)
    stack = np.empty(128, dtype=np.int32)
    close = np.empty(len(candidates), dtype=np.int32)
    may_be_inside = np.empty(len(candidates), dtype=np.bool_)
    cells = np.empty(MOST_CELLS + 1, dtype=np.int32)
    bounds_low, bounds_high = np.empty((1, 3)), np.empty((1, 3))
    found = 0
    for solid in range(len(roots)):
        bounds_low[0], bounds_high[0] = low[roots[solid]], high[roots[solid]]
        for face in range(skin_stops[solid], starts[solid + 1]):  # the fans' centres may stick out of the skin's box
            centre = faces[face, 2]
            for axis in range(3):
                bounds_low[0, axis] = min(bounds_low[0, axis], points[centre, axis])
                bounds_high[0, axis] = max(bounds_high[0, axis], points[centre, axis])
        near, contained = 0, 0
        left, right, down, up = np.inf, -np.inf, np.inf, -np.inf
        for block in range(blocks):
            if blocks_excluded[block, solid] or (
                _boxes_distance(block_low[block], block_high[block], bounds_low[0], bounds_high[0]) > reach * reach
            ):
                continue
            for vertex in candidates[block * BLOCK : (block + 1) * BLOCK]:
                x, y, z = points[vertex, 0], points[vertex, 1], points[vertex, 2]
                away = _box_distance(x, y, z, bounds_low, bounds_high, 0)
                if (away > 0.0 and away >= reach * reach) or excluded[vertex, solid]:
                    continue
                close[near], may_be_inside[near] = vertex, away == 0.0
                near += 1
                if away == 0.0:
                    contained += 1
                    left, right = min(left, x), max(right, x)
                    down, up = min(down, y), max(up, y)
        if near == 0:
            continue
        side = 1
        entries = np.empty(0, dtype=np.int32)
        if contained > 0:
            side = min(max(int(np.sqrt(contained)), 1), MOST_SIDE)
            chosen = _faces_over(
                roots[solid], lefts, firsts, counts, low, high, skin_stops[solid], starts[solid + 1],
                left, right, down, up, stack,
            )  # fmt: skip
            entries = _shadow_grid(points, faces, chosen, left, right, down, up, side, cells)
        last_face = -1
        for number in range(near):
            vertex = close[number]
            x, y, z = points[vertex, 0], points[vertex, 1], points[vertex, 2]
            inside = may_be_inside[number] and _is_inside(
                x, y, z, points, faces, cells, entries, left, right, down, up, side
            )
            if not inside and reach == 0.0:
                continue
            bound = np.inf if inside else reach * reach
            best, face, v, w = _nearest(
                x, y, z, roots[solid], points, faces, lefts, firsts, counts, low, high, bound, last_face, stack
            )
            if face < 0:
                continue
            last_face = face  # neighbours come one after the other: a good guess for the next
            if found < len(out_vertex):
                out_vertex[found], out_solid[found], out_face[found] = vertex, solid, face
                out_v[found], out_w[found] = v, w
                out_distance[found] = -np.sqrt(best) if inside else np.sqrt(best)
            found += 1
    return found


@njit(**OPTIONS)
def nearest_points(points, faces, vertices, triangles, shares_v, shares_w, distances, barycentrics, nearest, normals):
    """Fill in, for each pair, the barycentrics and the place of the nearest point, and the unit direction that leads out:
    from it to a vertex outside, to it from one inside; on the surface itself (within a nanometre) the face's normal."""
    for row in range(len(vertices)):
        i, j, k = faces[triangles[row], 0], faces[triangles[row], 1], faces[triangles[row], 2]
        v, w = shares_v[row], shares_w[row]
        u = 1.0 - v - w
        barycentrics[row, 0], barycentrics[row, 1], barycentrics[row, 2] = u, v, w
        x = u * points[i, 0] + v * points[j, 0] + w * points[k, 0]
        y = u * points[i, 1] + v * points[j, 1] + w * points[k, 1]
        z = u * points[i, 2] + v * points[j, 2] + w * points[k, 2]
        nearest[row, 0], nearest[row, 1], nearest[row, 2] = x, y, z
        out = 1.0 if distances[row] >= 0.0 else -1.0
        vertex = vertices[row]
        x, y, z = out * (points[vertex, 0] - x), out * (points[vertex, 1] - y), out * (points[vertex, 2] - z)
        length = np.sqrt(x * x + y * y + z * z)
        if length < 1e-9:
            abx, aby, abz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            acx, acy, acz = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1], points[k, 2] - points[i, 2]
            x, y, z = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
            length = max(np.sqrt(x * x + y * y + z * z), 1e-300)
        normals[row, 0], normals[row, 1], normals[row, 2] = x / length, y / length, z / length


def compiled() -> bool:
    """Whether the kernels lie compiled on disk, or in this process."""
    from pathlib import Path

    return any(near_pairs.signatures) or any(Path(near_pairs.stats.cache_path).glob("kernels.near_pairs-*.nbc"))
