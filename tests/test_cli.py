"""The command line: what it writes, what it says, and one line for every mistake."""

import json
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, fingerless, scaled, stand, walk

from retarget.body.kinematics import world_pose
from retarget.correspond.joints import scrambled
from retarget.io import load, save
from retarget.motion.filter import cut

QUICK = ("--method", "copy-rotations")
"""Where what is said and written is looked at, not the motion."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Small files of each kind."""
    folder = tmp_path_factory.mktemp("made")
    for motion in (walk(), stand()):
        save(folder / f"{motion.name}.bvh", fingerless(body()), [fingerless(motion)])
    save(folder / "heavy.glb", fingerless(body("heavy")), [])
    save(
        folder / "two.glb",
        fingerless(body()),
        [replace(fingerless(walk()), name="one"), replace(fingerless(stand()), name="two")],
    )
    (folder / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return folder


def hips(path, clip=None):
    motion = load(path).motion(clip)
    return motion, world_pose(motion)[1][:, motion.skeleton.index("hips")]


# --- run ----------------------------------------------------------------------------------------------------------


def test_one_motion_onto_one_character(made, tmp_path, command):
    code, out, err = command("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "out.glb")
    assert (code, err) == (0, "") and "90 frames" in out and len(out.splitlines()) == 1
    asset = load(tmp_path / "out.glb")
    assert [clip.name for clip in asset.clips] == ["walk"] and len(asset.character.mesh.vertices) >= len(
        body("heavy").mesh.vertices
    )
    _, path = hips(tmp_path / "out.glb")
    assert np.ptp(path[:, 2]) == pytest.approx(1.05, rel=0.15)


def test_contacts_can_be_left_alone(made, tmp_path, command):
    for name, options in (("a", QUICK), ("b", ("--no-repair-contacts",))):
        code, _, err = command("run", made / "stand.bvh", made / "heavy.glb", "-o", tmp_path / f"{name}.glb", *options)
        assert (code, err) == (0, "")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    both = ("--no-repair-contacts", "--method", "interaction")
    code, _, err = command("run", made / "stand.bvh", made / "heavy.glb", "-o", tmp_path / "c.glb", *both)
    assert code == 2 and "--no-repair-contacts and --method interaction contradict each other" in err
    assert not (tmp_path / "c.glb").exists()


def test_bodies_on_one_rig_may_get_equal_rotations(made, tmp_path, command):
    alone = (*QUICK, "--no-foot-lock", "--no-steady", "--one-rig")
    assert command("run", made / "two.glb", made / "heavy.glb", "--clip", "one", "-o", tmp_path / "a.glb", *alone)[0] == 0
    wanted, found = (load(path).motion("one").rotations for path in (made / "two.glb", tmp_path / "a.glb"))
    np.testing.assert_allclose(np.abs((wanted * found).sum(axis=-1)), 1.0, atol=1e-5)


def test_json_is_one_object_and_nothing_else(made, tmp_path, command):
    code, out, err = command("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "out.glb", "--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    (clip,) = report["clips"]
    assert clip["frames"] == 90 and clip["status"] == "ok" and clip["output"].endswith("out.glb")
    assert clip["target_joints"]["leftHand"] == "leftHand" and clip["stats"]["scale"] > 0.5
    assert "NaN" not in out and "Infinity" not in out


def test_verbose_says_what_was_inferred(made, tmp_path, command):
    code, _, err = command("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "out.glb", "-v")
    assert code == 0 and "up axis +y" in err


def test_several_motions_and_a_folder_out(made, tmp_path, command):
    code, out, _ = command("run", made / "walk.bvh", made / "stand.bvh", made / "heavy.glb", "-o", tmp_path / "results", *QUICK)
    assert code == 0 and len(out.splitlines()) == 2
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == ["stand_heavy.glb", "walk_heavy.glb"]
    code, _, _ = command("run", made / "walk.bvh", made / "stand.bvh", made / "heavy.glb", "-o", tmp_path / "both.glb", *QUICK)
    assert code == 0 and [clip.name for clip in load(tmp_path / "both.glb").clips] == ["walk", "stand"]


def test_a_folder_of_motions(made, tmp_path, command):
    inputs = tmp_path / "in"
    inputs.mkdir()
    for name in ("walk.bvh", "stand.bvh"):
        (inputs / name).write_bytes((made / name).read_bytes())
    (inputs / "notes.txt").write_text("not a motion")
    code, out, _ = command("run", inputs, made / "heavy.glb", "-o", tmp_path / "results", *QUICK)
    assert code == 0 and len(out.splitlines()) == 2


def test_a_folder_of_motions_may_hold_the_character_too(made, tmp_path, command):
    inputs = tmp_path / "in"
    inputs.mkdir()
    for name in ("walk.bvh", "heavy.glb"):
        (inputs / name).write_bytes((made / name).read_bytes())
    code, out, _ = command("run", inputs, inputs / "heavy.glb", "-o", tmp_path / "results", *QUICK)
    assert code == 0 and [path.name for path in (tmp_path / "results").iterdir()] == ["walk_heavy.glb"]


def test_one_input_is_too_few(made, tmp_path, command):
    code, _, err = command("run", made / "walk.bvh", "-o", tmp_path / "out.glb")
    assert code == 2 and err.startswith("retarget: ") and len(err.splitlines()) == 1


def test_clips_by_name_all_of_them_and_the_first(made, tmp_path, command):
    def clips(*words):
        out = tmp_path / "out.glb"
        code, _, err = command("run", made / "two.glb", made / "heavy.glb", "-o", out, *QUICK, *words)
        assert code == 0
        return [clip.name for clip in load(out).clips], err

    assert clips("--clip", "two")[0] == ["two"]
    assert clips("--all-clips") == (["one", "two"], "")
    names, err = clips()
    assert names == ["one"] and "--all-clips" in err, "taking the first of several is said"


def test_start_end_and_fps(made, tmp_path, command):
    out = tmp_path / "out.glb"
    words = ("--start", "1", "--end", "2", "--fps", "60")
    assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", out, *QUICK, *words)[0] == 0
    motion, path = hips(out)
    assert len(motion) == 61 and motion.seconds == pytest.approx(1.0, abs=1e-4)
    assert np.ptp(path[:, 2]) < 0.8


def test_in_place(made, tmp_path, command):
    out = tmp_path / "out.bvh"
    assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", out, *QUICK, "--in-place")[0] == 0
    assert np.ptp(hips(out)[1][:, [0, 2]], axis=0).max() < 1e-3


def test_animation_only(made, tmp_path, command):
    out, whole = tmp_path / "bones.glb", tmp_path / "whole.glb"
    assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", out, *QUICK, "--animation-only")[0] == 0
    assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", whole, *QUICK)[0] == 0
    asset = load(out)
    assert asset.character.mesh is None and len(asset.clips) == 1
    assert np.abs(hips(out)[1] - hips(whole)[1]).max() < 1e-4
    assert out.stat().st_size < whole.stat().st_size / 2


def test_foot_lock_can_be_left_out_and_the_same_call_writes_the_same_bytes(made, tmp_path, command):
    for name, words in (("held.glb", []), ("again.glb", []), ("free.glb", ["--no-foot-lock"])):
        assert command("run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / name, *QUICK, *words)[0] == 0
    assert (tmp_path / "held.glb").read_bytes() == (tmp_path / "again.glb").read_bytes()
    assert (tmp_path / "held.glb").read_bytes() != (tmp_path / "free.glb").read_bytes()


# --- info, map, body, picture -------------------------------------------------------------------------------------


def test_info_tells_and_tells_machines(made, command):
    code, out, _ = command("info", made / "walk.bvh")
    assert (
        code == 0
        and "22 joints" in out
        and re.search(r"leftHand +leftHand +0\.\d\d", out)
        and "90 frames at 30 fps" in out
    )
    for name, kind in (("walk.bvh", "motion"), ("two.glb", "character"), ("bare.obj", "mesh")):
        code, out, _ = command("info", made / name, "--json")
        assert code == 0 and json.loads(out)["kind"] == kind


def test_info_of_what_is_no_humanoid_is_no_error(tmp_path, command):
    (tmp_path / "worm.bvh").write_text(WORM)
    code, out, _ = command("info", tmp_path / "worm.bvh")
    assert code == 0 and "humanoid   no:" in out


def test_a_map_can_be_written_edited_and_used(made, tmp_path, command):
    """A character whose names mean nothing: the map says what is what, and what the map leaves out is not driven."""
    strange = replace(body("heavy"), skeleton=scrambled(body().skeleton, 7))
    save(tmp_path / "strange.glb", strange, [])
    table = tmp_path / "map.toml"
    code, out, _ = command("map", made / "walk.bvh", tmp_path / "strange.glb", "-o", table)
    assert code == 0 and "--map" in out and "leftIndexProximal" in table.read_text()
    edited = re.sub(r"(?m)^(left|right)(Index|Middle|Ring|Little|Thumb)\w+ .*\n", "", table.read_text())
    table.write_text(edited)
    code, out, _ = command(
        "run", made / "walk.bvh", tmp_path / "strange.glb", "-o", tmp_path / "out.bvh", "--map", table, "--json"
    )
    report = json.loads(out)["clips"][0]
    assert code == 0 and "leftIndexProximal" not in report["target_joints"]
    assert report["target_joints"]["leftHand"] == strange.skeleton.names[body().skeleton.index("leftHand")]


@pytest.mark.parametrize(
    "change, words",
    [
        (("leftHand ", "leftHnad "), "leftHnad"),
        (('"leftHand"', '"leftHandd"'), "leftHandd"),
        (('"leftHand"', '"rightHand"'), "twice"),
        (('"leftHand"', "3"), "quotes"),
        (("[target]", "[goal]"), "goal"),
        (("[target]", "[target"), "TOML"),
    ],
    ids=["joint", "name", "twice", "number", "table", "syntax"],
)
def test_mistakes_in_a_map_are_named(made, tmp_path, command, change, words):
    table = tmp_path / "map.toml"
    assert command("map", made / "walk.bvh", made / "heavy.glb", "-o", table)[0] == 0
    table.write_text(re.sub(re.escape(change[0]), change[1], table.read_text(), count=1))
    refused(command, words, "run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "out.glb", "--map", table)


def test_body_writes_the_human(tmp_path, command):
    out = tmp_path / "child.glb"
    code, text, _ = command("body", "--weight", "0.9", "--height", "1.3", "--age", "0.2", "-o", out)
    assert code == 0 and "1.300 m" in text
    vertices = load(out).character.mesh.vertices
    assert np.ptp(vertices[:, 1]) == pytest.approx(1.3, abs=1e-3)


def test_picture_draws_a_row_for_each_file(made, tmp_path, command):
    from PIL import Image

    out = tmp_path / "sheet.png"
    code, _, _ = command("picture", made / "two.glb", made / "walk.bvh", "-o", out, "--frames", "3", "--size", "64")
    assert code == 0
    width, height = Image.open(out).size
    assert width >= 3 * 20 and height >= 2 * 64


# --- evaluate -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def performed(made, tmp_path_factory):
    """Results of `run`, and sources to judge them by."""
    folder = tmp_path_factory.mktemp("performed")
    moment = cut(fingerless(walk()), 0.5, 0.8)
    save(folder / "skin.glb", fingerless(body()), [replace(moment, name="step")])
    save(folder / "bones.bvh", fingerless(body()), [replace(fingerless(walk()), name="walk")])
    both = [replace(moment, name="step"), replace(cut(fingerless(stand()), 0.0, 0.3), name="pause")]
    save(folder / "both.glb", fingerless(body()), both)
    return folder


def test_evaluate_prints_a_table_what_to_look_at_and_notes(performed, command):
    code, out, err = command("evaluate", performed / "skin.glb", "--source", performed / "skin.glb")
    assert (code, err) == (0, "")
    assert re.search(r"limb direction, off the source's +0\.00 +deg", out) and "rests on    " in out
    assert re.search(r"limb vertices inside other parts +0\.00 +0\.00  %", out)
    assert "Nothing that needs a look was found." in out and "joints off the truth" not in out


def test_evaluate_without_surfaces_and_with_a_truth(performed, command):
    bones = performed / "bones.bvh"
    code, out, _ = command("evaluate", bones, "--source", bones, "--truth", bones)
    assert code == 0 and re.search(r"\(MPJPE\) +0\.00 +mm", out) and "limb vertices" not in out
    assert "note: the result has no surface" in out


def test_evaluate_names_what_is_wrong(made, performed, tmp_path, command):
    moved = fingerless(walk())
    path = moved.translations + np.linspace(0, 0.3, 90)[:, None, None] * [1, 0, 0]
    save(tmp_path / "slid.bvh", fingerless(body()), [replace(moved, translations=path, name="walk")])
    code, out, _ = command("evaluate", tmp_path / "slid.bvh", "--source", made / "walk.bvh")
    assert code == 0 and re.search(r"1\. (left|right) foot slides \d\.\d cm from \d\.\d\d s to \d\.\d\d s", out)


def test_evaluate_json_is_one_object_with_figures_curves_and_problems(performed, command):
    code, out, err = command("evaluate", performed / "bones.bvh", "--source", performed / "bones.bvh", "--json")
    report = json.loads(out)
    assert (code, err) == (0, "") and report["figures"]["frames"] == 90 and report["problems"] == []
    assert len(report["curves"]["speed_m_s/result/left hand"]) == 90 and report["clips"]["result"] == "bones"
    assert "NaN" not in out and "Infinity" not in out


def test_evaluate_draws_curves(performed, tmp_path, command):
    from PIL import Image

    out = tmp_path / "curves.png"
    code, text, _ = command("evaluate", performed / "bones.bvh", "--source", performed / "bones.bvh", "-o", out)
    assert code == 0 and "curves.png" in text and Image.open(out).size[0] > 1000


def test_evaluate_takes_the_clips_that_belong_together(made, performed, tmp_path, command):
    def clips(*words):
        code, out, _ = command("evaluate", *words, "--json")
        assert code == 0
        report = json.loads(out)
        return report["clips"], report["notes"]

    both, skin = performed / "both.glb", performed / "skin.glb"
    chosen, notes = clips(both, "--source", skin)
    assert chosen == {"result": "step", "source": "step"} and any("2 clips" in note for note in notes)
    assert clips(both, "--source", both)[0] == {"result": "pause", "source": "pause"}, "the last, and its namesake"
    chosen, notes = clips(both, "--source", both, "--clip", "step", "--source-clip", "pause")
    assert chosen == {"result": "step", "source": "pause"} and not any("2 clips" in note for note in notes)
    chosen, notes = clips(both, "--source", made / "walk.bvh", "--start", "0.5", "--end", "0.8")
    assert chosen["result"] == "pause" and not any("lengths" in note for note in notes)
    assert any("lengths differ" in note for note in clips(both, "--source", made / "walk.bvh")[1])


@pytest.mark.parametrize(
    "words, call",
    [
        ("no animation", ["heavy.glb", "--source", "walk.bvh"]),
        ("no animation", ["walk.bvh", "--source", "heavy.glb"]),
        ("no animation", ["walk.bvh", "--source", "walk.bvh", "--truth", "heavy.glb"]),
        ("no animation", ["two.glb", "--source", "bare.obj"]),
        ("no such file", ["nothing.glb", "--source", "walk.bvh"]),
        ("'walk'", ["walk.bvh", "--source", "walk.bvh", "--clip", "wolk"]),
        ("'two'", ["walk.bvh", "--source", "two.glb", "--source-clip", "tow"]),
        ("'walk'", ["walk.bvh", "--source", "walk.bvh", "--truth", "walk.bvh", "--truth-clip", "wolk"]),
        ("nothing lies between", ["walk.bvh", "--source", "walk.bvh", "--start", "9"]),
        ("positive", ["walk.bvh", "--source", "walk.bvh", "--fps", "0"]),
        ("+z", ["walk.bvh", "--source", "walk.bvh", "--up", "upward"]),
        ("unit", ["walk.bvh", "--source", "walk.bvh", "--unit", "-1"]),
        (".png", ["walk.bvh", "--source", "walk.bvh", "-o", "curves.jpg"]),
        ("does not exist", ["walk.bvh", "--source", "walk.bvh", "-o", "no/curves.png"]),
        ("nothing.toml", ["walk.bvh", "--source", "walk.bvh", "--map", "nothing.toml"]),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_evaluate_refuses_in_one_line(made, monkeypatch, command, words, call):
    monkeypatch.chdir(made)
    before = sorted(made.iterdir())
    refused(command, words, "evaluate", *call)
    assert sorted(made.iterdir()) == before


def test_evaluate_refuses_the_truth_of_another_body(made, tmp_path, command):
    save(tmp_path / "giant.bvh", scaled(fingerless(body()), 1.4), [scaled(fingerless(walk()), 1.4)])
    call = ["evaluate", made / "walk.bvh", "--source", made / "walk.bvh", "--truth", tmp_path / "giant.bvh"]
    refused(command, "animation of the result's character", *call)


def test_help_and_version(command):
    from retarget import __version__

    assert command("--version")[1].strip() == __version__
    code, out, _ = command("--help")
    assert code == 0 and all(word in out for word in ("run", "info", "map", "body", "picture", "evaluate"))


# --- bad input ----------------------------------------------------------------------------------------------------

WORM = """HIERARCHY
ROOT a
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT b
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 10 0
    }
  }
}
MOTION
Frames: 1
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0
"""


def refused(command, words, *call):
    """The call ends with exit code 2 and one line on standard error that names the trouble; nothing is printed."""
    code, out, err = command(*call)
    assert code == 2 and out == "", (code, out, err)
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("retarget: "), err
    for word in [words] if isinstance(words, str) else words:
        assert word in lines[0], err
    return lines[0]


def glb(text, binary=b""):
    """A GLB file of the given JSON text."""
    text = text.encode() + b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def edited_glb(path, change):
    """The file with its JSON changed in place."""
    raw = path.read_bytes()
    length = struct.unpack_from("<I", raw, 12)[0]
    document = json.loads(raw[20 : 20 + length])
    change(document)
    return glb(json.dumps(document), raw[20 + length + 8 :])


def lines_of(path):
    return path.read_text().splitlines(keepends=True)


def bad_motions(made):
    """File name, content and a word of the message for motions that cannot be used."""
    rows = lines_of(made / "walk.bvh")
    first = next(i for i, row in enumerate(rows) if row.startswith("Frame Time")) + 1
    frames = next(i for i, row in enumerate(rows) if row.startswith("Frames:"))
    text = "".join(rows)
    yield "empty.bvh", "", "empty"
    yield "truncated.bvh", text[: len(text) // 3], "line"
    yield "cut_hierarchy.bvh", text[:400], "line"
    yield "short_row.bvh", "".join([*rows[:first], rows[first].rsplit(" ", 3)[0] + "\n", *rows[first + 1 :]]), "line"
    yield "nan.bvh", "".join([*rows[:first], re.sub(r"^\S+", "nan", rows[first]), *rows[first + 1 :]]), "line"
    yield "many_frames.bvh", "".join([*rows[:frames], "Frames: 1000000\n", *rows[frames + 1 :]]), "1000000"
    yield "no_frames.bvh", "".join([*rows[:frames], "Frames: 0\n", rows[frames + 1]]), "frames"
    yield "two_roots.bvh", "".join([*rows[: frames - 1], *rows[1 : frames - 1], *rows[frames - 1 :]]), "root"
    yield "worm.bvh", WORM, "humanoid"
    yield "zero_bones.bvh", re.sub(r"OFFSET .*", "OFFSET 0 0 0", text), ""
    yield "wrong.glb", text, "glTF"
    yield "motion.txt", text, ".txt"
    yield "noise.bvh", "\0\1\2 nothing of the kind", "line"


def bad_characters(made):
    """File name, content and a word of the message for characters that cannot be used."""
    whole, good = (made / "heavy.glb").read_bytes(), made / "heavy.glb"
    yield "empty.glb", b"", "empty"
    yield "truncated.glb", whole[: len(whole) // 2], "byte"
    yield "lying_length.glb", whole[:8] + struct.pack("<I", 2**31) + whole[12:], "byte"
    yield "lying_chunk.glb", whole[:12] + struct.pack("<I", 2**31) + whole[16:], "byte"
    yield "no_json.glb", glb("{"), "JSON"
    yield "not_gltf.glb", b"BLENDER-v300" + whole[:500], ""
    yield "extension.glb", edited_glb(good, lambda d: d.update(extensionsRequired=["VENDOR_new"])), "VENDOR_new"
    yield (
        "outside.gltf",
        json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": "../../secret.bin", "byteLength": 4}]}),
        "secret.bin",
    )
    yield "no_skeleton.glb", glb(json.dumps({"asset": {"version": "2.0"}, "scenes": [{"nodes": []}]})), ""

    def cycle(document):
        joints = document["skins"][0]["joints"]
        document["nodes"][joints[3]].setdefault("children", []).append(joints[0])

    yield "cycle.glb", edited_glb(good, cycle), ""
    yield "mesh.obj", (made / "bare.obj").read_text(), "a body needs a surface"
    yield "worm.bvh", WORM, "humanoid"
    yield "picture.png", b"\x89PNG\r\n", ".png"


@pytest.mark.parametrize("number", range(13))
def test_a_motion_that_cannot_be_used(made, tmp_path, command, number):
    name, content, words = list(bad_motions(made))[number]
    (tmp_path / name).write_text(content)
    line = refused(
        command, [words, name.split(".")[0]], "run", tmp_path / name, made / "heavy.glb", "-o", tmp_path / "out.glb"
    )
    assert len(line) < 700
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.parametrize("number", range(13))
def test_a_character_that_cannot_be_used(made, tmp_path, command, number):
    name, content, words = list(bad_characters(made))[number]
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    folder = tmp_path / "results"
    refused(command, [words, name.split(".")[0]], "run", made / "walk.bvh", tmp_path / name, "-o", folder)
    assert not folder.exists(), "not even the folder"


def test_there_are_as_many_bad_files_as_cases(made):
    assert len(list(bad_motions(made))) == len(list(bad_characters(made))) == 13


@pytest.mark.parametrize(
    "words, options",
    [
        ("positive", ["--fps", "0"]),
        ("1e+09", ["--fps", "1e9"]),
        ("nothing lies between", ["--start", "9"]),
        ("seconds", ["--end", "nan"]),
        ("unit", ["--unit", "-1"]),
        ("+z", ["--up", "upward"]),
        ("unit", ["--target-unit", "nan"]),
        ("copy-rotations", ["--method", "copy"]),
        ("'walk'", ["--clip", "wolk"]),
        ("nothing.toml", ["--map", "nothing.toml"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_options_that_cannot_be(made, tmp_path, command, words, options):
    refused(command, words, "run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "out.glb", *options)
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_cannot_be(made, tmp_path, command):
    (tmp_path / "file").write_text("")
    for words, output in (
        (".txt", "out.txt"),
        ("does not exist", "no/out.glb"),
        ("is a file", "file"),
        ("is a file", "file/deeper"),
    ):
        refused(command, words, "run", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / output)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_two_results_never_share_a_name(made, tmp_path, command):
    other = tmp_path / "other"
    other.mkdir()
    (other / "walk.bvh").write_bytes((made / "walk.bvh").read_bytes())
    refused(
        command,
        "walk_heavy.glb",
        "run",
        made / "walk.bvh",
        other / "walk.bvh",
        made / "heavy.glb",
        "-o",
        tmp_path / "results",
    )


def test_a_character_without_clips_is_no_motion(made, tmp_path, command):
    for words in ([], ["--all-clips"]):
        refused(
            command,
            ["heavy.glb", "no animation"],
            "run",
            made / "heavy.glb",
            made / "two.glb",
            "-o",
            tmp_path / "out.glb",
            *words,
        )


@pytest.mark.parametrize(
    "words, call",
    [
        ("name", ["body", "--shape", "name=1"]),
        ("NAME=VALUE", ["body", "--shape", "waist"]),
        ("height", ["body", "--height", "99"]),
        ("thin", ["body", "--preset", "thinn"]),
        ("'nope'", ["body", "--motion", "nope"]),
    ],
    ids=lambda value: value[2] if isinstance(value, list) else "",
)
def test_bodies_that_cannot_be(tmp_path, command, words, call):
    refused(command, words, *call, "-o", tmp_path / "body.glb")
    assert list(tmp_path.iterdir()) == []


def test_other_commands_refuse_in_one_line_too(made, tmp_path, command):
    refused(command, "no such file", "info", tmp_path / "none.bvh")
    refused(command, ".txt", "info", (tmp_path / "a.txt").write_text("") or tmp_path / "a.txt")
    refused(command, "no/map.toml", "map", made / "walk.bvh", made / "heavy.glb", "-o", tmp_path / "no" / "map.toml")
    refused(command, "a body needs a surface", "map", made / "bare.obj", made / "heavy.glb", "-o", tmp_path / "map.toml")
    refused(command, ".png", "picture", made / "two.glb", "-o", tmp_path / "sheet.jpg")
    refused(command, "nope", "picture", made / "two.glb", "-o", tmp_path / "sheet.png", "--clip", "nope")
    refused(command, "skeletal", "bench", "skeletall")
    refused(command, "does not exist", "bench", "skeletal", "--json", tmp_path / "no" / "bench.json")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
