"""The five tips of a body, found on a bare surface in any pose and told apart.

Head, hands and feet are the points farthest from each other along the surface. Which is which follows from their distances;
that a hand and a foot belong to one side, from the sides' functions agreeing on the trunk; what is in front, from the
orientation of the surface. What remains is the turn by half a circle, which keeps orientation: for that, both are handed on
to be fitted. Ours; the recipe of geodesic extremities is common, the votes are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from retarget.geometry.geodesic import Geodesics
from retarget.geometry.resample import Surface
from retarget.geometry.spectral import SpectralBasis

Array = np.ndarray

TIPS = ("head", "leftHand", "rightHand", "leftFoot", "rightFoot")
SMOOTH = 30
"""Eigenfunctions that the front's function keeps."""
FRONT = 0.25
"""Weight of the front's function beside distances of mean one, where points are matched."""


@dataclass(frozen=True, eq=False)
class IntrinsicBody:
    """A surface with what is needed to find and tell apart its tips."""

    surface: Surface
    basis: SpectralBasis
    geodesics: Geodesics


@dataclass(frozen=True, eq=False)
class Labelled:
    """Tips with their names, and the functions they span."""

    tips: Int[Array, "5"]
    """Vertices, in the order of `TIPS`."""
    distances: Float[Array, "vertices 5"]
    """From each tip."""
    front: Float[Array, "vertices"]
    """1 in front, -1 behind, smooth."""
    twist: float
    """How far the directions from right to left agree between arms and legs on the trunk, -1 to 1: below nought the hands or
    the feet are exchanged."""
    misfit: float
    """Root mean square of the logarithms of the tips' distances over the template's; 0 for the template itself."""

    @property
    def features(self) -> Float[Array, "vertices 6"]:
        """Coordinates by which points of two bodies with the same tips are matched."""
        return np.concatenate([self.distances / self.distances.mean(), FRONT * self.front[:, None]], axis=1)


def find_tips(body: IntrinsicBody, count: int = 5) -> Int[Array, "tips"]:
    """The points farthest from the body's middle, and from each other."""
    distance = body.geodesics.distance
    rims = [distance(0)]
    for _ in range(5):
        rims.append(distance(int(np.min(rims, axis=0).argmax())))
    middle = int(np.sort(rims, axis=0)[-4:].sum(axis=0).argmin())
    nearest, tips = distance(middle), []
    while len(tips) < count:
        tips.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distance(tips[-1]))
    return np.array(tips)


def label_tips(body: IntrinsicBody, tips: Int[Array, "5"], misfit: float = 0.0) -> Labelled:
    """The functions that tips in the order of `TIPS` span."""
    distances = body.geodesics.distances(tips)
    front, twist = _front(body, distances)
    return Labelled(tips, distances, front, twist, misfit)


def labellings(
    body: IntrinsicBody, template: Labelled, tips: Int[Array, "tips"], choices: int = 2
) -> Iterator[Labelled]:
    """The likeliest ways of naming the tips, with left and right both ways: two for each choice of head, hands and feet,
    choices whose distances are most like the template's first."""
    between = body.geodesics.distances(tips)[tips]
    upper = np.triu_indices(5, 1)
    wanted = np.log(template.distances[template.tips][upper])
    ranked: list[tuple[float, list[int]]] = []
    for order in _assignments(len(tips)):
        found = np.log(np.maximum(between[np.ix_(order, order)][upper], 1e-9)) - wanted
        ranked.append((float(found.std()), order))
    ranked.sort(key=lambda entry: entry[0])
    taken: set[tuple[int, frozenset[int], frozenset[int]]] = set()
    for misfit, (head, a, b, c, d) in ranked:
        choice = (head, frozenset((a, b)), frozenset((c, d)))
        if choice in taken:
            continue
        if len(taken) == choices:
            return
        taken.add(choice)
        straight, crossed = (label_tips(body, tips[[head, a, b, *feet]], misfit) for feet in ((c, d), (d, c)))
        first = straight if straight.twist >= crossed.twist else crossed
        yield first
        swapped = first.tips[[0, 2, 1, 4, 3]]
        yield Labelled(swapped, first.distances[:, [0, 2, 1, 4, 3]], -first.front, first.twist, misfit)


def _assignments(count: int) -> Iterator[list[int]]:
    """Head, hands and feet among the tips; one order of the hands, both of the feet."""
    for head in range(count):
        rest = [tip for tip in range(count) if tip != head]
        for hands in combinations(rest, 2):
            for feet in combinations([tip for tip in rest if tip not in hands], 2):
                yield [head, *hands, *feet]
                yield [head, *hands, *feet[::-1]]


def _front(body: IntrinsicBody, distances: Float[Array, "vertices 5"]) -> tuple[Float[Array, "vertices"], float]:
    """The front's function, and the agreement of arms and legs about the sides.

    With f growing to the left and g to the feet, (grad g x grad f) . normal is positive in front of an outward oriented
    surface; in any pose, since all three are of the surface.
    """
    head, left_hand, right_hand, left_foot, right_foot = distances.T
    arms, legs = right_hand - left_hand, right_foot - left_foot
    down = head - np.minimum(left_foot, right_foot)
    normals, area = _face_normals(body.surface)
    towards_left, towards_feet = (_gradient(body.surface, f, normals, area) for f in (arms + legs, down))
    lengths = np.linalg.norm(towards_left, axis=1) * np.linalg.norm(towards_feet, axis=1)
    signs = np.einsum("fx,fx->f", np.cross(towards_feet, towards_left), normals) / np.maximum(lengths, 1e-9)
    front = body.basis.smooth(_on_vertices(body.surface, signs, area), SMOOTH)
    by_arms, by_legs = (_gradient(body.surface, f, normals, area) for f in (arms, legs))
    lengths = np.linalg.norm(by_arms, axis=1) * np.linalg.norm(by_legs, axis=1)
    agreement = _on_vertices(body.surface, (by_arms * by_legs).sum(axis=1) / np.maximum(lengths, 1e-9), area)
    away = distances.min(axis=1)
    return front, float(agreement[away > np.quantile(away, 0.6)].mean())


def _face_normals(surface: Surface) -> tuple[Float[Array, "faces 3"], Float[Array, "faces"]]:
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    doubled = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    return normals / doubled[:, None], doubled / 2


def _gradient(
    surface: Surface, function: Float[Array, "vertices"], normals: Float[Array, "faces 3"], area: Float[Array, "faces"]
) -> Float[Array, "faces 3"]:
    """Gradient of a linear function on each face."""
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    f, g, h = function[surface.faces].T
    across = (c - b) * f[:, None] + (a - c) * g[:, None] + (b - a) * h[:, None]
    return np.cross(normals, across) / np.maximum(2 * area, 1e-300)[:, None]


def _on_vertices(
    surface: Surface, values: Float[Array, "faces"], area: Float[Array, "faces"]
) -> Float[Array, "vertices"]:
    """Mean over the faces around each vertex, by area."""
    corners, count = surface.faces.ravel(), len(surface)
    total = np.bincount(corners, np.repeat(values * area, 3), count)
    return total / np.maximum(np.bincount(corners, np.repeat(area, 3), count), 1e-300)
