"""`retarget rig`, and `retarget run` onto a bare mesh."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent / "rig"))
from rig_bodies import case, quadruped  # noqa: E402

from retarget.character import Mesh  # noqa: E402
from retarget.commands_rig import parse_landmarks  # noqa: E402
from retarget.errors import RetargetError  # noqa: E402
from retarget.io import load, save  # noqa: E402
from retarget.rig import rigging  # noqa: E402
from retarget.rig.map_file import read_surface_map  # noqa: E402
from retarget.rig.rigging import rig  # noqa: E402
from retarget.rig.templates import human_template  # noqa: E402


def write_obj(path, mesh):
    lines = [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def statue(tmp_path_factory):
    return write_obj(tmp_path_factory.mktemp("statue") / "statue.obj", case(6).mesh)


@pytest.fixture(scope="module")
def rigged(statue):
    """The statue's rig, made once more, for what need not rig it again."""
    return rig(load(statue).mesh)


def test_a_statue_gets_a_rig_and_the_same_again(command, statue, rigged, tmp_path):
    code, out, err = command("rig", statue, "-o", tmp_path / "rigged.glb", "--json")
    told = json.loads(out)
    assert code == 0 and not err
    assert told["confidence"] > 0.8 and told["joints"][0] == "hips"
    written = load(tmp_path / "rigged.glb")
    assert written.kind == "character" and len(written.character.skeleton) == 52
    assert len(written.character.mesh.faces) == len(case(6).mesh.faces)
    save(tmp_path / "again.glb", replace(rigged.character, name="statue"), [])
    assert (tmp_path / "rigged.glb").read_bytes() == (tmp_path / "again.glb").read_bytes()


def test_a_statue_walks(command, statue, rigged, tmp_path, monkeypatch):
    def known(mesh, unit=None, tell=None):
        assert np.array_equal(mesh.vertices, load(statue).mesh.vertices) and unit is None
        return rigged

    monkeypatch.setattr(rigging, "rig", known)
    walk = tmp_path / "walk.glb"
    assert command("body", "-o", walk, "--preset", "thin", "--motion", "walk")[0] == 0
    few = "--end", "0.3", "--method", "copy-rotations"
    code, _, err = command("run", walk, statue, "-o", tmp_path / "statue_walk.glb", *few, "-v")
    assert code == 0 and "rigged with confidence" in err
    written = load(tmp_path / "statue_walk.glb")
    assert len(written.clips) == 1 and written.character.skin is not None


def test_a_map_from_a_file_is_followed(command, statue, tmp_path):
    places = case(6).places
    nearest = places.corners[np.arange(len(places.corners)), places.weights.argmax(axis=1)]
    (tmp_path / "map.txt").write_text("\n".join(map(str, nearest.tolist())))
    np.savez(tmp_path / "map.npz", corners=places.corners, weights=places.weights)
    code, out, err = command("rig", statue, "-o", tmp_path / "m.glb", "--surface-map", tmp_path / "map.txt")
    assert code == 0 and "given map" in out, err
    read = read_surface_map(tmp_path / "map.npz", len(human_template().file_vertices))
    assert np.array_equal(read.corners, places.corners) and np.array_equal(read.weights, places.weights)


@pytest.mark.parametrize(
    "name, content, reason",
    [
        ("map.txt", "3\nfour\n", "line 2: a vertex number is expected, found 'four'"),
        ("map.txt", "9999999\n", "names vertex 9999999 of the template, which has 6883"),
        ("map.txt", "1\n2\n", "the surface map is of 2 vertices"),
        ("map.png", "", "a surface map is .txt or .csv"),
    ],
)
def test_maps_that_are_none(command, statue, tmp_path, name, content, reason):
    (tmp_path / name).write_text(content)
    code, _, err = command("rig", statue, "-o", tmp_path / "m.glb", "--surface-map", tmp_path / name)
    assert code == 2 and reason in err and err.count("\n") == 1
    assert not (tmp_path / "m.glb").exists()


@pytest.mark.parametrize(
    "arrays, reason",
    [
        ({"other": np.zeros(3)}, "holds neither 'map', nor 'corners' and 'weights', nor 'C' with its bases"),
        ({"C": np.eye(20)}, "'C' means nothing without the eigenfunctions it is between; 'mesh_basis' is missing"),
        ({"map": np.zeros((3, 2), dtype=int)}, "'map' must be one number for each vertex"),
        ({"corners": np.zeros((3, 2), dtype=int), "weights": np.zeros((3, 2))}, "must be rows of three"),
        ({"corners": np.zeros((3, 3), dtype=int), "weights": np.zeros((3, 3))}, "each row must sum to one"),
    ],
)
def test_archives_that_are_no_maps(command, statue, tmp_path, arrays, reason):
    np.savez(tmp_path / "map.npz", **arrays)
    code, _, err = command("rig", statue, "-o", tmp_path / "m.glb", "--surface-map", tmp_path / "map.npz")
    assert code == 2 and reason in err


def test_what_is_no_body_is_one_line(command, tmp_path):
    dog = write_obj(tmp_path / "dog.obj", quadruped())
    code, out, err = command("rig", dog, "-o", tmp_path / "dog.glb")
    assert code == 2 and not out and err.count("\n") == 1
    assert "dog.obj: no body was found with certainty" in err and "--landmarks head=" in err
    assert re.search(r"\(confidence 0\.\d+; 0\.34 is needed\)", err)
    assert not (tmp_path / "dog.glb").exists()


def test_what_is_no_body_does_not_walk(command, tmp_path):
    draw = np.random.default_rng(5)
    soup = write_obj(tmp_path / "soup.obj", Mesh(draw.normal(size=(3000, 3)), draw.integers(0, 3000, (5000, 3))))
    walk = tmp_path / "walk.glb"
    command("body", "-o", walk, "--preset", "thin", "--motion", "walk")
    code, _, err = command("run", walk, soup, "-o", tmp_path / "soup.glb")
    assert code == 2 and "soup.obj" in err and "criss-cross" in err and not (tmp_path / "soup.glb").exists()


def test_outputs_without_a_surface_are_refused(command, statue, tmp_path):
    code, _, err = command("rig", statue, "-o", tmp_path / "x.bvh")
    assert code == 2 and "holds no surface" in err


def test_landmarks_are_read():
    found = parse_landmarks("head=12, mixamorig:Left_Hand=1:2.5:-3,a=b=7,812=3")
    assert found["head"] == 12 and found["a=b"] == 7 and found["812"] == 3
    assert found["mixamorig:Left_Hand"].tolist() == [1.0, 2.5, -3.0]


@pytest.mark.parametrize("text", ["head", "head=", "=3", "head=1:2", "head=a", "head=1:2:nan", "head=3,,"])
def test_landmarks_that_are_none(text):
    with pytest.raises(RetargetError, match="--landmarks takes NAME=VERTEX or NAME=X:Y:Z"):
        parse_landmarks(text)


def test_a_landmark_given_twice():
    with pytest.raises(RetargetError, match="'head' is given twice"):
        parse_landmarks("head=3,head=4")


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "inf"])
def test_units_that_are_no_length(command, statue, tmp_path, unit):
    code, _, err = command("rig", statue, "-o", tmp_path / "m.glb", "--unit", unit)
    assert code == 2 and "it must be a length above nought" in err and err.count("\n") == 1
    assert not (tmp_path / "m.glb").exists()
