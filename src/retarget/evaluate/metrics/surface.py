"""Metrics on vertices and points of a surface whose true places are known.

MPVD, PA-MPVD and MDEL are those of Rekik 2023 (3DV, section 4); volumes of body parts are those of Basset 2019
(section 4.2.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.evaluate.metrics.basis import mean, procrustes, require_alike
from retarget.geometry.topology import signed_volume

Array = np.ndarray

NEIGHBOURS = 6
"""Edges that MDEL draws from each point (Rekik 2023)."""


def mpvd(result: Float[Array, "frames vertices 3"], truth: Float[Array, "frames vertices 3"]) -> float:
    """Mean per-vertex distance: mean over frames and vertices of |r - t|, metres (Rekik 2023, table 4)."""
    require_alike(truth=truth, result=result)
    return mean(np.linalg.norm(result - truth, axis=-1))


def pa_mpvd(result: Float[Array, "frames vertices 3"], truth: Float[Array, "frames vertices 3"]) -> float:
    """MPVD after aligning every frame on its own by rotation and translation, without scale, metres (Rekik 2023, table
    4). The paper does not say how it aligns; as in `pa_mpjpe`, this is our choice."""
    return mpvd(procrustes(result, truth), truth)


def mdel(
    result: Float[Array, "frames vertices 3"],
    truth: Float[Array, "frames vertices 3"],
    rest: Float[Array, "vertices 3"] | None = None,
) -> float:
    """Mean difference of edge lengths: mean over frames and edges of ||r_a - r_b| - |t_a - t_b||, metres; edges go from
    each point to its 6 nearest neighbours in the truth (Rekik 2023, table 4; needs scipy).

    The paper does not say whether neighbours are sought in each frame. By default they are (ours, its words taken
    literally), so that where skin touches skin edges cross the gap; give `rest` (true points in the rest pose) to seek
    them once there, along the surface. Two points that are each other's neighbours count twice. Points must not coincide
    (weld doubled seam vertices before). Raises `RetargetError` for fewer than seven points.
    """
    require_alike(truth=truth, result=result)
    if truth.shape[1] <= NEIGHBOURS:
        raise RetargetError(f"MDEL needs more than {NEIGHBOURS} points, received {truth.shape[1]}")
    edges = None
    if rest is not None:
        require_alike(truth=truth[0] if len(truth) else rest, rest=rest)
        edges = _nearest(rest)
    differences = np.empty((len(truth), truth.shape[1], NEIGHBOURS))
    for frame, (made, right) in enumerate(zip(result, truth)):
        ends = _nearest(right) if edges is None else edges
        lengths = (np.linalg.norm(points[ends] - points[:, None], axis=-1) for points in (made, right))
        differences[frame] = np.abs(np.subtract(*lengths))
    return mean(differences)


def _nearest(points: Float[Array, "vertices 3"]) -> Int[Array, "vertices neighbours"]:
    """The six points nearest to each, itself left out."""
    from scipy.spatial import cKDTree

    found = cKDTree(points).query(points, k=NEIGHBOURS + 1)[1]
    other = found != np.arange(len(points))[:, None]  # a point is not always its own first: others may coincide
    return np.take_along_axis(found, np.argsort(other, axis=1, kind="stable"), axis=1)[:, 1:]


def volume_error_percent(
    result: Float[Array, "frames vertices 3"],
    truth: Float[Array, "truths vertices 3"],
    parts: Sequence[Int[Array, "_ 3"]],
) -> Float[Array, "frames parts"]:
    """Volume error of each body part: 100 |V(r) - V(t)| / |V(t)|, per cent, with V = sum over the part's faces of the
    signed tetrahedra a · (b x c) / 6 to one of the part's own vertices (Basset 2019, section 4.2.1).

    `parts` lists the faces of each part, closed and all turned one way (seams closed by a vertex of their own, which the
    arrays contain). `truth` has as many frames as the result, or one (the target's rest pose: the paper asks that parts
    keep the volume they have there). The relative figure is ours, the paper prints an energy (V - V_T)².
    Raises `RetargetError` for a part that is not closed or is empty in the truth.
    """
    if len(truth) not in (1, len(result)):
        raise RetargetError(f"truth has {len(truth)} frames; give one, or {len(result)} as the result has")
    require_alike(truth=truth[:1], result=result[:1] if len(result) else truth[:1])
    errors = np.empty((len(result), len(parts)))
    for number, faces in enumerate(parts):
        _require_closed(faces, number)
        true, made = _volume(truth, faces), _volume(result, faces)
        extent = np.ptp(truth[:, np.unique(faces)], axis=1).max(axis=-1)
        if (np.abs(true) <= 1e-12 * extent**3).any():
            raise RetargetError(f"part {number} has no volume in the truth")
        errors[:, number] = 100 * np.abs(made - true) / np.abs(true)
    return errors


def _volume(vertices: Float[Array, "frames vertices 3"], faces: Int[Array, "faces 3"]) -> Float[Array, "frames"]:
    """Volume of one part. Tetrahedra to a vertex of the part instead of the origin: the same, and exact far away."""
    used, local = np.unique(faces, return_inverse=True)
    corners = vertices[:, used]
    return signed_volume(corners - corners[:, :1], local.reshape(faces.shape))


def _require_closed(faces: Int[Array, "faces 3"], number: int) -> None:
    """A volume exists where every edge is walked as often one way as the other; else it would depend on the origin."""
    if len(faces) == 0:
        raise RetargetError(f"part {number} has no faces")
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[edges[:, 0] != edges[:, 1]]
    turned = edges[:, 0] > edges[:, 1]
    _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    open_edges = int(np.count_nonzero(np.bincount(edge.ravel(), weights=np.where(turned, -1, 1))))
    if open_edges:
        raise RetargetError(
            f"part {number} is not closed: {open_edges} edges lack a face that runs the other way; close its seams first"
        )
