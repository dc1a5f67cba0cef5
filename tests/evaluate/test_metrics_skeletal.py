"""Joint metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.evaluate.metrics import (
    MSE_DEFINITIONS,
    acc,
    angle_error_degrees,
    end_effector_orientation_error_degrees,
    end_effector_position_error_cm,
    floor_error_cm,
    foot_slide_cm,
    jerk,
    mpjpe,
    mse_over_height,
    pa_acc,
    pa_mpjpe,
    position_error_cm,
)

COMPARISONS = {
    "mpjpe": mpjpe,
    "pa_mpjpe": pa_mpjpe,
    "acc": acc,
    "pa_acc": pa_acc,
    "position_error_cm": lambda a, b: position_error_cm(a, b, 1.7),
    "end_effector_position_error_cm": lambda a, b: float(end_effector_position_error_cm(a, b, 1.7).mean()),
} | {
    f"mse {name} {kind}": lambda a, b, name=name, local=local: mse_over_height(a, b, 1.7, name, local)
    for name in MSE_DEFINITIONS
    for kind, local in (("global", False), ("local", True))
}
compared = pytest.mark.parametrize("compare", COMPARISONS.values(), ids=COMPARISONS)


def clip(seed, frames=8, joints=6):
    return np.random.default_rng(seed).normal(size=(frames, joints, 3))


def turned(points):
    """The whole world moved."""
    return rot.rotate(rot.from_rotation_vector(np.array([0.4, -1.1, 0.3])), points) + [1.0, -2.0, 3.0]


@compared
def test_zero_on_identity(compare):
    assert compare(clip(0), clip(0)) == pytest.approx(0, abs=1e-14)


@compared
def test_moving_the_world_changes_nothing(compare):
    assert compare(turned(clip(0)), turned(clip(1))) == pytest.approx(compare(clip(0), clip(1)), rel=1e-9)


@compared
def test_the_order_of_joints_does_not_count(compare):
    order = [0, 4, 2, 5, 1, 3]  # the root stays first
    assert compare(clip(0)[:, order], clip(1)[:, order]) == pytest.approx(compare(clip(0), clip(1)), rel=1e-12)


@compared
def test_a_larger_error_reads_larger(compare):
    noise = clip(1)
    read = [compare(clip(0) + size * noise, clip(0)) for size in (0.001, 0.002, 0.004, 0.008)]
    assert read == sorted(read) and read[0] > 0 and read[3] > 1.5 * read[2]


@pytest.mark.parametrize("compare", [pa_mpjpe, pa_acc])
def test_aligned_metrics_forgive_rigid_errors_of_each_frame(compare):
    truth = clip(0)
    result = rot.rotate(rot.normalise(np.random.default_rng(2).normal(size=(8, 1, 4))), truth) + clip(3, joints=1)
    assert compare(result, truth) == pytest.approx(0, abs=1e-13)
    assert mpjpe(result, truth) > 1


def test_aligned_error_by_hand():
    truth = np.array([[[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]])
    assert pa_mpjpe(1.1 * truth, truth) == pytest.approx(0.1), "a body too large stays wrong by a tenth"


def test_joint_distance():
    a, b = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    b[0, 0] = [0.03, 0.04, 0]
    assert mpjpe(b, a) == pytest.approx(0.05 / 4)
    assert position_error_cm(a, b, 1.7) == pytest.approx(5 / 4)
    assert position_error_cm(a, b, 3.4) == pytest.approx(5 / 8)
    np.testing.assert_allclose(end_effector_position_error_cm(a, b, 1.7), [2.5, 0.0])
    np.testing.assert_allclose(end_effector_position_error_cm(a, b, 0.85), [5.0, 0.0])


def test_acceleration_by_hand():
    truth, result = np.zeros((5, 2, 3)), np.zeros((5, 2, 3))
    result[:, 0, 1] = 0.5 * 0.02 * np.arange(5) ** 2  # 0.02 m a frame squared, on one of two joints
    assert acc(result, truth) == pytest.approx(0.01)
    result[:, 1, 0] = 7 + 3 * np.arange(5)  # a drift of constant speed does not accelerate
    assert acc(result, truth) == pytest.approx(0.01)
    for frames in range(3):
        assert np.isnan(acc(result[:frames], truth[:frames]))


def test_acceleration_is_compared_as_a_vector():
    up, down = np.zeros((3, 1, 3)), np.zeros((3, 1, 3))
    up[1, 0, 1], down[1, 0, 1] = 0.01, -0.01
    assert acc(up, down) == pytest.approx(0.04), "equal lengths, opposite directions"


@pytest.mark.parametrize(
    "definition, wanted",
    # One of four joint places is off by (3, 4, 0) cm on a body of 2 m.
    [
        ("nkn", (9 + 16) / 200 / 4),
        ("meshret", 0.05**2 / 2 / 4),
        ("san", (0.015**2 + 0.02**2) / 3 / 4),
        ("star", 0.05 / 2 / 4),
    ],
)
def test_the_four_published_errors(definition, wanted):
    truth, result = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    result[1, 1] = [0.03, 0.04, 0]
    assert mse_over_height(result, truth, 2.0, definition) == pytest.approx(wanted)
    assert mse_over_height(result, truth, 2.0, definition, local=True) == pytest.approx(wanted)
    shifted = result + np.array([[[1.0, 0, 0]], [[0, 0, -2.0]]])
    assert mse_over_height(shifted, truth, 2.0, definition, local=True) == pytest.approx(wanted), "local: no root error"
    assert mse_over_height(shifted, truth, 2.0, definition) > 10 * wanted


def test_how_the_four_errors_relate():
    nkn, meshret, san = (mse_over_height(clip(0), clip(1), 1.6, name) for name in ("nkn", "meshret", "san"))
    assert nkn == pytest.approx(100 * meshret)
    assert nkn == pytest.approx(300 * 1.6 * san)


def test_an_unknown_definition_names_the_known_ones():
    with pytest.raises(RetargetError, match="'meshrat'.*nearest: 'meshret'"):
        mse_over_height(clip(0), clip(0), 1.7, "meshrat")
    with pytest.raises(RetargetError, match="height must be positive"):
        mse_over_height(clip(0), clip(0), 0.0)


def test_orientation_by_hand():
    truth = np.tile(rot.IDENTITY, (2, 2, 1))
    result = truth.copy()
    result[0, 1] = rot.from_rotation_vector(np.radians([0.0, 30.0, 0.0]))
    result[1, 1] = rot.from_rotation_vector(np.radians([50.0, 0.0, 0.0]))
    np.testing.assert_allclose(end_effector_orientation_error_degrees(result, truth), [0.0, 40.0], atol=1e-9)
    np.testing.assert_allclose(end_effector_orientation_error_degrees(-result, truth), [0.0, 40.0], atol=1e-9)
    world = rot.normalise(np.array([0.1, 0.7, -0.2, 0.5]))
    both = end_effector_orientation_error_degrees(rot.multiply(world, result), rot.multiply(world, truth))
    np.testing.assert_allclose(both, [0.0, 40.0], atol=1e-5)


def test_angles():
    x, y = np.array([[[2.0, 0, 0]]]), np.array([[[0, 0.5, 0]]])
    assert angle_error_degrees(x, y)[0, 0] == pytest.approx(90)
    assert angle_error_degrees(x, x)[0, 0] == 0
    assert angle_error_degrees(x, -x)[0, 0] == pytest.approx(180)
    tiny = np.array([[[1.0, 1e-6, 0]]])
    assert angle_error_degrees(x, tiny)[0, 0] == pytest.approx(np.degrees(1e-6), rel=1e-6), (
        "exact near zero, unlike arccos"
    )


def test_a_slide_of_4_cm():
    points = np.zeros((6, 1, 3))
    points[1:5, 0, 0] = [0.0, 0.0, 0.04, 0.04]  # mean 0.02: every frame is 2 cm from it
    points[1:5, 0, 1] = [0, 9, 0, 9]  # heights do not count
    touching = np.array([0, 1, 1, 1, 1, 0], bool)[:, None]
    assert foot_slide_cm(points, touching, 1.7) == pytest.approx([2.0])
    assert foot_slide_cm(points, touching, 0.85) == pytest.approx([4.0]), "quoted at 1.7 m"


def test_one_value_a_contact():
    points = np.zeros((7, 2, 3))
    touching = np.array([[1, 1], [1, 0], [0, 0], [1, 0], [0, 1], [0, 1], [1, 1]], bool)
    assert len(foot_slide_cm(points, touching, 1.7)) == 5
    assert len(foot_slide_cm(points, np.zeros((7, 2), bool), 1.7)) == 0


def test_floor_error_is_that_of_the_lowest_resting_point():
    points = np.zeros((3, 2, 3))
    points[..., 1] = [[0.01, 0.05], [-0.02, 0.03], [0.5, 0.5]]
    touching = np.array([[1, 1], [1, 0], [0, 0]], bool)
    assert floor_error_cm(points, touching, np.zeros((3, 2)), 1.7) == pytest.approx([1.0, 2.0])
    assert floor_error_cm(points, touching, np.zeros((3, 2)) + 0.01, 1.7) == pytest.approx([0.0, 3.0])


def test_jerk_of_a_cubic():
    time = np.arange(20) / 10.0
    points = np.zeros((20, 1, 3))
    points[:, 0, 2] = time**3  # third derivative 6 m/s³
    assert jerk(points, 10.0, 0.5) == pytest.approx(12.0)
    points[:, 0, 2] = time**2
    assert jerk(points, 10.0, 0.5) == pytest.approx(0.0, abs=1e-9)
    assert jerk(points[:3], 10.0, 0.5) == 0.0
