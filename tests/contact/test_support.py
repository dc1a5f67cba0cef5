"""Heels, balls and palms: where a body stands."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, cast_by_names, scaled

from retarget.body.kinematics import rest_pose
from retarget.character import Character
from retarget.contact.support import descendants, leg_length, support_limbs, support_points
from retarget.evaluate.cases import with_other_joint_axes


def rest_points(character):
    actor = cast_by_names(character)
    limbs = support_limbs(actor.character, actor.humanoid)
    rotations, positions = rest_pose(actor.skeleton)
    return limbs, [points[0] for points in support_points(limbs, rotations[None], positions[None])], positions


@pytest.mark.parametrize("preset", ["thin", "heavy", "toddler"])
def test_feet_stand_on_their_soles_heel_behind_ball(preset):
    limbs, points, at = rest_points(body(preset))
    assert [limb.name for limb in limbs] == ["leftLeg", "rightLeg", "leftArm", "rightArm"]
    assert [len(each) for each in points] == [2, 2, 1, 1]
    height = np.ptp(body(preset).mesh.vertices[:, 1])
    for side, (heel, ball) in zip(("left", "right"), points[:2]):
        ankle = at[body().skeleton.index(f"{side}Foot")]
        assert abs(heel[1]) < 0.01 * height and heel[1] == ball[1]
        assert heel[2] < ankle[2] < ball[2], "heel, ankle, ball from back to front"
        assert 0.08 < np.linalg.norm(ball - heel) / height < 0.16
        assert (ball[0] > 0) == (side == "left")


def test_points_follow_their_joint():
    limbs, points, at = rest_points(body())
    rotations, positions = rest_pose(body().skeleton)
    moved = support_points(limbs, rotations[None], positions[None] + [1.0, 2.0, 3.0])
    for before, after in zip(points, moved):
        assert np.allclose(after[0], before + [1, 2, 3])


def test_points_do_not_know_the_joints_own_axes():
    _, plain, _ = rest_points(body())
    _, rolled, _ = rest_points(with_other_joint_axes(body(), 6))
    assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(plain, rolled))


def test_a_bare_skeleton_stands_nearly_where_its_body_does():
    _, skinned, _ = rest_points(body())
    _, bare, _ = rest_points(Character(body().skeleton))
    for a, b in zip(skinned[:2], bare[:2]):
        assert np.abs(a - b).max() < 0.05


def test_leg_length_by_hand_and_scaled():
    actor = cast_by_names(body())
    offsets = actor.skeleton.offsets
    expected = np.mean(
        [
            sum(np.linalg.norm(offsets[actor.skeleton.index(side + part)]) for part in ("LowerLeg", "Foot"))
            for side in ("left", "right")
        ]
    )
    assert leg_length(actor.skeleton, actor.humanoid) == pytest.approx(expected)
    assert leg_length(scaled(body(), 2.5).skeleton, actor.humanoid) == pytest.approx(2.5 * expected)


def test_a_foot_without_toes_has_a_ball_too():
    skeleton = body().skeleton
    names = {name: name for name in skeleton.names if not name.endswith("Toes")}
    actor = cast_by_names(replace(body(), origin=None), names)
    points = support_points(
        support_limbs(actor.character, actor.humanoid), *(each[None] for each in rest_pose(skeleton))
    )
    for heel, ball in (each[0] for each in points[:2]):
        assert 0.08 < ball[2] - heel[2] < 0.25


def test_descendants():
    skeleton = body().skeleton
    assert {skeleton.names[j] for j in descendants(skeleton, skeleton.index("leftUpperLeg"))} == {
        "leftUpperLeg", "leftLowerLeg", "leftFoot", "leftToes",
    }  # fmt: skip
