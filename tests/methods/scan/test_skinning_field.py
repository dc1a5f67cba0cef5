"""The skinning field with the package's weights, on bodies that it never saw."""

import shutil

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.errors import FileError, RetargetError
from retarget.evaluate.scan_split import BODY_SEEDS, TEST, drawn_shape
from retarget.geometry.sampling import sample_surface
from retarget.methods.scan.features import JOINTS
from retarget.methods.scan.regressor import FOLDER, load_regressor
from retarget.methods.scan.skinning_field import FILE, load_field

LIFTS = {"T": 48.0, "A": 0.0, "arms down": -36.0}
"""Degrees by which arms are lifted from the rest pose."""


def resting(seed, stance):
    """Vertices, joints, their turns and true weights of a body in a stance; fingers belong to hands."""
    model = human_model()
    body = human(**drawn_shape(seed))
    rotations = np.tile(rot.IDENTITY, (len(model.parents), 1))
    for side, joint in ((1, 7), (-1, 15)):
        rotations[joint] = rot.from_rotation_vector(np.array([0, 0, side * np.radians(LIFTS[stance])]))
    turns, places = forward(model.parents, rotations[None], body.skeleton.offsets[None])
    points = prepare_skinning(body).vertices(turns, places)[0].astype(np.float64)
    owners = np.arange(len(model.parents))
    for joint in range(JOINTS, len(owners)):
        owners[joint] = owners[model.parents[joint]]
    weights = np.zeros((len(points), JOINTS))
    np.add.at(weights, (np.arange(len(points))[:, None], owners[model.skin_columns]), model.skin_weights)
    return points, places[0, :JOINTS], turns[0, :JOINTS], weights


def spread(vertices):
    """Points evenly over a body."""
    return sample_surface(vertices, human().mesh.faces, 6890, 3)


@pytest.mark.parametrize("stance, bound", [("T", 0.0004), ("A", 0.0005), ("arms down", 0.0015)])
def test_weights_of_unseen_bodies_are_found(stance, bound):
    field, errors = load_field(), []
    for seed in BODY_SEEDS[TEST][:6]:
        points, joints, turns, weights = resting(seed, stance)
        found = field(points, joints, turns, spread(points))
        assert (found >= 0).all() and np.allclose(found.sum(axis=1), 1.0)
        errors.append(((found - weights) ** 2).mean())
    assert np.mean(errors) < bound


def test_place_facing_and_size_of_a_body_do_not_matter():
    field = load_field()
    points, joints, turns, _ = resting(BODY_SEEDS[TEST][0], "T")
    turn = rot.from_rotation_vector(np.array([0.2, 1.3, -0.1]))
    moved = [rot.rotate(turn, each) * 0.5 + [3.0, 1.0, -2.0] for each in (points, joints)]
    there = field(*moved, rot.multiply(turn, turns), moved[0])
    assert np.abs(there - field(points, joints, turns, points)).max() < 1e-3


def test_a_point_of_its_own_gets_what_it_gets_among_others():
    points, joints, turns, _ = resting(BODY_SEEDS[TEST][1], "T")
    field = load_field()
    assert np.abs(field(points[40:41], joints, turns, points)[0] - field(points, joints, turns, points)[40]).max() < 1e-5
    assert field(points[:0], joints, turns, points).shape == (0, JOINTS)


def test_flesh_tells_how_joints_have_erred():
    """Joints of the regressor cost less where the body that they were found in is seen evenly."""
    field, errors = load_field(), []
    for seed in BODY_SEEDS[TEST][:6]:
        points, _, _, weights = resting(seed, "T")
        cloud = spread(points)
        seen = load_regressor()(cloud)
        errors.append([((field(points, seen.places, seen.turns, each) - weights) ** 2).mean() for each in (cloud, 2.0 * cloud)])
    right, wrong = np.mean(errors, axis=0)
    assert right < 0.0005 < wrong


def test_what_is_no_number_is_refused():
    points, joints, turns, _ = resting(BODY_SEEDS[TEST][1], "T")
    points[7] = np.nan
    with pytest.raises(RetargetError, match="must be finite"):
        load_field()(points, joints, turns, points)


def test_a_body_without_points_is_refused():
    points, joints, turns, _ = resting(BODY_SEEDS[TEST][1], "T")
    with pytest.raises(RetargetError, match="received none"):
        load_field()(points, joints, turns, points[:0])


def test_large_clouds_are_thinned():
    points, joints, turns, _ = resting(BODY_SEEDS[TEST][1], "T")
    large, small = (sample_surface(points, human().mesh.faces, count, 3) for count in (60_000, 6_890))
    few = points[::50]
    assert np.abs(load_field()(few, joints, turns, large) - load_field()(few, joints, turns, small)).max() < 0.05


def test_arrays_of_other_shapes_are_refused():
    field = load_field()
    with pytest.raises(RetargetError, match="22 x 3 joints"):
        type(field).__call__.__wrapped__(field, np.zeros((5, 3)), np.zeros((21, 3)), np.zeros((22, 4)), np.zeros((5, 3)))


def test_missing_and_foreign_weights_are_named(tmp_path):
    with pytest.raises(FileError, match="skinning_field.onnx: the network's weights are not there"):
        load_field(tmp_path)
    shutil.copy(FOLDER / "skeleton_look_1.onnx", tmp_path / FILE)
    with pytest.raises(FileError, match="holds the network 'skeleton-regressor' instead of 'skinning-field'"):
        load_field(tmp_path)
