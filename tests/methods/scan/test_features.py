"""What the regressor sees: exact nearest points, the same whatever the order, place, density and facing of a cloud."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human, human_model
from retarget.methods.scan import cloud_kernels, features
from retarget.methods.scan.features import Bodies, basis, closer_look, first_look, gathered, thinned, vectors_to


@pytest.fixture(scope="module")
def body():
    return human(**PRESETS["average"])


def joints_of(body):
    places = human_model().joints(body.mesh.vertices)[: features.JOINTS]
    turns = np.broadcast_to(np.eye(3), (1, features.JOINTS, 3, 3))
    return places, turns.astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_nearest_points_are_those_of_a_search_of_all(seed, body):
    draw = np.random.default_rng(seed)
    strays = draw.uniform(-3, 3, size=(200, 3))
    points = [body.mesh.vertices, draw.normal(size=(500, 3)), strays[:1], np.concatenate([body.mesh.vertices, strays])][seed]
    clouds = thinned(points)
    queries = draw.uniform(-2, 2, size=(1, 700, 3)).astype(np.float32)
    vectors = vectors_to(clouds, queries)
    away, _ = cKDTree(clouds.places[0]).query(queries[0])
    assert np.allclose(np.linalg.norm(vectors[0], axis=1), away, atol=1e-5)
    ends, _ = cKDTree(clouds.places[0]).query(queries[0] + vectors[0])
    assert ends.max() < 1e-5, "a vector must end in a point of the cloud"


def test_a_cell_keeps_the_mean_of_its_points(body):
    points = np.random.default_rng(0).uniform(-0.3, 0.3, size=(5000, 3))
    clouds = thinned(points)
    cells = np.floor((points - points.mean(axis=0)) / features.CELL + cloud_kernels.SHIFT)
    _, owner, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(owner.ravel(), points[:, axis]) / counts for axis in range(3)], axis=1)
    away, _ = cKDTree(clouds.places[0] + clouds.middles[0]).query(means)
    assert len(clouds.places[0]) == len(means) and away.max() < 1e-6


def test_order_of_points_does_not_matter(body):
    points = body.mesh.vertices
    mixed = points[np.random.default_rng(1).permutation(len(points))]
    assert np.abs(first_look(thinned(points)) - first_look(thinned(mixed))).max() < 1e-5


def test_where_a_cloud_stands_does_not_matter(body):
    points = body.mesh.vertices
    here, there = thinned(points), thinned(points + [30.0, -4.0, 7.0])
    assert np.allclose(there.middles - here.middles, [30.0, -4.0, 7.0], atol=1e-4)
    assert np.abs(first_look(here) - first_look(there)).max() < 0.01  # points that change their cell by rounding


def test_where_points_lie_dense_does_not_move_the_middle(body):
    points = body.mesh.vertices
    head = points[points[:, 1] > 0.85 * points[:, 1].max()]
    dense = np.concatenate([points, np.repeat(head, 20, axis=0) + np.random.default_rng(2).normal(size=(20 * len(head), 3)) * 1e-3])
    assert np.linalg.norm(points.mean(axis=0) - dense.mean(axis=0)) > 0.2
    assert np.linalg.norm(thinned(points).middles - thinned(dense).middles) < 0.03


def test_a_few_strays_hardly_move_the_middle(body):
    points = body.mesh.vertices
    far = np.concatenate([points, np.random.default_rng(3).uniform(3, 6, size=(30, 3))])
    assert np.linalg.norm(thinned(points).middles - thinned(far).middles) < 0.02


def test_fixed_places_are_spread_in_a_ball():
    places = basis()
    assert places.shape == (features.BASIS, 3) and np.linalg.norm(places, axis=1).max() <= features.REACH
    assert np.abs(places.mean(axis=0)).max() < 0.02
    gaps, _ = cKDTree(places).query(places, k=2)
    assert gaps[:, 1].min() > 0.005


def test_a_closer_look_does_not_depend_on_facing(body, monkeypatch):
    monkeypatch.setattr(features, "CELL", 1e-4)  # every point in a cell of its own, however the body is turned
    places, turns = joints_of(body)
    turn = rot.to_matrix(rot.from_rotation_vector(np.array([0.3, 2.0, -0.4])))
    seen = []
    for matrix in (np.eye(3), turn):
        clouds = thinned(body.mesh.vertices @ matrix.T)
        found = Bodies(
            ((places @ matrix.T) - clouds.middles[0]).astype(np.float32)[None], (matrix @ turns).astype(np.float32)
        )
        seen.append(closer_look(clouds, found, whole=True)[0])
    upward = slice(-4, -1)  # the vertical as the hips see it: the only thing that may change
    assert np.allclose(seen[0][upward], [0, 1, 0], atol=1e-6) and np.allclose(seen[1][upward], turn[1], atol=1e-6)
    seen[0][upward] = seen[1][upward] = 0.0
    assert np.quantile(np.abs(seen[0] - seen[1]), 0.99) < 1e-4  # nearest points that are equally near may be swapped


def test_a_closer_look_does_not_depend_on_size(body, monkeypatch):
    monkeypatch.setattr(features, "CELL", 1e-4)
    places, turns = joints_of(body)
    seen = []
    for scale in (1.0, 0.6):
        clouds = thinned(body.mesh.vertices * scale)
        found = Bodies((places * scale - clouds.middles[0]).astype(np.float32)[None], turns)
        seen.append(closer_look(clouds, found, whole=True)[0])
    assert seen[1][-1] == pytest.approx(0.6 * seen[0][-1], rel=1e-5)
    assert np.quantile(np.abs(seen[0] - seen[1])[:-1], 0.99) < 1e-4


def test_two_columns_make_a_rotation():
    turns = rot.to_matrix(rot.from_rotation_vector(np.random.default_rng(4).normal(size=(20, 3)) * 2))
    six = np.concatenate([1.7 * turns[..., 0], 0.3 * turns[..., 1] + 0.5 * turns[..., 0]], axis=-1)
    assert np.allclose(gathered(six), turns)
    assert np.isfinite(gathered(np.zeros((1, 6)))).all()
