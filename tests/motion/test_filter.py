"""Smoothing and resampling along time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from retarget.body import rotations as rot
from retarget.character import Motion, Skeleton
from retarget.errors import RetargetError
from retarget.motion.filter import FASTEST, cut, gaussian, resample, upper_envelope

BONE = Skeleton(
    ("root", "tip"), np.array([-1, 0]), np.zeros((2, 3)) + [[0, 0, 0], [0, 1, 0]], np.tile(rot.IDENTITY, (2, 1))
)


def turning(frames, fps, rate=1.0):
    """The tip turns about y at `rate` radians a second, the root goes along x at 1 m/s."""
    time = np.arange(frames) / fps
    rotations = np.tile(rot.IDENTITY, (frames, 2, 1))
    rotations[:, 1] = rot.from_rotation_vector(time[:, None] * [0, rate, 0])
    return Motion(BONE, rotations, time[:, None, None] * [1.0, 0, 0], float(fps), name="turning")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=40), st.integers(0, 12))
def test_the_upper_envelope_is_never_below(values, reach):
    values = np.array(values)
    envelope = upper_envelope(values, reach)
    assert envelope.shape == values.shape
    assert (envelope >= values - 1e-9).all()
    assert envelope.max() <= values.max() + 1e-9


def test_the_upper_envelope_of_a_spike_is_a_smooth_hill():
    spike = np.zeros(61)
    spike[30] = 1.0
    hill = upper_envelope(spike, 10)
    assert hill[30] == pytest.approx(1.0) and hill[0] == hill[-1] == 0.0
    assert np.abs(np.diff(hill)).max() <= 0.12, "it rises over the reach, it does not jump"
    assert np.allclose(hill, hill[::-1])


def test_gaussian_keeps_constants_and_lines_and_damps_noise():
    line = np.arange(50.0)[:, None] * [1.0, -2.0]
    assert np.allclose(gaussian(np.full((20, 3), 4.0), 3.0), 4.0)
    assert np.allclose(gaussian(line, 2.0)[10:-10], line[10:-10])
    noise = np.random.default_rng(0).normal(size=2000)
    assert gaussian(noise, 4.0).std() == pytest.approx(1 / np.sqrt(2 * np.sqrt(np.pi) * 4.0), rel=0.2)
    assert np.array_equal(gaussian(noise, 0.0), noise) and len(gaussian(noise[:1], 9.0)) == 1


@pytest.mark.parametrize("fps", [15.0, 24.0, 59.94, 120.0])
def test_resampling_follows_the_same_path(fps):
    motion = turning(61, 30.0)
    other = resample(motion, fps)
    time = np.arange(len(other)) / fps
    assert other.fps == fps and other.name == motion.name
    assert motion.seconds - other.seconds < 1 / fps, "the duration stays, but for a part of a frame"
    assert other.seconds <= motion.seconds + 1e-9
    assert np.allclose(other.translations[:, 0, 0], time)
    assert np.allclose(rot.to_rotation_vector(other.rotations[:, 1])[:, 1], time, atol=1e-9)


def test_resampling_keeps_both_ends_and_there_and_back_again():
    motion = turning(31, 30.0)
    double = resample(motion, 60.0)
    assert len(double) == 61
    assert np.allclose(double.translations[[0, -1]], motion.translations[[0, -1]])
    back = resample(double, 30.0)
    assert np.allclose(back.rotations, motion.rotations) and np.allclose(back.translations, motion.translations)


def test_resampling_turns_the_short_way():
    motion = turning(2, 1.0, rate=1.0)
    flipped = Motion(BONE, motion.rotations * [[[1.0]], [[-1.0]]], motion.translations, 1.0)
    halfway = resample(flipped, 2.0).rotations[1, 1]
    assert np.abs(rot.to_rotation_vector(halfway) - [0, 0.5, 0]).max() < 1e-9


def test_one_frame_can_be_resampled():
    assert len(resample(turning(1, 30.0), 60.0)) == 1 and resample(turning(1, 30.0), 60.0).fps == 60.0


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 2 * FASTEST])
def test_impossible_frame_rates_are_refused(fps):
    with pytest.raises(RetargetError, match="frame rate"):
        resample(turning(10, 30.0), fps)


def test_resampling_does_not_fill_the_memory():
    hours = Motion(BONE, np.tile(rot.IDENTITY, (2, 2, 1)), np.zeros((2, 1, 3)), 1e-5)
    with pytest.raises(RetargetError, match="more than 1,000,000 frames"):
        resample(hours, 1000.0)


def test_cutting_by_seconds():
    motion = turning(61, 30.0)
    part = cut(motion, 0.5, 1.0)
    assert (
        len(part) == 16
        and part.translations[0, 0, 0] == pytest.approx(0.5)
        and part.translations[-1, 0, 0] == pytest.approx(1.0)
    )
    assert len(cut(motion, None, None)) == 61
    assert len(cut(motion, 1.0, None)) == 31
    assert len(cut(motion, None, 99.0)) == 61, "an end beyond the clip is the clip's end"
    assert len(cut(motion, 1.0, 1.0)) == 1


@pytest.mark.parametrize(
    "start, end", [(3.0, None), (1.0, 0.5), (-0.5, None), (None, -1.0), (float("nan"), None), (None, float("inf"))]
)
def test_nothing_left_is_refused(start, end):
    with pytest.raises(RetargetError, match="0 to 2 s|times in seconds"):
        cut(turning(61, 30.0), start, end)
