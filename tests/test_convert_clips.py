"""`retarget convert` with several clips: all of them where the format holds several, each once, and one line where it does not."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, fingerless, stand, walk
from vrm_maker import vrm

from retarget.body.kinematics import world_pose
from retarget.io import load, save

USD = [".usda", ".usdc", ".usdz"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A body with two clips of one rate, another with two of different rates, a VRM with two."""
    folder = tmp_path_factory.mktemp("clips")
    clips = [replace(fingerless(walk()), name="one"), replace(fingerless(stand()), name="two")]
    save(folder / "two.glb", fingerless(body()), clips)
    save(folder / "rates.glb", fingerless(body()), [clips[0], replace(clips[1], fps=24.0)])
    vrm(folder / "avatar.vrm", motions=[replace(walk(), name="one"), replace(stand(), name="two")])
    return folder


def clips(path):
    return [(clip.name, clip.frames) for clip in load(path).clips]


def places(path, clip):
    """Joint positions, joints in the order of their names."""
    motion = load(path).motion(clip)
    return world_pose(motion)[1][:, np.argsort(motion.skeleton.names)]


@pytest.mark.parametrize("suffix", [".glb", ".gltf", *USD])
@pytest.mark.parametrize("source", ["two.glb", "rates.glb"])
def test_all_clips_arrive_where_they_were(made, tmp_path, command, suffix, source):
    if suffix in USD:
        pytest.importorskip("pxr")
    code, out, err = command("convert", made / source, tmp_path / f"o{suffix}")
    assert (code, err) == (0, "") and "2 clips" in out
    for name in ("one", "two"):
        away = places(tmp_path / f"o{suffix}", name)[:60] - places(made / source, name)[:60]
        assert np.abs(away).max() < 1e-5, "a hundredth of a millimetre"


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])  # a layer, and a package of one
def test_a_stage_that_is_kept_gets_nothing_twice(made, tmp_path, command, suffix):
    pytest.importorskip("pxr")
    two = load(made / "two.glb")
    save(tmp_path / "in.usda", replace(two.character, origin=None), [two.motion(clip) for clip in (0, 1)])
    assert command("convert", tmp_path / "in.usda", tmp_path / f"o{suffix}")[0] == 0
    assert clips(tmp_path / f"o{suffix}") == clips(tmp_path / "in.usda")
    assert command("convert", tmp_path / "in.usda", tmp_path / f"t{suffix}", "--clip", "two")[0] == 0
    assert [name for name, _ in clips(tmp_path / f"t{suffix}")] == ["two"]
    assert command("convert", tmp_path / "in.usda", tmp_path / ("e_{clip}" + suffix))[0] == 0
    assert [[name for name, _ in clips(tmp_path / f"e_{each}{suffix}")] for each in ("one", "two")] == [["one"], ["two"]]
    assert command("convert", tmp_path / "in.usda", tmp_path / f"f{suffix}", "--fps", "24")[0] == 0
    assert [clip.fps for clip in load(tmp_path / f"f{suffix}").clips] == [24, 24], "nothing else needs the old clock"


def test_an_avatar_that_is_kept_gets_nothing_twice(made, tmp_path, command):
    assert command("convert", made / "avatar.vrm", tmp_path / "o.vrm")[0] == 0
    assert clips(tmp_path / "o.vrm") == clips(made / "avatar.vrm")
    assert command("convert", made / "avatar.vrm", tmp_path / "t.vrm", "--clip", "two")[0] == 0
    assert [name for name, _ in clips(tmp_path / "t.vrm")] == ["two"]


@pytest.fixture
def real_blender(monkeypatch):
    """Blender, or an interpreter with bpy, where there is one."""
    python = os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    monkeypatch.setenv("RETARGET_BLENDER", python)


def test_all_clips_into_one_fbx_and_those_of_different_rates_with_a_common_one(real_blender, made, tmp_path, command):
    code, out, err = command("convert", made / "two.glb", tmp_path / "o.fbx")
    assert (code, err) == (0, "") and [name.split("|")[-1] for name, _ in clips(tmp_path / "o.fbx")] == ["one", "two"]
    code, out, err = command("convert", made / "rates.glb", tmp_path / "r.fbx")
    assert (code, out) == (2, "") and "received 24, 30; bring them to one (--fps), or choose one clip (--clip)" in err
    assert command("convert", made / "rates.glb", tmp_path / "r.fbx", "--fps", "30")[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.fbx", "r.fbx"]


@pytest.mark.parametrize(
    "words, said",
    [
        (("two.glb", "o.abc"), "holds 2 clips ('one', 'two'), and .abc holds one; choose one with --clip NAME, or write a file each"),
        (("walk.bvh", "o.abc"), "an Alembic file holds moving surfaces, and there is none to write"),
        (("two.glb", "o.vrm"), "came from no VRM"),
    ],
)  # fmt: skip
def test_what_a_format_does_not_hold_is_one_line(made, tmp_path, monkeypatch, command, words, said):
    monkeypatch.setenv("RETARGET_BLENDER", sys.executable)  # it comes to no call of it
    save(tmp_path / "walk.bvh", fingerless(body()), [fingerless(walk())])
    (tmp_path / "two.glb").write_bytes((made / "two.glb").read_bytes())
    monkeypatch.chdir(tmp_path)
    code, out, err = command("convert", *words)
    assert (code, out) == (2, "") and said in err and len(err.splitlines()) == 1
    assert not (tmp_path / words[1]).exists()


def test_without_blender_it_is_said_before_anything_is_read(tmp_path, monkeypatch, command):
    monkeypatch.setenv("RETARGET_BLENDER", "no-such-program")
    code, _, err = command("convert", tmp_path / "none.glb", tmp_path / "o.fbx")
    assert code == 2 and "RETARGET_BLENDER names no-such-program" in err
