"""Frames that are not finite, between and beside those that are."""

import numpy as np
import pytest

from retarget.errors import RetargetError
from retarget.geometry.bridging import bridged


def line(frames=8):
    """Two vertices that go straight on, not a step as long as the other."""
    at = np.arange(frames)[:, None, None].astype(np.float32)
    return np.broadcast_to(at, (frames, 2, 3)) * np.float32([[[1], [3]]])


def test_whole_surfaces_come_back_as_they_are():
    surface = line()
    found, missing = bridged(surface)
    assert found is surface and len(missing) == 0


def test_frames_in_the_middle_lie_between_their_neighbours():
    surface = line().copy()
    surface[2, 1, 0] = np.nan  # one coordinate is enough to mistrust the frame
    surface[4:6] = np.inf
    before = surface.copy()
    found, missing = bridged(surface)
    assert missing.tolist() == [2, 4, 5]
    assert found == pytest.approx(line()) and found.dtype == np.float32
    assert np.array_equal(surface, before, equal_nan=True), "what was given is left alone"


def test_ends_repeat_the_nearest():
    surface = line().copy()
    surface[[0, 1, 7]] = np.nan
    found, missing = bridged(surface)
    assert missing.tolist() == [0, 1, 7]
    assert np.array_equal(found[0], surface[2]) and np.array_equal(found[1], surface[2])
    assert np.array_equal(found[7], surface[6])


def test_nothing_to_start_from_is_refused():
    with pytest.raises(RetargetError, match="none of the surface's 3 frames is finite"):
        bridged(np.full((3, 2, 3), np.nan))
