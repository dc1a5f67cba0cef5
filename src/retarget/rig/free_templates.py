"""Templates of any structure: dogs, birds, spiders, lamps. Nothing is known of them but their own joints and skin.

Without a human's ends and stances to look for, they are laid into meshes by landmarks that the user gives (`given.py`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Skeleton
from retarget.correspond.joints import Humanoid
from retarget.correspond.joints_by_name import spell
from retarget.errors import RetargetError
from retarget.geometry.resample import Surface
from retarget.rig.fit import AREA
from retarget.rig.template import AVERAGE, Parts, Structure, Template, make_template
from retarget.rig.templates import (
    dense_weights,
    joint_landmarks,
    nearest_vertices,
    no_components,
    one_surface,
    scaled_skeleton,
)
from retarget.rig.working_surface import surface_size

Array = np.ndarray

LEAST_SKIN = 0.001
"""Share of the skin from which a joint is fitted; what moves less follows the joint above it, and gets its place from the skin."""
MOST_JOINTS = 90
"""Joints that are fitted, those with the most skin."""
PART_SPREAD = 0.5
"""How far parts are expected to differ in size and girth, as a share: animals of one structure do more than humans."""
UPRIGHT = 0.25
"""Share of the height by which a human's hands are above its feet at rest, at least, and its head above its hips."""


def free_template(character: Character) -> Template:
    """Any rigged character with a surface, in metres with +Y up, whatever its structure; one in many pieces stands as the shell
    around them.

    Raises `RetargetError` for a character without a surface, and for one whose surface fewer than two joints move.
    """
    who = character.name or "the template"
    if character.mesh is None or character.skin is None:
        raise RetargetError(f"{who} has no surface, so it cannot be a template")
    rest = rest_vertices(character)
    used, packed = np.unique(character.mesh.faces, return_inverse=True)
    surface, weights = one_surface(Surface(rest[used], packed.reshape(-1, 3)), dense_weights(character)[used])
    unit = float(np.sqrt(AREA)) / surface_size(surface)
    surface = Surface(surface.vertices * unit, surface.faces)
    skeleton = scaled_skeleton(character.skeleton, unit)
    structure = free_structure(skeleton, weights)
    if len(structure.names) < 2:
        raise RetargetError(f"{who} has {len(structure.names)} joint that moves its surface; a template needs two")
    return make_template(
        Parts(skeleton, structure, surface, weights, (), joint_landmarks(skeleton, surface, weights),
              nearest_vertices(rest * unit, surface), float(np.ptp(rest[used, 1])), *no_components(surface, structure),
              {"template": AVERAGE})
    )  # fmt: skip


def free_structure(skeleton: Skeleton, weights: Float[Array, "vertices joints"]) -> Structure:
    """Every joint that moves some of the skin, and the one that they all hang on; left and right ones by their names."""
    share = weights.mean(axis=0)
    order = np.argsort(-share, kind="stable")[:MOST_JOINTS]
    chosen = set(order[share[order] >= LEAST_SKIN].tolist())
    joints = np.array(sorted(chosen | {_common(skeleton, chosen)}))
    parents = np.full(len(joints), -1)
    place = {int(joint): number for number, joint in enumerate(joints)}
    for number in range(1, len(joints)):
        above = int(skeleton.parents[joints[number]])
        while above not in place:
            above = int(skeleton.parents[above])
        parents[number] = place[above]
    names = tuple(skeleton.names[joint] for joint in joints)
    return Structure(names, joints, parents, len(joints), _pairs(names), (), PART_SPREAD)


def stands_like_a_human(skeleton: Skeleton, humanoid: Humanoid) -> bool:
    """Whether a body whose joints were matched to a human's stands like one at rest; dogs' joints match as well, on all fours."""
    places, joints = rest_pose(skeleton)[1] @ humanoid.axes[1], humanoid.joints
    if not {"hips", "head", "leftHand", "rightHand", "leftFoot", "rightFoot"} <= set(joints):
        return True  # what is missing is told by who needs it
    hips, head, hands, feet = (
        places[[joints[name] for name in names]].mean()
        for names in (("hips",), ("head",), ("leftHand", "rightHand"), ("leftFoot", "rightFoot"))
    )
    tall = abs(head - feet)
    return bool(hands - feet > UPRIGHT * tall and head - hips > UPRIGHT * tall)


def _common(skeleton: Skeleton, chosen: set[int]) -> int:
    """The lowest joint that all of these are or hang on; the root for none."""
    chains = []
    for joint in chosen:
        chain = [joint]
        while chain[-1]:
            chain.append(int(skeleton.parents[chain[-1]]))
        chains.append(set(chain))
    return max(set.intersection(*chains), default=0) if chains else 0


def _pairs(names: tuple[str, ...]) -> list[list[int]]:
    """Joints whose names differ in the side alone, in twos; the others alone."""
    spelled = [spell(name) for name in names]
    sides: dict[tuple[str, int | None, int | None], dict[int, list[int]]] = {}
    for joint, each in enumerate(spelled):
        if each.side:
            sides.setdefault((each.word, each.number, each.last_number), {}).setdefault(each.side, []).append(joint)
    pairs = {min(one + other): one + other for one, other in _both(sides) if len(one) == len(other) == 1}
    paired = {joint for pair in pairs.values() for joint in pair}
    return [sorted(pairs.get(joint, [joint])) for joint in range(len(names)) if joint in pairs or joint not in paired]


def _both(sides: dict) -> list[tuple[list[int], list[int]]]:
    return [(each[1], each[-1]) for each in sides.values() if set(each) == {1, -1}]
