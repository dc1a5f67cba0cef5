"""How bodies differ: the principal components of the embedded human's shapes.

Ages, sexes, builds and heights are sampled, since their effects multiply; to the finer components shapes are all but linear,
so each is taken as it is and not left to what a sample happens to draw of it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body.human import height_range, human_model, human_vertices
from retarget.rig.fit import HEIGHT

Array = np.ndarray

BODIES, COMPONENTS = 200, 90
"""Sampled bodies, and the principal components kept of them and of the finer components."""
DETAIL = 0.3
"""How far a finer component of the shape is expected to go: one standard deviation, of at most 1."""
YOUNG, YOUNGEST_SHARE = 0.4, 0.4
"""Age below which a body is a child or a youth, and the share of these: small bodies differ most, and need as many as they can
get."""
HEAVIEST_SHARE = 0.15
"""Share of bodies beyond a weight of 1.3."""


def shape_components() -> Float[Array, "components vertices 3"]:
    """Principal components of embedded bodies, one standard deviation each, in metres of bodies scaled to `fit.HEIGHT`."""
    bodies = np.stack([_sized(_body(*each)) for each in evenly_spread(BODIES, 6).tolist()])
    away = [bodies - bodies.mean(axis=0), _finer()]
    rows = np.concatenate([each.reshape(len(each), -1) / np.sqrt(count) for each, count in zip(away, (BODIES, 2))])
    _, vectors = np.linalg.eigh(rows @ rows.T)
    return (vectors[:, : -COMPONENTS - 1 : -1].T @ rows).reshape(COMPONENTS, -1, 3)


def evenly_spread(count: int, dimensions: int) -> Float[Array, "count dimensions"]:
    """Points of the unit cube, more even than random ones: multiples of the powers of the one positive root of
    x^(d + 1) = x + 1 (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences")."""
    root = 2.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, dimensions + 1.0)) % 1.0


def _body(gender: float, muscle: float, weight: float, age: float, height: float, ideal: float) -> Array:
    """A body of the parameters' usual ranges, each given as a place from 0 to 1 among all bodies."""
    shape = {
        "gender": gender,
        "muscle": muscle,
        "weight": float(np.interp(weight, (0.0, 1.0 - HEAVIEST_SHARE, 1.0), (0.0, 1.3, 2.0))),
        "age": float(np.interp(age, (0.0, YOUNGEST_SHARE, 1.0), (0.0, YOUNG, 1.0))),
        "proportions": 0.2 + 0.7 * ideal,
    }
    low, high = height_range(**shape)
    return human_vertices(height=low + height * (high - low), **shape)


def _finer() -> Float[Array, "rows vertices 3"]:
    """What each finer component does to the neutral body, upwards and downwards."""
    neutral = _sized(human_vertices())
    amounts = [{name: amount} for name in human_model().detail_names for amount in (DETAIL, -DETAIL)]
    return np.stack([_sized(human_vertices(**amount)) - neutral for amount in amounts])


def _sized(body: Float[Array, "vertices 3"]) -> Float[Array, "vertices 3"]:
    return body / np.ptp(body[:, 1]) * HEIGHT
