"""Made-up performances: arms come to what they reach for, crouches keep their feet where they were."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.methods.interaction.looker import prepare_looker
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.train import performances, reaching


@cache
def field():
    return prepare_looker(actor(), actor()).field


@cache
def clip():
    return cut(embedded_motion("walk"), 0.0, 2.0)


def nearest_of(motion, pairs):
    return reaching.figures_of_pairs(motion, field())[:, pairs, 0].max(axis=1)


def nearest_of_hands(motion):
    return nearest_of(motion, reaching.HANDS)


def test_reaching_arms_touch_the_body():
    draw, found = np.random.default_rng(4), []
    for frame in range(0, 40, 4):
        rotations = clip().rotations[frame : frame + 1].copy()
        rotations[0, list(reaching.ARMS)] = reaching.reaching_arms(clip(), frame, field(), draw)
        pose = replace(clip(), rotations=rotations, translations=clip().translations[frame : frame + 1])
        found.append(nearest_of_hands(pose)[0])
    assert np.mean(np.array(found) > reaching.CLOSE) > 0.7 > np.mean(nearest_of_hands(clip()) > reaching.CLOSE)


def test_arms_reach_for_all_parts_but_themselves():
    draw = np.random.default_rng(2)
    wanted = {reaching._wanted("left", draw) for _ in range(600)}
    assert {"head", "spine", "rightHand", "leftUpperLeg", "rightFoot"} < wanted
    assert not wanted & {"leftShoulder", "leftUpperArm", "leftLowerArm", "leftHand"}


@pytest.mark.parametrize("seed", [0, 1])
def test_bent_legs_keep_the_lowest_foot_where_it_was(seed):
    bent = performances._bending(clip(), None, np.random.default_rng(seed))
    lowest = [world_pose(each)[1][:, performances.FEET, 1].min(axis=1) for each in (clip(), bent)]
    assert np.allclose(*lowest, atol=1e-9)
    hips = [each.translations[:, 0, 1] for each in (clip(), bent)]
    assert (hips[1] < hips[0] - 0.03).any()


def test_legs_that_touch_do_in_most_poses():
    def legs(pose):
        rotations = clip().rotations[:1].copy()
        rotations[0, [*performances.TRUNK, *performances.LEGS]] = pose
        return nearest_of(replace(clip(), rotations=rotations, translations=clip().translations[:1]), performances.LOW)[0]

    draw = np.random.default_rng(5)
    touching = [legs(pose) for pose in performances._touching(clip(), np.arange(8), field(), draw)]
    bent = [legs(pose) for pose in performances._bent(30, draw)]
    assert np.mean(np.array(touching) > performances.CLOSE) > 0.8 > 0.4 > np.mean(np.array(bent) > performances.CLOSE)


def test_a_performance_is_a_function_of_its_draw():
    clips = (embedded_motion("walk"),)
    one, other = (performances.drawn_performance(clips, actor(), field(), np.random.default_rng(9)) for _ in range(2))
    assert np.array_equal(one.rotations, other.rotations) and np.array_equal(one.translations, other.translations)
