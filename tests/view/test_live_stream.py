"""The viewer of `retarget stream --view`: a body that moves as poses arrive."""

import numpy as np
import pytest

pytest.importorskip("viser")

from retarget import RetargetError
from retarget.body.human import human
from retarget.body.kinematics import still_motion
from retarget.casting import cast
from retarget.live import LivePose
from retarget.motion.align import Actor
from retarget.view.live_stream import StreamViewer


def test_a_body_is_shown_where_its_pose_puts_it():
    target = cast(human())
    viewer = StreamViewer(target)
    try:
        assert viewer.address.startswith("http://127.0.0.1:")
        motion = still_motion(target.skeleton)
        moved = type(motion)(motion.skeleton, motion.rotations, motion.translations + [1.0, 0.0, 0.0])
        viewer.show(LivePose(0, None, "nobody", 0.0))
        viewer.show(LivePose(1, moved, "found", 0.9))
        shown = np.asarray(viewer._body.vertices)
        assert np.abs(shown - target.character.mesh.vertices - [1.0, 0.0, 0.0]).max() < 1e-4
        assert "found" in viewer._state.content
    finally:
        viewer.close()


def test_bare_skeletons_are_not_shown():
    target = cast(human())
    bare = type(target.character)(target.character.skeleton, name="bare")
    with pytest.raises(RetargetError, match="--view shows surfaces"):
        StreamViewer(Actor(bare, bare, target.humanoid, target.house_from_file, target.height))
