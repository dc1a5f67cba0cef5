"""Captured motions get a body whose joints stand where the capture's do."""

import time

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.io import load
from retarget.motion.filter import cut
from retarget.motion.stand_in import fit_stand_in

FILES = (
    "cmu_daz/02_10",
    "cmu_daz/13_07",
    "cmu_daz/14_17",
    "cmu_cgspeed/01_01",
    "animated_drawings/fair1_dab",
    "animated_drawings/cmu1_jumping_jacks",
)
JOINTS = ("head", "leftHand", "rightHand", "leftFoot", "rightFoot")


@pytest.mark.parametrize("name", FILES)
def test_captures_get_a_body(data, name):
    path = data / "motions" / f"{name}.bvh"
    if not path.is_file():
        pytest.skip(f"{name} is not at hand")
    asset = load(path)
    source = cast(asset, motion=asset.motion())
    start = time.process_time()
    fitted = fit_stand_in(source)
    assert time.process_time() - start < 2.0
    assert fitted.bone_error < 0.05
    motion = source.house_from_file.motion(asset.motion())
    motion = cut(motion, 0.0, min(2.0, motion.seconds))
    on_body = fitted.motion(motion)
    assert np.isfinite(prepare_skinning(fitted.actor.character).vertices(*world_pose(on_body))[::20]).all()
    (_, there), (_, here) = world_pose(motion), world_pose(on_body)
    for joint in JOINTS:
        gap = there[:, source.humanoid.joints[joint]] - here[:, fitted.actor.humanoid.joints[joint]]
        assert np.linalg.norm(gap, axis=1).mean() < 0.01, joint
