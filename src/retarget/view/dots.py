"""Points as pictures see them: each a small octahedron, on as many frames as are shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from retarget.character import Mesh
from retarget.view.picture import Row

Array = np.ndarray

MOST = 6000
"""Points of a frame that are drawn, at random where there are more."""
CORNERS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
SIDES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
STRAYS = 0.5
"""Per cent of the points on every side that do not decide the size of the picture: they are left out."""


def dots_row(label: str, clouds: Sequence[Array], captions: tuple[str, ...] = ()) -> Row:
    """A row of a sheet with a cloud (points, 3) a frame. What strays far from all others is not drawn, an empty frame
    shows nothing.

    Raises `RetargetError` where there is no frame.
    """
    shown = [_chosen(np.asarray(cloud, dtype=np.float64)) for cloud in clouds]
    count = max((len(cloud) for cloud in shown), default=0)
    size = _spacing(shown)
    vertices = np.empty((len(shown), 6 * count, 3))
    somewhere = next((cloud[:1] for cloud in shown if len(cloud)), np.zeros((1, 3)))
    for frame, cloud in enumerate(shown):
        if len(cloud):
            middles = np.resize(cloud, (count, 3))  # frames with fewer points show some twice
            vertices[frame] = (middles[:, None] + size * CORNERS).reshape(-1, 3)
        else:
            vertices[frame] = somewhere  # without extent: not drawn
    faces = (SIDES[None] + 6 * np.arange(count)[:, None, None]).reshape(-1, 3)
    mesh = Mesh(vertices[0] if len(vertices) else np.zeros((0, 3)), faces)
    return Row(label, mesh, vertices, captions)


def _chosen(cloud: Array) -> Array:
    if not len(cloud):
        return cloud
    low, high = np.percentile(cloud, [STRAYS, 100 - STRAYS], axis=0)
    wide = 0.5 * (high - low)
    kept = cloud[((cloud >= low - wide) & (cloud <= high + wide)).all(axis=1)]
    if len(kept) <= MOST:
        return kept
    return kept[np.random.default_rng(0).choice(len(kept), MOST, replace=False)]


def _spacing(clouds: Sequence[Array]) -> float:
    """Most of what usually lies between neighbouring points, within a 1,000th and a 50th of the cloud's size."""
    from scipy.spatial import cKDTree

    cloud = max(clouds, key=len, default=np.zeros((0, 3)))
    if len(cloud) < 2:
        return 0.01
    size = float(np.linalg.norm(np.ptp(cloud, axis=0))) or 1.0
    apart = float(np.median(cKDTree(cloud).query(cloud, 2)[0][:, 1]))
    return float(np.clip(0.7 * apart, size / 1000, size / 50))
