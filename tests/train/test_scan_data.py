"""Training clouds: the same for the same number, with the joints inside the body, and with the troubles that were asked for."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import forward
from retarget.evaluate.scan_split import TRAINING, VALIDATION
from retarget.methods.scan.features import PARENTS, Bodies, closer_look, first_look, thinned
from retarget.train import data
from retarget.train.poses import drawn_poses, gather_poses, other_side, still_poses


@pytest.fixture(scope="module")
def maker():
    return data.CloudMaker(data.bake_bodies((8000, 8001, 8002)), gather_poses(VALIDATION))


def test_a_batch_is_a_function_of_its_number(maker):
    one, other, next_one = (maker.batch(number, 6)[0] for number in (4, 4, 5))
    assert np.array_equal(first_look(one), first_look(other))
    assert not np.allclose(first_look(one), first_look(next_one))


def test_bodies_lie_around_their_joints(maker):
    clouds, truth = maker.batch(0, 12, "clean")
    for number in range(12):
        points = clouds.places[number, : clouds.firsts[number, clouds.blocks[number]]]
        away = np.linalg.norm(points[:, None] - truth.places[number], axis=2).min(axis=0)
        assert away.max() < 0.25 and 0.01 < away.mean() < 0.1


def test_clouds_are_what_skinning_makes_of_the_body(maker):
    """Samples and transforms against the package's own skinning, through the middle of the cloud and the nearest points."""
    from scipy.spatial import cKDTree

    clouds, truth = maker.batch(1, 8, "clean")
    for number in range(8):
        points = clouds.places[number, : clouds.firsts[number, clouds.blocks[number]]]
        hands = truth.places[number, [9, 17]] + 0.08 * np.einsum(
            "jab,jb->ja", truth.turns[number, [9, 17]], np.array([[0.5, -0.6, 0.6], [-0.5, -0.6, 0.6]])
        )
        away, _ = cKDTree(points).query(hands)
        assert away.max() < 0.06


def test_half_a_view_sees_one_side(maker):
    clouds, truth = maker.batch(2, 16, "half")
    whole, _ = maker.batch(2, 16, "clean")
    counts = [found.firsts[np.arange(16), found.blocks] for found in (clouds, whole)]
    share = (counts[0] / counts[1]).mean()
    assert 0.3 < share < 0.75


def test_sparse_clouds_are_sparse_and_noise_is_noise(maker):
    sparse, _ = maker.batch(3, 8, "sparse")
    assert (sparse.firsts[np.arange(8), sparse.blocks] <= 500).all()
    clean, noisy = (maker.batch(3, 8, sort)[0] for sort in ("clean", "noise"))
    assert (noisy.firsts[np.arange(8), noisy.blocks] > clean.firsts[np.arange(8), clean.blocks]).all()


def test_training_and_use_thin_alike(maker):
    clouds, truth = maker.batch(6, 4)
    for number in range(4):
        points = clouds.places[number, : clouds.firsts[number, clouds.blocks[number]]].astype(np.float64)
        assert np.linalg.norm(thinned(points).middles) < 0.02
    assert np.isfinite(closer_look(clouds, truth, whole=True)).all()


def test_poses_face_anywhere_and_some_fall():
    poses = drawn_poses(gather_poses(TRAINING), 600, np.random.default_rng(0))
    ahead = rot.rotate(poses[:, 0], np.array([0.0, 0.0, 1.0]))
    facing = np.histogram(np.arctan2(ahead[:, 0], ahead[:, 2]), bins=8, range=(-np.pi, np.pi))[0]
    assert facing.min() > 30
    upright = rot.rotate(poses[:, 0], np.array([0.0, 1.0, 0.0]))[:, 1]
    assert 0.02 < (upright < 0.5).mean() < 0.12


def test_t_and_straight_arms_are_what_they_are_called():
    """T: arms level and to the side. With straightened elbows the forearm goes on where the upper arm points."""
    model, body = human_model(), human()
    joints = model.joints(body.mesh.vertices)
    poses = still_poses(200, np.random.default_rng(1), (48.0,))
    offsets = np.broadcast_to(joints - np.where(model.parents[:, None] >= 0, joints[model.parents], 0.0), (200, 52, 3))
    _, places = forward(model.parents, poses, offsets)
    for side, shoulder in ((1, 7), (-1, 15)):
        upper, lower = (rot.unit(places[:, shoulder + 1 + i] - places[:, shoulder + i]) for i in (0, 1))
        assert abs(np.degrees(np.arcsin(upper[:, 1])).mean()) < 3.0 and (side * upper[:, 0] > 0.9).all()
        assert np.degrees(np.arccos(np.clip((upper * lower).sum(axis=1), -1, 1))).min() < 8.0


def test_a_mirrored_pose_is_the_mirror_image():
    model = human_model()
    draw = np.random.default_rng(2)
    joints = model.joints(human().mesh.vertices)
    offsets = joints - np.where(model.parents[:, None] >= 0, joints[model.parents], 0.0)
    rotations = rot.from_rotation_vector(draw.normal(size=(52, 3)) * 0.4)
    mirrored = rotations[other_side()] * [1.0, -1.0, -1.0, 1.0]
    _, places = forward(model.parents, rotations[None], offsets[None])
    _, others = forward(model.parents, mirrored[None], offsets[None])
    assert np.allclose(others[0], places[0][other_side()] * [-1, 1, 1], atol=2e-3)


def test_joints_of_the_features_are_those_of_the_human():
    model = human_model()
    assert np.array_equal(model.parents[:22], PARENTS)


def test_baked_bodies_come_back_from_their_folder(tmp_path):
    baked = data.bake_bodies((8000, 8003), tmp_path)
    again = data.bake_bodies((8000, 8003), tmp_path)
    assert all(np.array_equal(getattr(baked, name), getattr(again, name)) for name in vars(baked))
    assert baked.weights.sum(axis=2) == pytest.approx(1.0, abs=1e-5)
    assert isinstance(maker_bodies(baked), Bodies)


def maker_bodies(wardrobe):
    return data.CloudMaker(wardrobe, gather_poses(VALIDATION)).batch(0, 2)[1]
