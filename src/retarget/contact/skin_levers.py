"""How points of the skin move when joints turn: the analytic Jacobian of linear blend skinning, by joints of the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.character import Character
from retarget.correspond.joints import Humanoid

Array = np.ndarray

TURNING = (
    "hips", "spine", "chest", "upperChest", "neck", "head",
    *(f"{side}{part}" for side in ("left", "right") for part in (
        "Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot",
        "ThumbMetacarpal", "IndexProximal", "MiddleProximal", "RingProximal", "LittleProximal")),
)  # fmt: skip
"""The joints that a solver turns, where a body has them; all others go along with the one they hang on. Of fingers only the
knuckles turn: enough for a hand to lie on a belly rounder than the source's."""
FAINT = 0.01
"""Share of a vertex below which it does not count as carried by a joint."""


@dataclass(frozen=True, eq=False)
class SkinLevers:
    """What solvers need of a skin; `prepare_levers` makes one."""

    names: tuple[str, ...]
    """Canonical names of the turning joints; those above come first."""
    turning: Int[Array, "turning"]
    """Their joints in the skeleton."""
    above: Bool[Array, "turning turning"]
    """`above[a, b]`: joint a carries joint b (or is b)."""
    joints: Int[Array, "vertices carrying"]
    """Turning joints that carry each vertex; -1 behind the last."""
    weights: Float[Array, "vertices carrying"]
    """How much of the vertex each carries: the skinning weights of all joints that hang on it, and its own. A turn w of
    the joint at x moves a vertex at p by weight · w x (p - x)."""


def prepare_levers(character: Character, humanoid: Humanoid) -> SkinLevers:
    """Gather, for every vertex, how much of it each turning joint carries."""
    skeleton, skin = character.skeleton, character.skin
    chosen = sorted((humanoid.joints[name], name) for name in TURNING if name in humanoid.joints)
    turning = np.array([joint for joint, _ in chosen])
    carries = np.zeros((len(turning), len(skeleton)), dtype=bool)
    for joint in range(len(skeleton)):
        above = int(skeleton.parents[joint])
        if above >= 0:
            carries[:, joint] = carries[:, above]
        carries[turning == joint, joint] = True
    total = np.zeros((len(skin.weights), len(skeleton)))
    rows = np.repeat(np.arange(len(skin.weights)), skin.columns.shape[1])
    np.add.at(total, (rows, skin.joints[skin.columns].ravel()), skin.weights.ravel())
    carried = total @ carries.T.astype(np.float64)
    carried[carried < FAINT] = 0.0
    most = int((carried > 0).sum(axis=1).max(initial=1))
    joints = np.argsort(-carried, axis=1, kind="stable")[:, :most]
    weights = np.take_along_axis(carried, joints, axis=1)
    joints = np.where(weights > 0, joints, -1).astype(np.int32)
    return SkinLevers(
        tuple(name for _, name in chosen), turning, carries[:, turning], joints, np.ascontiguousarray(weights)
    )
