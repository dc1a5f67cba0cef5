"""Contact and penetration metrics against values worked out by hand."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.evaluate.metrics import (
    contact_error,
    contacts_gained,
    contacts_kept,
    depth_mean_mm,
    depth_p95_mm,
    excess_penetration_percent,
    new_part_penetration_percent,
    new_penetration_percent,
    part_penetration_percent,
    penetration_percent,
)


def row(*values):
    return np.array([values], float)


# contact error of Ye 2024


def test_contact_error_by_hand():
    source = row(0.05, 0.05, 0.05, 0.20)  # arm of 5 cm: the last pair is beyond the diameter
    target = row(0.10, 0.20, 0.05, 9.00)  # arm of 10 cm: equal, one radius too far, half a radius too near
    assert contact_error(source, target, 0.05, 0.10) == pytest.approx(1.0 / 3)
    assert contact_error(source, target, 0.05, 0.10, two_sided=True) == pytest.approx((1.0 + 0.25) / 3)


def test_contact_error_charges_losing_touch_as_the_prose_says():
    apart, touching = row(0.04), row(0.0)
    assert contact_error(touching, apart, 0.05, 0.05) == pytest.approx(0.64)
    assert contact_error(apart, touching, 0.05, 0.05) == 0, "the printed inequality would charge this one"


def test_contact_error_is_zero_on_identity_and_scales_with_the_body():
    random = np.random.default_rng(0)
    source, target = random.uniform(0, 0.15, (2, 5, 30))
    assert contact_error(source, source, 0.05, 0.05, two_sided=True) == 0
    assert contact_error(source, 2 * source, 0.05, 0.10, two_sided=True) == pytest.approx(0)
    wanted = contact_error(source, target, 0.05, 0.06)
    assert contact_error(3 * source, target, 0.15, 0.06) == pytest.approx(wanted)
    order = random.permutation(30)
    assert contact_error(source[:, order], target[:, order], 0.05, 0.06) == pytest.approx(wanted)
    read = [contact_error(source, source + gap, 0.05, 0.05) for gap in (0.01, 0.02, 0.04)]
    assert read == pytest.approx([0.04, 0.16, 0.64])


def test_pairs_that_do_not_count():
    assert np.isnan(contact_error(row(0.2, 0.10), row(0.0, 0.0), 0.05, 0.05)), "the diameter itself is out"
    assert contact_error(row(0.05, np.nan), row(0.10, np.nan), 0.05, 0.05) == pytest.approx(1.0)
    with pytest.raises(RetargetError, match="target_radius must be positive, received 0"):
        contact_error(row(0.05), row(0.05), 0.05, 0.0)


# contacts


def test_contacts_kept_by_hand():
    first = np.zeros((2, 2, 3))
    second = first.copy()
    second[:, :, 0] = [[0.0, 0.029], [0.031, 0.5]]  # within 3 cm: the first two
    valid = np.array([[1, 1], [1, 0]], bool)
    assert contacts_kept(first, second, valid, 0.02) == pytest.approx(2 / 3)
    assert contacts_kept(first, second, valid | True, 0.02) == pytest.approx(2 / 4)
    assert contacts_kept(first, first, valid, 0.02) == 1
    assert np.isnan(contacts_kept(first, second, valid & False, 0.02))
    with pytest.raises(RetargetError, match="threshold must be positive"):
        contacts_kept(first, second, valid, -0.02)


def test_contacts_kept_do_not_depend_on_world_or_order_and_fall_with_the_gap():
    random = np.random.default_rng(1)
    first = random.normal(size=(4, 50, 3))
    gap = 0.02 * random.normal(size=(4, 50, 3))
    valid = random.random((4, 50)) < 0.7
    kept = contacts_kept(first, first + gap, valid, 0.02)
    turn, order = rot.from_rotation_vector(np.array([0.4, -1.1, 0.3])), random.permutation(50)
    assert contacts_kept(rot.rotate(turn, first) + 5, rot.rotate(turn, first + gap) + 5, valid, 0.02) == kept
    assert contacts_kept(first[:, order], (first + gap)[:, order], valid[:, order], 0.02) == pytest.approx(kept)
    assert contacts_kept(first + gap, first, valid, 0.02) == pytest.approx(kept)
    falling = [contacts_kept(first, first + size * gap, valid, 0.02) for size in (0, 0.5, 1, 2, 4)]
    assert falling == sorted(falling, reverse=True) and falling[0] == 1 and falling[-1] < 0.2


def test_contacts_gained_by_hand():
    source = row(0.00, 0.025, 0.04, 0.50, 0.50)
    result = row(0.00, 0.01, 0.01, 0.00, 0.50)
    valid = np.ones((1, 5), bool)
    # Thresholds 2 cm: four pairs touch in the result; of their source distances 4 and 50 cm exceed 3 cm.
    assert contacts_gained(source, result, valid, 0.02, 0.02) == pytest.approx(2 / 4)
    morphology = row(1, 1, 0.2, 1.0, 1)
    assert contacts_gained(source, result, valid, 0.02, 0.02, morphology) == pytest.approx(1.2 / 4)
    assert contacts_gained(source, result, np.array([[1, 1, 1, 0, 1]], bool), 0.02, 0.02) == pytest.approx(1 / 3)
    assert contacts_gained(source, source, valid, 0.02, 0.02) == 0
    assert contacts_gained(result, 2 * result, valid, 0.02, 0.04) == 0, "a body twice the size has twice the threshold"
    assert np.isnan(contacts_gained(source, result + 1, valid, 0.02, 0.02))


# penetration

LIMB = np.array([1, 1, 1, 1, 0, 0], bool)
MM = 0.001 * np.array([[0.0, 0.9, 1.1, 20, 50, -30], [0, 0, 0, 0, 9, 9], [2, 2, 2, 2, np.nan, np.nan]])


def test_penetration_by_hand():
    np.testing.assert_allclose(penetration_percent(MM, LIMB), [50, 0, 100])
    np.testing.assert_allclose(penetration_percent(MM, LIMB, deeper_than=0.0005), [75, 0, 100])
    np.testing.assert_allclose(penetration_percent(np.full((2, 6), np.nan), LIMB), 0)
    with pytest.raises(RetargetError, match="no vertex"):
        penetration_percent(MM, LIMB & False)


def test_penetration_does_not_depend_on_the_order_and_grows_with_depth():
    random = np.random.default_rng(2)
    depth, limb, order = random.normal(0, 0.01, (5, 60)), random.random(60) < 0.5, random.permutation(60)
    wanted = penetration_percent(depth, limb)
    np.testing.assert_allclose(penetration_percent(depth[:, order], limb[order]), wanted)
    assert (penetration_percent(depth + 0.005, limb) >= wanted).all()


def test_penetration_within_parts():
    part = np.array([0, 0, 2, 2, -1, -1])
    wanted = [[0, 0, 100], [0, 0, 0], [100, 0, 100]]  # part 1 has no vertices
    np.testing.assert_allclose(part_penetration_percent(MM, part, 3), wanted)
    one = part_penetration_percent(MM, np.where(LIMB, 0, -1), 1)
    np.testing.assert_allclose(one[:, 0], penetration_percent(MM, LIMB))
    with pytest.raises(RetargetError, match="parts from -1 to 2; right are -1 to 1"):
        part_penetration_percent(MM, part, 2)


def test_new_penetration_by_hand():
    source = np.zeros((3, 6))
    source[0, 2], source[2, :2] = 0.005, 0.0005  # one vertex penetrates in the source, two only touch
    np.testing.assert_allclose(new_penetration_percent(MM, source, LIMB), [25, 0, 100])
    np.testing.assert_allclose(new_penetration_percent(MM, MM, LIMB), 0)
    np.testing.assert_allclose(new_penetration_percent(MM, source - 1, LIMB), penetration_percent(MM, LIMB))


def test_new_and_excess_penetration_of_foreign_bodies():
    result, source = np.array([[10.0, 5], [4, 0], [7, 7]]), np.array([[4.0, 0], [9, 3], [7, 0]])
    np.testing.assert_allclose(excess_penetration_percent(result, source), [[6, 5], [0, 0], [0, 7]])
    np.testing.assert_allclose(excess_penetration_percent(result[:, 0], source[:, 0]), [6, 0, 0])
    np.testing.assert_allclose(new_part_penetration_percent(result, source), [[0, 5], [0, 0], [0, 7]])
    for measure in (excess_penetration_percent, new_part_penetration_percent):
        np.testing.assert_allclose(measure(source, source), 0)


def test_new_is_at_least_excess_where_vertices_correspond():
    depth, source = np.random.default_rng(3).normal(0, 0.01, (2, 20, 6))
    new = new_penetration_percent(depth, source, LIMB)
    excess = excess_penetration_percent(penetration_percent(depth, LIMB), penetration_percent(source, LIMB))
    assert (new >= excess - 1e-12).all() and (new > excess).any()


def test_depths_by_hand():
    # Deeper than 1 mm within the limb: 1.1 and 20, then 2 four times.
    assert depth_mean_mm(MM, LIMB, 1.7) == pytest.approx((1.1 + 20 + 8) / 6)
    assert depth_p95_mm(MM, LIMB, 1.7) == pytest.approx(2 + 0.75 * 18), "rank 4.75 of 1.1 2 2 2 2 20"
    assert depth_mean_mm(MM, LIMB, 0.85) == pytest.approx(2 * (1.1 + 20 + 8) / 6), "quoted at 1.7 m"
    assert depth_p95_mm(MM, LIMB, 0.85) == pytest.approx(2 * 15.5)


@pytest.mark.parametrize("measure", [depth_mean_mm, depth_p95_mm])
def test_a_planted_depth_is_read(measure):
    assert measure(np.zeros((2, 6)), LIMB, 1.7) == 0
    for planted in (10.0, 20.0, 30.0):
        depth = np.zeros((2, 6))
        depth[1, 1:4] = planted / 1000
        assert measure(depth, LIMB, 1.7) == pytest.approx(planted)
