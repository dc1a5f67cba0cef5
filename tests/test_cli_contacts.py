"""The command `contacts`: what it lists, what it writes, and one line for every mistake."""

import json

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.contact.contact_file import read_contacts
from retarget.evaluate.touch import judged_body
from retarget.io import load, save


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    from dataclasses import replace

    from retarget.body.human import PRESETS, human
    from retarget.casting import cast
    from retarget.motion.filter import cut
    from retarget.motion.library import embedded_motion, performer
    from retarget.retargeting import prepare

    folder = tmp_path_factory.mktemp("contacts")
    clip = cut(embedded_motion("hands_on_hips"), 1.5, 2.0)
    save(folder / "hips.glb", performer(), [replace(clip, name="hips")])
    save(folder / "two.glb", performer(), [replace(clip, name="hips"), replace(clip, name="again")])
    save(folder / "hips.bvh", performer(), [clip])
    heavy = human(name="heavy", **PRESETS["heavy"])
    save(folder / "heavy.glb", heavy, [])
    copied = prepare(cast(performer()), cast(heavy), "copy-rotations")(clip).motion
    save(folder / "sunk.glb", heavy, [replace(copied, name="sunk"), replace(copied, name="again")])
    return folder


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


# --- what the file does --------------------------------------------------------------------------------------------


def hand_places(path):
    motion = load(path).motion()
    return world_pose(motion)[1][:, motion.skeleton.index("leftHand")]


def test_an_edited_file_changes_what_it_says_and_what_it_does_not_reach_is_told(files, tmp_path, command):
    listed = tmp_path / "c.toml"
    assert command("contacts", files / "hips.glb", "-o", listed)[0] == 0
    run = ("run", files / "hips.glb", files / "heavy.glb", "--contacts", listed, "-o")
    assert command(*run, tmp_path / "as_listed.glb")[::2] == (0, "")
    assert command("run", files / "hips.glb", files / "heavy.glb", "-o", tmp_path / "plain.glb")[0] == 0
    assert np.abs(hand_places(tmp_path / "plain.glb") - hand_places(tmp_path / "as_listed.glb")).max() < 1e-6
    entries = ("left" + entry for entry in listed.read_text().split("left"))
    text = "".join(entries).removeprefix("left").replace('does = "auto"', 'does = "release"')
    late = '[[contact]]\nparts = ["leftHand", "head"]\nstart = 100.0\ndoes = "add"\n'
    listed.write_text(text + late)
    code, out, err = command(*run, tmp_path / "released.glb")
    assert code == 0 and "nothing in this clip for the contacts file's add leftHand-head from 100 s to the end" in err
    apart = np.linalg.norm(hand_places(tmp_path / "released.glb") - hand_places(tmp_path / "plain.glb"), axis=1)
    assert apart.max() > 0.01, "hands that need not touch lie elsewhere"


def test_a_wrong_entry_stops_before_anything_is_written(files, tmp_path, command):
    (tmp_path / "c.toml").write_text('[[contact]]\nparts = ["leftHnd", "head"]\n')
    code, out, err = command(
        "run", files / "hips.glb", files / "heavy.glb", "--contacts", tmp_path / "c.toml", "-o", tmp_path / "o.glb"
    )
    assert (code, out) == (2, "") and "[[contact]] 1: part 'leftHnd'" in err and len(err.splitlines()) == 1
    assert not (tmp_path / "o.glb").exists()


def test_the_report_lists_what_was_corrected(files, tmp_path, command):
    run = ("run", files / "hips.glb", files / "heavy.glb", "-o", tmp_path / "o.glb")
    plain, listed = command(*run)[1], command(*run, "--report")[1]
    assert listed.startswith(plain.rstrip()) and "UpperArm turned by up to " in listed
    stats = json.loads(command(*run, "--json")[1])["clips"][0]["stats"]
    assert stats["corrections"][0]["degrees"] > 5 and stats["contacts_of_the_source"] > 50


def test_repair_takes_the_hands_out_of_the_body(files, tmp_path, command):
    code, out, err = command("repair", files / "sunk.glb", "--clip", "sunk", "-o", tmp_path / "fixed.glb")
    assert (code, err) == (0, "") and out.splitlines()[0] == f"{tmp_path / 'fixed.glb'}: 1 clips repaired"
    fixed = load(tmp_path / "fixed.glb")
    assert [clip.name for clip in fixed.clips] == ["sunk", "again", "sunk repaired"]
    body = judged_body(cast(fixed.character))
    depths = [body.collider.depths(body.skinner.vertices(*world_pose(fixed.motion(n)))) for n in (0, 2)]
    assert (depths[0] > 0.001).sum() > 20 * (depths[1] > 0.001).sum()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["hips.bvh", "-o", "out.glb"], "has no skinned character"),
        (["heavy.glb", "-o", "out.glb"], "holds no animation to repair"),
        (["sunk.glb", "--clip", "sunken", "-o", "out.glb"], "nearest: 'sunk'"),
        (["none.glb", "-o", "out.glb"], "none.glb"),
    ],
)
def test_what_cannot_be_repaired_is_told_in_a_line(files, tmp_path, command, words, problem):
    code, out, err = command("repair", files / words[0], *words[1:-1], tmp_path / words[-1])
    assert (code, out) == (2, "") and problem in err and len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_repair_does_not_replace_what_it_repairs(files, command):
    before = (files / "sunk.glb").read_bytes()
    code, _, err = command("repair", files / "sunk.glb", "-o", files / "sunk.glb")
    assert code == 2 and "would replace the file that is repaired" in err and (files / "sunk.glb").read_bytes() == before
