"""`retarget rig --template` with templates that are no humans."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent / "rig"))
from made_quadrupeds import Build, end_vertices, posed, quadruped  # noqa: E402

from retarget.body.human import human  # noqa: E402
from retarget.body.skinning import rest_vertices  # noqa: E402
from retarget.character import Character  # noqa: E402
from retarget.commands_rig import in_house, template_of_file  # noqa: E402
from retarget.io import load, save  # noqa: E402
from retarget.io.asset import Convention  # noqa: E402

LONG = Build(leg=0.35, trunk=0.9, neck=0.2, head=0.25, tail=0.3)


@pytest.fixture(scope="module")
def dogs(tmp_path_factory):
    """A rigged dog, and a bare one in another pose with its landmarks."""
    folder = tmp_path_factory.mktemp("dogs")
    save(folder / "dog1.glb", quadruped(Build()).character, [])
    other = quadruped(LONG, 120, 2500)
    vertices, _ = posed(other, "walking")
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (other.character.mesh.faces + 1).tolist()]
    (folder / "dog2.obj").write_text("\n".join(lines) + "\n")
    words = ",".join(f"{name}={vertex}" for name, vertex in end_vertices(LONG, other).items())
    return folder / "dog1.glb", folder / "dog2.obj", words


def test_a_dog_gets_a_dogs_rig(command, dogs, tmp_path):
    template, mesh, words = dogs
    code, out, err = command("rig", mesh, "--template", template, "--landmarks", words, "-o", tmp_path / "dog2.glb", "--json")
    assert code == 0 and not err
    told = json.loads(out)
    assert told["confidence"] > 0.7 and told["metres_per_unit"] == 1.0
    written = load(tmp_path / "dog2.glb").character
    assert written.skeleton.names == load(template).character.skeleton.names
    legs = [written.skeleton.index(f"{leg}Lower") for leg in ("FrontLeft", "FrontRight", "HindLeft", "HindRight")]
    assert np.linalg.norm(written.skeleton.offsets[legs], axis=1).mean() == pytest.approx(0.16, abs=0.04)  # as long as dog 2's


def test_without_landmarks_they_are_asked_for_in_one_line(command, dogs, tmp_path):
    template, mesh, _ = dogs
    code, out, err = command("rig", mesh, "--template", template, "-o", tmp_path / "dog2.glb")
    assert code == 2 and not out and err.count("\n") == 1
    assert "dog2.obj: a template that is no human is laid in by 4 landmarks or more" in err and "Head_end" in err
    assert not (tmp_path / "dog2.glb").exists()


def test_why_a_template_is_no_human_is_told(command, dogs, tmp_path):
    template, mesh, _ = dogs
    _, _, err = command("rig", mesh, "--template", template, "-o", tmp_path / "dog2.glb", "-v")
    assert "dog1.glb is taken as of its own structure: " in err


def test_bones_alone_are_no_template(command, dogs, tmp_path):
    _, mesh, words = dogs
    save(tmp_path / "bones.glb", Character(quadruped(Build()).character.skeleton), [])
    code, _, err = command("rig", mesh, "--template", tmp_path / "bones.glb", "--landmarks", words, "-o", tmp_path / "x.glb")
    assert code == 2 and err.count("\n") == 1 and "bones.glb: " in err and "has no surface" in err


def test_the_files_unit_and_axes_are_followed(dogs):
    asset = load(dogs[0])
    said = replace(asset, convention=Convention(0.01, "+z"))
    here, there = rest_vertices(asset.character), rest_vertices(in_house(said))
    assert np.allclose(there, 0.01 * here[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    assert template_of_file(dogs[0]).height == pytest.approx(float(np.ptp(here[:, 1])))


def test_one_that_lies_on_all_fours_is_no_human(monkeypatch, tmp_path):
    from retarget import commands_rig

    save(tmp_path / "human.glb", human(), [])
    assert template_of_file(tmp_path / "human.glb").human
    monkeypatch.setattr(commands_rig, "stands_like_a_human", lambda skeleton, humanoid: False)
    assert not template_of_file(tmp_path / "human.glb").human
