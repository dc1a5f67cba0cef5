"""Where the template's body lies in a surface: first states from tips and from stances, each tried in small, the best in full.

Tips work in any pose; stances (upright, arms out or down) for bodies whose tips are no head, hands or feet, like toys with
hats and swords. Which is right shows in how well the template fits: that decides between all of them, and between left and
right, since feet, knees and faces fit one way only. The margin to the best of the others is the confidence. Ours.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.correspond.landmarks import TIPS, IntrinsicBody, Labelled, find_tips, label_tips, labellings
from retarget.progress import Tell
from retarget.rig.fit import (
    AREA,
    HEIGHT,
    Misfit,
    Pull,
    Target,
    fit_to_places,
    fit_to_surface,
    misfit,
    prepare_target,
    scaled_shape,
    similarity,
    state_from_places,
)
from retarget.rig.fit_model import BodyState, FitModel, pose_body
from retarget.rig.given import FEWEST_LANDMARKS, Given
from retarget.rig.template import SAMPLES, Start, Template
from retarget.rig.working_surface import surface_size

Array = np.ndarray

COARSE, COARSE_SPREAD = 500, 400
"""Points of the template, and of the surface, in a first try."""
FINALISTS = 3
CLEAR = 0.8
"""Confidence in a body found by its tips at which stances are not tried."""
GUIDED = Pull(0.15, 1.0, 1e-4, 2e-5)
TRIED = [Pull(0.12 if r < 4 else 0.05, 0.1, 3e-5, 1e-5) for r in range(8)]
STOOD = [
    Pull(max(0.05, 0.3 * 0.75**r), 0.3 if r < 6 else 0.1, 1e-3 * 0.7**r + 3e-5, 1e-3 * 0.6**r + 1e-5) for r in range(8)
]
SETTLED = [Pull(max(0.05, 0.12 * 0.8**r), 0.1, 3e-5, 1e-5) for r in range(14)]
UPRIGHT = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Directions that bodies in files stand along."""
LIFTS = (0.0, 40.0, -25.0)
"""Degrees that the arms of a stance are lifted above the template's."""
ELSEWHERE = 0.08 * HEIGHT
"""Metres between joints, on average, from which two candidates are two readings."""
WORTH_OF_LANDMARKS = 0.5
"""How much a metre of mean distance to given landmarks counts in a candidate's misfit."""
FAR_FROM_LANDMARK = 0.2
"""Metres from a given landmark at which a template that is no human is not laid in as the user said: right ones end within .05."""
WELL, ILL = 0.020, 0.045
"""Metres of the template's misfit that speak for a body, and against any."""
CLOTHED, STRANGE = 0.064, 0.082
"""Metres of the surface's misfit that clothes and tools come to, and those of a body lost in something larger."""
CLEARLY = 0.25
"""Share by which the best reading is better than the next, from which there is no doubt between them."""
CUSTOM = 0.03
"""Share by which a body that stands as files have them counts as nearer: blocky toys fit nearly as well back to front."""
CUSTOMARY = (((0, 1, 0), (0, 0, 1)), ((0, 0, 1), (0, -1, 0)))
"""Up and forward: of glTF and most exports, and of Blender."""
LIKE_CUSTOM = 0.8
"""Cosine of the angles within which it does."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way the body may lie in the surface."""

    how: str
    """What it started from."""
    usual: Float[Array, "shapes"]
    """The shape it was expected around."""
    state: BodyState
    misfit: Misfit
    joints: Float[Array, "joints 3"]
    landmarks: Float[Array, "given"]
    """Metres from each of the given landmarks."""

    @property
    def total(self) -> float:
        """What candidates are ranked by, metres."""
        away = float(self.landmarks.mean()) if len(self.landmarks) else 0.0
        return (1.0 - CUSTOM * self.customary) * self.misfit.total + WORTH_OF_LANDMARKS * away

    @property
    def customary(self) -> bool:
        """Whether the body stands as files have them."""
        hips = self.state.turns[0]
        return any(min(np.dot(up, hips[:, 1]), np.dot(ahead, hips[:, 2])) > LIKE_CUSTOM for up, ahead in CUSTOMARY)


def candidates(
    template: Template,
    body: IntrinsicBody,
    given: Given,
    tell: Tell,
    known: Float[Array, "template 3"] | None = None,
) -> tuple[Target, list[Candidate]]:
    """Ways of laying the template into a surface, the best first, all but the first few tried in small only.

    `known` are the places of the template's vertices on the mesh, in its units, where a map is at hand: then nothing else is
    tried.
    """
    target = prepare_target(body.surface, float(np.sqrt(AREA)) / surface_size(body.surface))
    trial = _Trial(template, target, given)
    if known is not None:
        places = (known - target.origin) * target.unit
        return target, trial.settle([trial.by_known(start, places) for start in template.starts], tell)
    tried = []
    for how, start, labelled in _by_tips(template, body, given) if template.human else ():
        tell("looking for the body by its ends", 1)
        tried.append(trial.by_places(how, start, labelled.features, start.labelled.features))
    if len(given.names) >= FEWEST_LANDMARKS:
        tell("looking for the body by its landmarks", 1)
        tried += [trial.by_landmarks(start, body) for start in template.starts]
        tried += [trial.drawn(start) for start in template.starts if not template.human]
    found = trial.settle(tried, tell)
    if confidence_of(found)[0] < CLEAR and not given:
        for start in template.starts:
            tell("looking for the body by its stance", 1)
            tried += [
                trial.standing(start, up, quarter, lift) for up in UPRIGHT for quarter in range(4) for lift in LIFTS
            ]
        found = trial.settle(tried, tell)
    return target, found


def confidence_of(found: list[Candidate]) -> tuple[float, str]:
    """0 to 1, and what is in doubt: how near the template lies and how much of the surface it explains, times how far the
    next different reading is behind."""
    if not found:
        return 0.0, "it has no ends like a head, hands and feet"
    best = found[0]
    near = float(np.clip((ILL - best.misfit.template) / (ILL - WELL), 0.0, 1.0))
    others = [each for each in found[1:] if _differ(each, best)]
    behind = 1.0 - best.total / min(each.total for each in others) if others else 1.0
    clear = float(np.clip(behind / CLEARLY, 0.0, 1.0))
    own = float(np.clip((STRANGE - best.misfit.surface) / (STRANGE - CLOTHED), 0.0, 1.0))
    doubts = {"no reading of it fits the template": near, "two readings of it fit about as well": clear,
              "much of it is nothing of the template's": own}  # fmt: skip
    return float(np.sqrt(near * clear * own)), min(doubts, key=lambda doubt: doubts[doubt])


def _differ(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates are two readings, not one reached twice."""
    return float(np.linalg.norm(one.joints - other.joints, axis=1).mean()) > ELSEWHERE


@dataclass(frozen=True, eq=False)
class _Trial:
    """What first states are tried on."""

    template: Template
    target: Target
    given: Given

    @cached_property
    def coarse(self) -> dict[str, FitModel]:
        """The body at few points, around the shape of each start."""
        own = self.template.body.at(self.template.samples[:COARSE])
        return {start.name: own.around(start.shape) for start in self.template.starts}

    def by_places(
        self, how: str, start: Start, features: Float[Array, "vertices k"], wanted: Float[Array, "template k"]
    ) -> Candidate:
        """From the surface's points that have the same features as the template's."""
        from scipy.spatial import cKDTree

        _, near = cKDTree(features).query(wanted[start.samples[:COARSE]])
        return self._guided(how, start, self.target.vertices[near])

    def by_known(self, start: Start, places: Float[Array, "template 3"]) -> Candidate:
        """From a map that is at hand."""
        return self._guided(f"{start.name}, given map", start, places[self.template.samples[:COARSE]])

    def _guided(self, how: str, start: Start, places: Float[Array, "coarse 3"]) -> Candidate:
        coarse = self.coarse[start.name]
        state = fit_to_places(coarse, state_from_places(coarse, places, start.shape), places, 6, GUIDED)
        return self._candidate(how, start, fit_to_surface(coarse, state, self.target, TRIED, COARSE_SPREAD), coarse)

    def by_landmarks(self, start: Start, body: IntrinsicBody) -> Candidate:
        """From the distances to four and more given landmarks."""
        from scipy.spatial import cKDTree

        there = cKDTree(body.surface.vertices).query(self.given.places)[1]
        here = start.near.query(start.vertices[self.given.vertices])[1]
        features, wanted = body.geodesics.distances(there), start.body.geodesics.distances(here)
        return self.by_places(f"{start.name}, landmarks", start, features / features.mean(), wanted / wanted.mean())

    def drawn(self, start: Start) -> Candidate:
        """Turned, scaled and moved as the given landmarks are (Kabsch 1976), and drawn to each of them: less and less with the
        distance along the surface from it, by Gaussians about as wide as landmarks are apart."""
        here, there = start.vertices[self.given.vertices], (self.given.places - self.target.origin) * self.target.unit
        turn, scale, shift = similarity(here, there)
        ends = start.near.query(here)[1]
        distances = start.body.geodesics.distances(ends)
        between = distances[ends] + np.diag(np.full(len(ends), np.inf))
        pull = np.exp(-((distances / np.median(between.min(axis=1))) ** 2))
        drawn = np.linalg.lstsq(pull[ends], there - scale * here @ turn.T - shift, rcond=1e-2)[0]
        chosen = self.template.samples[:COARSE], start.samples[:COARSE]
        places = scale * start.vertices[chosen[0]] @ turn.T + shift + pull[chosen[1]] @ drawn
        return self._guided(f"{start.name}, drawn to landmarks", start, places)

    def standing(self, start: Start, up: tuple[float, ...], quarter: int, lift: float) -> Candidate:
        """Upright, facing one of four ways, the arms lifted."""
        coarse = self.coarse[start.name]
        state = _standing(self.template.names, coarse, self.target, start.shape, np.array(up), quarter, lift)
        how = f"{start.name}, standing along {'xyz'[int(np.argmax(up))]}, turned {90 * quarter}, arms {lift:+g}"
        return self._candidate(how, start, fit_to_surface(coarse, state, self.target, STOOD, COARSE_SPREAD), coarse)

    def settle(self, tried: list[Candidate], tell: Tell) -> list[Candidate]:
        """The best readings that differ fitted in full, then the others."""
        waiting = sorted(tried, key=lambda each: each.total)
        settled: list[Candidate] = []
        while waiting and len(settled) < FINALISTS:
            tell("fitting", 1)
            each = waiting.pop(0)
            model = self.template.body.at(self.template.samples[:SAMPLES]).around(each.usual)
            state = fit_to_surface(model, each.state, self.target, SETTLED)
            settled.append(self._scored(each.how, each.usual, state, model))
            waiting = [other for other in waiting if _differ(other, each)]
        return sorted(settled, key=lambda each: each.total) + waiting

    def _candidate(self, how: str, start: Start, state: BodyState, model: FitModel) -> Candidate:
        return self._scored(how, start.shape, state, model)

    def _scored(self, how: str, usual: Float[Array, "shapes"], state: BodyState, model: FitModel) -> Candidate:
        away = np.zeros(0)
        if self.given:
            own = pose_body(self.template.body.at(self.given.vertices), state).points
            away = np.linalg.norm(own - (self.given.places - self.target.origin) * self.target.unit, axis=1)
        feet = self.template.feet[self.template.samples[: len(model.points)]]
        found = misfit(model, state, self.target, feet)
        return Candidate(how, usual, state, found, pose_body(model, state).joints, away)


def _by_tips(template: Template, body: IntrinsicBody, given: Given) -> Iterator[tuple[str, Start, Labelled]]:
    """First states by the five tips: given ones where all are, else found ones."""
    from scipy.spatial import cKDTree

    if set(TIPS) <= set(given.names):
        places = given.places[[given.names.index(name) for name in TIPS]]
        known = label_tips(body, cKDTree(body.surface.vertices).query(places)[1])
        yield from ((f"{start.name}, given ends", start, known) for start in template.starts)
        return
    tips = find_tips(body)
    for start in template.starts:
        for number, labelled in enumerate(labellings(body, start.labelled, tips)):
            yield f"{start.name}, ends {number}", start, labelled


def _standing(
    names: tuple[str, ...],
    coarse: FitModel,
    target: Target,
    usual: Float[Array, "shapes"],
    up: Float[Array, "3"],
    quarter: int,
    lift: float,
) -> BodyState:
    """The template as tall as the surface, on the same floor, in its middle."""
    turns = np.tile(np.eye(3), (len(coarse.parents), 1, 1))
    for joint, name in enumerate(names[: len(turns)]):
        if name.endswith(("UpperArm", "LowerArm", "Hand")):
            angle = np.radians(lift) * (1 if name.startswith("left") else -1)
            turns[joint] = rot.to_matrix(rot.from_rotation_vector(np.array([0.0, 0.0, angle])))
    front = np.array([0.0, 0.0, 1.0]) if up[1] else np.array([0.0, -1.0, 0.0])
    front = rot.to_matrix(rot.from_rotation_vector(up * quarter * np.pi / 2)) @ front
    turns = np.stack([np.cross(up, front), up, front], axis=1) @ turns
    points = pose_body(coarse, BodyState(usual, turns, np.zeros(3))).points
    shape = scaled_shape(usual, float(np.ptp(target.vertices @ up)) / float(np.ptp(points @ up)))
    points = pose_body(coarse, BodyState(shape, turns, np.zeros(3))).points
    across = np.median(target.vertices, axis=0) - np.median(points, axis=0)
    rise = float((target.vertices @ up).min() - (points @ up).min())
    return BodyState(shape, turns, across - up * (across @ up) + up * rise)
