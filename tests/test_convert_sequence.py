"""`retarget convert` with surfaces that move without a skeleton."""

import numpy as np
import pytest
from made_motions import actor

from retarget.commands_convert import Conversion, convert_file
from retarget.errors import FileError
from retarget.io import load, save
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion


@pytest.fixture
def waving(tmp_path):
    path = tmp_path / "waving.glb"
    save(path, actor().character, [cut(embedded_motion("wave"), 0.5, 0.8)])
    return path


@pytest.mark.parametrize("name", ["frames", "frames.npz"])
def test_a_character_is_baked(waving, tmp_path, name):
    report = convert_file(Conversion(waving, tmp_path / name))
    baked = load(tmp_path / name).sequence
    assert report["files"][0]["clips"][0]["frames"] == len(baked) == 10
    assert np.abs(baked.vertices[0] - baked.vertices[-1]).max() > 0.01


def test_from_frames_to_gltf_and_back(waving, tmp_path):
    convert_file(Conversion(waving, tmp_path / "frames"))
    convert_file(Conversion(tmp_path / "frames", tmp_path / "again.glb", fps=24.0, unit=1.0, up="+y"))
    convert_file(Conversion(tmp_path / "again.glb", tmp_path / "last.npz"))
    first, last = load(tmp_path / "frames").sequence, load(tmp_path / "last.npz").sequence
    assert last.fps == 24.0 and np.abs(first.vertices - last.vertices).max() < 1e-6


def test_units_and_axes_are_applied(waving, tmp_path):
    convert_file(Conversion(waving, tmp_path / "frames"))
    convert_file(Conversion(tmp_path / "frames", tmp_path / "turned.npz", unit=0.01, up="+z"))
    here, there = (load(tmp_path / name).sequence.vertices for name in ("frames", "turned.npz"))
    assert np.allclose(np.ptp(there[0], axis=0).max(), 0.01 * np.ptp(here[0], axis=0).max(), rtol=1e-5)
    assert np.abs(there[..., 1] - 0.01 * here[..., 2]).max() < 1e-6, "what was +z is up"


@pytest.mark.parametrize(
    ("source", "order", "said"),
    [
        ("still", {}, "whose surface does not move"),
        ("frames", {"clip": "walk"}, "--clip does not apply"),
        ("frames", {"output": "x.glb"}, "no joints that show it; give --up and --unit"),
        ("frames", {"output": "x.obj"}, r"written as .glb, .gltf, .npz or a folder, as USD or Alembic"),
    ],
)
def test_what_does_not_fit_is_told(waving, tmp_path, source, order, said):
    convert_file(Conversion(waving, tmp_path / "frames"))
    save(tmp_path / "still.glb", actor().character, [])
    path = tmp_path / ("still.glb" if source == "still" else "frames")
    output = tmp_path / order.pop("output", "out.npz")
    with pytest.raises(FileError, match=said):
        convert_file(Conversion(path, output, **order))
    assert not output.exists()
