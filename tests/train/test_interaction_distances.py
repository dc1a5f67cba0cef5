"""Distances of hands weigh more than in the solver, at little cost to what the solver wants."""

from functools import cache

import numpy as np
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare
from retarget.train.interaction_distances import with_distances


@cache
def case():
    motion = frames_of(embedded_motion("hands_on_hips"), np.array([0, 45, 60]))
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(motion).motion
    return prepare_looker(actor(), actor("heavy")), motion, copied


def error(turned):
    """Mean square of what distances of near pairs are off, in radii of the arm."""
    looker, motion, copied = case()
    source, posed = looker.source(motion)[0], world_pose(looker.moved(copied, world_pose(copied)[0], turned))
    own, there = looker.distances, looker.field.target(*posed)[0]
    here, now = (np.linalg.norm(each[:, own.pairs[0]] - each[:, own.pairs[1]], axis=2) for each in (source, there))
    here, now = (each / height / radius for each, height, radius in zip((here, now), own.heights, own.radii))
    return np.array([np.mean((b - a)[a < 2.0] ** 2) if (a < 2.0).any() else 0.0 for a, b in zip(here, now)])


def solved(stiff, need=1.0):
    measure = np.tile(stiff * np.eye(SIZE), (3, 1, 1))
    return with_distances(*case(), np.zeros((3, SIZE)), measure, np.full(3, need))


def test_hands_come_as_near_as_they_should_be():
    turned, measure = solved(1.0)
    before, after = error(np.zeros((3, SIZE))), error(turned)
    assert (before[1:] > 0.1).all() and (after[1:] < 0.8 * before[1:]).all()
    assert np.isfinite(measure).all() and np.linalg.eigvalsh(measure).min() > 0.9
    assert not turned[:, -3:].any(), "the hips stay"


def test_what_the_solver_wants_holds():
    turned, _ = solved(1e9)
    assert np.abs(turned).max() < 1e-3


def test_poses_without_need_stay():
    turned, _ = solved(1.0, need=0.0)
    assert not turned.any()
