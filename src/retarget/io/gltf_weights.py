"""Skinning weights of glTF primitives: read, repaired where they are none, and put into the form that files hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.io.gltf_document import Document

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Influences:
    """Joints (numbers within the skin) and weights of the vertices of one primitive; rows of weights sum to one."""

    joints: Int[Array, "vertices influences"]
    weights: Float[Array, "vertices influences"]
    faults: tuple[str, ...]
    """What had to be mended, in words."""
    clean: bool
    """Whether the file's own data may stay in a written file: valid but for the last digit."""


def read_influences(document: Document, attributes: dict[str, int], count: int, bones: int, place: str) -> Influences:
    """All sets of joints and weights side by side. Raises `FileError` for missing rows and joints beyond the skin's."""
    joint_sets, weight_sets = [], []
    while f"JOINTS_{len(joint_sets)}" in attributes and f"WEIGHTS_{len(joint_sets)}" in attributes:
        number = len(joint_sets)
        joint_sets.append(document.integers(attributes[f"JOINTS_{number}"], ("VEC4",)))
        weight_sets.append(document.decoded(attributes[f"WEIGHTS_{number}"], ("VEC4",)))
        if len(joint_sets[-1]) != count or len(weight_sets[-1]) != count:
            rows = f"{len(joint_sets[-1])} joint and {len(weight_sets[-1])} weight rows"
            raise document.fail(f"has {rows} for {count} vertices", place)
    joints, weights = np.concatenate(joint_sets, axis=1), np.concatenate(weight_sets, axis=1)
    faults = []
    spoilt = ~np.isfinite(weights) | (weights < 0) | (weights > 1e6)
    if spoilt.any():
        rows = int(spoilt.any(axis=1).sum())
        faults.append(
            f"{place}: {rows} vertices have weights that are negative or not numbers; these are taken as zero"
        )
        weights[spoilt] = 0.0
    joints = np.where(weights > 0, joints, 0)
    if joints.size and joints.max() >= bones:
        vertex = int(joints.max(axis=1).argmax())
        raise document.fail(f"vertex {vertex} follows joint {int(joints.max())} of a skin of {bones}", place)
    total = weights.sum(axis=1)
    loose = total <= 1e-9
    if loose.any():
        faults.append(f"{place}: {int(loose.sum())} vertices have no weights; they follow the skin's first joint")
        weights[loose], joints[loose], weights[loose, 0] = 0.0, 0, 1.0
    uneven = ~loose & (np.abs(total - 1) > 0.02)
    if uneven.any():
        faults.append(f"{place}: the weights of {int(uneven.sum())} vertices do not sum to one; they are scaled")
    ordered = np.sort(np.where(weights > 0, joints, -1 - np.arange(joints.shape[1])), axis=1)
    twice = (ordered[:, 1:] == ordered[:, :-1]).any()
    # A sum of rounded single precision numbers is off by a few 1e-7; validators refuse more.
    clean = not faults and not twice and bool((np.abs(total - 1) <= 5e-7).all())
    return Influences(joints, weights / weights.sum(axis=1, keepdims=True), tuple(faults), clean)


def merge_influences(
    joints: Int[Array, "vertices influences"], weights: Float[Array, "vertices influences"]
) -> tuple[Int[Array, "vertices sets"], Float[Array, "vertices sets"]]:
    """As glTF wants them: each joint once a vertex, the heaviest first, joint 0 where the weight is zero.

    The width becomes a multiple of four; weights are single precision and still sum to one.
    """
    order = np.argsort(np.where(weights > 0, joints, np.iinfo(np.int64).max), axis=1, kind="stable")
    joints, weights = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1)
    for k in range(joints.shape[1] - 1, 0, -1):
        same = (joints[:, k] == joints[:, k - 1]) & (weights[:, k] > 0)
        weights[same, k - 1] += weights[same, k]
        weights[same, k] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    joints, weights = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1)
    used = max(int((weights > 0).any(axis=0).sum()), 1)
    width = -(-used // 4) * 4
    padding = ((0, 0), (0, max(0, width - joints.shape[1])))
    joints, weights = np.pad(joints, padding)[:, :width], np.pad(weights, padding)[:, :width]
    single = weights.astype(np.float32)
    single[:, 0] = 1.0 - single[:, 1:].sum(axis=1, dtype=np.float64)
    return np.where(single > 0, joints, 0), single
