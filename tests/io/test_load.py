"""What any reader meets: names that no file can have, devices, files that fill the memory; always one line that can be shown."""

import os

import pytest

from retarget import load
from retarget.errors import FileError, RetargetError
from retarget.io import READERS, obj_ply


def said(path):
    with pytest.raises(FileError) as caught:
        load(path)
    assert str(caught.value).isprintable()
    return str(caught.value)


@pytest.mark.parametrize("name", ["a" * 300 + ".bvh", "a/" * 3000 + "b.bvh"], ids=["name", "path"])
def test_names_longer_than_files_have(tmp_path, name):
    assert "cannot be read: File name too long" in said(tmp_path / name)


@pytest.mark.parametrize("suffix", sorted(READERS))
def test_names_are_shown_without_what_steers_terminals(tmp_path, suffix):
    path = tmp_path / f"x\n\x1b[2Jy\u202e{suffix}"
    assert "x\\n\\x1b[2Jy\\u202e" in said(path)
    path.write_bytes(b"\0\1nonsense")
    assert "x\\n\\x1b[2Jy\\u202e" in said(path)
    assert str(RetargetError("ö 'a\tb\udcff'")) == "ö 'a\\tb\\udcff'"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("suffix", sorted(READERS))
def test_pipes_and_devices_are_no_files(tmp_path, suffix):
    pipe, zero, loop = (tmp_path / f"{name}{suffix}" for name in ("pipe", "zero", "loop"))
    os.mkfifo(pipe)
    zero.symlink_to("/dev/zero")
    loop.symlink_to(loop)
    assert "is not a file" in said(pipe) and "is not a file" in said(zero) and said(loop)


def test_what_does_not_fit_into_the_memory_is_told(tmp_path, monkeypatch):
    def greedy(path):
        raise MemoryError

    monkeypatch.setattr(obj_ply, "load", greedy)
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    assert said(tmp_path / "a.obj").endswith("needs more memory than there is")


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".vrm", ".fbx"])
def test_files_larger_than_their_kind_are_not_read(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"glTF")
    os.truncate(path, 5 << 30)  # takes no room on the disk
    assert f"has {5 << 30} bytes; " in said(path)


def test_a_line_without_an_end(tmp_path, monkeypatch):
    monkeypatch.setattr(obj_ply, "LONGEST_LINE", 100)
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\n" + bytes(101))
    assert "line 2: a line of more than 100 characters; this is no OBJ file" in said(tmp_path / "a.obj")
