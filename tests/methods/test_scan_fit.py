"""The body that is drawn into a cloud: its derivatives, its neighbours, and what is made of a frame first."""

import numpy as np
import pytest
from made_scans import sampled
from scipy.spatial import cKDTree

import retarget.methods.scan.fit_kernels as kernels
from retarget.body import rotations as rot
from retarget.body.human import human
from retarget.methods.scan.cloud import MOST, binned, pieces, thinned, without_floor
from retarget.methods.scan.fit import Expected, Posed, _rigid, fit_cloud, turn_matrices
from retarget.methods.scan.scan_body import BODY, scan_body
from retarget.methods.scan.usual import usual_precision
from retarget.rig.fit_model import BodyState, FitModel, moved_state, pose_body


def any_state(seed=0):
    rng = np.random.default_rng(seed)
    turns = rot.to_matrix(rot.from_rotation_vector(rng.normal(0, 0.4, (BODY, 3))))
    return BodyState(rng.normal(0, 0.5, scan_body().shapes) * scan_body().spread, turns, rng.normal(0, 1, 3))


def as_fit_model(body):
    """The same body at its chosen points, as `rig` has it."""
    weights = np.zeros((len(body.chosen), BODY))
    np.add.at(weights, (np.arange(len(weights))[:, None], body.point_columns), body.point_weights)
    points = body.vertices[body.chosen]
    return FitModel(
        body.parents, points, np.zeros_like(points), body.joints, weights, body.basis[:, body.chosen], body.joint_basis,
        body.spread, np.zeros(body.shapes), np.zeros((BODY, 3)), BODY,
    )  # fmt: skip


def rows_of(body, state, directions, chosen):
    shaped = body.shaped(state.shape)
    posed, moved = Posed.of(body, shaped, state), np.zeros((BODY, 3, body.shapes))
    kernels.carried_shapes(body.parents, body.joint_shapes, state.turns, moved)
    rows = np.empty((len(chosen), 3 * BODY + 3 + body.shapes))
    kernels.fill_rows(
        chosen, np.full(len(chosen), 2.0), directions, body.parents, shaped.points, body.point_columns, body.point_weights,
        state.turns, posed.offsets, posed.joints, body.point_basis, moved, rows,
    )  # fmt: skip
    return rows, posed


def test_derivatives_are_those_of_the_rig_s_model():
    body, state, rng = scan_body(), any_state(), np.random.default_rng(1)
    directions = rot.unit(rng.normal(size=(len(body.chosen), 3)))
    chosen = rng.choice(len(body.chosen), 200, replace=False)
    rows, posed = rows_of(body, state, directions, chosen)
    model = pose_body(as_fit_model(body), state, derivatives=True)
    assert np.abs(posed.points - model.points).max() < 1e-9 and np.abs(posed.joints - model.joints).max() < 1e-9
    wanted = 2.0 * np.einsum("pa,pak->pk", directions, model.jacobian)[chosen]
    assert np.abs(rows - wanted).max() < 1e-9


def test_derivatives_are_central_differences():
    body, state, rng = scan_body(), any_state(3), np.random.default_rng(2)
    directions = rot.unit(rng.normal(size=(len(body.chosen), 3)))
    chosen = np.arange(0, len(body.chosen), 7)
    rows, _ = rows_of(body, state, directions, chosen)
    way = rng.normal(size=rows.shape[1]) * 1e-5

    def along(sign):
        moved = moved_state(state, sign * way, body.parents)
        turns = np.empty_like(state.turns)
        kernels.turn_joints(body.parents, sign * way, state.turns, turns)
        assert np.abs(turns - moved.turns).max() < 1e-12
        return 2.0 * (Posed.of(body, body.shaped(moved.shape), moved).points * directions).sum(axis=1)[chosen]

    assert np.abs((along(1) - along(-1)) / 2 - rows @ way).max() < 1e-9


def test_neighbours_are_the_nearest():
    rng = np.random.default_rng(0)
    points, queries = rng.random((800, 3)), rng.random((300, 3)) * 1.4 - 0.2
    found, squares = binned(points).nearest(queries, 0.25)
    distance, near = cKDTree(points).query(queries)
    assert (found[distance < 0.25] == near[distance < 0.25]).all()
    assert np.allclose(np.sqrt(squares[distance < 0.25]), distance[distance < 0.25])
    assert (found[distance > 0.6] == -1).all()


def test_a_thinned_cloud_does_not_know_the_order_of_its_points():
    rng = np.random.default_rng(0)
    cloud = sampled(human().mesh.vertices, human().mesh.faces, 6890, rng)
    one, other = thinned(cloud), thinned(rng.permutation(cloud))
    assert np.abs(one - other).max() < 1e-12 and len(one) == MOST
    broken = np.concatenate([[[np.nan, 0, 0], [0, np.inf, 0]], cloud])
    assert np.abs(thinned(broken) - one).max() < 1e-12
    assert len(thinned(np.full((5, 3), np.nan))) == 0


def test_points_far_off_cost_no_memory():
    cloud = np.concatenate([np.random.default_rng(0).random((500, 3)), [[1e6, 0, 0], [0, -1e7, 3e5]]])
    assert len(thinned(cloud)) <= 500


@pytest.mark.parametrize("wide", [1.5, 0.35])
def test_a_floor_is_taken_away_and_feet_stay(wide):
    rng = np.random.default_rng(0)
    cloud = sampled(human().mesh.vertices, human().mesh.faces, 4000, rng, noise=0.0)
    floor = np.stack([rng.uniform(-wide, wide, 3000), rng.normal(0, 0.004, 3000), rng.uniform(-wide, wide, 3000)], axis=1)
    kept = without_floor(np.concatenate([cloud, floor]))
    assert (kept[:, 1] < 0.02).any()
    away = cKDTree(cloud).query(kept)[0]
    assert (away > 0.15).sum() == 0 and len(kept) > 0.98 * len(cloud)
    assert len(without_floor(cloud)) == len(cloud)


def test_pieces_come_by_size():
    rng = np.random.default_rng(0)
    piece = pieces(np.concatenate([rng.random((40, 3)) * 0.3 + 2.0, rng.random((300, 3)) * 0.5]))
    assert (piece[:40] == 1).all() and (piece[40:] == 0).all()


@pytest.mark.parametrize("shaping", [True, False])
def test_a_body_a_little_off_is_drawn_back(shaping):
    body, rng = scan_body(), np.random.default_rng(0)
    shape = np.zeros(body.shapes)
    shape[:3] = 0.5
    true = BodyState(shape, np.tile(np.eye(3), (BODY, 1, 1)), np.array([0.0, 0.9, 0.0]))
    posed = Posed.of(body, body.shaped(shape), true)
    turns = np.empty_like(true.turns)
    kernels.turn_joints(body.parents, rng.normal(0, 0.06, 3 * BODY), true.turns, turns)
    start = BodyState(np.zeros(body.shapes) if shaping else shape, turns, true.root + 0.02)
    nothing = Expected(
        true.turns, np.zeros(BODY), usual_precision(), true.root, 0.0, np.zeros(body.shapes), np.diag(body.spread**-2.0)
    )
    fit = fit_cloud(body, start, binned(posed.points), nothing, (0.1, 0.08, 0.06, 0.05, 0.04, 0.04, 0.03), shaping)
    joints = Posed.of(body, body.shaped(fit.state.shape), fit.state).joints
    assert np.linalg.norm(joints - posed.joints, axis=1).mean() < 0.004
    assert fit.explained > 0.99 and fit.seen > 0.95 and fit.distance < 0.003


def test_what_is_not_shown_pulls_nothing():
    """The front half alone leaves the body where it is; were its back drawn to the front, it would lean forward."""
    body = scan_body()
    state = BodyState(np.zeros(body.shapes), np.tile(np.eye(3), (BODY, 1, 1)), np.array([0.0, 0.9, 0.0]))
    posed = Posed.of(body, body.shaped(state.shape), state)
    front = np.ascontiguousarray(posed.points[posed.normals[:, 2] > 0.1])
    nothing = Expected(
        state.turns, np.zeros(BODY), usual_precision(), state.root, 0.0, np.zeros(body.shapes), np.diag(body.spread**-2.0)
    )
    fit = fit_cloud(body, state, binned(front), nothing, (0.06, 0.05, 0.04), False)
    joints = Posed.of(body, body.shaped(fit.state.shape), fit.state).joints
    assert np.linalg.norm(joints - posed.joints, axis=1).max() < 0.006
    behind = posed.normals[: len(fit.shown), 2] < -0.9
    assert fit.shown[~behind].mean() > 0.7 and fit.shown[behind].mean() < 0.02


def test_turns_stay_rotations_through_hundreds_of_frames():
    """As frames follow each other a chain's turns are made relative to the joint above (its transpose) and put together again."""
    draw = np.random.default_rng(0)
    turns = turn_matrices(draw.normal(size=(8, 3)))
    torn = turns.copy()
    for _ in range(300):
        step = turn_matrices(0.02 * draw.normal(size=(8, 3)))
        for each, kept in ((turns, _rigid), (torn, lambda every: every)):
            relative = np.concatenate([each[:1], np.matmul(each[:-1].transpose(0, 2, 1), each[1:])])
            for joint in range(1, 8):
                relative[joint] = each[joint - 1] @ relative[joint]
            each[:] = kept(np.matmul(step, relative))
    off = [np.abs(np.matmul(each.transpose(0, 2, 1), each) - np.eye(3)).max() for each in (turns, torn)]
    assert off[0] < 1e-12
    assert not off[1] < 1e-6  # what happens without
