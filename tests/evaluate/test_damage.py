"""The damage that is done to files, and the count of what comes of it: read, refused, raises, goes down and hangs."""

import json
import random
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from retarget.character import Mesh
from retarget.evaluate import damage_run
from retarget.evaluate.damage import WAYS, damage, damaged_glb, damaged_json, damaged_text, damaged_zip
from retarget.io import load
from retarget.io.obj_ply import save


@pytest.fixture
def seed(tmp_path):
    path = tmp_path / "seed.obj"
    save(path, Mesh(np.random.default_rng(0).normal(size=(40, 3)), np.arange(39).reshape(13, 3)))
    return path


def test_damaged_surfaces_are_read_or_refused(seed):
    found = damage_run.outcomes([seed], 150)
    assert found.crashes == found.hangs == 0 and not found.faults
    assert found.read > 5 and found.refused > 5 and found.read + found.refused == found.count == 150
    assert [path.name for path in seed.parent.iterdir()] == ["seed.obj"]


@pytest.mark.parametrize("suffix", ["", ".obj"])
def test_the_same_damage_every_time(seed, suffix):
    content = seed.read_bytes()
    found = [damage(content, "a", number, suffix) for number in range(50)]
    assert found == [damage(content, "a", number, suffix) for number in range(50)]
    assert len(set(found)) > 40 and content not in found[:5] and found[0] != damage(content, "b", 0, suffix)


@pytest.mark.parametrize("suffix", sorted(WAYS))
@pytest.mark.parametrize("content", [b"", b"{", b"\0", b"PK\3\4", b"glTF" + bytes(30)])
def test_what_is_no_such_file_is_damaged_too(suffix, content):
    for number in range(40):
        assert isinstance(damage(content, "a", number, suffix), bytes)


def test_damaged_documents_are_still_json():
    content = json.dumps({"nodes": [{"name": "a", "children": [1, 2]}, {"mesh": 0}], "meshes": []}).encode()
    found = [damaged_json(content, random.Random(number)) for number in range(200)]
    for each in found:
        json.loads(each)
    assert len(set(found)) > 150


def test_damaged_glbs_keep_their_chunks():
    text, binary = b'{"nodes":[{"name":"ab"}]}   ', b"12345678"
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    content = struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
    for number in range(100):
        found = damaged_glb(content, random.Random(number))
        length = struct.unpack_from("<I", found, 12)[0]
        json.loads(found[20 : 20 + length])
        assert struct.unpack_from("<I", found, 8)[0] == len(found) and found[-8:] == binary


def test_damaged_zips_are_still_zips(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(300), b=np.zeros(3))
    found = []
    for number in range(100):
        path.with_name("b.npz").write_bytes(damaged_zip(path.read_bytes(), random.Random(number)))
        with zipfile.ZipFile(path.with_name("b.npz")) as file:
            assert file.testzip() is None
            found.append(tuple(file.read(name) for name in file.namelist()))
    assert len(set(found)) > 60


def test_damaged_text_changes_words_and_lines():
    content = b"\n".join(b"v %d %d 3.5" % (number, -number) for number in range(30))
    found = [damaged_text(content, random.Random(number)) for number in range(200)]
    assert any(len(each.splitlines()) != 30 for each in found) and any(b"nan" in each for each in found)


READER = """
import sys, time, os
first, count = int(sys.argv[sys.argv.index("--first") + 1]), int(sys.argv[sys.argv.index("--count") + 1])
for number in range(first, first + count):
    if number == 2:
        open(os.path.join(os.path.dirname(sys.argv[-1]), f"damaged-{os.getpid()}-2.obj"), "w").close()
        os._exit(9)
    if number == 4: time.sleep(30)
    print({1: "raised KeyError", 3: "contained", 5: "refused"}.get(number, "read"), flush=True)
"""


def test_readers_that_fail_are_counted(seed, tmp_path, monkeypatch):
    """A stand-in for the reading process: it raises on one, goes down on the next and hangs on the fifth."""
    program = tmp_path / "reader.py"
    program.write_text(READER)
    real = damage_run.subprocess.Popen
    monkeypatch.setattr(damage_run, "SECONDS", 1.0)
    monkeypatch.setattr(damage_run, "STARTING", 0.0)
    monkeypatch.setattr(
        damage_run.subprocess, "Popen", lambda command, **how: real([command[0], str(program), *command[3:]], **how)
    )
    found = damage_run.outcomes([seed], 7)
    assert (found.read, found.refused, found.contained, found.crashes, found.hangs) == (2, 2, 1, 2, 1)
    assert not list(tmp_path.glob("damaged*"))
    assert found.faults == ("1: raised KeyError", "2: its process went down", "4: hangs")


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (KeyError("a\n"), "raised KeyError"),
        (MemoryError(), "raised MemoryError"),
    ],
)
def test_what_is_no_retarget_error_is_told_with_its_place(seed, monkeypatch, error, word):
    def load(path):
        raise error

    monkeypatch.setattr("retarget.io.load", load)
    told = damage_run.read(seed)
    assert told.startswith(word) and "test_damage.py, line" in told and "\n" not in told


def test_a_small_file_that_fills_the_memory_is_a_fault(seed, monkeypatch):
    def greedy(path):
        raise MemoryError

    monkeypatch.setattr("retarget.io.obj_ply.load", greedy)
    assert damage_run.read(seed) == "wanted more memory than a small file can need"


def test_what_is_no_line_is_a_fault(seed, monkeypatch):
    asset = load(seed)
    monkeypatch.setattr("retarget.io.load", lambda path: replace(asset, notes=("a\nb",)))
    assert damage_run.read(seed) == "noted what is no line: ('a\\nb',)"


def test_the_command_counts_keeps_and_refuses(seed, tmp_path):
    command = [sys.executable, "-m", "retarget.evaluate.damage_run", "--count", "20", "--first", "7"]
    done = subprocess.run([*command, str(seed)], capture_output=True, text=True)
    assert done.returncode == 0 and "20 files" in done.stdout and "0 crashes, 0 hangs" in done.stdout
    kept = tmp_path / "kept"
    kept.mkdir()
    subprocess.run([*command, "--keep", str(kept), str(seed)], check=True)
    assert sorted(kept.iterdir(), key=lambda path: int(path.stem))[0].read_bytes() == damage(seed.read_bytes(), "1", 7, ".obj")
    seed.write_text("v 1 2\n")
    done = subprocess.run([*command, str(seed)], capture_output=True, text=True)
    assert done.returncode == 1 and "is no valid file: refused" in done.stderr
