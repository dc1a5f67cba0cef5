"""Mesh sequences in Alembic, out and in again; what Blender is not needed for is tested without it."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor
from ogawa_maker import ACYCLIC, container, sampling

from retarget.body.skinning import bake
from retarget.character import Mesh, MeshMotion
from retarget.commands_convert import Conversion, convert_file
from retarget.errors import FileError, RetargetError
from retarget.evaluate.damage import damage
from retarget.io import alembic, blender, load, save, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@pytest.fixture
def real_blender(monkeypatch):
    """An interpreter with bpy, where there is one."""
    python = os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    monkeypatch.setenv(blender.VARIABLE, python)
    return python


@pytest.fixture
def scenes(real_blender, tmp_path):
    """The folder of small scenes that Blender wrote."""
    script = Path(__file__).with_name("blender_makes_abc.py")
    run = subprocess.run([real_blender, script, tmp_path], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return tmp_path


@pytest.fixture
def program(monkeypatch, tmp_path):
    """Makes a Python script stand in for Blender; it has the job as `job`."""

    def make(*lines):
        path = tmp_path / "made-program"
        path.write_text("\n".join([f"#!{sys.executable}", "import json, sys", "job = json.load(open(sys.argv[-1]))", *lines]))
        path.chmod(0o755)
        monkeypatch.setenv(blender.VARIABLE, str(path))

    return make


@pytest.fixture
def empty(tmp_path):
    """A container with seven frames and no meshes."""
    path = tmp_path / "in" / "empty.abc"
    path.parent.mkdir()
    path.write_bytes(container(sampling(7, 0.04, 0.0)))
    return path


def quad(frames=12, fps=25.0):
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    lift = np.linspace(0, 1, frames)[:, None, None] * np.array([0.0, 0.0, 1.0])
    return MeshMotion(mesh, mesh.vertices + lift * np.arange(4)[:, None], fps, "lift")


def test_what_is_written_comes_back_and_is_the_same_every_time(real_blender, tmp_path):
    moving = replace(bake(actor().character, cut(embedded_motion("wave"), 0.5, 0.9)), fps=24000 / 1001)
    for name in ("one.abc", "two.abc"):
        save_sequence(tmp_path / name, moving)
    asset = load(tmp_path / "one.abc")
    back = asset.sequence
    assert asset.kind == "mesh sequence" and (back.fps, back.name) == (moving.fps, moving.name)
    assert np.abs(back.vertices - moving.vertices).max() < 1e-6
    assert np.array_equal(back.mesh.faces, moving.mesh.faces)
    assert asset.convention.metres_per_unit == 1.0 and asset.convention.up == "+y"
    assert asset.notes == ("Alembic, written by Blender",)
    assert (tmp_path / "one.abc").read_bytes() == (tmp_path / "two.abc").read_bytes()
    assert b"_ai_DateWritten=Thu Jan  1 00:00:00 1970;" in (tmp_path / "one.abc").read_bytes()


def test_the_surface_of_a_character_is_a_sequence_too(real_blender, tmp_path):
    motion = cut(embedded_motion("wave"), 0.5, 0.8)
    for name in ("one.abc", "two.abc"):
        save(tmp_path / name, actor().character, [motion])
    assert (tmp_path / "one.abc").read_bytes() == (tmp_path / "two.abc").read_bytes()
    back, baked = load(tmp_path / "one.abc").sequence, bake(actor().character, motion)
    assert (back.fps, len(back)) == (baked.fps, len(baked))
    from scipy.spatial import cKDTree

    for frame in (0, 5, len(baked) - 1):  # glTF, which lies between, has copies at seams
        assert cKDTree(back.vertices[frame]).query(baked.vertices[frame])[0].max() < 1e-4


def test_through_usd_alembic_and_npz(real_blender, tmp_path):
    pytest.importorskip("pxr")
    moving = bake(actor().character, cut(embedded_motion("wave"), 0.5, 0.9))
    save_sequence(tmp_path / "a.usdc", moving)
    convert_file(Conversion(tmp_path / "a.usdc", tmp_path / "b.abc"))
    convert_file(Conversion(tmp_path / "b.abc", tmp_path / "c.npz"))
    back = load(tmp_path / "c.npz").sequence
    assert np.abs(back.vertices - moving.vertices).max() < 1e-6 and back.fps == moving.fps


def test_objects_and_their_parents_carry_meshes_and_others_are_left_out(scenes):
    asset = load(scenes / "moves.abc")
    moving = asset.sequence
    assert moving.vertices.shape == (7, 6, 3) and moving.fps == 24.0 and moving.name == "moves"
    assert sorted(map(sorted, moving.mesh.faces.tolist())) == [[0, 1, 2], [3, 4, 5]]
    assert np.allclose(moving.vertices[:, 0], np.linspace([0, 0, 0], [0, 3, 0], 7), atol=1e-5), "+z of Blender is up"
    assert np.allclose(moving.vertices[:, 3], np.linspace([0, 0, 0], [6, 0, 0], 7), atol=1e-5)
    for said in ("2 meshes are joined into one", "1 curve left out", "1 camera left out"):
        assert any(said in note for note in asset.notes), asset.notes


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("grows.abc", r"the faces of 'plate' change at 0.125 s: the frames of a mesh sequence are one mesh"),
        ("other.abc", r"the faces of 'plate' change at 0.125 s"),
        ("lines.abc", "holds no mesh with faces"),
    ],
)
def test_what_is_no_one_mesh_is_told(scenes, name, said):
    with pytest.raises(FileError, match=said):
        load(scenes / name)


def test_more_than_is_kept_is_refused_before_it_is_taken(scenes, monkeypatch):
    monkeypatch.setattr(alembic, "LARGEST", 12 * 6 * 7 - 1)
    with pytest.raises(FileError, match="holds 7 frames of 6 vertices, more than is kept"):
        load(scenes / "moves.abc")


def test_a_still_surface_is_a_mesh(real_blender, tmp_path):
    save_sequence(tmp_path / "still.abc", quad(1))
    asset = load(tmp_path / "still.abc")
    assert asset.kind == "mesh" and np.abs(asset.mesh.vertices - quad(1).vertices[0]).max() < 1e-7


def test_damaged_files_are_read_or_refused(real_blender, tmp_path):
    """A few: Blender starts anew for each."""
    save_sequence(tmp_path / "whole.abc", quad(4))
    content = (tmp_path / "whole.abc").read_bytes()
    for number in range(12):
        (tmp_path / "a.abc").write_bytes(damage(content, "few", number))
        try:
            load(tmp_path / "a.abc")
        except RetargetError as error:
            assert "\n" not in str(error)


MADE = [
    "import array",
    "array.array('f', [0, 0, 0, 1, 0, 0, 0, 1, 0] * job['frames']).tofile(open(job['points'], 'wb'))",
    "array.array('i', [0, 1, 2]).tofile(open(job['faces'], 'wb'))",
    "json.dump({'told': {'points': 3, 'meshes': 1, 'name': 'a', 'left_out': []}}, open(job['reply'], 'w'))",
]


def test_units_are_known_of_blender_s_files_only(program, empty, tmp_path):
    program(*MADE)
    asset = load(empty)
    assert asset.convention.metres_per_unit is None and any("tells no unit" in note for note in asset.notes)
    assert any("written by Maker" in note for note in asset.notes)
    with pytest.raises(FileError, match="does not tell its space.*give --unit"):
        convert_file(Conversion(empty, tmp_path / "a.glb"))
    convert_file(Conversion(empty, tmp_path / "a.npz", unit=0.01))
    assert np.abs(load(tmp_path / "a.npz").sequence.vertices).max() == pytest.approx(0.01)


def test_several_rates_are_told(program, empty):
    program(*MADE)
    empty.write_bytes(container(sampling(7, 0.04, 1.0), sampling(3, 0.02, 0.98)))
    asset = load(empty)
    assert (asset.sequence.fps, len(asset.sequence)) == (50.0, 14)
    assert any("sampled at 2 rates; 50 frames a second" in note for note in asset.notes)


@pytest.mark.parametrize(
    ("samplings", "said"),
    [
        ([sampling(900_000, 0.04, 1e5)], "plays 900000 frames from 100000 s on; frames are counted up to 1048574"),
        ([sampling(2, ACYCLIC, 0.0, 1e8)], "frames are counted up to"),
        ([sampling(2, 0.04, -5e4)], "plays 2 frames from -50000 s on"),
    ],
)
def test_frames_that_blender_cannot_count(program, empty, samplings, said):
    program(*MADE)
    empty.write_bytes(container(*samplings))
    with pytest.raises(FileError, match=said):
        load(empty)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["json.dump({'refused': 'holds no mesh'}, open(job['reply'], 'w'))"], "empty.abc: holds no mesh"),
        (["sys.exit('no such operator')"], r"Blender cannot read it \(no such operator \(exit code 1\)\)"),
        ([], "Blender ended without an error and without an answer"),
        (["open(job['reply'], 'w').write('{')"], "Blender ended without an error and without an answer"),
        (["import time", "time.sleep(20)"], "takes longer than 0.5 s to read it"),
    ],
)
def test_what_goes_wrong_in_blender_is_told(program, empty, monkeypatch, lines, said):
    program(*lines)
    monkeypatch.setattr(blender, "SECONDS", 0.5)
    with pytest.raises(FileError, match=said):
        load(empty)


def test_without_blender_one_line_says_what_to_do(monkeypatch, empty, tmp_path):
    monkeypatch.delenv(blender.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(blender.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FileError, match="empty.abc: is read by Blender: put blender on the PATH"):
        load(empty)
    with pytest.raises(FileError, match="is written by Blender: put blender on the PATH"):
        save_sequence(tmp_path / "out.abc", quad())


def test_a_file_that_is_too_large(monkeypatch, empty):
    monkeypatch.setattr(alembic, "LARGEST_FILE", 10)
    with pytest.raises(FileError, match="Alembic files of up to 10 are read"):
        load(empty)


@pytest.mark.parametrize(
    ("moving", "said"),
    [
        (replace(quad(), mesh=replace(quad().mesh, faces=np.zeros((0, 3), np.int64))), "without faces"),
        (replace(quad(), fps=1e6), "1e[+]06 frames a second cannot be written; 0.01 to 10000 can"),
        (quad(20), "20 frames of 4 vertices are more than"),
    ],
)
def test_what_cannot_be_written(program, monkeypatch, tmp_path, moving, said):
    program("sys.exit('started')")
    monkeypatch.setattr(alembic, "LARGEST", 12 * 4 * 19)
    with pytest.raises(FileError, match=said):
        save_sequence(tmp_path / "out.abc", moving)
    assert not (tmp_path / "out.abc").exists()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "without an error and without a file"),
        (["open(job['file'], 'w').write('nothing')"], "out.abc: Blender made a file that is no Alembic file"),
    ],
)
def test_a_file_that_blender_did_not_make(program, tmp_path, lines, said):
    program(*lines)
    with pytest.raises(FileError, match=said):
        save_sequence(tmp_path / "out.abc", quad())
    assert not (tmp_path / "out.abc").exists()


def test_what_the_writing_process_is_given(program, tmp_path):
    """Points cross as a PC2 cache in Blender's axes."""
    kept = tmp_path / "kept"
    program(
        "import shutil",
        f"shutil.copy(job['cache'], {str(kept)!r})",
        f"json.dump(job, open({str(kept) + '.json'!r}, 'w'))",
        f"open(job['file'], 'wb').write({container()!r})",
    )
    save_sequence(tmp_path / "out.abc", quad(3))
    content, job = kept.read_bytes(), json.loads((tmp_path / "kept.json").read_text())
    assert content[:12] == b"POINTCACHE2\0" and np.frombuffer(content, "<i4", 5, 12)[[0, 1, 4]].tolist() == [1, 4, 3]
    places = np.frombuffer(content, "<f4", offset=32).reshape(3, 4, 3)
    assert np.allclose(places[..., [0, 2, 1]] * [1, 1, -1], quad(3).vertices)
    assert (job["fps"], job["frames"], job["name"]) == (25.0, 3, "lift")
