"""Mesh sequences as motions: rigged, fitted, and given to a character."""

from functools import cache

import numpy as np
import pytest

from retarget import commands_run, performing
from retarget.body.human import PRESETS, human
from retarget.body.skinning import bake, skin_motion
from retarget.character import Mesh, MeshMotion
from retarget.errors import RetargetError
from retarget.io import load, save, save_sequence
from retarget.motion.filter import cut_surface
from retarget.motion.fit import fit_motion
from retarget.motion.joint_frames import prepare_frames
from retarget.motion.library import embedded_motion, performer
from retarget.motion.touch.mend import frames_of
from retarget.performing import cast_sequence
from retarget.retargeting import retarget
from retarget.rig.rigging import rig


@cache
def sequence():
    motion = frames_of(embedded_motion("hands_on_hips"), np.arange(0, 80, 10))
    baked = bake(performer(), motion)
    return MeshMotion(Mesh(baked.mesh.vertices, baked.mesh.faces), baked.vertices, 10.0, "hips")


@cache
def heavy():
    return human(name="heavy", **PRESETS["heavy"])


@pytest.fixture(autouse=True)
def rigged_once(monkeypatch):
    """Rigging takes seconds; the one body of these tests is rigged once."""
    monkeypatch.setattr(performing, "rig", lambda mesh, unit=None, tell=None: _rigged(unit))


@cache
def _rigged(unit):
    return rig(sequence().mesh, unit=unit)


@cache
def cast_once():
    return cast_sequence(sequence())


def test_the_rig_follows_the_surface():
    made = cast_once()
    skin = skin_motion(made.actor.character, made.motion)
    away = np.linalg.norm(skin - made.surface, axis=-1)
    assert np.sqrt((away**2).mean()) < 0.02
    assert len(made.motion) == len(sequence()) and made.motion.fps == 10.0


def test_a_surface_lying_on_its_back_stands_up():
    """+Z up: the file's own axis is told, the surface is turned."""
    turned = sequence().vertices[:, :, [0, 2, 1]] * np.array([1, -1, 1], dtype=np.float32)
    lying = MeshMotion(Mesh(turned[0].astype(float), sequence().mesh.faces), turned, 10.0)
    from retarget.casting import Hints

    made = cast_sequence(lying, Hints(up="+z"))
    assert np.ptp(made.surface[0, :, 1]) == pytest.approx(np.ptp(sequence().vertices[0, :, 1]), rel=1e-3)
    with pytest.raises(RetargetError, match="up axis is one of"):
        cast_sequence(lying, Hints(up="up"))


def test_frames_that_are_not_finite_are_bridged_and_told(tmp_path):
    broken = sequence().vertices.copy()
    broken[3] = np.nan
    np.savez(tmp_path / "holes.npz", vertices=broken, faces=sequence().mesh.faces, fps=np.array(10.0))
    asset = load(tmp_path / "holes.npz")
    assert any("1 of 8 frames are not finite (3)" in note for note in asset.notes)
    middle = 0.5 * (sequence().vertices[2] + sequence().vertices[4])
    assert np.abs(asset.sequence.vertices[3] - middle).max() < 1e-6
    np.savez(tmp_path / "none.npz", vertices=np.full_like(broken, np.nan), faces=sequence().mesh.faces)
    with pytest.raises(RetargetError, match="none of the surface's 8 frames is finite"):
        load(tmp_path / "none.npz")


def test_nobody_is_refused(monkeypatch):
    tried = []

    def refuse(mesh, unit=None, tell=None):
        tried.append(float(mesh.vertices[0, 0]))
        raise RetargetError(f"no body in frame {len(tried)}")

    monkeypatch.setattr(performing, "rig", refuse)
    with pytest.raises(
        RetargetError, match="none of its 5 frames that were tried can be rigged; of the first: no body in frame 1"
    ):
        cast_sequence(sequence())
    assert len(set(tried)) == 5


def test_a_moving_surface_drives_a_character_by_shape_transfer():
    made = retarget(sequence(), heavy())
    assert len(made.surface) == len(made.motion) == len(sequence())
    assert np.isfinite(made.surface.vertices).all()
    assert retarget(sequence(), heavy(), method="copy-rotations").surface is None


def test_fitting_gives_back_the_motion_of_a_skin():
    motion = frames_of(embedded_motion("walk"), np.arange(0, 12, 3))
    surface = skin_motion(performer(), motion).astype(np.float64)
    frames = prepare_frames(performer())
    made = fit_motion(frames, surface, 30.0)
    assert np.linalg.norm(skin_motion(performer(), made) - surface, axis=-1).max() < 0.03
    with pytest.raises(RetargetError, match="vertices, the surface is an array of"):
        fit_motion(frames, surface[:, :-1], 30.0)
    surface[1, 0] = np.nan
    with pytest.raises(RetargetError, match="frame 1 are not finite"):
        fit_motion(frames, surface, 30.0)


def test_a_part_of_a_sequence():
    whole = sequence()
    assert len(cut_surface(whole, 0.2, 0.5)) == 4
    assert cut_surface(whole, None, None) is whole
    with pytest.raises(RetargetError, match="no frame lies between"):
        cut_surface(whole, 5.0, 6.0)


def test_one_command_from_frames_to_a_character_and_to_a_surface(tmp_path, command):
    save_sequence(tmp_path / "frames", sequence())
    save(tmp_path / "heavy.glb", heavy(), [])
    code, out, err = command(
        "run", tmp_path / "frames", tmp_path / "heavy.glb", "-o", tmp_path / "made.glb", "--fps", 10
    )
    assert code == 0, err
    made = load(tmp_path / "made.glb")
    assert made.motion().seconds == pytest.approx(0.7, abs=0.01) and "8 frames" in out and "10 fps" in out
    code, _, err = command(
        "run", tmp_path / "frames", tmp_path / "heavy.glb", "-o", tmp_path / "made.npz", "--surface", "--end", 0.1
    )
    assert code == 0, err
    assert len(load(tmp_path / "made.npz").sequence) == 4  # 30 frames a second are taken, folders do not tell


@pytest.mark.parametrize(
    "words, text",
    [
        (("-o", "made.npz", "--surface", "--animation-only"), "--animation-only does not apply"),
        (("-o", "made.fbx", "--surface"), "a mesh sequence is written as"),
        (("-o", "made.glb", "--clip", "walk"), "--clip does not apply"),
    ],
)
def test_what_a_surface_cannot_be_is_said_before_any_work(tmp_path, command, words, text):
    save_sequence(tmp_path / "frames", sequence())
    save(tmp_path / "heavy.glb", heavy(), [])
    made = [tmp_path / word if word.startswith("made") else word for word in words]
    code, _, err = command("run", tmp_path / "frames", tmp_path / "heavy.glb", *made)
    assert code == 2 and text in err and len(err.strip().splitlines()) == 1
    assert not list(tmp_path.glob("made*"))


def test_contacts_of_a_sequence_are_listed(tmp_path, command):
    save_sequence(tmp_path / "hips.npz", sequence())
    code, out, err = command("contacts", tmp_path / "hips.npz", "-o", tmp_path / "contacts.toml")
    assert code == 0, err
    assert "Hand" in out and (tmp_path / "contacts.toml").exists()
    save(tmp_path / "heavy.glb", heavy(), [])
    code, _, err = command(
        "run",
        tmp_path / "hips.npz",
        tmp_path / "heavy.glb",
        "-o",
        tmp_path / "a.glb",
        "--contacts",
        tmp_path / "contacts.toml",
        "--report",
        tmp_path / "a.html",
    )
    assert code == 0, err
    assert (tmp_path / "a.html").stat().st_size > 10_000
    assert load(tmp_path / "a.glb").clips[0].made_from.file == "hips.npz"


def test_a_sequence_brings_its_own_performer():
    with pytest.raises(RetargetError, match="source and clip do not apply"):
        retarget(sequence(), heavy(), clip="walk")


def test_a_folder_of_frames_is_one_motion_and_keeps_its_name(tmp_path):
    """Clouds in archives too, whose suffix motions have as well; and what follows a dot is no suffix of a folder."""
    (tmp_path / "a.glb").touch()
    for name in ("run.01", "run.02"):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "0.npz", points=np.zeros((5, 3)))
    folders = [tmp_path / "run.01", tmp_path / "run.02"]
    order = commands_run.Order(tuple(folders), tmp_path / "a.glb", tmp_path / "out")
    assert list(commands_run._motion_files(order.motions)) == folders
    names = [path.name for path in commands_run._result_files(folders, order)]
    assert names == ["run.01_a.glb", "run.02_a.glb"]
