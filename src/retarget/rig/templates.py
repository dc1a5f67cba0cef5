"""The templates there are: the embedded human, and any rigged character that somebody has."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from retarget.body.human import human, human_model
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Skeleton
from retarget.contact.parts import body_parts
from retarget.correspond.joints import Humanoid
from retarget.correspond.landmarks import TIPS
from retarget.errors import RetargetError
from retarget.geometry.resample import Surface
from retarget.rig.fit import HEIGHT
from retarget.rig.human_shapes import shape_components
from retarget.rig.template import AVERAGE, STYLISED, Parts, Structure, Template, human_structure, make_template
from retarget.rig.working_surface import working_surfaces

Array = np.ndarray

ENDS = dict(zip(TIPS, ("crown", "leftMiddleTip", "rightMiddleTip", "leftBigToeTip", "rightBigToeTip")))
"""Landmarks of the embedded human at the body's ends."""


@lru_cache(maxsize=1)
def human_template() -> Template:
    """The embedded human: its bodies' principal components, and every part free to grow; from an average and from a stylised
    body."""
    character, model = human(height=HEIGHT), human_model()
    joints = {name: number for number, name in enumerate(model.joint_names)}
    components = shape_components()
    structure = human_structure(joints)
    regressor = model.shape.regressor[structure.joints]
    ends = {name: model.landmark(landmark) for name, landmark in ENDS.items()}
    return make_template(
        Parts(
            character.skeleton,
            structure,
            Surface(character.mesh.vertices, model.faces),
            dense_weights(character),
            tuple(ends.values()),
            dict(model.landmarks) | ends,
            np.arange(len(character.mesh.vertices)),
            HEIGHT,
            components,
            np.einsum("jv,kvx->kjx", regressor, components),
            {"average": AVERAGE, "stylised": STYLISED},
        )
    )


def character_template(character: Character, humanoid: Humanoid) -> Template:
    """Any rigged character with a surface, in metres with +Y up and facing +Z; what it holds and wears on joints of its own
    is left out, and a body in many pieces stands as the shell around them.

    Raises `RetargetError` for a character without a surface or without limbs.
    """
    if character.mesh is None or character.skin is None:
        raise RetargetError(f"{character.name or 'the template'} has no surface, so it cannot be a template")
    missing = [name for name in ("hips", *TIPS) if name not in humanoid.joints]
    if missing:
        raise RetargetError(f"a template needs the joints hips, {', '.join(TIPS)}; it lacks {', '.join(missing)}")
    rest = rest_vertices(character)
    faces = character.mesh.faces[body_parts(character, humanoid).body_faces]
    if not len(faces):
        raise RetargetError(f"no part of the surface of {character.name or 'the template'} is body")
    used, packed = np.unique(faces, return_inverse=True)
    height = max(float(np.ptp(rest[used, 1])), 1e-9)
    unit = HEIGHT / height
    surface, weights = one_surface(Surface(rest[used] * unit, packed.reshape(-1, 3)), dense_weights(character)[used])
    skeleton, structure = scaled_skeleton(character.skeleton, unit), human_structure(humanoid.joints)
    ends = {name: _end(name, humanoid, skeleton, surface, weights) for name in TIPS}
    landmarks = joint_landmarks(skeleton, surface, weights) | ends
    return make_template(
        Parts(skeleton, structure, surface, weights, tuple(ends.values()), landmarks,
              nearest_vertices(rest * unit, surface), HEIGHT, *no_components(surface, structure), {"template": AVERAGE})
    )  # fmt: skip


def one_surface(
    surface: Surface, weights: Float[Array, "vertices joints"]
) -> tuple[Surface, Float[Array, "shell joints"]]:
    """The surface itself if it is of one piece, else the shell around its pieces with the weights of what lies nearest."""
    from scipy.spatial import cKDTree

    working = next(working_surfaces(surface))
    if working.pieces == 1 and not working.fused:
        return surface, weights
    if not working.fused:
        near = cKDTree(surface.vertices).query(working.surface.vertices)[1]
        return working.surface, weights[near]
    distance, near = cKDTree(surface.vertices).query(working.surface.vertices, k=4)
    share = 1.0 / np.maximum(distance, 1e-6)
    share /= share.sum(axis=1, keepdims=True)
    return working.surface, np.einsum("vk,vkj->vj", share, weights[near])


def nearest_vertices(points: Float[Array, "file 3"], surface: Surface) -> Int[Array, "file"]:
    """For each vertex of a file the nearest of the surface that stands for it."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(surface.vertices).query(points)[1], dtype=np.int64)


def no_components(
    surface: Surface, structure: Structure
) -> tuple[Float[Array, "0 vertices 3"], Float[Array, "0 model 3"]]:
    """For bodies of which no others are known."""
    return np.zeros((0, len(surface), 3)), np.zeros((0, len(structure.names), 3))


def joint_landmarks(skeleton: Skeleton, surface: Surface, weights: Float[Array, "vertices joints"]) -> dict[str, int]:
    """Vertices by the names of joints: for each joint that moves some of the surface and does not branch, where the part that
    it moves ends, its vertex farthest from the joint; for a joint at the end of a bone that moves nothing (`Head_end`), the
    vertex of the bone's part that lies farthest out along it.

    A root and joints that branch have several ends, so that their names would say nothing. Ends of limbs come first.
    """
    places, heaviest, found = rest_pose(skeleton)[1], weights.argmax(axis=1), {}
    moves = np.bincount(heaviest, minlength=len(skeleton)) > 0
    reaches = moves.copy()
    for joint in range(len(skeleton) - 1, 0, -1):
        reaches[skeleton.parents[joint]] |= reaches[joint]
    limbs = [int(reaches[skeleton.children(joint)].sum()) for joint in range(len(skeleton))]
    for joint in sorted(range(1, len(skeleton)), key=lambda each: limbs[each] > 0):
        away = np.linalg.norm(surface.vertices - places[joint], axis=1)
        if moves[joint] and limbs[joint] < 2:
            found[skeleton.names[joint]] = int(np.where(heaviest == joint, away, -1.0).argmax())
        elif not skeleton.children(joint) and moves[skeleton.parents[joint]]:
            along = (surface.vertices - places[joint]) @ (places[joint] - places[skeleton.parents[joint]])
            found[skeleton.names[joint]] = int(np.where(heaviest == skeleton.parents[joint], along, -np.inf).argmax())
    return found


def dense_weights(character: Character) -> Float[Array, "vertices joints"]:
    """Skinning weights of every joint."""
    skin = character.skin
    weights = np.zeros((len(skin.columns), len(character.skeleton)))
    np.add.at(weights, (np.arange(len(weights))[:, None], skin.joints[skin.columns]), skin.weights)
    return weights


def scaled_skeleton(skeleton: Skeleton, unit: float) -> Skeleton:
    """The skeleton so many times as large."""
    return replace(skeleton, offsets=skeleton.offsets * unit, end_offsets=None)


def _end(
    name: str, humanoid: Humanoid, skeleton: Skeleton, surface: Surface, weights: Float[Array, "vertices joints"]
) -> int:
    """The vertex of an end part farthest from its joint (of a head, the highest above it), toes and fingers with it."""
    joint = humanoid.joints[name]
    hanging = [each for each in range(len(skeleton)) if _hangs(skeleton, each, joint)]
    part = np.flatnonzero(weights[:, hanging].sum(axis=1) > 0.5)
    if not len(part):
        part = np.flatnonzero(weights[:, hanging].sum(axis=1) > 0.1)
    if not len(part):
        raise RetargetError(f"no part of the template's surface follows its {name}")
    away = surface.vertices[part] - rest_pose(skeleton)[1][joint]
    return int(part[(away[:, 1] if name == "head" else np.linalg.norm(away, axis=1)).argmax()])


def _hangs(skeleton: Skeleton, joint: int, above: int) -> bool:
    while joint >= 0:
        if joint == above:
            return True
        joint = int(skeleton.parents[joint])
    return False
