"""Presets of the programs that results go to."""

import pytest

from retarget.errors import RetargetError
from retarget.io import WRITTEN_SUFFIXES
from retarget.io.presets import PRESETS, preset


@pytest.mark.parametrize(
    ("name", "fps", "rate"),
    [("unreal", 120.0, 60.0), ("unreal", 30.0, 30.0), ("unreal", 29.97, 30.0), ("unreal", 29.0, 25.0), ("unreal", 12.0, 24.0),
     ("unity", 119.88, 119.88), ("blender", 30.0, 24.0), ("godot", 120.0, 60.0)],
)  # fmt: skip
def test_a_rate_that_the_program_plays(name, fps, rate):
    assert preset(name).rate(fps) == rate


def test_every_preset_names_a_format_that_is_written():
    assert {each.suffix for each in PRESETS.values()} <= set(WRITTEN_SUFFIXES)


def test_an_unknown_preset_is_told_with_the_nearest():
    with pytest.raises(RetargetError, match="preset 'unrael' is not in this version; nearest: 'unreal'"):
        preset("unrael")
