"""The interaction network: contacts are kept and what sinks in comes out, in a fraction of the solver's time; bad weights are named."""

import shutil
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, fingerless

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.character import Character
from retarget.contact.part_field import FIGURES, PAIRS
from retarget.contact.skin_levers import TURNING
from retarget.errors import FileError, RetargetError
from retarget.evaluate.touch import observe, prepare_judge
from retarget.methods.interaction import network
from retarget.methods.interaction.learned import LearnedInteraction
from retarget.methods.interaction.method import Interaction
from retarget.methods.interaction.network import FILES, FOLDER, load_network
from retarget.motion.filter import cut, resample
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare, retarget

sys.path.append(str(Path(__file__).parents[1] / "rig"))
from made_quadrupeds import Build, quadruped  # noqa: E402


@cache
def hands_on_hips():
    return cut(embedded_motion("hands_on_hips"), 1.2, 2.2)


@cache
def touch():
    return observe(actor(), hands_on_hips())


@cache
def learned(preset):
    return prepare(actor(), actor(preset), "learned-interaction").retargeter


@cache
def copied(preset):
    return prepare(actor(), actor(preset), "copy-rotations").retargeter(hands_on_hips()).motion


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_hands_come_out_and_stay_on(preset):
    judge = prepare_judge(touch(), actor(preset))
    before, after = judge(touch(), copied(preset)), judge(touch(), learned(preset)(hands_on_hips()).motion)
    assert before["penetration_percent"] > 5
    assert after["penetration_percent"] < 0.3 * before["penetration_percent"]
    assert after["contacts_kept"] > max(before["contacts_kept"] - 0.02, 0.85)
    assert after["two_sided_contact_error"] < 0.6 * before["two_sided_contact_error"]


def test_it_is_several_times_as_fast_as_the_solver():
    own, solver = learned("heavy"), prepare(actor(), actor("heavy"), Interaction()).retargeter
    spent = []
    for each in (own, solver):
        each(hands_on_hips())
        start = time.process_time()
        for _ in range(3):
            each(hands_on_hips())
        spent.append(time.process_time() - start)
    assert spent[0] < 0.6 * spent[1]


def test_feet_stay_where_they_stood():
    feet = [body().skeleton.index(f"{side}Foot") for side in ("left", "right")]
    places = [world_pose(each)[1][:, feet] for each in (copied("heavy"), learned("heavy")(hands_on_hips()).motion)]
    assert np.linalg.norm(places[0] - places[1], axis=2).max() < 0.01


def test_a_pose_that_touches_nothing_is_left_nearly_as_copied():
    wave = cut(embedded_motion("run"), 0.3, 0.8)
    made, plain = (prepare(actor(), actor(), each).retargeter(wave).motion for each in ("learned-interaction", "copy-rotations"))
    assert np.degrees(rot.angle_between(made.rotations, plain.rotations)).mean() < 1.0


def test_online_frames_follow_within_a_few_frames():
    """Held for a second, the pose that steps reach is that of the clip."""
    held = replace(
        hands_on_hips(), rotations=np.repeat(hands_on_hips().rotations[15:16], 20, axis=0),
        translations=np.repeat(hands_on_hips().translations[15:16], 20, axis=0),
    )  # fmt: skip
    own = prepare(actor(), actor("heavy"), LearnedInteraction(foot_lock=False, steady=False)).retargeter
    clip = own(held).motion
    steps = [own.step(held.pose(number)) for number in range(20)]
    arms = [clip.skeleton.index(f"{side}{part}") for side in ("left", "right") for part in ("UpperArm", "LowerArm")]
    apart = [np.degrees(rot.angle_between(step.rotations[arms], clip.rotations[10][arms])).max() for step in steps]
    assert apart[-1] < 0.5
    assert max(apart[4:]) < 3.0


def test_clips_at_other_rates_are_corrected_alike():
    fast = learned("heavy")(resample(hands_on_hips(), 120.0)).motion
    slow = learned("heavy")(hands_on_hips()).motion
    apart = np.degrees(rot.angle_between(fast.rotations[::4][: len(slow)], slow.rotations))
    assert apart.max() < 4.0 and apart.mean() < 0.3


def test_joints_without_a_place_keep_their_copied_rotations():
    made = learned("heavy")(hands_on_hips()).motion
    tips = [made.skeleton.index(name) for name in made.skeleton.names if name.endswith(("Intermediate", "Distal"))]
    assert tips and rot.angle_between(made.rotations[:, tips], copied("heavy").rotations[:, tips]).max() < 1e-3


def test_a_body_without_fingers_serves():
    target = cast_by_names(fingerless(body("heavy")), {name: name for name in fingerless(body()).skeleton.names})
    made = prepare(actor(), target, "learned-interaction").retargeter(hands_on_hips()).motion
    assert np.isfinite(made.rotations).all()
    judge = prepare_judge(touch(), target)
    plain = prepare(actor(), target, "copy-rotations").retargeter(hands_on_hips()).motion
    assert judge(touch(), made)["penetration_percent"] < 0.5 * judge(touch(), plain)["penetration_percent"]


@pytest.mark.parametrize(
    ("pair", "figure", "value", "turns"),
    [
        (("leftHand", "spine"), 0, 0.3, True), (("leftHand", "spine"), 0, 0.05, False), (("rightUpperArm", "leftLowerArm"), 0, 0.3, True),
        (("leftUpperArm", "chest"), 0, 0.9, False), (("leftUpperArm", "chest"), 15, 0.03, True), (("leftLowerArm", "spine"), 15, 0.01, False),
        (("leftUpperArm", "rightShoulder"), 15, 0.05, False), (("rightHand", "spine"), 0, 0.9, False),
    ],
)  # fmt: skip
def test_an_arm_turns_where_it_touches_or_is_inside(pair, figure, value, turns):
    seen = np.zeros((1, FIGURES * len(PAIRS)), np.float32)
    seen[0, FIGURES * PAIRS.index(pair) + figure] = value
    found = network.cause(seen)[0].reshape(-1, 3)
    arm = [TURNING.index(f"left{part}") for part in ("Shoulder", "LowerArm", "Hand", "IndexProximal")]
    assert (found[arm] == float(turns)).all()
    assert (found[[TURNING.index(name) for name in ("hips", "head", "leftFoot", "rightUpperLeg")]] == 1.0).all()


def test_a_target_without_a_surface_is_refused():
    bare = cast_by_names(Character(body().skeleton))
    with pytest.raises(RetargetError, match="no surface; the method 'learned-interaction' needs one"):
        prepare(actor(), bare, "learned-interaction")


def test_a_quadruped_is_refused_with_words():
    with pytest.raises(RetargetError, match="matches no humanoid"):
        retarget(hands_on_hips(), quadruped(Build()).character, method="learned-interaction")


def test_a_source_without_a_surface_gets_a_body():
    bare = cast_by_names(Character(body().skeleton))
    made = prepare(bare, actor("heavy"), "learned-interaction").retargeter(hands_on_hips()).motion
    plain = copied("heavy")
    assert rot.angle_between(made.rotations, plain.rotations).max() > 0.05


@pytest.fixture
def folder(tmp_path):
    for name in FILES:
        shutil.copy(FOLDER / name, tmp_path / name)
    return tmp_path


def test_missing_weights_are_named(folder):
    (folder / FILES[1]).unlink()
    with pytest.raises(FileError, match="interaction_look_2.onnx: the network's weights are not there"):
        prepare(actor(), actor("heavy"), "learned-interaction", weights=folder)


@pytest.mark.parametrize("damage", ["cut", "noise", "empty"])
def test_damaged_weights_are_refused(folder, damage):
    path = folder / FILES[0]
    whole = path.read_bytes()
    path.write_bytes({"cut": whole[: len(whole) // 2], "noise": bytes(1000), "empty": b""}[damage])
    with pytest.raises(FileError, match="interaction_look_1.onnx: no readable ONNX network"):
        load_network(folder)


def test_other_versions_and_networks_are_refused(folder, monkeypatch):
    monkeypatch.setattr(network, "VERSION", "0")
    with pytest.raises(FileError, match="weights of version 2, but this program needs version 0"):
        load_network(folder)
    monkeypatch.undo()
    shutil.copy(FOLDER.parents[1] / "scan" / "weights" / "skinning_field.onnx", folder / FILES[0])
    load_network.cache_clear()
    with pytest.raises(FileError, match="holds the network 'skinning-field' instead of 'interaction'"):
        load_network(folder)


def test_the_networks_are_small():
    assert sum((FOLDER / name).stat().st_size for name in FILES) < 15e6


def test_the_solver_can_start_from_it():
    started = prepare(actor(), actor("heavy"), Interaction(learned_start=True)).retargeter(hands_on_hips())
    usual = prepare(actor(), actor("heavy"), Interaction()).retargeter(hands_on_hips())
    judge = prepare_judge(touch(), actor("heavy"))
    figures = [judge(touch(), each.motion) for each in (started, usual)]
    assert figures[0]["penetration_percent"] < 0.1
    assert figures[0]["contacts_kept"] > figures[1]["contacts_kept"] - 0.03


def test_a_long_clip_is_looked_at_in_stretches(monkeypatch):
    whole = learned("heavy")(hands_on_hips()).motion
    monkeypatch.setattr(network, "STRETCH", 7)
    parts = learned("heavy")(hands_on_hips()).motion
    assert np.degrees(rot.angle_between(whole.rotations, parts.rotations)).max() < 1e-2
