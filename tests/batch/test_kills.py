"""Killed at any moment and started again, a batch loses nothing, repeats nothing and leaves nothing half-written."""

import os

import pytest
from made_folders import make_characters, make_motions

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills process groups")


@pytest.mark.slow
def test_kills_lose_nothing(tmp_path):
    from batch_kills import kill_and_resume

    make_motions(tmp_path / "m")
    make_characters(tmp_path / "c")
    report = kill_and_resume(tmp_path, kills=4, seed=1)
    assert report["kills"] == 4 and report["batch_lost"] == 0, report
