"""The report on one result: nothing to say of a perfect one, and every planted fault found, measured and named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, scaled, stand, turned, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.character import Character
from retarget.errors import RetargetError
from retarget.evaluate import report_surface
from retarget.evaluate.problems import Problem, episodes, spoken, together, worst_first
from retarget.evaluate.report import evaluate
from retarget.evaluate.report_surface import penetration_figures, surface_track
from retarget.evaluate.take import Take, on_one_clock
from retarget.motion.filter import cut, resample
from retarget.motion.library import embedded_motion


@pytest.fixture(autouse=True, scope="module")
def prepared_once():
    """A body is prepared once for all of these tests, not once a report."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("prepare_contacts", "prepare_collider"):
            patch.setattr(report_surface, name, cache(getattr(report_surface, name)))
        yield


@cache
def bare():
    """The embedded human without its skin."""
    return cast_by_names(Character(body().skeleton))


def joints_only(source, result, **options):
    return evaluate(Take(bare(), source), Take(bare(), result), **options)


def sentences(report):
    return " | ".join(problem.sentence for problem in report.problems)


def shifted(motion, by):
    """The whole motion moved, by frame."""
    by = np.broadcast_to(by, (len(motion), 3))
    return replace(motion, translations=motion.translations + by[:, None])


def ramp(frames, start, stop):
    return np.clip((np.arange(frames) - start) / (stop - start), 0, 1)[:, None]


@cache
def belly():
    """The moments around which the right hand comes to lie on the belly."""
    return cut(embedded_motion("hand_on_belly"), 1.7, 2.0)


def with_hand_moved(motion, by):
    """The right hand moved in the world, its joint torn from the forearm: the skin of the hand goes along as it is."""
    hand = motion.skeleton.index("rightHand")
    rotations, positions = world_pose(motion)
    forearm = motion.skeleton.parents[hand]
    local = rot.rotate(rot.inverse(rotations[:, forearm]), positions[:, hand] + by - positions[:, forearm])
    return replace(motion, moved=(0, hand), translations=np.stack([motion.translations[:, 0], local], axis=1))


def pushed(motion, metres):
    """The right hand moved into the belly."""
    return with_hand_moved(motion, np.array([0.0, 0.0, -metres]))


# Perfect results


@cache
def perfect():
    return evaluate(Take(actor(), belly()), Take(actor(), belly()))


def test_of_a_perfect_result_there_is_nothing_to_say():
    report = perfect()
    figures = report.figures
    for key in (
        "direction_error_deg",
        "orientation_error_deg",
        "new_penetration_percent",
        "excess_penetration_percent",
    ):
        assert figures[key] == pytest.approx(0, abs=1e-6), key
    assert figures["contacts_kept"] == 1 and figures["jerk_ratio"] == pytest.approx(1)
    assert figures["foot_slide_cm"] == figures["source_foot_slide_cm"] < 0.1
    assert report.problems == () and report.facts["rests on"] == "feet"
    touch = "right hand – abdomen"
    assert report.curves[f"touch/result/{touch}"].any()
    assert np.array_equal(report.curves[f"touch/result/{touch}"], report.curves[f"touch/source/{touch}"])


def test_every_curve_has_a_value_a_frame():
    report = perfect()
    assert all(len(curve) == len(belly()) == report.figures["frames"] for curve in report.curves.values())
    kinds = {name.split("/")[0]: curve.dtype for name, curve in report.curves.items()}
    assert set(kinds) == {"time_s", "ground", "touch", "depth_cm", "foot_height_cm", "speed_m_s"}
    assert all(kinds[kind] == np.dtype(bool) for kind in ("ground", "touch"))
    assert report.curves["time_s"][-1] == pytest.approx(belly().seconds)


def test_a_report_can_be_json():
    import json

    report = joints_only(walk(), walk())
    assert "NaN" not in json.dumps(report.as_dict()) and report.as_dict()["figures"]["frames"] == 90


def test_turning_the_world_changes_no_figure():
    plain = joints_only(walk(), shifted(walk(), 0.1 * ramp(90, 20, 60)))
    other = joints_only(turned(walk(), 1.1), turned(shifted(walk(), 0.1 * ramp(90, 20, 60)), 1.1))
    for key, value in plain.figures.items():
        assert other.figures[key] == pytest.approx(value, abs=1e-6), key


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_result_of_another_size_reads_as_well(factor):
    other = cast_by_names(scaled(Character(body().skeleton), factor))
    report = evaluate(Take(bare(), walk()), Take(other, scaled(walk(), factor)))
    assert report.problems == () and report.figures["jerk_ratio"] == pytest.approx(1)
    assert report.figures["floor_error_cm"] == pytest.approx(report.figures["source_floor_error_cm"], abs=1e-6)
    for name in ("foot_height_cm", "speed_m_s"):
        mine, theirs = (report.curves[f"{name}/{who}/left foot"] for who in ("result", "source"))
        assert np.allclose(mine, theirs, atol=1e-6), "the source is drawn in the result's size"


# Planted faults


def test_a_sliding_foot_is_found_where_it_slides():
    slid = shifted(stand(), 0.04 * ramp(45, 20, 30) * [1, 0, 0])
    report = joints_only(stand(), slid)
    assert "left foot slides 2." in sentences(report) and "right foot slides 2." in sentences(report)
    assert "from 0.00 s to 1.47 s" in sentences(report), "the whole stand is one contact"
    per_metre = 1.7 / bare().height
    assert 2.0 * per_metre < report.figures["foot_slide_cm"] < 2.8 * per_metre
    assert joints_only(slid, slid).problems == (), "what the source does itself is no fault"


@pytest.mark.parametrize(
    "lift, words", [(0.05, "floats 5.0 cm above the floor"), (-0.05, "sinks 5.0 cm into the floor")]
)
def test_feet_off_the_floor_are_found(lift, words):
    report = joints_only(stand(), shifted(stand(), [0, lift, 0]))
    assert f"left foot {words}" in sentences(report) and f"right foot {words}" in sentences(report)
    assert report.figures["floor_error_cm"] == pytest.approx(5 * 1.7 / bare().height, abs=0.05)
    assert np.median(report.curves["foot_height_cm/result/left foot"]) == pytest.approx(100 * lift, abs=0.1)


def test_a_result_on_a_floor_of_its_own_stands_there_and_the_report_says_so():
    report = joints_only(stand(), shifted(stand(), [0, 0.8, 0]))
    assert report.problems == () and any("stands at a height of 0.81 m" in note for note in report.notes)


def test_a_source_that_stands_off_its_own_floor_is_matched_there_or_on_the_floor():
    """As it is (another tool copies heights as they are), and put on the floor (ours does)."""
    hovering = shifted(stand(), [0, 0.06, 0])
    for result in (hovering, stand()):
        report = joints_only(hovering, result)
        assert report.problems == () and report.figures["floor_error_cm"] < 0.1
    assert "sinks 6.0 cm into" in sentences(joints_only(hovering, shifted(stand(), [0, -0.06, 0])))


def test_a_limb_that_points_elsewhere_is_named():
    motion = stand()
    rotations, elbow = motion.rotations.copy(), motion.skeleton.index("rightLowerArm")
    bend = rot.from_rotation_vector(np.radians(40.0) * np.array([0.0, 1.0, 0.0]))
    rotations[15:30, elbow] = rot.multiply(rotations[15:30, elbow], bend)
    report = joints_only(motion, replace(motion, rotations=rotations))
    assert "right forearm points " in sentences(report) and "left forearm" not in sentences(report)
    named = next(each for each in report.problems if "points" in each.sentence)
    assert 0.5 <= named.time < 1.0
    assert 0 < report.figures["direction_error_deg"] < 40 / 8


def test_a_jump_of_one_frame_is_found():
    motion = stand()
    rotations, shoulder = motion.rotations.copy(), motion.skeleton.index("leftUpperArm")
    rotations[20, shoulder] = rot.multiply(rotations[20, shoulder], rot.from_rotation_vector(np.array([0, 0, 0.3])))
    report = joints_only(motion, replace(motion, rotations=rotations))
    jump = next(each for each in report.problems if "jumps" in each.sentence)
    assert jump.sentence.startswith("left hand jumps by ") and jump.time == pytest.approx(20 / 30)


def test_shake_is_found():
    motion = stand()
    noise = np.random.default_rng(0).normal(0, 0.004, (len(motion), 3)) * [1, 0, 1]
    report = joints_only(motion, shifted(motion, noise))
    assert "head shakes" in sentences(report) and report.figures["jerk_ratio"] > 2


def test_a_hand_pushed_into_the_belly_reads_as_deep_as_it_was_pushed():
    read, last = [], cut(belly(), 0.3, 0.3)
    for metres in (0.0, 0.01, 0.02, 0.03):
        track = surface_track(Take(actor(), pushed(last, metres)), 0.0)
        pair = next(
            depth for pair, depth in track.inside().items() if "rightHand" in [track.parts.names[p] for p in pair]
        )
        read.append(pair[-1])
        figures = penetration_figures(track)
        assert figures["deepest_mm"] >= 1000 * read[-1]
    assert np.diff(read) == pytest.approx([0.01] * 3, abs=0.001)


def test_a_penetrating_hand_is_named_and_the_contact_counted_as_lost_when_it_leaves():
    deep = evaluate(Take(actor(), belly()), Take(actor(), pushed(belly(), 0.03)))
    assert deep.problems[0].sentence.startswith("right hand is 3.") and "inside the abdomen at" in sentences(deep)
    assert deep.facts["deepest"].startswith("right hand in the abdomen, 3.")
    assert deep.figures["new_penetration_percent"] > 1 and deep.figures["excess_penetration_percent"] > 1
    assert deep.figures["depth_p95_mm"] > deep.figures["depth_mean_mm"] > deep.figures["source_depth_mean_mm"]
    away = evaluate(Take(actor(), belly()), Take(actor(), pushed(belly(), -0.08)))
    assert "right hand misses the abdomen by " in sentences(away)
    assert away.figures["contacts_kept"] < 0.2 < 0.9 < deep.figures["contacts_kept"] + 0.5
    assert away.figures["excess_penetration_percent"] == 0


def test_skin_below_the_floor_is_named():
    low = shifted(cut(stand(), 0.0, 0.2), [0, -0.05, 0])
    report = evaluate(Take(actor(), cut(stand(), 0.0, 0.2)), Take(actor(), low))
    assert "foot" in sentences(report) and report.figures["floor_error_cm"] > 4
    assert sum("left foot" in each.sentence for each in report.problems) == 1, "told once, not by joint and by skin"
    motion = cut(stand(), 0.0, 0.2)
    report = evaluate(Take(bare(), motion), Take(actor(), with_hand_moved(motion, np.array([-0.2, -0.9, 0.0]))))
    found = next(each.sentence for each in report.problems if "below the floor" in each.sentence)
    assert found.startswith("right hand is ")


def test_bodies_of_other_meshes_are_judged_by_sensors():
    mesh = body("tall").mesh
    other = replace(body("tall"), mesh=replace(mesh, faces=np.roll(mesh.faces, 1, axis=1)))
    motion = cut(belly(), 0.1, 0.3)
    report = evaluate(Take(actor(), motion), Take(cast_by_names(other), motion))
    assert any(note.startswith("contacts by sensors: carrying errs by") for note in report.notes)
    true = evaluate(Take(actor(), motion), Take(actor("tall"), motion))
    assert not true.notes and 0.1 < true.figures["contacts_kept"] < 0.8
    assert report.figures["contacts_kept"] == pytest.approx(true.figures["contacts_kept"], abs=0.1)
    for key in ("penetration_percent", "deepest_mm", "excess_penetration_percent"):
        assert report.figures[key] == pytest.approx(true.figures[key]), key
    assert 0 < report.figures["new_part_penetration_percent"] < true.figures["new_penetration_percent"]


# What is not there


def test_without_surfaces_there_are_no_figures_of_skin_and_a_note():
    report = joints_only(walk(), walk())
    assert "penetration_percent" not in report.figures and "depth_cm/result" not in report.curves
    assert any("no surface" in note for note in report.notes) and report.facts["rests on"] == "feet"
    report = evaluate(Take(bare(), belly()), Take(actor(), belly()))
    assert report.figures["deepest_mm"] >= 0 and "contacts_kept" not in report.figures
    assert any("the source has no surface" in note for note in report.notes)


def test_still_and_single_frames_are_measured_too():
    single = cut(stand(), 0.0, 0.0)
    report = joints_only(single, single)
    assert report.figures["frames"] == 1 and report.figures["jerk_ratio"] is None and report.problems == ()


def test_no_frames_are_refused():
    none = replace(stand(), rotations=stand().rotations[:0], translations=stand().translations[:0])
    with pytest.raises(RetargetError, match="no frames"):
        joints_only(stand(), none)


# One clock


def test_rates_and_lengths_are_brought_together_and_it_is_said():
    (one, other), notes = on_one_clock(
        {"source": Take(bare(), resample(walk(), 120.0)), "result": Take(bare(), cut(walk(), 0.0, 2.0))}
    )
    assert len(one) == len(other) == 61 and one.fps == other.fps == 30
    assert any("resampled from 120 to 30" in note for note in notes)
    assert any("lengths differ" in note and "first 2.00 s" in note for note in notes)
    assert np.allclose(one.positions, other.positions, atol=1e-9)


def test_a_frame_more_or_a_rate_in_other_digits_is_no_difference():
    takes = {
        "source": Take(bare(), replace(walk(), fps=1 / 0.0333333)),
        "result": Take(bare(), cut(walk(), 0.0, walk().seconds - 1 / 30)),
    }
    (one, other), notes = on_one_clock(takes)
    assert notes == [] and len(one) == len(other) == len(walk()) - 1


def test_slower_files_are_judged_at_their_own_rate_unless_told():
    slow = Take(bare(), resample(walk(), 24.0))
    assert on_one_clock({"source": slow, "result": Take(bare(), walk())})[0][1].fps == 24
    assert on_one_clock({"source": slow, "result": Take(bare(), walk())}, 60.0)[0][0].fps == 60
    fast = Take(bare(), resample(walk(), 60.0))
    assert on_one_clock({"source": fast, "result": fast})[0][0].fps == 30


# The truth


def test_the_truth_itself_has_no_error():
    take = Take(actor(), cut(walk(), 0.5, 0.6))
    figures = evaluate(take, take, take).figures
    for key in ("mpjpe", "acc", "mse_meshret", "local_mse_star", "end_effector_position_error_cm", "mpvd", "mdel"):
        assert figures[key] == pytest.approx(0, abs=1e-9), key
    for key in ("pa_mpjpe", "pa_acc", "pa_mpvd", "end_effector_orientation_error_degrees"):
        assert figures[key] == pytest.approx(0, abs=1e-5), key


def test_a_shift_from_the_truth_reads_as_its_length():
    motion = cut(walk(), 0.5, 0.6)
    truth = Take(actor(), motion)
    figures = evaluate(truth, Take(actor(), shifted(motion, [0.1, 0, 0])), truth).figures
    assert figures["mpjpe"] == pytest.approx(0.1) and figures["mpvd"] == pytest.approx(0.1, abs=1e-6)
    assert figures["end_effector_position_error_cm"] == pytest.approx(10 * 1.7 / actor().height)
    assert figures["mse_meshret"] == pytest.approx(0.01 / actor().height)
    assert figures["mse_nkn"] == pytest.approx(100 * figures["mse_meshret"])
    for key in ("pa_mpjpe", "acc", "local_mse_meshret", "pa_mpvd", "mdel"):
        assert figures[key] == pytest.approx(0, abs=1e-6), key


def test_local_errors_leave_out_where_the_hips_are():
    rotations = walk().rotations.copy()
    rotations[:, 0] = rot.multiply(rotations[:, 0], rot.from_rotation_vector(np.array([0.0, 0.2, 0.0])))
    figures = joints_only(walk(), replace(walk(), rotations=rotations), truth=Take(bare(), walk())).figures
    assert figures["local_mse_san"] == pytest.approx(figures["mse_san"]) and figures["mse_san"] > 0
    assert figures["end_effector_orientation_error_degrees"] == pytest.approx(np.degrees(0.2))


def test_the_truth_is_of_the_results_own_body():
    giant = cast_by_names(scaled(Character(body().skeleton), 1.5))
    with pytest.raises(RetargetError, match="animation of the result's character"):
        joints_only(walk(), walk(), truth=Take(giant, scaled(walk(), 1.5)))
    names = tuple(name if name != "jaw" else "chin" for name in body().skeleton.names)
    names = names if names != body().skeleton.names else ("pelvis", *body().skeleton.names[1:])
    skeleton = replace(body().skeleton, names=names)
    other = cast_by_names(Character(skeleton), dict(zip(body().skeleton.names, names)))
    with pytest.raises(RetargetError, match="only one of them has a joint"):
        joints_only(walk(), walk(), truth=Take(other, replace(walk(), skeleton=skeleton)))


# Words


def test_the_worst_come_first_ten_at_most_and_repetitions_are_counted():
    many = [Problem(f"p{n}", float(n), n / 10, ("slide", str(n))) for n in range(20)]
    assert [each.sentence for each in worst_first(many)] == [f"p{n}" for n in range(19, 9, -1)]
    again = [Problem("hand inside", 3.0, 1.0, ("inside",)), Problem("hand inside less", 2.0, 0.5, ("inside",))]
    assert [each.sentence for each in worst_first(again)] == ["hand inside; also at 0.50 s"]
    often = [Problem("x", 1.0, float(n), ("inside",)) for n in range(9)]
    assert worst_first(often)[0].sentence == "x; and 8 more times"


def test_episodes_bridge_short_gaps_and_know_their_worst_frame():
    values = np.zeros(100)
    values[[10, 11, 14, 50]] = [1.0, 2.0, 3.0, 1.5]
    found = list(episodes(values, values > 0.5, 30.0))
    assert [(each.start, each.stop, each.worst, each.value) for each in found] == [(10, 15, 14, 3.0), (50, 51, 50, 1.5)]


def test_parts_are_spoken_as_people_do():
    assert spoken("leftUpperArm") == "left upper arm" and spoken("pelvis") == "pelvis"
    assert together(["leftFoot", "pelvis", "rightFoot", "leftHand"]) == ["feet", "pelvis", "left hand"]
    assert together(["rightShin", "leftShin"]) == ["shins"]
