"""Point clouds one after another on a stream of bytes: for each frame a uint32 with the number of points, then that many points
of three float32 (x, y, z); all little-endian, nothing else in between."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float32

from retarget.errors import RetargetError

Array = np.ndarray

MOST_POINTS = 10_000_000
"""Points of a frame. More are a stream that is no stream of clouds."""
AT_ONCE = 1 << 20
"""Bytes read at once: memory is taken as points arrive, not as a header promises them."""


class CloudStream:
    """Frames of a stream, read one by one. `cut_short` says, once it ended, that it did so within a frame."""

    def __init__(self, file: Any) -> None:
        """`file` has a `read` that takes a number of bytes, like standard input's buffer."""
        self._file = file
        self.frames = 0
        """Whole frames read so far."""
        self.cut_short = False

    def __iter__(self) -> Iterator[Float32[Array, "_ 3"]]:
        """Every whole frame. Raises `RetargetError` for a frame of more than `MOST_POINTS` points."""
        while True:
            head = self._read(4)
            if len(head) < 4:
                self.cut_short = len(head) > 0
                return
            count = int(np.frombuffer(head, "<u4")[0])
            if count > MOST_POINTS:
                raise RetargetError(
                    f"frame {self.frames} of the stream is said to have {count:,} points, more than {MOST_POINTS:,}: each frame is a "
                    "little-endian uint32 with their number, then three float32 a point"
                )
            body = self._read(12 * count)
            if len(body) < 12 * count:
                self.cut_short = True
                return
            self.frames += 1
            yield np.frombuffer(body, "<f4").reshape(-1, 3)

    def _read(self, size: int) -> bytes:
        """So many bytes, or what there is until the end."""
        parts, left = [], size
        while left:
            part = self._file.read(min(left, AT_ONCE))
            if not part:
                break
            parts.append(part)
            left -= len(part)
        return b"".join(parts)


def frame_bytes(points: Array) -> bytes:
    """One frame as the stream has it."""
    return np.uint32(len(points)).astype("<u4").tobytes() + np.ascontiguousarray(points, dtype="<f4").tobytes()
