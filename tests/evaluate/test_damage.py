"""The count of damaged files: what is read, refused, raises, goes down and hangs is told apart."""

import numpy as np
import pytest

from retarget.character import Mesh
from retarget.evaluate import damage
from retarget.io.obj_ply import save


@pytest.fixture
def seed(tmp_path):
    path = tmp_path / "seed.obj"
    save(path, Mesh(np.random.default_rng(0).normal(size=(40, 3)), np.arange(39).reshape(13, 3)))
    return path


def test_damaged_surfaces_are_read_or_refused(seed, tmp_path):
    folder = tmp_path / "damaged"
    folder.mkdir()
    found = damage.outcomes([seed], 150, folder, 0)
    assert found.crashes == found.hangs == 0
    assert found.read > 5 and found.refused > 5 and found.read + found.refused == 150


def test_the_same_damage_every_time(seed):
    first, second = (damage.damaged(seed.read_bytes(), np.random.default_rng(7)) for _ in range(2))
    assert first == second != seed.read_bytes()


def test_readers_that_fail_are_counted(seed, tmp_path, monkeypatch):
    """A stand-in for the reading process: it reads one, raises on one, goes down on the third and hangs on the fifth."""
    program = tmp_path / "reader.py"
    program.write_text(
        "import sys, time, os\n"
        "for number in range(int(sys.argv[3]), int(sys.argv[4])):\n"
        "    if number == 2: os._exit(9)\n"
        "    if number == 4: time.sleep(30)\n"
        "    print('raised' if number == 1 else 'read', flush=True)\n"
    )
    real = damage.subprocess.Popen
    monkeypatch.setattr(damage, "SECONDS", 1.0)
    monkeypatch.setattr(damage.threading, "Timer", lambda seconds, end, timer=damage.threading.Timer: timer(min(seconds, 1.0), end))
    monkeypatch.setattr(
        damage.subprocess, "Popen", lambda command, **how: real([command[0], str(program), *command[3:]], **how)
    )
    folder = tmp_path / "damaged"
    folder.mkdir()
    assert damage.outcomes([seed], 7, folder, 0) == damage.Outcomes(read=4, refused=0, crashes=2, hangs=1)
