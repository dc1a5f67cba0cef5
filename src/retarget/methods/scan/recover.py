"""Limbs that were lost: found again where the cloud has points that nothing explains, or where a regressor sees them.

A pose that is followed from frame to frame stays in its valley: an arm that moved too fast, or lay on the trunk for a while, may be
left behind. It shows: its skin is no longer met by the cloud. Such limbs are tried elsewhere, and what fits best is kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.methods.scan.cloud import binned
from retarget.methods.scan.fit import SAID_BACK, Expected, Fit, fit_cloud, relative_turns, rotation_vectors
from retarget.methods.scan.scan_body import BODY, ScanBody, ShapedBody
from retarget.methods.scan.starts import Start, misfit
from retarget.rig.fit_model import BodyState

Array = np.ndarray

LIMBS = tuple(
    tuple(f"{side}{part}" for part in parts)
    for side in ("left", "right")
    for parts in (("UpperArm", "LowerArm", "Hand"), ("UpperLeg", "LowerLeg", "Foot", "Toes"))
)
LEGS = np.array([limb[0].endswith("UpperLeg") for limb in LIMBS])
"""Which of them are legs."""
REACHES = (0.15, 0.1, 0.08, 0.06, 0.045, 0.035)
"""Metres: reaches of the rounds in which a limb is sought elsewhere."""
FEWEST = 8
"""Points that nothing explains, of a thinned cloud, which a limb may have left behind."""
ELSEWHERE = 0.1
"""Metres between a joint and where a regressor sees it beyond which its limb is tried there."""
AT_ONCE = 2
"""Limbs that are tried in one frame, those first that lie farthest from where a regressor sees them."""
BETTER, TURNED, ABOUT = 0.95, 0.85, 0.65
"""Share of the misfit at which a limb is taken to be elsewhere, at which a whole body is, and at which it is turned about."""
POOR = 0.018
"""Metres of misfit beyond which all of the body may be elsewhere: bodies that are followed well stay below, those that look the
wrong way do not."""

UNLIKELY = 4.0
"""Standard deviations of a hand's or a foot's turn at which another is tried."""
NO_WORSE = 1.02
"""Share of the misfit at which a likely turn is taken instead, or a limb that the cloud hardly shows is where a regressor
sees it."""
HIDDEN = 0.3
"""A limb of whose skin less than this share is shown is hidden."""


@lru_cache(maxsize=1)
def limb_joints() -> tuple[Int[Array, "_"], ...]:
    """The joints of each limb, from the trunk outwards."""
    names = human_model().joint_names
    return tuple(np.array([names.index(name) for name in limb]) for limb in LIMBS)


def limbs_shown(body: ScanBody, fit: Fit) -> Float[Array, "limbs"]:
    """Share of each limb's skin that the cloud shows."""
    owner = np.full(BODY, -1)
    for number, joints in enumerate(limb_joints()):
        owner[joints] = number
    limb = owner[body.point_columns[:SAID_BACK, 0]]
    return np.array([fit.shown[limb == number].mean() for number in range(len(LIMBS))])


def sought_elsewhere(
    body: ScanBody, fit: Fit, shaped: ShapedBody, points: Float[Array, "points 3"], expected: Expected,
    doubted: Bool[Array, "limbs"],
) -> Fit:  # fmt: skip
    """The fit with doubted limbs where they fit better, if they do: each is tried stretched out to the points within its reach
    that nothing explains."""
    for limb in np.flatnonzero(doubted):
        for state in _aimed(body, fit, shaped, points, limb_joints()[limb]):
            fit = _tried(body, fit, state, shaped, points, expected, limb_joints()[limb])
    return fit


def seen_elsewhere(
    body: ScanBody, fit: Fit, shaped: ShapedBody, points: Float[Array, "points 3"], expected: Expected, starts: Sequence[Start],
    sure: bool, clothed: bool,
) -> Fit:  # fmt: skip
    """The fit with limbs, or all of the body, where a regressor sees them (`starts.guessed_starts`), if they fit better there.

    `sure` says that the body was followed well before: then all of it is not given up for little. Nor where it is `clothed` in
    what hangs: no pose fits well then, and what is expected of the next pose counts for any other too, or legs tremble."""
    guess = alike(starts, fit.state).state
    if misfit(fit) > POOR:
        free = replace(expected, turn_precision=0 * expected.turn_precision, root_precision=0.0)
        held = expected if clothed else free
        for start in starts:
            other = fit_cloud(body, replace(start.state, shape=fit.state.shape), binned(points), held, REACHES, False, shaped)
            about = float(np.trace(other.state.turns[0] @ fit.state.turns[0].T)) < 1.0  # by more than a quarter
            if misfit(other) < (BETTER if not (sure or clothed) else ABOUT if about else TURNED) * misfit(fit):
                fit = other
    own, there = (joints_of(body, shaped, state) for state in (fit.state, guess))
    apart = [np.linalg.norm((own[limb] - own[limb[0]]) - (there[limb] - there[limb[0]]), axis=1).max() for limb in limb_joints()]
    for limb in np.argsort(apart)[::-1][:AT_ONCE]:
        if apart[limb] > ELSEWHERE:
            turns, joints = fit.state.turns.copy(), limb_joints()[limb]
            turns[joints] = guess.turns[joints]
            most = NO_WORSE if limbs_shown(body, fit)[limb] < HIDDEN else BETTER
            fit = _tried(body, fit, replace(fit.state, turns=turns), shaped, points, expected, joints, most)
    return fit


def alike(starts: Sequence[Start], state: BodyState) -> Start:
    """The start whose hips face as those of a state do, as nearly as any."""
    return min(starts, key=lambda start: float(((start.state.turns[0] - state.turns[0]) ** 2).sum()))


def straightened(
    body: ScanBody, fit: Fit, shaped: ShapedBody, points: Float[Array, "points 3"], expected: Expected
) -> Fit:
    """The fit with ends of limbs that are turned as no joint turns (a foot that points backwards) begun again from rest, unless
    the cloud speaks against it."""
    beside = rotation_vectors(relative_turns(body, fit.state.turns))
    strange = np.einsum("ja,jab,jb->j", beside, expected.usual_precision, beside) > UNLIKELY**2
    for joints in limb_joints():
        if strange[joints[2:]].any():
            turns = fit.state.turns.copy()
            turns[joints[2:]] = turns[joints[1]]
            fit = _tried(body, fit, replace(fit.state, turns=turns), shaped, points, expected, joints[2:], NO_WORSE)
    return fit


def joints_of(body: ScanBody, shaped: ShapedBody, state: BodyState) -> Float[Array, "joints 3"]:
    """Places of the joints, metres."""
    import retarget.methods.scan.fit_kernels as kernels

    joints = np.empty_like(shaped.joints)
    kernels.place_joints(body.parents, shaped.joints, state.turns, state.root, joints, np.empty_like(joints))
    return joints


def _aimed(body: ScanBody, fit: Fit, shaped: ShapedBody, points: Array, limb: Int[Array, "_"]) -> Iterator[BodyState]:
    """States with the limb stretched out to points that nothing explains: to the farthest of them, and to their middle."""
    joints = joints_of(body, shaped, fit.state)
    long = np.linalg.norm(np.diff(shaped.joints[limb], axis=0), axis=1).sum() + 0.15
    away = points[fit.astray] - joints[limb[0]]
    distance = np.linalg.norm(away, axis=1)
    away = away[distance < long]
    if len(away) < FEWEST:
        return
    order = np.argsort(-np.linalg.norm(away, axis=1), kind="stable")
    for goal in (away[order[:FEWEST]].mean(axis=0), away.mean(axis=0)):
        turns = fit.state.turns.copy()
        for joint, end in zip(limb[:2], limb[1:3]):
            bone = fit.state.turns[joint] @ (shaped.joints[end] - shaped.joints[joint])
            turns[joint] = rot.to_matrix(rot.swing_between(bone, goal)) @ turns[joint]
        for joint in limb[2:]:
            turns[joint] = turns[limb[1]] @ fit.state.turns[limb[1]].T @ fit.state.turns[joint]
        yield replace(fit.state, turns=turns)


def _tried(
    body: ScanBody, fit: Fit, state: BodyState, shaped: ShapedBody, points: Array, expected: Expected, limb: Int[Array, "_"],
    most: float = BETTER,
) -> Fit:  # fmt: skip
    """The better of the fit and one in which the limb starts elsewhere."""
    precision = expected.turn_precision.copy()
    precision[limb] = 0.0
    other = fit_cloud(body, state, binned(points), replace(expected, turn_precision=precision), REACHES, False, shaped)
    return other if misfit(other) < most * misfit(fit) else fit
