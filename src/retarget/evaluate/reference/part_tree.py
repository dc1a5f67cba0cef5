"""Basset 2019's body: rigid parts in a tree, each turning about the seam with its parent (sections 4.2.1 and 4.3.3).

The paper's parts and their order are made by hand. Ours come from the skin's weights (`contact.parts`), and the tree from the
seams: the parts hang together by their longest ones, the pelvis, which holds the crotch, at the root.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.contact.parts import BodyParts
from retarget.errors import RetargetError
from retarget.geometry.topology import closing_fans, is_oriented, unique_pairs

Array = np.ndarray

ROOT = "pelvis"


@dataclass(frozen=True, eq=False)
class Solids:
    """Parts of a surface, each closed by fans over its seams; `closed_parts` makes one."""

    count: int
    corners: Int[Array, "triangles 3"]
    """Skin and fans of all solids; vertices first and then the centres of the rims."""
    owners: Int[Array, "triangles"]
    """Solid of each triangle."""
    centres: Any
    """Sparse (rims x vertices): the centroid of each rim."""

    def points(self, vertices: Float[Array, "vertices 3"]) -> Float[Array, "points 3"]:
        """What `corners` index."""
        return np.concatenate([vertices, self.centres @ vertices])


@dataclass(frozen=True, eq=False)
class PartTree:
    """The parts of a body, parents before children; `part_tree` makes one."""

    names: tuple[str, ...]
    parents: Int[Array, "parts"]
    """-1 for the root."""
    vertex_parts: Int[Array, "vertices"]
    face_parts: Int[Array, "faces"]
    """-1 for faces that do not count."""
    seams: tuple[Int[Array, "_"], ...]
    """Vertices that each part shares with its parent; all of the root's own."""
    below: Bool[Array, "parts parts"]
    """Row: a part; columns: itself and what hangs on it."""
    means: Any
    """Sparse (parts x vertices): the centroid of each seam."""
    sums: Any
    """Sparse (parts x vertices): the sum over each part's vertices."""

    def joints(self, vertices: Float[Array, "vertices 3"]) -> Float[Array, "parts 3"]:
        """What each part turns about: its seam's centroid, the root about its own (metres)."""
        return self.means @ vertices

    def turned(
        self, vertices: Float[Array, "vertices 3"], turns: Float[Array, "parts 3"]
    ) -> tuple[Float[Array, "vertices 3"], Float[Array, "parts 3 3"]]:
        """The vertices after every part turned, with all below it, about its joint in the given pose (rotation vectors,
        radians, axes of the world), and what each part was turned by in all."""
        joints, own = self.joints(vertices), rot.to_matrix(rot.from_rotation_vector(turns))
        world, move = own.copy(), joints - np.einsum("pij,pj->pi", own, joints)
        for part, parent in enumerate(self.parents):
            if parent >= 0:
                world[part] = world[parent] @ own[part]
                move[part] = world[parent] @ move[part] + move[parent]
        return np.einsum("vij,vj->vi", world[self.vertex_parts], vertices) + move[self.vertex_parts], world

    def turn_gradient(
        self, vertices: Float[Array, "vertices 3"], gradient: Float[Array, "vertices 3"]
    ) -> Float[Array, "parts 3"]:
        """Derivative by the rotation vectors of `turned`, at no turn, of an energy whose derivative by the vertices is
        given: the moment, about each part's joint, of all that hangs on it."""
        forces, moments = self.sums @ gradient, self.sums @ np.cross(vertices, gradient)
        return self.below @ moments - np.cross(self.joints(vertices), self.below @ forces)


def part_tree(faces: Int[Array, "faces 3"], parts: BodyParts) -> PartTree:
    """The tree of a body's parts. Raises `RetargetError` for a surface without a pelvis, in several pieces, or whose faces
    are not oriented alike: volumes then mean nothing."""
    corners = parts.welded[faces]
    counted = parts.body_faces & (parts.face_parts >= 0)
    present = np.unique(parts.face_parts[counted])
    if not (parts.names.index(ROOT) == present).any():
        raise RetargetError(f"the body has no {ROOT}, which is the root of its parts; it has {_named(parts, present)}")
    if not is_oriented(corners[counted]):
        raise RetargetError("the faces are not oriented alike: neighbours run along their edge in the same direction")
    touching = np.zeros((len(parts.welded), len(parts.names)), dtype=bool)
    touching[corners[counted], parts.face_parts[counted, None]] = True
    order, above = _hung_by_longest_seams(corners[counted], parts.face_parts[counted], parts.names.index(ROOT))
    if len(order) < len(present):
        loose = np.setdiff1d(present, order)
        raise RetargetError(f"the body must be one connected surface; no seam leads to {_named(parts, loose)}")
    row = np.full(len(parts.names) + 1, -1)
    row[order] = np.arange(len(order))
    parents = row[above]
    vertex_parts = np.maximum(row[parts.vertex_parts], 0)  # what lies on no face of the body follows the root
    seams = [np.flatnonzero(touching[:, order[0]] & (vertex_parts == 0))]
    seams += [np.flatnonzero(touching[:, part] & touching[:, up]) for part, up in zip(order[1:], above[1:])]
    below = np.eye(len(order), dtype=bool)
    for part in range(len(order) - 1, 0, -1):
        below[parents[part]] |= below[part]
    face_parts = np.where(counted, row[parts.face_parts], -1)
    names = tuple(parts.names[part] for part in order)
    members = [np.flatnonzero(vertex_parts == part) for part in range(len(order))]
    means, sums = _rows(seams, len(vertex_parts), mean=True), _rows(members, len(vertex_parts), mean=False)
    return PartTree(names, parents, vertex_parts, face_parts, tuple(seams), below, means, sums)


def closed_parts(corners: Int[Array, "faces 3"], face_parts: Int[Array, "faces"], count: int, vertices: int) -> Solids:
    """Each part with triangles between its rims and their centroids (section 4.2.1). Faces of part -1 are left out."""
    triangles, owners, rims = [], [], []
    for part in range(count):
        skin = corners[face_parts == part]
        caps, own_rims = closing_fans(skin, vertices + len(rims))
        triangles += [skin, caps]
        owners.append(np.full(len(skin) + len(caps), part))
        rims += own_rims
    return Solids(count, np.concatenate(triangles), np.concatenate(owners), _rows(rims, vertices, mean=True))


def _rows(groups: Sequence[Int[Array, "_"]], vertices: int, mean: bool) -> Any:
    """Sparse (groups x vertices): the sum, or the mean, over each group."""
    from scipy.sparse import csr_matrix

    lengths = np.array([len(group) for group in groups], dtype=np.int64)
    weights = np.repeat(1.0 / np.maximum(lengths, 1) if mean else np.ones(len(lengths)), lengths)
    columns = np.concatenate([np.zeros(0, dtype=np.int64), *groups])
    return csr_matrix((weights, columns, np.cumsum([0, *lengths])), shape=(len(groups), vertices))


def _hung_by_longest_seams(
    corners: Int[Array, "faces 3"], face_parts: Int[Array, "faces"], root: int
) -> tuple[Int[Array, "parts"], Int[Array, "parts"]]:
    """Parts in an order in which parents come first, and the parent of each (-1): the tree whose seams have the most edges
    in all."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    edges = np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, edge, _ = unique_pairs(edges)
    own = np.repeat(face_parts, 3)
    order = np.argsort(edge, kind="stable")
    same = np.flatnonzero(np.diff(edge[order]) == 0)
    a, b = own[order[same]], own[order[same + 1]]
    seam, _, length = unique_pairs(np.sort(np.stack([a, b], axis=1)[a != b], axis=1))
    size = int(face_parts.max()) + 1
    tree = minimum_spanning_tree(coo_matrix((-length.astype(float), seam.T), shape=(size, size)))
    order, above = breadth_first_order(tree, root, directed=False)
    return order.astype(np.int64), np.maximum(above[order], -1).astype(np.int64)


def _named(parts: BodyParts, chosen: Int[Array, "_"]) -> str:
    return ", ".join(parts.names[part] for part in chosen) or "none"
