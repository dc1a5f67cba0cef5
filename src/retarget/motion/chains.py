"""Chains whose joint counts differ between bodies (spine, neck) share their rotation by arc length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton
from retarget.correspond.joints import Humanoid

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints in a row from the root's side to the end, both ends included."""

    joints: tuple[int, ...]
    place: Float[Array, "chain"]
    """Arc length of each joint along the chain at rest, 0 at the first, 1 at the last."""


def path_up(skeleton: Skeleton, joint: int) -> list[int]:
    """The joint, its parent, and so on to the root."""
    path = [joint]
    while skeleton.parents[path[-1]] >= 0:
        path.append(int(skeleton.parents[path[-1]]))
    return path


def chain_between(skeleton: Skeleton, first: int, last: int) -> Chain:
    """The chain from an ancestor down to its descendant. Both may be the same joint."""
    up = path_up(skeleton, last)
    joints = up[: up.index(first) + 1][::-1] if first in up else [first, last]
    _, rest = rest_pose(skeleton)
    steps = np.linalg.norm(np.diff(rest[joints], axis=0), axis=1)
    length = steps.sum()
    place = np.concatenate([[0.0], np.cumsum(steps)]) / (length if length > 1e-9 else 1.0)
    if len(joints) > 1:
        place[-1] = 1.0
    return Chain(tuple(joints), place)


def chest_joint(skeleton: Skeleton, humanoid: Humanoid) -> int:
    """Where the arms part from the trunk: the lowest common ancestor of both upper arms (and of the head)."""
    arms = [set(path_up(skeleton, humanoid.joints[f"{side}UpperArm"])) for side in ("left", "right")]
    shared = [joint for joint in path_up(skeleton, humanoid.joints["head"]) if joint in arms[0] and joint in arms[1]]
    return shared[0]


def trunk_and_neck(skeleton: Skeleton, humanoid: Humanoid) -> tuple[Chain, Chain]:
    """Hips to chest, and chest to head."""
    chest = chest_joint(skeleton, humanoid)
    return chain_between(skeleton, humanoid.joints["hips"], chest), chain_between(
        skeleton, chest, humanoid.joints["head"]
    )


def share(place: float, chain: Chain) -> tuple[int, int, float]:
    """Which two joints of a chain stand at a place along it, and the weight of the second.

    At a place where several joints coincide (pelvis and first spine joint of many rigs) the last one counts, except at
    the very start, which always is the chain's first joint.
    """
    if len(chain.joints) == 1:
        return chain.joints[0], chain.joints[0], 0.0
    after = int(np.searchsorted(chain.place, place, side="right"))
    after = min(max(after, 1), len(chain.joints) - 1)
    before = after - 1
    span = chain.place[after] - chain.place[before]
    weight = float(np.clip((place - chain.place[before]) / span, 0, 1)) if span > 1e-9 else 1.0
    return chain.joints[before], chain.joints[after], weight
