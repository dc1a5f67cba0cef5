"""A character that came as a cloud of points comes back as one: point for point, on every frame."""

import json
import struct

import numpy as np
import pytest

from retarget.body.human import human
from retarget.body.skinning import skin_motion
from retarget.casting import cast
from retarget.character import PointCloud
from retarget.errors import FileError, RetargetError
from retarget.io import load, save_sequence
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion, performer
from retarget.retargeting import retarget

WALK = cut(embedded_motion("walk"), 0.0, 0.2)


@pytest.fixture(scope="module")
def waved():
    """A cloud in centimetres, and what came of it."""
    body = performer()
    cloud = PointCloud(100.0 * body.mesh.vertices[::2])
    return cloud, retarget(WALK, cloud, source=body, method="copy-rotations")


def test_points_follow_the_body_that_was_found_in_them(waved):
    cloud, result = waved
    moved = np.stack(result.file_cloud.clouds)
    assert moved.shape == (len(WALK), len(cloud.points), 3)
    truth = skin_motion(performer(), WALK)[:, ::2]
    away = np.linalg.norm((moved - moved.mean(axis=1, keepdims=True)) - (truth - truth.mean(axis=1, keepdims=True)), axis=2)
    assert away.mean() < 0.02 and np.percentile(away, 99) < 0.08


def test_they_are_written_in_order_as_archive_folder_and_gltf(waved, tmp_path):
    _, result = waved
    moved = np.stack(result.file_cloud.clouds)
    for name in ("points.npz", "points"):
        result.save_surface(tmp_path / name)
        np.testing.assert_array_equal(np.stack(load(tmp_path / name).clouds.clouds), moved)
    result.save_surface(tmp_path / "points.glb")
    blob = (tmp_path / "points.glb").read_bytes()
    tree = json.loads(blob[20 : 20 + struct.unpack_from("<I", blob, 12)[0]])
    (primitive,) = tree["meshes"][0]["primitives"]
    assert primitive["mode"] == 0 and len(primitive["targets"]) == len(WALK) - 1
    assert tree["accessors"][primitive["attributes"]["POSITION"]]["count"] == moved.shape[1]


def test_other_formats_and_untracked_clouds_are_refused(waved, tmp_path):
    _, result = waved
    with pytest.raises(FileError, match="a point sequence is written as .glb, .gltf, .npz or a folder"):
        result.save_surface(tmp_path / "points.abc")
    with pytest.raises(FileError, match="a point sequence is written as .npz or a folder"):
        save_sequence(tmp_path / "capture.glb", result.file_cloud)
    assert not list(tmp_path.iterdir())
    meshed = retarget(WALK, human(), source=performer(), method="copy-rotations")
    with pytest.raises(RetargetError, match="came with a surface"):
        meshed.file_cloud  # noqa: B018
    assert cast(human()).cloud is None
