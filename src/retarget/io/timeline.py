"""The even time grid behind the keys of an animation: numpy and no more, since readers in processes of their own use it too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Frame rates that keys are likely to lie on, the likelier first.
USUAL_RATES = (30.0, 24.0, 60.0, 25.0, 120.0, 50.0, 48.0, 100.0, 90.0, 72.0, 144.0, 240.0,
               30000 / 1001, 24000 / 1001, 60000 / 1001)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Timeline:
    """The even time grid that stands for a clip's keys."""

    start: float
    fps: float
    frames: int

    @property
    def times(self) -> np.ndarray:
        return self.start + np.arange(self.frames) / self.fps


def timeline(times: np.ndarray) -> Timeline:
    """The grid on which all keys (sorted, seconds) lie: at a usual rate, else at their own even rate, else at 30."""
    keys = times - times[0]
    length = float(keys[-1])
    if length <= 0:
        return Timeline(float(times[0]), 30.0, 1)

    def on_grid(rate: float, slack: float) -> bool:
        frames = keys * rate
        # 2e-7: single precision keys, their error grows with the time
        return bool((np.abs(frames - np.round(frames)) <= slack + 2e-7 * rate * np.abs(times)).all())

    rate = next((rate for slack in (1e-3, 2e-2) for rate in USUAL_RATES if on_grid(rate, slack)), None)
    if rate is None:
        spacing = length / (len(np.unique(np.round(keys, 6))) - 1 or 1)
        rate = 1 / spacing if 10 <= 1 / spacing <= 1000 and on_grid(1 / spacing, 2e-2) else 30.0
    return Timeline(float(times[0]), rate, int(np.ceil(length * rate - 0.02)) + 1)
