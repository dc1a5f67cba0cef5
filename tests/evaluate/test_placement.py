"""What can be kept of a patch at once: all of what only moved, the middle of what grew."""

import numpy as np

from retarget.body import rotations as rot
from retarget.evaluate.placement import kept_together


def patch(count=200):
    places = np.random.default_rng(0).uniform(-0.05, 0.05, (count, 3))
    places[:, 2] *= 0.1
    return places


def test_a_patch_that_only_turned_and_moved_is_kept_whole():
    turn = rot.from_rotation_vector(np.array([0.4, -1.0, 0.7]))
    moved = rot.rotate(turn[None], patch()) + [0.3, 1.0, -0.2]
    assert kept_together(patch(), moved, 1e-6, 0) == 200


def test_of_a_patch_that_grew_the_middle_is_kept():
    """Twice as large: pairs within the limit of the middle, as far as the patch is a square."""
    limit = 0.02
    kept = kept_together(patch(), 2.0 * patch(), limit, 0)
    within = int((np.linalg.norm(patch(), axis=1) <= limit).sum())
    assert within <= kept < 60, "folding and other middles gain little"


def test_a_mirrored_patch_is_not_laid_by_mirroring():
    solid = np.random.default_rng(1).uniform(-0.05, 0.05, (200, 3))
    assert kept_together(solid, solid * [1, 1, -1], 1e-3, 0) < 60


def test_two_pairs_can_always_be_laid():
    assert kept_together(np.zeros((2, 3)), np.array([[0.0, 0, 0], [5.0, 0, 0]]), 0.1, 0) == 2
