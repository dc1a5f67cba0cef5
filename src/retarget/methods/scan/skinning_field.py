"""The skinning field in use: how much each point of a resting cloud goes with each of its joints.

The paper's SKIN (Rekik 2023, section 3.4) maps the distances of a point to the 22 joints to weights, and is learnt
from posed points. Ours also sees how far the point is from every bone, and where it lies along and across each; in units
of the body's size, so a child is no other case than an adult; it sees where flesh lies around each joint, which tells how a
regressor has erred; and it is learnt from the weights themselves (cross-entropy).
`train/skinning_field.py` is its recipe, `docs/models/skinning_field.md` its card.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.io.onnx_network import open_network
from retarget.methods.scan.features import FIRST_CHILD, JOINTS, PARENTS, USUAL_SIZE, bone_ends
from retarget.methods.scan.regressor import FOLDER

Array = np.ndarray

FILE = "skinning_field.onnx"
VERSION = "2"
"""Of the weights' file; others are refused."""
KIND = "skinning-field"
AT_ONCE = 4096
"""Points that go through the network together."""
MOST = 20_000
"""Points of the body that are weighed at most, evenly chosen."""
SPREADS = (0.3, 0.8)
"""How far around a joint its flesh is weighed, in units of the body's size: standard deviations."""


@dataclass(frozen=True, eq=False)
class SkinningField:
    """Weights of points; `load_field()` makes it."""

    network: Any
    """Session of ONNX Runtime."""

    def __call__(
        self,
        points: Float[Array, "points 3"],
        joints: Float[Array, "joints 3"],
        turns: Float[Array, "joints 4"],
        cloud: Float[Array, "many 3"],
    ) -> Float[Array, "points joints"]:
        """Skinning weights of points of a body at rest (metres, a T, an A, or arms down): not negative, rows sum to one.

        `joints` are its 22 joints and `turns` their rotations in the world from the embedded human's rest pose (quaternions
        xyzw), both as the regressor gives them; `cloud` is the body that they were found in, by points that are spread evenly
        over it, as a scan's are and a mesh's vertices are not. Raises `RetargetError` where shapes do not fit, a number is not
        finite, or `cloud` is empty.
        """
        if not len(cloud):
            raise RetargetError("a skinning field needs points of the body that the joints were found in, received none")
        if points.shape[1:] != (3,) or cloud.shape[1:] != (3,) or joints.shape != (JOINTS, 3) or turns.shape != (JOINTS, 4):
            raise RetargetError(
                f"a skinning field takes points x 3, {JOINTS} x 3 joints and {JOINTS} x 4 turns, received arrays of shapes "
                f" {points.shape}, {joints.shape} and {turns.shape}"
            )
        if not all(np.isfinite(each).all() for each in (points, joints, turns, cloud)):
            raise RetargetError("points, joints and turns of a skinning field must be finite numbers")
        matrices, weights = rot.to_matrix(turns), np.empty((len(points), JOINTS))
        around = flesh(cloud, joints, matrices)
        for start in range(0, len(points), AT_ONCE):
            seen = field_features(points[start : start + AT_ONCE], joints, matrices, around)
            (out,) = self.network.run(None, {"features": seen})
            weights[start : start + AT_ONCE] = softmax(out.astype(np.float64))
        return weights


def field_features(
    points: Float[Array, "points 3"],
    joints: Float[Array, "joints 3"],
    turns: Float[Array, "joints 3 3"],
    around: Float[Array, "figures"],
) -> Float[Array, "points features"]:
    """What the field sees of each point: its distance to every joint and every bone, how far along each bone it lies, and where
    it is from each joint in that joint's axes; in units of the body's size. Then the body's `flesh`."""
    size = _size(joints)
    bones = np.matmul(turns, bone_ends()[..., None])[..., 0] * (size / USUAL_SIZE)
    inner = FIRST_CHILD >= 0
    bones[inner] = joints[FIRST_CHILD[inner]] - joints[inner]
    arms = (points[:, None] - joints) / size
    bones = bones / size
    along = np.einsum("pja,ja->pj", arms, bones) / np.maximum((bones**2).sum(axis=1), 1e-9)
    beside = arms - np.clip(along, 0.0, 1.0)[..., None] * bones
    own = np.einsum("pja,jab->pjb", arms, turns)
    parts = [np.linalg.norm(arms, axis=2), np.linalg.norm(beside, axis=2), np.clip(along, -2.0, 3.0)]
    body = np.broadcast_to(around, (len(points), len(around)))
    return np.concatenate([*parts, own.reshape(len(points), -1), body], axis=1).astype(np.float32)


def flesh(
    points: Float[Array, "points 3"], joints: Float[Array, "joints 3"], turns: Float[Array, "joints 3 3"]
) -> Float[Array, "figures"]:
    """Where the middle of the skin around each joint lies, in the joint's axes, and how far it is off on average; near and wide.
    Points should be spread evenly."""
    size = _size(joints)
    points = points[:: -(-len(points) // MOST)]
    arms = (points[:, None] - joints) / size
    squares = (arms**2).sum(axis=2)
    figures = []
    for spread in SPREADS:
        shares = np.exp(-0.5 * squares / spread**2) + 1e-9
        shares /= shares.sum(axis=0)
        figures.append(np.einsum("pj,pja,jab->jb", shares, arms, turns).ravel())
        figures.append((shares * np.sqrt(squares)).sum(axis=0))
    return np.concatenate(figures).astype(np.float32)


def _size(joints: Float[Array, "joints 3"]) -> float:
    return float(np.linalg.norm(joints[1:] - joints[PARENTS[1:]], axis=1).mean())


def softmax(scores: Float[Array, "points joints"]) -> Float[Array, "points joints"]:
    """Shares that sum to one."""
    shares = np.exp(scores - scores.max(axis=1, keepdims=True))
    return shares / shares.sum(axis=1, keepdims=True)


@lru_cache(maxsize=4)
def load_field(folder: Path = FOLDER) -> SkinningField:
    """The field with the package's weights, or those of a folder. Raises `FileError` for weights that are missing, damaged or of
    another version."""
    return SkinningField(open_network(folder / FILE, KIND, VERSION))
