"""Compiled loops of `capture`: which triangle every pixel of a depth camera sees, how far it is, and how it is turned.
Import only where used."""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "boundscheck": False}


@njit(**OPTIONS)
def look(places, faces, left, top, nearness, owner):
    """Fill a picture with the nearest triangles: `nearness` (1 / depth, to begin with 0) and `owner` (face, to begin
    with -1).

    `places` (vertices, 3) are pixels right, pixels down and depth; `left` and `top` are the picture's first column and
    row, whose middles lie half a pixel further. Both sides of a triangle are seen; one that reaches behind the eye is
    not.
    """
    rows, columns = nearness.shape
    for face in range(len(faces)):
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        if places[i, 2] <= 1e-6 or places[j, 2] <= 1e-6 or places[k, 2] <= 1e-6:
            continue
        ax, ay = places[i, 0] - left - 0.5, places[i, 1] - top - 0.5
        bx, by = places[j, 0] - left - 0.5, places[j, 1] - top - 0.5
        cx, cy = places[k, 0] - left - 0.5, places[k, 1] - top - 0.5
        first_column, last_column = max(0.0, np.ceil(min(ax, bx, cx))), min(columns - 1.0, np.floor(max(ax, bx, cx)))
        first_row, last_row = max(0.0, np.ceil(min(ay, by, cy))), min(rows - 1.0, np.floor(max(ay, by, cy)))
        if not (first_column <= last_column and first_row <= last_row):
            continue
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or not np.isfinite(area):
            continue
        near_a, near_b, near_c = 1.0 / places[i, 2], 1.0 / places[j, 2], 1.0 / places[k, 2]
        for row in range(int(first_row), int(last_row) + 1):
            for column in range(int(first_column), int(last_column) + 1):
                of_a = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / area
                of_b = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / area
                of_c = 1.0 - of_a - of_b
                if of_a < 0.0 or of_b < 0.0 or of_c < 0.0:
                    continue
                near = of_a * near_a + of_b * near_b + of_c * near_c  # 1 / depth is affine on the picture
                if near > nearness[row, column]:
                    nearness[row, column] = near
                    owner[row, column] = face


@njit(**OPTIONS)
def readings(places, faces, nearness, owner, focal, left, top):
    """A row for every pixel that sees something: column and row, from the middle of the picture to the middle of the
    pixel, depth, the largest depth among the four pixels around (endless where nothing is), how squarely its triangle
    faces it (0 to 1), and the triangle. Arguments as of `look`, after it."""
    rows, columns = nearness.shape
    count = 0
    for row in range(rows):
        for column in range(columns):
            count += owner[row, column] >= 0
    out = np.empty((count, 6))
    corner = np.empty((3, 3))
    at = 0
    for row in range(rows):
        for column in range(columns):
            face = owner[row, column]
            if face < 0:
                continue
            least = nearness[row, column]
            if row == 0 or column == 0 or row == rows - 1 or column == columns - 1:
                least = 0.0
            else:
                least = min(
                    nearness[row - 1, column],
                    nearness[row + 1, column],
                    nearness[row, column - 1],
                    nearness[row, column + 1],
                )
            for k in range(3):
                x, y, z = places[faces[face, k], 0], places[faces[face, k], 1], places[faces[face, k], 2]
                corner[k, 0], corner[k, 1], corner[k, 2] = x * z / focal, y * z / focal, z
            ax, ay, az = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
            bx, by, bz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            across, down = column + left + 0.5, row + top + 0.5
            rx, ry = across / focal, down / focal
            size = np.sqrt((nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + 1.0))
            out[at, 0], out[at, 1], out[at, 2] = across, down, 1.0 / nearness[row, column]
            out[at, 3] = 1.0 / least if least > 0.0 else np.inf
            out[at, 4] = abs(nx * rx + ny * ry + nz) / size if size > 0.0 else 0.0
            out[at, 5] = face
            at += 1
    return out


@njit(**OPTIONS)
def placed_points(across, depth, focal, axes, eye):
    """Points in the world: pixels (points, 2) from the middle of the picture, depths, the camera's axes (rows) and
    place."""
    out = np.empty((len(depth), 3))
    for point in range(len(depth)):
        x, y, z = across[point, 0] / focal * depth[point], across[point, 1] / focal * depth[point], depth[point]
        for axis in range(3):
            out[point, axis] = x * axes[0, axis] + y * axes[1, axis] + z * axes[2, axis] + eye[axis]
    return out


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, as `contact.collide.compile_kernels` does."""
    places = np.array([[0.0, 0, 1], [2, 0, 1], [0, 2, 1]])
    faces, owner, nearness = np.array([[0, 1, 2]]), np.full((2, 2), -1), np.zeros((2, 2))
    look(places, faces, 0.0, 0.0, nearness, owner)
    readings(places, faces, nearness, owner, 1.0, 0.0, 0.0)
    placed_points(places[:, :2], places[:, 2].copy(), 1.0, np.eye(3), np.zeros(3))
