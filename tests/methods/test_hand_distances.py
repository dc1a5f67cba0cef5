"""Equations of distances of hands: the slope of their energy, and nothing where nothing is off."""

from functools import cache

import numpy as np
from made_motions import actor

from retarget.body.kinematics import world_pose
from retarget.contact.skin_levers import TURNING
from retarget.methods.interaction.hand_distances import ASKED, matrix_of
from retarget.methods.interaction.looker import beside_seen, nothing_turned, prepare_looker
from retarget.methods.interaction.part_equations import ROWS
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.library import embedded_motion
from retarget.motion.touch.equations import MOST_NEAR
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare


@cache
def case(preset):
    motion = frames_of(embedded_motion("hands_on_hips"), np.array([0, 45, 60]))
    copied = prepare(actor(), actor(preset), "copy-rotations", one_rig=True, foot_lock=False).retargeter(motion).motion
    looker = prepare_looker(actor(), actor(preset))
    return looker, looker.source(motion), copied


def asked(preset, turned):
    looker, source, copied = case(preset)
    return matrix_of(beside_seen(looker.features(source, copied, world_pose(copied)[0], turned))[2])


def energy(turned):
    """Half the weighed squares of what distances are off, shares of the height, on the frame in the middle."""
    looker, source, copied = case("heavy")
    own, there = looker.distances, looker.field.target(*world_pose(looker.moved(copied, world_pose(copied)[0], turned)))[0]
    here, now = (np.linalg.norm(each[1, own.pairs[0]] - each[1, own.pairs[1]], axis=1) for each in (source[0], there))
    share = here / own.heights[0] / (2.0 * own.radii[0])
    weight = np.where(share < 1.0, (1.0 - share) ** 2, 0.0)
    off = now / own.heights[1] - here / own.heights[0] * own.radii[1] / own.radii[0]
    return 0.5 * float((weight * off**2).sum() / max(weight.sum(), MOST_NEAR))


def test_the_right_side_is_the_energy_s_slope():
    """By finite differences, for both arms; joints carry skin in shares, which the equations leave out."""
    arms = [3 * TURNING.index(side + part) + axis for side in ("left", "right") for part in ("UpperArm", "LowerArm") for axis in range(3)]
    slopes = []
    for place in arms:
        ahead, behind = nothing_turned(3), nothing_turned(3)
        ahead[1, place], behind[1, place] = 1e-3, -1e-3
        slopes.append((energy(behind) - energy(ahead)) / 2e-3)
    told = asked("heavy", nothing_turned(3))[1][1][[list(ROWS).index(place) for place in arms]]
    assert np.dot(told, slopes) > 0.95 * np.linalg.norm(told) * np.linalg.norm(slopes) > 0
    assert 0.8 < np.linalg.norm(told) / np.linalg.norm(slopes) < 1.25


def test_the_same_body_in_the_same_pose_is_right():
    matrix, right = asked("thin", nothing_turned(3))
    assert np.abs(right).max() < 1e-5 and np.abs(matrix[1]).max() > 1e-3


def test_hands_that_are_far_from_everything_ask_nothing():
    looker, (places, frames), copied = case("heavy")
    far = places * 3.0
    out = looker.distances.equations(far, places, np.zeros((3, 3, 4)), np.zeros((3, len(TURNING), 3)), np.zeros((3, len(TURNING), 3, 3)))
    assert out.shape == (3, ASKED) and not out.any()


def test_matrices_are_those_of_squares():
    matrix, _ = asked("heavy", np.random.default_rng(0).normal(size=(3, SIZE)) * 0.05)
    assert np.array_equal(matrix, matrix.transpose(0, 2, 1)) and np.linalg.eigvalsh(matrix).min() > -1e-6
