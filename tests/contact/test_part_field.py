"""The field by pairs of parts: it says what is near, where it should go and what has sunk in, in the body's own axes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, scaled, turned

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.contact.detect import LEAVE, THRESHOLD
from retarget.contact.part_field import FIGURES, PAIRS, field_sensors, prepare_part_field
from retarget.contact.part_field_kernels import LIFTED
from retarget.evaluate.cases import arms_turned, in_other_rest_pose, with_other_joint_axes
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare


@cache
def posed():
    """A hand on the belly."""
    return frames_of(embedded_motion("hand_on_belly"), np.array([60, 75]))


@cache
def field(preset="thin"):
    return field_of(actor(), actor(preset))


def field_of(source, target):
    sensors = [field_sensors(each.character, each.humanoid) for each in (source, target)]
    return prepare_part_field(*sensors, target.humanoid, (source.height, target.height))


def seen(own, source, target):
    return own.figures(own.source(*world_pose(source)), own.target(*world_pose(target)), *world_pose(target))


def pairs(figures):
    return figures[:, : FIGURES * len(PAIRS)].reshape(len(figures), len(PAIRS), FIGURES)


def pair(figures, own, other):
    return pairs(figures)[:, PAIRS.index((own, other))]


def test_the_same_body_in_the_same_pose_is_asked_for_nothing():
    figures = pairs(seen(field(), posed(), posed()))
    assert np.abs(figures[..., 2:8]).max() < 1e-5
    hand = pair(seen(field(), posed(), posed()), "rightHand", "spine")
    assert hand[:, 0].min() > 0.3, "the hand lies on the belly"
    assert pair(seen(field(), posed(), posed()), "leftHand", "head")[:, 0].max() == 0


def test_a_hand_that_is_moved_off_is_asked_back():
    """A hand on the belly, its arm lifted to the side: it should go inwards, and its closeness on the source stays."""
    away, skeleton = posed(), posed().skeleton
    rotations = away.rotations.copy()
    arm = skeleton.index("rightUpperArm")
    rotations[:, arm] = rot.multiply(rot.from_rotation_vector(np.array([0.0, 0.0, -0.3])), rotations[:, arm])
    lifted = replace(away, rotations=rotations)
    before, after = (pair(seen(field(), posed(), each), "rightHand", "spine") for each in (posed(), lifted))
    assert np.allclose(before[:, :2], after[:, :2])
    hands = [world_pose(each)[1][:, skeleton.index("rightHand")] for each in (posed(), lifted)]
    hips = rot.inverse(world_pose(posed())[0][:, 0])
    back = rot.rotate(hips, hands[0] - hands[1])
    asked = after[:, 2:5] / after[:, :1] * actor().height
    assert (np.einsum("fi,fi->f", asked, back) > 0.6 * np.linalg.norm(asked, axis=1) * np.linalg.norm(back, axis=1)).all()
    assert (np.linalg.norm(asked, axis=1) > 0.5 * np.linalg.norm(back, axis=1)).all()


def test_what_has_sunk_in_is_told_with_the_way_out():
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(posed()).motion
    hand = pair(seen(field("heavy"), posed(), copied), "rightHand", "spine")
    own = pair(seen(field(), posed(), posed()), "rightHand", "spine")
    assert (hand[:, 15] > own[:, 15] + 0.01).all(), "deeper than a hand that lies on the skin"
    out = hand[:, 16:19] / np.linalg.norm(hand[:, 16:19], axis=1, keepdims=True)
    assert (out[:, 2] > 0.5).all(), "the belly faces forward"


def test_what_is_inside_on_the_performer_is_asked_out_a_little():
    """A heavy performer with a hand in the belly, and the same on the same body: out by no more than surfaces that touch may be apart."""
    heavy, sunk = actor("heavy"), prepare(actor(), actor("heavy"), "copy-rotations").retargeter(posed()).motion
    hand = pair(seen(field_of(heavy, heavy), sunk, sunk), "rightHand", "spine")
    asked = hand[:, 5:8] / hand[:, 1:2]
    length = np.linalg.norm(asked, axis=1)
    assert np.isclose(LIFTED, LEAVE * THRESHOLD)
    out = hand[:, 16:19] / np.linalg.norm(hand[:, 16:19], axis=1, keepdims=True)
    assert (length > 0.5 * LIFTED).all() and (length < 1.01 * LIFTED).all()
    assert (np.einsum("fi,fi->f", asked, out) > 0.8 * length).all()


def test_neither_facing_nor_place_matters():
    as_is, other = (
        seen(field("child"), *(each(motion) for motion in (posed(), copied("child"))))
        for each in (lambda motion: motion, lambda motion: shifted(turned(motion, 2.0)))
    )
    assert np.abs(other - as_is).max() < 2e-4


def test_size_does_not_matter():
    small = [scaled(body(preset), 0.8) for preset in ("thin", "child")]
    own = field_of(*(cast_by_names(each) for each in small))
    figures = seen(own, scaled(posed(), 0.8), scaled(copied("child"), 0.8))
    assert np.abs(figures - seen(field("child"), posed(), copied("child"))).max() < 2e-3


def shifted(motion):
    return replace(motion, translations=motion.translations + [3.0, 0.5, -2.0])


@cache
def copied(preset):
    return prepare(actor(), actor(preset), "copy-rotations").retargeter(posed()).motion


@pytest.mark.parametrize("change", [lambda c: with_other_joint_axes(c, 3), lambda c: in_other_rest_pose(c, arms_turned(40.0))])
def test_neither_axes_nor_rest_poses_of_joints_matter(change):
    """But for a few degrees about the forearms: where they are not turned about themselves is read from the hands' skin."""
    other = cast_by_names(change(body("child")))
    own = field_of(actor(), other)
    there = prepare(actor(), other, "copy-rotations").retargeter(posed()).motion
    assert np.abs(seen(own, posed(), there) - seen(field("child"), posed(), copied("child"))).max() < 0.12
