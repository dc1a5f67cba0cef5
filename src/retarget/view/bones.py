"""A surface for motions that have none: octahedral bones with a ball at every joint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Shaped

from retarget.body.kinematics import rest_pose
from retarget.character import Material, Mesh, Skeleton
from retarget.errors import RetargetError

Array = np.ndarray

BONE = Material("bone", (0.25, 0.28, 0.34, 1.0))
JOINT = Material("joint", (0.75, 0.25, 0.08, 1.0))


def skeleton_mesh(
    skeleton: Skeleton, world_positions: Shaped[Array, "frames joints 3"]
) -> tuple[Mesh, Float[Array, "frames vertices 3"]]:
    """A mesh that shows a skeleton, and its vertices for joints at these world positions (metres).

    A bone is an octahedron from a joint to its child, thick near the joint; bones without length vanish. Raises
    `RetargetError` where the positions are of other joints.
    """
    positions = np.asarray(world_positions, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[1:] != (len(skeleton), 3):
        raise RetargetError(f"positions of shape (frames, {len(skeleton)}, 3) are needed, received {positions.shape}")
    rest = rest_pose(skeleton)[1]
    child = np.flatnonzero(skeleton.parents >= 0)
    parent = skeleton.parents[child]
    lengths = np.linalg.norm(rest[child] - rest[parent], axis=1)
    radius = _joint_radii(len(skeleton), parent, child, lengths, float(np.ptp(rest, axis=0).max()))

    ball, ball_faces = _ball()
    balls = positions[:, :, None] + radius[:, None, None] * ball
    thickness = np.maximum(1.15 * radius[parent], 0.08 * lengths)
    bones = _octahedra(positions[:, parent], positions[:, child], thickness)
    rest_balls = rest[:, None] + radius[:, None, None] * ball
    rest_bones = _octahedra(rest[None, parent], rest[None, child], thickness)
    faces = np.concatenate(
        [
            (np.arange(len(skeleton))[:, None, None] * len(ball) + ball_faces).reshape(-1, 3),
            (np.arange(len(child))[:, None, None] * 6 + OCTAHEDRON + len(skeleton) * len(ball)).reshape(-1, 3),
        ]
    )
    split = len(skeleton) * len(ball_faces)
    mesh = Mesh(
        np.concatenate([rest_balls.reshape(-1, 3), rest_bones.reshape(-1, 3)]),
        faces,
        materials=(JOINT, BONE),
        face_materials=(np.arange(len(faces)) >= split).astype(np.int64),
    )
    frames = len(positions)
    return mesh, np.concatenate([balls.reshape(frames, -1, 3), bones.reshape(frames, -1, 3)], axis=1)


OCTAHEDRON = np.array([[0, 1 + k, 1 + (k + 1) % 4] for k in range(4)] + [[5, 1 + (k + 1) % 4, 1 + k] for k in range(4)])
"""Corners: the joint, four round it a little along the bone, the child. Counter-clockwise from outside."""


def _octahedra(
    start: Float[Array, "frames bones 3"], end: Float[Array, "frames bones 3"], radius: Float[Array, "bones"]
) -> Float[Array, "frames bones 6 3"]:
    along = end - start
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    axis = along / np.maximum(length, 1e-12)
    aside = np.where(np.abs(axis[..., 2:]) < 0.8, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    x = np.cross(aside, axis)
    x /= np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-12)
    y = np.cross(axis, x)
    thick = np.minimum(radius[:, None], 0.3 * length)
    waist = start + np.minimum(0.18 * length, 2 * thick) * axis
    ring = [waist + thick * side for side in (-x, y, x, -y)]
    return np.stack([start, *ring, end], axis=-2)


def _joint_radii(
    count: int, parent: Int[Array, "bones"], child: Int[Array, "bones"], lengths: Float[Array, "bones"], size: float
) -> Float[Array, "joints"]:
    """1.4 % of the skeleton's size, less where bones are short, as in fingers."""
    shortest = np.full(count, np.inf)
    long = lengths > 1e-4 * size
    np.minimum.at(shortest, parent[long], lengths[long])
    np.minimum.at(shortest, child[long], lengths[long])
    return np.minimum(0.014 * max(size, 1e-3), 0.25 * shortest)


def _ball() -> tuple[Float[Array, "vertices 3"], Int[Array, "faces 3"]]:
    """A unit octahedron divided once, pushed onto the sphere: 18 vertices, 32 faces."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    sides = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    sides = [(x, y, z) if (x + y + z) % 2 == 0 else (x, z, y) for x, y, z in sides]
    middle: dict[tuple[int, int], int] = {}
    points, faces = list(corners), []
    for a, b, c in sides:
        inner = []
        for p, q in ((a, b), (b, c), (c, a)):
            key = (min(p, q), max(p, q))
            if key not in middle:
                middle[key] = len(points)
                points.append((corners[p] + corners[q]) / np.sqrt(2))
            inner.append(middle[key])
        ab, bc, ca = inner
        faces += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.array(points), np.array(faces)
