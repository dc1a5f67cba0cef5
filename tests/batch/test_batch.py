"""A batch: what it makes, what it makes again and what not, and what failures leave standing."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from made_folders import NAMES, QUICK, contents, make_characters, make_motions, records, short
from made_motions import body, fingerless, walk

from retarget.batch.run import Batch, run_batch
from retarget.batch.work import Settings
from retarget.errors import FileError, RetargetError
from retarget.io import load, save

PLAIN = Settings(method="copy-rotations")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The inputs, and what a batch made of them."""
    folder = tmp_path_factory.mktemp("batch")
    make_motions(folder / "m")
    make_characters(folder / "c")
    summary = run_batch(Batch(folder / "m", folder / "c", folder / "out", PLAIN, processes=2))
    assert not summary.failures and summary.done_before == 0
    return folder


@pytest.fixture
def copied(made, tmp_path):
    """The same, to be changed."""
    shutil.copytree(made, tmp_path / "b")  # times of files are kept
    return tmp_path / "b"


def again(folder, settings=PLAIN, **others):
    """Run the batch once more: what was made, and the summary."""
    before = len(records(folder / "out"))
    summary = run_batch(Batch(folder / "m", folder / "c", folder / "out", settings, processes=1, **others))
    return sorted(record["output"] for record in records(folder / "out")[before:]), summary


def test_every_clip_is_put_onto_every_character(made):
    assert sorted(contents(made / "out")) == NAMES
    asset = load(made / "out" / "heavy" / "sub" / "two" / "two_2.glb")
    assert [(clip.name, clip.frames) for clip in asset.clips] == [("two|2", 25)] and asset.kind == "character"
    finished = [record["done"][0] for record in records(made / "out") if record["done"][2] == "child.glb"]
    assert sorted(finished) == ["sub/two.glb", "sub/two.glb", "walk10.bvh", "walk2.bvh"]  # two workers: in any order


def test_the_results_are_those_of_run(made, tmp_path, command):
    for motion in ("walk2.bvh", "walk10.bvh"):
        command(
            "run", made / "m" / motion, made / "c" / "child.glb", "-o", tmp_path / "r.glb", "--method", "copy-rotations"
        )
        assert (tmp_path / "r.glb").read_bytes() == (made / "out" / "child" / motion).with_suffix(".glb").read_bytes()


def test_a_finished_batch_is_not_done_again(copied):
    before = {path: path.stat().st_mtime_ns for path in (copied / "out").rglob("*")}
    remade, summary = again(copied)
    assert remade == [] and summary.done_before == len(summary.done) == len(NAMES)
    assert {path: path.stat().st_mtime_ns for path in (copied / "out").rglob("*") if path.name != "out"} == before


def test_what_is_gone_or_damaged_is_made_again(copied):
    first, second = copied / "out" / NAMES[0], copied / "out" / NAMES[3]
    whole = contents(copied / "out")
    first.unlink()
    data = bytearray(second.read_bytes())
    data[-1] ^= 1
    second.write_bytes(data)
    assert again(copied)[0] == [NAMES[0], NAMES[3]]
    assert contents(copied / "out") == whole


def test_a_motion_that_changed_is_done_again_and_one_that_was_only_touched_is_not(copied):
    save(copied / "m" / "walk2.bvh", fingerless(body()), [short(walk(), "walk", 0.7)])
    os.utime(copied / "m" / "walk10.bvh")
    assert again(copied)[0] == ["child/walk2.glb", "heavy/walk2.glb"]
    save(copied / "c" / "child.glb", fingerless(body("toddler")), [])
    assert again(copied)[0] == [name for name in NAMES if name.startswith("child")]


def test_other_settings_or_another_version_do_everything_again(copied, monkeypatch):
    assert again(copied, Settings(method="copy-rotations", in_place=True))[0] == NAMES
    digest = PLAIN.digest()
    monkeypatch.setattr("retarget.__version__", "9")
    assert PLAIN.digest() != digest


def test_new_files_are_added(copied):
    shutil.copy(copied / "m" / "walk2.bvh", copied / "m" / "third.bvh")
    assert again(copied)[0] == ["child/third.glb", "heavy/third.glb"]


def test_a_buffer_beside_a_gltf_counts_as_the_file(tmp_path):
    make_characters(tmp_path / "c")
    (tmp_path / "c" / "heavy.glb").unlink()
    (tmp_path / "m").mkdir()
    save(tmp_path / "m" / "walk.gltf", fingerless(body()), [short(walk(), "walk")])
    assert again_or_first(tmp_path) == ["child/walk.glb"]
    data = bytearray((tmp_path / "m" / "walk.bin").read_bytes())
    data[-2] ^= 1
    (tmp_path / "m" / "walk.bin").write_bytes(data)
    assert again_or_first(tmp_path) == ["child/walk.glb"]


def again_or_first(folder):
    (folder / "out").mkdir(exist_ok=True)
    (folder / "out" / "manifest.jsonl").touch()
    return again(folder)[0]


def test_names_that_would_meet_are_told_apart(tmp_path):
    make_characters(tmp_path / "c")
    (tmp_path / "c" / "child.glb").unlink()
    for name in ("Walk.bvh", "walk.glb"):
        (tmp_path / "m").mkdir(exist_ok=True)
        save(tmp_path / "m" / name, fingerless(body()), [short(walk(), name)])
    assert again_or_first(tmp_path) == ["heavy/Walk_bvh.glb", "heavy/walk_glb.glb"]
    assert [load(tmp_path / "out" / "heavy" / name).clips[0].name for name in ("Walk_bvh.glb", "walk_glb.glb")] == [
        "Walk",
        "walk.glb",
    ]


def test_a_character_is_not_put_onto_itself(tmp_path):
    (tmp_path / "c").mkdir()
    for name in ("heavy", "child"):
        save(tmp_path / "c" / f"{name}.glb", fingerless(body(name)), [short(walk(), "own")])
    summary = run_batch(Batch(tmp_path / "c", tmp_path / "c", tmp_path / "c" / "out", PLAIN, processes=1))
    assert sorted(contents(tmp_path / "c" / "out")) == ["child/heavy.glb", "heavy/child.glb"] and not summary.failures
    asset = load(tmp_path / "c" / "out" / "child" / "heavy.glb")
    assert [clip.name for clip in asset.clips] == ["own"]  # the character's own clips are left out
    summary = run_batch(Batch(tmp_path / "c", tmp_path / "c", tmp_path / "c" / "out", PLAIN, processes=1))
    assert summary.done_before == 2  # results that lie in the folder of motions are no motions


# --- failures -----------------------------------------------------------------------------------------------------

STICK = """HIERARCHY
ROOT a
{
 OFFSET 0 0 0
 CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
 End Site
 {
  OFFSET 0 1 0
 }
}
MOTION
Frames: 1
Frame Time: 0.033
0 0 0 0 0 0
"""


def test_failures_are_collected_and_told_in_a_table(copied, command):
    (copied / "m" / "junk.bvh").write_text("nothing")
    (copied / "m" / "stick.bvh").write_text(STICK)
    (copied / "c" / "stick.bvh").write_text(STICK)
    save(copied / "m" / "still.glb", fingerless(body()), [])
    code, out, err = command("batch", copied / "m", copied / "c", "-o", copied / "out", *QUICK)
    assert (code, err) == (1, "")
    rows = [line.split() for line in out.splitlines()]
    assert "0 clips made" in out and "8 were there before" in out and "passed over: still.glb holds no animation" in out
    assert ["4", "failed:"] in rows
    assert [row[:2] for row in rows if row and row[0] in ("junk.bvh", "(every")] == [
        ["junk.bvh", "(every"],
        ["(every", "motion)"],
    ]
    assert [row[:3] for row in rows if row and row[0] == "stick.bvh"] == [
        ["stick.bvh", "[stick]", name] for name in ("child.glb", "heavy.glb")
    ]
    assert sorted(contents(copied / "out")) == NAMES
    (copied / "m" / "junk.bvh").unlink(), (copied / "m" / "stick.bvh").unlink(), (copied / "c" / "stick.bvh").unlink()
    code, out, err = command("batch", copied / "m", copied / "c", "-o", copied / "out", *QUICK, "--json")
    report = json.loads(out)
    assert (code, err, report["failed"], report["results"], report["made"]) == (0, "", [], 8, 0)


def test_a_job_that_takes_its_process_down_or_hangs_is_named_and_the_rest_is_done(tmp_path):
    make_characters(tmp_path / "c")
    (tmp_path / "c" / "heavy.glb").unlink()
    (tmp_path / "m").mkdir()
    for name in ("a", "crash", "hang", "z"):
        save(tmp_path / "m" / f"{name}.bvh", fingerless(body()), [short(walk(), name)])
    batch = Batch(tmp_path / "m", tmp_path / "c", tmp_path / "out", PLAIN, processes=2, seconds=4.0)
    summary = run_batch(batch, work="crew_tasks:flaky")
    assert sorted(contents(tmp_path / "out")) == ["child/a.glb", "child/z.glb"]
    assert [(each.motion, each.character, each.error) for each in summary.failures] == [
        ("crash.bvh", "child.glb", "its process stopped (exit code 3)"),
        ("hang.bvh", "child.glb", "took longer than 4 s and was given up"),
    ]
    assert len(records(tmp_path / "out", "failed")) == 2
    summary = run_batch(batch)  # nothing wrong with them now
    assert summary.done_before == 2 and len(summary.done) == 4 and not summary.failures


def test_an_input_that_changes_meanwhile_is_not_taken_for_what_it_was(made, tmp_path):
    from retarget.batch.work import perform

    task = {
        "do": "clip",
        "motion": str(made / "m" / "walk2.bvh"),
        "clip": 0,
        "character": str(made / "c" / "heavy.glb"),
    }
    task |= {
        "inputs": ["0" * 64, "0" * 64],
        "output": str(tmp_path / "x.glb"),
        "settings": {"method": "copy-rotations"},
    }
    with pytest.raises(RetargetError, match="walk2.bvh: was changed while the batch ran"):
        perform(task)
    (tmp_path / "map.toml").write_text("")
    with pytest.raises(RetargetError, match="map.toml: was changed while the batch ran"):
        Settings(map_file=str(tmp_path / "map.toml"), map_hash="0").hints()
    with pytest.raises(RetargetError, match="map.toml: was changed while the batch ran"):
        Settings(contacts=str(tmp_path / "map.toml"), contacts_hash="0").for_method()


def test_a_clip_without_frames_is_refused():
    from dataclasses import replace

    from retarget.batch.work import Bench, retarget_clip
    from retarget.io.asset import Asset, Clip

    empty = fingerless(walk())
    empty = replace(empty, rotations=empty.rotations[:0], translations=empty.translations[:0])
    asset = Asset(Path("e.glb"), "motion", clips=(Clip("walk", 0, 30.0),), read_clip=lambda number: empty)
    bench = Bench()
    bench.motion = (("e.glb", "0", None), asset)
    task = {"motion": "e.glb", "clip": 0, "character": "c", "inputs": ["0", "0"], "output": "o.glb"}
    with pytest.raises(RetargetError, match="e.glb: the clip 'walk' has no frames"):
        retarget_clip(task, PLAIN, bench)


def test_a_prepared_pair_is_used_again_and_changes_nothing(made, tmp_path):
    """Bytes do not depend on what a process did before."""
    from retarget.batch.plan import content_hash
    from retarget.batch.work import Bench, retarget_clip

    settings, bench, names = Settings(), Bench(), ("walk2.bvh", "walk10.bvh")
    for fresh in (False, True):
        for name in names:
            paths = [made / "m" / name, made / "c" / "heavy.glb"]
            task = {"motion": str(paths[0]), "clip": 0, "character": str(paths[1])}
            task |= {
                "inputs": [content_hash(path) for path in paths],
                "output": str(tmp_path / f"{fresh}{name}.glb"),
            }
            retarget_clip(task, settings, Bench() if fresh else bench)
    assert len(bench.pairs) == 1  # both performers are one
    for name in names:
        assert (tmp_path / f"True{name}.glb").read_bytes() == (tmp_path / f"False{name}.glb").read_bytes()


# --- what cannot be begun -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words, said",
    [
        (["nowhere", "c", "-o", "o"], "nowhere: no such file or folder"),
        (["m", "empty", "-o", "o"], "empty: the folder holds no file with a skeleton"),
        (["m", "c", "-o", "m"], "m: holds the inputs; name another folder"),
        (["m", "c", "-o", "c"], "c: holds the inputs"),
        (["m", "c", "-o", "m/walk2.bvh"], "cannot be made a folder: File exists"),
        (["m", "c", "-o", "o", "--suffix", "gltx"], "cannot write '.gltx'; use .bvh, .glb"),
        (["m", "c", "-o", "o", "--method", "interacton"], "nearest: 'interaction'"),
        (["m", "c", "-o", "o", "--up", "y"], "--up: 'y' is unknown"),
        (["m", "c", "-o", "o", "--target-unit", "-1"], "--target-unit: must be positive"),
        (["m", "c", "-o", "o", "--fps", "0"], "--fps: must be positive"),
        (["m", "c", "-o", "o", "--map", "no.toml"], "no.toml: cannot be read"),
        (["m", "c", "-o", "o", "--contacts", "m/walk2.bvh"], "walk2.bvh"),
    ],
)
def test_what_cannot_be_begun_is_one_line(made, tmp_path, monkeypatch, command, words, said):
    (
        shutil.copytree(made / "m", tmp_path / "m"),
        shutil.copytree(made / "c", tmp_path / "c"),
        (tmp_path / "empty").mkdir(),
    )
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    code, out, err = command("batch", *words)
    assert (code, out) == (2, "") and said in err and len(err.splitlines()) == 1
    assert contents(tmp_path) == before


def test_a_result_never_replaces_an_input(tmp_path, made):
    shutil.copytree(made / "m", tmp_path / "out" / "heavy")
    save(tmp_path / "out" / "heavy" / "a.glb", fingerless(body()), [short(walk(), "a")])
    shutil.copytree(made / "c", tmp_path / "c")
    before = contents(tmp_path)
    with pytest.raises(RetargetError, match="is read and would be written"):
        run_batch(Batch(tmp_path / "out" / "heavy" / "a.glb", tmp_path / "c", tmp_path / "out", PLAIN))
    assert contents(tmp_path) == before


def test_two_runs_in_one_folder_are_refused(copied):
    from retarget.batch.lock import held_alone

    with held_alone(copied / "out"), pytest.raises(FileError, match="another batch .process [0-9]+. is at work there"):
        again(copied)


def test_temporaries_of_a_dead_run_are_taken_away_and_nothing_else(copied):
    stale = copied / "out" / "heavy" / ".walk2.glb.4242.tmp"
    kept = copied / "out" / "heavy" / ".notes.tmp"
    stale.write_bytes(b"x"), kept.write_bytes(b"x")
    again(copied)
    assert not stale.exists() and kept.exists()


def test_an_interrupt_leaves_everything_consistent(made, tmp_path, interruptible):
    """Ctrl-C reaches all processes of the terminal."""
    words = [
        sys.executable,
        "-m",
        "retarget",
        "batch",
        str(made / "m"),
        str(made / "c"),
        "-o",
        str(tmp_path / "out"),
        *QUICK,
    ]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(words, start_new_session=True, stderr=subprocess.PIPE, env=environment)
    while (
        process.poll() is None
        and not (tmp_path / "out" / "heavy").exists()
        and not (tmp_path / "out" / "child").exists()
    ):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=300)[1].decode()
    assert process.returncode in (130, 0) and said == ("retarget: interrupted\n" if process.returncode else "")
    assert not [path for path in (tmp_path / "out").rglob(".*") if path.is_file()]
    summary = run_batch(Batch(made / "m", made / "c", tmp_path / "out", PLAIN, processes=2))
    assert not summary.failures and contents(tmp_path / "out") == contents(made / "out")
