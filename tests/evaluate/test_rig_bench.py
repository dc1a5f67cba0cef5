"""The bench of rig transfer finds true rigs faultless, sees made faults, and counts as it says."""

from dataclasses import replace

import numpy as np
import pytest

from retarget.body.human import human_model
from retarget.character import Mesh
from retarget.errors import RetargetError
from retarget.evaluate.benches import rig_transfer
from retarget.evaluate.reference import pyfm_pipeline
from retarget.evaluate.rig_cases import rig_case
from retarget.evaluate.rig_judge import judge_map, judge_rig, main_weights, truth_of
from retarget.evaluate.rig_real import joint_figures, knees_forward, unlike
from retarget.evaluate.rig_rows import OURS_MAPPED, basis_of
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.geometry.topology import vertex_normals
from retarget.rig.rigging import Rigged
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template


@pytest.fixture(scope="module")
def case():
    return rig_case(1)


@pytest.fixture(scope="module")
def truth(case):
    return truth_of(case)


def true_rig(case, truth) -> Rigged:
    order = [case.character.skeleton.index(name) for name in human_template().names]
    return Rigged(truth.character, 1.0, case.places, case.joints[order], truth.posed, 1.0 / case.scale, ())


def test_the_true_rig_is_faultless(case, truth):
    row = judge_rig(case, truth, true_rig(case, truth))
    for key in ("map_error_percent", "flipped_percent", "joint_error_cm", "finger_error_cm", "registration_mm"):
        assert row[key] == pytest.approx(0, abs=1e-6), key
    assert row["rest_vertex_error_cm"] == pytest.approx(0, abs=1e-6)
    assert row["weight_mse_x100"] < 1e-3 and row["animated_mpvd_cm"] < 0.02 and row["torn_percent"] < 0.1
    assert row["success"] is True and row["unit_factor"] == pytest.approx(1)


def test_made_faults_are_seen_for_what_they_are(case, truth):
    rigged = true_rig(case, truth)
    mirror, rest = human_model().mirror, human_template().model.points
    swapped = judge_map(case, case.places.of(rest[mirror]))
    assert swapped["flipped_percent"] > 70 and not swapped["success"]
    body = replace(
        rigged.character,
        mesh=replace(case.mesh, vertices=truth.rest + np.array([0.0, 0, 0.1]) * (truth.rest[:, :1] > 0.3)),
    )
    bent = judge_rig(case, truth, replace(rigged, character=body))
    assert bent["rest_vertex_error_cm"] > 0.3 and bent["animated_mpvd_cm"] > 0.3 and bent["joint_error_cm"] < 1e-6
    centimetre = 0.01 * case.height / 1.7
    off = judge_rig(
        case, truth, replace(rigged, joints=rigged.joints + [centimetre, 0, 0], posed=rigged.posed + [0, centimetre, 0])
    )
    assert off["joint_error_cm"] == pytest.approx(1) and off["registration_mm"] == pytest.approx(10)
    half = judge_rig(case, truth, replace(rigged, unit=0.5 * rigged.unit))
    assert half["unit_factor"] == pytest.approx(2)


def test_rest_of_what_lies_off_the_body_lies_off_it_as_far_and_on_the_same_side():
    """Clothes and noise are taken back with the skin beneath, at their distance, along its normal."""
    case = rig_case(5)
    truth, rest = truth_of(case), case.character.mesh.vertices
    off = np.linalg.norm(case.mesh.vertices - case.places.of(case.posed), axis=1) / case.scale
    there = truth.rest - case.places.of(rest)
    np.testing.assert_allclose(np.linalg.norm(there, axis=1), off, atol=1e-9)
    assert off[~case.body].mean() > 0.005 and (truth.posed != case.posed).any()
    normals = case.places.of(vertex_normals(rest, case.character.mesh.faces))
    clothes = ~case.body
    assert ((there * normals).sum(axis=1)[clothes] / off[clothes]).mean() > 0.93


def test_fingers_count_to_their_hands():
    weights = np.eye(len(human_model().joint_names))
    merged = main_weights(weights)
    thumb, hand = human_model().joint_names.index("leftThumbDistal"), MAIN.index("leftHand")
    assert merged[thumb, hand] == 1 and (merged.sum(axis=1) == 1).all()


def test_joints_of_a_real_rig_are_judged_by_the_stated_rule():
    truth = {
        name: human_template().model.joints[number]
        for number, name in enumerate(human_template().names)
        if name in MAIN
    }
    same = joint_figures(truth, truth, 1.7)
    assert same["success"] and same["joint_error_percent"] == 0 and same["swapped"] == 0
    moved = joint_figures(truth, {name: place + [0.2, 0, 0] for name, place in truth.items()}, 1.7)
    assert not moved["success"] and moved["joint_error_percent"] == pytest.approx(100 * 0.2 / 1.7)
    mirrored = joint_figures(truth, {name: place * [-1, 1, 1] for name, place in truth.items()}, 20.0)
    assert mirrored["swapped"] == 1 and not mirrored["success"]  # within 5 % of a giant, but exchanged
    spine = joint_figures(truth, truth | {"chest": truth["chest"] + [0, 3.0, 0]}, 1.7)
    assert not spine["success"] and spine["success_limbs"] and spine["worst_joint"].startswith("chest")


def test_knees_that_bend_backwards_are_seen():
    template = human_template()
    joints = dict(zip(template.names, template.model.joints))
    assert knees_forward(joints) > -0.05
    broken = joints | {"leftLowerLeg": joints["leftLowerLeg"] - [0, 0, 0.2]}
    assert knees_forward(broken) < -0.1


def test_the_odd_one_of_three_poses_is_told():
    places = np.random.default_rng(0).normal(size=(30, 3))
    away = unlike([places, places, places[::-1]])
    assert away[0] == away[1] == 0 and away[2] > 50
    with pytest.raises(RetargetError, match="three poses"):
        unlike([places, places])


def test_spectra_on_a_decimated_copy_are_the_surfaces_own(monkeypatch):
    from retarget.evaluate import rig_rows

    template = human_template()
    body = Surface(template.model.points, template.faces)
    monkeypatch.setattr(rig_rows, "FUNCTIONS", 30)
    monkeypatch.setattr(rig_rows, "COARSE", 4000)
    found = basis_of(body)
    np.testing.assert_allclose(found.vectors.T @ (found.masses[:, None] * found.vectors), np.eye(30), atol=1e-9)
    monkeypatch.setattr(rig_rows, "COARSE", len(body))
    exact = basis_of(body)
    np.testing.assert_allclose(found.values[1:], exact.values[1:], rtol=0.03)
    overlap = np.linalg.svd(found.vectors.T @ (exact.masses[:, None] * exact.vectors))[1]
    assert overlap[:25].min() > 0.98


def made(seed, sort, half, **figures):
    return {"seed": seed, "name": str(seed), "sort": sort, "half": half, "method": "ours", "refused": None,
            "success": True, "unit_factor": 1.0, "weight_mse_x100": 0.1} | figures  # fmt: skip


def test_the_summary_counts_as_it_says():
    cases = [
        made(0, "clean", "seen"),
        made(1000, "clean", "unseen"),
        made(1003, "clean", "unseen", refused="no body", success=False),
        made(1001, "noisy", "unseen", success=False, weight_mse_x100=0.4),
        made(1002, "multi", "unseen", unit_factor=39.37),
        made(1002, "multi", "unseen", weight_mse_x100=0.7) | {"method": OURS_MAPPED},
    ]
    del cases[2]["weight_mse_x100"], cases[2]["unit_factor"]
    real = [{"success": True, "refused": None}, {"success": False, "refused": "no"}]
    summary = rig_transfer._summary(cases, real, {"10k": {"seconds": 2.0, "peak_mb": 900.0, "template_seconds": 1.0}})
    assert (summary["success_rate"], summary["success_rate_noisy"], summary["success_rate_multi"]) == (0.5, 0.0, 1.0)
    assert (summary["refused_rate"], summary["silent_failure_rate"], summary["wrong_unit_rate"]) == (0.2, 0.2, 0.25)
    assert summary["weight_mse_x100"] == 0.7 and summary["weight_mse_x100_auto"] == pytest.approx(0.7 / 4)
    assert summary["weight_mse_x100_auto_median"] == pytest.approx(0.1) and summary["real_success_rate"] == 0.5
    assert (summary["seconds_10k"], summary["seconds_100k"], summary["peak_mb"]) == (2.0, None, 900.0)
    empty = rig_transfer._summary([], [], {})
    assert all(value is None for value in empty.values())


def test_a_refusal_is_a_row_and_pictures_are_drawn(monkeypatch, tmp_path, command):
    """A case that is refused is no success, and its mesh still stands on the sheet."""

    def refused(mesh, **known):
        if known:
            return true_rig(small, truth_of(small))
        raise RetargetError("no body was found")

    small = rig_case(1)
    monkeypatch.setattr(rig_transfer, "rig", refused)
    monkeypatch.setattr("retarget.evaluate.rig_rows.rig", refused)
    monkeypatch.setattr(rig_transfer, "QUICK", (1,))
    monkeypatch.setattr(rig_transfer, "real_bodies", lambda quick: iter(()))
    monkeypatch.setattr(
        rig_transfer, "rigging_cost", lambda n: {"seconds": 1.0, "peak_mb": None, "template_seconds": 1.0}
    )
    monkeypatch.setattr(pyfm_pipeline, "installed", lambda: False)
    code, out, _ = command("bench", "rig-transfer", "--quick", "--pictures", tmp_path)
    assert code == 0 and "failed: 1 woman T" in out and "no body was found" in out and "not installed" in out
    assert [path.name for path in tmp_path.iterdir()] == ["rig-transfer-01.png"]


def test_pictures_where_there_are_none_are_refused(tmp_path, command):
    code, _, err = command("bench", "skeletal", "--pictures", tmp_path)
    assert code == 2 and "has no pictures" in err
    (tmp_path / "file").touch()
    for place, problem in (("file", "is not a folder"), ("none/pictures", "none does not exist")):
        code, _, err = command("bench", "rig-transfer", "--pictures", tmp_path / place)
        assert code == 2 and problem in err


@pytest.mark.slow
def test_a_run_from_end_to_end(monkeypatch):
    """One case, and no process that is timed; `make test` gates all of the quick run."""
    monkeypatch.setattr(rig_transfer, "QUICK", (1024,))
    monkeypatch.setattr(rig_transfer, "rigging_cost", lambda n: {"seconds": n, "peak_mb": 1.0, "template_seconds": 2.0})
    shown = []
    report = rig_transfer.run(quick=True, show=shown.append)
    summary = report["summary"]
    assert summary["success_rate_noisy"] == 1.0 and summary["refused_rate"] == summary["silent_failure_rate"] == 0
    assert summary["weight_mse_x100"] < 0.1 and summary["weight_mse_x100"] < summary["weight_mse_x100_function"]
    assert summary["joint_error_cm"] < 1.5 and summary["registration_mm"] < 10 and summary["rest_vertex_error_cm"] < 2.5
    assert summary["seconds_10k"] == 10_000 and summary["template_seconds"] == 2.0
    assert len(shown) == 1 + len(report["real"]) and shown[0].vertices.shape[0] == 3
    assert {row["method"] for row in report["rows"]} >= {"ours", OURS_MAPPED, "function", "p2p", "eq. 10", "low-pass"}
    assert (pyfm_pipeline.installed()) == any(row["method"] == "pyFM" for row in report["rows"])


def test_a_rigging_process_that_fails_is_one_line(monkeypatch):
    from retarget.evaluate import rig_speed

    monkeypatch.setattr(rig_speed, "CHILD", "raise ValueError('out of luck')")
    with pytest.raises(RetargetError, match="failed: ValueError: out of luck"):
        rig_speed.rigging_cost(2000)


def test_a_case_with_loose_vertices_is_refused(case):
    from retarget.evaluate import rig_rows

    loose = replace(
        case,
        mesh=Mesh(np.concatenate([case.mesh.vertices, case.mesh.vertices[:1]]), case.mesh.faces),
        body=np.append(case.body, True),
    )
    used = np.unique(case.mesh.faces)
    with pytest.raises(RetargetError, match="1 vertices of no face"):
        rig_rows._for_all(loose, Places(case.places.corners[used], case.places.weights[used]), used)
