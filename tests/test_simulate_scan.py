"""`retarget simulate-scan`, and what `info`, `picture` and `convert` make of captures."""

import json
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor, body
from scipy.spatial import cKDTree

from retarget.body.kinematics import world_pose
from retarget.body.skinning import bake, prepare_skinning
from retarget.geometry.sampling import sample_surface
from retarget.io import load, save, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A character with a clip, another without, the clip alone, and the moving surface."""
    folder = tmp_path_factory.mktemp("captures")
    motion = cut(embedded_motion("wave"), 0.5, 0.7)
    save(folder / "man.glb", actor().character, [motion])
    save(folder / "still.glb", actor().character, [])
    save(folder / "woman.glb", body("woman"), [])
    save(folder / "wave.bvh", actor().character, [motion])
    save_sequence(folder / "surface.npz", bake(actor().character, motion))
    return folder


@pytest.fixture
def here(files, tmp_path, monkeypatch):
    monkeypatch.chdir(files)
    return tmp_path


def off(cloud, vertices, faces=None):
    """How far points are from a surface, metres, but for the worst of a hundred."""
    surface = sample_surface(vertices, actor().character.mesh.faces if faces is None else faces, 100_000)
    return np.quantile(cKDTree(surface).query(cloud)[0], 0.99)


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_the_same_seed_gives_the_same_files_and_another_others(here, command):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        words = ["--holes", 0.3, "--outliers", 0.2, "--floor", "--points", 700]
        code, out, err = command("simulate-scan", "man.glb", "man.glb", "-o", here / name, "--seed", seed, *words)
        assert (code, err) == (0, ""), err
        assert out == f"{here / name}: 7 frames at 30 fps, 700 points, 4 cameras, seed {seed}; played as it is\n"
    assert list(contents(here / "a")) == [f"{number:04d}.ply" for number in range(7)]
    assert contents(here / "a") == contents(here / "b") != contents(here / "c")


@pytest.mark.parametrize("character", ["man.glb", "still.glb"])
def test_a_rig_that_matches_plays_the_motion_as_it_is(here, command, character):
    code, out, _ = command(
        "simulate-scan", "man.glb", character, "-o", here / "a.npz", "--noise", 0, "--holes", 0, "--outliers", 0
    )
    assert code == 0 and "played as it is" in out, out
    motion = cut(embedded_motion("wave"), 0.5, 0.7)
    posed = prepare_skinning(actor().character).vertices(*world_pose(motion))
    capture = load(here / "a.npz").clouds
    assert len(capture) == len(posed) and capture.fps == motion.fps
    away = [off(cloud, vertices) for vertices, cloud in zip(posed, capture.clouds)]
    assert max(away) < 0.005


def test_another_character_is_retargeted_as_run_does(here, command):
    code, out, _ = command(
        "simulate-scan",
        "man.glb",
        "woman.glb",
        "-o",
        here / "a.npz",
        "--noise",
        0,
        "--holes",
        0,
        "--outliers",
        0,
        "--fps",
        15,
    )
    assert code == 0 and "4 frames at 15 fps" in out and "retargeted" in out, out
    command("run", "man.glb", "woman.glb", "-o", here / "run.glb", "--fps", 15)
    result = load(here / "run.glb")
    posed = prepare_skinning(result.character).vertices(*world_pose(result.motion(0)))
    seconds = np.arange(len(posed)) / result.clips[0].fps  # few keys are read at 30 frames a second
    at = [np.abs(seconds - frame / 15).argmin() for frame in range(4)]
    for vertices, cloud in zip(posed[at], load(here / "a.npz").clouds.clouds):
        assert off(cloud, vertices, result.character.mesh.faces) < 0.005


def test_a_moving_surface_is_scanned_as_it_is_and_half_a_view_is_half(here, command):
    code, out, _ = command(
        "simulate-scan", "surface.npz", "surface.npz", "-o", here / "a", "--cameras", 1, "--format", "pcd", "--fps", 10
    )
    assert code == 0 and "7 frames at 10 fps, 6890 points, 1 camera, seed 0; played as it is" in out
    surface, clouds = load("surface.npz").sequence.vertices, load(here / "a").clouds.clouds
    assert sorted(path.suffix for path in (here / "a").iterdir()) == [".pcd"] * 7
    assert np.median(clouds[0][:, 2]) > np.median(surface[0, :, 2]), "the front alone"


def test_json_says_what_was_made(here, command):
    _, out, _ = command("simulate-scan", "man.glb", "man.glb", "-o", here / "a", "--points", 100, "--json")
    told = json.loads(out)
    assert (
        told["frames"] == 7
        and told["points"] == [100, 100]
        and told["cameras"] == 4
        and told["motion"] == "played as it is"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("man.glb man.glb -o OUT/a.glb", "a point sequence is written as .npz or a folder"),
        ("man.glb man.glb -o OUT/a.npz --format ply", "is an archive: --format does not apply"),
        ("man.glb man.glb -o OUT/a --format obj", "frames are written as ply or pcd, received 'obj'"),
        ("man.glb man.glb -o OUT/no/a", "does not exist"),
        ("man.glb man.glb -o OUT", "is there already"),
        ("man.glb man.glb -o OUT/a --fps 0", "--fps must be positive"),
        ("man.glb man.glb -o OUT/a --clip dance", "clip 'dance' is not in"),
        ("surface.npz surface.npz -o OUT/a --clip wave", "holds one mesh sequence: --clip does not apply"),
        ("surface.npz surface.npz -o surface.npz", "is read, as motion or character, and would be replaced"),
        ("woman.glb man.glb -o OUT/a", "holds no animation clip"),
        ("wave.bvh wave.bvh -o OUT/a", "has no surface that a scanner could see"),
        ("none.bvh man.glb -o OUT/a", "no such file"),
    ],
)
def test_one_line_says_what_is_wrong_and_nothing_is_written(here, files, command, words, said):
    before = contents(files)
    code, out, err = command("simulate-scan", *words.replace("OUT", str(here)).split())
    assert code == 2 and out == "" and err.count("\n") == 1, (code, out, err)
    assert said in err and list(here.iterdir()) == [] and contents(files) == before


def test_python_callers_are_told_too(here, monkeypatch):
    from retarget import commands_capture
    from retarget.commands_capture import CaptureOrder, simulate_scan
    from retarget.errors import RetargetError

    with pytest.raises(RetargetError, match="a seed is not negative"):
        simulate_scan(CaptureOrder(Path("man.glb"), Path("man.glb"), here / "a", seed=-1))
    monkeypatch.setattr(commands_capture, "LARGEST", 1000)
    with pytest.raises(RetargetError, match="7 frames of 6890 points are more than is kept in memory"):
        simulate_scan(CaptureOrder(Path("man.glb"), Path("man.glb"), here / "a"))
    assert list(here.iterdir()) == []


def test_who_is_no_human_plays_its_own_clip(here, command):
    from gltf_maker import worm

    worm(clips=1).glb(here / "worm.glb")
    code, out, err = command(
        "simulate-scan", here / "worm.glb", here / "worm.glb", "-o", here / "a.npz", "--points", 200
    )
    assert code == 0 and "played as it is" in out and err == "", (out, err)
    cloud = load(here / "a.npz").clouds.clouds[0]
    worm_mesh = load(here / "worm.glb").character.mesh.vertices
    assert (
        len(cloud) == 200
        and np.isfinite(cloud).all()
        and np.ptp(cloud, axis=0).max() < 3 * np.ptp(worm_mesh, axis=0).max()
    )


@pytest.mark.parametrize(
    ("frames", "said"), [(0, "man.glb: holds no frames"), (2, "man.glb: a surface without area cannot be scanned")]
)
def test_what_no_scanner_sees_is_told(here, command, monkeypatch, frames, said):
    from retarget import commands_capture
    from retarget.commands_capture import Performance

    mesh = actor().character.mesh
    flat = Performance(mesh, frames, 30.0, "", lambda chosen: np.zeros((len(chosen), len(mesh.vertices), 3)))
    monkeypatch.setattr(commands_capture, "_performance", lambda order: flat)
    code, _, err = command("simulate-scan", "man.glb", "man.glb", "-o", here / "a")
    assert code == 2 and said in err and err.count("\n") == 1 and list(here.iterdir()) == []


def test_a_write_that_fails_leaves_nothing(here, command, monkeypatch):
    from retarget.io import point_folder

    def full(file, cloud):
        file.write(b"some")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(point_folder, "write_points", full)
    code, _, err = command("simulate-scan", "man.glb", "man.glb", "-o", here / "a", "--points", 100)
    assert code == 2 and err.count("\n") == 1 and "No space left" in err and list(here.iterdir()) == []


@pytest.fixture(scope="module")
def capture(files):
    from retarget.cli_capture import simulate_scan

    folder = files / "capture"
    simulate_scan(files / "man.glb", files / "man.glb", folder, points=800, fps=None, clip=None, form=None)
    (folder / "0002.ply").write_text("ply?")
    yield folder
    import shutil

    shutil.rmtree(folder)


def test_info_tells_of_a_capture(capture, command):
    code, out, _ = command("info", capture)
    assert code == 0 and "point sequence" in out
    assert "points     800 on a usual frame, 0 to 800, 1 frames empty" in out
    assert "7 frames at 30 fps" in out and "1 of 7 files cannot be read and stand as empty frames (0002.ply: " in out


def test_picture_shows_points(capture, here, command):
    from PIL import Image

    code, _, err = command("picture", capture, capture / "0000.ply", "-o", here / "a.png", "--size", 128, "--frames", 3)
    assert code == 0, err
    assert (np.asarray(Image.open(here / "a.png")).min(axis=2) < 150).sum() > 500, "dots are drawn"


def test_convert_leads_from_folder_to_archive_and_back(capture, here, command):
    assert command("convert", capture, here / "a.npz", "--fps", 24)[0] == 0
    code, out, _ = command("convert", here / "a.npz", here / "b")
    assert code == 0 and "0 to 800 points, 'a': 7 frames at 24 fps" in out
    back, first = load(here / "b").clouds.clouds, load(capture).clouds.clouds
    assert all(np.array_equal(one, other) for one, other in zip(back, first))
    assert command("convert", here / "b", here / "c.npz", "--unit", 0.5, "--up", "+z")[0] == 0
    turned = load(here / "c.npz").clouds.clouds
    assert np.allclose(turned[0][:, 1], 0.5 * first[0][:, 2], atol=1e-6) and len(turned[2]) == 0
    assert command("convert", capture / "0000.ply", here / "d.pcd")[0] == 0
    assert np.array_equal(load(here / "d.pcd").points.points, first[0].astype(float))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("convert CAPTURE OUT/a.glb", "a point sequence is written as .npz or a folder"),
        ("convert CAPTURE OUT/a.npz --clip x", "holds one point sequence: --clip does not apply"),
        ("convert CAPTURE/0000.ply OUT/a.obj", "holds points without faces; write them as .ply or .pcd"),
        ("convert man.ply OUT/a.pcd", "holds a surface, and .pcd has no faces"),
        ("repair CAPTURE -o OUT/a.glb", "holds a point sequence, a capture without joints to follow"),
    ],
)
def test_what_a_capture_cannot_be(capture, here, files, command, words, said):
    from retarget.io.obj_ply import save as save_surface

    save_surface(files / "man.ply", actor().character.mesh)
    code, out, err = command(*words.replace("OUT", str(here)).replace("CAPTURE", str(capture)).split())
    assert code == 2 and out == "" and err.count("\n") == 1 and said in err, (code, out, err)
    assert list(here.iterdir()) == []
