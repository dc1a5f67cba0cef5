"""Shake of longer limbs is filtered, and only that."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, prepared, walk

from retarget.body import rotations as rot
from retarget.methods import CopyRotations
from retarget.motion.steady import LONGEST_SIGMA, lightest, low_pass, shake


def test_shake_is_the_third_difference_over_a_thirtieth():
    for fps in (30.0, 60.0, 120.0):
        time = np.arange(int(fps)) / fps
        points = np.stack([time**3, 0 * time, time], axis=-1)[:, None]
        assert shake(points, fps, 2.0) == pytest.approx(6 / 2, rel=1e-6)
    assert shake(np.zeros((3, 1, 3)), 30.0, 1.0) == 0.0


@pytest.mark.parametrize(("needed", "found"), [(0.0, 0.0), (0.1, 0.125), (0.3, 0.375), (0.99, 1.0), (2.0, 1.0)])
def test_the_lightest_filter_that_does_it_is_found(needed, found):
    assert lightest(lambda strength: 1.0 - strength, 1.0 - needed, 1.0) == pytest.approx(found)


def test_a_low_pass_keeps_the_mean_and_takes_the_tremble():
    angles = 0.3 + 0.1 * (-1.0) ** np.arange(60)
    turned = rot.from_rotation_vector(angles[:, None, None] * np.array([0.0, 0.0, 1.0]))
    path = np.stack([angles] * 3, axis=-1)
    smooth, way = low_pass(turned, path, 1.0)
    assert np.abs(rot.to_rotation_vector(smooth)[5:-5, 0, 2] - 0.3).max() < 2e-3
    assert np.abs(way[5:-5] - 0.3).max() < 2e-3


def trembling(seed=4):
    """The walk as a poor capture has it."""
    motion = walk()
    noise = np.random.default_rng(seed).normal(scale=0.02, size=motion.rotations.shape[:2] + (3,))
    return replace(motion, rotations=rot.multiply(motion.rotations, rot.from_rotation_vector(noise)))


def stocky(legs=0.4):
    """The thin human with short legs."""
    character = body()
    skeleton = character.skeleton
    short = [skeleton.index(f"{side}{part}") for side in ("left", "right") for part in ("LowerLeg", "Foot")]
    offsets = skeleton.offsets.copy()
    offsets[short] *= legs
    return cast_by_names(replace(character, skeleton=replace(skeleton, offsets=offsets), mesh=None, skin=None))


def test_short_legs_bring_a_filter_and_the_sources_own_body_none():
    own = prepared(actor(), actor(), CopyRotations())(trembling())
    assert own.stats["low_pass_s"] == 0.0
    target = stocky()
    steady, plain = (
        prepared(actor(), target, CopyRotations(foot_lock=False, steady=each))(trembling()) for each in (True, False)
    )
    assert 0 < steady.stats["low_pass_s"] <= LONGEST_SIGMA
    assert plain.stats["low_pass_s"] == 0.0
    joint = target.humanoid.joints["leftHand"]
    shaken = [np.linalg.norm(np.diff(result.motion.rotations[:, joint], n=3, axis=0)) for result in (steady, plain)]
    assert shaken[0] < 0.6 * shaken[1]
    turned_by = np.degrees(rot.angle_between(steady.motion.rotations, plain.motion.rotations))
    assert turned_by.mean() < 2.0
