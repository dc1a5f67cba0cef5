"""What ufbx reads, held so that it cannot bring the process down. Runs in the child.

ufbx 0.0.5 stops the whole process where a wrapper outlives what it wraps, or dies while its owner is used; so every
wrapper is kept alive to the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_kept: list[Any] = []


def hold(wrapper: Any) -> Any:
    """The wrapper, kept alive to the end."""
    _kept.append(wrapper)
    return wrapper


def items(listed: Any) -> list[Any]:
    """All members of a list of ufbx, kept alive, and the list with them."""
    hold(listed)
    return [hold(listed[number]) for number in range(len(listed))]


def integers(listed: Any) -> np.ndarray:
    """A list of numbers as int64."""
    hold(listed)
    return np.array([listed[number] for number in range(len(listed))], dtype=np.int64)


def vectors(listed: Any, width: int) -> np.ndarray:
    """A list of vectors (n, width) as doubles, copied out of the scene's memory at once."""
    hold(listed)
    return np.array(memoryview(listed), dtype=np.float64).reshape(-1, width) if len(listed) else np.zeros((0, width))


def open_scene(source: str) -> Any:
    """The file in metres with +Y up; geometry and joints changed so that no node is scaled or turned for it."""
    import ufbx

    return hold(ufbx.load_file(
        source,
        target_axes=ufbx.axes_right_handed_y_up,
        target_unit_meters=1.0,
        space_conversion=ufbx.SpaceConversion.MODIFY_GEOMETRY,
        geometry_transform_handling=ufbx.GeometryTransformHandling.MODIFY_GEOMETRY,
        inherit_mode_handling=ufbx.InheritModeHandling.COMPENSATE,
        load_external_files=False,
        clean_skin_weights=True,
    ))  # fmt: skip
