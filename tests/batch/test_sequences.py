"""Mesh sequences and captures as motions of a batch. Whom they show is known at once here (`crew_tasks.known_bodies`)."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_bodies import box_figure
from made_folders import QUICK, contents, follows_at_once, known_rig, make_characters, records, short
from made_motions import body, fingerless, walk

from retarget import performing
from retarget.batch import work
from retarget.batch.plan import (
    Clips,
    Input,
    Job,
    content_hash,
    find_inputs,
    plan_jobs,
    refuse_overwriting,
    stamps,
    unchanged,
)
from retarget.batch.run import Batch, _Waiting, run_batch
from retarget.batch.work import Bench, Settings, retarget_clip
from retarget.body.skinning import bake
from retarget.character import PointMotion
from retarget.errors import FileError, RetargetError
from retarget.io import load, save, save_sequence
from retarget.motion.align import Actor
from retarget.motion.filter import cut
from retarget.retargeting import Production

PLAIN = Settings(method="copy-rotations")


def sequence(name="", seconds=0.1):
    return replace(bake(box_figure(), fingerless(cut(walk(), 0.0, seconds))), name=name)


def capture(frames=4):
    return PointMotion(tuple(np.random.default_rng(frame).random((50, 3)) for frame in range(frames)), 30.0, "")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Motions of every kind, two characters, and what a batch made of them."""
    folder = tmp_path_factory.mktemp("sequences")
    (folder / "m" / "deep").mkdir(parents=True)
    save(folder / "m" / "walk.bvh", fingerless(body()), [short(walk(), "walk")])
    save_sequence(folder / "m" / "boxes", sequence())
    save_sequence(folder / "m" / "deep" / "file.npz", sequence())
    save_sequence(folder / "made", sequence(seconds=0.14))
    (folder / "made").rename(folder / "m" / "deep" / "run.01")
    save_sequence(folder / "m" / "scan", capture())
    make_characters(folder / "c")
    summary = batch(folder)
    assert not summary.failures and summary.done_before == 0 and not summary.passed_over
    return folder


MOTIONS = ("boxes", "deep/file", "deep/run.01", "scan", "walk")
NAMES = sorted(f"{character}/{motion}.glb" for character in ("heavy", "child") for motion in MOTIONS)


@pytest.fixture
def copied(made, tmp_path):
    shutil.copytree(made, tmp_path / "b")  # times of files are kept
    return tmp_path / "b"


def batch(folder, motions="m", out="out", **others):
    made = Batch(folder / motions, folder / "c", folder / out, **{"settings": PLAIN, "processes": 1} | others)
    return run_batch(made, work="crew_tasks:known_bodies")


def again(folder, **others):
    """Run the batch once more: what was made."""
    before = len(records(folder / "out"))
    assert not batch(folder, **others).failures
    return sorted(record["output"] for record in records(folder / "out")[before:])


def test_sequences_and_captures_are_put_onto_every_character(made):
    assert sorted(contents(made / "out")) == NAMES
    clips = {name: load(made / "out" / "child" / f"{name}.glb").clips for name in MOTIONS}
    assert {name: (clip.name, clip.frames, clip.fps) for name, (clip,) in clips.items()} == {
        "boxes": ("boxes", 4, 30.0),
        "deep/file": ("file", 4, 30.0),
        "deep/run.01": ("run.01", 5, 30.0),
        "scan": ("scan", 4, 30.0),
        "walk": ("walk", 16, 30.0),
    }
    assert clips["deep/run.01"][0].made_from.file == "run.01"
    notes = [record["notes"] for record in records(made / "out") if record["output"] == "child/boxes.glb"][0]
    assert "source: 4 files taken as frames at 30 a second, which a folder does not tell (--fps)" in notes


def test_the_results_are_those_of_run(made, tmp_path, command, monkeypatch):
    monkeypatch.setattr(performing, "rig", known_rig)
    monkeypatch.setattr(performing, "cast_scan", follows_at_once)
    for motion in ("boxes", "scan"):
        words = ("run", made / "m" / motion, made / "c" / "child.glb", "-o", tmp_path / "r.glb", *QUICK[:2])
        assert command(*words)[0] == 0
        assert (tmp_path / "r.glb").read_bytes() == (made / "out" / "child" / f"{motion}.glb").read_bytes()


def test_the_characters_of_one_sequence_follow_each_other(made):
    order = [record["done"][0] for record in records(made / "out") if record["done"][0] != "walk.bvh"]
    assert order[::2] == order[1::2], "its performer is ready"


def test_a_process_goes_on_with_its_performer():
    names = {"motion": ("a", "b"), "character": ("x", "y")}
    at = lambda name: Input(Path("/" + name), name)  # noqa: E731
    jobs = [Job(at(a), 0, "", at(x), "", moving=True) for x in names["character"] for a in names["motion"]]
    waiting = _Waiting(jobs)
    first, second = waiting.take(None), waiting.take(None)
    assert {first.motion.name, second.motion.name} == {"a", "b"}, "two processes make two performers"
    assert waiting.take(first).motion == first.motion and waiting.take(second).motion == second.motion
    assert waiting.take(first) is None


# --- what is done again -------------------------------------------------------------------------------------------


def test_a_finished_batch_is_not_done_again(copied):
    assert again(copied) == []


@pytest.mark.parametrize("change", ["add", "remove", "write"])
def test_a_frame_more_or_less_or_another_does_that_motion_again(copied, change):
    frames = copied / "m" / "boxes"
    if change == "add":
        shutil.copy(frames / "0000.ply", frames / "0004.ply")
    elif change == "remove":
        (frames / "0003.ply").unlink()
    else:
        shutil.copy(frames / "0000.ply", frames / "0003.ply")
    assert again(copied) == ["child/boxes.glb", "heavy/boxes.glb"]
    wanted = {"add": 5, "remove": 3, "write": 4}[change]
    assert load(copied / "out" / "child" / "boxes.glb").clips[0].frames == wanted


def test_frames_that_were_only_touched_are_not_done_again(copied):
    for path in (copied / "m" / "boxes").iterdir():
        path.touch()
    (copied / "m" / "boxes" / "notes.txt").write_text("no frame")
    assert again(copied) == []


def test_stamps_and_hash_of_a_folder_know_every_frame(tmp_path):
    folder = tmp_path / "s"
    save_sequence(folder, sequence())
    marks, known = stamps(folder), {content_hash(folder)}
    assert unchanged(folder, json.loads(json.dumps(marks))) and marks[0][0] == "s"
    (folder / ".hidden.ply").write_bytes(b"x"), (folder / "notes.txt").write_bytes(b"x")
    assert unchanged(folder, marks) and content_hash(folder) in known
    (folder / "0001.ply").rename(folder / "0009.ply")
    assert not unchanged(folder, marks)
    known.add(content_hash(folder))
    (folder / "0009.ply").write_bytes(b"x")
    known.add(content_hash(folder))
    (folder / "more.obj").write_bytes(b"x")
    known.add(content_hash(folder))
    (folder / "0009.ply").unlink()
    known.add(content_hash(folder))
    assert len(known) == 5
    shutil.rmtree(folder)
    assert not unchanged(folder, marks)
    folder.write_bytes(b"x")
    assert not unchanged(folder, marks)


def test_another_rate_is_that_of_the_frames_and_a_preset_s_is_not(made, tmp_path):
    shutil.copytree(made / "m" / "boxes", tmp_path / "m" / "boxes")
    shutil.copytree(made / "c", tmp_path / "c")
    for settings, fps in ((replace(PLAIN, fps=10.0), 10.0), (replace(PLAIN, engine="blender"), 30.0)):
        assert not batch(tmp_path, settings=settings).failures
        assert [(each["frames"], each["fps"]) for each in records(tmp_path / "out")[-2:]] == [(4, fps)] * 2
        assert load(tmp_path / "out" / "child" / "boxes.glb").motion(0).seconds == pytest.approx(3 / fps)


# --- failures -----------------------------------------------------------------------------------------------------


def test_broken_frames_are_told_in_the_table_and_the_rest_is_done(made, tmp_path, command, monkeypatch):
    monkeypatch.setattr("retarget.commands_batch.WORK", "crew_tasks:known_bodies")
    shutil.copytree(made / "m" / "boxes", tmp_path / "m" / "good")
    (tmp_path / "m" / "broken").mkdir()
    for number in range(3):
        (tmp_path / "m" / "broken" / f"{number}.ply").write_text("nothing")
    code, out, err = command("batch", tmp_path / "m", made / "c", "-o", tmp_path / "o", *QUICK)
    assert (code, err) == (1, "") and "2 clips made" in out and "1 failed:" in out
    row = next(line for line in out.splitlines() if line.strip().startswith("broken"))
    assert "(every one)" in row and "3 of its 3 files cannot be read as frames" in row
    assert sorted(contents(tmp_path / "o")) == ["child/good.glb", "heavy/good.glb"]


def task(made, motion, output, character="heavy"):
    paths = [made / "m" / motion, made / "c" / f"{character}.glb"]
    told = {"motion": str(paths[0]), "clip": 0, "character": str(paths[1]), "output": str(output)}
    return told | {"inputs": [content_hash(path) for path in paths]}


def test_frames_that_change_meanwhile_are_not_taken_for_what_they_were(copied, tmp_path):
    told = task(copied, "boxes", tmp_path / "x.glb")
    (copied / "m" / "boxes" / "0003.ply").unlink()
    with pytest.raises(RetargetError, match="boxes: was changed while the batch ran"):
        retarget_clip(told, PLAIN, Bench())


# --- the performer ------------------------------------------------------------------------------------------------


def test_a_performer_is_cast_once_and_let_go_with_its_motion(made, tmp_path, monkeypatch):
    cast, surfaces = [], []
    real, perform = work.cast_moving, Production.__call__
    monkeypatch.setattr(performing, "rig", known_rig)
    monkeypatch.setattr(performing, "cast_scan", follows_at_once)
    monkeypatch.setattr(work, "cast_moving", lambda asset, *rest: cast.append(asset.path.name) or real(asset, *rest))
    monkeypatch.setattr(
        Production, "__call__", lambda self, *given: surfaces.append(given[2]) or perform(self, *given)
    )
    bench = Bench()
    for motion, character in (("boxes", "heavy"), ("boxes", "child"), ("walk.bvh", "child"), ("boxes", "child")):
        retarget_clip(task(made, motion, tmp_path / "x.glb", character), PLAIN, bench)
        assert (bench.performing[1] is None) == (motion == "walk.bvh")
    assert cast == ["boxes", "boxes"]
    assert [None if each is None else each.shape[0] for each in surfaces] == [4, 4, None, 4]
    retarget_clip(task(made, "boxes", tmp_path / "x.glb", "child"), replace(PLAIN, fps=10.0), bench)
    assert len(cast) == 3, "another rate is another motion"
    retarget_clip(task(made, "scan", tmp_path / "x.glb", "child"), PLAIN, bench)
    assert surfaces[-1] is None and cast[3:] == ["scan"]


def test_a_pair_is_prepared_for_the_kind_of_performer(made, tmp_path, monkeypatch):
    """Methods are chosen, and set, by it."""
    kinds, real = [], work.prepare
    monkeypatch.setattr(performing, "rig", known_rig)
    monkeypatch.setattr(performing, "cast_scan", follows_at_once)
    told = lambda source, *rest, **own: kinds.append(type(source)) or real(source, *rest, **own)  # noqa: E731
    monkeypatch.setattr(work, "prepare", told)
    bench = Bench()
    for motion in ("boxes", "scan", "walk.bvh"):
        retarget_clip(task(made, motion, tmp_path / "x.glb"), PLAIN, bench)
    assert kinds == [performing.Performer, performing.ScanPerformer, Actor]


def test_a_sequence_that_shows_nobody_is_tried_once(made, tmp_path, monkeypatch):
    tried = []

    def nobody(mesh, unit=None, tell=None):
        tried.append(1)
        raise RetargetError("nobody")

    monkeypatch.setattr(performing, "rig", nobody)
    bench = Bench()
    for character in ("heavy", "child"):
        with pytest.raises(RetargetError, match="boxes: none of its 4 frames that were tried can be rigged"):
            retarget_clip(task(made, "boxes", tmp_path / "x.glb", character), PLAIN, bench)
    assert len(tried) == 4 and not list(tmp_path.iterdir())


# --- which folders are motions ------------------------------------------------------------------------------------


def names(folder, without=Path("nowhere"), sequences=True):
    return [(each.name, each.is_folder) for each in find_inputs(folder, without, sequences)]


def test_a_folder_of_frames_is_one_motion_at_any_depth(tmp_path):
    for folder in ("top", "top/top", "top/b/c2", "top/b/c10", "top/.hidden", "top/points", "top/mixed", "top/motions"):
        (tmp_path / folder).mkdir(parents=True)
        for number in (1, 2):
            (tmp_path / folder / f"{number}.ply").write_text("")
    (tmp_path / "top" / "alone").mkdir()
    (tmp_path / "top" / "alone" / "statue.ply").write_text("")
    for number in (1, 2):
        (tmp_path / "top" / "points" / f"{number}.ply").unlink()
        np.savez(tmp_path / "top" / "points" / f"{number}.npz", points=np.zeros((5, 3)))
    np.savez(tmp_path / "top" / "mixed" / "2.npz", points=np.zeros((5, 3)))
    np.savez(tmp_path / "top" / "motions" / "poses.npz", poses=np.zeros((5, 3)))
    below = [("b/c2", True), ("b/c10", True), ("mixed", True), ("motions/poses.npz", False), ("points", True)]
    assert names(tmp_path / "top") == [("./top", True), *below, ("top", True)]
    shutil.rmtree(tmp_path / "top" / "top")
    assert names(tmp_path / "top") == [*below, ("top", True)]
    (tmp_path / "top" / "walk.bvh").write_text("")
    assert names(tmp_path / "top") == [*below, ("walk.bvh", False)], "beside a motion they are none"
    assert names(tmp_path / "top", without=tmp_path / "top" / "b") == [*below[2:], ("walk.bvh", False)]
    assert names(tmp_path / "top" / "b" / "..") == names(tmp_path / "top")
    assert names(tmp_path / "top", sequences=False) == [
        (name, False) for name in ("mixed/2.npz", "motions/poses.npz", "points/1.npz", "points/2.npz", "walk.bvh")
    ]


def test_a_folder_without_motion_is_refused(tmp_path):
    with pytest.raises(FileError, match=r"the folder holds no motion: no file of one \(.bvh, .*\) and no frames \(.obj"):
        find_inputs(tmp_path, Path("nowhere"), sequences=True)


def test_results_are_called_as_the_folder(tmp_path):
    for folder in ("run.01", "run.02", "walk"):
        (tmp_path / folder).mkdir()
    (tmp_path / "c.glb").write_bytes(b""), (tmp_path / "walk.bvh").write_bytes(b"")
    motions = ("run.01", "run.02", "walk", "walk.bvh")
    inputs = [Input(tmp_path / name, name, is_folder=name != "walk.bvh") for name in motions]
    jobs = plan_jobs([Clips(each, ("",)) for each in inputs], [Input(tmp_path / "c.glb", "c.glb")], ".glb", [])
    assert [job.output for job in jobs] == ["c/run.01.glb", "c/run.02.glb", "c/walk.glb", "c/walk_bvh.glb"]


def test_no_result_lies_among_frames(tmp_path):
    (tmp_path / "heavy").mkdir()
    frames, character = Input(tmp_path / "heavy", "heavy", True), Input(tmp_path / "c" / "heavy.glb", "heavy.glb")
    job = Job(frames, 0, "heavy", character, "heavy/heavy.glb", True)
    with pytest.raises(RetargetError, match="would lie among frames that are read"):
        refuse_overwriting([job], [frames, character], tmp_path)
    refuse_overwriting([job], [frames, character], tmp_path / "out")
