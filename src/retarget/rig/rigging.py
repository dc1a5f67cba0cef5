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
from retarget.geometry.resample import Surface
from retarget.progress import Tell, untold
from retarget.rig.fit import LIKE_NORMALS, Target
from retarget.rig.fit_model import part_transforms, pose_body
from retarget.rig.given import Given, expect_landmarks
from retarget.rig.laying import LaidOn, lay_on
from retarget.rig.rest import rest_from_pose
from retarget.rig.search import CLEAR, FAR_FROM_LANDMARK, ILL, Candidate, candidates, confidence_of
from retarget.rig.shares import bare_parts
from retarget.rig.stretch import fill_stretched
from retarget.rig.template import Template, intrinsic_body
from retarget.rig.templates import human_template
from retarget.rig.unit import likely_unit, usual_height
from retarget.rig.weights import HELD_AWAY, finer_places, places_on_template, rigid_pieces, sparse_weights
from retarget.rig.working_surface import (
    MOST_LEFT_OUT,
    STANDS_APART,
    WorkingSurface,
    finite_surface,
    surface_of_points,
    working_surfaces,
)

Array = np.ndarray

LEAST_CONFIDENCE = 0.34
"""Below this no rig is delivered: landmarks are asked for."""
LIKE_NORMALS_OF_PIECES = 0.3 * LIKE_NORMALS
"""How far apart opposite normals put two places on bodies put together of pieces, whose surfaces turn every way."""
RINGS_OF_PIECES = 2
"""Vertices around stretched edges whose weights are filled in too on such bodies, whose places are less sure."""


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
    taken. Raises `RetargetError` for a unit that is no length, for a mesh that cannot be worked on, that holds no body of the
    template's kind, or of which more must be known.
    """
    if unit is not None and not 0.0 < unit < float("inf"):
        raise RetargetError(f"a unit of {unit:g} metres; it must be a length above nought")
    template = template or human_template()
    mesh = _as_mesh(body, tell)
    surface = finite_surface(mesh.vertices, mesh.faces)
    if surface_map is not None:
        surface_map = _onto_surface(template, surface, surface_map)
    known = None if surface_map is None else _known_places(template, surface, surface_map)
    given = Given.of(template, surface, landmarks or {})
    if known is None:
        expect_landmarks(template, given)
    found = _found(template, surface, given, tell, known)
    if found.confidence < LEAST_CONFIDENCE and not landmarks and known is None:
        raise RetargetError(_doubtful(surface, found.working, found.doubt, found.confidence))
    if not template.human and known is None:
        _expect_likeness(found, given)
    best, target = found.candidates[0], found.target
    tell("laying the template on", 1)
    moved = _turned_like(Surface((surface.vertices - target.origin) * target.unit, surface.faces), target)
    fitted = lay_on(template, best, target, moved, None if known is None else (known - target.origin) * target.unit)
    tell("weights", 1)
    model = template.model
    like_normals = LIKE_NORMALS_OF_PIECES if found.working.fused else LIKE_NORMALS
    places = places_on_template(moved, fitted.registered, template.faces, model.points, like_normals)
    if surface_map is not None:
        places = finer_places(surface_map, places, model.points)
    bare = bare_parts(template, pose_body(model, fitted.state).points, moved, places) if template.human else {}
    lost = {name: share for name, share in bare.items() if not name.endswith("Hand")}  # a fist may lie in an armpit
    if lost and not landmarks and known is None:
        doubt = f"nothing of it is left for {', '.join(lost)}"
        raise RetargetError(_doubtful(surface, found.working, doubt, found.confidence * min(lost.values())))
    away = np.linalg.norm(places.of(fitted.registered.vertices) - moved.vertices, axis=1)
    filling = fill_stretched(moved, places.of(model.points), RINGS_OF_PIECES if found.working.fused else 0)
    carried = rigid_pieces(moved, filling.of(places.of(model.weights)), away)
    rest = rest_from_pose(model, fitted.state, carried, moved.vertices)
    body = away < max(HELD_AWAY, float(np.median(away)))
    floor, top = float(rest[body, 1].min()), float(rest[body, 1].max())
    height = (top - floor) / target.unit
    told = (unit, f"{height * (unit or 0.0):.2f} m tall")
    usual = usual_height(template, fitted.state.shape)
    metres, note = likely_unit(height, usual, template.height) if unit is None else told
    skin = sparse_weights(rigid_pieces(moved, filling.of(places.of(template.weights)), away))
    character = _character(template, fitted, replace(mesh, vertices=rest), skin, floor, metres / target.unit)
    notes = (note, *((f"{found.working.pieces} pieces, taken as one body",) if found.working.fused else ()), best.how)
    notes += (f"next to nothing of the mesh is {', '.join(bare)}",) if bare else ()
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


def _found(
    template: Template, surface: Surface, given: Given, tell: Tell, known: Float[Array, "template 3"] | None
) -> _Found:
    """The working surface whose best reading is the surest. Raises `RetargetError` where nothing is named and no surface is one
    body's alone."""
    best: _Found | None = None
    tell("preparing the surface", 1)
    for working in working_surfaces(surface):
        if working.left_out > MOST_LEFT_OUT and not given and known is None:
            if best is None:
                apart = f"{100 * working.left_out:.0f} % of the surface {STANDS_APART}"
                raise RetargetError(_doubtful(surface, working, apart, 0.0))
            break
        target, found = candidates(template, intrinsic_body(working.surface), given, tell, known)
        this = _Found(working, target, found, *confidence_of(found))
        if best is None or this.confidence > best.confidence:
            best = this
        if best.confidence > CLEAR:
            break
        tell("closing a shell around all pieces", 1)
    return best


def _turned_like(mesh: Surface, target: Target) -> Surface:
    """The mesh with its faces turned over if most look against the working surface, which is oriented outward."""
    from scipy.spatial import cKDTree

    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    near = cKDTree(target.vertices).query(corners.mean(axis=1))[1]
    if np.einsum("fx,fx->", across, target.normals[near]) < 0:
        return Surface(mesh.vertices, mesh.faces[:, ::-1])
    return mesh


def _character(
    template: Template, fitted: LaidOn, mesh: Mesh, skin: tuple[Array, Array], floor: float, scale: float
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


def _all_joints(template: Template, fitted: LaidOn) -> Float[Array, "joints 3"]:
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


def _doubtful(mesh: Surface, working: WorkingSurface, doubt: str, confidence: float) -> str:
    size = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
    count = f"{len(mesh)} vertices in {working.pieces} piece{'s' if working.pieces > 1 else ''}"
    return (
        f"no body was found with certainty in {count}, {size} units large: {doubt} "
        f"(confidence {confidence:.2f}; {LEAST_CONFIDENCE} is needed). Say where some places are, by vertex: "
        "--landmarks head=N,leftHand=N,rightHand=N,leftFoot=N,rightFoot=N"
    )
