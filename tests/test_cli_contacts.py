"""The command `contacts`: what it lists, what it writes, and one line for every mistake."""

import json
import sys

import pytest

from retarget import cli
from retarget.contact.contact_file import read_contacts
from retarget.io import save


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    from dataclasses import replace

    from retarget.motion.filter import cut
    from retarget.motion.library import embedded_motion, performer

    folder = tmp_path_factory.mktemp("contacts")
    clip = cut(embedded_motion("hands_on_hips"), 1.5, 2.0)
    save(folder / "hips.glb", performer(), [replace(clip, name="hips")])
    save(folder / "two.glb", performer(), [replace(clip, name="hips"), replace(clip, name="again")])
    save(folder / "hips.bvh", performer(), [clip])
    return folder


@pytest.fixture
def command(monkeypatch, capfd):
    def run(*words):
        monkeypatch.setattr(sys, "argv", ["retarget", *map(str, words)])
        code = 0
        try:
            cli.main()
        except SystemExit as leaving:
            code = leaving.code or 0
        out, err = capfd.readouterr()
        return code, out, err

    return run


def test_contacts_are_listed_and_written(files, tmp_path, command):
    code, out, err = command("contacts", files / "hips.glb", "-o", tmp_path / "c.toml")
    assert (code, err) == (0, "") and "leftHand - pelvis" in out and "pose" in out
    pairs = [edit.parts for edit in read_contacts(tmp_path / "c.toml").edits]
    assert ("leftHand", "pelvis") in pairs and ("rightHand", "pelvis") in pairs
    assert out.splitlines()[-1] == f"{tmp_path / 'c.toml'}: {len(pairs)} contacts"


def test_json_and_a_part_of_the_clip(files, command):
    code, out, _ = command("contacts", files / "hips.glb", "--start", 0.1, "--end", 0.3, "--json")
    report = json.loads(out)
    assert code == 0 and report["output"] is None and report["fps"] <= 30
    assert {"parts": ["leftHand", "pelvis"], "start": 0.0}.items() <= next(
        each for each in report["contacts"] if each["parts"] == ["leftHand", "pelvis"]
    ).items()
    assert max(each["end"] for each in report["contacts"]) == pytest.approx(0.2, abs=0.02)


def test_a_bare_skeleton_gets_a_body_that_stands_in_for_it(files, tmp_path, command):
    code, out, err = command("contacts", files / "hips.bvh", "-o", tmp_path / "c.toml")
    assert (code, err) == (0, "") and out.startswith("note: the source has no surface: an embedded human of ")
    pairs = [edit.parts for edit in read_contacts(tmp_path / "c.toml").edits]
    assert ("leftHand", "pelvis") in pairs and ("rightHand", "pelvis") in pairs


def test_a_clip_taken_among_several_is_told(files, command):
    code, _, err = command("contacts", files / "two.glb")
    assert code == 0 and "holds 2 clips; taking the first, 'hips'" in err
    code, out, err = command("contacts", files / "two.glb", "--clip", "again", "--json")
    assert (code, err) == (0, "") and json.loads(out)["clip"] == "again"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["hips.glb", "--clip", "hip"], "nearest: 'hips'"),
        (["none.glb"], "none.glb"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(files, tmp_path, command, words, problem):
    code, out, err = command("contacts", files / words[0], *words[1:], "-o", tmp_path / "c.toml")
    assert (code, out) == (2, "") and problem in err and len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_missing_is_told_at_once(files, tmp_path, command):
    code, _, err = command("contacts", files / "hips.glb", "-o", tmp_path / "none" / "c.toml")
    assert code == 2 and "does not exist" in err


def test_the_source_is_not_overwritten(files, command):
    before = (files / "hips.glb").read_bytes()
    code, _, err = command("contacts", files / "hips.glb", "-o", files / "hips.glb")
    assert code == 2 and "replace the source" in err and (files / "hips.glb").read_bytes() == before
