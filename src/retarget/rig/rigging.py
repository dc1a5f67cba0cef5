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
from retarget.rig.carrying import Carried, carry
from retarget.rig.fit import Target
from retarget.rig.fit_model import part_transforms
from retarget.rig.laying import LaidOn, lay_on
from retarget.rig.reading import Hints, read_body
from retarget.rig.rest import rest_from_pose
from retarget.rig.template import Template
from retarget.rig.templates import human_template
from retarget.rig.unit import likely_unit, usual_height
from retarget.rig.working_surface import finite_surface, surface_of_points

Array = np.ndarray


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
    mesh = as_mesh(body, tell)
    surface = finite_surface(mesh.vertices, mesh.faces)
    hints = Hints.of(template, surface, landmarks or {}, surface_map)
    reading = read_body(template, surface, hints, tell)
    best, target = reading.candidates[0], reading.target
    tell("laying the template on", 1)
    inside = _turned_like(Surface(target.inside(surface.vertices), surface.faces), target)
    laid = lay_on(template, best, target, inside, None if hints.known is None else target.inside(hints.known))
    tell("weights", 1)
    carried = carry(template, laid, reading, inside, hints)
    height = (carried.top - carried.floor) / target.unit
    if unit is None:
        unit, note = likely_unit(height, usual_height(template, laid.state.shape), template.height)
    else:
        note = f"{height * unit:.2f} m tall"
    pieces = (f"{reading.working.pieces} pieces, taken as one body",) if reading.working.fused else ()
    bare = (f"next to nothing of the mesh is {', '.join(carried.bare)}",) if carried.bare else ()
    joints, _ = part_transforms(template.model, laid.state)
    return Rigged(
        _character(template, laid, mesh, carried, unit / target.unit),
        reading.confidence,
        carried.places,
        target.outside(joints),
        target.outside(laid.registered.vertices),
        unit,
        (note, *pieces, best.how, *bare),
    )


def as_mesh(body: Mesh | PointCloud, tell: Tell = untold) -> Mesh:
    """A mesh as it is; of a cloud a closed surface around its points. Raises `RetargetError` for too few of them."""
    if isinstance(body, Mesh):
        return body
    tell("closing a surface around the points", 1)
    found = surface_of_points(body.points)
    return Mesh(found.vertices, found.faces)


def _turned_like(mesh: Surface, target: Target) -> Surface:
    """The mesh with its faces turned over if most look against the working surface, which is oriented outward."""
    from scipy.spatial import cKDTree

    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    near = cKDTree(target.vertices).query(corners.mean(axis=1))[1]
    if np.einsum("fx,fx->", across, target.normals[near]) < 0:
        return Surface(mesh.vertices, mesh.faces[:, ::-1])
    return mesh


def _character(template: Template, fitted: LaidOn, mesh: Mesh, carried: Carried, scale: float) -> Character:
    """Skeleton and weights of the template on the mesh at rest; feet on y = 0, hips at x = z = 0."""
    skeleton = template.skeleton
    joints = _all_joints(template, fitted)
    shift = np.array([joints[0, 0], carried.floor, joints[0, 2]])
    joints, vertices = (joints - shift) * scale, (carried.rest - shift) * scale
    world, _ = rest_pose(skeleton)
    offsets = joints.copy()
    child = np.flatnonzero(skeleton.parents >= 0)
    above = skeleton.parents[child]
    offsets[child] = rot.rotate(rot.inverse(world[above]), joints[child] - joints[above])
    binds = np.tile(np.eye(4), (len(skeleton), 1, 1))
    turn = rot.to_matrix(rot.inverse(world))
    binds[:, :3, :3], binds[:, :3, 3] = turn, -np.einsum("jab,jb->ja", turn, joints)
    rigged = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.rest_rotations)
    skin = Skin(np.arange(len(skeleton)), binds, carried.columns, carried.weights)
    return Character(rigged, replace(mesh, vertices=vertices), skin, name="rigged")


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
