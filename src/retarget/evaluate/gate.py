"""Keep what was reached: compare a bench's summary with the committed baseline."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from retarget.errors import FileError

BASELINE = Path(__file__).with_name("baseline.json")


@dataclass(frozen=True)
class Bound:
    """What a figure must not pass."""

    value: float
    """As committed."""
    better: str
    """'lower' or 'higher'."""
    tolerance: float
    """How far beyond the committed value still passes, in the figure's own unit."""

    @property
    def limit(self) -> float:
        return self.value + (self.tolerance if self.better == "lower" else -self.tolerance)

    def holds(self, measured: float) -> bool:
        return measured <= self.limit if self.better == "lower" else measured >= self.limit


def bounds_of(bench: str, quick: bool, path: Path = BASELINE) -> dict[str, Bound]:
    """The committed bounds of a bench, by summary key. Raises `FileError` for a baseline that cannot be used."""
    try:
        stored = json.loads(path.read_text())
        chosen = stored.get(bench, {}).get("quick" if quick else "full", {})
        return {key: Bound(float(row["value"]), row["better"], float(row["tolerance"])) for key, row in chosen.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise FileError(path, f"is no baseline: {error}") from None


def regressions(summary: Mapping[str, Any], bounds: Mapping[str, Bound]) -> list[str]:
    """A line for every bounded figure that got worse than its tolerance, or is missing."""
    lines = []
    for key, bound in bounds.items():
        measured = summary.get(key)
        if measured is None:
            lines.append(f"{key} was not measured; the baseline has {bound.value:g}")
        elif not bound.holds(float(measured)):
            side = "at most" if bound.better == "lower" else "at least"
            lines.append(f"{key} is {measured:.4g}; right is {side} {bound.limit:.4g} (baseline {bound.value:g})")
    return lines
