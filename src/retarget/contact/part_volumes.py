"""Volumes of the parts of a posed body, and the surface inflated until they are what they should be.

Basset 2019, section 4.2, adds a step along the normals towards the target's volumes to every iteration; it mixes cubic metres
with metres, so that it only works in one unit. Here one offset a part is found by Newton's method for all parts together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.collide import Collider
from retarget.geometry.topology import adjacency

Array = np.ndarray

SPREAD = 8
"""Rounds of averaging with neighbours by which a part's offset fades out over its seams."""
STEPS = 2
"""Newton steps."""
LEAST = 1e-6
"""Damping, over the mean of the system's diagonal."""


@dataclass(frozen=True, eq=False)
class PartVolumes:
    """A body whose parts have volumes; `prepare_volumes` makes one."""

    collider: Collider
    shares: Float[Array, "vertices solids"]
    """How much each solid's offset moves each vertex."""
    members: Int[Array, "_"]
    """Vertices of one solid after the other."""
    member_starts: Int[Array, "_"]
    """First place of each solid in `members`, and the end."""
    volumes: Float[Array, "solids"]
    """At rest, cubic metres."""
    faces: Int[Array, "faces 3"]
    """Over welded vertices."""

    def of(self, vertices: Float[Array, "vertices 3"]) -> Float[Array, "solids"]:
        """Volumes of the parts of a posed body (metres), cubic metres."""
        return self._system(vertices, np.zeros((len(vertices), 3)))[0]

    def kept(self, vertices: Float[Array, "vertices 3"]) -> Float[Array, "vertices 3"]:
        """The posed body with the volumes that its parts have at rest, every vertex moved along its normal."""
        from retarget.geometry import turn_kernels as kernels

        normals = np.empty((len(vertices), 3))
        for _ in range(STEPS):
            kernels.normals(vertices, self.faces, normals)
            volumes, matrix = self._system(vertices, normals)
            square = matrix.T @ matrix
            square[np.diag_indices(len(square))] += LEAST * square.trace() / len(square)
            offsets = np.linalg.solve(square, matrix.T @ (self.volumes - volumes))
            vertices = vertices + (self.shares @ offsets)[:, None] * normals
        return vertices[self.collider.parts.welded]

    def _system(self, vertices: Array, normals: Array) -> tuple[Float[Array, "solids"], Float[Array, "solids solids"]]:
        from retarget.contact import kernels as contact_kernels
        from retarget.geometry import turn_kernels as kernels

        own, solids = self.collider, len(self.volumes)
        rims, count = own.rim_starts, len(vertices)
        points = np.empty((count + len(rims) - 1, 3))
        points[:count] = vertices
        contact_kernels.rim_centres(points, own.rims, rims, count)
        volumes, matrix = np.empty(solids), np.zeros((solids, solids))
        kernels.volume_system(
            points, own.corners, own.starts, own.rims, rims, self.members, self.member_starts, normals, self.shares,
            np.zeros_like(points), volumes, matrix,
        )  # fmt: skip
        return volumes, matrix


def prepare_volumes(collider: Collider, rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> PartVolumes:
    """Prepare a body with its solids, from its surface at rest (metres)."""
    from scipy import sparse

    faces = np.ascontiguousarray(collider.parts.welded[faces])
    count, solids = len(rest), len(collider.starts) - 1
    shares, members = np.zeros((count, solids)), []
    for solid in range(solids):
        corners = collider.corners[collider.starts[solid] : collider.starts[solid + 1]]
        members.append(np.unique(corners[corners < count]))
        shares[members[-1], solid] = 1.0
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1.0)
    graph = adjacency(faces, count) + sparse.identity(count, format="csr")
    spread = sparse.diags_array(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph
    for _ in range(SPREAD):
        shares = spread @ shares
    found = PartVolumes(
        collider, np.ascontiguousarray(shares), np.concatenate([np.zeros(0, dtype=np.int64), *members]),
        np.cumsum([0, *map(len, members)]), np.ones(solids), faces,
    )  # fmt: skip
    return replace(found, volumes=found.of(rest))
