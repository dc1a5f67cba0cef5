"""Arrays of .npz files: what numpy writes is read, what a file cannot hold or should not run is refused before it is
read."""

import io
import struct
import zipfile

import numpy as np
import pytest

from retarget.errors import FileError
from retarget.io import npz_arrays
from retarget.io.npz_arrays import open_archive


def header(text, version=1):
    width = "<H" if version == 1 else "<I"
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack(width, len(text)) + text


def zipped(path, name="poses.npy", raw=b"", compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as file:
        file.writestr(name, raw)
    return path


def refused(path, name="poses"):
    archive = open_archive(path)
    with pytest.raises(FileError) as told:
        archive.numbers(name)
    assert told.value.place == name and "\n" not in str(told.value)
    return told.value.problem


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize(
    "value",
    [
        np.arange(6.0).reshape(2, 3),
        np.float32(3.5),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(4, dtype=">i2"),
    ],
)
def test_what_numpy_writes_is_read(tmp_path, save, value):
    save(tmp_path / "a.npz", value=value, other=np.zeros(3))
    archive = open_archive(tmp_path / "a.npz")
    assert archive.shape("value") == np.shape(value)
    assert np.array_equal(archive.numbers("value"), value) and archive.numbers("value").dtype == np.float64


@pytest.mark.parametrize("version", [1, 2, 3])
def test_header_versions_and_the_long_integers_of_python_2(tmp_path, version):
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (2L, 1L), }\n"
    zipped(tmp_path / "a.npz", raw=header(text, version) + np.array([1.0, 2.0]).tobytes())
    assert open_archive(tmp_path / "a.npz").numbers("poses").tolist() == [[1.0], [2.0]]


def test_integers_keep_their_kind(tmp_path):
    np.savez(tmp_path / "a.npz", whole=np.array([4294967295], dtype=np.uint32), broken=np.array([1.5]))
    archive = open_archive(tmp_path / "a.npz")
    assert archive.integers("whole").tolist() == [4294967295]
    with pytest.raises(FileError, match="must hold integers"):
        archive.integers("broken")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array("male"), "male"),
        (np.array(["female"]), "female"),
        (np.array(b"male"), "male"),
        (np.array("male").astype(">U4"), "male"),
        (np.array(b"\xff"), None),
        (np.array("two\nlines"), None),
        (np.array([0x20006E], dtype=np.uint32).view("U1"), None),
        (np.array(3), None),
        (np.array(["a", "b"]), None),
        (np.array("x", dtype=object), None),
    ],
)
def test_texts_are_hints(tmp_path, value, text):
    np.savez(tmp_path / "a.npz", gender=value)
    assert open_archive(tmp_path / "a.npz").text("gender") == text


def test_what_is_no_archive(tmp_path):
    for raw in (b"", b"PK\x03\x04", b"\x93NUMPY" * 30):
        (tmp_path / "a.npz").write_bytes(raw)
        with pytest.raises(FileError, match="is no .npz file"):
            open_archive(tmp_path / "a.npz")


def test_one_name_twice(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("poses.npy", b"1")
        file.writestr("poses.npy", b"2")
    with pytest.raises(FileError, match="twice"):
        open_archive(tmp_path / "a.npz")


def test_pickled_objects_are_never_read(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.array({"a": 1}, dtype=object))
    assert "run code" in refused(tmp_path / "a.npz")


def test_arrays_that_are_no_numbers(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.array(["a"]), fields=np.zeros(2, dtype=[("a", "<f8")]), bits=np.array([True]))
    assert "must hold numbers" in refused(tmp_path / "a.npz")
    assert "not a plain array" in refused(tmp_path / "a.npz", "fields")
    assert "must hold numbers" in refused(tmp_path / "a.npz", "bits")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_numbers_that_are_none(tmp_path, value):
    np.savez(tmp_path / "a.npz", poses=np.array([0.0, value]))
    assert "not finite" in refused(tmp_path / "a.npz")


def test_declared_shapes_must_fit_the_bytes(tmp_path):
    for shape in (b"(100000, 156)", b"(3,)", b"()"):
        text = b"{'descr': '<f8', 'fortran_order': False, 'shape': " + shape + b", }\n"
        zipped(tmp_path / "a.npz", raw=header(text) + bytes(16))
        assert "does not fit" in refused(tmp_path / "a.npz")
    zipped(tmp_path / "a.npz", raw=header(text.replace(shape, b"(1000000000000, 156)")) + bytes(16))
    assert "156000000000000 values" in refused(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("raw", "problem"),
    [
        (b"hello, this is text", "no numpy array"),
        (header(b"{'descr': '<f8'}") + bytes(8), "not a plain array"),
        (header(b"{'descr': '<q9', 'fortran_order': False, 'shape': (1,), }") + bytes(8), "numpy does not write"),
        (header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1 1,), }") + bytes(8), "numpy does not write"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff", "a header of 4294967295 bytes"),
    ],
)
def test_headers_that_are_none(tmp_path, raw, problem):
    assert problem in refused(zipped(tmp_path / "a.npz", raw=raw))


def test_members_that_numpy_does_not_write(tmp_path):
    assert "compressed in a way" in refused(zipped(tmp_path / "a.npz", raw=bytes(99), compression=zipfile.ZIP_LZMA))
    raw = bytearray(zipped(tmp_path / "b.npz", raw=bytes(99)).read_bytes())
    raw[raw.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "b.npz").write_bytes(raw)
    assert "encrypted" in refused(tmp_path / "b.npz")


def test_sizes_are_checked_before_memory_is_taken(tmp_path, monkeypatch):
    def declared(size, compression):
        content = io.BytesIO()
        np.save(content, np.zeros(1000))
        path = zipped(tmp_path / "a.npz", raw=content.getvalue(), compression=compression)
        raw = bytearray(path.read_bytes())
        at = raw.index(b"PK\x01\x02") + 24
        raw[at : at + 4] = struct.pack("<I", size)
        path.write_bytes(raw)
        return path

    assert "more than the file can hold" in refused(declared(4_000_000_000, zipfile.ZIP_STORED))
    assert "more than the file can hold" in refused(declared(4_000_000_000, zipfile.ZIP_DEFLATED))
    np.savez_compressed(tmp_path / "bomb.npz", poses=np.zeros(100_000))
    monkeypatch.setattr(npz_arrays, "LARGEST", 1 << 19)
    assert "arrays of up to" in refused(tmp_path / "bomb.npz")


def test_small_integers_do_not_grow_without_end(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", poses=np.zeros(1000, dtype=np.int8))
    monkeypatch.setattr(npz_arrays, "MOST_VALUES", 999)
    assert "1000 values" in refused(tmp_path / "a.npz")


def test_damage_is_told(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.arange(1000.0))
    raw = bytearray((tmp_path / "a.npz").read_bytes())
    raw[4000] ^= 1
    (tmp_path / "a.npz").write_bytes(raw)
    assert refused(tmp_path / "a.npz") == "is damaged"
    np.savez_compressed(tmp_path / "a.npz", poses=np.arange(1000.0))
    raw = bytearray((tmp_path / "a.npz").read_bytes())
    start = raw.index(b"poses.npy") + len(b"poses.npy")
    raw[start : start + 40] = b"\xff" * 40
    (tmp_path / "a.npz").write_bytes(raw)
    assert refused(tmp_path / "a.npz") == "is damaged"
