"""What rests stands still, what does not is left smooth: the parts of the foot lock one by one."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.contact.support import SupportLimb
from retarget.motion.foot_lock import LimbGoal, body_lift, hip_drop, limb_goal, reach_goals, settle

FPS = 60.0
FOOT = SupportLimb("leftLeg", (0, 1, 2), np.array([[0, -0.1, -0.05], [0, -0.1, 0.15]]))


def drifting(frames, start, stop, speed=0.1):
    """One point that drifts along x all the time and rests on the frames in between."""
    points = np.zeros((frames, 1, 2))
    points[:, 0, 0] = np.arange(frames) * speed / FPS
    resting = np.zeros((frames, 1), bool)
    resting[start:stop] = True
    return points, resting


def test_a_drifting_point_stands_still_while_it_rests():
    points, resting = drifting(180, 60, 120)
    held = points[:, 0] + settle(points, resting, FPS)
    assert np.ptp(points[60:120, 0, 0]) > 0.09
    assert np.ptp(held[60:120], axis=0).max() < 2e-3


def test_the_correction_fades_and_is_smooth():
    points, resting = drifting(240, 100, 140)
    correction = settle(points, resting, FPS)[:, 0]
    assert np.abs(correction[[0, -1]]).max() < 0.1 * np.abs(correction).max()
    assert np.abs(np.diff(correction)).max() < 2.5 * 0.1 / FPS, "never much faster than what it corrects"
    assert np.abs(np.diff(correction, n=2)).max() < 0.1 / FPS * 0.5, "no pop where the contact begins and ends"


def test_a_point_that_stands_still_is_left_alone():
    points, resting = drifting(90, 20, 70, speed=0.0)
    assert np.abs(settle(points, resting, FPS)).max() < 1e-12


def test_without_contact_nothing_is_corrected():
    points, resting = drifting(50, 0, 0)
    assert np.abs(settle(points, resting, FPS)).max() == 0


def test_a_long_stand_does_not_creep():
    points, resting = drifting(3000, 10, 2990, speed=0.0)
    points[:, 0, 0] = 0.03 * np.sin(np.arange(3000) / 40)  # a foot that sways under a body of other proportions
    held = points[:, 0] + settle(points, resting, FPS)
    assert np.ptp(held[10:2990, 0]) < 6e-3


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_the_shortest_clips_do_not_crash(frames):
    path = np.zeros((frames, 3)) + [0.0, 0.1, 0.0]
    points = path[:, None] + FOOT.points
    touching = np.ones((frames, 2), bool)
    goal = limb_goal(FOOT, path, points, touching, np.zeros((frames, 2)) + 0.02, np.zeros(frames), FPS)
    assert np.allclose(goal.displacement, [0, 0.02, 0], atol=1e-3)
    positions = np.tile(np.array([[0, 1.0, 0], [0, 0.55, 0.02], [0, 0.1, 0]]), (frames, 1, 1))
    assert hip_drop([goal], positions, FPS).shape == (frames,)
    assert body_lift([points], [touching], [np.zeros((frames, 2))], 0.9, FPS).shape == (frames,)


def test_heights_meet_the_support_and_nothing_sinks():
    frames = 120
    height = 0.1 + 0.05 * np.sin(np.arange(frames) / 12)  # an ankle that bobs by 5 cm
    path = np.zeros((frames, 3))
    path[:, 1] = height
    points = path[:, None] + FOOT.points
    touching = np.zeros((frames, 2), bool)
    touching[40:80] = True
    support = np.full((frames, 2), 0.03)
    goal = limb_goal(FOOT, path, points, touching, support, np.zeros(frames), FPS)
    held = points[..., 1] + goal.displacement[:, None, 1]
    assert np.abs(held[40:80] - 0.03).max() < 1e-3
    assert held.min() > -2e-3, "free frames stay above the ground"


def test_a_resting_foot_does_not_swivel():
    frames = 90
    path = np.zeros((frames, 3)) + [0.0, 0.1, 0.0]
    turn = rot.from_rotation_vector(np.arange(frames)[:, None] / FPS * [0, 0.3, 0])
    points = path[:, None] + rot.rotate(turn[:, None], FOOT.points)
    touching = np.ones((frames, 2), bool)
    goal = limb_goal(FOOT, path, points, touching, np.zeros((frames, 2)), np.zeros(frames), FPS)
    spin = rot.from_rotation_vector(goal.turn[:, None] * [0, 1.0, 0])
    held = (path + goal.displacement)[:, None] + rot.rotate(spin[:, None], points - path[:, None])
    assert np.ptp(points[:, 1, 0]) > 0.05
    assert np.ptp(held, axis=0).max() < 1e-3


def test_the_body_rises_by_what_its_feet_lack():
    frames = 60
    points = np.zeros((frames, 2, 3))
    points[..., 1] = -0.05
    touching, support = np.ones((frames, 2), bool), np.zeros((frames, 2))
    assert np.allclose(body_lift([points], [touching], [support], 0.9, FPS), 0.05)
    none = np.zeros((frames, 2), bool)
    assert np.allclose(body_lift([points, points], [none, none], [support, support], 0.9, FPS), 0)


def test_of_two_feet_the_deeper_one_leads():
    frames = 60
    deep, level = np.zeros((frames, 2, 3)), np.zeros((frames, 2, 3))
    deep[..., 1] = -0.10
    touching, support = np.ones((frames, 2), bool), np.zeros((frames, 2))
    lift = body_lift([deep, level], [touching, touching], [support, support], 0.9, FPS)
    assert np.allclose(lift, 0.10, atol=0.002)


def leg(frames):
    """A leg of 0.5 + 0.5 m, slightly bent, hip at 0.99 m."""
    one = np.array([[0, 0.99, 0], [0, 0.4925, 0.0497], [0, 0.0, 0]])
    one[1, 2] = np.sqrt(0.25 - 0.495**2)
    one[1, 1] = 0.495
    return np.tile(one, (frames, 1, 1))


def goal_at(displacement, active):
    frames = len(displacement)
    return LimbGoal(FOOT, np.asarray(displacement, float), np.zeros(frames), np.asarray(active))


def test_hips_sink_just_enough_for_a_stretched_leg():
    frames = 61
    displacement = np.zeros((frames, 3))
    displacement[20:40, 1] = -0.05  # the foot must go 5 cm down; the leg is 1 m long and 0.99 m are used
    drop = hip_drop([goal_at(displacement, np.ones(frames, bool))], leg(frames), FPS)
    assert drop[30] == pytest.approx(0.04, abs=1e-3)
    assert drop[0] == 0 and drop.min() >= 0
    assert np.abs(np.diff(drop)).max() < 0.02, "eased in and out"


def test_hips_stay_when_the_legs_reach():
    frames = 30
    displacement = np.zeros((frames, 3)) + [0.0, 0.02, 0.05]
    assert np.abs(hip_drop([goal_at(displacement, np.ones(frames, bool))], leg(frames), FPS)).max() == 0
    far, resting = np.zeros((frames, 3)), np.arange(frames) < 10
    far[~resting, 1] = -0.3
    assert np.abs(hip_drop([goal_at(far, resting)], leg(frames), FPS)).max() == 0, "free legs pull nothing down"


def test_limbs_reach_their_goals_after_the_hips_sank():
    frames = 10
    positions = leg(frames)
    world = np.tile(rot.IDENTITY, (frames, 3, 1))
    goal = goal_at(np.zeros((frames, 3)) + [0.05, 0.03, 0.1], np.ones(frames, bool))
    drop = np.linspace(0, 0.04, frames)
    turned = reach_goals([goal], world, positions, {"leftLeg": np.array([0, 0, 1.0])}, drop, {2: [2]})
    hip = positions[:, 0] - drop[:, None] * [0, 1, 0]
    knee = hip + rot.rotate(turned[:, 0], positions[:, 1] - positions[:, 0])
    ankle = knee + rot.rotate(turned[:, 1], positions[:, 2] - positions[:, 1])
    assert np.abs(ankle - (positions[:, 2] + goal.displacement)).max() < 1e-6
    assert np.allclose(turned[:, 2], world[:, 2]), "the foot keeps its world rotation"
