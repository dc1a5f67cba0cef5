"""What the skeleton regressor sees of a cloud: vectors to the points nearest to fixed places, and to places around joints.

Basis point sets: Prokudin et al. 2019, "Efficient learning on point clouds with basis point sets"; features indexed by the
pose found so far: Dollár et al. 2010, "Cascaded pose regression". The paper (Rekik 2023, section 3.2) has a PointNet in this
place. Everything works on many clouds at once (axis `clouds`), for training and use alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

CELL = 0.025
"""Metres: clouds are thinned to one point in a cube of this side, so that it does not matter where points lie dense."""
ORDER = (0, 1, 2, 2)
"""Which network looks when: the last one twice."""
BASIS, REACH = 448, 1.0
"""How many fixed places there are, and how far from the middle of the cloud (metres; in the second look, of a body of usual size)."""
JOINTS = 22
"""The joints of the embedded human's body, without fingers; the first of its skeleton."""
BONES = 14
"""Places around each joint, six of them around the joint itself and eight around the middle of its bone."""
AROUND_JOINT, AROUND_BONE = 0.08, 0.06
"""How far these are along each of their axes (metres, of a body of usual size)."""
USUAL_SIZE = 0.2
"""Mean length of a bone of a body of usual size, metres."""
SMALLEST, LARGEST = 0.25, 2.0
"""Sizes, of the usual one, that places are spread for."""
PARENTS = np.array([-1, 0, 1, 2, 3, 4, 3, 6, 7, 8, 0, 10, 11, 12, 3, 14, 15, 16, 0, 18, 19, 20])
"""Of the joints, as in the embedded human."""
FIRST_CHILD = np.array([1, 2, 3, 4, 5, -1, 7, 8, 9, -1, 11, 12, 13, -1, 15, 16, 17, -1, 19, 20, 21, -1])
_ENDS = {5: (0.0, 0.2, 0.02), 9: (0.08, -0.1, 0.14), 17: (-0.08, -0.1, 0.14), 13: (0.0, -0.02, 0.08), 21: (0.0, -0.02, 0.08)}
"""Where bones without a child end, from their joint, in the embedded human's rest pose (metres)."""


@dataclass(frozen=True, eq=False)
class Clouds:
    """Thinned clouds about their middles, laid out for the search; `thinned` makes them."""

    places: Float[Array, "clouds places 3"]
    """From the middle; metres. Rows beyond a cloud's last block mean nothing."""
    firsts: Int[Array, "clouds starts"]
    """Where each block of places begins."""
    boxes: Float[Array, "clouds 6 blocks"]
    blocks: Int[Array, "clouds"]
    """How many blocks each cloud has."""
    middles: Float[Array, "clouds 3"]


@dataclass(frozen=True, eq=False)
class Bodies:
    """Joints found in clouds."""

    places: Float[Array, "clouds joints 3"]
    """From the middle of the cloud, metres."""
    turns: Float[Array, "clouds joints 3 3"]
    """Rotations in the world from the embedded human's rest pose."""

    @property
    def sizes(self) -> Float[Array, "clouds 1 1"]:
        """Mean length of the bones, of a usual body's."""
        bones = np.linalg.norm(self.places[:, 1:] - self.places[:, PARENTS[1:]], axis=-1)
        return np.clip(bones.mean(axis=1) / USUAL_SIZE, SMALLEST, LARGEST).astype(np.float32)[:, None, None]


def thinned(points: Float[Array, "points 3"]) -> Clouds:
    """One cloud (metres), thinned and centred. Neither the order of points nor where the cloud stands matters."""
    from retarget.methods.scan.cloud_kernels import centre, thin

    count = len(points)
    origin = points.mean(axis=0, dtype=np.float64)
    places = np.empty((count, 3), dtype=np.float32)
    firsts, boxes = np.empty(count + 1, dtype=np.int32), np.empty((6, count), dtype=np.float32)
    found, blocks = thin(points, origin, CELL, places, firsts, boxes)
    middle = origin + centre(places, found, boxes, blocks)
    return Clouds(places[None, :found], firsts[None], boxes[None], np.array([blocks]), middle[None])


@lru_cache(maxsize=1)
def basis() -> Float[Array, "basis 3"]:
    """The fixed places, spread in a ball, denser towards its middle; neighbours follow each other."""
    root = 1.2207440846057596  # of x^4 = x + 1: the quasirandom sequence of Roberts 2018
    even = (0.5 + np.arange(1, BASIS + 1)[:, None] * root ** -np.arange(1.0, 4.0)) % 1.0
    height, around, away = 2.0 * even[:, 0] - 1.0, 2.0 * np.pi * even[:, 1], REACH * even[:, 2] ** 0.45
    level = np.sqrt(1.0 - height**2)
    spread = away[:, None] * np.stack([level * np.cos(around), height, level * np.sin(around)], axis=1)
    order = np.lexsort(np.floor(spread / 0.34).T)
    fixed = spread[order].astype(np.float32)
    fixed.flags.writeable = False
    return fixed


def vectors_to(clouds: Clouds, queries: Float[Array, "clouds queries 3"]) -> Float[Array, "clouds queries 3"]:
    """From each query (from the middle of its cloud) to the nearest point of the thinned cloud."""
    from retarget.methods.scan.cloud_kernels import nearest_of_each

    vectors = np.empty(queries.shape, dtype=np.float32)
    queries = np.ascontiguousarray(queries, dtype=np.float32)
    nearest_of_each(queries, clouds.places, clouds.firsts, clouds.boxes, clouds.blocks, vectors)
    return vectors


def first_look(clouds: Clouds) -> Float[Array, "clouds features"]:
    """Vectors from the fixed places, in the world's axes."""
    fixed = np.broadcast_to(basis(), (len(clouds.places), BASIS, 3))
    return vectors_to(clouds, fixed).reshape(len(clouds.places), -1)


def closer_look(clouds: Clouds, bodies: Bodies, whole: bool) -> Float[Array, "clouds features"]:
    """Vectors from places around the joints found so far, each in its joint's axes; with `whole` also from the fixed places,
    laid into the found body's hips and turned with them; and the found pose as the hips see it. In units of the body's size.

    So what is left to learn does not depend on where a body faces, and little on how tall it is.
    """
    size = bodies.sizes
    hips = bodies.turns[:, 0]
    middle = 0.5 * (bodies.places[:, 0] + bodies.places[:, 3])[:, None]
    queries = [_anchors(bodies, size)]
    if whole:
        queries.append(middle + size * np.matmul(basis(), hips.transpose(0, 2, 1)))
    vectors = vectors_to(clouds, np.concatenate(queries, axis=1)) / size
    near = vectors[:, : JOINTS * BONES].reshape(len(hips), JOINTS, BONES, 3)
    parts = [np.matmul(near, bodies.turns), np.matmul(vectors[:, JOINTS * BONES :], hips)]
    parts += [np.matmul((bodies.places - middle) / size, hips)]
    parts += [np.matmul(hips.transpose(0, 2, 1)[:, None], bodies.turns)[..., :2], hips[:, 1], size]
    return np.concatenate([part.reshape(len(hips), -1) for part in parts], axis=1).astype(np.float32)


def _anchors(bodies: Bodies, size: Float[Array, "clouds 1 1"]) -> Float[Array, "clouds anchors 3"]:
    """The places around every joint, and around the middle of its bone."""
    bones = size * np.matmul(bodies.turns, bone_ends()[..., None])[..., 0]
    inner = FIRST_CHILD >= 0
    bones[:, inner] = bodies.places[:, FIRST_CHILD[inner]] - bodies.places[:, inner]
    spread = size[..., None] * np.matmul(_offsets(), bodies.turns.transpose(0, 1, 3, 2))
    spread += bodies.places[:, :, None]
    spread[:, :, 6:] += 0.5 * bones[:, :, None]
    return spread.reshape(len(spread), -1, 3)


@lru_cache(maxsize=1)
def bone_ends() -> Float[Array, "joints 3"]:
    ends = np.zeros((JOINTS, 3), dtype=np.float32)
    for joint, end in _ENDS.items():
        ends[joint] = end
    return ends


@lru_cache(maxsize=1)
def _offsets() -> Float[Array, "bones 3"]:
    axes = AROUND_JOINT * np.concatenate([np.eye(3), -np.eye(3)])
    corners = AROUND_BONE * np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(8, 3)
    return np.concatenate([axes, corners]).astype(np.float32)


def gathered(six: Float[Array, "*batch 6"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of their first two columns, made orthonormal (Zhou et al. 2019, "On the continuity of rotation
    representations in neural networks")."""
    first = _unit(six[..., :3])
    second = _unit(six[..., 3:] - (first * six[..., 3:]).sum(axis=-1, keepdims=True) * first)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _unit(vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
