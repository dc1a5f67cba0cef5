"""The skeleton regressor with the package's weights: bodies and motions that it never saw, and weights that cannot be used."""

import shutil

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.errors import FileError, RetargetError
from retarget.evaluate.scan_split import BODY_SEEDS, EMBEDDED, TEST, drawn_shape
from retarget.methods.scan import regressor as module
from retarget.methods.scan.regressor import FOLDER, load_regressor
from retarget.motion.library import embedded_motion

BODIES, FRAMES = 8, 3


@pytest.fixture(scope="module")
def found_and_true():
    """Joints found in the vertices of unseen bodies in unseen motions, and the true ones; a few frames of each."""
    regressor, draw = load_regressor(), np.random.default_rng(0)
    rows = []
    for seed in BODY_SEEDS[TEST][:BODIES]:
        body = human(**drawn_shape(seed))
        motion = embedded_motion(EMBEDDED[TEST][seed % len(EMBEDDED[TEST])])
        moved = motion.__class__(body.skeleton, motion.rotations, motion.translations, motion.fps)
        turns, places = world_pose(moved)
        chosen = draw.integers(len(motion), size=FRAMES)
        for frame, points in zip(chosen, prepare_skinning(body).vertices(turns[chosen], places[chosen])):
            rows.append((points.astype(np.float64), places[frame, :22], turns[frame, :22]))
    return [(regressor(points), points, places, turns) for points, places, turns in rows]


def away(found, places):
    return np.linalg.norm(found.places - places, axis=1).mean()


def test_joints_of_unseen_bodies_are_found(found_and_true):
    errors = [away(found, places) for found, _, places, _ in found_and_true]
    assert np.mean(errors) < 0.018 and max(errors) < 0.05


def test_turns_of_unseen_bodies_are_found(found_and_true):
    angles = [np.degrees(rot.angle_between(found.turns, turns)) for found, _, _, turns in found_and_true]
    assert np.mean(angles) < 9.0 and np.max([each[0] for each in angles]) < 30.0


def test_names_are_those_of_the_embedded_human(found_and_true):
    assert found_and_true[0][0].names == human_model().joint_names[:22]


def test_expected_errors_tell_large_ones_from_small_ones(found_and_true):
    errors = np.array([np.linalg.norm(found.places - places, axis=1) for found, _, places, _ in found_and_true])
    doubts = np.array([found.doubts for found, *_ in found_and_true])
    assert (doubts > 0).all() and 0.5 < doubts.mean() / errors.mean() < 2.0
    ranks = [values.ravel().argsort().argsort() for values in (errors, doubts)]
    assert np.corrcoef(*ranks)[0, 1] > 0.2


def test_a_few_points_do(found_and_true):
    regressor, draw = load_regressor(), np.random.default_rng(1)
    errors = []
    for _, points, places, _ in found_and_true:
        errors.append(away(regressor(points[draw.choice(len(points), 500, replace=False)]), places))
    assert np.mean(errors) < 0.04


def test_order_of_points_changes_nothing(found_and_true):
    found, points, _, _ = found_and_true[0]
    again = load_regressor()(points[np.random.default_rng(2).permutation(len(points))])
    assert np.abs(again.places - found.places).max() < 1e-4
    assert rot.angle_between(again.turns, found.turns).max() < 1e-3


def test_joints_move_with_the_points(found_and_true):
    found, points, _, _ = found_and_true[0]
    there = load_regressor()(points + [12.0, -3.0, 5.0])
    assert np.abs(there.places - [12.0, -3.0, 5.0] - found.places).max() < 3e-3


def test_joints_turn_with_the_points(found_and_true):
    regressor = load_regressor()
    for found, points, _, _ in found_and_true[::6]:
        for around in (0.7, 2.0, 4.0):
            turn = rot.from_rotation_vector(np.array([0.0, around, 0.0]))
            turned = regressor(rot.rotate(turn, points))
            assert away(turned, rot.rotate(turn, found.places)) < 0.015
            assert np.degrees(rot.angle_between(turned.turns, rot.multiply(turn, found.turns))).mean() < 6.0


def test_points_that_are_no_numbers_are_left_out(found_and_true):
    found, points, _, _ = found_and_true[0]
    spoilt = np.concatenate([points, [[np.nan, 0, 0], [np.inf, 0, 0], [1e30, 0, 0]]])
    assert np.abs(load_regressor()(spoilt).places - found.places).max() < 1e-4


def test_single_precision_points_do(found_and_true):
    found, points, _, _ = found_and_true[0]
    assert np.abs(load_regressor()(points.astype(np.float32)).places - found.places).max() < 3e-3


@pytest.mark.parametrize("points", [np.zeros((3, 3)), np.full((500, 3), np.nan), np.zeros((0, 3))])
def test_too_few_points_are_refused(points):
    with pytest.raises(RetargetError, match="at least 100 points"):
        load_regressor()(points)


def test_an_array_of_another_shape_is_refused():
    with pytest.raises(RetargetError, match=r"points x 3 numbers, received an array of shape \(200, 2\)"):
        load_regressor().__call__.__wrapped__(load_regressor(), np.zeros((200, 2)))


def test_noise_alone_gives_finite_joints():
    found = load_regressor()(np.random.default_rng(3).normal(size=(300, 3)) * 5)
    assert all(np.isfinite(each).all() for each in (found.places, found.turns, found.doubts))
    one = load_regressor()(np.ones((200, 3)))
    assert np.isfinite(one.places).all()


@pytest.fixture
def folder(tmp_path):
    for name in module.FILES:
        shutil.copy(FOLDER / name, tmp_path / name)
    return tmp_path


def test_missing_weights_are_named(folder):
    (folder / module.FILES[1]).unlink()
    with pytest.raises(FileError, match="skeleton_look_2.onnx: the network's weights are not there"):
        load_regressor(folder)


@pytest.mark.parametrize("damage", ["cut", "noise", "empty"])
def test_damaged_weights_are_refused(folder, damage):
    path = folder / module.FILES[0]
    whole = path.read_bytes()
    path.write_bytes({"cut": whole[: len(whole) // 2], "noise": bytes(1000), "empty": b""}[damage])
    with pytest.raises(FileError, match="skeleton_look_1.onnx: no readable ONNX network"):
        load_regressor(folder)


@pytest.mark.parametrize("was, told, message", [
    (b"\x07version\x12\x011", b"\x07version\x12\x010", "weights of version 0, but this program needs version 1"),
    (b"skeleton-regressor", b"skeleton-retrieved", "holds the network 'skeleton-retrieved' instead of 'skeleton-regressor'"),
])  # fmt: skip
def test_other_versions_and_networks_are_refused(folder, was, told, message):
    path = folder / module.FILES[2]
    whole = path.read_bytes()
    assert was in whole
    path.write_bytes(whole.replace(was, told))
    with pytest.raises(FileError, match=message):
        load_regressor(folder)


def test_all_networks_together_are_small():
    assert sum(path.stat().st_size for path in FOLDER.glob("*.onnx")) < 20e6
