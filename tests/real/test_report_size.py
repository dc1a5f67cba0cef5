"""The report's page on the biggest character at hand."""

import pytest


@pytest.mark.slow
def test_ten_seconds_of_the_biggest_character_are_less_than_eight_megabytes(data, tmp_path, command):
    motion, made, page = data / "motions/cmu_daz/02_10.bvh", tmp_path / "made.glb", tmp_path / "page.html"
    part = ("--start", "0", "--end", "10")
    for words in (
        ("run", motion, data / "characters/godot/mannequiny.glb", "-o", made, "--method", "copy-rotations", *part),
        ("report", made, motion, "-o", page, *part),
    ):
        code, _, err = command(*words)
        assert code == 0, err
    assert 1e6 < page.stat().st_size < 8e6, "2.5 MB where it was measured"
