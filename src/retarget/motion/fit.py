"""A rig fitted to moving vertices: the skeletal motion that explains a surface best, joint by joint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_rotations
from retarget.character import Character, Motion
from retarget.errors import RetargetError
from retarget.motion.joint_frames import prepare_frames

Array = np.ndarray


def fit_motion(character: Character, vertices: Float[Array, "frames vertices 3"], fps: float, name: str = "") -> Motion:
    """The motion of a skinned character whose surface is known on every frame (metres, vertex for vertex).

    Every joint turns as the skin that it moves, in the sense of least squares (weights squared); the root goes where its own
    skin goes, and bones keep their lengths. Raises `RetargetError` for another number of vertices, or frames that are not
    finite.
    """
    frames = prepare_frames(character)
    if vertices.ndim != 3 or vertices.shape[1:] != frames.rest.shape:
        raise RetargetError(
            f"the character has {len(frames.rest)} vertices, the surface is an array of {vertices.shape}"
        )
    broken = np.flatnonzero(~np.isfinite(vertices).all(axis=(1, 2)))
    if len(broken):
        raise RetargetError(
            f"vertices of frame {int(broken[0])} are not finite; {len(broken)} of {len(vertices)} frames are so"
        )
    skeleton = character.skeleton
    found = [frames.of(each) for each in vertices]
    world = np.stack([turned for turned, _ in found]).reshape(-1, len(skeleton), 4)
    at = np.stack([places for _, places in found]).reshape(-1, len(skeleton), 3)
    local = rot.continuous(local_rotations(skeleton.parents, world))
    # The root is set so that all joints lie nearest to where they were seen: its own place alone says less.
    offsets = np.tile(skeleton.offsets, (len(local), 1, 1))
    _, placed = forward(skeleton.parents, local, offsets)
    root = skeleton.offsets[0] + (at - placed).mean(axis=1)
    return Motion(skeleton, local, root[:, None], fps, name=name)
