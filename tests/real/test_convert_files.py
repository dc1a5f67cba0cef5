"""Real files come through `retarget convert` with every joint where it was."""

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.commands_convert import Conversion, convert_file
from retarget.io import load

FILES = ["characters/kaykit/Knight.glb", "characters/godot/mannequiny.glb", "characters/quaternius/Alien.fbx"]
MOTIONS = ["cmu_daz/02_01.bvh", "makehuman/walk1.bvh", "animated_drawings/fair1_dab.bvh", "pybvh/bvh_test2.bvh"]


def places(path, clip=None):
    motion = load(path).motion(clip)
    return world_pose(motion)[1][:, np.argsort(motion.skeleton.names)]


@pytest.mark.parametrize("name", FILES)
def test_a_clip_of_a_character_as_bvh(name, data, tmp_path):
    clip = load(data / name).clips[-1].name
    convert_file(Conversion(data / name, tmp_path / "o.bvh", clip=clip))
    there = places(data / name, clip)
    assert np.abs(places(tmp_path / "o.bvh") - there).max() < 1e-4 * np.ptp(there)
    convert_file(Conversion(data / name, tmp_path / "o.gltf", clip=clip))
    assert np.abs(places(tmp_path / "o.gltf") - there).max() < 1e-4 * np.ptp(there)


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_becomes_gltf_of_human_size_and_comes_back(name, data, tmp_path):
    report = convert_file(Conversion(data / "motions" / name, tmp_path / "o.glb"))
    assert [note.split(":")[0].split(" ")[0] for note in report["inferred"]] == ["up", "unit"]
    there, here = places(data / "motions" / name), places(tmp_path / "o.glb")
    # A similarity: all distances scale alike.
    spread = lambda joints: np.linalg.norm(joints[:, :, None] - joints[:, None], axis=-1)[::20]  # noqa: E731
    ratio = np.median(spread(here)[spread(there) > 0] / spread(there)[spread(there) > 0])
    assert np.abs(spread(here) - ratio * spread(there)).max() < 1e-4
    assert 0.8 < np.ptp(here[..., 1]) < 3.0  # upright, in metres
