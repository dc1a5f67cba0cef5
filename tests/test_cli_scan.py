"""`retarget skeleton` and `retarget stream`, as their users call them."""

import json
import socket
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_scans import StandIn, capture

from retarget.body.human import human
from retarget.body.kinematics import world_pose
from retarget.io import load, save
from retarget.io.asset import Asset
from retarget.io.cloud_stream import frame_bytes
from retarget.motion.library import embedded_motion, performer

FRAMES = 6


@pytest.fixture(scope="module")
def walk():
    motion = embedded_motion("walk")
    cut = replace(motion, rotations=motion.rotations[30 : 30 + FRAMES], translations=motion.translations[30 : 30 + FRAMES])
    return capture(performer(), cut, points=4000)


@pytest.fixture
def known(walk, monkeypatch):
    """The regressor that comes with the program knows this walk, and `capture` is a folder with it."""
    monkeypatch.setattr("retarget.methods.scan.starts.own_regressor", lambda: StandIn(walk))
    monkeypatch.setattr("retarget.live.own_regressor", lambda: StandIn(walk))
    asset = Asset(Path("capture"), "point sequence", clouds=walk.clouds)
    real = load
    fake = lambda path, **more: asset if Path(path).name == "capture" else real(path, **more)  # noqa: E731
    monkeypatch.setattr("retarget.commands_scan.load", fake)
    monkeypatch.setattr("retarget.commands_run.load", fake)
    return asset


@pytest.fixture(scope="module")
def hero(tmp_path_factory):
    path = tmp_path_factory.mktemp("hero") / "hero.glb"
    save(path, human(weight=0.9), [])
    return path


def test_a_skeleton_is_written(command, known, walk, tmp_path):
    code, out, err = command("skeleton", "capture", "-o", tmp_path / "walk.bvh")
    assert code == 0, err
    assert "6 frames at 30 fps" in out
    motion = load(tmp_path / "walk.bvh").motion()
    names = walk.character.skeleton.names[:22]
    assert sorted(motion.skeleton.names) == sorted(names) and len(motion) == FRAMES
    places = world_pose(motion)[1][:, [motion.skeleton.index(name) for name in names]]
    assert np.linalg.norm(places - walk.places[:, :22], axis=2).mean() < 0.02


def test_a_body_is_written_with_its_surface(command, known, tmp_path):
    code, out, err = command("skeleton", "capture", "-o", tmp_path / "walk.glb", "--body", "--start", "0.1", "--json")
    assert code == 0, err
    asset = load(tmp_path / "walk.glb")
    assert asset.character.skin is not None and asset.clips[0].frames == 3 and json.loads(out)["shown"] == 3


def test_run_takes_a_capture(command, known, hero, tmp_path):
    code, out, err = command("run", "capture", hero, "-o", tmp_path / "out.glb", "--method", "copy-rotations")
    assert code == 0, err
    assert load(tmp_path / "out.glb").clips[0].frames == FRAMES
    assert command("run", "capture", hero, "-o", tmp_path / "x.glb", "--clip", "a")[2].strip().endswith("--clip does not apply")


def test_a_skeleton_comes_of_captures_only(command, hero, tmp_path):
    code, _, err = command("skeleton", hero, "-o", tmp_path / "a.bvh")
    assert code == 2 and "a capture is needed" in err and not (tmp_path / "a.bvh").exists()


def streamed(walk):
    return b"".join(frame_bytes(cloud) for cloud in walk.clouds.clouds)


def check_lines(path):
    head, *lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(head["joints"]) == len(lines[0]["rotations"]) == 52
    assert [line["frame"] for line in lines] == list(range(FRAMES))
    assert [line["status"] for line in lines] == ["found"] + ["followed"] * (FRAMES - 1)


def test_a_file_is_streamed_and_may_end_within_a_frame(command, known, walk, hero, tmp_path):
    (tmp_path / "clouds").write_bytes(streamed(walk) + b"\x05\0\0\0abc")
    code, _, err = command("stream", "--in", tmp_path / "clouds", "--target", hero, "-o", tmp_path / "p", "--method", "copy-rotations")
    assert code == 0, err
    assert "6 frames (5 followed, 1 found)" in err and "ended within a frame" in err and "p99" in err
    check_lines(tmp_path / "p")


def test_a_socket_of_this_machine_is_listened_on(command, known, walk, hero, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def send():
        for _ in range(200):
            try:
                with socket.create_connection(("127.0.0.1", port)) as to:
                    to.sendall(streamed(walk))
                    return
            except OSError:
                time.sleep(0.05)

    thread = threading.Thread(target=send)
    thread.start()
    code, _, err = command("stream", "--in", f"127.0.0.1:{port}", "--target", hero, "-o", tmp_path / "p", "--method", "copy-rotations")
    thread.join()
    assert code == 0, err
    check_lines(tmp_path / "p")


@pytest.mark.parametrize(
    "source, said", [("0.0.0.0:7000", "listens on this machine only"), ("nowhere/clouds", "cannot be read: No such file")]
)
def test_streams_that_cannot_begin_are_refused(command, known, hero, tmp_path, source, said):
    code, _, err = command("stream", "--in", source, "--target", hero, "-o", tmp_path / "p")
    assert code == 2 and said in err and err.count("\n") == 1
