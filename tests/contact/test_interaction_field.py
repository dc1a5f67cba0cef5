"""The dense mesh interaction field: exactly the paper's entries, chosen on the source, whatever is missing on either body."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import still_motion
from retarget.contact import field_losses as losses
from retarget.contact import interaction_field as module
from retarget.contact.field_losses import cosine_loss, distance_matrix_loss, distance_shares, field_losses, vector_loss
from retarget.contact.interaction_field import (
    GROUPS,
    PARTS,
    interaction_field,
    nearest_and_farthest,
    part_radii,
    prepare_field,
    semantic_coordinates,
)
from retarget.contact.sensor_bones import BONES
from retarget.contact.sensors import Layout, paper_layout, place_sensors, pose_sensors
from retarget.correspond.joints import match_humanoid
from retarget.errors import RetargetError


def sensed(name, layout=None):
    character = human(**PRESETS[name])
    return place_sensors(character, match_humanoid(character.skeleton), layout)


@pytest.fixture(scope="module")
def bodies():
    return sensed("thin"), sensed("very_heavy")


@pytest.fixture(scope="module")
def poses(bodies):
    """Positions and frames of both bodies in the same three poses, orthonormal to double precision."""
    found = []
    for body in bodies:
        places, frames = (each.astype(np.float64) for each in pose_sensors(body, moving(body)))
        u, _, v = np.linalg.svd(frames)
        found.append((places, np.where(body.valid[:, None, None], u @ v, 0.0)))
    return tuple(found)


def moving(sensors, frames=3):
    still = still_motion(sensors.character.skeleton, frames)
    turns = 0.4 * np.random.default_rng(5).normal(size=(*still.rotations.shape[:2], 3))
    return replace(still, rotations=rot.multiply(still.rotations, rot.from_rotation_vector(turns)))


def fields(plan, source, target):
    chosen = plan.select(source[0])
    here = interaction_field(*source, chosen.observers, chosen.targets, chosen.source)
    return chosen, here, interaction_field(*target, chosen.observers, chosen.targets, chosen.both)


def without(sensors, missing):
    """The same sensors, of which some miss."""
    valid = sensors.valid.copy()
    valid[missing] = False
    return replace(sensors, valid=valid)


def of_part(sensors, part):
    return np.flatnonzero(np.isin(np.array(BONES)[sensors.layout.bones], PARTS[part]))


def reference(source, target, source_pose, target_pose, nearest=10, farthest=10):
    """The paper's text as loops: row by row the entries (target, d on the source, d on the target or None) of a frame."""
    (here, source_frames), (there, target_frames) = source_pose, target_pose
    rows = []
    for limb, parts in GROUPS.items():
        for part in parts:
            for i in of_part(source, limb):
                rows.append((i, []))
                if not source.valid[i]:
                    continue
                seen = [j for j in of_part(source, part) if source.valid[j]]
                seen.sort(key=lambda j: (float(np.sum((here[j] - here[i]) ** 2)), j))
                near = seen[:nearest]
                far = [j for j in reversed(seen) if j not in near][:farthest]
                for j in near + far:
                    entry = np.linalg.inv(source_frames[i]) @ (here[j] - here[i])
                    both = target.valid[i] and target.valid[j]
                    rows[-1][1].append(
                        (j, entry, np.linalg.inv(target_frames[i]) @ (there[j] - there[i]) if both else None)
                    )
    return rows


def test_the_field_is_the_papers(bodies, poses):
    plan = prepare_field(*bodies)
    chosen, here, there = fields(plan, *poses)
    assert chosen.targets.shape == (3, 480, 20) and here.shape == there.shape == (3, 480, 20, 3)
    assert (chosen.both != chosen.source).any()
    for frame in range(3):
        rows = reference(*bodies, *(tuple(each[frame] for each in pose) for pose in poses))
        for row, (observer, entries) in enumerate(rows):
            used = chosen.source[frame, row]
            assert chosen.observers[row] == observer and used.sum() == len(entries)
            assert chosen.targets[frame, row][used].tolist() == [j for j, _, _ in entries]
            both = chosen.both[frame, row]
            for field, mask, side in ((here, used, 1), (there, both, 2)):
                known = [entry[side] for entry in entries if entry[side] is not None]
                assert np.allclose(field[frame, row][mask], np.reshape(known, (-1, 3)), rtol=0, atol=1e-14)
            assert both[used].tolist() == [seen is not None for _, _, seen in entries] and not both[~used].any()
    assert not here[~chosen.source].any() and not there[~chosen.both].any()


def test_single_precision_is_kept_and_enough(bodies, poses):
    chosen = prepare_field(*bodies).select(poses[0][0])
    here, single = (
        interaction_field(*pose, chosen.observers, chosen.targets, chosen.source)
        for pose in (poses[0], tuple(each.astype(np.float32) for each in poses[0]))
    )
    assert single.dtype == np.float32 and np.abs(single - here).max() < 1e-6


def test_rows_of_a_group_lie_together(bodies):
    plan = prepare_field(*bodies)
    for limb, parts in GROUPS.items():
        rows = plan.rows(limb)
        own = of_part(bodies[0], limb)
        assert plan.observers[rows].tolist() == np.tile(own, len(parts)).tolist()
    assert plan.rows("rightLeg").stop == len(plan.observers) == 480
    assert sorted(bone for bones in PARTS.values() for bone in bones) == sorted(BONES)


def test_no_pair_is_counted_twice(bodies, poses):
    chosen = prepare_field(*bodies, nearest=40, farthest=40).select(poses[0][0])
    for row in range(0, len(chosen.observers), 7):
        seen = chosen.targets[0, row][chosen.source[0, row]]
        assert len(np.unique(seen)) == len(seen)


def test_moving_and_turning_the_world_changes_nothing(bodies, poses):
    plan, (places, frames) = prepare_field(*bodies), poses[0]
    turn = rot.to_matrix(rot.from_rotation_vector(np.array([0.4, -1.3, 0.8])))
    moved = np.where(bodies[0].valid[:, None], places @ turn.T + [3e5, -2e4, 7e4], 0.0), turn @ frames
    chosen, here, _ = fields(plan, (places, frames), poses[1])
    again, there, _ = fields(plan, moved, poses[1])
    assert np.array_equal(chosen.targets, again.targets)
    assert np.allclose(here, there, atol=1e-9)


def test_a_body_agrees_with_itself(bodies, poses):
    body, pose = bodies[0], poses[0]
    plan = prepare_field(body, body)
    chosen, here, there = fields(plan, pose, pose)
    assert np.array_equal(chosen.source, chosen.both) and np.array_equal(here, there)
    assert np.isclose(cosine_loss(here, there, chosen.both), -np.count_nonzero(chosen.both) / 3, rtol=1e-12)
    assert vector_loss(here, there, chosen.both, 0.04, 0.04) == 0
    assert distance_matrix_loss(pose[0], pose[0]) == 0


def test_the_order_of_sensors_does_not_matter(bodies, poses):
    order = np.random.default_rng(2).permutation(288)
    layout = paper_layout()
    shuffled = Layout(layout.bones[order], layout.along[order], layout.around[order])
    others = tuple(sensed(name, shuffled) for name in ("thin", "very_heavy"))
    mixed = tuple(tuple(each[:, order] for each in pose) for pose in poses)
    pairs = []
    for plan, pose, new in (
        (prepare_field(*bodies), poses, np.arange(288)),
        (prepare_field(*others), mixed, order),
    ):
        chosen, here, there = fields(plan, *pose)
        at = np.argwhere(chosen.both)
        named = new[chosen.observers[at[:, 1]]], new[chosen.targets[chosen.both]]
        found = np.column_stack([at[:, 0], *named, here[chosen.both], there[chosen.both]])
        pairs.append(found[np.lexsort(found[:, 2::-1].T)])
    assert np.allclose(*pairs, atol=1e-12)


def test_what_is_missing_on_the_target_is_masked_and_not_replaced(bodies, poses):
    missing = np.flatnonzero(bodies[1].valid)[::5]
    whole, some = prepare_field(*bodies).select(poses[0][0]), None
    target = without(bodies[1], missing)
    some, here, there = fields(prepare_field(bodies[0], target), *poses)
    assert np.array_equal(some.targets, whole.targets) and np.array_equal(some.source, whole.source)
    gone = np.isin(some.targets, missing) | np.isin(some.observers, missing)[:, None]
    assert np.array_equal(some.both, whole.both & ~gone)
    assert here[some.source & gone].any() and not there[gone].any()


def test_what_is_missing_on_the_source_is_never_seen(bodies, poses):
    missing = np.flatnonzero(bodies[0].valid)[::5]
    plan = prepare_field(without(bodies[0], missing), bodies[1])
    chosen, here, _ = fields(plan, *poses)
    assert chosen.targets.shape == (3, 480, 20)
    assert not np.isin(chosen.targets[chosen.source], missing).any()
    assert not chosen.source[:, np.isin(chosen.observers, missing)].any()
    assert (chosen.targets == chosen.observers[:, None])[~chosen.source].all() and not here[~chosen.source].any()


@pytest.mark.parametrize("left", [12, 0])
def test_parts_with_few_sensors_leave_the_rest_of_the_row_empty(bodies, poses, left):
    head = of_part(bodies[0], "head")
    kept = head[bodies[0].valid[head]][:left]
    source = without(bodies[0], np.setdiff1d(head, kept))
    plan = prepare_field(source, bodies[1])
    chosen = plan.select(poses[0][0])
    rows = next(block.rows for block in plan.blocks if (block.limb, block.part) == ("leftArm", "head"))
    looking = source.valid[chosen.observers[rows]]
    assert (chosen.source[:, rows].sum(axis=2) == np.where(looking, left, 0)).all()
    for row in np.flatnonzero(looking):
        at = rows.start + row
        assert sorted(chosen.targets[0, at][chosen.source[0, at]]) == sorted(kept)


def test_a_body_without_any_sensor_has_an_empty_field(bodies, poses):
    plan = prepare_field(without(bodies[0], slice(None)), bodies[1])
    chosen, here, there = fields(plan, *poses)
    assert not chosen.source.any() and not chosen.both.any() and not here.any() and not there.any()
    assert field_losses(plan, *poses)["pairs"] == 0 and np.isfinite(plan.radii[0]).all()


def test_nearest_only_and_farthest_only_are_halves_of_both(bodies, poses):
    both = prepare_field(*bodies).select(poses[0][0])
    near = prepare_field(*bodies, nearest=10, farthest=0).select(poses[0][0])
    far = prepare_field(*bodies, nearest=0, farthest=10).select(poses[0][0])
    assert np.array_equal(near.targets, both.targets[..., :10]) and np.array_equal(near.both, both.both[..., :10])
    assert np.array_equal(far.targets, both.targets[..., 10:]) and np.array_equal(far.both, both.both[..., 10:])
    lengths = np.linalg.norm(
        poses[0][0][np.arange(3)[:, None, None], both.targets] - poses[0][0][:, both.observers, None], axis=-1
    )
    seeing = both.source.all(axis=2)
    assert (np.diff(lengths[..., :10][seeing]) >= 0).all() and (np.diff(lengths[..., 10:][seeing]) <= 0).all()
    assert (lengths[..., 9] <= lengths[..., 19])[seeing].all()


def test_at_one_distance_the_lower_index_is_nearer():
    squared = np.array([[[1.0, 1.0, -1e-17, 4.0, 4.0]]])  # expanded squares may end up below zero
    assert nearest_and_farthest(squared.copy(), 2, 2).tolist() == [[[2, 0, 4, 3]]]
    assert nearest_and_farthest(squared.copy(), 3, 0).tolist() == [[[2, 0, 1]]]
    assert nearest_and_farthest(squared[..., :1].copy(), 1, 0).tolist() == [[[0]]]


def test_sensors_in_one_place_give_zero_and_not_nan(bodies, poses):
    plan = prepare_field(*bodies)
    points = np.full_like(poses[0][0], 1.5), poses[0][1]
    chosen, here, there = fields(plan, points, points)
    assert chosen.both.any() and not here.any() and not there.any()
    with np.errstate(all="raise"):
        assert cosine_loss(here, there, chosen.both) == 0
        assert vector_loss(here, there, chosen.both, 0.03, 0.05) == 0
        assert distance_matrix_loss(points[0], poses[1][0]) > 0 and not distance_shares(points[0]).any()
    one = here.copy()
    one[0, 0, 0] = [0, 0, 2.0]
    assert cosine_loss(one, there, chosen.both) == 0


def test_cosine_sees_directions_and_the_vector_form_lengths(bodies, poses):
    plan = prepare_field(bodies[0], bodies[0])
    chosen, here, _ = fields(plan, poses[0], poses[0])
    count = np.count_nonzero(chosen.both)
    assert np.isclose(cosine_loss(here, 3 * here, chosen.both), -count / 3)
    assert np.isclose(cosine_loss(here, -here, chosen.both), count / 3)
    assert np.isclose(vector_loss(here, 3 * here, chosen.both, plan.radii[0], 3 * plan.radii[0]), 0, atol=1e-9)
    away = sum(float(d @ d) for d in here[chosen.both]) / 3
    assert np.isclose(vector_loss(here, 3 * here, chosen.both, 1.0, 1.0), 4 * away)
    assert np.isclose(vector_loss(here, 3 * here, chosen.both, 2.0, 2.0), away)
    less = chosen.both & (np.arange(20) < 3)
    assert np.isclose(vector_loss(here, 0 * here, less, 1.0, 1.0), sum(float(d @ d) for d in here[less]) / 3)
    assert np.isclose(cosine_loss(here, here, less), -np.count_nonzero(less) / 3)


def test_distance_matrices_are_those_of_r2et(poses):
    a, b = poses[0][0][:, :9], poses[1][0][:, :9]
    total = 0.0
    for x, y in zip(a, b):
        for i in range(9):
            shares = [[float(np.linalg.norm(z[i] - other)) for other in z] for z in (x, y)]
            total += sum((p / sum(shares[0]) - q / sum(shares[1])) ** 2 for p, q in zip(*shares))
    assert np.isclose(distance_matrix_loss(a, b), total / 3)
    turn = rot.to_matrix(rot.from_rotation_vector(np.array([0.4, -1.3, 0.8])))
    assert distance_matrix_loss(a, 1.7 * a @ turn.T + 4.0) < 1e-20


def test_entries_carry_their_semantic_coordinates(bodies, poses):
    layout = bodies[0].layout
    chosen = prepare_field(*bodies).select(poses[0][0][:1])
    bones, along, around = semantic_coordinates(layout, chosen.observers, chosen.targets)
    for row, column in ((0, 0), (200, 7), (479, 19)):
        pair = [chosen.observers[row], chosen.targets[0, row, column]]
        assert bones[0, row, column].tolist() == layout.bones[pair].tolist()
        assert along[0, row, column].tolist() == layout.along[pair].tolist()
        assert around[0, row, column].tolist() == layout.around[pair].tolist()


def test_radii_grow_with_the_body(bodies):
    thin, heavy = (part_radii(body) for body in bodies)
    assert all(heavy[part] > thin[part] for part in PARTS)
    assert 0.015 < thin["leftArm"] < thin["leftLeg"] < thin["torso"] < 0.2
    assert np.isclose(thin["leftArm"], thin["rightArm"], rtol=0.05)
    plan = prepare_field(*bodies)
    assert (plan.radii[1][plan.rows("leftLeg")] == heavy["leftLeg"]).all()


def test_hands_can_be_made_to_look_at_legs(bodies, poses):
    plan = prepare_field(*bodies, groups={"leftArm": ("leftLeg", "rightLeg")})
    chosen = plan.select(poses[0][0])
    legs = np.concatenate([of_part(bodies[0], part) for part in ("leftLeg", "rightLeg")])
    assert np.isin(chosen.targets[chosen.source], legs).all() and len(chosen.observers) == 96


def test_pieces_change_nothing_and_bound_the_memory(monkeypatch):
    layout = paper_layout(2, 2)
    a, b = sensed("thin", layout), sensed("heavy", layout)
    plan = prepare_field(a, b, nearest=4, farthest=4)
    one = pose_sensors(a, moving(a, 60)), pose_sensors(b, moving(b, 60))
    chosen, here, there = fields(plan, *one)
    whole = field_losses(plan, *one)
    assert np.isclose(whole["cosine"], cosine_loss(here, there, chosen.both))
    assert np.isclose(whole["by_radius"], vector_loss(here, there, chosen.both, *plan.radii), rtol=1e-6)
    assert np.isclose(whole["by_height"], vector_loss(here, there, chosen.both, *plan.heights), rtol=1e-6)
    assert np.isclose(whole["pairs"], np.count_nonzero(chosen.both) / 60)

    many = tuple(tuple(np.tile(each, (50,) + (1,) * (each.ndim - 1)) for each in pose) for pose in one)
    tracemalloc.start()
    long = plan.select(many[0][0])
    held, peak = tracemalloc.get_traced_memory()
    assert peak - held < 8e6
    tracemalloc.reset_peak()
    field = interaction_field(*many[0], long.observers, long.targets, long.source)
    after, peak = tracemalloc.get_traced_memory()
    assert after - held > 0.9 * field.nbytes and peak - after < 6e6
    tracemalloc.reset_peak()
    again = field_losses(plan, *many)
    assert tracemalloc.get_traced_memory()[1] - after < 70e6
    tracemalloc.stop()
    assert np.array_equal(long.targets[-60:], chosen.targets) and np.array_equal(field[-60:], here)
    assert np.isclose(again["cosine"], whole["cosine"]) and np.isclose(again["by_height"], whole["by_height"])

    for own, name in ((module, "DISTANCES"), (module, "ENTRIES"), (losses, "HELD")):
        monkeypatch.setattr(own, name, 50)
    small, tiny, _ = fields(plan, *one)
    assert np.array_equal(small.targets, chosen.targets) and np.array_equal(small.both, chosen.both)
    assert np.array_equal(tiny, here) and np.isclose(field_losses(plan, *one)["cosine"], whole["cosine"])


def test_an_empty_clip_has_an_empty_field(bodies, poses):
    nothing = tuple((places[:0], frames[:0]) for places, frames in poses)
    plan = prepare_field(*bodies)
    chosen, here, there = fields(plan, *nothing)
    assert here.shape == (0, 480, 20, 3) and cosine_loss(here, there, chosen.both) == 0
    assert field_losses(plan, *nothing)["cosine"] == 0


def test_a_layout_without_limbs_has_no_rows():
    trunk = sensed("thin", Layout(np.zeros(8, np.int64), np.full(8, 0.5), np.arange(8) * 0.7))
    pose = pose_sensors(trunk, moving(trunk))
    plan = prepare_field(trunk, trunk)
    assert plan.select(pose[0]).targets.shape == (3, 0, 20)
    assert field_losses(plan, pose, pose) == {"cosine": 0, "by_radius": 0, "by_height": 0, "pairs": 0}


def test_mistakes_are_named(bodies, poses):
    plan = prepare_field(*bodies)
    with pytest.raises(RetargetError, match="one layout only; received 288 and 72"):
        prepare_field(bodies[0], sensed("thin", paper_layout(2, 2)))
    for near, far in ((0, 0), (-1, 10)):
        with pytest.raises(RetargetError, match=f"received {near} and {far}"):
            prepare_field(*bodies, nearest=near, farthest=far)
    with pytest.raises(RetargetError, match="leftArm"):
        prepare_field(*bodies, groups={"leftArms": ("head",)})
    with pytest.raises(RetargetError, match="at least one"):
        prepare_field(*bodies, groups={})
    with pytest.raises(RetargetError, match="leftLeg"):
        plan.rows("leftFoot")
    with pytest.raises(RetargetError, match="received positions of 10"):
        plan.select(poses[0][0][:, :10])
    broken = poses[0][0].copy()
    broken[1, 4, 0] = np.nan
    with pytest.raises(RetargetError, match="frame 1"):
        plan.select(broken)
    with pytest.raises(RetargetError, match="3 and 2 frames"):
        field_losses(plan, poses[0], tuple(each[:2] for each in poses[1]))
