"""Posed points and their derivatives."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.rig.fit import Pull, fit_to_places, scaled_shape, state_from_places
from retarget.rig.fit_model import BodyState, hangs_on, moved_state, pose_body
from retarget.rig.rest import rest_from_pose
from retarget.rig.templates import human_template


@pytest.fixture(scope="module")
def template():
    return human_template()


def some_state(model, seed, bend=0.5):
    """A random shape and pose; turns of parts follow their parents'."""
    draw = np.random.default_rng(seed)
    turns = rot.to_matrix(rot.from_rotation_vector(draw.normal(size=(len(model.parents), 3)) * bend))
    for joint in range(1, len(turns)):
        turns[joint] = turns[model.parents[joint]] @ turns[joint]
    shape = draw.normal(size=len(model.spread)) * np.minimum(model.spread, 1.0) * 0.3
    return BodyState(shape, turns, draw.normal(size=3))


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_central_differences(template, seed):
    model = template.model.at(template.samples[:200])
    state = some_state(model, seed)
    posed = pose_body(model, state, derivatives=True)
    draw = np.random.default_rng(seed + 10)
    for _ in range(3):
        step = draw.normal(size=posed.jacobian.shape[2])
        ahead, behind = (
            pose_body(model, moved_state(state, sign * 1e-5 * step, model.parents)).points for sign in (1, -1)
        )
        assert np.allclose(posed.jacobian @ step, (ahead - behind) / 2e-5, atol=2e-5)


def test_at_rest_points_are_at_rest(template):
    model = template.body
    still = BodyState(np.zeros(len(model.spread)), np.tile(np.eye(3), (len(model.parents), 1, 1)), model.joints[0])
    posed = pose_body(model, still)
    assert np.allclose(posed.points, model.points, atol=1e-12) and np.allclose(posed.joints, model.joints, atol=1e-12)


def test_the_last_shape_is_the_body_larger(template):
    model = template.body
    shape = some_state(model, 4).shape
    assert np.allclose(model.points_of(scaled_shape(shape, 1.7)), 1.7 * model.points_of(shape), atol=1e-9)
    assert np.allclose(model.joints_of(scaled_shape(shape, 1.7)), 1.7 * model.joints_of(shape), atol=1e-9)


def test_the_way_back_to_rest_is_the_inverse_of_skinning(template):
    model = template.model
    state = some_state(model, 5, bend=0.3)
    rest = rest_from_pose(model, state, model.weights, pose_body(model, state).points)
    assert np.abs(rest - model.points_of(state.shape)).max() < 1e-6


def test_known_places_give_back_shape_and_pose(template):
    model = template.body.at(template.samples[:600])
    true = some_state(model, 6, bend=0.35)
    places = pose_body(model, true).points
    state = state_from_places(model, places, np.zeros(len(model.spread)))
    state = fit_to_places(model, state, places, 15, Pull(0.3, 1.0, 1e-9, 1e-9))
    assert np.abs(pose_body(model, state).points - places).max() < 2e-3


def test_what_hangs_on_what():
    below = hangs_on(np.array([-1, 0, 1, 0]))
    assert below.tolist() == [[1, 1, 1, 1], [0, 1, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
