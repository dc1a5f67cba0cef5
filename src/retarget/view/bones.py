"""A surface for motions that have none: octahedral bones with a ball at every joint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Shaped

from retarget.body import rotations as rot
from retarget.body.kinematics import joint_transforms, rest_pose
from retarget.character import Character, Material, Mesh, Skeleton, Skin
from retarget.errors import RetargetError

Array = np.ndarray

BONE = Material("bone", (0.25, 0.28, 0.34, 1.0))
JOINT = Material("joint", (0.75, 0.25, 0.08, 1.0))


def skeleton_mesh(
    skeleton: Skeleton,
    world_positions: Shaped[Array, "frames joints 3"],
    world_rotations: Shaped[Array, "_ _ 4"] | None = None,
) -> tuple[Mesh, Float[Array, "frames vertices 3"]]:
    """A mesh that shows a skeleton, and its vertices for joints at these world positions (metres).

    A bone is an octahedron from a joint to its child, thick near the joint; bones without length vanish. Where the
    world rotations (quaternions xyzw) are given too, the last bones (`end_offsets`: head, fingertips, toes) are drawn
    as well. Raises `RetargetError` where positions or rotations are of other joints.
    """
    positions = np.asarray(world_positions, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[1:] != (len(skeleton), 3):
        raise RetargetError(f"positions of shape (frames, {len(skeleton)}, 3) are needed, received {positions.shape}")
    rest_rotations, rest = rest_pose(skeleton)
    child = np.flatnonzero(skeleton.parents >= 0)
    start, rest_end, end = skeleton.parents[child], rest[child], positions[:, child]
    if world_rotations is not None and skeleton.end_offsets:
        rotations = np.asarray(world_rotations, dtype=np.float64)
        if rotations.shape != (*positions.shape[:2], 4):
            raise RetargetError(
                f"rotations of shape {(*positions.shape[:2], 4)} are needed, received {rotations.shape}"
            )
        last = np.array(list(skeleton.end_offsets), dtype=np.int64)
        offsets = np.array(list(skeleton.end_offsets.values()), dtype=np.float64).reshape(-1, 3)
        start = np.concatenate([start, last])
        rest_end = np.concatenate([rest_end, rest[last] + rot.rotate(rest_rotations[last], offsets)])
        end = np.concatenate([end, positions[:, last] + rot.rotate(rotations[:, last], offsets)], axis=1)

    size = max(float(np.ptp(rest, axis=0).max()), 1e-3)
    lengths = np.linalg.norm(rest_end - rest[start], axis=1)
    radius = _joint_radii(len(skeleton), start[: len(child)], child, lengths[: len(child)], size)
    thickness = np.minimum(np.maximum(1.15 * radius[start], 0.08 * lengths), 0.022 * size)
    ball, ball_faces = _ball()
    split = len(skeleton) * len(ball)
    faces = [
        np.arange(len(skeleton))[:, None, None] * len(ball) + ball_faces,
        np.arange(len(start))[:, None, None] * 6 + OCTAHEDRON + split,
    ]

    def surface(joints: Float[Array, "frames joints 3"], ends: Float[Array, "frames bones 3"]) -> Array:
        balls = joints[:, :, None] + radius[:, None, None] * ball
        bones = _octahedra(joints[:, start], ends, thickness)
        return np.concatenate([balls.reshape(len(joints), -1, 3), bones.reshape(len(joints), -1, 3)], axis=1)

    triangles = np.concatenate([each.reshape(-1, 3) for each in faces])
    material = (triangles[:, 0] >= split).astype(np.int64)
    mesh = Mesh(surface(rest[None], rest_end[None])[0], triangles, materials=(JOINT, BONE), face_materials=material)
    return mesh, surface(positions, end)


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
    return np.minimum(0.014 * size, 0.25 * shortest)


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


def bone_character(skeleton: Skeleton) -> Character:
    """A skeleton as a character whose skin is its bones, each moved by the joint it starts from. Exact where joints keep
    their offsets."""
    rotations, positions = rest_pose(skeleton)
    mesh, _ = skeleton_mesh(skeleton, positions[None], rotations[None])
    starts = skeleton.parents[skeleton.parents >= 0].tolist() + list(skeleton.end_offsets or {})
    balls = np.repeat(np.arange(len(skeleton)), len(_ball()[0]))
    joints = np.concatenate([balls, np.repeat(np.array(starts, dtype=np.int64), 6)])
    binds = np.linalg.inv(joint_transforms(rotations, positions))
    skin = Skin(np.arange(len(skeleton)), binds, joints[:, None], np.ones((len(joints), 1)))
    return Character(skeleton, mesh, skin, "bones")
