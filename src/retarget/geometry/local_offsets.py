"""A surface's shape as offsets in local frames, whatever its pose: high frequencies of another surface are brought to it.

Basset 2019, equations 2 and 3 (after Wuhrer and others 2012): each vertex lies at an offset from the mean of its neighbours,
written in a frame of its normal and one neighbour. The paper transfers shapes by some hundred steps towards those places;
here a handful clean what gradient-domain deformation leaves: creases at joints and the source's own artefacts there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.geometry.topology import adjacency

Array = np.ndarray

SHARE = 0.6
"""Of the way that a vertex goes in one step: twice the paper's epsilon, so that half as many steps come as far."""


@dataclass(frozen=True, eq=False)
class LocalOffsets:
    """A shape at rest; `prepare_offsets` makes one."""

    faces: Int[Array, "faces 3"]
    """Over welded vertices."""
    starts: Int[Array, "_"]
    """First neighbour of each vertex in `others`, and the end; neighbours share an edge."""
    others: Int[Array, "entries"]
    leading: Int[Array, "vertices"]
    """The neighbour that turns each vertex's frame: the one that lies farthest across its normal; itself where there is none."""
    offsets: Float[Array, "vertices 3"]
    """From the mean of the neighbours, in the local frame, metres."""
    welded: Int[Array, "vertices"]

    def relaxed(self, vertices: Float[Array, "vertices 3"], steps: int) -> Float[Array, "vertices 3"]:
        """A posed surface (metres) some steps nearer to this shape."""
        from retarget.geometry import turn_kernels as kernels

        vertices = np.array(vertices, dtype=np.float64)
        normals, moved = np.empty((2, *vertices.shape))
        for _ in range(steps):
            kernels.normals(vertices, self.faces, normals)
            kernels.offset_moves(vertices, normals, self.starts, self.others, self.leading, self.offsets, SHARE, moved)
            vertices, moved = moved, vertices
        return vertices[self.welded] if steps else vertices


def prepare_offsets(
    rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], welded: Int[Array, "vertices"]
) -> LocalOffsets:
    """The shape of a surface at rest (metres); `welded` names the first vertex at each one's place."""
    from retarget.geometry import turn_kernels as kernels

    faces = np.ascontiguousarray(welded[faces])
    count = len(rest)
    graph = adjacency(faces, count)
    starts, others = graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
    rest = np.ascontiguousarray(rest, dtype=np.float64)
    normals, offsets = np.empty((count, 3)), np.empty((count, 3))
    kernels.normals(rest, faces, normals)
    rows = np.repeat(np.arange(count), np.diff(starts))
    across = np.linalg.norm(np.cross(rest[others] - rest[rows], normals[rows]), axis=1)
    leading, order = np.arange(count), np.lexsort((across, rows))
    leading[rows[order]] = others[order]  # the last one written is the farthest
    kernels.local_offsets(rest, normals, starts, others, leading, offsets)
    return LocalOffsets(faces, starts, others, leading, offsets, welded)
