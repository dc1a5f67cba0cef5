"""The bench of shape transfer: its cases, its judge and what it sums up."""

import json

import numpy as np
import pytest

from retarget.body.human import human
from retarget.evaluate.benches import shape_transfer
from retarget.evaluate.remeshed import clustered
from retarget.evaluate.remeshed_body import remeshed_body
from retarget.evaluate.shape_cases import APART, HELD_OUT, PAIRS, body, shape_case
from retarget.evaluate.shape_judge import judge_pose, judged_shape, kept_contacts, shape_figures
from retarget.geometry.resample import Surface
from retarget.motion.joint_frames import prepare_frames


@pytest.fixture(scope="module")
def case():
    return shape_case("hands_on_hips", ("thin", "heavy"))


def test_pairs_that_are_only_reported_were_not_looked_at():
    assert not set(PAIRS) & set(HELD_OUT)


def test_the_frame_is_the_one_that_touches_most(case):
    rows = case.touch.pose_rows()
    frames = np.bincount(case.touch.contacts.frame[rows], minlength=len(case.touch.motion))
    assert frames[case.frame] == frames.max() > 500
    assert len(case.motion) == 1


def test_the_target_at_rest_has_its_own_shape(case):
    target = judged_shape(case.target)
    figures = shape_figures(target, target.frames.rest)
    assert max(figures.values()) < 1e-6


def test_a_swollen_part_a_longer_limb_and_stretched_skin_are_seen(case):
    target = judged_shape(case.target)
    rest = target.frames.rest
    moved = rest.copy()
    shin = target.collider.parts.vertex_parts == target.collider.parts.index("leftFoot")
    moved[shin] -= [0.0, 0.05, 0.0]
    figures = shape_figures(target, moved)
    assert figures["limb_length_error_percent_worst"] > 3
    assert figures["part_volume_error_percent_worst"] > 2
    assert figures["shape_mdel_mm"] > 0.05


def test_the_source_keeps_its_own_contacts(case):
    own, counted = kept_contacts(case.touch, case.source, case.posed[None], np.array([case.frame]))
    assert own == 1.0 and counted > 500
    away = case.posed.copy()
    hand = case.touch.parts.vertex_parts == case.touch.parts.index("leftHand")
    away[hand] += [0.3, 0.0, 0.0]
    lost, _ = kept_contacts(case.touch, case.source, away[None], np.array([case.frame]))
    assert lost < 0.7


def test_no_contact_on_a_frame_is_no_figure(case):
    assert kept_contacts(case.touch, case.source, case.posed[None], np.array([0]))[0] is None


def test_the_target_s_own_skinning_penetrates_where_rotations_are_copied(case):
    from retarget.body.skinning import skin_motion
    from retarget.methods import CopyRotations
    from retarget.retargeting import prepare

    copied = prepare(case.source, case.target, CopyRotations())(case.motion).motion
    figures = judge_pose(case, skin_motion(case.target.character, copied)[0].astype(np.float64))
    assert figures["excess_penetration_percent"] > 5 and figures["new_morphology_contacts"] > 0


def test_a_remeshed_body_keeps_its_skin():
    character = human()
    surface, places = clustered(Surface(character.mesh.vertices, character.mesh.faces), 2000, np.random.default_rng(1))
    made = remeshed_body(character, surface.faces, places)
    frames, own = prepare_frames(made), prepare_frames(character)
    _, at = frames.of(frames.rest)
    _, rest = own.of(own.rest)
    main = [character.skeleton.names.index(name) for name in ("leftLowerArm", "rightFoot", "head")]
    assert np.abs(at[main] - rest[main]).max() < 0.002
    assert made.skin.weights.sum(axis=1) == pytest.approx(1.0)


def test_a_run_says_all_that_the_issue_names(monkeypatch, tmp_path, command):
    only = shape_case("hand_to_shoulder", ("thin", "heavy"))
    monkeypatch.setattr(shape_transfer, "shape_cases", lambda quick: iter([("seen", "6k9", only)]))
    monkeypatch.setattr(shape_transfer, "QUICK_PAIRS", (("thin", "heavy"),))
    monkeypatch.setattr(shape_transfer, "QUICK_POSES", ("hand_to_shoulder",))
    monkeypatch.setattr(shape_transfer, "sequence_row", lambda motion, source, target: {
        "motion": motion, "frames": 90, "contacts_kept": 1.0, "jerk_ratio": 1.0, "foot_slide_cm": 0.1, "source_foot_slide_cm": 0.1,
    })  # fmt: skip
    monkeypatch.setattr(shape_transfer, "foreign_row", lambda pose, source, target: {"contacts_kept": 0.9})
    code, out, _ = command(
        "bench", "shape-transfer", "--quick", "--json", tmp_path / "all.json", "--pictures", tmp_path
    )
    assert code == 0 and "Basset 2019" in out
    report = json.loads((tmp_path / "all.json").read_text())
    summary = report["summary"]
    wanted = {
        "warm_ms_6k9", "cold_ms_6k9", "speed_ratio_cold", "speed_ratio_warm", "energy_ratio", "energy_ratio_worst",
        "contacts_kept", "new_morphology_contacts", "excess_penetration_percent", "excess_penetration_percent_worst",
        "depth_p95_mm", "part_volume_error_percent", "limb_length_error_percent", "shape_mdel_mm", "jerk_ratio",
        "foot_slide_cm", "foreign_contacts_kept",
    }  # fmt: skip
    assert wanted <= set(summary)
    assert summary["contacts_kept"] > 0.95 and summary["contacts_kept"] > summary["contacts_kept_copy"]
    assert summary["excess_penetration_percent"] < 0.5 < summary["excess_penetration_percent_copy"]
    assert summary["part_volume_error_percent"] < 2
    assert len(list(tmp_path.glob("shape-transfer-*.png"))) >= 1
    assert {row["method"] for row in report["rows"]} == {"copy-rotations", "deformation transfer", "Basset 2019", "ours"}


def test_bodies_of_two_resolutions_are_one_body():
    fine, coarse = body("heavy", finer=True), body("heavy")
    assert len(fine.character.mesh.vertices) > 1.5 * len(coarse.character.mesh.vertices)
    assert fine.height == pytest.approx(coarse.height, rel=0.01)


def test_motions_of_no_contact_are_of_the_two_kinds_that_poses_of_contact_lack():
    """Or the times by kind would not be all that the paper tells (section 7.1)."""
    from retarget.evaluate.shape_rows import kind_of, ready

    cases = [shape_case(pose, PAIRS[0]) for pose in APART]
    assert [kind_of(case, ready(case.source, case.target)) for case in cases] == ["none", "collisions"]
