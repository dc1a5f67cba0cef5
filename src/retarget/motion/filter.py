"""Smoothing and resampling along time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.character import MeshMotion, Motion, PointMotion
from retarget.errors import RetargetError

Array = np.ndarray

FASTEST = 1000.0
"""Frames a second. Beyond this a number is a mistake, and would only fill the memory."""
MOST_FRAMES = 1_000_000
"""What resampling makes of a clip at most, for the same reason."""


def gaussian(values: Float[Array, "frames *axes"], sigma: float) -> Float[Array, "frames *axes"]:
    """Gaussian low-pass along the frames, `sigma` in frames; the ends are held."""
    if sigma <= 0 or len(values) < 2:
        return values.copy()
    reach = int(np.ceil(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    flat = values.reshape(len(values), -1)
    padded = np.pad(flat, ((reach, reach), (0, 0)), mode="edge")
    total = np.cumsum(np.zeros_like(flat), axis=0)
    for shift, weight in enumerate(kernel):
        total += weight * padded[shift : shift + len(flat)]
    return total.reshape(values.shape)


def upper_envelope(values: Float[Array, "frames"], reach: int) -> Float[Array, "frames"]:
    """The smallest smooth-ish curve that is nowhere below `values`: running maximum over ±reach frames, then averaged."""
    if reach < 1 or len(values) < 2:
        return values.copy()
    window = np.lib.stride_tricks.sliding_window_view
    highest = window(np.pad(values, 2 * reach, mode="edge"), 2 * reach + 1).max(axis=-1)
    smooth = highest
    # Two box averages of half the width each stay above the values, because the maximum was taken over their full reach.
    for half in (reach - reach // 2, reach // 2):
        if half:
            smooth = window(np.pad(smooth, half, mode="edge"), 2 * half + 1).mean(axis=-1)
    return smooth[reach:-reach]


def resample(motion: Motion, fps: float) -> Motion:
    """The same motion at another frame rate: rotations by slerp, positions linearly; first frame and duration stay.

    Raises `RetargetError` for a rate that is not positive or beyond `FASTEST`, or for more than `MOST_FRAMES`.
    """
    if not 0 < fps <= FASTEST:
        raise RetargetError(f"frame rate must be positive and at most {FASTEST:g}, received {fps:g}")
    if fps == motion.fps or len(motion) < 2:
        return replace(motion, fps=fps)
    if motion.seconds * fps > MOST_FRAMES:
        raise RetargetError(
            f"{motion.seconds:g} s at {fps:g} frames a second are more than {MOST_FRAMES:,} frames; cut the clip first"
        )
    count = int(np.floor(motion.seconds * fps + 1e-6)) + 1
    place = np.minimum(np.arange(count) * (motion.fps / fps), len(motion) - 1)
    left = np.minimum(place.astype(int), len(motion) - 2)
    part = place - left
    return replace(
        motion,
        rotations=rot.slerp(motion.rotations[left], motion.rotations[left + 1], part[:, None]),
        translations=motion.translations[left] * (1 - part)[:, None, None]
        + motion.translations[left + 1] * part[:, None, None],
        fps=fps,
    )


def cut(motion: Motion, start: float | None, end: float | None) -> Motion:
    """The part between two times in seconds. Raises `RetargetError` when nothing is left."""
    for time in (start, end):
        if time is not None and not np.isfinite(time):
            raise RetargetError(f"start and end are times in seconds, received {time}")
    first = 0 if start is None else int(round(start * motion.fps))
    last = len(motion) if end is None else int(round(end * motion.fps)) + 1
    if not 0 <= first < min(last, len(motion)):
        raise RetargetError(
            f"nothing lies between {start if start is not None else 0:g} s and {end if end is not None else motion.seconds:g} s; "
            f"the clip runs from 0 to {motion.seconds:g} s"
        )
    kept, made_from = motion.rotations[first:last], motion.made_from
    if made_from is not None:
        begins = made_from.start + first / motion.fps
        made_from = replace(made_from, start=begins, end=begins + (len(kept) - 1) / motion.fps)
    return replace(motion, rotations=kept, translations=motion.translations[first:last], made_from=made_from)


def cut_clouds(capture: PointMotion, start: float | None, end: float | None) -> PointMotion:
    """The frames of a capture between two times in seconds. Raises `RetargetError` when nothing is left."""
    chosen = _chosen_frames(len(capture), capture.fps, start, end)
    return replace(capture, clouds=tuple(capture.clouds[frame] for frame in chosen))


def cut_surface(sequence: MeshMotion, start: float | None, end: float | None) -> MeshMotion:
    """The frames of a mesh sequence between two times in seconds. Raises `RetargetError` when nothing is left."""
    chosen = _chosen_frames(len(sequence), sequence.fps, start, end)
    return sequence if len(chosen) == len(sequence) else replace(sequence, vertices=sequence.vertices[chosen])


def _chosen_frames(frames: int, fps: float, start: float | None, end: float | None) -> Int[Array, "_"]:
    """Which frames lie between two times. Raises `RetargetError` where none does."""
    seconds = np.arange(frames) / fps
    chosen = (seconds >= (start or 0.0) - 1e-9) & (seconds <= (np.inf if end is None else end) + 1e-9)
    if not chosen.any():
        raise RetargetError(f"no frame lies between {start or 0.0:g} s and {seconds[-1] if end is None else end:g} s of {seconds[-1]:g} s")
    return np.flatnonzero(chosen)
