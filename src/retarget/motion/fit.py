"""A rig fitted to moving vertices: the skeletal motion that explains a surface best, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Shaped

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_rotations
from retarget.character import Motion
from retarget.errors import RetargetError
from retarget.motion.joint_frames import JointFrames

Array = np.ndarray


def fit_motion(
    frames: JointFrames,
    vertices: Shaped[Array, "frames vertices 3"],
    fps: float,
    name: str = "",
    leading: Sequence[int] | None = None,
) -> Motion:
    """The motion of a skinned character whose surface is known on every frame (metres, vertex for vertex).

    Every joint turns as the skin that it moves, in the sense of least squares (weights squared); bones keep their lengths, and
    the root is placed so that the `leading` joints (None: all) lie in the mean where their skin carries them. Raises
    `RetargetError` for another number of vertices, or frames that are not finite.
    """
    if vertices.ndim != 3 or vertices.shape[1:] != frames.rest.shape:
        raise RetargetError(
            f"the character has {len(frames.rest)} vertices, the surface is an array of {vertices.shape}"
        )
    broken = np.flatnonzero(~np.isfinite(vertices).all(axis=(1, 2)))
    if len(broken):
        raise RetargetError(
            f"vertices of frame {int(broken[0])} are not finite; {len(broken)} of {len(vertices)} frames are so"
        )
    skeleton = frames.skeleton
    world, places = (np.stack(each) for each in zip(*map(frames.of, vertices)))
    local = rot.continuous(local_rotations(skeleton.parents, world))
    offsets = np.broadcast_to(skeleton.offsets, (len(local), *skeleton.offsets.shape))
    _, reached = forward(skeleton.parents, local, offsets)
    chosen = slice(None) if leading is None else list(leading)
    root = skeleton.offsets[0] + (places - reached)[:, chosen].mean(axis=1)
    return Motion(skeleton, local, root[:, None], fps, name=name)
