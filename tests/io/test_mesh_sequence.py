"""Mesh sequences: folders of frames and glTF morph targets, out and in again."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor

from retarget.body.skinning import bake
from retarget.character import Mesh, MeshMotion
from retarget.errors import FileError, RetargetError
from retarget.io import gltf_morph, load, save_sequence
from retarget.io.mesh_folder import natural
from retarget.io.obj_ply import save as save_surface
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


def waving():
    return bake(actor().character, cut(embedded_motion("wave"), 0.5, 0.9))


def quad(frames=12):
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    lift = np.linspace(0, 1, frames)[:, None, None] * np.array([0.0, 0.0, 1.0])
    return MeshMotion(mesh, mesh.vertices + lift * np.arange(4)[:, None], 25.0, "lift")


@pytest.mark.parametrize("name", ["wave.glb", "wave.gltf", "wave.npz", "wave"])
def test_what_is_written_comes_back(tmp_path, name):
    moving = waving()
    save_sequence(tmp_path / name, moving)
    asset = load(tmp_path / name)
    back = asset.sequence
    assert asset.kind == "mesh sequence" and back.fps == 30.0
    assert back.vertices.shape == moving.vertices.shape
    assert np.array_equal(np.unique(back.mesh.faces, axis=0), np.unique(moving.mesh.faces, axis=0))  # glTF sorts by material
    assert np.abs(back.vertices - moving.vertices).max() < 1e-6
    assert np.abs(moving.vertices[0] - moving.vertices[6]).max() > 0.05, "it moves"


def test_a_baked_body_stands_where_its_skin_does():
    from retarget.body.kinematics import world_pose
    from retarget.body.skinning import prepare_skinning

    motion = cut(embedded_motion("wave"), 0.5, 0.9)
    posed = prepare_skinning(actor().character).vertices(*world_pose(motion))
    assert np.abs(waving().vertices - posed).max() < 1e-6


def test_a_body_without_a_surface_cannot_be_baked():
    bare = replace(actor().character, mesh=None, skin=None)
    with pytest.raises(RetargetError, match="has no skin"):
        bake(bare, embedded_motion("wave"))


def test_frames_come_in_natural_order(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    moving = quad()
    for number in range(len(moving)):
        save_surface(folder / f"lift_{number}.obj", replace(moving.mesh, vertices=moving.vertices[number]))
    (folder / "notes.txt").write_text("not a frame")
    back = load(folder).sequence
    assert np.allclose(back.vertices, moving.vertices, atol=1e-6)
    assert any("taken as frames at 30 a second" in note for note in load(folder).notes)


def test_natural_order():
    assert sorted(["f10", "f2", "F1", "g", "2"], key=natural) == ["2", "F1", "f2", "f10", "g"]


def test_one_frame_is_a_still_mesh_in_gltf(tmp_path):
    save_sequence(tmp_path / "still.glb", quad(1))
    assert load(tmp_path / "still.glb").kind == "mesh"


def test_materials_are_kept(tmp_path):
    from retarget.character import Material

    moving = quad()
    looks = replace(moving.mesh, materials=(Material("red"), Material("blue")), face_materials=np.array([0, 1]))
    save_sequence(tmp_path / "two.glb", replace(moving, mesh=looks))
    back = load(tmp_path / "two.glb").sequence
    assert [each.name for each in back.mesh.materials] == ["red", "blue"]
    assert np.abs(back.vertices[-1] - moving.vertices[-1]).max() < 1e-6


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "point sequence"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 2 4\n", "point sequence"),
        ("v 0 0 0\nv 1 0 0\n", "point sequence"),
        ("v 0 0 x\n", "mesh sequence"),
    ],
)
def test_one_set_of_faces_makes_a_mesh_sequence(tmp_path, content, kind):
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(7):
        save_surface(folder / f"{number}.obj", quad().mesh)
    (folder / "5.obj").write_text(content)
    assert load(folder).kind == kind


def test_frames_that_cannot_be_read_are_bridged(tmp_path):
    save_sequence(tmp_path / "frames", quad())
    (tmp_path / "frames" / "0000.ply").write_text("ply?")
    (tmp_path / "frames" / "0003.ply").write_bytes((tmp_path / "frames" / "0003.ply").read_bytes()[:-30])
    asset = load(tmp_path / "frames")
    assert asset.kind == "mesh sequence" and np.abs(asset.sequence.vertices[1:] - quad().vertices[1:]).max() < 1e-6
    assert np.array_equal(asset.sequence.vertices[0], asset.sequence.vertices[1])
    assert "2 of 12 files cannot be read and are bridged from those beside them (0000.ply: is not a PLY file" in asset.notes[1]
    for number in range(4, 9):
        (tmp_path / "frames" / f"{number:04d}.ply").write_text("")
    with pytest.raises(FileError, match=r"7 of its 12 files cannot be read as frames; of the first: .*0000.ply: is not a PLY file"):
        load(tmp_path / "frames")


def test_folders_that_hold_none(tmp_path, monkeypatch):
    with pytest.raises(FileError, match=r"the folder holds no frames"):
        load(tmp_path)
    save_surface(tmp_path / "0.obj", quad().mesh)
    monkeypatch.setattr("retarget.io.mesh_folder.LARGEST", 10)
    with pytest.raises(FileError, match="more than is kept in memory"):
        load(tmp_path)


def test_what_cannot_be_written(tmp_path):
    from retarget.io.gltf_morph import save_sequence as save_gltf
    from retarget.io.mesh_folder import save as save_folder

    with pytest.raises(FileError, match=r"written as .glb, .gltf, .npz or a folder, as USD or Alembic, not as '.obj'"):
        save_sequence(tmp_path / "a.obj", quad())
    with pytest.raises(FileError, match=r"frames are written as .obj or .ply"):
        save_folder(tmp_path / "a", quad(), ".stl")
    with pytest.raises(FileError, match="the suffix '.obj'"):
        save_gltf(tmp_path / "a.obj", quad())
    save_sequence(tmp_path / "a", quad())
    with pytest.raises(FileError, match="is there already"):
        save_sequence(tmp_path / "a", quad())
    with pytest.raises(FileError, match="does not exist"):
        save_sequence(tmp_path / "no" / "a", quad())
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a"]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("weights", "weights for 12 keys of 11 morph targets"), ("target", "a morph target has 3 vertices for 4"),
        ("years", "the sequence claims 1e\\+08 seconds, more than its data can fill"),
        ("large", "the sequence has 12 frames of 4 vertices; up to 100 bytes of them are read"),
    ],
)
def test_faulty_morphs_are_told(tmp_path, monkeypatch, fault, said):
    monkeypatch.setattr(gltf_morph, "LARGEST", 100 if fault == "large" else gltf_morph.LARGEST)
    save_sequence(tmp_path / "lift.gltf", quad())
    text = json.loads((tmp_path / "lift.gltf").read_text())
    if fault == "weights":
        text["accessors"][text["animations"][0]["samplers"][0]["output"]]["count"] -= 1
    elif fault == "years":
        view = text["bufferViews"][text["accessors"][text["animations"][0]["samplers"][0]["input"]]["bufferView"]]
        raw = bytearray((tmp_path / text["buffers"][0]["uri"]).read_bytes())
        struct.pack_into("<12f", raw, view["byteOffset"], *range(11), 1e8)
        (tmp_path / text["buffers"][0]["uri"]).write_bytes(raw)
    elif fault == "target":
        text["accessors"][text["meshes"][0]["primitives"][0]["targets"][2]["POSITION"]]["count"] = 3
    (tmp_path / "lift.gltf").write_text(json.dumps(text))
    with pytest.raises(FileError, match=said):
        load(tmp_path / "lift.gltf")


@pytest.mark.parametrize("wrong", [{"fps": 0.0}, {"fps": np.nan}, {"vertices": np.zeros((0, 4, 3))}, {"vertices": np.zeros((2, 5, 3))}])
def test_a_mesh_motion_checks_itself(wrong):
    with pytest.raises(RetargetError, match="MeshMotion"):
        replace(quad(), **wrong)


def test_step_and_spline_keys(tmp_path):
    """Keys held until the next, and splines read at their keys."""
    moving = quad(5)
    save_sequence(tmp_path / "lift.gltf", moving)
    text = json.loads((tmp_path / "lift.gltf").read_text())
    text["animations"][0]["samplers"][0]["interpolation"] = "STEP"
    (tmp_path / "lift.gltf").write_text(json.dumps(text))
    assert np.abs(load(tmp_path / "lift.gltf").sequence.vertices - moving.vertices).max() < 1e-6


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"vertices": np.zeros((3, 4))}, r"must have the shape \(frames, vertices, 3\), received \(3, 4\)"),
        ({"vertices": np.zeros((0, 4, 3))}, "must have the shape"),
        ({"faces": np.zeros((2, 4), np.int64)}, r"must have the shape \(faces, 3\)"),
        ({"faces": np.array([[0, 1, 4]])}, "names vertices from 0 to 4; there are 4"),
        ({"fps": np.array([30.0, 30.0])}, "must be one positive number"),
        ({"fps": np.array(0.0)}, "must be one positive number"),
        ({"vertices": np.full((2, 4, 3), np.nan)}, "finite"),
    ],
)
def test_faulty_archives_are_told(tmp_path, arrays, said):
    whole = {"vertices": np.zeros((2, 4, 3)), "faces": np.array([[0, 1, 2]]), "fps": np.array(30.0)}
    np.savez(tmp_path / "a.npz", **(whole | arrays))
    with pytest.raises(FileError, match=said):
        load(tmp_path / "a.npz")


def test_an_archive_without_a_rate_says_so_and_is_the_same_every_time(tmp_path):
    np.savez(tmp_path / "a.npz", vertices=np.zeros((2, 4, 3)), faces=np.array([[0, 1, 2]]))
    assert any("states no frame rate" in note for note in load(tmp_path / "a.npz").notes)
    for name in ("b.npz", "c.npz"):
        save_sequence(tmp_path / name, quad())
    assert (tmp_path / "b.npz").read_bytes() == (tmp_path / "c.npz").read_bytes()
