"""The nearest point of a body's surface whose normal agrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.contact.sensor_bones import Stance

Array = np.ndarray

CANDIDATES = 24
SAMPLING = 0.02
"""Faces longer than this share of height are found by several points, at most `FINEST` along an edge."""
FINEST = 12


@dataclass(frozen=True, eq=False)
class TargetSurface:
    """A body in the stance, in shares of its height, ready for closest points."""

    corners: Float[Array, "faces 3 3"]
    normals: Float[Array, "faces 3"]
    faces: Int[Array, "faces"]
    """Numbers of these faces in the character's mesh; props and faces without area are left out."""
    owners: Int[Array, "samples"]
    """The face of each sample."""
    tree: Any
    """Of points spread over the faces."""

    @classmethod
    def of(cls, stance: Stance) -> TargetSurface:
        from scipy.spatial import cKDTree

        corners = stance.vertices[stance.faces] / stance.height
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        kept = np.flatnonzero(stance.body & (np.linalg.norm(normals, axis=1) > 1e-12))
        corners, normals = corners[kept], rot.unit(normals[kept])
        samples, owners = _spread(corners)
        return cls(corners, normals, kept, owners, cKDTree(samples))

    def project(
        self, points: Float[Array, "points 3"], normals: Float[Array, "points 3"], strictness: float
    ) -> tuple[Int[Array, "points"], Float[Array, "points 3"], Float[Array, "points 3"], Float[Array, "points"]]:
        """Face, barycentrics and place nearest to each point, and the cosine of its normal with the wanted one.

        An opposite normal counts like `2 strictness` (shares of height) of distance.
        """
        count = min(CANDIDATES, len(self.owners))
        near = self.owners[self.tree.query(points, k=count)[1].reshape(len(points), count)]
        triangles = self.corners[near]
        shares = closest_barycentrics(points[:, None], triangles)
        places = np.einsum("pkc,pkci->pki", shares, triangles)
        agree = np.einsum("pki,pi->pk", self.normals[near], normals)
        away = np.linalg.norm(places - points[:, None], axis=-1) + strictness * (1.0 - agree)
        best, row = away.argmin(axis=1), np.arange(len(points))
        return self.faces[near[row, best]], shares[row, best], places[row, best], agree[row, best]


def _spread(corners: Float[Array, "faces 3 3"]) -> tuple[Float[Array, "samples 3"], Int[Array, "samples"]]:
    """Points over every face, more on larger ones, and the face of each."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    pieces = np.clip(np.ceil(longest / SAMPLING), 1, FINEST).astype(int)
    samples, owners = [], []
    for count in np.unique(pieces):
        i, j = np.meshgrid(np.arange(count), np.arange(count))
        inside = i + j < count
        first, second = ((each[inside] + 1 / 3) / count for each in (i, j))
        shares = np.stack([first, second, 1.0 - first - second], axis=1)
        which = np.flatnonzero(pieces == count)
        samples.append((shares @ corners[which]).reshape(-1, 3))
        owners.append(np.repeat(which, len(shares)))
    return np.concatenate(samples), np.concatenate(owners)


def closest_barycentrics(
    points: Float[Array, "*#batch 3"], corners: Float[Array, "*batch 3 3"]
) -> Float[Array, "*batch 3"]:
    """Barycentrics of the point of each triangle that is closest to each point."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac, ap = b - a, c - a, points - a

    def dot(p: Array, q: Array) -> Array:
        return (p * q).sum(axis=-1)

    bb, bc, cc, pb, pc = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    area = np.maximum(bb * cc - bc * bc, 1e-30)
    second, third = (cc * pb - bc * pc) / area, (bb * pc - bc * pb) / area
    inner = np.stack([1.0 - second - third, second, third], axis=-1)
    # On an edge where the foot of the perpendicular lies outside: the nearest of the three edges' closest points.
    pp, edge = dot(ap, ap), np.maximum(bb - 2 * bc + cc, 1e-30)
    t = np.clip(pb / np.maximum(bb, 1e-30), 0, 1), np.clip(pc / np.maximum(cc, 1e-30), 0, 1)
    u = np.clip((pc - pb + bb - bc) / edge, 0, 1)
    zero = np.zeros_like(u)
    outer = np.stack(
        [np.stack(each, axis=-1) for each in ((1 - t[0], t[0], zero), (1 - t[1], zero, t[1]), (zero, 1 - u, u))],
        axis=-2,
    )
    v, w = outer[..., 1], outer[..., 2]
    away = pp[..., None] - 2 * (v * pb[..., None] + w * pc[..., None]) + (
        v * v * bb[..., None] + 2 * v * w * bc[..., None] + w * w * cc[..., None]
    )  # fmt: skip
    best = np.take_along_axis(outer, away.argmin(axis=-1)[..., None, None], axis=-2)[..., 0, :]
    return np.where((inner >= 0).all(axis=-1, keepdims=True), inner, best)
