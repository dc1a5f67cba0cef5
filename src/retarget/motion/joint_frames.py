"""Where the joints of a skinned body are when only its surface is known: a frame for each, read off the skin that it moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Skeleton
from retarget.errors import RetargetError

Array = np.ndarray

LEAST = 0.05
"""Weight below which a vertex says nothing of a joint."""
FEWEST = 4
"""Vertices that tell how a joint is turned; one with fewer follows the joint that it hangs on."""


@dataclass(frozen=True, eq=False)
class JointFrames:
    """A character's joints as rigid pieces of its skin; `prepare_frames` makes one."""

    skeleton: Skeleton
    rest: Float[Array, "vertices 3"]
    """Vertices at rest, metres."""
    world: Float[Array, "joints 4"]
    """World rotations at rest."""
    places: Float[Array, "joints 3"]
    """Joints at rest, metres."""
    starts: Int[Array, "_"]
    """First place of each joint in `members`, and the end."""
    members: Int[Array, "_"]
    """Vertices that tell of each joint, one joint after the other."""
    weights: Float[Array, "_"]
    """What each says, summing to one a joint: its squared skinning weight, so that skin shared with others says little."""
    centres: Float[Array, "joints 3"]
    """Of these vertices at rest."""

    def of(self, vertices: Float[Array, "vertices 3"]) -> tuple[Float[Array, "joints 4"], Float[Array, "joints 3"]]:
        """World rotations and places (metres) of all joints on a posed surface. A joint lies between where its own skin and
        that of the joint it hangs on carry it."""
        from retarget.geometry import turn_kernels as kernels

        count = len(self.skeleton)
        turns, centres = np.tile(rot.IDENTITY, (count, 1)), np.empty((count, 3))
        kernels.group_turns(
            self.rest, np.ascontiguousarray(vertices, dtype=np.float64), self.starts, self.members, self.weights,
            self.centres, turns, centres,
        )  # fmt: skip
        places = np.empty((count, 3))
        kernels.joint_places(
            self.skeleton.parents, self.starts, turns, centres, self.centres.copy(), self.places, places
        )
        return rot.multiply(turns, self.world), places


def prepare_frames(character: Character) -> JointFrames:
    """Which vertices tell of which joint. Raises `RetargetError` for a character whose skin tells of none."""
    skin, count = character.skin, len(character.skeleton)
    rest = rest_vertices(character)
    weights = np.zeros((len(rest), count))
    rows = np.repeat(np.arange(len(rest)), skin.columns.shape[1])
    np.add.at(weights, (rows, skin.joints[skin.columns].ravel()), skin.weights.ravel())
    members, shares, centres = [], [], np.zeros((count, 3))
    for joint in range(count):
        own = np.flatnonzero(weights[:, joint] > LEAST)
        own = own if len(own) >= FEWEST else own[:0]
        share = weights[own, joint] ** 2
        share /= max(share.sum(), 1e-300)
        members.append(own)
        shares.append(share)
        centres[joint] = share @ rest[own]
    if not any(map(len, members)):
        raise RetargetError(f"no joint of {character.name or 'the character'} moves enough of its skin")
    world, places = rest_pose(character.skeleton)
    return JointFrames(
        character.skeleton, rest, world, places, np.cumsum([0, *map(len, members)]), np.concatenate(members),
        np.concatenate(shares), centres,
    )  # fmt: skip
