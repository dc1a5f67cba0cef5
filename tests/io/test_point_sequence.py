"""Captures: folders of clouds and of meshes without correspondence, and archives of them, out and in again."""

from dataclasses import replace

import numpy as np
import pytest
from pcd_maker import pcd_of

from retarget.body.human import human
from retarget.character import Mesh, PointCloud, PointMotion
from retarget.errors import FileError, RetargetError
from retarget.io import load, npz_clouds, point_folder, save_sequence
from retarget.io.obj_ply import save as save_surface

CLOUDS = tuple(np.random.default_rng(k).normal(size=(5 + k, 3)).astype(np.float32) for k in range(12))
BOX = Mesh(
    np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)]),
    np.array(
        [
            [0, 1, 2],
            [1, 3, 2],
            [4, 6, 5],
            [5, 6, 7],
            [0, 4, 1],
            [1, 4, 5],
            [2, 3, 6],
            [3, 7, 6],
            [0, 2, 4],
            [2, 6, 4],
            [1, 5, 3],
            [3, 5, 7],
        ]
    ),
)


def captured(**changed):
    return replace(PointMotion(CLOUDS, 25.0, "capture"), **changed)


def same(clouds, others):
    return len(clouds) == len(others) and all(np.array_equal(one, other) for one, other in zip(clouds, others))


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_a_folder_that_is_written_comes_back(tmp_path, suffix):
    holed = captured(clouds=(*CLOUDS[:3], CLOUDS[0][:0], *CLOUDS[4:]))
    point_folder.save(tmp_path / "capture", holed, suffix)
    asset = load(tmp_path / "capture")
    assert asset.kind == "point sequence" and asset.clouds.fps == 30.0
    assert same(asset.clouds.clouds, holed.clouds)
    assert f"1 of 12 frames are empty (0003{suffix})" in asset.notes


def test_an_archive_that_is_written_comes_back(tmp_path):
    holed = captured(clouds=(CLOUDS[0][:0], *CLOUDS[:3], CLOUDS[0][:0], *CLOUDS[4:], CLOUDS[0][:0]))
    for name in ("a.npz", "b.npz"):
        save_sequence(tmp_path / name, holed)
    asset = load(tmp_path / "a.npz")
    assert asset.kind == "point sequence" and asset.clouds.fps == 25.0 and same(asset.clouds.clouds, holed.clouds)
    assert asset.notes == ("3 of 14 frames are empty",)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_archives_of_one_cloud_and_of_equal_frames(tmp_path):
    np.savez(tmp_path / "one.npz", points=[[0.0, 0, 0], [np.nan, 0, 0], [1, 2, 3]])
    one = load(tmp_path / "one.npz")
    assert one.kind == "points" and one.points.points.tolist() == [[0, 0, 0], [1, 2, 3]]
    assert one.notes == ("1 points that are not finite were left out",)
    equal = np.random.default_rng(0).normal(size=(3, 4, 3))
    equal[1, 2] = np.nan
    np.savez(tmp_path / "equal.npz", points=equal, fps=12)
    asset = load(tmp_path / "equal.npz")
    assert asset.clouds.fps == 12.0 and [len(cloud) for cloud in asset.clouds.clouds] == [4, 3, 4]


def test_formats_may_be_mixed_and_frames_come_in_natural_order(tmp_path):
    folder = tmp_path / "mixed"
    folder.mkdir()
    for number in (10, 2, 1, 3):
        cloud = CLOUDS[number]
        if number == 1:
            save_surface(folder / "f_1.ply", PointCloud(cloud.astype(float)))
        elif number == 2:
            (folder / "f_2.pcd").write_bytes(pcd_of(cloud, "binary_compressed"))
        elif number == 3:
            (folder / "f_3.obj").write_text("".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in cloud.tolist()))
        else:
            np.savez(folder / "f_10.npz", points=cloud)
    np.savez(folder / "0_settings.npz", fps=30)  # no frame
    (folder / ".hidden.ply").write_text("")
    asset = load(folder)
    assert same(asset.clouds.clouds, [CLOUDS[number] for number in (1, 2, 3, 10)])


def test_surfaces_that_do_not_correspond_are_sampled_by_area(tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    body = human()
    save_surface(folder / "0.ply", BOX)
    save_surface(folder / "1.ply", Mesh(body.mesh.vertices, body.mesh.faces))
    np.savez(folder / "2.npz", vertices=BOX.vertices * 2, faces=BOX.faces)
    asset = load(folder)
    assert asset.kind == "point sequence"
    assert any("of 3 frames with faces 8192 points each were taken, evenly by area" in note for note in asset.notes)
    box, person, large = asset.clouds.clouds
    sides = [(np.abs(box[:, axis] - end) < 1e-6).sum() for axis in range(3) for end in (0, 1)]
    assert min(sides) > 8192 / 6 * 0.9, "every side of a cube gets its sixth"
    head = (person[:, 1] > body.mesh.vertices[:, 1].max() - 0.25).mean()
    dense = (body.mesh.vertices[:, 1] > body.mesh.vertices[:, 1].max() - 0.25).mean()
    assert head < 0.12 < dense, "vertices are dense at the head, points are not"
    assert large.max() == pytest.approx(2.0)
    assert same(asset.clouds.clouds, load(folder).clouds.clouds), "the same every time"


def test_frames_that_cannot_be_read_are_empty_and_told(tmp_path):
    point_folder.save(tmp_path / "capture", captured())
    folder = tmp_path / "capture"
    (folder / "0002.ply").write_text("ply?")
    (folder / "0003.ply").write_bytes(b"")
    np.savez(folder / "0004.npz", points=np.full((4, 3), np.nan))
    (folder / "0004.ply").unlink()
    (folder / "0005.npz").write_bytes(b"PK no zip")
    (folder / "0005.ply").unlink()
    (folder / "0006.obj").write_text("v 0 0 x\n")
    (folder / "0006.ply").unlink()
    asset = load(folder)
    assert [len(cloud) for cloud in asset.clouds.clouds] == [5, 6, 0, 0, 0, 0, 0, 12, 13, 14, 15, 16]
    assert "1 of 12 frames are empty (0004.npz)" in asset.notes
    assert "4 of 12 files cannot be read and stand as empty frames (0002.ply: is not a PLY file" in asset.notes[-1]
    for number in (7, 8, 9):
        (folder / f"{number:04d}.ply").write_text("ply?")
    with pytest.raises(
        FileError, match="7 of its 12 files cannot be read as frames; of the first: .*0002.ply: is not a PLY file"
    ):
        load(folder)


def test_large_clouds_are_thinned_and_told(tmp_path, monkeypatch):
    monkeypatch.setattr(point_folder, "MOST_POINTS", 10)
    point_folder.save(tmp_path / "capture", captured())
    asset = load(tmp_path / "capture")
    assert max(len(cloud) for cloud in asset.clouds.clouds) == 10
    assert "of 6 frames with more points 10 were kept, at random" in asset.notes
    assert set(map(tuple, asset.clouds.clouds[11].tolist())) < set(map(tuple, CLOUDS[11].tolist()))


def test_folders_that_are_too_much_or_nothing(tmp_path, monkeypatch):
    point_folder.save(tmp_path / "empty", captured(clouds=(CLOUDS[0][:0],) * 3))
    with pytest.raises(FileError, match="none of its 3 frames has a point"):
        load(tmp_path / "empty")
    point_folder.save(tmp_path / "capture", captured())
    monkeypatch.setattr(point_folder, "LARGEST", 100)
    with pytest.raises(FileError, match="more than is kept in memory at once"):
        load(tmp_path / "capture")
    (tmp_path / "none").mkdir()
    np.savez(tmp_path / "none" / "motion.npz", poses=np.zeros((2, 66)))
    (tmp_path / "none" / "cut_off.npz").write_bytes(b"PK")
    with pytest.raises(FileError, match=r"no frames \(.obj, .ply, .pcd, .npz\); none of its 2 archives can be read as a frame"):
        load(tmp_path / "none")


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"points": np.zeros((4, 2))}, r"must have the shape \(points, 3\) beside counts"),
        ({"counts": np.array([1, 2])}, "must say how many of the 4 points belong to each frame"),
        ({"counts": np.array([5, -1])}, "must say how many"),
        ({"counts": np.array([[4]])}, "must say how many"),
        ({"counts": np.zeros(0, np.int64)}, "must say how many"),
        ({"counts": np.array([2.0, 2.0])}, "must hold integers"),
        ({"counts": np.array([2**63 + 4, 2**63], np.uint64)}, "must say how many"),
        ({"points": np.full((4, 3), np.nan)}, "none of its 4 points is finite"),
        ({"points": np.full((4, 3), np.nan), "counts": None}, "none of its 4 points is finite"),
        ({"points": np.zeros((4, 4)), "counts": None}, r"must have the shape \(points, 3\), received \(4, 4\)"),
        ({"points": np.zeros((2, 2, 4)), "counts": None}, r"or \(frames, points, 3\), received \(2, 2, 4\)"),
        ({"fps": np.array(-1.0)}, "must be one positive number"),
    ],
)
def test_faulty_archives_are_told(tmp_path, arrays, said):
    whole = {"points": np.zeros((4, 3)), "counts": np.array([1, 3]), "fps": np.array(30.0)} | arrays
    np.savez(tmp_path / "a.npz", **{name: array for name, array in whole.items() if array is not None})
    with pytest.raises(FileError, match=said):
        load(tmp_path / "a.npz")


def test_archives_that_are_no_frames_are_told(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.zeros((2, 66)))
    with pytest.raises(FileError, match="is no frame: it needs points"):
        npz_clouds.frame(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", vertices=np.zeros((4, 3)), faces=np.zeros((2, 4), np.int64))
    with pytest.raises(FileError, match=r"must have the shape \(faces, 3\), received \(2, 4\)"):
        npz_clouds.frame(tmp_path / "b.npz")


def test_what_cannot_be_written_is_told_and_leaves_nothing(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="clouds are written as .ply or .pcd, not as '.obj'"):
        point_folder.save(tmp_path / "a", captured(), ".obj")
    with pytest.raises(FileError, match="a point sequence is written as .npz or a folder"):
        save_sequence(tmp_path / "a.glb", captured())
    with pytest.raises(FileError, match="does not exist"):
        save_sequence(tmp_path / "no" / "a", captured())
    with pytest.raises(FileError, match="does not exist"):
        point_folder.save(tmp_path / "no" / "a", captured())
    monkeypatch.setattr("tempfile.mkdtemp", lambda **_: (_ for _ in ()).throw(OSError(13, "Permission denied")))
    with pytest.raises(FileError, match="cannot be written: Permission denied"):
        save_sequence(tmp_path / "a", captured())
    monkeypatch.setattr(npz_clouds, "MOST_VALUES", 100)
    with pytest.raises(FileError, match="126 points are more than an archive holds"):
        save_sequence(tmp_path / "a.npz", captured())
    monkeypatch.undo()
    monkeypatch.setattr(
        point_folder, "write_points", lambda file, cloud: (_ for _ in ()).throw(OSError(28, "No space left"))
    )
    with pytest.raises(FileError, match="cannot be written: No space left"):
        save_sequence(tmp_path / "a", captured())
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    save_sequence(tmp_path / "a", captured())
    with pytest.raises(FileError, match="is there already"):
        save_sequence(tmp_path / "a", captured())
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"clouds": ()}, "at least one frame"), ({"fps": 0.0}, "must be positive"),
     ({"clouds": (np.full((3, 3), np.nan),)}, "finite")],
)  # fmt: skip
def test_a_point_motion_checks_itself(wrong, said):
    with pytest.raises(RetargetError, match=said):
        captured(**wrong)


def test_a_capture_has_no_joints_and_says_so(tmp_path):
    save_sequence(tmp_path / "a.npz", captured())
    with pytest.raises(FileError, match="holds a point sequence, a capture without joints to follow"):
        load(tmp_path / "a.npz").motion()
