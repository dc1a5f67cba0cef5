"""The best reading of a body laid onto its mesh: first without, then with fingers; then a smooth displacement of the skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.resample import Surface, cleaned, decimate
from retarget.rig.fit import Pull, Target, fit_to_places, fit_to_skin, fit_to_surface, lifted, prepare_skin
from retarget.rig.fit_model import BodyState, FitModel, pose_body
from retarget.rig.hands import fit_fingers
from retarget.rig.registration import Registered, register
from retarget.rig.search import Candidate
from retarget.rig.template import SAMPLES, Template

Array = np.ndarray

COARSE = [Pull(0.03, 0.02, 1e-6, 2e-7)] * 6
CLOSE, CLOSE_ROUNDS = Pull(0.03, 0.01, 1e-7, 2e-8), 5
CLOSEST, CLOSEST_ROUNDS, WHOLE_ROUNDS = Pull(0.01, 0.01, 1e-8, 1e-8, 1e-7), 9, 3
"""Pulls and rounds: of bodies without fingers, of sampled points with fingers, and then of all the template's points."""
WITHIN, MOST, AROUND = 0.001, 3.5, 16
"""Metres (median) to which a body of the template's own kind comes, with what averages out over so many neighbours left out:
noise and triangles. What stays further off has shapes that the model lacks, and would bend to make up for them: it is held to
usual shapes and poses more, by the fourth power, until it lies `MOST` times as far off."""
WIDEST = 0.03
"""Metres of reach, at most."""
GUIDED = Pull(0.05, 1.0, 1e-5, 1e-6)
REFIT = Pull(0.05, 1.0, 1e-6, 1e-7)
LAID_ON = 30_000
"""Vertices of the mesh that the template is laid onto; larger ones are decimated for that."""


@dataclass(frozen=True, eq=False)
class LaidOn:
    """The template's body in the mesh, in the target's metres."""

    state: BodyState
    registered: Registered


def lay_on(
    template: Template, found: Candidate, target: Target, mesh: Surface, known: Float[Array, "template 3"] | None
) -> LaidOn:
    """Fit the best candidate finely to the mesh itself, lay it on, and turn it as the skin then says.

    `mesh` and `known` (where the template's vertices lie, if a map is at hand) are in the target's metres and place.
    """
    skin = prepare_skin(mesh if len(mesh) <= LAID_ON else decimate(cleaned(mesh), LAID_ON))
    body = template.body.at(template.samples[:SAMPLES]).around(found.usual)
    state = fit_to_surface(body, found.state, target, COARSE)
    alien = max(1.0, _systematic_distance(body, state, skin) / WITHIN)
    state = fit_to_skin(body, state, skin, [_held(CLOSE, alien)] * CLOSE_ROUNDS, target)
    model = template.model.around(found.usual)
    state = _with_fingers(state, model)
    if known is not None:
        state = fit_to_places(model.at(template.samples), state, known[template.samples], 6, GUIDED)
    else:
        model, state = fit_fingers(template.names, model, state, skin)
    fine = model.at(template.samples)
    state = fit_to_skin(fine, state, skin, [_held(CLOSEST, alien)] * CLOSEST_ROUNDS, target)
    state = fit_to_skin(model, state, skin, [_held(CLOSEST, alien)] * WHOLE_ROUNDS, target)
    registered = register(pose_body(model, state).points, template.faces, skin, alien)
    state = fit_to_places(fine, state, registered.vertices[template.samples], 2, REFIT)
    return LaidOn(state, registered)


def _systematic_distance(model: FitModel, state: BodyState, skin: SurfaceIndex) -> float:
    """Median distance along the surface's normals, averaged over neighbours first."""
    from scipy.spatial import cKDTree

    posed = pose_body(model, state)
    there = skin.closest(lifted(posed.points, posed.normals)).of(skin.vertices)
    along = ((there[:, :3] - posed.points) * rot.unit(there[:, 3:])).sum(axis=1)
    _, around = cKDTree(posed.points).query(posed.points, k=min(AROUND, len(along)))
    return float(np.median(np.abs(along[around].reshape(len(along), -1).mean(axis=1))))


def _held(pull: Pull, alien: float) -> Pull:
    """The same for a body that lies so many times as far off as one of the template's kind."""
    more = min(alien, MOST) ** 4
    reach = min(pull.reach * alien, max(pull.reach, WIDEST))
    return Pull(reach, pull.across, pull.pose * more, pull.shape * more, pull.fingers * more)


def _with_fingers(state: BodyState, model: FitModel) -> BodyState:
    """The same state with fingers that follow their hands."""
    turns = np.empty((len(model.parents), 3, 3))
    turns[: len(state.turns)] = state.turns
    for joint in range(len(state.turns), len(turns)):
        turns[joint] = turns[model.parents[joint]]
    return BodyState(state.shape, turns, state.root)
