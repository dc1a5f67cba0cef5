"""A rigged body that others get their rig from.

A template is fitted by the joints of its `Structure`. A human's are the canonical ones: those of the body first, fingers at
the end. Twist bones, props and the rest hang on them rigidly in the fit and are placed afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.human import human_model
from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton
from retarget.correspond.joints import HUMANOID_JOINTS
from retarget.correspond.landmarks import IntrinsicBody, Labelled, label_tips
from retarget.geometry.geodesic import Geodesics, farthest_points
from retarget.geometry.resample import Surface
from retarget.geometry.spectral import spectral_basis
from retarget.geometry.topology import vertex_normals
from retarget.rig.fit import HEIGHT
from retarget.rig.fit_model import FitModel, part_shapes
from retarget.rig.working_surface import working_surfaces

Array = np.ndarray

SAMPLES, FINER = 1500, 1000
"""Points of the template that a fit weighs, and further ones where fingers are fitted."""
FUNCTIONS = 120
"""Eigenfunctions of a body."""
NEAR, OUTSIDE = 60, 0.12 * HEIGHT
"""Vertices that place a joint outside the model, and metres from the nearest from which all of the body does."""
PART_SPREAD = 0.15
"""How far parts of humans are expected to differ in size and girth, as a share."""
FINGERS = tuple(name for name in HUMANOID_JOINTS if any(word in name for word in (
    "Thumb", "Index", "Middle", "Ring", "Little")))  # fmt: skip
MAIN = tuple(name for name in HUMANOID_JOINTS if name not in FINGERS and "Eye" not in name and name != "jaw")
"""Canonical joints of the body."""
AVERAGE: dict[str, tuple[float, float]] = {}
STYLISED = {"head": (1.2, 0.0), "UpperLeg": (-0.45, 0.3), "LowerLeg": (-0.45, 0.3), "UpperArm": (-0.3, 0.3),
            "LowerArm": (-0.3, 0.3), "Hand": (0.3, 0.0), "Foot": (0.3, 0.0)}  # fmt: skip
"""Growth of parts, in size and girth, of a second body to start from: big head, short limbs, as toys and games have them."""


@dataclass(frozen=True, eq=False)
class Start:
    """A shape of the template to begin with, and its intrinsic side."""

    name: str
    shape: Float[Array, "shapes"]
    body: IntrinsicBody
    labelled: Labelled | None
    """Its ends, where it is a human."""
    near: Any
    """Tree over the intrinsic surface's vertices."""
    vertices: Float[Array, "vertices 3"]
    """All of the template's vertices in that shape."""
    samples: Int[Array, "samples"]
    """For each point that a fit weighs, the vertex of the intrinsic surface nearest to it."""


@dataclass(frozen=True, eq=False)
class Template:
    """A rigged body ready to be fitted, about `fit.HEIGHT` tall, with +Y up and facing +Z."""

    skeleton: Skeleton
    """What others get, in its own proportions."""
    joints: Int[Array, "model"]
    """Joints of the skeleton that the model's joints are."""
    names: tuple[str, ...]
    """Their names: canonical ones, fingers last, or the skeleton's own where it is no human."""
    model: FitModel
    """With fingers, at every vertex of the template's surface."""
    body: FitModel
    """Without fingers: they follow their hands."""
    weights: Float[Array, "vertices joints"]
    """Skinning weights of all joints of the skeleton."""
    faces: Int[Array, "faces 3"]
    samples: Int[Array, "samples"]
    """Vertices that a fit weighs, spread evenly, so that any first ones are."""
    starts: tuple[Start, ...]
    feet: Bool[Array, "vertices"]
    """Whether a vertex follows a foot or its toes; none where it is no human."""
    landmarks: Mapping[str, int]
    """Vertices by name: the body's ends, and whatever else has a name."""
    file_vertices: Int[Array, "file"]
    """For each vertex of the character's mesh, as its file has it, the nearest of the template's surface."""
    height: float
    """Metres that such a body is tall: by this the unit of a mesh is told."""
    other_vertices: Int[Array, "others near"]
    """For each joint outside the model, in their order, vertices around it."""
    other_shares: Float[Array, "others near"]
    """Their shares in its place; rows sum to one."""

    @property
    def human(self) -> bool:
        """Whether its ends and stances are a human's: what else it is laid into a mesh by landmarks."""
        return all(start.labelled is not None for start in self.starts)


@dataclass(frozen=True, eq=False)
class Structure:
    """The joints that a template is fitted by, and how they belong together."""

    names: tuple[str, ...]
    joints: Int[Array, "model"]
    """Joints of the skeleton."""
    parents: Int[Array, "model"]
    """Among themselves; parents come before their children, and joint 0 is the root."""
    body: int
    """How many of them are fitted first; the others (fingers) follow their parents there."""
    groups: list[list[int]]
    """Joints of the body whose parts grow together: one of the middle, or a left and its right one."""
    feet: tuple[int, ...]
    spread: float = PART_SPREAD
    """How far parts are expected to differ in size and girth, as a share."""


@dataclass(frozen=True, eq=False)
class Parts:
    """What a template is made of; see `make_template`."""

    skeleton: Skeleton
    structure: Structure
    surface: Surface
    """At rest."""
    weights: Float[Array, "vertices joints"]
    ends: tuple[int, ...]
    """Vertices of the body's ends, in the order of `landmarks.TIPS`; none where it is no human."""
    landmarks: Mapping[str, int]
    file_vertices: Int[Array, "file"]
    """As in `Template`."""
    height: float
    """As in `Template`."""
    components: Float[Array, "components vertices 3"]
    """Shapes known beforehand, one standard deviation each; there may be none."""
    component_joints: Float[Array, "components model 3"]
    """How the model's joints move with them."""
    starts: Mapping[str, Mapping[str, tuple[float, float]]]
    """Shapes to begin with: growth of parts in size and girth, by the ends of their joints' names."""


def model_names(joints: Mapping[str, int]) -> tuple[str, ...]:
    """The canonical joints that a model has, fingers last."""
    return tuple(name for name in (*MAIN, *FINGERS) if name in joints)


def human_structure(joints: Mapping[str, int]) -> Structure:
    """The canonical joints that a skeleton has, by their names."""
    names = model_names(joints)
    body = sum(name in MAIN for name in names)
    feet = tuple(number for number, name in enumerate(names) if name.endswith(("Foot", "Toes")))
    chosen = np.array([joints[name] for name in names])
    return Structure(names, chosen, _canonical_parents(names), body, _groups(names[:body]), feet)


def make_template(parts: Parts) -> Template:
    """Prepare a rigged body for fits. Lengths must be metres of a body about `fit.HEIGHT` tall, with `fit.AREA` of skin."""
    structure = parts.structure
    names, joints, parents, body = structure.names, structure.joints, structure.parents, structure.body
    vertices, faces = parts.surface.vertices, parts.surface.faces
    rest = rest_pose(parts.skeleton)[1]
    weights = parts.weights @ _owners(parts.skeleton, joints)
    follow = np.arange(len(names))
    for joint in range(body, len(names)):
        follow[joint] = follow[parents[joint]]
    alone = weights @ np.eye(body)[follow]
    groups = structure.groups
    own, own_joints = part_shapes(parents[:body], vertices, rest[joints[:body]], alone, groups)
    model = FitModel(
        parents,
        vertices,
        vertex_normals(vertices, faces),
        rest[joints],
        weights,
        np.concatenate([parts.components, own, vertices[None]]),
        np.concatenate([parts.component_joints, own_joints[:, follow], rest[None, joints]]),
        np.concatenate([np.ones(len(parts.components)), np.full(len(own), structure.spread), [10.0]]),
        np.zeros(len(parts.components) + len(own) + 1),
        np.zeros((len(names), 3)),
        body,
    )
    without_fingers = replace(
        model,
        parents=parents[:body],
        joints=model.joints[:body],
        weights=alone,
        joint_basis=model.joint_basis[:, :body],
        bends=model.bends[:body],
    )
    samples = farthest_points(vertices, SAMPLES + FINER, parts.ends[0] if parts.ends else 0)
    shapes = {name: _grown(model, names, groups, growth) for name, growth in parts.starts.items()}
    starts = tuple(_start(name, model, shape, faces, parts.ends, samples) for name, shape in shapes.items())
    feet = weights[:, list(structure.feet)].sum(axis=1) > 0.5
    around, shares = _placed_by_skin(rest[np.setdiff1d(np.arange(len(rest)), joints)], vertices)
    return Template(
        parts.skeleton, joints, names, model, without_fingers, parts.weights, faces, samples, starts, feet,
        parts.landmarks, parts.file_vertices, parts.height, around, shares,
    )  # fmt: skip


def intrinsic_body(surface: Surface) -> IntrinsicBody:
    """Eigenfunctions and geodesics of a surface."""
    return IntrinsicBody(surface, spectral_basis(surface.vertices, surface.faces, FUNCTIONS), Geodesics(surface))


def _canonical_parents(names: tuple[str, ...]) -> Int[Array, "model"]:
    """The nearest joint above each in the canonical human, whatever the skeleton's own tree: some keep feet under the root."""
    human = human_model()
    parents = np.full(len(names), -1)
    for number, name in enumerate(names[1:], 1):
        above = name
        while True:
            above = human.joint_names[human.parents[human.joint_names.index(above)]]
            if above in names:
                parents[number] = names.index(above)
                break
    return parents


def _owners(skeleton: Skeleton, joints: Int[Array, "model"]) -> Float[Array, "joints model"]:
    """1 where a joint of the skeleton is a joint of the model, or hangs on it and on none nearer."""
    place = {int(joint): number for number, joint in enumerate(joints)}
    owner = np.zeros(len(skeleton), dtype=np.int64)
    for joint in range(len(skeleton)):
        owner[joint] = place.get(joint, owner[skeleton.parents[joint]] if joint else 0)
    return np.eye(len(joints))[owner]


def _groups(names: tuple[str, ...]) -> list[list[int]]:
    """Joints whose parts grow together: one of the middle, or a left and its right one."""
    groups = []
    for joint, name in enumerate(names):
        other = "right" + name.removeprefix("left")
        if name.startswith("left") and other in names:
            groups.append([joint, names.index(other)])
        elif not (name.startswith("right") and "left" + name.removeprefix("right") in names):
            groups.append([joint])
    return groups


def _grown(
    model: FitModel, names: tuple[str, ...], groups: list[list[int]], growth: Mapping[str, tuple[float, float]]
) -> Float[Array, "shapes"]:
    """The shape in which parts have grown in size and girth."""
    shape = np.zeros(len(model.spread))
    first = len(shape) - 1 - 2 * len(groups)
    for number, group in enumerate(groups):
        word = names[group[0]].removeprefix("left").removeprefix("right")
        shape[first + 2 * number : first + 2 * number + 2] = growth.get(word, (0.0, 0.0))
    return shape


def _start(
    name: str,
    model: FitModel,
    shape: Float[Array, "shapes"],
    faces: Int[Array, "faces 3"],
    ends: tuple[int, ...],
    samples: Int[Array, "samples"],
) -> Start:
    from scipy.spatial import cKDTree

    vertices = model.points_of(shape)
    body = intrinsic_body(next(working_surfaces(Surface(vertices, faces))).surface)
    near = cKDTree(body.surface.vertices)
    labelled = label_tips(body, near.query(vertices[list(ends)])[1]) if ends else None
    return Start(name, shape, body, labelled, near, vertices, near.query(vertices[samples])[1])


def _placed_by_skin(
    places: Float[Array, "others 3"], vertices: Float[Array, "vertices 3"]
) -> tuple[Int[Array, "others near"], Float[Array, "others near"]]:
    """Each place as the combination of the vertices around it with the smallest weights that gives it and sums to one; of
    vertices all over the body where none is near, as for a root on the ground.

    MMMC21 learn a regressor for each joint; the least-norm one is closed form, exact on the template, and as steady.
    """
    from scipy.spatial import cKDTree

    count = min(NEAR, len(vertices))
    distance, near = (each.reshape(len(places), count) for each in cKDTree(vertices).query(places, k=count))
    near[distance[:, 0] > OUTSIDE] = farthest_points(vertices, count)
    shares = np.zeros(near.shape)
    for number, (place, around) in enumerate(zip(places, near)):
        rows = np.concatenate([(vertices[around] - place).T, np.ones((1, len(around)))])
        shares[number] = np.linalg.pinv(rows, rcond=1e-6)[:, 3]
    return near, shares
