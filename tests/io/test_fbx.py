"""FBX: what small files say is read as it stands, and nothing that a file does reaches this process."""

import subprocess
import sys

import numpy as np
import pytest
from fbx_maker import document, strip

from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.errors import FileError
from retarget.io import fbx, load, save
from retarget.io.fbx_surface import heaviest


@pytest.fixture
def written(tmp_path):
    def write(name="strip.fbx", **settings):
        path = tmp_path / name
        path.write_text(document(**settings))
        return path

    return write


def test_skeleton_surface_skin_and_colour(written):
    asset = load(written(unit=100.0))
    character = asset.character
    assert asset.kind == "character" and set(character.skeleton.names) >= {"Lower", "Upper"}
    vertices, quads, upper = strip()
    assert rest_vertices(character) == pytest.approx(vertices, abs=1e-6)
    assert len(character.mesh.faces) == 2 * len(quads)
    assert set(character.mesh.faces[0]) < set(quads[0]), "triangles of a quad keep its corners"
    joint = character.skeleton.index("Upper")
    share = (character.skin.weights * (character.skin.joints[character.skin.columns] == joint)).sum(axis=1)
    assert share == pytest.approx(upper, abs=1e-6)
    assert character.mesh.materials[0].name == "Skin"
    assert character.mesh.materials[0].base_color[:3] == pytest.approx((0.2, 0.4, 0.6), abs=1e-3)


@pytest.mark.parametrize(("unit", "metres"), [(1.0, 0.01), (100.0, 1.0), (2.54, 0.0254)])
def test_units_are_the_files_own(written, unit, metres):
    _, places = rest_pose(load(written(unit=unit)).character.skeleton)
    assert np.ptp(places[:, 1]) == pytest.approx(metres, rel=1e-5)


def test_a_file_with_z_up_stands_up(written):
    """The strip stands along the file's y, which is depth where z is up: it lies on its back in our space."""
    character = load(written(unit=100.0, up="z")).character
    extent = np.ptp(rest_vertices(character), axis=0)
    assert extent[[0, 2]] == pytest.approx([1.0, 2.0], abs=1e-5) and extent[1] < 1e-5


@pytest.mark.parametrize("ranged", [True, False])
def test_takes_by_name_bend_as_their_curves_say(written, ranged):
    asset = load(written(unit=100.0, takes=(("slow", 30.0), ("fast", 90.0), ("none", 0.0)), ranged=ranged))
    assert [(clip.name, clip.frames, clip.fps) for clip in asset.clips] == [("slow", 31, 30.0), ("fast", 31, 30.0)]
    for name, degrees in (("slow", 30.0), ("fast", 90.0)):
        motion = asset.motion(name)
        tips = prepare_skinning(asset.character).vertices(*world_pose(motion))[:, -1]
        angle = np.radians(np.linspace(0, degrees, 31))
        assert tips[:, 1] == pytest.approx(1 + np.cos(angle), abs=1e-5)
        assert tips[:, 2] == pytest.approx(np.sin(angle), abs=1e-5)


def test_a_pre_rotation_turns_the_axis_that_the_curve_turns_about(written):
    asset = load(written(unit=100.0, takes=(("bend", 90.0),), pre_rotation=(0, 90, 0)))
    tips = prepare_skinning(asset.character).vertices(*world_pose(asset.motion("bend")))[:, -1]
    assert tips[0] == pytest.approx([0.5, 2, 0], abs=1e-5)  # the last vertex stands half a unit beside the bone
    assert tips[-1] == pytest.approx([1, 0.5, 0], abs=1e-5), "x of the bone points along -z of the world"


def test_the_result_is_written_as_glb_with_all_that_was_read(written, tmp_path):
    asset = load(written(unit=100.0))
    save(tmp_path / "out.glb", asset.character, [asset.motion()])
    again = load(tmp_path / "out.glb")
    assert rest_vertices(again.character) == pytest.approx(rest_vertices(asset.character), abs=1e-6)
    _, places = world_pose(again.motion())
    assert places == pytest.approx(world_pose(asset.motion())[1], abs=1e-6)
    assert again.character.mesh.materials[0].name == "Skin"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "cannot be read as FBX .*Empty file"),
        (b"Kaydara FBX Binary  \x00\x1a\x00" + b"\xff" * 500, "cannot be read as FBX .*version"),
        (b"\x00" * 1000, "cannot be read as FBX"),
        (b"; FBX 7.4.0 project file\nObjects: {\n}\n", "holds neither a skeleton nor a mesh"),
    ],
)
def test_what_is_no_fbx_is_one_line(tmp_path, content, problem):
    (tmp_path / "bad.fbx").write_bytes(content)
    with pytest.raises(FileError, match=problem) as caught:
        load(tmp_path / "bad.fbx")
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(tmp_path / "bad.fbx"))


def test_cut_off_files_are_refused_or_read_but_never_crash(written, tmp_path):
    text = written().read_text()
    for share in (0.2, 0.5, 0.8, 0.95):
        (tmp_path / "cut.fbx").write_text(text[: int(share * len(text))])
        try:
            load(tmp_path / "cut.fbx")
        except FileError:
            pass


def test_a_reader_that_crashes_or_hangs_is_one_line(written, monkeypatch, own_child):
    path = written()
    own_child("fbx_child", "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    with pytest.raises(FileError, match=r"cannot be read as FBX \(the process stopped without a word \(SIGSEGV\)\)"):
        load(path)
    monkeypatch.setattr(fbx, "SECONDS", 0.5)
    own_child("fbx_child", "import time\ntime.sleep(60)\n")
    with pytest.raises(FileError, match="takes longer than 0.5 s"):
        load(path)


def test_too_large_files_are_refused_before_anything_is_read(written, monkeypatch):
    monkeypatch.setattr(fbx, "LARGEST", 100)
    with pytest.raises(FileError, match="FBX files of up to 100 are read"):
        load(written())


def test_this_process_never_loads_ufbx(written):
    code = f"import sys; from retarget import load; load({str(written())!r}); assert 'ufbx' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_heaviest_influences_come_first_and_sum_to_one():
    spans = np.array([[0, 2], [2, 0], [2, 10]])
    rows = np.array([[3, 0.25], [1, 0.75], *([n, n + 1.0] for n in range(10))])
    joints, weights = heaviest(spans, rows, 3)
    assert joints.shape == (3, 8) and joints[0, :2].tolist() == [1, 3] and weights[0, :2].tolist() == [0.75, 0.25]
    assert weights[1].sum() == 0 and joints[2].tolist() == [9, 8, 7, 6, 5, 4, 3, 2]
    assert weights[2] == pytest.approx(np.arange(10, 2, -1) / np.arange(3, 11).sum())


def test_without_ufbx_the_cure_is_told(written, own_child):
    path = written()
    own_child("fbx_child", "raise ImportError(\"No module named 'ufbx'\")")
    with pytest.raises(FileError, match="needs the package ufbx to be read: pip install ufbx"):
        load(path)
