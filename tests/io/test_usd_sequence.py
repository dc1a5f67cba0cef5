"""Mesh sequences in USD: time-sampled points, out and in again, in the units and axes that stages have."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor

from retarget.body.skinning import bake
from retarget.character import Mesh, MeshMotion
from retarget.commands import describe
from retarget.commands_convert import Conversion, convert_file
from retarget.errors import FileError
from retarget.io import load, save, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion

pytest.importorskip("pxr")

POINTS = "[(0,0,0), (1,0,0), (1,1,0), (0,1,%g)]"
SAMPLES = "point3f[] points.timeSamples = {" + ", ".join(f"{at}: {POINTS % lift}" for at, lift in ((1, 0), (2, 1), (3, 4))) + "}"
FACES = "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]\n"


def text(*meshes, head="metersPerUnit = 1"):
    bodies = "".join(f'def Mesh "M{number}" {{\n{each}\n}}\n' for number, each in enumerate(meshes))
    return f'#usda 1.0\n(\ntimeCodesPerSecond = 24\n{head}\n)\n{bodies}'


def written(tmp_path, *meshes, **options):
    (tmp_path / "a.usda").write_text(text(*meshes, **options))
    return load(tmp_path / "a.usda")


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
def test_what_is_written_comes_back(tmp_path, suffix):
    moving = bake(actor().character, cut(embedded_motion("wave"), 0.5, 0.9))
    for name in ("one", "two"):
        save_sequence(tmp_path / f"{name}.{suffix}", moving)
    asset = load(tmp_path / f"one.{suffix}")
    assert asset.kind == "mesh sequence" and asset.sequence.fps == moving.fps
    assert np.abs(asset.sequence.vertices - moving.vertices).max() < 1e-6
    assert np.array_equal(np.unique(asset.sequence.mesh.faces, axis=0), np.unique(moving.mesh.faces, axis=0))
    if suffix != "usdz":  # a package names its layer
        assert (tmp_path / f"one.{suffix}").read_bytes() == (tmp_path / f"two.{suffix}").read_bytes()


@pytest.mark.parametrize("name", ["wave", "my dance, 2nd take"])
def test_the_name_comes_back(tmp_path, name):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    save_sequence(tmp_path / "a.usda", MeshMotion(mesh, np.stack([mesh.vertices, 2 * mesh.vertices]), name=name))
    assert load(tmp_path / "a.usda").sequence.name == name


def test_the_default_prim_names_a_sequence_else_its_mesh(tmp_path):
    assert written(tmp_path, FACES + SAMPLES).sequence.name == "M0"
    assert written(tmp_path, FACES + SAMPLES, FACES + SAMPLES, head='defaultPrim = "M1"').sequence.name == "M1"


def test_units_and_axes_are_the_stage_s(tmp_path):
    moving = written(tmp_path, FACES + SAMPLES, head='metersPerUnit = 0.01\nupAxis = "Z"').sequence
    assert moving.fps == 24 and len(moving) == 3
    assert np.allclose(moving.vertices[:, 3], [[0, 0, -0.01], [0, 0.01, -0.01], [0, 0.04, -0.01]])


def test_animated_places_move_still_meshes_and_all_are_one(tmp_path):
    place = 'double3 xformOp:translate.timeSamples = {1: (0,0,0), 3: (0,0,2)}\nuniform token[] xformOpOrder = ["xformOp:translate"]\n'
    asset = written(tmp_path, FACES + SAMPLES, FACES + place + "point3f[] points = " + POINTS % 0)
    moving = asset.sequence
    assert moving.vertices.shape == (3, 8, 3) and any("2 meshes are joined" in note for note in asset.notes)
    assert np.allclose(moving.vertices[:, 3, 2], [0, 1, 4]) and np.allclose(moving.vertices[:, 4, 2], [0, 1, 2])
    assert len(moving.mesh.faces) == 4


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (FACES.replace("int[] faceVertexIndices =", "int[] faceVertexIndices.timeSamples = {1: [0, 1, 2, 3], 2:").replace("3]\n", "3, 2, 1, 0]}\n").replace("[0, 1, 2, 3, 2, 1, 0]", "[0, 3, 2, 1]") + SAMPLES, r"the faces of /M0 change at time code 2"),
        (FACES + f"point3f[] points.timeSamples = {{1: {POINTS % 0}, 2: [(0,0,0)]}}", r"/M0 has 1 points at time code 2 and 4 at first"),
        (FACES + f"point3f[] points.timeSamples = {{1: {POINTS % 0}, 2: [(0,0,0),(0,0,0),(0,0,0),(inf,0,0)]}}", r"not numbers at time code 2"),
        (FACES + f"point3f[] points.timeSamples = {{1: {POINTS % 0}, 30000001: {POINTS % 1}}}", r"more than is kept in memory"),
    ],
)  # fmt: skip
def test_what_is_no_one_mesh_is_told(tmp_path, mesh, said):
    with pytest.raises(FileError, match=said):
        written(tmp_path, mesh)


def test_what_cannot_be_written(tmp_path, monkeypatch):
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    moving = MeshMotion(mesh, np.zeros((2, 3, 3), np.float32))
    with pytest.raises(FileError, match="without faces"):
        save_sequence(tmp_path / "a.usdc", replace(moving, mesh=replace(mesh, faces=np.zeros((0, 3), np.int64))))
    monkeypatch.setattr("retarget.io.usd_sequence.LARGEST", 10)
    with pytest.raises(FileError, match="more than a USD file is given"):
        save_sequence(tmp_path / "a.usdc", moving)
    assert list(tmp_path.iterdir()) == []


def test_a_skinned_stage_is_baked_and_comes_back(tmp_path):
    save(tmp_path / "man.usdc", actor().character, [cut(embedded_motion("wave"), 0.5, 0.9)])
    convert_file(Conversion(tmp_path / "man.usdc", tmp_path / "man.npz"))
    convert_file(Conversion(tmp_path / "man.npz", tmp_path / "moving.usdz", unit=1.0, up="+y"))
    here, there = (load(tmp_path / name).sequence.vertices for name in ("man.npz", "moving.usdz"))
    assert np.abs(here - there).max() < 1e-6
    told = describe(tmp_path / "moving.usdz")
    assert told["clips"][0]["frames"] == len(here) and any("m on the first frame" in line for line in told["lines"])


def test_it_drives_nothing_and_says_what_can_be_done(tmp_path):
    with pytest.raises(FileError, match="mesh sequence, whose surface moves without joints.*`convert` writes it"):
        written(tmp_path, FACES + SAMPLES).motion()
