"""Fingers in a surface: several curls of the hand are tried, and the one that fits is where they are fitted from.

Fingers lie closer to each other than they move, so the nearest surface is often another finger's. People bend them together
(Santello, Flanders and Soechting 1998: over half of all grasps lie on one curve), so a few curls from open to fist come near
enough to all of them. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.geometry.closest import SurfaceIndex
from retarget.rig.fit import Pull, fit_to_skin, lifted
from retarget.rig.fit_model import BodyState, FitModel, pose_body

Array = np.ndarray

CURLS = (0.0, 20.0, 40.0, 65.0)
"""Degrees that a ring finger's first joint is bent in the hands that are tried."""
SHARES = {"Thumb": 0.35, "Index": 0.8, "Middle": 0.9, "Ring": 1.0, "Little": 1.1}
SEGMENTS = {"Metacarpal": 0.3, "Proximal": 1.0, "Intermediate": 1.15, "Distal": 0.65}
"""How much the fingers, and the joints of each, bend with the curl."""
TRIED = [Pull(0.02, 0.01, 1e-7, 2e-8)] * 4
WORST = 0.03
"""Metres, normals included, that a distance counts at most where curls are compared."""
MOST = 400
"""Points of a hand's surface that are compared."""


@dataclass(frozen=True, eq=False)
class _Hand:
    side: str
    joints: Int[Array, "joints"]
    """The hand and its fingers."""
    points: Bool[Array, "points"]
    """The model's points on it."""
    skin: Int[Array, "skin"]
    """Vertices of the surface near it."""


def fit_fingers(
    names: tuple[str, ...], model: FitModel, state: BodyState, skin: SurfaceIndex
) -> tuple[FitModel, BodyState]:
    """Bend the fingers of both hands as the surface says, from a state in which they follow their hands.

    `names` are the canonical ones of the model's joints. Returns the model with these fingers as the expected ones.
    A hand without index and little finger is left as it is.
    """
    hands = _hands(names, model, state, skin)
    if not hands:
        return model, state
    near = model.at(np.flatnonzero(np.any([hand.points for hand in hands], axis=0)))
    hands = [replace(hand, points=near.weights[:, hand.joints].sum(axis=1) > 0.5) for hand in hands]
    free = np.concatenate([3 * hand.joints[:, None] + np.arange(3) for hand in hands]).ravel()
    best: dict[str, tuple[float, Array, Array]] = {}
    for curl in CURLS:
        bends = model.bends.copy()
        for hand in hands:
            bends += _curled(names, model, hand.side, curl)
        bent = replace(near, bends=bends)
        tried = fit_to_skin(bent, _bent(state, bent), skin, TRIED, free=free)
        for hand, miss in zip(hands, _misses(bent, tried, hands, skin)):
            if hand.side not in best or miss < best[hand.side][0]:
                best[hand.side] = miss, tried.turns, bends
    turns, bends = state.turns.copy(), model.bends.copy()
    for hand in hands:
        _, turned, expected = best[hand.side]
        turns[hand.joints], bends[hand.joints] = turned[hand.joints], expected[hand.joints]
    return replace(model, bends=bends), BodyState(state.shape, turns, state.root)


def _hands(names: tuple[str, ...], model: FitModel, state: BodyState, skin: SurfaceIndex) -> list[_Hand]:
    from scipy.spatial import cKDTree

    posed = pose_body(model, state)
    _, near = cKDTree(lifted(posed.points, posed.normals)).query(skin.vertices)
    hands = []
    for side in ("left", "right"):
        if not {f"{side}Hand", f"{side}IndexProximal", f"{side}MiddleProximal", f"{side}LittleProximal"} <= set(names):
            continue
        fingers = tuple(side + finger for finger in SHARES)
        joints = np.array([j for j, name in enumerate(names) if name == f"{side}Hand" or name.startswith(fingers)])
        points = model.weights[:, joints].sum(axis=1) > 0.5
        there = np.flatnonzero(points[near])
        if len(there):
            chosen = there[np.unique(np.linspace(0, len(there) - 1, MOST).astype(np.int64))]
            hands.append(_Hand(side, joints, points, chosen))
    return hands


def _curled(names: tuple[str, ...], model: FitModel, side: str, degrees: float) -> Float[Array, "joints 3"]:
    """Rotation vectors of a hand's fingers for a curl, about axes across each finger, towards the palm."""
    place = {name: model.joints[joint] for joint, name in enumerate(names)}
    along = place[f"{side}MiddleProximal"] - place[f"{side}Hand"]
    palm = np.cross(along, place[f"{side}LittleProximal"] - place[f"{side}IndexProximal"])
    palm = -palm if side == "left" else palm
    bends = np.zeros((len(names), 3))
    for finger, share in SHARES.items():
        chain = [joint for joint, name in enumerate(names) if name.startswith(side + finger)]
        if len(chain) < 2:
            continue
        axis = rot.unit(np.cross(model.joints[chain[-1]] - model.joints[chain[0]], palm))
        for joint in chain:
            bends[joint] = np.radians(degrees) * share * SEGMENTS[names[joint].removeprefix(side + finger)] * axis
    return bends


def _bent(state: BodyState, model: FitModel) -> BodyState:
    """The state with its fingers bent as the model expects them."""
    turns = state.turns.copy()
    bends = rot.to_matrix(rot.from_rotation_vector(model.bends))
    for joint in range(model.fingers, len(turns)):
        turns[joint] = turns[model.parents[joint]] @ bends[joint]
    return BodyState(state.shape, turns, state.root)


def _misses(model: FitModel, state: BodyState, hands: list[_Hand], skin: SurfaceIndex) -> list[float]:
    """How far each hand is from the surface near it, both ways."""
    from scipy.spatial import cKDTree

    posed = pose_body(model, state)
    own = lifted(posed.points, posed.normals)
    there = np.linalg.norm(skin.closest(own).of(skin.vertices) - own, axis=1)
    misses = []
    for hand in hands:
        here, _ = cKDTree(own[hand.points]).query(skin.vertices[hand.skin])
        misses.append(_root_mean_square(there[hand.points]) + _root_mean_square(here))
    return misses


def _root_mean_square(distances: Float[Array, "_"]) -> float:
    return float(np.sqrt((np.minimum(distances, WORST) ** 2).mean()))
