"""How good a rig is that was made for a mesh whose true one is known: what the bench of rig transfer reports of a case."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh, Motion, Skin
from retarget.evaluate import metrics
from retarget.evaluate.rig_cases import RigCase
from retarget.geometry.closest import Places, SurfaceIndex
from retarget.motion.library import embedded_motion
from retarget.rig.fit import HEIGHT
from retarget.rig.rigging import Rigged
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

Array = np.ndarray

MOST_ERROR, MOST_FLIPPED = 3.0, 5.0
"""A map succeeds that errs by less than this per cent of the height on average and has less than this per cent flipped."""
APART = 0.1
"""Metres between a place on the template and its mirror image from which a vertex can be flipped."""
MOTIONS = ("walk", "hands_on_hips", "jump")
"""Embedded motions that true and made rig are compared under."""
FRAMES, VERTICES = 10, 2_000
"""Frames of each, and vertices of the body, that are compared; evenly spread."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of a case, in metres of the body, at its mesh's own vertices."""

    rest: Float[Array, "vertices 3"]
    weights: Float[Array, "vertices joints"]
    character: Character
    """The mesh with its true rig, at rest."""
    posed: Float[Array, "skin 3"]
    """The embedded topology's vertices on the mesh, in its pose, space and unit."""


def truth_of(case: RigCase) -> Truth:
    """What rigging the case's mesh should give.

    Vertices lie off the body by noise, remeshing and clothes: what they lie off by is turned back to rest with the skin
    beneath. The template's true places are on the skin, and where a shirt was swollen, on the shirt.
    """
    skin, skeleton = case.character.skin, case.character.skeleton
    own = np.zeros((len(skin.columns), len(skeleton)))
    np.add.at(own, (np.arange(len(own))[:, None], skin.joints[skin.columns]), skin.weights)
    weights = case.places.of(own)
    away = (case.mesh.vertices - case.places.of(case.posed)) / case.scale
    blended = np.tensordot(weights, rot.to_matrix(case.rotations), axes=1)
    u, _, vt = np.linalg.svd(blended)  # the turn nearest to the blend: offsets keep their length
    rest = case.places.of(case.character.mesh.vertices) + np.einsum("vba,vb->va", u @ vt, away)
    columns = np.argsort(-weights, axis=1, kind="stable")[:, :8]
    kept = np.take_along_axis(weights, columns, axis=1)
    _, places = rest_pose(skeleton)
    binds = np.tile(np.eye(4), (len(skeleton), 1, 1))
    binds[:, :3, 3] = -places
    true = Character(
        skeleton,
        replace(case.mesh, vertices=rest),
        Skin(np.arange(len(skeleton)), binds, columns, kept / kept.sum(axis=1, keepdims=True)),
    )
    return Truth(rest, weights, true, case.posed + _swelling(case))


def _swelling(case: RigCase) -> Float[Array, "skin 3"]:
    """How far the shirt lifts the template's places off the skin; nought where there is none."""
    from scipy.spatial import cKDTree

    if case.sort != "multi":
        return np.zeros_like(case.posed)
    away = (case.mesh.vertices - case.places.of(case.posed))[case.body]
    rest = case.character.mesh.vertices
    distance, near = cKDTree(case.places.of(rest)[case.body]).query(rest, k=4)
    share = 1.0 / np.maximum(distance, 1e-6)
    return np.einsum("vk,vkx->vx", share / share.sum(axis=1, keepdims=True), away[near])


@lru_cache(maxsize=1)
def main_columns() -> Int[Array, "joints"]:
    """For each joint of the embedded skeleton the main one (in the order of `MAIN`) that it is, or hangs on."""
    model = human_model()
    owner = np.zeros(len(model.joint_names), dtype=np.int64)
    for joint, name in enumerate(model.joint_names):
        owner[joint] = MAIN.index(name) if name in MAIN else owner[model.parents[joint]]
    return owner


def main_weights(weights: Float[Array, "vertices joints"]) -> Float[Array, "vertices main"]:
    """Weights of the embedded skeleton with fingers counted to their hands."""
    merged = np.zeros((len(weights), len(MAIN)))
    for joint, owner in enumerate(main_columns()):
        merged[:, owner] += weights[:, joint]
    return merged


def dense_weights(character: Character) -> Float[Array, "vertices joints"]:
    """Skinning weights, a column a joint of the skeleton."""
    skin = character.skin
    dense = np.zeros((len(skin.columns), len(character.skeleton)))
    np.add.at(dense, (np.arange(len(dense))[:, None], skin.joints[skin.columns]), skin.weights)
    return dense


def judge_map(case: RigCase, places: Float[Array, "vertices 3"]) -> dict[str, float | bool]:
    """Where the body's own vertices were mapped to on the template (metres at rest), against where they belong."""
    rest, body = human_template().model.points, case.body
    true, mirrored = (case.places.of(each)[body] for each in (rest, rest[human_model().mirror]))
    return map_figures(places[body], true, mirrored)


def map_figures(
    result: Float[Array, "vertices 3"], truth: Float[Array, "vertices 3"], mirrored: Float[Array, "vertices 3"]
) -> dict[str, float | bool]:
    """Error, flips, and whether both are small enough."""
    error = float(metrics.map_error_percent(result, truth, HEIGHT).mean())
    flipped = metrics.flipped_percent(result, truth, mirrored, APART)
    right = error < MOST_ERROR and flipped < MOST_FLIPPED
    return {"map_error_percent": error, "flipped_percent": flipped, "success": bool(right)}


def judge_weights(
    case: RigCase, truth: Truth, weights: Float[Array, "vertices joints"], prefix: str = ""
) -> dict[str, float]:
    """Weight errors on the body's own vertices, mean over main joints (fingers with their hands) and over all."""
    result, true = weights[case.body], truth.weights[case.body]
    return {
        prefix + "weight_mse_x100": float(metrics.weight_mse_x100(main_weights(result), main_weights(true)).mean()),
        prefix + "weight_mse_x100_52": float(metrics.weight_mse_x100(result, true).mean()),
    }


def judge_rest(case: RigCase, truth: Truth, rest: Float[Array, "vertices 3"]) -> float:
    """Mean error of the body's own vertices at rest, cm at 1.7 m; metres of the true body."""
    return float(metrics.rest_vertex_error_cm(rest[case.body], truth.rest[case.body], case.height / case.scale).mean())


def judge_rig(case: RigCase, truth: Truth, rigged: Rigged) -> dict[str, Any]:
    """Everything about a delivered rig."""
    order = [case.character.skeleton.index(name) for name in human_template().names]
    joints = metrics.joint_error_cm(rigged.joints, case.joints[order], case.height)
    rest = human_template().model.points
    to_metres = 1.0 / (rigged.unit * case.scale)  # the mesh's unit was guessed; what it was is judged apart
    surface = SurfaceIndex(case.mesh.vertices, case.mesh.faces)
    near = surface.closest(rigged.posed, candidates=16).of(case.mesh.vertices)
    return {
        "confidence": rigged.confidence,
        **judge_map(case, rigged.places.of(rest)),
        **judge_weights(case, truth, dense_weights(rigged.character)),
        "joint_error_cm": float(joints[: len(MAIN)].mean()),
        "finger_error_cm": float(joints[len(MAIN) :].mean()),
        "joint_errors_cm": dict(zip(MAIN, joints.tolist())),
        "registration_mm": float(metrics.registration_mm(rigged.posed, truth.posed, case.height).mean()),
        "registration_surface_mm": float(metrics.registration_mm(rigged.posed, near, case.height).mean()),
        "rest_vertex_error_cm": judge_rest(case, truth, rigged.character.mesh.vertices * to_metres),
        "torn_percent": torn(case.mesh, rigged, case.height),
        "animated_mpvd_cm": animated_mpvd_cm(case, truth, rigged.character, to_metres),
        "unit_factor": to_metres,
    }


def torn(mesh: Mesh, rigged: Rigged, height: float) -> float:
    """`torn_percent` of a rigged mesh, whose height is given in its own unit."""
    edges = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return metrics.torn_percent(rigged.character.mesh.vertices / rigged.unit, mesh.vertices, edges, height)


def animated_mpvd_cm(case: RigCase, truth: Truth, character: Character, to_metres: float) -> float:
    """MPVD (cm at 1.7 m) of `MOTIONS`, hips held, the same local rotations on made and true rig; the made one scaled to the
    true body's metres and moved so that both bodies' middles at rest coincide, not turned: up and front are promised."""
    body = np.flatnonzero(case.body)
    chosen = body[np.linspace(0, len(body) - 1, min(VERTICES, len(body))).astype(np.int64)]
    errors = []
    for name in MOTIONS:
        made, true = (_performed(each, name, chosen) for each in (character, truth.character))
        move = truth.rest[chosen].mean(axis=0) - character.mesh.vertices[chosen].mean(axis=0) * to_metres
        errors.append(metrics.mpvd(made * to_metres + move, true))
    return 100 * float(np.mean(errors)) * metrics.REFERENCE_HEIGHT * case.scale / case.height


def _performed(character: Character, name: str, chosen: Int[Array, "chosen"]) -> Float[Array, "frames chosen 3"]:
    skin, motion = character.skin, embedded_motion(name)
    frames = np.unique(np.linspace(0, len(motion) - 1, FRAMES).astype(np.int64))
    few = Character(
        character.skeleton,
        Mesh(character.mesh.vertices[chosen], np.zeros((0, 3), dtype=np.int64)),
        Skin(skin.joints, skin.inverse_binds, skin.columns[chosen], skin.weights[chosen]),
    )
    return prepare_skinning(few).vertices(*world_pose(in_place(few, motion, frames))).astype(np.float64)


def in_place(character: Character, motion: Motion, frames: Int[Array, "frames"]) -> Motion:
    """Some frames of an embedded motion on a character with the embedded skeleton, hips where they are at rest."""
    hips = np.tile(character.skeleton.offsets[0], (len(frames), 1, 1))
    return Motion(character.skeleton, motion.rotations[frames], hips, motion.fps)


def places_for_all(case: RigCase, places: Places) -> Places:
    """Places of the body's own vertices carried to those of its clothes, the nearest one's each."""
    from scipy.spatial import cKDTree

    near = cKDTree(case.mesh.vertices[case.body]).query(case.mesh.vertices)[1]
    near[case.body] = np.arange(int(case.body.sum()))
    return Places(places.corners[near], places.weights[near])
