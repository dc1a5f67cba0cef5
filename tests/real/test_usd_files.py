"""The real USDZ at hand: read as usd-core poses it, performed upon, and kept; real GLB characters through USD and back."""

import subprocess
import sys
import time

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.io import load, save
from retarget.retargeting import prepare

pytest.importorskip("pxr")
from usd_reference import posed_by_usd  # noqa: E402

FIGURE, KNIGHT = "characters/khronos/RiggedFigure.usdz", "characters/kaykit/Knight.glb"


def at_hand(data, name):
    if not (data / name).exists():
        pytest.skip(f"{name} is not at hand")
    return data / name


def posed(character, motion):
    turns, places = world_pose(motion)
    return places, prepare_skinning(character).vertices(turns, places)


def test_the_figure_is_read_as_usd_poses_it_and_recognised(data):
    path = at_hand(data, FIGURE)
    started = time.perf_counter()
    asset = load(path)
    motion = asset.motion()
    assert time.perf_counter() - started < 10 and (len(motion), motion.fps) == (31, 24.0)
    places, vertices = posed(asset.character, motion)
    for frame in range(0, 31, 6):
        joints, points = posed_by_usd(path, float(frame))
        assert np.abs(vertices[frame] - points).max() < 1e-5
        assert max(np.abs(places[frame, motion.skeleton.index(name)] - place).max() for name, place in joints.items()) < 1e-5
    actor = cast(asset)
    assert len(actor.humanoid.joints) == 19 and actor.height == pytest.approx(1.45, abs=0.05)


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
@pytest.mark.parametrize("name", [FIGURE, KNIGHT])
def test_characters_go_through_usd_within_a_tenth_of_a_millimetre(data, tmp_path, name, suffix):
    asset = load(at_hand(data, name))
    motion, path = asset.motion(0), tmp_path / f"out.{suffix}"
    save(path, asset.character, [motion])
    again = load(path)
    order = [again.character.skeleton.index(joint) for joint in asset.character.skeleton.names]
    (places, vertices), (new_places, new_vertices) = posed(asset.character, motion), posed(again.character, again.motion())
    assert 1000 * np.abs(places - new_places[:, order]).max() < 0.1
    assert 1000 * np.abs(vertices - new_vertices).max() < 0.1


@pytest.mark.parametrize("suffix", ["usdz", "glb"])
def test_a_captured_motion_reaches_the_figure(data, tmp_path, suffix):
    source = load(at_hand(data, "motions/cmu_daz/02_01.bvh"))
    figure = load(at_hand(data, FIGURE))
    motion = source.motion()
    result = prepare(cast(source, motion=motion), cast(figure), "copy-rotations")(motion)
    result.save(tmp_path / f"out.{suffix}")
    again = load(tmp_path / f"out.{suffix}")
    assert sorted(clip.name for clip in again.clips) == sorted([motion.name, "skelAnim_0"])
    written = again.motion(motion.name)
    assert len(written) == len(motion) and written.fps == pytest.approx(motion.fps)
    assert np.abs(world_pose(written)[1] - world_pose(result.file_motion)[1]).max() < 1e-5


def test_the_command_line_takes_and_gives_usd(data, tmp_path):
    figure, out = at_hand(data, FIGURE), tmp_path / "out.usdz"
    clip = at_hand(data, "motions/cmu_daz/02_01.bvh")
    arguments = ["run", clip, figure, "-o", out, "--end", "0.2", "--method", "copy-rotations"]
    subprocess.run([sys.executable, "-m", "retarget", *map(str, arguments)], check=True, capture_output=True)
    assert load(out).plays == 0 and load(out).clips[0].name == "02_01"
