"""The small system of pairs of parts: it asks for nothing where nothing is missing, and its step does what is asked."""

from functools import cache

import numpy as np
import pytest
from made_motions import actor

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.contact.part_field import FIGURES, PAIRS
from retarget.contact.skin_levers import TURNING
from retarget.methods.interaction.looker import beside_seen, nothing_turned, prepare_looker
from retarget.methods.interaction.part_equations import (
    CARRIED,
    HELD,
    PAIRED,
    ROWS,
    SAID,
    SAYS,
    STIFF,
    TURNED,
    part_steps,
)
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.motion.touch.solve import STIFFNESS
from retarget.retargeting import prepare


@cache
def case(preset="heavy"):
    motion = frames_of(embedded_motion("hand_on_belly"), np.array([60, 75]))
    looker = prepare_looker(actor(), actor(preset))
    copied = prepare(actor(), actor(preset), "copy-rotations", one_rig=True, foot_lock=False).retargeter(motion).motion
    return looker, looker.source(motion), copied


def features(turned, preset="heavy"):
    looker, source, copied = case(preset)
    return looker.features(source, copied, world_pose(copied)[0], turned)


def said(frames=2, touching=4.0, sunk=5.0):
    """All pairs alike, joints as stiff as the solver has them."""
    out = np.zeros((frames, SAID), np.float32)
    out[:, PAIRED] = np.tile([touching, touching - 3.0, sunk, *[0.0] * (SAYS - 3)], len(PAIRS))
    stiff = [0.01 * STIFFNESS.get(name.removeprefix("left").removeprefix("right"), 1.0) for name in TURNED]
    out[:, STIFF] = np.log(np.repeat(stiff, 3))
    out[:, HELD] = -10.0
    return out


def stepped(seen, turned, says):
    places, axes, asked = beside_seen(seen)
    return part_steps(seen, places, axes, turned, asked, says)


def step(turned, preset="heavy", **kind):
    seen = features(turned, preset)
    return stepped(seen, turned, said(**kind))


def asked(turned):
    """How far the hand should go against the belly, shares of the height, and how deep it is in."""
    figures = features(turned)[:, : FIGURES * len(PAIRS)].reshape(-1, len(PAIRS), FIGURES)[:, PAIRS.index(("rightHand", "spine"))]
    return np.linalg.norm(figures[:, 5:8], axis=1) / figures[:, 1], figures[:, 15]


def test_the_same_body_stays_as_it_is():
    assert np.abs(step(nothing_turned(2), "thin", sunk=-10.0)).max() < 1e-4


def test_steps_bring_a_hand_to_its_place_on_the_belly():
    turned = nothing_turned(2)
    before = asked(turned)[0]
    for _ in range(3):
        turned = turned + step(turned, sunk=-10.0)
    assert (before > 0.02).all() and (asked(turned)[0] < 0.5 * before).all()


def test_steps_bring_a_hand_out():
    turned = nothing_turned(2)
    before = asked(turned)[1]
    for _ in range(2):
        turned = turned + step(turned, touching=-7.0)
    assert (before > 0.02).all() and (asked(turned)[1] < 0.7 * before).all()


def test_the_levers_are_derivatives():
    """What places on skins do when an elbow's turn grows a little, by finite differences."""
    looker, _, copied = case()
    turned, world = np.random.default_rng(2).normal(size=(2, SIZE)) * 0.1, world_pose(copied)[0]
    turned[:, -3:] = 0.0
    posed = world_pose(looker.moved(copied, world, turned))
    places, axes = looker.unknowns.levers(turned, world, posed)
    hips, height = looker.unknowns.hips[1], looker.unknowns.height
    to_hips = rot.multiply(looker.unknowns.upright, rot.inverse(posed[0][:, hips]))
    for name, hand in (("rightLowerArm", "rightHand"), ("chest", "leftHand"), ("leftUpperArm", "leftLowerArm")):
        joint, end = TURNING.index(name), copied.skeleton.index(hand)
        for axis in range(3):
            more = turned.copy()
            more[:, 3 * joint + axis] += 1e-4
            moved = world_pose(looker.moved(copied, world, more))[1][:, end] - posed[1][:, end]
            there = rot.rotate(to_hips, moved) / height / 1e-4
            lever = places[:, TURNING.index(hand)] - places[:, joint]
            assert np.abs(np.cross(axes[:, joint, :, axis], lever) - there).max() < 2e-3


def test_what_carries_a_part():
    hand = PAIRS.index(("leftHand", "chest"))
    names = [{name for name, carries in zip(TURNED, row[hand]) if carries} for row in CARRIED]
    trunk = {"hips", "spine", "chest", "upperChest"}
    assert names == [{*trunk, "leftShoulder", "leftUpperArm", "leftLowerArm", "leftHand"}, trunk]


@pytest.mark.parametrize("odd", [np.nan, 1e30])
def test_odd_figures_leave_numbers_and_other_frames_alone(odd):
    seen, turned, says = features(nothing_turned(2)), nothing_turned(2), said()
    plain = stepped(seen, turned, says)
    says[:, 0] = 0.125
    seen[0, : FIGURES * len(PAIRS)] = odd
    made = stepped(seen, turned, says)
    assert np.isfinite(made).all()
    assert np.allclose(made[1, 1:], plain[1, 1:]) and np.abs(plain[1]).max() > 0.05
    if np.isnan(odd):
        assert np.allclose(made[0], says[0, :SIZE], atol=1e-3)


def test_knuckles_are_the_network_s_alone():
    says, seen, turned = said(), features(nothing_turned(2)), nothing_turned(2)
    knuckle = 3 * TURNING.index("leftIndexProximal")
    says[:, knuckle] = 0.25
    made = stepped(seen, turned, says)
    assert (made[:, knuckle] == 0.25).all() and knuckle not in ROWS
