"""Rigged bodies that others get their rig from: the embedded human, or any rigged character.

A template is fitted by its canonical joints: those of the body first, fingers at the end. Twist bones, props and the rest
hang on them rigidly in the fit and are placed afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.human import human, human_model, human_vertices
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character
from retarget.correspond.joints import HUMANOID_JOINTS
from retarget.correspond.landmarks import IntrinsicBody, Labelled, label_tips
from retarget.errors import RetargetError
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
BODIES, COMPONENTS = 160, 24
"""Random embedded bodies, and the principal components kept of them."""
NEAR = 60
"""Vertices that place a joint outside the model."""
PART_SPREAD = 0.15
"""How far parts are expected to differ in size and girth, as a share."""
FINGERS = tuple(name for name in HUMANOID_JOINTS if any(word in name for word in (
    "Thumb", "Index", "Middle", "Ring", "Little")))  # fmt: skip
MAIN = tuple(name for name in HUMANOID_JOINTS if name not in FINGERS and "Eye" not in name and name != "jaw")
"""Canonical joints of the body."""
TIPS = {"head": "crown", "leftHand": "leftMiddleTip", "rightHand": "rightMiddleTip", "leftFoot": "leftBigToeTip",
        "rightFoot": "rightBigToeTip"}  # fmt: skip
"""Landmarks of the embedded human at the body's ends."""
STYLISED = {"head": (1.2, 0.0), "UpperLeg": (-0.45, 0.3), "LowerLeg": (-0.45, 0.3), "UpperArm": (-0.3, 0.3),
            "LowerArm": (-0.3, 0.3), "Hand": (0.3, 0.0), "Foot": (0.3, 0.0)}  # fmt: skip
"""Growth of parts, in size and girth, of a second body to start from: big head, short limbs, as toys and games have them."""


@dataclass(frozen=True, eq=False)
class Start:
    """A shape of the template to begin with, and its intrinsic side."""

    name: str
    shape: Float[Array, "shapes"]
    body: IntrinsicBody
    labelled: Labelled
    near: Any
    """Tree over the surface's vertices."""
    vertices: Float[Array, "vertices 3"]
    """All of the template's vertices in that shape."""
    samples: Int[Array, "samples"]
    """For each point that a fit weighs, the vertex of the intrinsic surface nearest to it."""


@dataclass(frozen=True, eq=False)
class Template:
    """A rigged body ready to be fitted, about `HEIGHT` tall, with +Y up and facing +Z."""

    character: Character
    joints: Int[Array, "model"]
    """Joints of the character that the model's joints are."""
    names: tuple[str, ...]
    """Their canonical names, fingers last."""
    model: FitModel
    """With fingers, at every vertex of the character's mesh."""
    body: FitModel
    """Without fingers: they follow their hands."""
    samples: Int[Array, "samples"]
    """Vertices that a fit weighs, spread evenly, so that any first ones are."""
    faces: Int[Array, "faces 3"]
    starts: tuple[Start, ...]
    feet: Bool[Array, "vertices"]
    """Whether a vertex follows a foot or its toes."""
    landmarks: dict[str, int]
    """Vertices by name: the body's ends, and whatever else has a name."""
    other_vertices: Int[Array, "others near"]
    """For each joint outside the model, vertices around it."""
    other_weights: Float[Array, "others near"]
    """Their share in its place; rows sum to one."""


@lru_cache(maxsize=1)
def human_template() -> Template:
    """The embedded human: its bodies' principal components, and every part free to grow; from an average and from a stylised
    body."""
    character = human(height=HEIGHT)
    model, vertices = human_model(), character.mesh.vertices
    names = MAIN + FINGERS
    joints = np.array([model.joint_names.index(name) for name in names])
    regressor = model.shape.regressor[joints]
    places, parents = regressor @ vertices, _model_parents(model.parents, joints)
    weights = _model_weights(character, joints)
    basis, body = _components(vertices), len(MAIN)
    groups = _groups(MAIN)
    own, _ = part_shapes(parents[:body], vertices, places[:body], _model_weights(character, joints[:body]), groups)
    point_basis = np.concatenate([basis, own, vertices[None]])
    joint_basis = np.einsum("jv,kvx->kjx", regressor, point_basis)
    spread = np.concatenate([np.ones(len(basis)), np.full(len(own), PART_SPREAD), [10.0]])
    fit = FitModel(parents, vertices, vertex_normals(vertices, model.faces), places, weights, point_basis, joint_basis,
                   spread, np.zeros(len(spread)))  # fmt: skip
    stylised = np.zeros(len(spread))
    for number, group in enumerate(groups):
        word = MAIN[group[0]].removeprefix("left")
        stylised[len(basis) + 2 * number : len(basis) + 2 * number + 2] = STYLISED.get(word, (0.0, 0.0))
    tips = [model.landmark(name) for name in TIPS.values()]
    samples = farthest_points(vertices, SAMPLES + FINER, tips[0])
    starts = tuple(
        _start(name, fit, shape, model.faces, tips, samples)
        for name, shape in (("average", np.zeros(len(spread))), ("stylised", stylised))
    )
    landmarks = dict(model.landmarks) | dict(zip(TIPS, tips))
    none = np.zeros((0, NEAR))
    return Template(character, joints, names, fit, _body_model(fit, body), samples, model.faces, starts,
                    _follows("Foot", "Toes", names=names, weights=weights), landmarks,
                    none.astype(np.int64), none)  # fmt: skip


def _body_model(model: FitModel, body: int) -> FitModel:
    """The model's first joints alone; the others follow the nearest of them that they hang on."""
    owner = np.arange(len(model.parents))
    for joint in range(body, len(owner)):
        owner[joint] = owner[model.parents[joint]]
    weights = np.zeros((len(model.points), body))
    for joint, own in enumerate(owner):
        weights[:, own] += model.weights[:, joint]
    return replace(
        model, parents=model.parents[:body], joints=model.joints[:body], weights=weights,
        joint_basis=model.joint_basis[:, :body],
    )  # fmt: skip


def _components(vertices: Float[Array, "vertices 3"]) -> Float[Array, "components vertices 3"]:
    """Principal components of random embedded bodies of one height, one standard deviation each."""
    draw = np.random.default_rng(7)
    details = human_model().detail_names
    bodies = []
    for _ in range(BODIES):
        shape = {"gender": draw.uniform(), "muscle": draw.uniform()}
        shape["weight"] = draw.uniform(0.0, 1.3) if draw.random() < 0.85 else draw.uniform(1.3, 2.0)
        shape["age"] = draw.uniform(0.4, 1.0) if draw.random() < 0.6 else draw.uniform(0.0, 0.4)
        shape |= {str(name): draw.uniform(-0.8, 0.8) for name in draw.choice(details, 10, replace=False)}
        body = human_vertices(**shape)
        bodies.append(body / np.ptp(body[:, 1]) * HEIGHT)
    away = np.stack(bodies).reshape(BODIES, -1)
    away -= away.mean(axis=0)
    values, vectors = np.linalg.eigh(away @ away.T)
    last = slice(-1, -COMPONENTS - 1, -1)
    components = vectors[:, last].T @ away / np.sqrt(BODIES)
    return components.reshape(COMPONENTS, -1, 3)


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


def _model_weights(character: Character, joints: Int[Array, "model"]) -> Float[Array, "vertices model"]:
    """Skinning weights of the model's joints, with those of all that hangs on them."""
    skin, parents = character.skin, character.skeleton.parents
    place = {int(joint): number for number, joint in enumerate(joints)}
    owner = np.zeros(len(parents), dtype=np.int64)
    for joint in range(len(parents)):
        owner[joint] = place.get(joint, owner[parents[joint]] if joint else 0)
    weights = np.zeros((len(skin.columns), len(joints)))
    np.add.at(weights, (np.arange(len(weights))[:, None], owner[skin.joints[skin.columns]]), skin.weights)
    return weights


def _start(
    name: str,
    model: FitModel,
    shape: Float[Array, "shapes"],
    faces: Int[Array, "faces 3"],
    tips: list[int],
    samples: Int[Array, "samples"],
) -> Start:
    from scipy.spatial import cKDTree

    vertices = model.points_of(shape)
    body = intrinsic_body(next(working_surfaces(Surface(vertices, faces))).surface)
    near = cKDTree(body.surface.vertices)
    labelled = label_tips(body, near.query(vertices[tips])[1])
    return Start(name, shape, body, labelled, near, vertices, near.query(vertices[samples])[1])


def intrinsic_body(surface: Surface) -> IntrinsicBody:
    """Eigenfunctions and geodesics of a surface."""
    return IntrinsicBody(surface, spectral_basis(surface.vertices, surface.faces, FUNCTIONS), Geodesics(surface))


def character_template(character: Character, joints: dict[str, int], tips: list[int] | None = None) -> Template:
    """Any rigged character with a surface, by its canonical joints (`Humanoid.joints`).

    `tips` are its vertices at the top of the head, the ends of the hands and of the feet (left first); without them, the
    vertices farthest out on each part. Raises `RetargetError` for a character without a surface or without limbs.
    """
    if character.mesh is None or character.skin is None:
        raise RetargetError(f"{character.name or 'the template'} has no surface, so it cannot be a template")
    body = [name for name in MAIN if name in joints]
    missing = [name for name in TIPS if name not in joints]
    if missing or body[0] != "hips":
        raise RetargetError(
            f"a template needs the joints hips, {', '.join(TIPS)}; it lacks {', '.join(missing) or 'hips'}"
        )
    names = tuple(body + [name for name in FINGERS if name in joints])
    chosen = np.array([joints[name] for name in names])
    parents = _model_parents(character.skeleton.parents, chosen)
    vertices, faces = rest_vertices(character), character.mesh.faces
    unit = HEIGHT / max(float(np.ptp(vertices[:, 1])), 1e-9)
    vertices, places = vertices * unit, rest_pose(character.skeleton)[1][chosen] * unit
    own, own_joints = part_shapes(
        parents[: len(body)],
        vertices,
        places[: len(body)],
        _model_weights(character, chosen[: len(body)]),
        _groups(names[: len(body)]),
    )
    owner = np.arange(len(names))
    for joint in range(len(body), len(owner)):
        owner[joint] = owner[parents[joint]]
    point_basis = np.concatenate([own, vertices[None]])
    joint_basis = np.concatenate([own_joints[:, owner], places[None]])
    spread = np.append(np.full(len(own), PART_SPREAD), 10.0)
    weights = _model_weights(character, chosen)
    fit = FitModel(parents, vertices, vertex_normals(vertices, faces), places, weights, point_basis, joint_basis, spread,
                   np.zeros(len(spread)))  # fmt: skip
    ends = tips or [_tip(name, names, vertices, places, weights) for name in TIPS]
    samples = farthest_points(vertices, SAMPLES + FINER, ends[0])
    start = _start("template", fit, np.zeros(len(spread)), faces, ends, samples)
    others = np.setdiff1d(np.arange(len(character.skeleton)), chosen)
    around, shares = _placed_by_skin(rest_pose(character.skeleton)[1][others] * unit, vertices)
    return Template(character, chosen, names, fit, _body_model(fit, len(body)), samples, faces, (start,),
                    _follows("Foot", "Toes", names=names, weights=weights), dict(zip(TIPS, ends)), around, shares)  # fmt: skip


def _model_parents(parents: Int[Array, "joints"], chosen: Int[Array, "model"]) -> Int[Array, "model"]:
    """For each chosen joint the nearest chosen one above it; the first where there is none."""
    place = {int(joint): number for number, joint in enumerate(chosen)}
    found = np.full(len(chosen), -1)
    for number, joint in enumerate(chosen):
        above = int(parents[joint])
        while above >= 0 and above not in place:
            above = int(parents[above])
        found[number] = place[above] if above >= 0 else (-1 if number == 0 else 0)
    return found


def _follows(*words: str, names: tuple[str, ...], weights: Float[Array, "vertices model"]) -> Bool[Array, "vertices"]:
    return weights[:, [name.endswith(words) for name in names]].sum(axis=1) > 0.5


def _placed_by_skin(
    places: Float[Array, "others 3"], vertices: Float[Array, "vertices 3"]
) -> tuple[Int[Array, "others near"], Float[Array, "others near"]]:
    """Each place as the combination of the vertices around it with the smallest weights that gives it and sums to one.

    MMMC21 learn a regressor for each joint; the least-norm one is closed form, exact on the template, and as steady.
    """
    from scipy.spatial import cKDTree

    _, near = cKDTree(vertices).query(places, k=min(NEAR, len(vertices)))
    near = near.reshape(len(places), -1)
    shares = np.zeros(near.shape)
    for number, (place, around) in enumerate(zip(places, near)):
        rows = np.concatenate([(vertices[around] - place).T, np.ones((1, len(around)))])
        shares[number] = np.linalg.pinv(rows, rcond=1e-6)[:, 3]
    return near, shares


def _tip(
    name: str,
    names: tuple[str, ...],
    vertices: Array,
    places: Float[Array, "model 3"],
    weights: Float[Array, "vertices model"],
) -> int:
    """The vertex of an end part farthest from its joint; of a foot and its toes, of those together."""
    own = weights[:, names.index(name)].copy()
    toes = name.replace("Foot", "Toes")
    if toes in names:
        own += weights[:, names.index(toes)]
    part = np.flatnonzero(own > 0.5)
    if not len(part):
        raise RetargetError(f"no part of the template's surface follows its {name}")
    joint = places[names.index(name)]
    away = vertices[part, 1] - joint[1] if name == "head" else np.linalg.norm(vertices[part] - joint, axis=1)
    return int(part[away.argmax()])
