"""Compiled loops of `isometric`: how the surroundings of every vertex have turned, and the edges that follow. Import only
where used."""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
NEWTON = 40
"""Steps towards the largest eigenvalue, at most; about five are taken."""


@njit(**OPTIONS)
def normals(vertices, faces, out):
    """Unit normals of vertices, faces weighing by their area; zero where there is none."""
    out[:] = 0.0
    for face in range(len(faces)):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
        bx, by, bz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for corner in (i, j, k):
            out[corner, 0] += x
            out[corner, 1] += y
            out[corner, 2] += z
    for vertex in range(len(out)):
        length = np.sqrt(out[vertex, 0] ** 2 + out[vertex, 1] ** 2 + out[vertex, 2] ** 2)
        if length > 0.0:
            for axis in range(3):
                out[vertex, axis] /= length


@njit(**OPTIONS)
def nearest_turn(m, q):
    """Write into q (xyzw) the rotation R that makes trace(R^T m) largest: of vectors r turned into p, m is the sum of p r^T.

    Horn 1987: the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix; the eigenvalue by Newton's steps from
    above on the characteristic polynomial (Theobald 2005), the vector from its cofactors. q stays where m says nothing.
    """
    n = np.empty((4, 4))  # w first
    n[0, 0] = m[0, 0] + m[1, 1] + m[2, 2]
    n[0, 1], n[0, 2], n[0, 3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    n[1, 1], n[1, 2], n[1, 3] = m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[2, 0] + m[0, 2]
    n[2, 2], n[2, 3] = m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]
    n[3, 3] = m[2, 2] - m[0, 0] - m[1, 1]
    squares = 0.0
    for i in range(3):
        for j in range(3):
            squares += m[i, j] * m[i, j]
    if not squares > 1e-300:
        return
    for i in range(4):
        for j in range(i):
            n[i, j] = n[j, i]
    determinant = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    second, first, zeroth = -2.0 * squares, -8.0 * determinant, 0.0
    for column in range(4):
        zeroth += n[0, column] * _cofactor(n, 0, column)
    value = np.sqrt(3.0 * squares)
    for _ in range(NEWTON):
        square = value * value
        slope = 4.0 * square * value + 2.0 * second * value + first
        if abs(slope) < 1e-300:
            break
        step = (square * square + second * square + first * value + zeroth) / slope
        value -= step
        if abs(step) < 1e-12 * abs(value):
            break
    for i in range(4):
        n[i, i] -= value
    best, cofactors, found = 0.0, np.empty(4), np.empty(4)
    for row in range(4):
        length = 0.0
        for column in range(4):
            cofactors[column] = _cofactor(n, row, column)
            length += cofactors[column] ** 2
        if length > best:
            best = length
            found[:] = cofactors
        if best > 1e-4 * squares**3:  # of a well-posed turn: no other row can be much longer
            break
    if best > 1e-40 * squares**3:
        scale = 1.0 / np.sqrt(best)
        q[0], q[1], q[2], q[3] = scale * found[1], scale * found[2], scale * found[3], scale * found[0]


@njit(**OPTIONS)
def _cofactor(n, row, column):
    """Signed minor of a 4 x 4 matrix."""
    i, j, k = (row + 1) % 4, (row + 2) % 4, (row + 3) % 4
    a, b, c = (column + 1) % 4, (column + 2) % 4, (column + 3) % 4
    minor = (
        n[i, a] * (n[j, b] * n[k, c] - n[j, c] * n[k, b])
        - n[i, b] * (n[j, a] * n[k, c] - n[j, c] * n[k, a])
        + n[i, c] * (n[j, a] * n[k, b] - n[j, b] * n[k, a])
    )
    return minor if (row + column) % 2 == 0 else -minor


@njit(**OPTIONS)
def vertex_turns(rest, rest_normals, posed, posed_normals, starts, others, ratios, flatness, donors, q):
    """Rotations q (vertices x 4) from `rest` to `posed` of every vertex with its neighbours `others[starts[v]:starts[v + 1]]`,
    its normal counting as `flatness` times their edges; edges whose `ratios` is 0 say nothing. A vertex whose `donor` is
    another gets that one's; a donor comes from itself."""
    m = np.empty((3, 3))
    for vertex in range(len(rest)):
        if donors[vertex] != vertex:
            continue
        m[:] = 0.0
        size = 0.0
        for entry in range(starts[vertex], starts[vertex + 1]):
            other = others[entry]
            if ratios[entry] == 0.0:
                continue
            for j in range(3):
                r = rest[other, j] - rest[vertex, j]
                size += r * r
                for i in range(3):
                    m[i, j] += (posed[other, i] - posed[vertex, i]) * r
        size *= flatness
        for i in range(3):
            for j in range(3):
                m[i, j] += size * posed_normals[vertex, i] * rest_normals[vertex, j]
        nearest_turn(m, q[vertex])
    for vertex in range(len(rest)):
        if donors[vertex] != vertex:
            q[vertex] = q[donors[vertex]]


@njit(**OPTIONS)
def mean_turns(q, starts, others, out):
    """Every rotation averaged with those of its neighbours."""
    for vertex in range(len(q)):
        x, y, z, w = q[vertex, 0], q[vertex, 1], q[vertex, 2], q[vertex, 3]
        for entry in range(starts[vertex], starts[vertex + 1]):
            p = q[others[entry]]
            along = p[0] * q[vertex, 0] + p[1] * q[vertex, 1] + p[2] * q[vertex, 2] + p[3] * q[vertex, 3]
            sign = 1.0 if along >= 0.0 else -1.0
            x, y, z, w = x + sign * p[0], y + sign * p[1], z + sign * p[2], w + sign * p[3]
        scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
        out[vertex, 0], out[vertex, 1], out[vertex, 2], out[vertex, 3] = scale * x, scale * y, scale * z, scale * w


@njit(**OPTIONS)
def turned_edges(q, shape, ratios, source, starts, others, matrices, out):
    """The right-hand side of the graph's Laplacian: for every vertex, the sum over its edges (itself less the other one) of the
    source's posed edge, `ratios` times as long, and of `shape`, what the target's edge has at rest beyond the source's so
    scaled, turned by the mean of both ends' rotations. `matrices` (vertices x 3 x 3) is room to work in."""
    for vertex in range(len(q)):
        x, y, z, w = q[vertex, 0], q[vertex, 1], q[vertex, 2], q[vertex, 3]
        m = matrices[vertex]
        m[0, 0], m[0, 1], m[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        m[1, 0], m[1, 1], m[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        m[2, 0], m[2, 1], m[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    for vertex in range(len(q)):
        m, a, b, c = matrices[vertex], 0.0, 0.0, 0.0
        for entry in range(starts[vertex], starts[vertex + 1]):
            other, ratio = others[entry], ratios[entry]
            n = matrices[other]
            x, y, z = shape[entry, 0], shape[entry, 1], shape[entry, 2]
            a += 0.5 * ((m[0, 0] + n[0, 0]) * x + (m[0, 1] + n[0, 1]) * y + (m[0, 2] + n[0, 2]) * z)
            b += 0.5 * ((m[1, 0] + n[1, 0]) * x + (m[1, 1] + n[1, 1]) * y + (m[1, 2] + n[1, 2]) * z)
            c += 0.5 * ((m[2, 0] + n[2, 0]) * x + (m[2, 1] + n[2, 1]) * y + (m[2, 2] + n[2, 2]) * z)
            if ratio > 0.0:
                a += ratio * (source[vertex, 0] - source[other, 0])
                b += ratio * (source[vertex, 1] - source[other, 1])
                c += ratio * (source[vertex, 2] - source[other, 2])
        out[vertex, 0], out[vertex, 1], out[vertex, 2] = a, b, c


@njit(**OPTIONS)
def group_turns(rest, posed, starts, members, weights, rest_centres, q, centres):
    """Rotation and centre of groups of vertices: of group g, `members[starts[g]:starts[g + 1]]` with their weights, which
    sum to one. A group that says nothing keeps its q."""
    m = np.empty((3, 3))
    for group in range(len(starts) - 1):
        centres[group] = 0.0
        for entry in range(starts[group], starts[group + 1]):
            for i in range(3):
                centres[group, i] += weights[entry] * posed[members[entry], i]
        m[:] = 0.0
        for entry in range(starts[group], starts[group + 1]):
            vertex = members[entry]
            for j in range(3):
                r = weights[entry] * (rest[vertex, j] - rest_centres[group, j])
                for i in range(3):
                    m[i, j] += (posed[vertex, i] - centres[group, i]) * r
        nearest_turn(m, q[group])


@njit(**OPTIONS)
def _carried(q, centre, rest_centre, place, out):
    """Where a piece that has turned by q about its centre carries a place of its rest."""
    x, y, z = place[0] - rest_centre[0], place[1] - rest_centre[1], place[2] - rest_centre[2]
    a, b, c, w = q[0], q[1], q[2], q[3]
    u, v, t = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    out[0] = centre[0] + x + w * u + b * t - c * v
    out[1] = centre[1] + y + w * v + c * u - a * t
    out[2] = centre[2] + z + w * t + a * v - b * u


@njit(**OPTIONS)
def skin_turns(rest, posed, starts, members, weights, totals, rest_centres, rounds, q, centres, told):
    """Improve rotations and centres of the joints of a skin: those whose linear blend comes nearest to the posed vertices. Each
    joint in turn is fitted to what the others leave over, `rounds` times. `weights` are the skin's, `totals` the sums of their
    squares a joint, `rest_centres` means weighted by these; `told` (vertices x 3) is room for the blend."""
    m, own, sums = np.empty((3, 3)), np.empty(3), np.empty(3)
    told[:] = 0.0
    for joint in range(len(starts) - 1):
        for entry in range(starts[joint], starts[joint + 1]):
            _carried(q[joint], centres[joint], rest_centres[joint], rest[members[entry]], own)
            for axis in range(3):
                told[members[entry], axis] += weights[entry] * own[axis]
    for _ in range(rounds):
        for joint in range(len(starts) - 1):
            if starts[joint] == starts[joint + 1]:
                continue
            m[:], sums[:] = 0.0, 0.0
            for entry in range(starts[joint], starts[joint + 1]):
                vertex, weight = members[entry], weights[entry]
                _carried(q[joint], centres[joint], rest_centres[joint], rest[vertex], own)
                for i in range(3):
                    told[vertex, i] -= weight * own[i]
                    left = weight * (posed[vertex, i] - told[vertex, i])
                    sums[i] += left
                    for j in range(3):
                        m[i, j] += left * (rest[vertex, j] - rest_centres[joint, j])
            nearest_turn(m, q[joint])
            centres[joint] = sums / totals[joint]
            for entry in range(starts[joint], starts[joint + 1]):
                vertex = members[entry]
                _carried(q[joint], centres[joint], rest_centres[joint], rest[vertex], own)
                for axis in range(3):
                    told[vertex, axis] += weights[entry] * own[axis]


@njit(**OPTIONS)
def joint_places(parents, starts, q, centres, rest_centres, rest_places, places):
    """Places of joints from the pieces of skin that they move: between where their own piece and their parent's carry them. A
    joint without a piece follows its parent's; `q`, `centres` and `rest_centres` are filled in for it. Parents come first."""
    other = np.empty(3)
    for joint in range(len(parents)):
        above = parents[joint]
        told = starts[joint + 1] > starts[joint]
        if not told and above >= 0:
            q[joint], centres[joint], rest_centres[joint] = q[above], centres[above], rest_centres[above]
        elif not told:
            centres[joint], rest_centres[joint] = 0.0, 0.0
        _carried(q[joint], centres[joint], rest_centres[joint], rest_places[joint], places[joint])
        if told and above >= 0:
            _carried(q[above], centres[above], rest_centres[above], rest_places[joint], other)
            for axis in range(3):
                places[joint, axis] = 0.5 * (places[joint, axis] + other[axis])


@njit(**OPTIONS)
def volume_system(
    points, triangles, starts, rims, rim_starts, members, member_starts, normals, shares, gradient, volumes, matrix
):  # fmt: skip
    """Volumes of closed solids (triangles `starts[s]:starts[s + 1]` each) and, in matrix[s, k], how they change when every
    vertex moves along its normal by `shares[vertex, k]`. Points behind the vertices close rims, as the means of
    `rims[rim_starts[r]:rim_starts[r + 1]]`. `members` are each solid's vertices; `gradient` (points x 3, zero) is room."""
    count = len(normals)
    for solid in range(len(starts) - 1):
        total = 0.0
        for row in range(starts[solid], starts[solid + 1]):
            for corner in range(3):
                own, a, b = triangles[row, corner], triangles[row, (corner + 1) % 3], triangles[row, (corner + 2) % 3]
                x = points[a, 1] * points[b, 2] - points[a, 2] * points[b, 1]
                y = points[a, 2] * points[b, 0] - points[a, 0] * points[b, 2]
                z = points[a, 0] * points[b, 1] - points[a, 1] * points[b, 0]
                gradient[own, 0] += x / 6.0
                gradient[own, 1] += y / 6.0
                gradient[own, 2] += z / 6.0
                if corner == 0:
                    total += points[own, 0] * x + points[own, 1] * y + points[own, 2] * z
        volumes[solid] = total / 6.0
        for rim in range(len(rim_starts) - 1):
            own, length = gradient[count + rim], rim_starts[rim + 1] - rim_starts[rim]
            if own[0] != 0.0 or own[1] != 0.0 or own[2] != 0.0:
                for place in range(rim_starts[rim], rim_starts[rim + 1]):
                    for axis in range(3):
                        gradient[rims[place], axis] += own[axis] / length
                own[:] = 0.0
        for place in range(member_starts[solid], member_starts[solid + 1]):
            vertex = members[place]
            along = 0.0
            for axis in range(3):
                along += gradient[vertex, axis] * normals[vertex, axis]
                gradient[vertex, axis] = 0.0
            for other in range(shares.shape[1]):
                matrix[solid, other] += along * shares[vertex, other]


@njit(**OPTIONS)
def _local_frame(vertices, normals, vertex, other, frame):
    """Rows: the normal, a neighbour's direction across it, and what completes them; all zero where there is no such frame."""
    frame[:] = 0.0
    n = normals[vertex]
    x, y, z = (
        vertices[other, 0] - vertices[vertex, 0],
        vertices[other, 1] - vertices[vertex, 1],
        vertices[other, 2] - vertices[vertex, 2],
    )
    along = x * n[0] + y * n[1] + z * n[2]
    x, y, z = x - along * n[0], y - along * n[1], z - along * n[2]
    length = np.sqrt(x * x + y * y + z * z)
    if length < 1e-12 or n[0] * n[0] + n[1] * n[1] + n[2] * n[2] < 0.5:
        return False
    x, y, z = x / length, y / length, z / length
    frame[0] = n
    frame[1, 0], frame[1, 1], frame[1, 2] = x, y, z
    frame[2, 0], frame[2, 1], frame[2, 2] = n[1] * z - n[2] * y, n[2] * x - n[0] * z, n[0] * y - n[1] * x
    return True


@njit(**OPTIONS)
def local_offsets(vertices, normals, starts, others, leading, out):
    """For every vertex, the mean of its neighbours less itself, in the frame of its normal and its `leading` neighbour."""
    frame, delta = np.empty((3, 3)), np.empty(3)
    for vertex in range(len(vertices)):
        out[vertex] = 0.0
        if leading[vertex] != vertex and _local_frame(vertices, normals, vertex, leading[vertex], frame):
            _from_mean(vertices, vertex, starts, others, delta)
            for row in range(3):
                for axis in range(3):
                    out[vertex, row] += frame[row, axis] * delta[axis]


@njit(**OPTIONS)
def _from_mean(vertices, vertex, starts, others, out):
    """The mean of a vertex's neighbours less itself."""
    x, y, z, count = 0.0, 0.0, 0.0, starts[vertex + 1] - starts[vertex]
    for entry in range(starts[vertex], starts[vertex + 1]):
        other = others[entry]
        x, y, z = x + vertices[other, 0], y + vertices[other, 1], z + vertices[other, 2]
    out[0], out[1], out[2] = (
        x / count - vertices[vertex, 0],
        y / count - vertices[vertex, 1],
        z / count - vertices[vertex, 2],
    )


@njit(**OPTIONS)
def offset_moves(vertices, normals, starts, others, leading, offsets, share, out):
    """Every vertex moved by a `share` of the way to where its neighbours and its own offset in the local frame want it."""
    frame, delta = np.empty((3, 3)), np.empty(3)
    for vertex in range(len(vertices)):
        out[vertex] = vertices[vertex]
        if leading[vertex] != vertex and _local_frame(vertices, normals, vertex, leading[vertex], frame):
            _from_mean(vertices, vertex, starts, others, delta)
            a, b, c = offsets[vertex, 0], offsets[vertex, 1], offsets[vertex, 2]
            for axis in range(3):
                wanted = a * frame[0, axis] + b * frame[1, axis] + c * frame[2, axis]
                out[vertex, axis] += share * (delta[axis] - wanted)


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `contact.collide.compile_kernels` does."""
    places, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
    own, q = np.empty((3, 3)), np.zeros((3, 4))
    q[:, 3] = 1.0
    normals(places, faces, own)
    starts, others, donors = np.array([0, 2, 4, 6], np.int32), np.array([1, 2, 0, 2, 0, 1], np.int32), np.arange(3)
    vertex_turns(places, own, places, own, starts, others, np.ones(6), 0.5, donors, q)
    mean_turns(q, starts, others, q.copy())
    turned_edges(q, np.zeros((6, 3)), np.ones(6), places, starts, others, np.empty((3, 3, 3)), np.empty((3, 3)))
    group_turns(places, places, starts, others, np.full(6, 0.5), places, q, np.empty((3, 3)))
    skin_turns(
        places,
        places,
        starts,
        others,
        np.full(6, 0.5),
        np.full(3, 0.5),
        places,
        1,
        q,
        np.zeros((3, 3)),
        np.empty((3, 3)),
    )
    joint_places(
        np.array([-1, 0, 1]), np.array([0, 1, 2, 2], np.int32), q, np.zeros((3, 3)), np.zeros((3, 3)), places, own
    )
    volume_system(
        places, faces.astype(np.int32), np.array([0, 1]), donors[:0], np.array([0]), donors, np.array([0, 3]), own,
        np.ones((3, 1)), np.zeros((3, 3)), np.empty(1), np.zeros((1, 1)),
    )  # fmt: skip
    local_offsets(places, own, starts, others, np.array([1, 2, 0]), np.empty((3, 3)))
    offset_moves(places, own, starts, others, np.array([1, 2, 0]), own, 0.3, np.empty((3, 3)))
