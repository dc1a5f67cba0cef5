"""A body that stands in for a source without a surface: the embedded human, fitted to its skeleton.

Motion capture comes as bare joints, but what touches what is a matter of surfaces. So a human of slim build is made as tall
as the source, its joints are moved to where the source's bones want them, and its skin is stretched along. Which hand
touched which hip then shows, up to the girth of the performer, which no skeleton tells. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import HEIGHT, human
from retarget.body.kinematics import forward, local_positions, local_rotations, rest_pose, world_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Motion, Pose
from retarget.contact.support import leg_length
from retarget.correspond.joints import humanoid_from_names
from retarget.errors import RetargetError
from retarget.io.asset import Convention
from retarget.motion.align import Actor, make_actor, same_skeleton
from retarget.motion.copy import CopyPlan, copy_rotations, plan_copy, positions_of

Array = np.ndarray

BUILD = {"gender": 0.5, "weight": 0.2}
"""Of the human: between man and woman, and slim, as performers are. On the skeletons of a thin, a female and a muscular
body with their hands on hips, on the belly and arms crossed, 0.2 invents up to 16 % of the contacts found (thin) and misses
up to 20 % of the true ones (female); a weight of 0.3 invents 21 % and misses no fewer."""
AGE = ((0.8, 1.2, 1.5), (0.02, 0.12, 0.5))
"""Heights in metres, and the human's `age` there: a small skeleton is a child's."""
STRETCH = (0.6, 1.7)
"""Bones are stretched within these bounds; beyond, the source is no human and its stand-in gives way."""
PINNED = ("head", "leftUpperArm", "leftUpperLeg", "rightUpperArm", "rightUpperLeg")
"""Joints put where the source's are on every frame, so that spines of other joint counts and leaning hip sockets move no
hand. In the order of the embedded skeleton."""
SPINE = ("spine", "chest", "upperChest")
"""Joints that first carry the shoulders' middle to the source's, a third of the way each."""
SLACK = 0.06
"""Of the body's height: how far a pinned joint, or the shoulders' middle, may leave its place in the stand-in, whose skin is pulled along."""
LEAST_BONE = 1e-4
"""Of the body's height: a shorter bone is no bone and keeps the human's length."""
BONES: dict[str, tuple[str, str]] = {
    **{f"{side}{joint}": (f"{side}{joint}", f"{side}{child}") for side in ("left", "right") for joint, child in (
        ("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"),
        ("Hand", "MiddleProximal"), ("Foot", "Toes"))},
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
    source: Actor
    plan: CopyPlan

    def motion(self, motion: Motion) -> Motion:
        """A motion of the source on the stand-in: the same frames and rate, joints where the source's are.

        Raises `RetargetError` for a motion of another skeleton.
        """
        if not same_skeleton(motion.skeleton, self.source.skeleton):
            raise RetargetError("the motion belongs to another skeleton than the one the stand-in was fitted to")
        rotations, translations, moved = self._moved(*world_pose(motion))
        return Motion(self.actor.skeleton, rot.continuous(rotations), translations, motion.fps, moved, motion.name)

    def pose(self, pose: Pose) -> Pose:
        """The same for one pose, online. Raises `RetargetError` for a pose of another skeleton."""
        skeleton = self.source.skeleton
        if len(pose.rotations) != len(skeleton) or max(pose.moved) >= len(skeleton):
            raise RetargetError(f"the pose has {len(pose.rotations)} joints, the source {len(skeleton)}")
        local = local_positions(skeleton, pose.translations[None], pose.moved)
        rotations, translations, moved = self._moved(*forward(skeleton.parents, pose.rotations[None], local))
        return Pose(rotations[0], translations[0], moved)

    def _moved(
        self, rotations: Float[Array, "frames joints 4"], positions: Float[Array, "frames joints 3"]
    ) -> tuple[Float[Array, "frames targets 4"], Float[Array, "frames moved 3"], tuple[int, ...]]:
        """Local rotations, and places of the hips and the pinned joints, from the source's world pose."""
        skeleton = self.actor.skeleton
        world = copy_rotations(self.plan, rotations)
        placed = positions_of(skeleton, world, 0, np.zeros((len(world), 3)))
        sockets = positions[:, self.plan.source_sockets].mean(axis=1)
        hips = sockets - placed[:, self.plan.target_sockets].mean(axis=1)
        placed = placed + hips[:, None]
        places = {0: hips}

        def pull(joint: int, away: Float[Array, "frames 3"]) -> None:
            turned = rot.rotate(rot.inverse(world[:, skeleton.parents[joint]]), away)
            places[joint] = skeleton.offsets[joint] + turned

        joints = {name: skeleton.index(name) for name in (*SPINE, *PINNED)}
        away = {name: positions[:, self.source.humanoid.joints[name]] - placed[:, joints[name]] for name in PINNED}
        upper = self._bounded((away["leftUpperArm"] + away["rightUpperArm"]) / 2)
        for name in SPINE:
            pull(joints[name], upper / len(SPINE))
        for name in PINNED:
            pull(joints[name], self._bounded(away[name] if name.endswith("Leg") else away[name] - upper))
        moved = tuple(sorted(places))
        translations = np.stack([places[joint] for joint in moved], axis=1)
        return local_rotations(skeleton.parents, world), translations, moved

    def _bounded(self, away: Float[Array, "frames 3"]) -> Float[Array, "frames 3"]:
        """Ways no longer than `SLACK` allows."""
        length = np.linalg.norm(away, axis=1, keepdims=True)
        return away * np.minimum(1.0, SLACK * self.actor.height / np.maximum(length, 1e-12))


def fit_stand_in(source: Actor) -> StandIn:
    """Fit the embedded human to a source, whatever its proportions.

    Raises `RetargetError` for a skeleton without height, legs or trunk.
    """
    if not 0.0 < source.height < np.inf:
        raise RetargetError(f"no body can stand in for a skeleton of height {source.height:g} m")
    if not leg_length(source.skeleton, source.humanoid) > LEAST_BONE * source.height:
        raise RetargetError("no body can stand in for a skeleton whose legs have no length")
    age = float(np.interp(source.height, *AGE))
    base = human(**BUILD, age=age, height=float(np.clip(source.height, *HEIGHT)), name="stand-in")
    body, wanted, reached = _fitted(base, source)
    if not np.isfinite(body.mesh.vertices).all():
        raise RetargetError("no body can stand in for the source: its joints have no finite places")
    humanoid = humanoid_from_names(body.skeleton, {name: name for name in body.skeleton.names})
    actor = make_actor(body, humanoid, Convention(1.0, "+y"), up="+y", unit=1.0, rest_surface=rest_vertices(body))
    apart = {name: abs(reached[name] / wanted[name] - 1.0) for name in wanted}
    error = float(np.mean(list(apart.values()))) if apart else 0.0
    return StandIn(actor, (_note(actor, age, apart, error),), error, source, plan_copy(source, actor, 0.0, 0.0))


def _note(actor: Actor, age: float, apart: dict[str, float], error: float) -> str:
    """What was chosen, in a line."""
    build = ", ".join(f"{name} {value:g}" for name, value in (BUILD | {"age": age}).items())
    note = (
        f"the source has no surface: an embedded human of {actor.height:.2f} m ({build}) stands in for it; its bones "
        f"agree to {100 * error:.1f} %"
    )
    short = [name for name, value in apart.items() if value > 0.01]
    return f"{note}; beyond what a human stretches to: {', '.join(short)}" if short else note


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
        length = np.linalg.norm(there[second] - there[first])
        return float(np.clip(length / own, *STRETCH)) if length > LEAST_BONE * source.height else 1.0

    stretch = np.ones(len(skeleton))
    axis = np.zeros((len(skeleton), 3))
    for joint in range(len(skeleton)):
        children = skeleton.children(joint)
        if children:
            axis[joint] = joints[children[0]] - joints[joint]
    for name, (first, second) in BONES.items():
        number = skeleton.index(name)
        stretch[number], axis[number] = ratio(first, second), here[second] - here[first]
    # Rigs disagree on where a neck begins, so neck and head are raised to the source's head over its shoulders.
    # The trunk from the hip sockets to the shoulders, and the widths of both.
    trunk = _trunk_length(there) / _trunk_length(here)
    trunk = float(np.clip(trunk, *STRETCH))
    shoulders, hips = ratio("leftUpperArm", "rightUpperArm"), ratio("leftUpperLeg", "rightUpperLeg")
    rise = _head_over_shoulders(here, np.array([0.0, 1.0, 0.0]))
    bone = here["head"][1] - here["neck"][1]
    neck_rise = trunk * (rise - bone)
    neck = float(np.clip(_head_over_shoulders(there, source.humanoid.axes[1]) / (neck_rise + bone), *STRETCH))
    number = skeleton.index("neck")
    stretch[number], axis[number] = neck, here["head"] - here["neck"]
    scale = {name: np.array([1.0, trunk, 1.0]) for name in ("spine", "chest", "upperChest", "neck")}
    scale |= {f"{side}Shoulder": np.array([shoulders, trunk, 1.0]) for side in ("left", "right")}
    scale |= {f"{side}UpperArm": np.array([shoulders, trunk, 1.0]) for side in ("left", "right")}
    scale |= {f"{side}UpperLeg": np.array([hips, 1.0, 1.0]) for side in ("left", "right")}
    grown = np.ones(len(skeleton))  # hands and feet grow in all directions, with all that hangs on them
    for joint, name in enumerate(skeleton.names):
        above = int(skeleton.parents[joint])
        if name.endswith(("Hand", "Foot")):
            grown[joint], stretch[joint] = stretch[joint], 1.0
        elif above >= 0:
            grown[joint] = grown[above]
    offsets = skeleton.offsets.copy()
    for joint in range(1, len(skeleton)):
        name, above = skeleton.names[joint], int(skeleton.parents[joint])
        if name in scale:
            offsets[joint] *= scale[name]
        elif stretch[above] != 1.0:
            offsets[joint] = _along(axis[above], stretch[above]) @ offsets[joint]
        else:
            offsets[joint] *= grown[above]
    offsets[skeleton.index("neck"), 1] += (neck - 1.0) * neck_rise
    ends = {joint: end * grown[joint] for joint, end in (skeleton.end_offsets or {}).items()}
    moved = replace(skeleton, offsets=offsets, end_offsets=ends)
    _, goals = rest_pose(moved)
    maps = np.empty((len(skeleton), 3, 3))
    for joint in range(len(skeleton)):
        maps[joint] = _along(axis[joint], stretch[joint]) if stretch[joint] != 1.0 else grown[joint] * np.eye(3)
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
            if length > LEAST_BONE * source.height:
                wanted[name] = length
                reached[name] = float(np.linalg.norm(at[skeleton.index(second)] - at[skeleton.index(first)]))
    return body, wanted, reached


def _along(axis: Float[Array, "3"], by: float) -> Float[Array, "3 3"]:
    """What stretches space along an axis."""
    length = np.linalg.norm(axis)
    unit = axis / length if length > 0 else axis
    return np.eye(3) + (by - 1.0) * np.outer(unit, unit)


def _head_over_shoulders(at: dict[str, Array], up: Float[Array, "3"]) -> float:
    """How far the head joint is above the middle of the shoulders, metres."""
    return float((at["head"] - (at["leftUpperArm"] + at["rightUpperArm"]) / 2) @ up)


def _trunk_length(at: dict[str, Array]) -> float:
    """From the middle of the hip sockets to the middle of the shoulders, metres."""
    sockets = [(at[f"left{name}"] + at[f"right{name}"]) / 2 for name in ("UpperLeg", "UpperArm")]
    return float(np.linalg.norm(sockets[1] - sockets[0]))
