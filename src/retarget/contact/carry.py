"""Carry places from one body's skin to another's through their dense sensors, with no common mesh.

The nearest sensor alone errs by about 1% of height on the trunk. Better, and ours throughout:

1. Both bodies stand in the common stance; sensors valid on both are pairs (place on the source, place on the target).
2. The pairs are improved together. Some rounds of: each target place moves to the nearby surface point whose normal
   is most like the source's, then all are replaced by what their neighbours say (moving least squares, affine). Rays
   depend on where a rig puts its joints; surfaces do not: of an error from joints 1.5% of height off, a third goes.
3. A point is carried by the affine map that fits the pairs around it best, then put on the target's surface where
   the normal agrees. Neighbours are near in place, in normal and in the limb they belong to, whichever bone cast them,
   so that no jump shows where one bone's sensors end.

Weights only say who is a neighbour, joints only where rays start: a rig with fewer joints or harder weights
changes little (`tests/contact/test_carry.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.contact.sensor_bones import Stance
from retarget.contact.sensor_surface import TargetSurface
from retarget.contact.sensors import Sensors, surface_points
from retarget.errors import RetargetError

Array = np.ndarray

NORMAL, LIMB = 0.035, 0.08
"""When neighbours are chosen, unlike normals (by their difference) and other limbs count as so many shares of height."""
NEIGHBOURS, ROUND_NEIGHBOURS = 20, 40
NODES = 2000
"""Pairs that are improved together, about."""
FEWEST = 100
"""Pairs without which nothing is carried."""
STIFF = 0.01
"""Share of a uniform scaling in each local affine map: decides where neighbours lie in a plane."""
NEAR, PULL = 0.03, 0.3
"""Shares of height by which a point goes astray rather than to a surface whose normal stands at right angles to the
wanted one: when it is carried, and when pairs are improved."""
CHUNK = 20_000
"""Points carried in one go: bounds the memory."""
TRUSTED = 0.25
"""Confidence from which a carried point counts as valid."""


@dataclass(frozen=True, eq=False)
class Carried:
    """Places on the target, one for each point of the source."""

    faces: Int[Array, "points"]
    barycentrics: Float[Array, "points 3"]
    confidence: Float[Array, "points"]
    """From 0 to 1: how near the pairs lie, how near the target's surface is to where they point, how normals agree."""

    @property
    def valid(self) -> Bool[Array, "points"]:
        return self.confidence > TRUSTED


@dataclass(frozen=True, eq=False)
class Carrier:
    """Carries points from one body to another; `prepare_carry` makes one."""

    source: Sensors
    target: Sensors
    pairs: _Pairs
    surface: TargetSurface

    def __call__(self, faces: Int[Array, "points"], barycentrics: Float[Array, "given 3"]) -> Carried:
        """Where points of the source's mesh lie on the target's.

        Raises `RetargetError` for faces that the source does not have and barycentrics of another number.
        """
        stance = self.source.stance
        faces, barycentrics = np.asarray(faces), np.asarray(barycentrics, dtype=np.float64)
        if faces.ndim != 1 or barycentrics.shape != (len(faces), 3):
            raise RetargetError(
                f"points are (n,) faces and (n, 3) barycentrics, received {faces.shape} and {barycentrics.shape}"
            )
        outside = faces[(faces < 0) | (faces >= len(stance.faces))]
        if len(outside):
            raise RetargetError(f"a point lies on face {outside[0]}; the source has {len(stance.faces)} faces")
        carried = Carried(np.empty(len(faces), np.int64), np.empty((len(faces), 3)), np.empty(len(faces)))
        for start in range(0, len(faces), CHUNK):
            part = slice(start, start + CHUNK)
            carried.faces[part], carried.barycentrics[part], carried.confidence[part] = self._carry(
                faces[part], barycentrics[part]
            )
        return carried

    def _carry(self, faces: Array, barycentrics: Array) -> tuple[Array, Array, Array]:
        points, normals, limbs = _stanced(self.source.stance, faces, barycentrics)
        images, wanted, apart = self.pairs.map(points, normals, limbs, NEIGHBOURS)
        found, shares, places, agree = self.surface.project(images, wanted, NEAR)
        missed = np.linalg.norm(places - images, axis=1)
        confidence = np.exp(-((missed / 0.03) ** 2) - (apart / 0.06) ** 2) * np.clip(0.5 + agree, 0.0, 1.0)
        return found, shares, confidence


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Places on the source and their images on the target, in the stance, in shares of each body's height."""

    anchors: Float[Array, "nodes 3"]
    normals: Float[Array, "nodes 3"]
    limbs: Float[Array, "nodes limbs"]
    images: Float[Array, "nodes 3"]
    image_normals: Float[Array, "nodes 3"]
    tree: Any

    def map(self, points: Array, normals: Array, limbs: Array, neighbours: int) -> tuple[Array, Array, Array]:
        """Images of points, the normals to expect there, and how far away the nearest pair is."""
        distance, near = self.tree.query(_key(points, normals, limbs), k=min(neighbours, len(self.anchors)))
        weight = np.maximum(1.0 - (distance / distance[:, -1:].clip(1e-9)) ** 2, 1e-3) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        images = _affine(points, self.anchors[near], self.images[near], weight)
        return images, rot.unit(np.einsum("pk,pki->pi", weight, self.image_normals[near])), distance[:, 0]


def _key(points: Array, normals: Array, limbs: Array) -> Float[Array, "points key"]:
    return np.concatenate([points, NORMAL * normals, LIMB * limbs], axis=1)


def _affine(
    points: Float[Array, "points 3"],
    anchors: Float[Array, "points near 3"],
    images: Float[Array, "points near 3"],
    weight: Float[Array, "points near"],
) -> Float[Array, "points 3"]:
    """Each point through the affine map that takes its anchors to their images best (weighted least squares)."""
    here, there = ((weight[:, None] @ each)[:, 0] for each in (anchors, images))
    p, q = anchors - here[:, None], images - there[:, None]
    weighted = (weight[..., None] * p).transpose(0, 2, 1)
    spread, mixed = weighted @ p, (weighted @ q).transpose(0, 2, 1)
    size = np.trace(spread, axis1=1, axis2=2) + 1e-12
    scale = np.sqrt(np.einsum("pk,pki,pki->p", weight, q, q) / size)
    stiff = STIFF * size[:, None, None] * np.eye(3)
    turned = np.linalg.solve(spread + stiff, (mixed + scale[:, None, None] * stiff).transpose(0, 2, 1))
    return there + ((points - here)[:, None] @ turned)[:, 0]


def prepare_carry(source: Sensors, target: Sensors, rounds: int = 4) -> Carrier:
    """Pair two bodies by their sensors, which must have one (dense) layout; `rounds` of improvement, 0 for none.

    Raises `RetargetError` for sensors of different layouts and for bodies that share too few valid sensors.
    """
    if len(source) != len(target) or not all(
        np.array_equal(getattr(source.layout, name), getattr(target.layout, name))
        for name in ("bones", "along", "around")
    ):
        raise RetargetError(f"sensors correspond on one layout only; received {len(source)} and {len(target)} sensors")
    both = np.flatnonzero(source.valid & target.valid)
    if len(both) < FEWEST:
        raise RetargetError(
            f"only {len(both)} of {len(source)} sensors lie on both bodies, {FEWEST} are needed: use dense_layout(), "
            "and check that joints and surface belong together"
        )
    surface = TargetSurface.of(target.stance)
    pairs = _pair(source, target, both[:: max(1, len(both) // NODES)] if rounds else both)
    for _ in range(rounds):
        pairs = _improved(pairs, surface)
    return Carrier(source, target, pairs, surface)


def _pair(source: Sensors, target: Sensors, which: Int[Array, "nodes"]) -> _Pairs:
    from scipy.spatial import cKDTree

    here, there = (_stanced(each.stance, each.faces[which], each.barycentrics[which]) for each in (source, target))
    return _Pairs(*here, images=there[0], image_normals=there[1], tree=cKDTree(_key(*here)))


def _stanced(stance: Stance, faces: Array, barycentrics: Array) -> tuple[Array, Array, Array]:
    """Places in shares of height, normals and limbs of points of a body in the stance."""
    points = surface_points(stance.vertices, stance.faces, faces, barycentrics) / stance.height
    normals = rot.unit(surface_points(stance.normals, stance.faces, faces, barycentrics))
    return points, normals, surface_points(stance.limbs(), stance.faces, faces, barycentrics)


def _improved(pairs: _Pairs, surface: TargetSurface) -> _Pairs:
    """One round: images onto the surface where the normal is most like the source's, then smoothed."""
    _, _, places, _ = surface.project(pairs.images, pairs.normals, PULL)
    pulled = replace(pairs, images=places)
    images, normals, _ = pulled.map(pairs.anchors, pairs.normals, pairs.limbs, ROUND_NEIGHBOURS)
    return replace(pairs, images=images, image_normals=normals)


def carry(
    faces: Int[Array, "points"], barycentrics: Float[Array, "points 3"], source: Sensors, target: Sensors
) -> Carried:
    """Take places on the source's skin to the target's; for many calls on one pair keep a `prepare_carry`."""
    return prepare_carry(source, target)(faces, barycentrics)
