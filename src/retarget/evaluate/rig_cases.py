"""Bare meshes whose rig is known: embedded bodies in poses, with other triangles, noise, holes and clothes.

The seeds of the two halves were written down before anything was built on them: `SEEN` may be looked at and tuned on,
`UNSEEN` are only reported. A case is made from its seed alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.body.human import PARAMETERS, PRESETS, human, human_model
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh
from retarget.evaluate.remeshed import clustered, collapsed
from retarget.geometry.closest import Places
from retarget.geometry.clothes import layer, smoothed
from retarget.geometry.resample import Surface, subdivide
from retarget.geometry.topology import vertex_normals
from retarget.motion.library import embedded_motion

Array = np.ndarray

SEEN = tuple(range(36))
UNSEEN = tuple(range(1000, 1036))
SORTS = ("clean", "noisy", "multi")
"""A third each, by seed modulo three: as remeshed; with noise or holes; with clothes in pieces of their own."""
QUICK = (0, 1, 2, 1003)
FEWEST, MOST = 2_000, 50_000
"""Vertices of the remeshed body."""
BODIES = tuple(PRESETS)
STANCES = ("rest", "T", "sitting", "legs together", "reaching", "kneeling")
CAPTURED = (
    "arms_crossed", "hands_on_hips", "walk", "run", "legs_crossed", "hand_on_belly", "clap", "squat_hands_on_knees", "wave",
    "hands_behind_head", "jump", "hand_to_shoulder",
)  # fmt: skip
"""Embedded motions that a random frame is taken from."""


@dataclass(frozen=True, eq=False)
class RigCase:
    """A bare mesh, and what is known of it."""

    name: str
    seed: int
    sort: str
    mesh: Mesh
    """What is handed over: rotated, in its own unit."""
    body: Bool[Array, "vertices"]
    """The vertices that are the body itself; the others belong to clothes."""
    places: Places
    """Where each vertex lies on the embedded topology; for clothes, what lies beneath."""
    character: Character
    """The body with its true rig, at rest."""
    posed: Float[Array, "skin 3"]
    """The embedded topology's vertices in the pose, in the mesh's space."""
    joints: Float[Array, "joints 3"]
    """True joints in the pose, in the mesh's space."""
    rotations: Float[Array, "joints 4"]
    """True world rotations of the joints in the mesh's space."""
    scale: float
    """Units of the mesh in a metre."""

    @property
    def height(self) -> float:
        """Of the body at rest, in units of the mesh."""
        return float(np.ptp(self.character.mesh.vertices[:, 1])) * self.scale


def rig_case(seed: int) -> RigCase:
    """The case of a seed."""
    draw = np.random.default_rng([seed, 2021])
    sort = SORTS[seed % 3]
    character = _body(draw, seed)
    stance, rotations = _pose(draw, seed)
    skeleton = character.skeleton
    world, joints = forward(skeleton.parents, rotations[None], skeleton.offsets[None])
    posed = prepare_skinning(character).vertices(world, joints)[0].astype(np.float64)
    count = int(np.exp(draw.uniform(np.log(FEWEST), np.log(MOST))))
    shape = Surface(posed, character.mesh.faces)
    remesh = clustered if (seed // 3) % 2 else collapsed
    surface, places = remesh(shape, count, draw)
    body = np.ones(len(surface), dtype=bool)
    detail = remesh.__name__
    if sort == "noisy":
        surface, kept, detail = _damaged(surface, draw)
        places, body = Places(places.corners[kept], places.weights[kept]), body[kept]
    elif sort == "multi":
        surface, places, body, detail = _dressed(surface, places, shape, draw)
    turn = rot.from_rotation_vector(_axis(draw) * draw.uniform(0, np.pi)) if draw.random() < 0.5 else rot.IDENTITY
    scale = float(draw.choice([1.0, 100.0, 1000.0, 0.1, 39.37]))
    shift = draw.normal(size=3) * scale * 0.5
    vertices, posed, joints = (rot.rotate(turn, each) * scale + shift for each in (surface.vertices, posed, joints[0]))
    name = f"{seed} {character.name} {stance} {len(surface)} {sort} {detail}"
    return RigCase(
        name, seed, sort, Mesh(vertices, surface.faces), body, places, character, posed, joints,
        rot.multiply(turn, world[0]), scale,
    )  # fmt: skip


def _body(draw: np.random.Generator, seed: int) -> Character:
    preset = BODIES[seed % len(BODIES)] if seed < 1000 else BODIES[int(draw.integers(len(BODIES)))]
    shape = dict(PRESETS[preset])
    details = draw.choice(human_model().detail_names, size=8, replace=False)
    for name in details.tolist():
        shape[name] = float(np.clip(shape.get(name, 0.0) + draw.uniform(-0.6, 0.6), -1, 1))
    for name in ("gender", "muscle", "weight"):
        lowest, neutral, highest = PARAMETERS[name]
        shape[name] = float(np.clip(shape.get(name, neutral) + draw.uniform(-0.2, 0.2), lowest, highest))
    height = shape.pop("height", None)
    return human(height=height, name=preset, **shape)


def _pose(draw: np.random.Generator, seed: int) -> tuple[str, Float[Array, "joints 4"]]:
    """Local rotations of a pose, a little off its model."""
    names = human_model().joint_names
    rotations = np.tile(rot.IDENTITY, (len(names), 1))
    stances = STANCES + CAPTURED
    stance = stances[seed % len(stances)] if seed < 1000 else stances[int(draw.integers(len(stances)))]
    if stance in CAPTURED:
        motion = embedded_motion(stance)
        rotations = motion.rotations[int(draw.integers(len(motion)))].copy()
    else:
        for joint, degrees in _angles(stance, draw).items():
            rotations[names.index(joint)] = rot.from_rotation_vector(np.radians(degrees))
    wobble = np.radians(draw.normal(size=(len(names), 3)) * 4.0)
    wobble[22:] = 0.0
    return stance, rot.multiply(rotations, rot.from_rotation_vector(wobble))


def _angles(stance: str, draw: np.random.Generator) -> dict[str, tuple]:
    """Rotation vectors in degrees by joint; x bends forward, z lifts the left arm."""
    if stance == "T":
        return {"leftUpperArm": (0, 0, 40), "rightUpperArm": (0, 0, -40)}
    if stance == "sitting":
        bend = float(draw.uniform(75, 95))
        legs = {f"{side}UpperLeg": (-bend, 0, 0) for side in ("left", "right")}
        return legs | {f"{side}LowerLeg": (bend, 0, 0) for side in ("left", "right")} | {"leftLowerArm": (0, -50, 0)}
    if stance == "legs together":
        return {"leftUpperLeg": (0, 0, -4), "rightUpperLeg": (0, 0, 4), "leftUpperArm": (0, 0, -20),
                "rightUpperArm": (0, 0, 20)}  # fmt: skip
    if stance == "reaching":
        return {
            "leftUpperArm": (0, 0, 110),
            "rightUpperArm": (0, 60, -30),
            "spine": (15, 10, 0),
            "leftUpperLeg": (-30, 0, 0),
        }
    if stance == "kneeling":
        return {"leftUpperLeg": (-80, 0, 0), "leftLowerLeg": (95, 0, 0), "rightUpperLeg": (10, 0, 0),
                "rightLowerLeg": (80, 0, 0)}  # fmt: skip
    return {}


def _axis(draw: np.random.Generator) -> Float[Array, "3"]:
    axis = draw.normal(size=3)
    return axis / np.linalg.norm(axis)


def _damaged(surface: Surface, draw: np.random.Generator) -> tuple[Surface, Array, str]:
    """Noise along the normals of .08 to .3 % of the height, or three to six holes; kept vertices by their old number."""
    size = float(np.ptp(surface.vertices, axis=0).max())
    if draw.random() < 0.5:
        noise = draw.normal(size=(len(surface), 1)) * draw.uniform(0.0008, 0.003) * size
        moved = surface.vertices + noise * vertex_normals(surface.vertices, surface.faces)
        return Surface(moved, surface.faces), np.arange(len(surface)), "noise"
    middles = surface.vertices[surface.faces].mean(axis=1)
    gone = np.zeros(len(surface.faces), dtype=bool)
    for center in middles[draw.integers(len(middles), size=int(draw.integers(3, 7)))]:
        gone |= np.linalg.norm(middles - center, axis=1) < draw.uniform(0.012, 0.03) * size
    used, packed = np.unique(surface.faces[~gone], return_inverse=True)
    return Surface(surface.vertices[used], packed.reshape(-1, 3)), used, "holes"


def _dressed(
    surface: Surface, places: Places, body: Surface, draw: np.random.Generator
) -> tuple[Surface, Places, Bool[Array, "vertices"], str]:
    """Clothes: a swollen trunk as a shirt would make it, and shoes, a skirt and a hat as pieces of their own."""
    model = human_model()
    size = float(np.ptp(body.vertices, axis=0).max())
    parts = {name: number for number, name in enumerate(model.part_names)}
    trunk = np.isin(model.vertex_parts, [parts[name] for name in ("chest", "abdomen", "pelvis")]).astype(float)
    swelling = (
        places.of(smoothed(trunk, body))[:, None] * vertex_normals(surface.vertices, surface.faces) * 0.006 * size
    )
    pieces = [(Surface(surface.vertices + swelling, surface.faces), places)]
    outfits = [draw.random() < chance for chance in (0.8, 0.5, 0.5)]
    fine, placing = subdivide(body)
    names = []
    if outfits[0]:
        names.append("shoes")
        for side in ("left", "right"):
            pieces.append(layer(fine, placing, body, [parts[f"{side}Foot"]], 0.008 * size))
    if outfits[1] or not any(outfits):
        names.append("skirt")
        pieces.append(
            layer(fine, placing, body, [parts[name] for name in ("pelvis", "leftThigh", "rightThigh")], 0.02 * size)
        )
    if outfits[2]:
        names.append("hat")
        pieces.append(layer(fine, placing, body, [parts["head"]], 0.015 * size, above=True))
    offsets = np.cumsum([0] + [len(piece) for piece, _ in pieces])
    whole = Surface(
        np.concatenate([piece.vertices for piece, _ in pieces]),
        np.concatenate([piece.faces + offset for (piece, _), offset in zip(pieces, offsets)]),
    )
    joined = Places(
        np.concatenate([place.corners for _, place in pieces]), np.concatenate([place.weights for _, place in pieces])
    )
    own = np.arange(len(whole)) < offsets[1]
    return whole, joined, own, "+".join(names)


def unposed(case: RigCase) -> RigCase:
    """The same with the mesh in metres, for a look at it."""
    return replace(case, mesh=replace(case.mesh, vertices=case.mesh.vertices / case.scale), scale=1.0)
