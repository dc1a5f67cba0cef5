"""Forward kinematics: local rotations to world transforms, all frames at once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.character import Motion, Skeleton

Array = np.ndarray

FEW = 64
"""Frames up to which `_forward_few` takes less time: a fourth for one frame, equally much for a hundred."""


def levels(parents: Int[Array, "joints"]) -> tuple[Int[Array, "level"], ...]:
    """Joints grouped by their depth in the tree, root first: a group needs only the groups before it."""
    return _levels(tuple(np.asarray(parents).tolist()))


@lru_cache(maxsize=32)
def _levels(parents: tuple[int, ...]) -> tuple[Int[Array, "level"], ...]:
    depth = np.zeros(len(parents), dtype=int)
    for joint, parent in enumerate(parents):
        depth[joint] = 0 if parent < 0 else depth[parent] + 1
    groups = tuple(np.flatnonzero(depth == d) for d in range(depth.max() + 1))
    for group in groups:
        group.flags.writeable = False  # every caller gets the same arrays
    return groups


def forward(
    parents: Int[Array, "joints"],
    rotations: Float[Array, "*frames joints 4"],
    positions: Float[Array, "*frames joints 3"],
) -> tuple[Float[Array, "*frames joints 4"], Float[Array, "*frames joints 3"]]:
    """World rotations and positions of all joints from local ones (parent-from-joint)."""
    if rotations[..., 0, 0].size <= FEW:
        return _forward_few(parents, rotations, positions)
    world_rotations, world_positions = np.empty_like(rotations), np.empty(rotations.shape[:-1] + (3,))
    for level in levels(parents):
        above = parents[level]
        if above[0] < 0:
            world_rotations[..., level, :] = rotations[..., level, :]
            world_positions[..., level, :] = positions[..., level, :]
            continue
        turn = world_rotations[..., above, :]
        world_rotations[..., level, :] = rot.multiply(turn, rotations[..., level, :])
        world_positions[..., level, :] = world_positions[..., above, :] + rot.rotate(turn, positions[..., level, :])
    return world_rotations, world_positions


def _forward_few(
    parents: Int[Array, "joints"],
    rotations: Float[Array, "*frames joints 4"],
    positions: Float[Array, "*frames joints 3"],
) -> tuple[Float[Array, "*frames joints 4"], Float[Array, "*frames joints 3"]]:
    """`forward` of few frames, where the number of calls is what takes time: one product with a matrix for each level."""
    first, *others = levels(parents)
    turns, right = rotations.copy(), rot.right_matrices(rotations)
    for level in others:
        turns[..., level, :] = np.matmul(right[..., level, :, :], turns[..., parents[level], :, None])[..., 0]
    places = rot.rotate(turns[..., np.maximum(parents, 0), :], positions)
    places[..., first, :] = positions[..., first, :]
    for level in others:
        places[..., level, :] += places[..., parents[level], :]
    return turns, places


def local_rotations(
    parents: Int[Array, "joints"], world_rotations: Float[Array, "*frames joints 4"]
) -> Float[Array, "*frames joints 4"]:
    """Parent-from-joint rotations of given world rotations: the inverse of `forward`."""
    local = world_rotations.copy()
    child = np.flatnonzero(parents >= 0)
    local[..., child, :] = rot.multiply(
        rot.inverse(world_rotations[..., parents[child], :]), world_rotations[..., child, :]
    )
    return local


def local_positions(
    skeleton: Skeleton, translations: Float[Array, "frames moved 3"], moved: Sequence[int]
) -> Float[Array, "frames joints 3"]:
    """The skeleton's offsets with the moved joints put in their place."""
    positions = np.broadcast_to(skeleton.offsets, (len(translations), len(skeleton), 3)).copy()
    positions[:, list(moved)] = translations
    return positions


def world_pose(motion: Motion) -> tuple[Float[Array, "frames joints 4"], Float[Array, "frames joints 3"]]:
    """World rotations and positions of all joints of a motion."""
    positions = local_positions(motion.skeleton, motion.translations, motion.moved)
    return forward(motion.skeleton.parents, motion.rotations, positions)


def rest_pose(skeleton: Skeleton) -> tuple[Float[Array, "joints 4"], Float[Array, "joints 3"]]:
    """World rotations and positions of all joints at rest."""
    return forward(skeleton.parents, skeleton.rest_rotations, skeleton.offsets)


def joint_transforms(
    world_rotations: Float[Array, "*frames joints 4"], world_positions: Float[Array, "*frames joints 3"]
) -> Float[Array, "*frames joints 4 4"]:
    """The same as matrices `T_world_joint`."""
    T_world_joint = np.zeros(world_rotations.shape[:-1] + (4, 4))
    T_world_joint[..., :3, :3] = rot.to_matrix(world_rotations)
    T_world_joint[..., :3, 3] = world_positions
    T_world_joint[..., 3, 3] = 1.0
    return T_world_joint


def still_motion(skeleton: Skeleton, frames: int = 1, fps: float = 30.0, name: str = "rest") -> Motion:
    """A motion that holds the rest pose."""
    return Motion(
        skeleton,
        np.broadcast_to(skeleton.rest_rotations, (frames, len(skeleton), 4)).copy(),
        np.broadcast_to(skeleton.offsets[:1], (frames, 1, 3)).copy(),
        fps,
        name=name,
    )
