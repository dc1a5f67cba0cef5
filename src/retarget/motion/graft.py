"""Feet and hands that hang beside their limb instead of on it.

Rigs made for animators often keep the joint that moves a foot under the root, where inverse kinematics drives it, and end
the leg in a bare joint at the ankle. Methods turn limbs from the root down, so in their work such a joint hangs on the end
of its limb; the result is led back to the tree of the file, where the joint gets a path of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from retarget.body import rotations as rot
from retarget.body.kinematics import local_rotations, rest_pose, world_pose
from retarget.character import Character, Motion, Skeleton
from retarget.correspond.joints import Humanoid

Array = np.ndarray

NEAR = 0.03
"""Of the height: how far from the end of its limb a joint beside it may lie."""
ENDS = {"Foot": "LowerLeg", "Hand": "LowerArm"}


@dataclass(frozen=True, eq=False)
class Graft:
    """A skeleton in which joints hang elsewhere than in its file; `graft` finds it."""

    skeleton: Skeleton
    """The file's tree."""
    order: Int[Array, "joints"]
    """For each joint of the grafted skeleton, the file's."""
    moved: tuple[int, ...]
    """Joints of the file that hang elsewhere."""

    def back(self, motion: Motion) -> Motion:
        """A motion of the grafted skeleton on the file's: the same place and turn of every joint on every frame."""
        rotations, positions = world_pose(motion)
        place = np.empty_like(self.order)
        place[self.order] = np.arange(len(self.order))
        rotations, positions = rotations[:, place], positions[:, place]
        moved = tuple(sorted({0, *self.moved, *(int(self.order[joint]) for joint in motion.moved)}))
        parents = self.skeleton.parents[list(moved)]
        translations = positions[:, list(moved)].copy()
        for number, parent in enumerate(parents.tolist()):
            if parent >= 0:
                away = positions[:, moved[number]] - positions[:, parent]
                translations[:, number] = rot.rotate(rot.inverse(rotations[:, parent]), away)
        local = rot.continuous(local_rotations(self.skeleton.parents, rotations))
        return replace(motion, skeleton=self.skeleton, rotations=local, translations=translations, moved=moved)


def graft(character: Character, humanoid: Humanoid, height: float) -> tuple[Character, Humanoid, Graft | None]:
    """The character with its feet and hands on their limbs; None where they are, and the character as it was."""
    parents = _parents(character, humanoid, height)
    skeleton = character.skeleton
    changed = np.flatnonzero(parents != skeleton.parents)
    if not len(changed):
        return character, humanoid, None
    order = _parents_first(parents)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    world, positions = rest_pose(skeleton)
    above = np.where(parents[order] >= 0, place[parents[order]], -1)
    offsets = skeleton.offsets[order].copy()
    rotations = local_rotations(above, world[order])
    for joint in place[changed].tolist():
        away = positions[order[joint]] - positions[order[above[joint]]]
        offsets[joint] = rot.rotate(rot.inverse(world[order[above[joint]]]), away)
    ends = skeleton.end_offsets and {int(place[joint]): end for joint, end in skeleton.end_offsets.items()}
    grafted = Skeleton(tuple(skeleton.names[joint] for joint in order), above, offsets, rotations, ends)
    skin = replace(character.skin, joints=place[character.skin.joints])
    body = replace(
        humanoid,
        joints={name: int(place[joint]) for name, joint in humanoid.joints.items()},
        twists={int(place[joint]): name for joint, name in humanoid.twists.items()},
    )
    moved = tuple(int(joint) for joint in changed)
    return replace(character, skeleton=grafted, skin=skin, origin=None), body, Graft(skeleton, order, moved)


def _parents(character: Character, humanoid: Humanoid, height: float) -> Int[Array, "joints"]:
    """Parents under which feet and hands hang on their limbs."""
    skeleton = character.skeleton
    parents = skeleton.parents.copy()
    if character.skin is None:
        return parents
    _, rest = rest_pose(skeleton)
    skinned = _moves_skin(character)
    for side in ("left", "right"):
        for end, lower in ENDS.items():
            if f"{side}{end}" not in humanoid.joints or f"{side}{lower}" not in humanoid.joints:
                continue
            tip, limb = humanoid.joints[f"{side}{end}"], humanoid.joints[f"{side}{lower}"]
            if tip in _hanging(parents, limb) and skinned[_hanging(parents, tip)].any():
                continue
            under = tip if tip in _hanging(parents, limb) else limb
            beside = np.linalg.norm(rest - rest[tip], axis=1) < NEAR * height
            for joint in np.flatnonzero(beside).tolist():
                below = _hanging(parents, joint)
                if joint and joint not in _hanging(parents, limb) and limb not in below and skinned[below].any():
                    parents[joint] = under
                    break
    return parents


def _moves_skin(character: Character) -> Array:
    moves = np.zeros(len(character.skeleton), dtype=bool)
    used = np.unique(character.skin.columns[character.skin.weights > 0.1])
    moves[character.skin.joints[used]] = True
    return moves


def _hanging(parents: Int[Array, "joints"], joint: int) -> list[int]:
    """The joint and all that hang on it."""
    found = [joint]
    for each in found:
        found.extend(np.flatnonzero(parents == each).tolist())
    return found


def _parents_first(parents: Int[Array, "joints"]) -> Int[Array, "joints"]:
    """The joints in an order in which parents come first, else as they were."""
    order: list[int] = []
    placed = np.zeros(len(parents), dtype=bool)
    while len(order) < len(parents):
        for joint in range(len(parents)):
            if not placed[joint] and (parents[joint] < 0 or placed[parents[joint]]):
                placed[joint] = True
                order.append(joint)
    return np.array(order)
