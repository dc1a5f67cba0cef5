"""The bench of scan retargeting: its cases, its truth and what it sums up."""

from dataclasses import replace

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.kinematics import still_motion, world_pose
from retarget.body.skinning import skin_motion
from retarget.casting import cast
from retarget.evaluate import scan_cases, scan_frames, scan_rows
from retarget.evaluate.benches import scan
from retarget.evaluate.scan_cases import CLOTHED, NAKED, POINTS, SCANNED, scan_case, unseen_body
from retarget.evaluate.scan_split import BENCH_BODIES, BENCH_TARGETS, BODY_SEEDS, TRAINING, VALIDATION
from retarget.geometry.closest import SurfaceIndex
from retarget.retargeting import prepare


@pytest.fixture(scope="module")
def short():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_cases, "SECONDS", 0.3)
        yield {kind: scan_case(kind, kind == CLOTHED, 1, 1) for kind in (NAKED, CLOTHED, SCANNED)}


def distances(points, surface, faces):
    places = SurfaceIndex(surface, faces).closest(points.astype(np.float64)).of(surface)
    return np.linalg.norm(places - points, axis=1)


def test_nobody_of_the_bench_was_learnt_from():
    learnt = {*BODY_SEEDS[TRAINING], *BODY_SEEDS[VALIDATION]}
    assert not learnt & {*BENCH_BODIES, *BENCH_TARGETS} and not {*BENCH_BODIES} & {*BENCH_TARGETS}


def test_there_are_as_many_cases_as_in_the_paper(monkeypatch):
    monkeypatch.setattr(scan_cases, "scan_case", lambda *case: case)
    assert [len(list(scan_cases.scan_cases(kind))) for kind in (NAKED, CLOTHED, SCANNED)] == [16, 12, 28]
    assert [len(list(scan_cases.scan_cases(kind, quick=True))) for kind in (NAKED, CLOTHED, SCANNED)] == [2, 2, 2]


def test_points_lie_on_who_is_captured(short):
    case = short[NAKED]
    assert all(len(cloud) == POINTS for cloud in case.capture.clouds)
    surface = skin_motion(case.source, case.performed).astype(np.float64)
    for frame in (0, len(surface) - 1):
        away = distances(case.capture.clouds[frame][:200], surface[frame], case.source.mesh.faces)
        assert away.max() < 1e-4


def test_clothes_and_faults_are_seen(short):
    surface = skin_motion(short[CLOTHED].source, short[CLOTHED].performed).astype(np.float64)[0]
    away = {
        kind: distances(short[kind].capture.clouds[0][:300], surface, short[kind].source.mesh.faces)
        for kind in (CLOTHED, SCANNED)
    }
    assert 0.004 < np.median(away[CLOTHED]) < 0.08
    assert 0.001 < np.median(away[SCANNED]) < 0.02


def test_the_truth_is_the_same_pose_on_another_body(short):
    case = short[NAKED]
    assert np.array_equal(case.performed.rotations, case.truth.rotations)
    assert case.source.skeleton.offsets[0, 1] != pytest.approx(case.target.skeleton.offsets[0, 1], rel=0.02)
    copied = prepare(cast(case.source), cast(case.target), scan_rows.COPIED)(case.performed).motion
    errors = scan_rows.errors(scan_rows.shown(case.target, copied), scan_rows.shown(case.target, case.truth))
    assert errors["mpjpe"] < 0.006 and errors["pa_mpjpe"] < 1e-4 and errors["mdel"] < 1e-5


def test_errors_are_zero_for_the_truth_and_grow(short):
    case = short[NAKED]
    truth = scan_rows.shown(case.target, case.truth)
    assert max(scan_rows.errors(truth, truth).values()) < 1e-6
    moved = scan_rows.Shown(truth.joints + [0.1, 0, 0], truth.vertices + [0.1, 0, 0])
    errors = scan_rows.errors(moved, truth)
    assert errors["mpjpe"] == pytest.approx(0.1) and errors["mpvd"] == pytest.approx(0.1) and errors["pa_mpjpe"] < 1e-6


def test_a_body_that_faces_the_other_way_is_a_flip(short):
    motion = short[NAKED].performed
    assert scan_rows.flips_percent(motion, motion) == 0.0
    turned = motion.rotations.copy()
    turned[:3, 0] = rot.multiply(rot.from_rotation_vector(np.array([0, np.pi, 0])), turned[:3, 0])
    flipped = replace(motion, rotations=turned)
    assert scan_rows.flips_percent(flipped, motion) == pytest.approx(100 * 3 / len(motion))


def test_single_clouds_have_their_joints_inside():
    for kind in (scan_frames.WHOLE, scan_frames.HALF_VIEW, scan_frames.FEW_POINTS):
        cloud, joints = scan_frames.single_cloud(kind, 3)
        low, high = cloud.min(axis=0) - 0.2, cloud.max(axis=0) + 0.2
        assert ((joints > low) & (joints < high)).all() and joints.shape == (22, 3)
    assert len(cloud) == 500


def test_weights_of_fingers_count_for_their_hands():
    weights = scan_frames.body_weights(unseen_body(BENCH_BODIES[0]))
    assert weights.shape[1] == 22 and np.allclose(weights.sum(axis=1), 1.0)


def test_arms_are_lifted_and_hang():
    body = unseen_body(BENCH_BODIES[0])
    names = body.skeleton.names[:22]
    hand, shoulder = names.index("leftHand"), names.index("leftUpperArm")
    drop = {}
    for suffix, lift in scan_frames.LIFTS.items():
        vertices, joints, turns = scan_frames.resting(body, lift)
        drop[suffix] = joints[shoulder, 1] - joints[hand, 1]
        assert np.allclose(joints, world_pose(body_at_rest(body, lift))[1][0, :22], atol=1e-6) and turns.shape == (22, 4)
    assert drop["_arms_down"] > 0.3 > drop[""]


def body_at_rest(body, lift):
    still = still_motion(body.skeleton)
    turned = still.rotations.copy()
    for name, sign in (("leftUpperArm", 1.0), ("rightUpperArm", -1.0)):
        turned[:, body.skeleton.index(name)] = rot.from_rotation_vector(np.radians([0, 0, sign * lift]))
    return replace(still, rotations=turned)


@pytest.mark.slow
def test_a_run_says_all_that_is_promised(monkeypatch):
    monkeypatch.setattr(scan_cases, "SECONDS", 0.4)
    monkeypatch.setattr(scan, "KINDS", (NAKED,))
    monkeypatch.setattr(scan_cases, "QUICK_CASES", 1)
    monkeypatch.setattr(scan, "QUICK_SAMPLES", 2)
    monkeypatch.setattr(scan, "QUICK_FRAMES", 12)
    shown = []
    report = scan.run(quick=True, show=shown.append)
    summary = report["summary"]
    assert all(summary[f"naked_{key}"] is not None for key in scan.FIGURES)
    assert summary["naked_mpjpe"] < 0.05 and summary["naked_mdel"] < 0.002 and summary["flips_percent"] == 0
    assert summary["regressor_mpjpe"] < 0.05 and summary["skin_weight_mse"] < 0.002 and summary["fps"] > 1
    assert len(shown) == 3 and {row["method"] for row in report["rows"]} >= {scan_rows.COPY, scan_rows.OURS, scan_rows.ONLINE}
    assert any("Rekik 2023, its own data" in line for line in report["lines"])
