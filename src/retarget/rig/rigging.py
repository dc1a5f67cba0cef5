"""The verb of this folder: a bare mesh in any pose becomes a rigged character at rest.

    >>> from retarget.io import load
    >>> rigged = rig(load("statue.obj").mesh)
    >>> rigged.character.skeleton.names[:3], rigged.confidence

Musoni 2021 goes from a functional map to weights, from weights to joints, from joints to the rest pose. Here the template's
body is fitted, shape and pose together, and laid onto the skin; weights, joints and rest pose are then read off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Character, Mesh, PointCloud, Skeleton, Skin
from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface, cleaned, decimate
from retarget.progress import Tell, untold
from retarget.rig.fit import LIKE_NORMALS, Pull, Target, fit_to_places, fit_to_surface
from retarget.rig.fit_model import BodyState, FitModel, part_transforms, pose_body
from retarget.rig.given import Given, expect_landmarks
from retarget.rig.registration import Registered, register
from retarget.rig.rest import rest_from_pose
from retarget.rig.search import CLEAR, FAR_FROM_LANDMARK, ILL, Candidate, candidates, confidence_of
from retarget.rig.template import SAMPLES, Template, intrinsic_body
from retarget.rig.templates import human_template
from retarget.rig.weights import HELD_AWAY, places_on_template, rigid_pieces, sparse_weights
from retarget.rig.working_surface import WorkingSurface, finite_surface, surface_of_points, working_surfaces

Array = np.ndarray

LEAST_CONFIDENCE = 0.34
"""Below this no rig is delivered: landmarks are asked for."""
FINE = [Pull(0.03, 0.02, 1e-6, 2e-7)] * 8
FINGERS = [Pull(0.03, 0.02, 1e-6, 2e-7)] * 5
GUIDED = Pull(0.05, 1.0, 1e-5, 1e-6)
REFIT = Pull(0.05, 1.0, 1e-6, 1e-7)
LIKE_NORMALS_OF_PIECES = 0.3 * LIKE_NORMALS
"""How far apart opposite normals put two places on bodies put together of pieces, whose surfaces turn every way."""
LAID_ON = 30_000
"""Vertices of the mesh that the template is laid onto; larger ones are decimated for that."""
UNITS = {"m": (1.0, 0.0), "cm": (0.01, 0.0), "mm": (0.001, 0.0), "dm": (0.1, 0.6), "inch": (0.0254, 0.6)}
"""Metres, and how much better the height must fit (in its logarithm) for the rarer ones."""
PLAUSIBLE, USUAL = (0.4, 3.0), 1.7
"""Heights of bodies in metres by which a unit is told, and the likeliest."""


@dataclass(frozen=True, eq=False)
class Rigged:
    """A bare mesh with its rig, and how it came about."""

    character: Character
    """In metres, +Y up, facing +Z, in the template's rest pose. Vertices, their order, UVs and materials are the mesh's."""
    confidence: float
    """0 to 1: how well the body fits, and how much better than the other way round."""
    places: Places
    """Where each vertex of the character lies on the template."""
    joints: Float[Array, "joints 3"]
    """Joints of the template's model in the pose of the mesh, in its own space."""
    posed: Float[Array, "template 3"]
    """The template's vertices laid onto the mesh, in its own space."""
    unit: float
    """Metres in a unit of the mesh."""
    notes: tuple[str, ...]
    """What was inferred and chosen."""


@dataclass(frozen=True, eq=False)
class _Fitted:
    """The template's body in the mesh, in the target's metres."""

    state: BodyState
    registered: Registered


def rig(
    body: Mesh | PointCloud,
    template: Template | None = None,
    landmarks: Mapping[str, int | Float[Array, "3"]] | None = None,
    surface_map: Places | None = None,
    unit: float | None = None,
    tell: Tell = untold,
) -> Rigged:
    """Give a mesh the template's skeleton, weights and rest pose. A cloud of points gets a closed surface first.

    `landmarks` name vertices or places of the mesh by the template's landmarks (`Template.landmarks`, or the number of a vertex
    of its mesh, as text); a template that is no human needs four. `surface_map` is the place of each vertex on the template's
    mesh, where it is known. `unit` is metres in a unit of the mesh; without it the unit that makes a plausible height is
    taken. Raises `RetargetError` for a mesh that cannot be worked on, that holds no body of the template's kind, or of which
    more must be known.
    """
    template = template or human_template()
    mesh = _as_mesh(body, tell)
    surface = finite_surface(mesh.vertices, mesh.faces)
    known = None if surface_map is None else _known_places(template, surface, surface_map)
    given = Given.of(template, surface, landmarks or {})
    if known is None:
        expect_landmarks(template, given)
    found = _found(template, surface, given, tell, known)
    if found.confidence < LEAST_CONFIDENCE and not landmarks and known is None:
        raise RetargetError(_doubtful(mesh, found))
    if not template.human and known is None:
        _expect_likeness(found, given)
    best, target = found.candidates[0], found.target
    tell("laying the template on", 1)
    moved = Surface((surface.vertices - target.origin) * target.unit, surface.faces)
    fitted = _fitted(template, best, target, moved, None if known is None else (known - target.origin) * target.unit)
    tell("weights", 1)
    model = template.model
    like_normals = LIKE_NORMALS_OF_PIECES if found.working.fused else LIKE_NORMALS
    places = places_on_template(moved, fitted.registered, template.faces, model.points, like_normals)
    away = np.linalg.norm(places.of(fitted.registered.vertices) - moved.vertices, axis=1)
    rest = rest_from_pose(model, fitted.state, rigid_pieces(moved, places.of(model.weights), away), moved.vertices)
    body = away < max(HELD_AWAY, float(np.median(away)))
    floor, top = float(rest[body, 1].min()), float(rest[body, 1].max())
    height = (top - floor) / target.unit
    metres, note = likely_unit(height, template.height) if unit is None else (unit, f"{height * unit:.2f} m tall")
    skin = sparse_weights(rigid_pieces(moved, places.of(template.weights), away))
    character = _character(template, fitted, replace(mesh, vertices=rest), skin, floor, metres / target.unit)
    notes = (note, *((f"{found.working.pieces} pieces, taken as one body",) if found.working.fused else ()), best.how)
    joints, _ = part_transforms(model, fitted.state)
    return Rigged(
        character,
        found.confidence,
        places,
        target.outside(joints),
        target.outside(fitted.registered.vertices),
        metres,
        notes,
    )


def _as_mesh(body: Mesh | PointCloud, tell: Tell) -> Mesh:
    if isinstance(body, Mesh):
        return body
    tell("closing a surface around the points", 1)
    found = surface_of_points(body.points)
    return Mesh(found.vertices, found.faces)


@dataclass(frozen=True, eq=False)
class _Found:
    """Readings of one working surface."""

    working: WorkingSurface
    target: Target
    candidates: list[Candidate]
    confidence: float
    doubt: str


def _known_places(template: Template, surface: Surface, surface_map: Places) -> Float[Array, "template 3"]:
    """For each vertex of the template, the vertex of the mesh that is mapped nearest to it. Raises `RetargetError` for a map
    of another mesh or another template."""
    from scipy.spatial import cKDTree

    rest, own = template.model.points, template.file_vertices
    if len(surface_map.corners) != len(surface) or surface_map.corners.max(initial=0) >= len(own):
        raise RetargetError(
            f"the surface map is of {len(surface_map.corners)} vertices onto vertex {surface_map.corners.max(initial=0)}; the mesh "
            f"has {len(surface)}, the template {len(own)}"
        )
    surface_map = Places(own[surface_map.corners], surface_map.weights)
    return surface.vertices[cKDTree(surface_map.of(rest)).query(rest)[1]]


def _found(
    template: Template, surface: Surface, given: Given, tell: Tell, known: Float[Array, "template 3"] | None
) -> _Found:
    """The working surface whose best reading is the surest."""
    best: _Found | None = None
    tell("preparing the surface", 1)
    for working in working_surfaces(surface):
        target, found = candidates(template, intrinsic_body(working.surface), given, tell, known)
        this = _Found(working, target, found, *confidence_of(found))
        if best is None or this.confidence > best.confidence:
            best = this
        if best.confidence > CLEAR:
            break
    return best


def _fitted(
    template: Template, found: Candidate, target: Target, mesh: Surface, known: Float[Array, "template 3"] | None
) -> _Fitted:
    """The best candidate, finely: without, then with fingers; laid onto the mesh; and turned as the skin then says."""
    body = template.body.at(template.samples[:SAMPLES]).around(found.usual)
    state = fit_to_surface(body, found.state, target, FINE)
    model = template.model.around(found.usual)
    fine, state = model.at(template.samples), _with_fingers(state, model)
    if known is not None:
        state = fit_to_places(fine, state, known[template.samples], 6, GUIDED)
    state = fit_to_surface(fine, state, target, FINGERS)
    laid_on = mesh if len(mesh) <= LAID_ON else decimate(cleaned(mesh), LAID_ON)
    registered = register(pose_body(model, state).points, template.faces, laid_on)
    state = fit_to_places(fine, state, registered.vertices[template.samples], 2, REFIT)
    return _Fitted(state, registered)


def _with_fingers(state: BodyState, model: FitModel) -> BodyState:
    """The same state with fingers that follow their hands."""
    turns = np.empty((len(model.parents), 3, 3))
    turns[: len(state.turns)] = state.turns
    for joint in range(len(state.turns), len(turns)):
        turns[joint] = turns[model.parents[joint]]
    return BodyState(state.shape, turns, state.root)


def likely_unit(height: float, usual: float = USUAL) -> tuple[float, str]:
    """Metres in a unit by which a body so many units tall is likely, and why; `usual` is how tall such bodies are."""
    likely = [
        (abs(np.log(height * unit / usual)) + rare, name, unit)
        for name, (unit, rare) in UNITS.items()
        if PLAUSIBLE[0] <= height * unit * USUAL / usual <= PLAUSIBLE[1]
    ]
    if likely:
        _, name, unit = min(likely)
        return unit, f"unit {name}: the body is {height * unit:.2f} m tall"
    return usual / height, f"no unit makes a height of {height:.4g} plausible: scaled to {usual:.2f} m"


def _character(
    template: Template, fitted: _Fitted, mesh: Mesh, skin: tuple[Array, Array], floor: float, scale: float
) -> Character:
    """Skeleton and weights of the template on the mesh, which is at rest; feet on y = 0, hips at x = z = 0."""
    skeleton, (columns, weights) = template.skeleton, skin
    joints = _all_joints(template, fitted)
    shift = np.array([joints[0, 0], floor, joints[0, 2]])
    joints, vertices = (joints - shift) * scale, (mesh.vertices - shift) * scale
    world, _ = rest_pose(skeleton)
    offsets = joints.copy()
    child = np.flatnonzero(skeleton.parents >= 0)
    above = skeleton.parents[child]
    offsets[child] = rot.rotate(rot.inverse(world[above]), joints[child] - joints[above])
    binds = np.tile(np.eye(4), (len(skeleton), 1, 1))
    turn = rot.to_matrix(rot.inverse(world))
    binds[:, :3, :3], binds[:, :3, 3] = turn, -np.einsum("jab,jb->ja", turn, joints)
    rigged = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.rest_rotations)
    return Character(
        rigged, replace(mesh, vertices=vertices), Skin(np.arange(len(skeleton)), binds, columns, weights), name="rigged"
    )


def _all_joints(template: Template, fitted: _Fitted) -> Float[Array, "joints 3"]:
    """Every joint of the template's character at rest: fitted ones from the shape, the others from the skin around them."""
    model = template.model
    joints = np.empty((len(template.skeleton), 3))
    joints[template.joints] = model.joints_of(fitted.state.shape)
    others = np.setdiff1d(np.arange(len(joints)), template.joints)
    if len(others):
        rest = rest_from_pose(model, fitted.state, model.weights, fitted.registered.vertices)
        joints[others] = np.einsum("jk,jkx->jx", template.other_shares, rest[template.other_vertices])
    return joints


def _expect_likeness(found: _Found, given: Given) -> None:
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


def _doubtful(mesh: Mesh, found: _Found) -> str:
    size = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
    count = f"{len(mesh.vertices)} vertices in {found.working.pieces} piece{'s' if found.working.pieces > 1 else ''}"
    return (
        f"no body was found with certainty in {count}, {size} units large: {found.doubt} "
        f"(confidence {found.confidence:.2f}; {LEAST_CONFIDENCE} is needed). Say where some places are, by vertex: "
        "--landmarks head=N,leftHand=N,rightHand=N,leftFoot=N,rightFoot=N"
    )
