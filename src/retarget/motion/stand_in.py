"""A body that stands in for a source without a surface: the embedded human, fitted to its skeleton.

Motion capture comes as bare joints, but what touches what is a matter of surfaces. So a human of plain build is made as tall
as the source, its joints are moved to where the source's bones want them, and its skin is stretched along. Which hand
touched which hip then shows, up to the girth of the performer, which no skeleton tells. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body.human import HEIGHT, human
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Motion, Pose
from retarget.correspond.joints import humanoid_from_names
from retarget.errors import RetargetError
from retarget.io.asset import Convention
from retarget.motion.align import Actor, make_actor
from retarget.motion.copy_clip import Copier, CopySettings, prepare_copier

Array = np.ndarray

BUILD = {"gender": 0.5, "weight": 0.4}
"""Of the human: between man and woman, a little lighter than average, as performers are. Too light a body misses contacts,
too heavy a one invents them; the middle does least harm."""
STRETCH = (0.6, 1.7)
"""Bones are stretched within these bounds; beyond, the source is no human and its stand-in gives way."""
BONES: dict[str, tuple[str, str]] = {
    **{f"{side}{joint}": (f"{side}{joint}", f"{side}{child}") for side in ("left", "right") for joint, child in (
        ("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))},
    "neck": ("neck", "head"),
}  # fmt: skip
"""Bones whose length the source gives, by the joint that carries them."""


@dataclass(frozen=True, eq=False)
class StandIn:
    """The embedded human fitted to a source's skeleton; `fit_stand_in` makes one."""

    actor: Actor
    """With a skin, in metres with +Y up."""
    notes: tuple[str, ...]
    """What was chosen."""
    bone_error: float
    """Mean relative difference of the limbs' lengths that is left; 0 where all agree."""
    copier: Copier

    def motion(self, motion: Motion) -> Motion:
        """A motion of the source on the stand-in: the same frames and rate. Raises `RetargetError` as `Copier.clip`."""
        return self.copier.clip(motion).motion

    def pose(self, pose: Pose) -> Pose:
        """The same for one pose, online."""
        return self.copier.step(pose)


def fit_stand_in(source: Actor) -> StandIn:
    """Fit the embedded human to a source. Raises `RetargetError` for a skeleton without height."""
    if not 0.0 < source.height < np.inf:
        raise RetargetError("no body can stand in for a skeleton without height")
    base = human(**BUILD, height=float(np.clip(source.height, *HEIGHT)), name="stand-in")
    body, wanted, reached = _fitted(base, source)
    names = {name: name for name in body.skeleton.names}
    humanoid = humanoid_from_names(body.skeleton, names)
    actor = make_actor(body, humanoid, Convention(1.0, "+y"), up="+y", unit=1.0, rest_surface=rest_vertices(body))
    error = float(np.mean([abs(reached[name] / wanted[name] - 1.0) for name in wanted])) if wanted else 0.0
    note = (
        f"the source has no surface: an embedded human of {actor.height:.2f} m and plain build stands in for it; limbs agree "
        f"to {100 * error:.1f} %"
    )
    copier = prepare_copier(CopySettings(foot_lock=False, steady=False, limits=False), source, actor)
    return StandIn(actor, (note,), error, copier)


def _fitted(base: Character, source: Actor) -> tuple[Character, dict[str, float], dict[str, float]]:
    """The human with the source's bones; lengths wanted and reached, by `BONES`."""
    skeleton = base.skeleton
    _, joints = rest_pose(skeleton)
    _, placed = rest_pose(source.skeleton)
    here = {name: joints[number] for number, name in enumerate(skeleton.names)}
    there = {name: placed[joint] for name, joint in source.humanoid.joints.items()}

    def ratio(first: str, second: str) -> float:
        """Length between two joints, source over human; 1 where the source has none."""
        own = float(np.linalg.norm(here[second] - here[first]))
        if first not in there or second not in there or own <= 0:
            return 1.0
        return float(np.clip(np.linalg.norm(there[second] - there[first]) / own, *STRETCH))

    stretch = np.ones(len(skeleton))
    axis = np.zeros((len(skeleton), 3))
    for joint in range(len(skeleton)):
        children = skeleton.children(joint)
        if children:
            axis[joint] = joints[children[0]] - joints[joint]
    for name, (first, second) in BONES.items():
        number = skeleton.index(name)
        stretch[number], axis[number] = ratio(first, second), here[second] - here[first]
    # The trunk from the hip sockets to the shoulders, and the widths of both.
    trunk = _trunk_length(there) / _trunk_length(here)
    trunk = float(np.clip(trunk, *STRETCH))
    shoulders, hips = ratio("leftUpperArm", "rightUpperArm"), ratio("leftUpperLeg", "rightUpperLeg")
    scale = {name: np.array([1.0, trunk, 1.0]) for name in ("spine", "chest", "upperChest", "neck")}
    scale |= {f"{side}Shoulder": np.array([shoulders, trunk, 1.0]) for side in ("left", "right")}
    scale |= {f"{side}UpperArm": np.array([shoulders, trunk, 1.0]) for side in ("left", "right")}
    scale |= {f"{side}UpperLeg": np.array([hips, 1.0, 1.0]) for side in ("left", "right")}
    offsets = skeleton.offsets.copy()
    for joint in range(1, len(skeleton)):
        name, above = skeleton.names[joint], int(skeleton.parents[joint])
        if name in scale:
            offsets[joint] *= scale[name]
        elif stretch[above] != 1.0:
            offsets[joint] = _along(axis[above], stretch[above]) @ offsets[joint]
    moved = replace(skeleton, offsets=offsets, end_offsets=skeleton.end_offsets)
    _, goals = rest_pose(moved)
    maps = np.empty((len(skeleton), 3, 3))
    for joint, name in enumerate(skeleton.names):
        maps[joint] = _along(axis[joint], stretch[joint]) if stretch[joint] != 1.0 else np.eye(3)
    for name in ("spine", "chest", "upperChest"):
        maps[skeleton.index(name)] = np.diag([1.0 + 0.5 * (shoulders - 1.0), trunk, 1.0])
    maps[skeleton.index("hips")] = np.diag([hips, 1.0, 1.0])
    skin, mesh = base.skin, base.mesh
    by_column = np.einsum(
        "vkij,vkj->vki", maps[skin.joints[skin.columns]], mesh.vertices[:, None] - joints[skin.joints[skin.columns]]
    )
    vertices = (skin.weights[..., None] * (by_column + goals[skin.joints[skin.columns]])).sum(axis=1)
    sole = vertices[:, 1].min()
    binds = np.tile(np.eye(4), (len(skin.joints), 1, 1))
    binds[:, :3, 3] = -goals[skin.joints]
    offsets[0, 1] -= sole
    binds[:, 1, 3] += sole
    vertices[:, 1] -= sole
    body = replace(
        base, skeleton=replace(moved, offsets=offsets), mesh=replace(mesh, vertices=vertices),
        skin=replace(skin, inverse_binds=binds),
    )  # fmt: skip
    _, at = rest_pose(body.skeleton)
    wanted, reached = {}, {}
    for name, (first, second) in BONES.items():
        if first in there and second in there:
            length = float(np.linalg.norm(there[second] - there[first]))
            if length > 0:
                wanted[name] = length
                reached[name] = float(np.linalg.norm(at[skeleton.index(second)] - at[skeleton.index(first)]))
    return body, wanted, reached


def _along(axis: Float[Array, "3"], by: float) -> Float[Array, "3 3"]:
    """What stretches space along an axis."""
    length = np.linalg.norm(axis)
    unit = axis / length if length > 0 else axis
    return np.eye(3) + (by - 1.0) * np.outer(unit, unit)


def _trunk_length(at: dict[str, Array]) -> float:
    """From the middle of the hip sockets to the middle of the shoulders, metres."""
    sockets = [(at[f"left{name}"] + at[f"right{name}"]) / 2 for name in ("UpperLeg", "UpperArm")]
    return float(np.linalg.norm(sockets[1] - sockets[0]))
