"""The manifest survives what kills its writer; the lock does not outlive its holders."""

import json
import os
import subprocess
import sys

import pytest

from retarget.batch import lock
from retarget.batch.lock import held_alone
from retarget.batch.manifest import NAME, Manifest, file_hash, stands
from retarget.errors import FileError


def lines(folder):
    return (folder / NAME).read_bytes()


def test_what_is_added_is_there_again(tmp_path):
    with Manifest(tmp_path) as manifest:
        assert manifest.records == []
        manifest.add({"done": ["a.bvh", 0, "k.glb"], "name": "ä \udcff\n"})
        manifest.add({"failed": []})
    with Manifest(tmp_path) as manifest:
        assert manifest.records == [{"done": ["a.bvh", 0, "k.glb"], "name": "ä \udcff\n"}, {"failed": []}]
    assert lines(tmp_path).count(b"\n") == 2


def test_a_line_torn_at_any_byte_is_taken_away_and_only_that(tmp_path):
    first, last = b'{"done":["a",0,"b"]}\n', b'{"done":["c",1,"b"],"bytes":12}\n'
    for length in range(len(last) + 1):
        (tmp_path / NAME).write_bytes(first + last[:length])
        with Manifest(tmp_path) as manifest:
            known = [record["done"][0] for record in manifest.records]
            manifest.add({"done": ["e", 2, "b"]})
        whole = length >= len(last) - 1  # all but the end of the line is as good
        assert known == (["a", "c"] if whole else ["a"])
        assert lines(tmp_path) == first + (last if whole else b"") + b'{"done":["e",2,"b"]}\n'


@pytest.mark.parametrize(
    "junk", [b"\n", b"\xff\xfe\n", b"[1]\n", b'{"done":\n', b"[" * 100_000 + b"\n", b"null\n", b"9" * 10000 + b"\n"]
)
def test_lines_that_say_nothing_are_passed_over(tmp_path, junk):
    (tmp_path / NAME).write_bytes(b'{"a":1}\n' + junk + b'{"b":2}\n')
    with Manifest(tmp_path) as manifest:
        assert manifest.records == [{"a": 1}, {"b": 2}]


def test_a_manifest_that_cannot_be_is_refused(tmp_path):
    (tmp_path / NAME).mkdir()
    with pytest.raises(FileError, match="manifest.jsonl: cannot be written"):
        Manifest(tmp_path)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_disk_is_said_so(tmp_path):
    with Manifest(tmp_path) as manifest, open("/dev/full", "wb", buffering=0) as full:
        manifest._file.close()
        manifest._file = full
        with pytest.raises(FileError, match="cannot be written: No space left"):
            manifest.add({"a": 1})


def test_an_output_stands_only_as_it_was_written(tmp_path):
    output = tmp_path / "out.glb"
    output.write_bytes(b"abc")
    record = {"output": "out.glb", "bytes": 3, "sha256": file_hash(output), "beside": [], "page": None}
    assert stands(tmp_path, record)
    assert not stands(tmp_path, record | {"bytes": 4}) and not stands(tmp_path, record | {"output": "other.glb"})
    assert not stands(tmp_path, record, page=True), "it has none"
    assert not stands(tmp_path, {}) and not stands(tmp_path, record | {"output": 7})
    output.write_bytes(b"abd")
    assert not stands(tmp_path, record)


# --- the lock -----------------------------------------------------------------------------------------------------


def test_one_holder_at_a_time_and_none_after(tmp_path):
    with held_alone(tmp_path):
        assert (tmp_path / lock.NAME).read_text().strip() == str(os.getpid())
        with pytest.raises(FileError, match=f"another batch .process {os.getpid()}. is at work there"):
            with held_alone(tmp_path):
                pass
        assert (tmp_path / lock.NAME).exists()
    assert not (tmp_path / lock.NAME).exists()
    with held_alone(tmp_path):
        pass


def test_a_lock_file_of_the_dead_holds_nothing(tmp_path):
    (tmp_path / lock.NAME).write_text("999999999\n")
    with held_alone(tmp_path):
        assert (tmp_path / lock.NAME).read_text() == f"{os.getpid()}\n"


def test_a_lock_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / lock.NAME).mkdir()
    with pytest.raises(FileError, match="cannot be written"):
        with held_alone(tmp_path):
            pass


@pytest.mark.skipif(os.name != "posix", reason="descriptors are handed down on POSIX only")
def test_processes_left_behind_keep_it_until_they_end(tmp_path, monkeypatch):
    """The holder is gone, a process that has the descriptor is not."""
    code = (
        "import os, subprocess, sys\nfrom pathlib import Path\nfrom retarget.batch.lock import held_alone\n"
        "with held_alone(Path(sys.argv[1])) as held:\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'import sys; sys.stdin.read()'], pass_fds=[held])\n"
        "    os._exit(0)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, env=environment)
    assert process.wait(timeout=30) == 0
    monkeypatch.setattr(lock, "PATIENCE", 0.3)
    with pytest.raises(FileError, match="processes of a run that ended are still at work"):
        with held_alone(tmp_path):
            pass
    process.stdin.close()
    monkeypatch.setattr(lock, "PATIENCE", 30.0)
    with held_alone(tmp_path):
        pass
    assert json.dumps([each.name for each in tmp_path.iterdir()]) == "[]"
