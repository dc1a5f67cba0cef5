"""Where the joints of a skinned body are when only its surface is known: the frames whose skinning comes nearest to it.

Every joint starts as the rigid piece of its own skin; then each in turn is fitted to what the others' share of its skin leaves
over (as the bone updates of skinning decomposition, Le and Deng 2012, the weights being given). The start alone is 7 degrees
off in upper arms and 17 in shoulders, whose skin moves half with others; on a skinned surface three rounds leave .6, eight .01.
"""

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
"""Weight above which a vertex counts as a joint's own."""
FEWEST = 4
"""Own vertices that tell how a joint is turned; one with fewer follows the joint that it hangs on."""
ROUNDS = 4
"""In which joints are fitted to what the others leave: a millisecond or two at 7,000 vertices."""


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
    """How much each moves with the joint, summing to one a vertex over all joints that have vertices."""
    squares: Float[Array, "_"]
    """The squares of these, summing to one a joint: skin shared with others says little."""
    totals: Float[Array, "joints"]
    """The sums of the squares."""
    centres: Float[Array, "joints 3"]
    """Of these vertices at rest, by the squares."""

    def of(self, vertices: Float[Array, "vertices 3"]) -> tuple[Float[Array, "joints 4"], Float[Array, "joints 3"]]:
        """World rotations and places (metres) of all joints on a posed surface. A joint lies between where its own skin and
        that of the joint it hangs on carry it."""
        from retarget.geometry import turn_kernels as kernels

        count = len(self.skeleton)
        turns, centres = np.tile(rot.IDENTITY, (count, 1)), np.empty((count, 3))
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        kernels.group_turns(self.rest, vertices, self.starts, self.members, self.squares, self.centres, turns, centres)
        kernels.skin_turns(
            self.rest, vertices, self.starts, self.members, self.weights, self.totals, self.centres, ROUNDS, turns, centres,
            np.empty_like(vertices),
        )  # fmt: skip
        places = np.empty((count, 3))
        kernels.joint_places(
            self.skeleton.parents, self.starts, turns, centres, self.centres.copy(), self.places, places
        )
        return rot.multiply(turns, self.world), places


def prepare_frames(character: Character) -> JointFrames:
    """Which vertices tell of which joint. Raises `RetargetError` for a character whose skin tells of none."""
    skin, count = character.skin, len(character.skeleton)
    rest = np.ascontiguousarray(rest_vertices(character), dtype=np.float64)
    weights = np.zeros((len(rest), count))
    rows = np.repeat(np.arange(len(rest)), skin.columns.shape[1])
    np.add.at(weights, (rows, skin.joints[skin.columns].ravel()), skin.weights.ravel())
    weights[:, (weights > LEAST).sum(axis=0) < FEWEST] = 0.0
    if not weights.any():
        raise RetargetError(f"no joint of {character.name or 'the character'} moves enough of its skin")
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    joints, members = np.nonzero(weights.T)
    each = weights[members, joints]
    totals = (weights**2).sum(axis=0)
    centres = (weights**2).T @ rest / np.maximum(totals, 1e-300)[:, None]
    world, places = rest_pose(character.skeleton)
    return JointFrames(
        character.skeleton, rest, world, places,
        np.concatenate([[0], np.bincount(joints, minlength=count).cumsum()]).astype(np.int32), members.astype(np.int32), each, each**2 / totals[joints], totals, centres,
    )  # fmt: skip
