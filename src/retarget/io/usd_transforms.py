"""Transforms of USD prims and joints as glTF nodes have them. Runs in the child."""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.child import Refused

SHEAR = 1e-4
"""Part of a matrix's size by which it may differ from rotation times scale."""


def decomposed(matrix: np.ndarray) -> dict[str, list[float]]:
    """Translation, rotation (xyzw) and scale of an affine matrix (4, 4; columns); itself, if it is sheared."""
    translation, rotation, scale, straight = split(matrix[None])
    if not straight[0]:
        return {"matrix": matrix.T.ravel().tolist()}
    return {"translation": translation[0].tolist(), "rotation": rotation[0].tolist(), "scale": scale[0].tolist()}


def split(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Translations, rotations (xyzw), scales of affine matrices (n, 4, 4), and which of them are no more than that.

    The rotation is the nearest one (polar decomposition); a mirroring matrix has three negative scales.
    """
    linear = matrices[:, :3, :3]
    sign = np.where(np.linalg.det(linear) < 0, -1.0, 1.0)[:, None, None]
    u, _, vt = np.linalg.svd(linear * sign)
    turn = u @ vt
    shape = np.swapaxes(turn, 1, 2) @ linear
    scale = np.diagonal(shape, axis1=1, axis2=2)
    rest = np.abs(shape - scale[:, :, None] * np.eye(3)).max(axis=(1, 2), initial=0)
    return matrices[:, :3, 3], quaternions(turn), scale, rest <= SHEAR * np.abs(shape).max(axis=(1, 2), initial=0)


def quaternions(turns: np.ndarray) -> np.ndarray:
    """Unit quaternions xyzw of rotation matrices (n, 3, 3), by the largest of the four components."""
    m = turns
    trace = np.trace(m, axis1=1, axis2=2)
    squares = np.stack([*(1 + 2 * m[:, axis, axis] - trace for axis in range(3)), 1 + trace], axis=1)
    x, y, z, w = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1], squares[:, 3]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    rows = np.stack([
        np.stack([squares[:, 0], xy, xz, x], axis=1), np.stack([xy, squares[:, 1], yz, y], axis=1),
        np.stack([xz, yz, squares[:, 2], z], axis=1), np.stack([x, y, z, w], axis=1),
    ], axis=1)  # fmt: skip
    chosen = rows[np.arange(len(m)), squares.argmax(axis=1)]
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


def placement(prim: Any, code: float | None = None) -> np.ndarray:
    """World-from-prim (4, 4; columns) at a time code, the first if none is given. Raises `Refused` for a flat one."""
    from pxr import Usd, UsdGeom

    time = Usd.TimeCode.EarliestTime() if code is None else Usd.TimeCode(code)
    matrix = np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(time), dtype=np.float64).T
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 1e12 or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise Refused(f"{prim.GetPath()} is scaled to nothing, or placed nowhere")
    return matrix
