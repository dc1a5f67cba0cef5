"""Points over time in glTF: the same ones on every frame, as morph targets of a mesh of points."""

import numpy as np
import pytest
from test_gltf_write import errors_found

from retarget.character import PointMotion
from retarget.errors import FileError
from retarget.io import save_sequence

MOVING = PointMotion(tuple(np.random.default_rng(3).normal(size=(4, 30, 3)).astype(np.float32)), 24.0, "dust")


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_equal_points_give_equal_bytes(tmp_path, suffix):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        save_sequence(tmp_path / name / f"dust.{suffix}", MOVING, tracked=True)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_the_khronos_validator_finds_no_error(tmp_path):
    save_sequence(tmp_path / "dust.glb", MOVING, tracked=True)
    assert errors_found(tmp_path / "dust.glb") == [[]]


@pytest.mark.parametrize("clouds", [(MOVING.clouds[0], MOVING.clouds[1][:5]), (MOVING.clouds[0][:0],)])
def test_frames_of_other_points_are_refused_and_leave_nothing(tmp_path, clouds):
    with pytest.raises(FileError, match="the same points on every frame"):
        save_sequence(tmp_path / "dust.glb", PointMotion(clouds), tracked=True)
    assert not list(tmp_path.iterdir())
