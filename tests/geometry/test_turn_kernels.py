"""Nearest rotations against scipy's and against Procrustes by singular values."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.geometry import turn_kernels as kernels

IDENTITY = np.array([0.0, 0, 0, 1])


def nearest(m, q=IDENTITY):
    found = q.copy()
    kernels.nearest_turn(np.ascontiguousarray(m, dtype=float), found)
    return found


def apart(q, turn):
    """Degrees between a quaternion and a rotation."""
    return np.degrees((Rotation.from_quat(q).inv() * turn).magnitude())


def by_singular_values(m):
    u, _, vt = np.linalg.svd(m)
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return Rotation.from_matrix(u @ vt)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 90.0, 179.9, 180.0])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e9])
def test_turned_points_give_their_rotation_back(degrees, size):
    random = np.random.default_rng(2)
    for _ in range(20):
        axis = random.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis))
        points = random.normal(size=(6, 3))
        found = nearest(size * turn.apply(points).T @ points)
        assert abs(np.linalg.norm(found) - 1) < 1e-9 and apart(found, turn) < 1e-4


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_about_the_axes(axis):
    turn = Rotation.from_rotvec(np.pi * axis)
    assert apart(nearest(turn.as_matrix() @ np.diag([3.0, 2.0, 1.0])), turn) < 1e-6


def test_any_matrix_gives_what_singular_values_give():
    """Half of them turn space inside out; the best rotation is still well defined."""
    random = np.random.default_rng(3)
    signs = set()
    for _ in range(300):
        m = random.normal(size=(3, 3))
        signs.add(np.sign(np.linalg.det(m)))
        s = np.linalg.svd(m, compute_uv=False)
        if np.linalg.det(m) < 0 and s[1] - s[2] < 0.05:
            continue  # two rotations are nearly as near
        assert apart(nearest(m), by_singular_values(m)) < 1e-4
    assert signs == {-1.0, 1.0}


def test_flat_neighbourhoods_have_a_rotation_too():
    random = np.random.default_rng(4)
    for _ in range(50):
        turn = Rotation.random(random_state=random)
        flat = random.normal(size=(7, 3)) * [1, 1, 0]
        assert np.linalg.matrix_rank(m := turn.apply(flat).T @ flat) == 2
        assert apart(nearest(m), turn) < 1e-4


@pytest.mark.parametrize("m", [np.zeros((3, 3)), np.full((3, 3), np.nan)], ids=["nothing", "not finite"])
def test_what_says_nothing_leaves_the_rotation(m):
    before = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_quat()
    assert np.array_equal(nearest(m, before), before)


@pytest.mark.parametrize("m", [np.outer([1.0, 2, 3], [2.0, 0, 1]), -np.eye(3)], ids=["one line", "inside out"])
def test_where_many_rotations_are_nearest_one_of_them_comes(m):
    found = Rotation.from_quat(nearest(m)).as_matrix()
    s = np.linalg.svd(m, compute_uv=False)
    best = s[0] + s[1] + (s[2] if np.linalg.det(m) >= 0 else -s[2])
    assert np.trace(found.T @ m) == pytest.approx(best, rel=1e-6)


def groups(random, count=4, each=9):
    rest = random.normal(size=(count * each, 3))
    weights = random.uniform(0.1, 1, size=(count, each))
    weights /= weights.sum(axis=1, keepdims=True)
    centres = np.einsum("gm,gmx->gx", weights, rest.reshape(count, each, 3))
    return rest, np.arange(0, count * each + 1, each), weights.ravel(), centres


def test_groups_turn_about_their_centres():
    random = np.random.default_rng(5)
    rest, starts, weights, centres = groups(random)
    turns, shifts = Rotation.random(4, random_state=random), random.normal(size=(4, 3))
    posed = np.concatenate([turns[g].apply(rest[starts[g] : starts[g + 1]] - centres[g]) + shifts[g] for g in range(4)])
    q, places = np.tile(IDENTITY, (5, 1)), np.empty((5, 3))
    kernels.group_turns(
        rest, posed, np.append(starts, starts[-1]), np.arange(len(rest)), weights, np.append(centres, [[0.0, 0, 0]], axis=0),
        q, places,
    )  # fmt: skip
    assert max(apart(q[g], turns[g]) for g in range(4)) < 1e-4
    assert np.abs(places[:4] - shifts).max() < 1e-12
    assert np.array_equal(q[4], IDENTITY), "a group without members keeps its rotation"


def test_blended_skin_gives_its_joints_back():
    """Two joints that share every vertex of their skin: each piece alone is wrong, fitted in turn they come right."""
    random = np.random.default_rng(6)
    rest = random.normal(size=(40, 3))
    share = random.uniform(0.05, 0.95, size=40)
    weights = np.stack([share, 1 - share])
    turns, shifts = Rotation.from_rotvec([[0.2, 0.7, 0], [0, -0.3, 0.4]]), np.array([[0.1, 0, 0], [0, 0.2, 0.3]])
    posed = sum(weights[j][:, None] * (turns[j].apply(rest) + shifts[j]) for j in range(2))
    totals = (weights**2).sum(axis=1)
    centres = weights**2 @ rest / totals[:, None]
    starts, members = np.array([0, 40, 80]), np.tile(np.arange(40), 2)
    q, places = np.tile(IDENTITY, (2, 1)), np.empty((2, 3))
    kernels.group_turns(rest, posed, starts, members, (weights**2 / totals[:, None]).ravel(), centres, q, places)
    assert min(apart(q[j], turns[j]) for j in range(2)) > 3
    told = np.empty_like(rest)
    kernels.skin_turns(rest, posed, starts, members, weights.ravel(), totals, centres, 60, q, places, told)
    assert max(apart(q[j], turns[j]) for j in range(2)) < 0.01
    assert np.abs(told - posed).max() < 1e-4
    assert np.abs(places - [turns[j].apply(centres[j]) + shifts[j] for j in range(2)]).max() < 1e-4
