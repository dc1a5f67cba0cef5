"""The same body slimmer: which contacts are there only because it is heavy?

Basset 2019, section 8, asks to tell contacts of the pose from contacts of the body's girth. We replay the pose on the same
skeleton with less flesh: every limb and the trunk shrink towards their bones, down to the girth of a thin human.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Mesh
from retarget.contact.parts import PARTS, BodyParts, weight_by_part
from retarget.correspond.joints import Humanoid

Array = np.ndarray

STEPS = (1 / 3, 2 / 3, 1.0)
"""How far along the way to a thin body each slimmer one is."""

_AXES: dict[str, tuple[str, str]] = {
    **{part: ("hips", "neck") for part in ("chest", "abdomen", "pelvis")},
    **{f"{side}{part}": (f"{side}{start}", f"{side}{end}") for side in ("left", "right") for part, start, end in (
        ("UpperArm", "UpperArm", "LowerArm"), ("Forearm", "LowerArm", "Hand"),
        ("Thigh", "UpperLeg", "LowerLeg"), ("Shin", "LowerLeg", "Foot"))},
}  # fmt: skip
"""Bones that the parts shrink towards. Head, neck, hands and feet keep their size."""

THIN_GIRTH = {
    "chest": 0.225, "abdomen": 0.20, "pelvis": 0.187, "UpperArm": 0.156, "Forearm": 0.111, "Thigh": 0.148, "Shin": 0.095,
}  # fmt: skip
"""Median distance from the bone over the bone's length, measured on the embedded human of preset 'thin'."""
SLIMMER = 0.95
"""Ratio of girths from which on downwards a target is slimmer for good, and contacts of girth are let go."""


def girths(character: Character, humanoid: Humanoid, parts: BodyParts) -> dict[str, float]:
    """Median distance of each part's skin from its bone, over the bone's length."""
    rest = rest_vertices(character)
    found = {}
    for part, start, end in _bones(character, humanoid):
        own = np.flatnonzero((parts.vertex_parts == PARTS.index(part)) & parts.body_vertices)
        if len(own):
            foot = _foot(rest[own], start, end)
            found[part] = float(np.median(np.linalg.norm(rest[own] - foot, axis=1)) / np.linalg.norm(end - start))
    return found


def girth_kept(source: dict[str, float], target: dict[str, float]) -> Float[Array, "parts parts"]:
    """What contacts of the source's girth weigh on the target, for two parts that touch: nothing where it is slimmer there
    (Basset 2019, section 8), all where it is not. From `girths` of both; parts without one (hands, feet, the head) leave it
    to the other, and two of them keep nothing."""
    ratio = np.full(len(PARTS), np.nan)
    for part in source.keys() & target.keys():
        ratio[PARTS.index(part)] = target[part] / max(source[part], 1e-9)
    known = ~np.isnan(ratio)
    ratio, count = np.where(known, ratio, 0.0), known.astype(np.float64)
    mean = (ratio[:, None] + ratio) / np.maximum(count[:, None] + count, 1.0)
    return np.where(count[:, None] + count > 0, np.clip((mean - SLIMMER) / (1.0 - SLIMMER), 0.0, 1.0), 0.0)


def arm_radius(character: Character, humanoid: Humanoid, parts: BodyParts) -> float:
    """Mean distance of the skin of upper arms and forearms from their bones, metres (Ye 2024 measures by it and leaves
    open how it is found)."""
    _, rest = rest_pose(character.skeleton)
    girth, radii = girths(character, humanoid, parts), []
    for part, (start, end) in _AXES.items():
        if part in girth and part.endswith(("UpperArm", "Forearm")):
            bone = rest[humanoid.joints[end]] - rest[humanoid.joints[start]]
            radii.append(girth[part] * np.linalg.norm(bone))
    return float(np.mean(radii)) if radii else 0.0


def slim_bodies(character: Character, humanoid: Humanoid, parts: BodyParts) -> tuple[Character, ...]:
    """The body on its way to a thin one, on the same skeleton and topology; none where it is thin already."""
    rest = rest_vertices(character)
    own = girths(character, humanoid, parts)
    share = weight_by_part(character, humanoid)
    inwards = np.zeros_like(rest)
    for part, start, end in _bones(character, humanoid):
        thin = THIN_GIRTH[part.removeprefix("left").removeprefix("right")]
        if own.get(part, 0.0) > thin:
            toward = _foot(rest, start, end) - rest
            inwards += share[:, PARTS.index(part), None] * (1.0 - thin / own[part]) * toward
    if not inwards.any():
        return ()
    binds = _rest_to_bound(character)
    return tuple(
        replace(character, mesh=_moved(character.mesh, np.einsum("vij,vj->vi", binds, step * inwards)))
        for step in STEPS
    )


def _bones(character: Character, humanoid: Humanoid) -> Iterator[tuple[str, Array, Array]]:
    """(part, start, end) of every bone that skin shrinks towards, at rest."""
    _, positions = rest_pose(character.skeleton)
    for part, (first, last) in _AXES.items():
        last = last if last in humanoid.joints else "head"
        start, end = positions[humanoid.joints[first]], positions[humanoid.joints[last]]
        if np.linalg.norm(end - start) > 0:
            yield part, start, end


def _foot(
    points: Float[Array, "points 3"], start: Float[Array, "3"], end: Float[Array, "3"]
) -> Float[Array, "points 3"]:
    """Nearest points of a segment."""
    along = end - start
    return start + np.clip((points - start) @ along / (along @ along), 0.0, 1.0)[:, None] * along


def _rest_to_bound(character: Character) -> Float[Array, "vertices 3 3"]:
    """What turns a displacement at rest into one of the bound mesh, for each vertex."""
    skin = character.skin
    rotations, positions = rest_pose(character.skeleton)
    from retarget.body.kinematics import joint_transforms

    T_world_mesh = joint_transforms(rotations[None], positions[None])[0, skin.joints] @ skin.inverse_binds
    blended = np.einsum("vk,vkij->vij", skin.weights, T_world_mesh[skin.columns][..., :3, :3])
    return np.linalg.inv(blended)


def _moved(mesh: Mesh, by: Float[Array, "vertices 3"]) -> Mesh:
    return replace(mesh, vertices=mesh.vertices + by)
