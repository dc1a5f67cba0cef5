"""FBX and Alembic through Blender: what is written is what was there; without Blender, or where it fails, one clear line."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.casting import cast
from retarget.errors import FileError
from retarget.io import blender, load, save
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


def wave():
    return cut(embedded_motion("wave"), 0.5, 1.0)


@pytest.fixture
def real_blender(monkeypatch):
    """Blender, or an interpreter with bpy, where there is one."""
    python = os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    monkeypatch.setenv(blender.VARIABLE, python)


@pytest.fixture
def program(monkeypatch, tmp_path):
    """Makes a program of some lines stand in for Blender."""

    def make(*lines):
        path = tmp_path / "made-blender"
        path.write_text("\n".join(["#!/bin/sh", *lines]))
        path.chmod(0o755)
        monkeypatch.setenv(blender.VARIABLE, str(path))

    return make


def posed(path, clip=0):
    """Names, world rotations, joint places and skin of a file's clip, in metres with +Y up."""
    asset = load(path)
    motion = asset.motion(clip)
    body = cast(asset, motion=motion)
    rotations, places = world_pose(body.house_from_file.motion(motion))
    skin = prepare_skinning(body.character).vertices(rotations, places)
    return list(body.skeleton.names), rotations, places, skin, motion


@pytest.mark.parametrize("root", ["", "root"])
def test_fbx_comes_back_as_it_was(real_blender, tmp_path, root):
    body, motion = actor("heavy").character, wave()
    save(tmp_path / "here.glb", body, [motion])
    save(tmp_path / "there.fbx", body, [motion], root=root)
    names, rotations, places, skin, read = posed(tmp_path / "here.glb")
    others, other_rotations, other_places, other_skin, back = posed(tmp_path / "there.fbx")
    assert set(others) - set(names) == ({root} if root else set())
    chosen = [others.index(name) for name in names]
    assert len(back) == len(read) and back.fps == read.fps
    assert np.abs(other_places[:, chosen] - places).max() < 1e-4
    assert np.degrees(rot.angle_between(other_rotations[:, chosen], rotations)).max() < 0.01
    for frame in (0, len(read) - 1):
        from scipy.spatial import cKDTree

        assert cKDTree(other_skin[frame]).query(skin[frame])[0].max() < 1e-4


def test_fbx_is_in_centimetres_and_holds_only_what_was_asked_for(real_blender, tmp_path):
    body, motion = actor().character, wave()
    save(tmp_path / "own.glb", body, [replace(motion, name="old")])
    kept = load(tmp_path / "own.glb")
    own = kept.motion("old")
    save(tmp_path / "all.fbx", kept.character, [own, replace(own, name="old friend")])
    asset = load(tmp_path / "all.fbx")
    assert [clip.name.split("|")[-1] for clip in asset.clips] == ["old", "old friend"]
    assert any("0.01 m a unit" in note for note in asset.notes)


def test_the_same_fbx_every_time(real_blender, tmp_path):
    for name in ("a.fbx", "b.fbx"):
        save(tmp_path / name, actor().character, [wave()])
    assert (tmp_path / "a.fbx").read_bytes() == (tmp_path / "b.fbx").read_bytes()


def test_alembic_holds_the_moving_surface(real_blender, tmp_path):
    body, motion = actor().character, wave()
    save(tmp_path / "wave.abc", body, [motion])
    told = subprocess.run(
        [os.environ[blender.VARIABLE], str(Path(__file__).with_name("blender_reads_abc.py")), str(tmp_path / "wave.abc"), "7", str(tmp_path / "there.npy")],
        capture_output=True, text=True,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    rotations, places = world_pose(motion)
    skin = prepare_skinning(body).vertices(rotations[7:8], places[7:8])[0]
    from scipy.spatial import cKDTree

    assert cKDTree(np.load(tmp_path / "there.npy")).query(skin)[0].max() < 1e-4


def test_without_blender_one_line_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.delenv(blender.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(blender.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FileError, match="is written by Blender: put blender on the PATH"):
        save(tmp_path / "out.fbx", actor().character, [wave()])
    monkeypatch.setenv(blender.VARIABLE, str(tmp_path / "nothing"))
    with pytest.raises(FileError, match="which is no program"):
        save(tmp_path / "out.fbx", actor().character, [wave()])


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["echo 'a warning' >&2", "echo 'ValueError: no armature' >&2", "exit 3"], r"cannot write it \(ValueError: no armature \(exit code 3\)\)"),
        (["exit 7"], r"cannot write it \(the process stopped without a word \(exit code 7\)\)"),
        (["exit 0"], "without an error and without a file"),
        (["exec sleep 20"], "takes longer than 0.5 s"),
    ],
)  # fmt: skip
def test_what_goes_wrong_in_blender_is_told_and_leaves_nothing(program, monkeypatch, tmp_path, lines, said):
    program(*lines)
    monkeypatch.setattr(blender, "SECONDS", 0.5)
    folder = tmp_path / "out"
    folder.mkdir()
    with pytest.raises(FileError, match=said):
        save(folder / "out.fbx", actor().character, [wave()])
    assert list(folder.iterdir()) == []


def test_a_program_that_is_none(monkeypatch, program, tmp_path):
    program("")
    broken = tmp_path / "made-blender"
    broken.write_bytes(b"\x7fELF not really")
    with pytest.raises(FileError, match="cannot be started|cannot write it"):
        save(tmp_path / "out.fbx", actor().character, [wave()])


def test_alembic_holds_one_clip_and_all_clips_one_rate(program, tmp_path):
    program("exit 0")
    with pytest.raises(FileError, match="an Alembic file holds one clip, received 2"):
        save(tmp_path / "out.abc", actor().character, [wave(), wave()])
    with pytest.raises(FileError, match="one frame rate here, received 30, 60"):
        save(tmp_path / "out.fbx", actor().character, [wave(), replace(wave(), fps=60.0)])
