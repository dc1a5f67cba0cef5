"""The container of Alembic files: rates, what wrote them, and the time of day taken out; no Blender is needed."""

import os
import struct

import numpy as np
import pytest
from ogawa_maker import ACYCLIC, container, sampling

from retarget.errors import FileError, RetargetError
from retarget.evaluate.damage import damage
from retarget.io import load
from retarget.io.ogawa import erase_date, read_archive

MUTATIONS = int(os.environ.get("RETARGET_MUTATIONS", 2000))


@pytest.fixture
def made(tmp_path):
    def write(content):
        path = tmp_path / "made.abc"
        path.write_bytes(content)
        return path

    return write


@pytest.mark.parametrize(
    ("cycle", "fps"),
    [(1 / 30, 30.0), (1 / 25, 25.0), (1001 / 24000, 24000 / 1001), (0.04170837, 23.97600), (np.float64(np.float32(1001 / 30000)), 30000 / 1001), (0.08, 12.5), (1.0, 1.0)],
)  # fmt: skip
def test_even_samples_keep_their_rate(made, cycle, fps):
    (grid,) = read_archive(made(container(sampling(7, cycle, 0.5)))).moving()
    assert grid.fps == pytest.approx(fps, rel=1e-7 if fps != 23.976 else 1e-5) and (grid.start, grid.frames) == (0.5, 7)


def test_samples_with_times_of_their_own_and_in_cycles(made):
    times = [0.0, 1 / 24, 3 / 24, 4 / 24]
    own, cyclic = (read_archive(made(container(each))).moving()[0] for each in (sampling(4, ACYCLIC, *times), sampling(5, 1 / 12, 1.0, 1.0 + 1 / 24)))
    assert (own.fps, own.frames, own.start) == (24.0, 5, 0.0)
    assert (cyclic.fps, cyclic.frames, cyclic.start) == (24.0, 5, 1.0)
    (between,) = read_archive(made(container(sampling(4, 1 / 16, 0.0, 1 / 24)))).moving()
    assert (between.fps, between.frames) == (48.0, 6), "the second cycle lies between the frames of the first"
    (long,) = read_archive(made(container(sampling(99_998, 1 / 12, 0.0, 1 / 24)))).moving()
    assert (long.fps, long.frames) == (24.0, 99_998)


def test_what_does_not_move_has_no_grid_and_equal_ones_are_one(made):
    assert read_archive(made(container())).moving() == []
    archive = read_archive(made(container(sampling(3, 0.04, 0.0), sampling(3, 0.04, 0.0), sampling(9, 0.02, 0.0))))
    assert [(grid.fps, grid.frames) for grid in archive.moving()] == [(25.0, 3), (50.0, 9)]
    assert archive.metadata["_ai_Application"] == "Maker"


def test_the_time_of_day_is_taken_out_and_nothing_else(made):
    content = container(sampling(3, 0.04, 0.0))
    path = made(content)
    erase_date(path)
    assert path.read_bytes() == content.replace(b"Fri Nov 26 19:43:50 2027", b"Thu Jan  1 00:00:00 1970") != content
    for said in (b"", b"a=b", b"_ai_DateWritten=", b"_ai_DateWritten=a date of another length than that of C's ctime;a=b"):
        path = made(container(metadata=said))
        erase_date(path)
        assert path.stat().st_size == len(container(metadata=said)) and read_archive(path).moving() == []
        assert b"another" not in path.read_bytes() and said[-4:] in path.read_bytes()[-400:]


def changed(content, place, form, value):
    return content[:place] + struct.pack(form, value) + content[place + struct.calcsize(form) :]


WHOLE = container(sampling(3, 0.04, 0.0))
ROOT = int.from_bytes(WHOLE[8:16], "little")
TIMES = WHOLE.index(sampling(1, 1.0, 0.0)) - 8


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "does not begin with 'Ogawa'"),
        (b"ply\nformat ascii 1.0\nelement", "does not begin with 'Ogawa'"),
        (b"\x89HDF\r\n\x1a\n" + bytes(20), r"of the old form \(HDF5\); export it again as Ogawa"),
        (container(finished=0), "was not finished by the program"),
        (container(parts=5), "its root has 5 parts instead of 6"),
        (WHOLE[:-24], "is cut off or damaged"),
        (changed(WHOLE, 8, "<Q", 2**64 - 1), "is cut off or damaged"),
        (changed(WHOLE, ROOT + 8 * 5, "<Q", 16), "part 4 of its root is no data"),
        (changed(WHOLE, TIMES, "<Q", 2**60), "part 4 of its root has 1152921504606846976 bytes"),
        (changed(WHOLE, TIMES, "<Q", 33), "time sampling 1: is damaged: it ends early"),
        (changed(WHOLE, TIMES + 8 + 12, "<I", 2**31), "it says that it has 2147483648 times"),
        (changed(WHOLE, TIMES + 8 + 12, "<I", 0), "it says that it has 0 times"),
        (container(sampling(3, np.nan, 0.0)), "times that do not rise"),
        (container(sampling(3, -1.0, 0.0)), "times that do not rise"),
        (container(sampling(3, 1.0, np.inf)), "times that do not rise"),
        (container(sampling(2, ACYCLIC, 1.0, 1.0)), "times that do not rise"),
        (container(sampling(3, ACYCLIC, 0.0, 1.0)), "has 3 samples; at most 1000000 are read, each with a time"),
        (container(sampling(4_000_000_000, 0.04, 0.0)), "has 4000000000 samples"),
        (container(sampling(3, 1e-9, 0.0)), "has 1 times in a cycle of 1e-09 s, which is no frame rate"),
        (container(sampling(3, 1e6, 0.0)), "which is no frame rate"),
        (container(sampling(3, 0.04, 0.0, 0.05)), "which is no frame rate"),
    ],
)  # fmt: skip
def test_what_is_no_such_file_is_told_with_its_place(made, content, said):
    path = made(content)
    with pytest.raises(FileError, match=said) as refusal:
        load(path)  # before any Blender is looked for
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_damaged_file_keeps_its_bytes(made):
    path = made(container(parts=5))
    with pytest.raises(FileError, match="its root has 5 parts"):
        erase_date(path)
    assert path.read_bytes() == container(parts=5)


def test_damaged_containers_are_read_or_refused(made):
    seeds = [container(sampling(50, 0.04, 0.0), sampling(9, 1 / 12, 0.0, 1 / 24)), container(sampling(4, ACYCLIC, 0.0, 0.1, 0.3, 0.4))]
    found = {"read": 0, "refused": 0}
    for number in range(MUTATIONS):
        path = made(damage(seeds[number % 2], "ogawa", number))
        try:
            grids = read_archive(path).moving()
            assert all(0 < grid.fps < 2e4 and 1 <= grid.frames <= 2e9 for grid in grids)
            found["read"] += 1
        except RetargetError:
            found["refused"] += 1
    assert min(found.values()) > 0.1 * MUTATIONS, found


def test_metadata_of_any_bytes(made):
    assert read_archive(made(container(metadata=b"\xff\xfe;=;;a=b=c"))).metadata["a"] == "b=c"
