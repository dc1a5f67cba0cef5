"""What a bench hands over to be drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Shaped
from numpy import ndarray as Array

from retarget.character import Mesh


@dataclass(frozen=True, eq=False)
class SheetRow:
    """A row of a sheet: one mesh in several moments, each with a caption."""

    label: str
    mesh: Mesh
    vertices: Shaped[Array, "moments vertices 3"]
    captions: tuple[str, ...]


Show = Callable[[SheetRow], None]
