"""Where a fit begins when nothing is known of the frame before: a regressor's guess and its mirror images, or stances tried all
around."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.methods.scan.cloud import Bins, binned
from retarget.methods.scan.fit import SMALLEST, Expected, Fit, fit_cloud, relative_size
from retarget.methods.scan.scan_body import BODY, ScanBody
from retarget.rig.fit_model import BodyState

Array = np.ndarray

SKETCH = 400
"""Points of the cloud that many starts are tried on."""
FINALISTS = 3
ROUGH = (0.25, 0.25, 0.2, 0.2, 0.15, 0.15, 0.12, 0.1, 0.08, 0.06)
"""Reaches (metres) from a start that may be far off."""
FINE = (0.1, 0.1, 0.08, 0.06, 0.05, 0.05, 0.04, 0.04)
"""Reaches (metres) from a regressor's guess, and to finish with."""
SUPPLE, STRAINED = 4.0, 0.001
"""Standard deviations of a pose's strain that people come to (1.5 to 3 walking and running, 5 dancing; bodies laid in the wrong way
round come to 6 to 10), and metres of misfit for each beyond."""
GUESSED = 0.02
"""Metres that a bone of an adult is off in a regressor's guess."""
LARGEST = 1.6
"""Size over an adult's above which nobody is taken to be."""
YAWS = 8
ARMS = (0.0, 45.0, -35.0)
"""Degrees that the arms of a stance are lifted above the rest pose's."""


@runtime_checkable
class Guess(Protocol):
    """What a regressor sees in a cloud."""

    places: Float[Array, "joints 3"]
    """Joints, metres."""
    turns: Float[Array, "joints 4"]
    """World-from-rest rotations (xyzw) of the joints of the embedded human."""
    names: Sequence[str]
    """Their canonical names."""


@runtime_checkable
class Regressor(Protocol):
    """Joints and turns of the embedded human from a cloud of points, without knowledge of frames before.

    One may have a `glance` beside this: the same in less time and less sure, for frames of a body that is followed well.
    """

    def __call__(self, points: Float[Array, "points 3"]) -> Guess: ...


def own_regressor() -> Regressor | None:
    """The regressor that comes with the program; None where there is none, and stances are tried instead."""
    try:
        from retarget.methods.scan.regressor import load_regressor
    except ImportError:
        return None
    return load_regressor()


@dataclass(frozen=True, eq=False)
class Start:
    """One way the body may stand in the cloud."""

    state: BodyState
    guessed: bool
    """By a regressor: then it is near."""
    doubts: Float[Array, "joints"] = field(default_factory=lambda: np.zeros(BODY))
    """How far off the regressor takes its joints to be, metres."""


def misfit(fit: Fit) -> float:
    """What fits are compared by, metres of an adult: distance of what is explained, the cloud that is not, skin that is not shown, and joints
    that are turned as they hardly turn, as those of a body laid in the wrong way round are."""
    away = float(np.hypot(fit.distance / relative_size(fit.state), 0.06 * np.sqrt(max(1.0 - fit.explained, 0.0))))
    return away + 0.02 * (1.0 - fit.seen) + STRAINED * max(fit.strain - SUPPLE, 0.0)


def guessed_starts(body: ScanBody, guess: Guess) -> Iterator[Start]:
    """The guess, and the same places taken by a body that looks the other way. A guess may have `doubts`, metres by which its
    joints are expected to be off."""
    order = [list(guess.names).index(name) for name in human_model().joint_names[:BODY]]
    places, turns = np.asarray(guess.places)[order].astype(float), rot.to_matrix(np.asarray(guess.turns)[order].astype(float))
    shape = guessed_shape(body, places, turns)
    other = _other_side()
    half = np.diag([-1.0, 1.0, -1.0])
    doubts = np.asarray(getattr(guess, "doubts", np.zeros(BODY)), dtype=float)[order]
    for where, how, doubt in ((places, turns, doubts), (places[other], turns[other] @ half, doubts[other])):
        yield Start(_placed(body, shape, how, where), True, doubt)


def guessed_shape(
    body: ScanBody, places: Float[Array, "joints 3"], turns: Float[Array, "joints 3 3"]
) -> Float[Array, "shapes"]:
    """The likeliest shape whose bones, turned so, are those between the places (metres): first the size by their lengths, then
    proportions by regularised least squares. A toddler is no small adult; a fit that starts from one loses limbs."""
    child, above = np.arange(1, BODY), body.parents[1:]
    bones = np.einsum("jba,jb->ja", turns[above], places[child] - places[above])
    rest = body.joints[child] - body.joints[above]
    size = np.clip(np.linalg.norm(bones, axis=1).sum() / np.linalg.norm(rest, axis=1).sum(), SMALLEST, LARGEST)
    shape = np.zeros(body.shapes)
    shape[-1] = size - 1.0
    basis = (body.joint_basis[:, child] - body.joint_basis[:, above]).reshape(body.shapes, -1).T / (size * GUESSED)
    missing = (bones - size * rest).ravel() / (size * GUESSED)
    return shape + np.linalg.solve(basis.T @ basis + np.diag(body.spread**-2.0), basis.T @ missing)


def stances(body: ScanBody, points: Float[Array, "points 3"]) -> Iterator[Start]:
    """The body upright where the cloud is, as tall as it, facing all around, arms at different heights."""
    low, high = np.percentile(points, [1, 99], axis=0)
    shape = np.zeros(body.shapes)
    shape[-1] = np.clip((high[1] - low[1]) / 1.68, 0.4, 1.3) - 1.0
    middle = np.median(points, axis=0)
    for lift in np.radians(ARMS):
        for yaw in np.arange(YAWS) * 2 * np.pi / YAWS:
            facing = rot.to_matrix(rot.from_rotation_vector(np.array([0.0, yaw, 0.0])))
            turns = np.tile(facing, (BODY, 1, 1))
            for side, sign in (("left", 1.0), ("right", -1.0)):
                arm = rot.to_matrix(rot.from_rotation_vector(np.array([0.0, 0.0, sign * lift])))
                for joint in ("UpperArm", "LowerArm", "Hand"):
                    turns[human_model().joint_names.index(side + joint)] = facing @ arm
            root = body.rest_joints(shape)[0] * [0, 1, 0] + middle * [1, 0, 1] + [0, low[1], 0]
            yield Start(BodyState(shape, turns, root), False)


def best_fit(
    body: ScanBody, starts: Iterable[Start], points: Float[Array, "points 3"], expected: Expected, anyone: bool = False
) -> Fit:
    """The fit that explains the cloud best, each start tried on a part of it, the best few on all. Of `anyone` the shape is
    expected around each start's: around an adult's toddlers are drawn out of the cloud."""
    starts, cloud = list(starts), binned(points)
    if len(starts) > FINALISTS:
        sketch = binned(np.ascontiguousarray(points[:: max(1, len(points) // SKETCH)]))
        tried = [_settled(body, start, sketch, expected, ROUGH[::2], anyone) for start in starts]
        tried.sort(key=misfit)
        starts = [Start(fit.state, False) for fit in tried[:FINALISTS]]
    fits = [_settled(body, start, cloud, expected, FINE if start.guessed else (*ROUGH, *FINE), anyone) for start in starts]
    return min(fits, key=misfit)


def _settled(
    body: ScanBody, start: Start, cloud: Bins, expected: Expected, reaches: Sequence[float], anyone: bool
) -> Fit:
    expected = replace(expected, shape=start.state.shape) if anyone else expected
    return fit_cloud(body, start.state, cloud, expected, reaches, shaping=True, across=0.1)


def _placed(body: ScanBody, shape: Array, turns: Array, places: Float[Array, "joints 3"]) -> BodyState:
    """The state whose joints lie around the places."""
    rest = body.rest_joints(shape)
    joints = np.zeros_like(rest)
    for joint in range(1, BODY):
        above = body.parents[joint]
        joints[joint] = joints[above] + turns[above] @ (rest[joint] - rest[above])
    return BodyState(shape, turns, (places - joints).mean(axis=0))


def _other_side() -> list[int]:
    """For each joint that of the other side."""
    names = human_model().joint_names[:BODY]
    swap = {"left": "right", "right": "left"}
    side = lambda name: next((each for each in swap if name.startswith(each)), "")  # noqa: E731
    return [names.index(swap[side(name)] + name.removeprefix(side(name))) if side(name) else at for at, name in enumerate(names)]
