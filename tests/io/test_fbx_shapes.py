"""Blend shapes of FBX files: as morph targets, with their weights, into written files and as moving meshes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fbx_maker import SECOND, Picture, Shapes, document, strip
from gltf_maker import PNG

from retarget.body.skinning import rest_vertices
from retarget.errors import FileError
from retarget.io import load, save, save_sequence
from retarget.io.fbx_shapes import shares

HERE = Path(__file__).parent


def read(path, **settings):
    path.write_text(document(**settings))
    return load(path)


def animated(document):
    """Weights (frames, targets) of the last animation that has any."""
    for animation in reversed(document.json["animations"]):
        for channel in animation["channels"]:
            if channel["target"]["path"] == "weights":
                rows = document.floats(animation["samplers"][channel["sampler"]]["output"], ("SCALAR",))
                mesh = document.json["nodes"][channel["target"]["node"]]["mesh"]
                return rows.reshape(-1, len(document.json["meshes"][mesh]["weights"]))
    return None


def test_weights_are_dealt_out_between_neighbours():
    weights = np.array([-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5])
    assert shares(weights, np.array([1.0]))[:, 0].tolist() == weights.tolist()
    two = shares(weights, np.array([0.5, 1.0]))
    assert two.tolist() == [[-1, 0], [0, 0], [0.5, 0], [1, 0], [0.5, 0.5], [0, 1], [-1, 2]]
    assert shares(weights, np.array([-1.0, 1.0])).tolist() == [[0.5, 0], [0, 0], [0, 0.25], [0, 0.5], [0, 0.75], [0, 1], [0, 1.5]]


def test_a_character_keeps_its_shapes_and_their_weights_in_a_written_file(tmp_path):
    asset = read(tmp_path / "strip.fbx", unit=100.0, shapes=Shapes((50.0, 100.0), rest=25.0, end=100.0), picture=Picture(PNG))
    save(tmp_path / "out.glb", asset.character, [asset.motion()])
    for held in (asset, load(tmp_path / "out.glb")):
        told = held.character.origin.document
        mesh = told.json["meshes"][0]
        assert mesh["weights"] == [0.5, 0.0] and mesh["extras"]["targetNames"] == ["Bulge0", "Bulge1"]
        per_cent = np.linspace(25, 100, 31)
        wanted = np.stack([np.minimum(per_cent, 100 - per_cent) / 50, np.maximum(per_cent - 50, 0) / 50], axis=1)
        assert animated(told) == pytest.approx(wanted, abs=1e-5)
        for number, target in enumerate(mesh["primitives"][0]["targets"]):
            moves = told.floats(target["POSITION"], ("VEC3",))
            assert len(moves) == 16 and np.flatnonzero(moves.any(axis=1)).tolist() == [8, 9]
            assert moves[8:10].tolist() == [[0, 0, number + 1.0]] * 2
            assert told.json["accessors"][target["POSITION"]]["sparse"]["count"] == 2, "vertices that rest take no room"
    assert any("its morph targets are animated" in note for note in asset.notes)


def test_the_surface_shows_shapes_as_they_rest(tmp_path):
    character = read(tmp_path / "strip.fbx", unit=100.0, shapes=Shapes(rest=40.0)).character
    wanted = strip()[0]
    wanted[8:, 2] = 0.4
    assert rest_vertices(character) == pytest.approx(wanted, abs=1e-6)
    assert animated(character.origin.document) is None, "still weights are no animation"


def test_shapes_on_seams_move_all_copies(tmp_path):
    settings = {"unit": 100.0, "shapes": Shapes(rest=100.0, vertices=(2, 3, 4)), "picture": Picture(PNG)}
    mesh = read(tmp_path / "strip.fbx", **settings).character.mesh
    places = strip()[0]
    of = np.array([int(np.argmin(np.linalg.norm(places[:, :2] - place[:2], axis=1))) for place in mesh.vertices])
    assert mesh.vertices[:, 2] == pytest.approx(np.isin(of, [2, 3, 4]).astype(float)) and len(of) == 16


@pytest.mark.parametrize("picture", [None, Picture(PNG)])
def test_a_mesh_that_only_shapes_move_is_a_sequence(tmp_path, picture):
    """In centimetres: shapes are brought to metres like the mesh."""
    asset = read(tmp_path / "strip.fbx", shapes=Shapes(end=100.0), bones=False, picture=picture)
    moving = asset.sequence
    assert asset.kind == "mesh sequence" and len(moving) == 31 and moving.fps == 30.0
    wanted = np.tile(strip()[0], (31, 1, 1))
    wanted[:, 8:, 2] = np.linspace(0, 1, 31)[:, None]
    assert moving.vertices[:, :10] == pytest.approx(wanted / 100, abs=1e-7)
    save_sequence(tmp_path / "out.glb", moving)
    assert load(tmp_path / "out.glb").sequence.vertices == pytest.approx(moving.vertices, abs=1e-6)


def test_shapes_that_move_nothing_are_none(tmp_path):
    for shapes in (Shapes(full=(0.0,), rest=50.0), Shapes(vertices=(77, 78), rest=50.0)):
        character = read(tmp_path / "strip.fbx", unit=100.0, shapes=shapes).character
        assert rest_vertices(character) == pytest.approx(strip()[0], abs=1e-6)
        assert "targets" not in character.origin.document.json["meshes"][0]["primitives"][0]


def test_takes_longer_than_anyone_made_are_refused(tmp_path):
    text = document(shapes=Shapes(end=100.0)).replace(f'"",{SECOND}\n', f'"",{SECOND * 10**7}\n')
    (tmp_path / "strip.fbx").write_text(text)
    with pytest.raises(FileError, match=r"strip.fbx: its takes have \d+ transforms, more than 40000000"):
        load(tmp_path / "strip.fbx")


@pytest.fixture(scope="module")
def blender():
    python = os.environ.get("RETARGET_BPY_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import importlib.util as u; exit(u.find_spec('bpy') is None)"]).returncode:
        pytest.skip("bpy is not installed (RETARGET_BPY_PYTHON may name an interpreter that has it)")
    return python


@pytest.mark.parametrize("how", [[], ["embed"], ["bone"], ["bone", "embed"]], ids=lambda how: "-".join(how) or "plain")
def test_files_by_blender_show_what_blender_shows(blender, tmp_path, how):
    (tmp_path / "paint.png").write_bytes(PNG)
    out, there = tmp_path / "box.fbx", tmp_path / "seen.npz"
    subprocess.run([blender, HERE / "blender_makes_fbx.py", tmp_path / "paint.png", out, there, *how], check=True, capture_output=True)
    if "embed" in how:
        (tmp_path / "paint.png").unlink()
    asset = load(out)
    with np.load(there) as file:
        seen = {name: file[name] for name in file.files}
    if how and how[0] == "bone":
        assert animated(asset.character.origin.document) == pytest.approx(seen["weights"], abs=1e-6)
        mesh, places = asset.character.mesh, seen["vertices"][:1]
    else:
        assert np.abs(asset.sequence.vertices[:, :8] - seen["vertices"]).max() < 1e-6, "metres"
        mesh, places = asset.sequence.mesh, seen["vertices"]
    assert mesh.materials[0].image == PNG and len(mesh.vertices) == 14
    theirs = {(vertex, *np.round(uv, 4)) for vertex, uv in zip(seen["corners"].tolist(), (seen["uvs"] * [1, -1] + [0, 1]).tolist())}
    of = [int(np.argmin(np.linalg.norm(places[0] - place, axis=1))) for place in mesh.vertices]
    assert {(vertex, *np.round(uv, 4)) for vertex, uv in zip(of, mesh.uvs.tolist())} == theirs
