"""The body read in a mesh: which surface it was looked for on, where it lies, how sure that is, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.progress import Tell
from retarget.rig.fit import Target
from retarget.rig.given import Given, expect_landmarks
from retarget.rig.search import CLEAR, FAR_FROM_LANDMARK, ILL, Candidate, candidates, confidence_of
from retarget.rig.template import Template, intrinsic_body
from retarget.rig.working_surface import MOST_LEFT_OUT, STANDS_APART, WorkingSurface, working_surfaces

Array = np.ndarray

LEAST_CONFIDENCE = 0.34
"""Below this no rig is delivered: landmarks are asked for."""


@dataclass(frozen=True, eq=False)
class Hints:
    """What the user says of the mesh; true if it is anything."""

    given: Given
    surface_map: Places | None
    """Where each vertex of the mesh lies on the template's surface."""
    known: Float[Array, "template 3"] | None
    """For each vertex of the template, the vertex of the mesh that is mapped nearest to it, in the mesh's space."""

    def __bool__(self) -> bool:
        return bool(self.given) or self.known is not None

    @staticmethod
    def of(
        template: Template,
        surface: Surface,
        landmarks: Mapping[str, int | Float[Array, "3"]],
        surface_map: Places | None,
    ) -> Hints:
        """Check what is said. Raises `RetargetError` for landmarks that do not exist or are too few for the template, and for
        a map of another mesh or another template."""
        given = Given.of(template, surface, landmarks)
        if surface_map is None:
            expect_landmarks(template, given)
            return Hints(given, None, None)
        surface_map = _onto_surface(template, surface, surface_map)
        return Hints(given, surface_map, _known_places(template, surface, surface_map))


@dataclass(frozen=True, eq=False)
class Reading:
    """Readings of one working surface, the best first."""

    working: WorkingSurface
    target: Target
    candidates: list[Candidate]
    confidence: float
    doubt: str


def read_body(template: Template, surface: Surface, hints: Hints, tell: Tell) -> Reading:
    """The reading that is the surest. Raises `RetargetError` where it is not sure enough and nothing was said, and where a
    template that is no human lies elsewhere than was said."""
    found = _surest(template, surface, hints, tell)
    if found.confidence < LEAST_CONFIDENCE and not hints:
        raise RetargetError(doubtful(surface, found.working, found.doubt, found.confidence))
    if not template.human and hints.known is None:
        _expect_likeness(found, hints.given)
    return found


def _surest(template: Template, surface: Surface, hints: Hints, tell: Tell) -> Reading:
    """The working surface whose best reading is the surest. Raises `RetargetError` where nothing is named and no surface is one
    body's alone."""
    best: Reading | None = None
    tell("preparing the surface", 1)
    for working in working_surfaces(surface):
        if working.left_out > MOST_LEFT_OUT and not hints:
            if best is None:
                apart = f"{100 * working.left_out:.0f} % of the surface {STANDS_APART}"
                raise RetargetError(doubtful(surface, working, apart, 0.0))
            break
        target, found = candidates(template, intrinsic_body(working.surface), hints.given, tell, hints.known)
        this = Reading(working, target, found, *confidence_of(found))
        if best is None or this.confidence > best.confidence:
            best = this
        if best.confidence > CLEAR:
            break
        tell("closing a shell around all pieces", 1)
    return best


def _expect_likeness(found: Reading, given: Given) -> None:
    """Raises `RetargetError` where a template that is no human does not lie in the mesh, or not as the landmarks say."""
    best, length = found.candidates[0], float(np.ptp(found.target.vertices, axis=0).max())
    cure = "check which landmark is where, give more of them, or take a template of the mesh's structure"
    if best.misfit.template > ILL:
        raise RetargetError(
            f"the template does not fit the mesh: its surface ends up {best.misfit.template / length:.1%} of the mesh's length "
            f"away, {ILL / length:.1%} is the limit; {cure}"
        )
    worst = int(best.landmarks.argmax())
    if best.landmarks[worst] > FAR_FROM_LANDMARK:
        raise RetargetError(
            f"the template fits the mesh only with its {given.names[worst]!r} {best.landmarks[worst] / length:.0%} of the mesh's "
            f"length from the landmark; {cure}"
        )


def doubtful(mesh: Surface, working: WorkingSurface, doubt: str, confidence: float) -> str:
    """The line that says what was seen, what is in doubt, and what would help."""
    size = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
    count = f"{len(mesh)} vertices in {working.pieces} piece{'s' if working.pieces > 1 else ''}"
    return (
        f"no body was found with certainty in {count}, {size} units large: {doubt} "
        f"(confidence {confidence:.2f}; {LEAST_CONFIDENCE} is needed). Say where some places are, by vertex: "
        "--landmarks head=N,leftHand=N,rightHand=N,leftFoot=N,rightFoot=N"
    )


def _onto_surface(template: Template, surface: Surface, surface_map: Places) -> Places:
    """A map onto the template's file as one onto its surface. Raises `RetargetError` for a map of another mesh or another
    template."""
    own = template.file_vertices
    if len(surface_map.corners) != len(surface) or surface_map.corners.max(initial=0) >= len(own):
        raise RetargetError(
            f"the surface map is of {len(surface_map.corners)} vertices onto vertex {surface_map.corners.max(initial=0)}; the mesh "
            f"has {len(surface)}, the template {len(own)}"
        )
    return Places(own[surface_map.corners], surface_map.weights)


def _known_places(template: Template, surface: Surface, surface_map: Places) -> Float[Array, "template 3"]:
    """For each vertex of the template, the vertex of the mesh that is mapped nearest to it."""
    from scipy.spatial import cKDTree

    rest = template.model.points
    return surface.vertices[cKDTree(surface_map.of(rest)).query(rest)[1]]
