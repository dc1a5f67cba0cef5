"""The published ways of rig transfer on bodies where the answer is known."""

from functools import lru_cache

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.evaluate.reference.rest_pose import (
    GROWING,
    NONE,
    closed_form_pose,
    energy_and_gradient,
    optimised_pose,
    rest_vertices,
    with_lengths,
)
from retarget.evaluate.reference.rig_transfer import (
    MappedTemplate,
    joint_regressor,
    joints_by_functions,
    joints_by_points,
)
from retarget.geometry.resample import Surface, decimate
from retarget.geometry.spectral import spectral_basis
from retarget.rig.templates import human_template

PARENTS = np.array([-1, 0, 1, 2, 1, 4, 0])
REST = np.array(
    [[0, 0, 0], [0, 0.5, 0], [0.3, 0.6, 0], [0.7, 0.6, 0], [-0.3, 0.6, 0], [-0.7, 0.6, 0], [0.1, -0.5, 0]], float
)


def posed(turns):
    """Joints and world turns for local rotation vectors."""
    local, world, joints = rot.to_matrix(rot.from_rotation_vector(turns)), np.empty((len(REST), 3, 3)), REST.copy()
    for joint, parent in enumerate(PARENTS):
        world[joint] = local[joint] if parent < 0 else world[parent] @ local[joint]
        if parent >= 0:
            joints[joint] = joints[parent] + world[parent] @ (REST[joint] - REST[parent])
    return joints, world


@lru_cache(maxsize=1)
def small():
    """A coarse template with its basis, weights and joints."""
    template = human_template()
    body = decimate(Surface(template.model.points, template.faces), 1500)
    from scipy.spatial import cKDTree

    weights = template.body.weights[cKDTree(template.model.points).query(body.vertices)[1]]
    return body, spectral_basis(body.vertices, body.faces, 60), weights, template.body


def test_weights_travel_to_the_same_body_as_well_as_each_way_can():
    body, basis, weights, _ = small()
    same = np.arange(len(body))
    mapped = MappedTemplate.of(body.vertices, body.faces, basis, basis, same)
    np.testing.assert_allclose(mapped.by_points(weights), weights)
    np.testing.assert_allclose(mapped.by_points(weights, adjoint=True), weights)
    np.testing.assert_allclose(mapped.by_function(weights), basis.smooth(weights), atol=1e-9)
    np.testing.assert_allclose(mapped.coordinates(), basis.smooth(body.vertices), atol=1e-9)
    error = lambda got: ((got - weights) ** 2).mean()  # noqa: E731
    low = error(mapped.low_pass_places().of(weights))
    assert low < 1e-4 and low < error(mapped.by_coordinates(weights)) < error(mapped.by_function(weights))


def test_the_regressor_gives_the_templates_joints_from_few_vertices_and_moves_with_them():
    body, basis, weights, model = small()
    regressor = joint_regressor(body.vertices, model.joints, weights, model.parents)
    assert np.abs(regressor @ body.vertices - model.joints).max() < 2e-3
    assert np.abs(regressor.sum(axis=1) - 1).max() < 1e-3
    knee = human_template().names.index("leftLowerLeg")
    used = np.flatnonzero(regressor[knee])
    assert len(used) and (weights[used, knee] > 0.1).all() and (weights[used, model.parents[knee]] > 0.1).all()
    same = np.arange(len(body))
    moved = body.vertices + [0.1, 0.0, -0.2]
    assert np.abs(joints_by_points(regressor, moved, same) - model.joints - [0.1, 0.0, -0.2]).max() < 3e-3
    spectral = joints_by_functions(regressor, basis, basis, np.eye(60), moved)
    assert 1e-4 < np.abs(spectral - model.joints - [0.1, 0.0, -0.2]).mean() < 0.05


def test_a_joint_without_shared_vertices_takes_its_own():
    vertices = np.random.default_rng(0).normal(size=(12, 3))
    weights = np.zeros((12, 2))
    weights[:6, 0] = weights[6:, 1] = 1.0
    regressor = joint_regressor(vertices, vertices[[0, 6]], weights, np.array([-1, 0]))
    assert not regressor[0, 6:].any() and not regressor[1, :6].any()
    np.testing.assert_allclose(regressor @ vertices, vertices[[0, 6]], atol=1e-6)


def test_the_gradient_of_the_pose_energy_is_the_central_difference():
    draw = np.random.default_rng(3)
    joints = REST + draw.normal(size=REST.shape) * 0.2
    for scale in (1.0, 1e-6):
        at = draw.normal(size=3 + 3 * len(REST)) * scale
        _, gradient = energy_and_gradient(at, REST, PARENTS, joints, 0.05)
        for _ in range(5):
            way = draw.normal(size=at.shape)
            step = 1e-6 * way
            up, down = (energy_and_gradient(at + s, REST, PARENTS, joints, 0.05)[0] for s in (step, -step))
            assert (up - down) / 2e-6 == pytest.approx(gradient @ way, rel=1e-4, abs=1e-6)


def test_both_ways_find_a_pose_without_twist_and_take_vertices_back():
    turns = np.zeros(REST.shape)
    turns[2], turns[4], turns[0] = [0, 0.4, 0.7], [0, -0.9, 0.2], [0.1, 0.0, 0.2]
    joints, world = posed(turns)
    vertices = np.random.default_rng(0).normal(size=(40, 3))
    weights = np.random.default_rng(1).dirichlet(np.ones(2), size=40) @ np.eye(len(REST))[[1, 2]]
    moves = joints - np.einsum("jab,jb->ja", world, REST)
    skinned = np.einsum("vj,jab,vb->va", weights, world, vertices) + weights @ moves
    for found in (optimised_pose(REST, PARENTS, joints, NONE, 400), closed_form_pose(REST, PARENTS, joints)):
        assert found.energy < 2e-3
        np.testing.assert_allclose(found.posed, joints, atol=2e-3)
        np.testing.assert_allclose(found.rest, REST, atol=1e-9)
    exact = closed_form_pose(REST, PARENTS, joints)
    np.testing.assert_allclose(exact.turns[1] @ (REST[2] - REST[1]), joints[2] - joints[1], atol=1e-9)
    from retarget.evaluate.reference.rest_pose import FoundPose

    np.testing.assert_allclose(
        rest_vertices(FoundPose(world, joints, REST, 0.0), weights, skinned), vertices, atol=1e-9
    )


def test_regularisation_turns_no_joint_that_moves_nothing():
    turns = np.zeros(REST.shape)
    turns[2] = [0, 0.4, 0.7]
    joints, _ = posed(turns)
    found = optimised_pose(REST, PARENTS, joints, GROWING)
    twist = lambda pose: np.degrees(np.arccos(np.clip((np.trace(pose.turns[6]) - 1) / 2, -1, 1)))  # noqa: E731
    assert twist(found) < 2 and found.energy < 0.05


def test_bones_take_other_lengths_in_their_own_directions():
    joints, _ = posed(np.zeros(REST.shape))
    long = with_lengths(REST, PARENTS, joints * 2.0)
    np.testing.assert_allclose(long, REST * 2.0, atol=1e-9)


def test_a_bone_that_points_the_other_way_is_turned_by_half_a_circle():
    parents, rest = np.array([-1, 0]), np.array([[0.0, 0, 0], [0, 1, 0]])
    found = closed_form_pose(rest, parents, np.array([[0.0, 0, 0], [0, -1, 0]]))
    np.testing.assert_allclose(found.turns[0] @ [0, 1, 0], [0, -1, 0], atol=1e-9)
    same = closed_form_pose(rest, parents, rest)
    np.testing.assert_allclose(same.turns[0], np.eye(3), atol=1e-12)
