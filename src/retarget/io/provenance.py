"""The record by which a result's file says what it was made from: a few plain values, in glTF as `extras` of the animation,
in USD as custom data of its prim.

    {"retarget": {"source": "dance.bvh", "clip": "dance", "start": 2.0, "end": 5.0, "fps": 120.0}}

No folders, no dates: equal input gives equal files, wherever they lie.
"""

from __future__ import annotations

from typing import Any

from retarget.character import Provenance
from retarget.errors import RetargetError
from retarget.io.glb import PROVENANCE_KEY as KEY

LONGEST = 1024
"""Characters of a name that is believed."""


def provenance_record(made_from: Provenance) -> dict[str, Any]:
    """The record, to be written under `KEY`. Seconds have six decimals."""
    start, end = round(made_from.start, 6), round(made_from.end, 6)
    return {"source": made_from.file, "clip": made_from.clip, "start": start, "end": end, "fps": made_from.fps}


def recorded_provenance(beside: Any) -> Provenance | None:
    """What `beside` (the extras of an animation: anybody's, anything) says under `KEY`; None where that is no such record."""
    record = beside.get(KEY) if isinstance(beside, dict) else None
    if not isinstance(record, dict):
        return None
    names = [record.get(key) for key in ("source", "clip")]
    numbers = [record.get(key) for key in ("start", "end", "fps")]
    if not all(isinstance(name, str) and len(name) <= LONGEST for name in names):
        return None
    if not all(type(number) in (int, float) and abs(number) < 1e9 for number in numbers):
        return None
    try:
        return Provenance(*names, *map(float, numbers))
    except RetargetError:
        return None
