"""The skeleton regressor in use: points of one frame in, the joints of a body out.

The paper's SKR (Rekik 2023, section 3.2) is a PointNet that gives 22 joints. Ours looks four times: from fixed places, then
three times from around the joints found so far, in their own axes, so that facing matters little; and it gives the turn of each
joint too, which places alone do not tell. `train/skeleton_regressor.py` is its recipe, `docs/models/skeleton_regressor.md` its card.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.errors import RetargetError
from retarget.io.onnx_network import open_network
from retarget.methods.scan.copies import fourfold, joined
from retarget.methods.scan.features import JOINTS, ORDER, Bodies, Clouds, closer_look, first_look, gathered, thinned

Array = np.ndarray

VERSION = "1"
"""Of the weights' files; others are refused."""
FOLDER = Path(__file__).with_name("weights")
FILES = tuple(f"skeleton_look_{number}.onnx" for number in (1, 2, 3))
FEWEST = 100
"""Points below which nothing is said of a cloud."""
FARTHEST = 1e6
"""Metres from the origin beyond which a point is no point."""


@dataclass(frozen=True, eq=False)
class FoundJoints:
    """A body's joints in one cloud."""

    names: tuple[str, ...]
    """VRM names of the 22 joints."""
    places: Float[Array, "joints 3"]
    """Metres, in the world."""
    turns: Float[Array, "joints 4"]
    """Rotation of each joint in the world from the embedded human's rest pose; quaternions xyzw."""
    doubts: Float[Array, "joints"]
    """How far off each joint is expected to be, metres."""


@dataclass(frozen=True, eq=False)
class Regressor:
    """Finds joints in clouds; `load_regressor()` makes it. One thread; calls do not depend on each other."""

    looks: tuple[Any, ...]
    """Sessions of ONNX Runtime."""
    copies: bool = True
    """Whether every cloud is looked at in the four copies of `copies.py`: a tenth better, for twice the time."""

    def __call__(self, points: Float[Array, "points 3"]) -> FoundJoints:
        """The joints in a cloud of one body: metres, +Y up, in any order, anywhere, facing anywhere.

        Points that are not finite are left out. Raises `RetargetError` for fewer than `FEWEST` others.
        """
        points = np.asarray(points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise RetargetError(f"a cloud must be points x 3 numbers, received an array of shape {points.shape}")
        with np.errstate(invalid="ignore"):
            kept = (np.abs(points) < FARTHEST).all(axis=1)
        usable = np.ascontiguousarray(points[kept], dtype=np.float64)
        if len(usable) < FEWEST:
            raise RetargetError(f"a cloud must have at least {FEWEST} points, received {len(usable)} that are finite")
        clouds = thinned(usable)
        found, doubts = self.find(clouds)
        places = found.places[0].astype(np.float64) + clouds.middles[0]
        turns = rot.from_matrix(found.turns[0].astype(np.float64))
        return FoundJoints(human_model().joint_names[:JOINTS], places, turns, doubts[0].astype(np.float64))

    def glance(self, points: Float[Array, "points 3"]) -> FoundJoints:
        """The same without copies."""
        return replace(self, copies=False)(points)

    def find(self, clouds: Clouds) -> tuple[Bodies, Float[Array, "clouds joints"]]:
        """Joints in many thinned clouds, from their middles, and the expected error of each (metres)."""
        return joined(*self.find_once(fourfold(clouds))) if self.copies else self.find_once(clouds)

    def find_once(self, clouds: Clouds) -> tuple[Bodies, Float[Array, "clouds joints"]]:
        """The same without copies."""
        found, out = None, np.empty((0, 0))
        for number in ORDER:
            features = first_look(clouds) if found is None else closer_look(clouds, found, whole=number == 1)
            (out,) = self.looks[number].run(None, {"features": features})
            found = _moved(found, out)
        return found, np.logaddexp(0.0, out[:, 9 * JOINTS :] - 4.0)


def _moved(found: Bodies | None, out: Float[Array, "clouds outputs"]) -> Bodies:
    """What a look makes of the joints found before; moves and turns are in each joint's own axes."""
    places = out[:, : 3 * JOINTS].reshape(-1, JOINTS, 3)
    six = out[:, 3 * JOINTS : 9 * JOINTS].reshape(-1, JOINTS, 6) + np.array([1, 0, 0, 0, 1, 0], dtype=np.float32)
    turns = gathered(six)
    if found is not None:
        places = found.places + found.sizes * np.matmul(found.turns, places[..., None])[..., 0]
        turns = np.matmul(found.turns, turns)
    return Bodies(places, turns)


@lru_cache(maxsize=4)
def load_regressor(folder: Path = FOLDER) -> Regressor:
    """The regressor with the package's weights, or those of a folder. Raises `FileError` for weights that are missing, damaged
    or of another version."""
    return Regressor(tuple(open_network(folder / name, "skeleton-regressor", VERSION) for name in FILES))
