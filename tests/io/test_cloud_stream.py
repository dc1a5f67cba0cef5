import io

import numpy as np
import pytest

from retarget.errors import RetargetError
from retarget.io.cloud_stream import CloudStream, frame_bytes


def clouds(count=3):
    rng = np.random.default_rng(0)
    return [rng.normal(size=(size, 3)).astype(np.float32) for size in rng.integers(0, 50, count)]


def test_frames_come_back():
    stream = CloudStream(io.BytesIO(b"".join(map(frame_bytes, clouds()))))
    assert all(np.array_equal(one, two) for one, two in zip(list(stream), clouds(), strict=True))
    assert stream.frames == 3 and not stream.cut_short


def test_the_framing_is_what_it_says():
    assert frame_bytes(np.array([[1.0, 2.0, 3.0]])) == b"\x01\0\0\0" + np.array([1, 2, 3], "<f4").tobytes()


@pytest.mark.parametrize("missing", [1, 11, 13, 14])
def test_a_stream_that_ends_within_a_frame_gives_all_whole_ones(missing):
    whole = frame_bytes(np.ones((5, 3))) + frame_bytes(np.zeros((1, 3)))
    stream = CloudStream(io.BytesIO(whole[:-missing]))
    assert len(list(stream)) == 1 and stream.cut_short


def test_a_stream_that_is_none_is_refused():
    with pytest.raises(RetargetError, match="frame 0 of the stream is said to have .* points"):
        list(CloudStream(io.BytesIO(b"ply\nformat ascii 1.0")))


def test_memory_is_taken_as_points_arrive():
    stream = CloudStream(io.BytesIO(np.uint32(9_000_000).tobytes() + bytes(24)))
    assert list(stream) == [] and stream.cut_short
