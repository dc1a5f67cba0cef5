"""Where a picture is taken from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.errors import RetargetError

Array = np.ndarray

AZIMUTHS = {"front": 0.0, "three-quarter": -35.0, "side": -90.0, "back": 180.0}
"""Directions by name, degrees from the subject's front (+Z) toward its left (+X). From the side it faces right."""


@dataclass(frozen=True)
class Camera:
    """A long lens that looks at `target` from `distance` metres, with the picture's upright edges upright."""

    target: tuple[float, float, float] = (0.0, 0.9, 0.0)
    azimuth: float = AZIMUTHS["three-quarter"]
    """Degrees from +Z toward +X: 0 sees the front of a subject that faces +Z."""
    elevation: float = 12.0
    """Degrees above the horizontal, within -89..89."""
    distance: float = 8.0
    span: float = 2.0
    """Height of what the picture shows at the target's distance, metres."""
    shift: float = 0.0
    """How far the picture's centre lies above the target there, metres (a lens shift: nothing tilts)."""

    def __post_init__(self) -> None:
        values = np.array([*self.target, self.azimuth, self.elevation, self.distance, self.span, self.shift])
        if not np.isfinite(values).all() or self.distance <= 0 or self.span <= 0 or abs(self.elevation) > 89:
            needs = "finite numbers, distance and span above zero, elevation within -89..89"
            raise RetargetError(f"a camera needs {needs}; received {self}")

    @property
    def scale(self) -> float:
        """About the size of what is looked at, metres: line widths and fading follow it, so that cropping does not."""
        return self.distance / 4.5

    def axes(self) -> Float[Array, "3 3"]:
        """Rows: the directions of the picture's right and up, and the one from the target to the camera."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        return np.stack([right, np.cross(back, right), back])

    def project(
        self, points: Float[Array, "*batch 3"], width: int, height: int
    ) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch"]]:
        """Pixels (x right, y down) and nearness: one over the depth in metres, 0 beside and behind the camera."""
        right, up, toward = np.moveaxis((points - np.asarray(self.target)) @ self.axes().T, -1, 0)
        depth = self.distance - toward
        near = np.where(depth > 0.02 * self.distance, 1.0 / np.maximum(depth, 0.02 * self.distance), 0.0)
        scale = near * self.distance * height / self.span
        lift = self.shift * height / self.span
        return np.stack([width / 2 + right * scale, height / 2 + lift - up * scale], axis=-1), near

    def key_light(self) -> Float[Array, "3"]:
        """Direction toward the key light: from the camera's upper left, always well above the ground."""
        a, e = np.radians(self.azimuth - 55.0), np.radians(58.0)
        return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
