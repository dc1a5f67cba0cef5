"""BVH files of many makers: what is known of them, and that writing loses nothing."""

import numpy as np
import pytest

from retarget.body.kinematics import rest_pose, world_pose
from retarget.io import bvh

# Joints, frames, frames a second.
FACTS = {
    "cmu_daz/01_01": (43, 2752, 120.0),
    "cmu_cgspeed/01_01": (31, 2752, 120.0),
    "animated_drawings/cmu1_jumping_jacks": (31, 125, 30.0),
    "animated_drawings/fair1_dab": (27, 339, 30.0),
    "animated_drawings/fair1_jumping": (27, 654, 119.88),
    "animated_drawings/fair1_wave_hello": (27, 839, 119.88),
    "makehuman/tpose": (173, 1, 24.0),
    "makehuman/walk1": (75, 14, 24.0),
    "makehuman/zombieWalk1": (75, 31, 24.0),
    "pybvh/bvh_test1": (24, 75, 30.0),
    "pybvh/bvh_test2": (23, 61, 120.0),
    "pybvh/bvh_test3": (60, 100, 120.0),
}


def test_every_file_is_read_and_finite(data):
    paths = sorted(data.rglob("*.bvh"))
    assert paths
    for path in paths:
        asset = bvh.load(path)
        motion = asset.motion()
        assert asset.kind == "motion" and asset.character.skeleton is motion.skeleton
        assert (len(motion), motion.fps) == (asset.clips[0].frames, asset.clips[0].fps)
        assert not any("passed over" in note or "numbered" in note for note in asset.notes), (path, asset.notes)
        assert np.isfinite(world_pose(motion)[1]).all()


@pytest.mark.parametrize("name", FACTS)
def test_known_facts(data, name):
    motion = bvh.load(data / "motions" / f"{name}.bvh").motion()
    assert (len(motion.skeleton), len(motion), motion.fps) == FACTS[name]


def test_the_daz_clips_share_one_skeleton_and_rate(data):
    assets = [bvh.load(path) for path in sorted((data / "motions/cmu_daz").glob("*.bvh"))]
    first = assets[0].character.skeleton
    assert len(first) == 43 and all(asset.clips[0].fps == 120.0 for asset in assets)
    for asset in assets:
        assert asset.character.skeleton.names == first.names
        assert np.array_equal(asset.character.skeleton.offsets, first.offsets)


def test_the_same_performance_on_two_skeletons_moves_the_hips_along_the_same_path(data):
    daz = bvh.load(data / "motions/cmu_daz/01_01.bvh").motion().translations[1:, 0]
    cgspeed = bvh.load(data / "motions/cmu_cgspeed/01_01.bvh").motion().translations[1:, 0]
    for axis in (1, 2):  # up and along the jump; sideways hardly anything happens
        assert np.corrcoef(daz[:, axis], cgspeed[:, axis])[0, 1] > 0.99


def test_position_channels_of_the_makehuman_t_pose_are_changes_of_the_offsets(data):
    """Read as replacements, every leg would collapse into the hip; the file itself would be no T-pose."""
    asset = bvh.load(data / "motions/makehuman/tpose.bvh")
    assert any("added" in note for note in asset.notes)
    motion = asset.motion()
    rest, posed = rest_pose(motion.skeleton)[1], world_pose(motion)[1][0]
    parents = motion.skeleton.parents[1:]

    def bones(positions):
        return np.linalg.norm(positions[1:] - positions[parents], axis=1)

    assert np.abs(bones(posed) - bones(rest)).max() < 1e-3
    left, right = (posed[motion.skeleton.index(f"upperarm01.{side}")] for side in "LR")
    assert np.allclose(left, right * [-1, 1, 1], atol=0.01)


@pytest.mark.parametrize("name", FACTS)
def test_written_and_read_back(data, tmp_path, name):
    motion = bvh.load(data / "motions" / f"{name}.bvh").motion()
    bvh.save(tmp_path / "out.bvh", motion)
    again = bvh.load(tmp_path / "out.bvh").motion()
    assert again.skeleton.names == motion.skeleton.names and again.fps == motion.fps and again.moved == motion.moved
    error = np.abs(world_pose(again)[1] - world_pose(motion)[1]).max()
    height = np.ptp(rest_pose(motion.skeleton)[1], axis=0).max()
    assert error / height * 1.7 < 1e-5  # metres, at a height of 1.7 m
