"""What a sheet shows of a rig: the mesh as it came, at rest, and in a step of a walk, coloured by the joint that moves it."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Material, Mesh
from retarget.evaluate.rig_judge import dense_weights, in_place, main_weights
from retarget.motion.library import embedded_motion
from retarget.rig.rigging import Rigged
from retarget.rig.template import MAIN

Array = np.ndarray

MOTION, FRAME = "walk", 12


@dataclass(frozen=True, eq=False)
class RigPicture:
    """A row of a sheet."""

    label: str
    mesh: Mesh
    """With a material for each joint."""
    vertices: Float[Array, "frames vertices 3"]
    captions: tuple[str, ...]


def picture_of(label: str, mesh: Mesh, rigged: Rigged | None, verdict: str) -> RigPicture:
    """The row of a rigged mesh, or of one that was refused."""
    plain = replace(mesh, uvs=None, materials=(), face_materials=None)
    if rigged is None:
        size = float(np.ptp(mesh.vertices, axis=0).max())
        return RigPicture(label, plain, (mesh.vertices - _foot(mesh.vertices))[None] * (1.7 / size), (verdict,))
    character = rigged.character
    owner = main_weights(dense_weights(character)).argmax(axis=1)
    faces = np.sort(owner[mesh.faces], axis=1)[:, 1]  # the middle one: that of two corners where two agree
    coloured = replace(plain, materials=_colours(), face_materials=faces)
    came = (mesh.vertices - _foot(mesh.vertices)) * rigged.unit
    walking = prepare_skinning(character).vertices(
        *world_pose(in_place(character, embedded_motion(MOTION), np.array([FRAME])))
    )[0]
    frames = np.stack([came, character.mesh.vertices, walking.astype(np.float64)])
    return RigPicture(label, coloured, frames, ("as it came", "at rest", verdict))


def _foot(vertices: Float[Array, "vertices 3"]) -> Float[Array, "3"]:
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    middle[1] = vertices[:, 1].min()
    return middle


def _colours() -> tuple[Material, ...]:
    """Neighbours in the skeleton's order far apart on the colour wheel; left ones pale, right ones deep."""
    found = []
    for name in MAIN:
        lightness = 0.7 if name.startswith("left") else 0.35 if name.startswith("right") else 0.5
        hue = (MAIN.index(name.replace("right", "left")) * 0.381966) % 1.0
        found.append(Material(name, (*colorsys.hls_to_rgb(hue, lightness, 0.75), 1.0)))
    return tuple(found)
