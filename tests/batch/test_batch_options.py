"""What a batch takes over from `run`: formats, presets, the user's model, pages; and what of it makes work be done again."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from made_folders import contents, records, short
from made_motions import body, fingerless, walk
from smpl_maker import amass, angles, model_arrays, z_up
from vrm_maker import vrm

from retarget.io import load, save

QUICK = ("--method", "copy-rotations", "--jobs", "1")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One motion at 50 frames a second, one character with a clip of its own, a model and a motion for it."""
    folder = tmp_path_factory.mktemp("options")
    for name in "mcs":
        (folder / name).mkdir()
    save(folder / "m" / "walk.bvh", fingerless(body()), [replace(short(walk(), "walk"), fps=50.0)])
    save(folder / "c" / "heavy.glb", fingerless(body("heavy")), [short(walk(), "own")])
    poses = angles(6, 52, left_elbow=[0, -1.4, 0])
    poses[:, 0] = z_up(6)
    amass(folder / "s" / "posed.npz", poses, np.zeros((6, 3)) + [0.0, 0.0, 0.9], fps=30)
    for name, moved in (("BODY", (0.0, -1.1, 0.03)), ("OTHER", (0.0, -1.2, 0.03))):
        np.savez(folder / f"{name}.npz", **model_arrays(52, moved=moved))
    return folder


@pytest.fixture
def run(made, tmp_path, command):
    """Runs a batch into `tmp_path`: its report, and what was made in this run."""

    def batch(*words, motions="m", characters=None):
        before = len(records(tmp_path / "o")) if (tmp_path / "o").exists() else 0
        words = ("batch", made / motions, characters or made / "c", "-o", tmp_path / "o", *QUICK, *words, "--json")
        code, out, err = command(*words)
        assert (code, err) == (0, ""), (out, err)
        return json.loads(out), [record["output"] for record in records(tmp_path / "o")[before:]]

    return batch


@pytest.mark.parametrize("suffix", [".gltf", ".bvh", ".usda", ".usdz"])
def test_results_in_other_formats_hold_their_one_clip(run, tmp_path, suffix):
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr")
    assert run("--suffix", suffix)[1] == [f"heavy/walk{suffix}"]
    asset = load(tmp_path / "o" / "heavy" / f"walk{suffix}")
    assert [(clip.name, clip.frames) for clip in asset.clips] == [("walk", 16)]
    assert run("--suffix", suffix)[1] == []


def test_an_avatar_stays_one(run, tmp_path):
    avatar = vrm(tmp_path / "avatar.vrm", motions=[replace(walk(), name="own")])
    assert run("--suffix", "vrm", characters=avatar)[1] == ["avatar/walk.vrm"]
    asset = load(tmp_path / "o" / "avatar" / "walk.vrm")
    assert asset.humanoid and [clip.name for clip in asset.clips] == ["walk"]


def test_a_character_that_the_format_does_not_hold_is_a_failure_with_nothing_written(made, tmp_path, command):
    code, out, _ = command("batch", made / "m", made / "c", "-o", tmp_path / "o", *QUICK, "--suffix", ".vrm")
    assert code == 1 and "came from no VRM" in out
    assert [path.name for path in (tmp_path / "o").iterdir()] == ["manifest.jsonl"]


def test_a_preset_sets_format_and_rate_unless_they_are_given(run, tmp_path):
    assert run("--for", "godot")[1] == ["heavy/walk.glb"]
    assert load(tmp_path / "o" / "heavy" / "walk.glb").clips[0].fps == 30
    assert run("--for", "blender")[1] == ["heavy/walk.glb"], "another preset is another setting"
    assert load(tmp_path / "o" / "heavy" / "walk.glb").clips[0].fps == 24
    assert run("--for", "unreal", "--suffix", ".bvh", "--fps", "25")[1] == ["heavy/walk.bvh"]
    assert load(tmp_path / "o" / "heavy" / "walk.bvh").clips[0].fps == 25


def test_the_results_of_a_preset_are_those_of_run(made, run, tmp_path, command):
    run("--for", "godot")
    words = ("run", made / "m" / "walk.bvh", made / "c" / "heavy.glb", "-o", tmp_path / "r.glb", *QUICK[:2], "--for", "godot")
    assert command(*words)[0] == 0
    found, wanted = load(tmp_path / "o" / "heavy" / "walk.glb"), load(tmp_path / "r.glb")
    assert found.clips[0] == wanted.clips[-1], "name, frames, rate and what it was made from"
    assert np.array_equal(found.motion(0).rotations, wanted.motion("walk").rotations)


def test_the_users_model_performs_and_another_one_does_it_again(made, run, tmp_path):
    model = ("--smpl-model", tmp_path / "BODY.npz")
    shutil.copy(made / "BODY.npz", tmp_path / "BODY.npz")
    assert run(motions="s")[1] == ["heavy/posed.glb"]
    stand_in = contents(tmp_path / "o")
    assert run(*model, motions="s")[1] == ["heavy/posed.glb"] and contents(tmp_path / "o") != stand_in
    assert run(*model, motions="s")[1] == []
    (tmp_path / "elsewhere").mkdir()
    shutil.move(tmp_path / "BODY.npz", tmp_path / "elsewhere" / "MODEL.npz")
    assert run("--smpl-model", tmp_path / "elsewhere" / "MODEL.npz", motions="s")[1] == [], "its content counts"
    assert run("--smpl-model", made / "OTHER.npz", motions="s")[1] == ["heavy/posed.glb"]


def test_a_model_that_changes_meanwhile_is_not_taken_for_what_it_was(made):
    from retarget.batch.work import Settings
    from retarget.errors import RetargetError

    with pytest.raises(RetargetError, match="BODY.npz: was changed while the batch ran"):
        Settings(smpl_model=str(made / "BODY.npz"), smpl_model_hash="0").load(made / "s" / "posed.npz")


def test_pages_lie_beside_the_results_and_are_made_when_they_are_missing(run, tmp_path):
    page = tmp_path / "o" / "heavy" / "walk.html"
    assert run()[1] == ["heavy/walk.glb"] and not page.exists()
    plain = contents(tmp_path / "o")
    assert run("--report")[1] == ["heavy/walk.glb"]
    first = page.read_bytes()
    assert b"walk.glb from walk.bvh" in first and b"method: copy-rotations, as asked" in first
    assert {name: known for name, known in contents(tmp_path / "o").items() if name in plain} == plain
    assert run("--report")[1] == []
    page.write_bytes(first[:-1])
    assert run()[1] == [], "nobody asked for pages"
    assert run("--report")[1] == ["heavy/walk.glb"] and page.read_bytes() == first


def test_a_page_that_fails_leaves_no_result(made, tmp_path):
    from retarget.batch.plan import content_hash
    from retarget.batch.work import Bench, Settings, retarget_clip
    from retarget.errors import RetargetError

    def refuse(*_):
        raise RetargetError("no page")

    paths = [made / "m" / "walk.bvh", made / "c" / "heavy.glb"]
    task = {"motion": str(paths[0]), "clip": 0, "character": str(paths[1]), "output": str(tmp_path / "o.glb")}
    task |= {"inputs": [content_hash(path) for path in paths], "page": str(tmp_path / "o.html")}
    with pytest.raises(RetargetError, match="no page"):
        retarget_clip(task, Settings(method="copy-rotations"), Bench(), refuse)
    assert not list(tmp_path.iterdir())


def test_a_buffer_of_a_result_that_is_gone_or_damaged_is_made_again(run, tmp_path):
    run("--suffix", ".gltf")
    whole, beside = contents(tmp_path / "o"), tmp_path / "o" / "heavy" / "walk.bin"
    for damage in (beside.unlink, lambda: beside.write_bytes(b"x")):
        damage()
        assert run("--suffix", ".gltf")[1] == ["heavy/walk.gltf"] and contents(tmp_path / "o") == whole


@pytest.mark.parametrize(
    "words, said",
    [
        (["--for", "unrael"], "nearest: 'unreal'"),
        (["--smpl-model", "BODY.npz"], "is for motions in .npz, and none is given"),
        (["--smpl-model", "m/walk.bvh"], "walk.bvh"),
        (["--smpl-model", "none.npz"], "none.npz: cannot be read: No such file"),
        (["--suffix", ".vrm", "--animation-only"], "--animation-only: a .vrm holds no animation alone"),
        (["--suffix", "abc", "--animation-only"], "--animation-only: a .abc holds no animation alone"),
        (["--suffix", "fbx"], "RETARGET_BLENDER names no-such-program"),
        (["--for", "unity"], "RETARGET_BLENDER names no-such-program"),
        (["--suffix", ""], "cannot write"),
    ],
)
def test_what_cannot_be_begun_is_one_line(made, tmp_path, monkeypatch, command, words, said):
    monkeypatch.setenv("RETARGET_BLENDER", "no-such-program")
    for name in "mc":
        shutil.copytree(made / name, tmp_path / name)
    shutil.copy(made / "BODY.npz", tmp_path)
    monkeypatch.chdir(tmp_path)
    code, out, err = command("batch", "m", "c", "-o", "o", *words)
    assert (code, out) == (2, "") and said in err and len(err.splitlines()) == 1
    assert not (tmp_path / "o").exists()
