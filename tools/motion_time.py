"""Curves over time: eased keys, sums of slow waves; and the clock of a clip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

from retarget.motion.filter import gaussian

Array = np.ndarray
FPS = 30.0


def clock(seconds: float) -> Array:
    """Times of all frames of a clip, the first 0."""
    return np.arange(int(round(seconds * FPS)) + 1) / FPS


def ease(t: Array, start: float, end: float) -> Array:
    """From 0 to 1 between two times with the least jerk, velocity and acceleration zero at both ends (Flash and Hogan 1985)."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def bump(t: Array, start: float, top: float, end: float) -> Array:
    """From 0 up to 1 and down again."""
    return ease(t, start, top) * (1.0 - ease(t, top, end))


def keyed(t: Array, keys: Sequence[tuple[float, Array | float]], soft: float = 2.0, late: Array | float = 0.0) -> Array:
    """Values (times, ...) that pass near their keys: monotone between them, held where two neighbours agree.

    `soft` frames of Gaussian smoothing round the corners in acceleration; `late` (seconds, one a value) lets some
    values follow after the others.
    """
    times = np.array([key[0] for key in keys], dtype=float)
    values = np.array([np.asarray(key[1], dtype=float) for key in keys])
    flat = values.reshape(len(values), -1)
    delays = np.broadcast_to(np.asarray(late, dtype=float).ravel(), flat.shape[1:])
    margin = int(np.ceil(4 * soft))
    wide = np.concatenate([t[0] - np.arange(margin, 0, -1) / FPS, t, t[-1] + np.arange(1, margin + 1) / FPS])
    out = np.empty((len(wide), flat.shape[1]))
    for delay in np.unique(delays):
        mine = delays == delay
        at = np.clip(wide - delay, times[0], times[-1])
        out[:, mine] = PchipInterpolator(times, flat[:, mine])(at) if len(times) > 1 else flat[0, mine]
    return gaussian(out, soft)[margin : margin + len(t)].reshape((len(t), *values.shape[1:]))


def sway(t: Array, seed: int, period: float = 3.0, waves: int = 4) -> Array:
    """A slow irregular wave about zero with a standard deviation near one, always the same for a seed."""
    random = np.random.default_rng(seed)
    periods = period * random.uniform(0.6, 1.8, waves)
    phases = random.uniform(0, 2 * np.pi, waves)
    return np.sin(2 * np.pi * t[:, None] / periods + phases).sum(axis=1) * np.sqrt(2.0 / waves)


def breath(t: Array, period: float = 3.7, phase: float = 0.0) -> Array:
    """0 empty to 1 full: breathing in takes two fifths of the period."""
    part = (t / period + phase) % 1.0
    return np.where(part < 0.4, ease(part, 0.0, 0.4), 1.0 - ease(part, 0.4, 0.97))
