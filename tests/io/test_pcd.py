"""PCD: in all three forms, organised, of doubles, and every refusal."""

import numpy as np
import pytest
from pcd_maker import lzf_packed, pcd_of

from retarget.character import PointCloud
from retarget.errors import FileError
from retarget.io import load, pcd
from retarget.io.obj_ply import save as save_surface

POINTS = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_every_form_is_read(tmp_path, form, colour):
    (tmp_path / "a.pcd").write_bytes(pcd_of(POINTS, form, colour))
    asset = load(tmp_path / "a.pcd")
    assert asset.kind == "points" and asset.notes == ()
    assert np.array_equal(asset.points.points, POINTS.astype(float))


def test_what_is_written_comes_back(tmp_path):
    for save, name in ((pcd.save, "a.pcd"), (save_surface, "b.pcd")):
        save(tmp_path / name, PointCloud(POINTS.astype(float)))
        assert np.array_equal(load(tmp_path / name).points.points, POINTS.astype(float))


def test_organised_clouds_keep_what_is_finite(tmp_path):
    holed = POINTS.copy()
    holed[::5] = np.nan
    (tmp_path / "a.pcd").write_bytes(pcd_of(holed, height=5))
    asset = load(tmp_path / "a.pcd")
    assert np.array_equal(asset.points.points, np.delete(POINTS, np.s_[::5], axis=0).astype(float))
    assert asset.notes == ("10 points that are not finite were left out",)


def test_doubles_and_integers_and_lines_left_out(tmp_path):
    row = np.dtype([("z", "<f8"), ("n", "<f4", (3,)), ("y", "<i2"), ("x", "u1")])
    table = np.zeros(4, dtype=row)
    table["x"], table["y"], table["z"] = [1, 2, 3, 4], [-1, -2, -3, -4], [0.1, 0.2, 0.3, 0.4]
    head = "VERSION 0.7\nFIELDS z n y x\nSIZE 8 4 2 1\nTYPE F F I U\nCOUNT 1 3 1 1\nWIDTH 4\nHEIGHT 1\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(head.encode() + table.tobytes())
    assert np.array_equal(
        load(tmp_path / "a.pcd").points.points, np.stack([table["x"], table["y"], table["z"]], axis=1)
    )


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"a",
        b"abc" * 400,
        bytes(1000),
        bytes(range(256)) * 40,
        np.random.default_rng(0).bytes(500) + bytes(70) + b"xyxyxyx",
    ],
)
def test_lzf_undoes_its_packing(raw):
    packed = lzf_packed(raw)
    assert pcd.lzf_unpacked(packed, len(raw)) == raw
    assert pcd.lzf_unpacked(packed, len(raw) + 1) is None
    if raw:
        assert pcd.lzf_unpacked(packed, len(raw) - 1) is None


@pytest.mark.parametrize("packed", [b"\x05ab", b"\xe0", b"\x20", b"\x20\x00", b"\x00a\x20\x01", b"\xe0\x05"])
def test_lzf_that_is_cut_off_or_looks_back_too_far(packed):
    assert pcd.lzf_unpacked(packed, 3) is None


@pytest.mark.parametrize(
    ("form", "lines", "said"),
    [
        ("binary", {"FIELDS": "x y rgb w"}, "needs the fields x, y and z"),
        ("binary", {"FIELDS": "x y z z"}, "needs the fields x, y and z once each"),
        ("binary", {"COUNT": "1 1 1 2"}, "once each, with one number"),
        ("binary", {"COUNT": "1 1 x 1"}, "COUNT must be whole numbers"),
        ("binary", {"SIZE": "4 4 4"}, "4 FIELDS have 3 SIZE, 4 TYPE and 4 COUNT"),
        ("binary", {"SIZE": "4 4 4 3"}, "no numbers are of TYPE 'F' and SIZE '3'"),
        ("binary", {"WIDTH": None, "POINTS": None}, "needs one number each of WIDTH, HEIGHT and POINTS"),
        ("binary", {"WIDTH": "10"}, "declares 50 POINTS, and 10 x 1 of them"),
        ("binary", {"DATA": "hex"}, "DATA is one of ascii, binary, binary_compressed, received 'hex'"),
        ("binary", {"WIDTH": "60", "POINTS": "60"}, "declares 60 points, 960 bytes, and holds 800; it is cut off"),
        ("binary", {"WIDTH": "999999999", "POINTS": "999999999"}, "up to 1073741824 bytes are read"),
        ("ascii", {"WIDTH": "60", "POINTS": "60"}, "declares 60 points of 4 numbers, holds 200 numbers; it is cut off"),
        ("binary_compressed", {"WIDTH": "60", "POINTS": "60"}, "where its points take 960"),
        ("binary", {"VERSION": "0.7\nVERSION 0.7"}, "a second line VERSION"),
        ("binary", {"VERSION": "0.7\nCOLOURS many"}, "is no line of its header"),
        ("binary", {"VERSION": "0.7\n#" + "x" * (1 << 14)}, "the header does not end"),
    ],
)
def test_headers_that_are_none_are_told(tmp_path, form, lines, said):
    (tmp_path / "a.pcd").write_bytes(pcd_of(POINTS, "binary" if lines.get("DATA") else form, **lines))
    with pytest.raises(FileError, match=said):
        load(tmp_path / "a.pcd")


def test_bodies_that_are_none_are_told(tmp_path):
    path = tmp_path / "a.pcd"
    packed = pcd_of(POINTS, "binary_compressed")
    body = packed.index(b"binary_compressed\n") + len("binary_compressed\n")
    for content, said in (
        (b"", "is empty"),
        (packed[:100], "the header does not end|is no line"),
        (packed[:-5], "it is cut off"),
        (packed[: body + 8] + b"\xff" * (len(packed) - body - 8), "its compressed points are damaged"),
        (pcd_of(POINTS, "ascii") + b"word", "holds words that are no numbers"),
        (pcd_of(np.full((3, 3), np.nan)), "none of its 3 points is finite"),
        (pcd_of(np.full((3, 3), 1e30)), "absurdly large"),
        (pcd_of(POINTS[:0]), "none of its 0 points is finite"),
    ):
        path.write_bytes(content)
        with pytest.raises(FileError, match=said):
            load(path)
    path.unlink()
    with pytest.raises(FileError, match="cannot be read"):
        pcd.load(path)


def test_an_empty_frame_is_a_cloud_where_frames_are_read(tmp_path):
    (tmp_path / "a.pcd").write_bytes(pcd_of(POINTS[:0]))
    assert len(pcd.load(tmp_path / "a.pcd", empty=True).points.points) == 0


def test_a_real_depth_frame(data):
    path = data / "scans" / "pcl" / "person.pcd"
    if not path.exists():
        pytest.skip("the file is not at hand")
    asset = load(path)
    assert len(asset.points.points) == 242_749
    assert asset.notes == ("64451 points that are not finite were left out",)
    assert np.ptp(asset.points.points, axis=0) == pytest.approx([3.086, 2.768, 3.172], abs=0.001)
