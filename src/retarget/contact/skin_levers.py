"""How points of the skin move when joints turn: the analytic Jacobian of linear blend skinning, by joints of the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.character import Character
from retarget.correspond.joints import Humanoid

Array = np.ndarray

TURNING = (
    "spine", "chest", "upperChest", "neck", "head",
    *(f"{side}{part}" for side in ("left", "right") for part in ("Shoulder", "UpperArm", "LowerArm", "Hand")),
)  # fmt: skip
"""The joints that the solver turns, where a body has them; all others go along with the one they hang on. Hips and legs
stay as they were copied, so that feet stand."""
INFLUENCES = 6
"""Turning joints that a vertex follows at most; the heaviest are kept."""


@dataclass(frozen=True, eq=False)
class SkinLevers:
    """What the solver needs of a skin; `prepare_levers` makes one."""

    names: tuple[str, ...]
    """Canonical names of the turning joints."""
    turning: Int[Array, "turning"]
    """Their joints in the skeleton; those above come first."""
    parents: Int[Array, "turning"]
    """The turning joint that each hangs on, -1 where there is none."""
    joints: Int[Array, "vertices influences"]
    """Turning joints that each vertex follows."""
    weights: Float[Array, "vertices influences"]


def prepare_levers(character: Character, humanoid: Humanoid) -> SkinLevers:
    """Gather a skin's weights on its turning joints. What hangs on one of them, a finger on its hand, counts as it; weight
    on what hangs on none is left out: those vertices stay."""
    skeleton, skin = character.skeleton, character.skin
    chosen = sorted((humanoid.joints[name], name) for name in TURNING if name in humanoid.joints)
    turning = np.array([joint for joint, _ in chosen])
    place = {joint: number for number, joint in enumerate(turning.tolist())}
    carrier = np.zeros(len(skeleton), dtype=np.int64)  # one column more for what hangs on none
    for joint in range(len(skeleton)):
        above = int(skeleton.parents[joint])
        carrier[joint] = place.get(joint, carrier[above] if above >= 0 else len(turning))
    parents = np.array([_turning_above(skeleton.parents, joint, place) for joint in turning.tolist()])
    total = np.zeros((len(skin.weights), len(turning) + 1))
    rows = np.repeat(np.arange(len(skin.weights)), skin.columns.shape[1])
    np.add.at(total, (rows, carrier[skin.joints[skin.columns]].ravel()), skin.weights.ravel())
    total = total[:, :-1]
    joints = np.argsort(-total, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(total, joints, axis=1)
    return SkinLevers(
        tuple(name for _, name in chosen),
        turning,
        parents.astype(np.int32),
        joints.astype(np.int32),
        weights,
    )


def _turning_above(parents: Int[Array, "joints"], joint: int, place: dict[int, int]) -> int:
    above = int(parents[joint])
    while above >= 0 and above not in place:
        above = int(parents[above])
    return place[above] if above >= 0 else -1
