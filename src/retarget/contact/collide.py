"""Where a posed body penetrates itself: signed distances of its vertices to its other parts.

Every part of the body is closed by fans over its seams (Basset 2019, section 4.2.1) and tested as a solid of its own. A
vertex is inside a solid if a ray from it crosses it an odd number of times; its depth is the distance to the solid's skin,
the fans left out, because what matters is the way out. Both are exact; boxes over the faces, refitted to each pose, and a
grid over their shadows make them fast. The spike that led here stands in `docs/collision.md`.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body.skinning import rest_vertices
from retarget.character import Character
from retarget.contact.parts import PARTS, BodyParts, body_height, body_parts
from retarget.contact.threads import THREADS, cores, shared_out
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError
from retarget.geometry.distance import edge_graph, within
from retarget.geometry.topology import closing_fans

Array = np.ndarray
log = logging.getLogger("retarget")

NEIGHBOURHOOD = 0.08
"""Share of the body's height: what lies closer to a part along the skin at rest is not tested against it, because skin
folds at every joint. Ours."""
BRIDGE = 0.02
"""Share of the body's height: pieces of a body that come this close where their parts meet in a joint count as one skin
there. Ours."""
LEAF = 4
"""Faces in a leaf of the box hierarchy."""
FARTHEST = 1e100
"""Metres; the squares of coordinates up to here are finite."""

_ADJACENT = frozenset(
    frozenset(pair)
    for pair in (
        ("head", "neck"), ("head", "chest"), ("neck", "chest"), ("chest", "abdomen"), ("chest", "pelvis"),
        ("abdomen", "pelvis"),
        *((f"{side}{a}", f"{side}{b}") for side in ("left", "right")
          for a, b in (("UpperArm", "Forearm"), ("Forearm", "Hand"), ("Thigh", "Shin"), ("Shin", "Foot"))),
        *((trunk, f"{side}{limb}") for side in ("left", "right")
          for trunk, limb in (("chest", "UpperArm"), ("pelvis", "Thigh"), ("abdomen", "Thigh"))),
    )
)  # fmt: skip
"""Parts that meet in a joint: where pieces of a body may hang together without sharing vertices."""


@dataclass(frozen=True, eq=False)
class SurfacePairs:
    """Vertices of a posed body beside, or inside, parts they do not belong to. One row a vertex and solid."""

    vertex: Int[Array, "pairs"]
    part: Int[Array, "pairs"]
    """Index into `PARTS` of the other part."""
    distance: Float[Array, "pairs"]
    """Signed, metres: negative inside."""
    point: Float[Array, "pairs 3"]
    """Nearest point of the other part's skin, metres."""
    normal: Float[Array, "pairs 3"]
    """Gradient of the signed distance by the vertex's place: unit, leads out of the part."""
    face: Int[Array, "pairs"]
    """Face of the mesh that the nearest point lies on."""
    barycentric: Float[Array, "pairs 3"]
    """The nearest point in that face."""


@dataclass(frozen=True, eq=False)
class Collider:
    """A body prepared for collision tests; `prepare_collider` makes one."""

    parts: BodyParts
    solid_parts: Int[Array, "solids"]
    """Part that each solid is (a piece of) ."""
    excluded: Bool[Array, "vertices solids"]
    """Pairs that are never tested: a vertex and its own part, what is near along the skin at rest, what overlaps there."""
    blocks: Blocks
    """Vertices that are tested: one of each place, of body pieces."""
    shares: tuple[Blocks, ...]
    """The same, dealt out to `THREADS` threads."""
    corners: Int[Array, "triangles 3"]
    """All solids' triangles, one solid after the other, skin first and then closing fans; vertices first and then rims."""
    mesh_faces: Int[Array, "triangles"]
    """The mesh's face that each skin triangle is, -1 for fans."""
    starts: Int[Array, "_"]
    """First triangle of each solid, and the end."""
    rims: Int[Array, "_"]
    """Vertices of each rim, one rim after the other; a rim's centroid closes it."""
    rim_starts: Int[Array, "_"]
    """First place of each rim, and the end."""
    tree: BoxTree

    def pairs(self, vertices: Float[Array, "vertices 3"], reach: float = 0.0) -> SurfacePairs:
        """All pairs of a posed body (metres) that penetrate, and those within `reach` metres outside. Rows come by vertex
        and solid; the vertex is the first at its place. Raises `RetargetError` for vertices that are not this body's or
        not finite."""
        posed = self._posed(vertices)
        # Every other block for each thread: parts that touch are spread over both.
        shares = self.shares if cores() > 1 else (self.blocks,)
        found = shared_out(lambda share: self._search(posed, share, reach), shares)
        return self._rows(posed[0], [np.concatenate(column) for column in zip(*found)])

    def depths(self, vertices: Float[Array, "frames vertices 3"]) -> Float[Array, "frames vertices"]:
        """How deep each vertex is in other parts (metres, 0 outside), over many frames; the deepest part counts. Vertices
        that lie on one place at rest have one depth; vertices that are no body have 0. Raises as `pairs`."""

        def of_frame(frame: int) -> Array:
            vertex, *_, distance = self._search(self._posed(vertices[frame]), self.blocks, 0.0)
            depth = np.zeros(vertices.shape[1])
            np.maximum.at(depth, vertex, -distance)
            return depth[self.parts.welded]

        return np.array(shared_out(of_frame, range(len(vertices)))).reshape(vertices.shape[:2])

    def without(self, vertices: Int[Array, "_"], part: Int[Array, "_"]) -> Collider:
        """The same collider that never tests these pairs of vertex and part either."""
        excluded = self.excluded.copy()
        for solid in range(len(self.solid_parts)):
            excluded[vertices[part == self.solid_parts[solid]], solid] = True
        return _with_exclusions(self, excluded)

    def only(self, vertices: Int[Array, "_"]) -> Collider:
        """The same collider that tests these vertices alone, of those it tests."""
        chosen = self.blocks.vertices[np.isin(self.blocks.vertices, vertices)]
        return _with_exclusions(replace(self, blocks=replace(self.blocks, vertices=chosen)), self.excluded)

    def points(self, vertices: Float[Array, "vertices 3"]) -> Float[Array, "points 3"]:
        """What `corners` index: the posed vertices, then the centres of the rims."""
        return self._posed(vertices)[0]

    def _posed(self, vertices: Float[Array, "vertices 3"]) -> tuple[Array, Array, Array]:
        """Vertices and rim centres, and the boxes over them."""
        from retarget.contact import kernels

        if vertices.shape != (len(self.excluded), 3):
            raise RetargetError(f"the body has {len(self.excluded)} vertices, received an array of {vertices.shape}")
        if not float(np.abs(vertices).max()) < FARTHEST:
            raise RetargetError("a posed vertex lies nowhere (a coordinate is not finite, or beyond all measure)")
        _announce()
        rims, tree = self.rim_starts, self.tree
        points = np.empty((len(vertices) + len(rims) - 1, 3))
        points[: len(vertices)] = vertices
        kernels.rim_centres(points, self.rims, rims, len(vertices))
        low, high = np.empty((2, len(tree.lefts), 3))
        kernels.refit(points, self.corners, tree.lefts, tree.firsts, tree.counts, low, high)
        return points, low, high

    def _search(self, posed: tuple[Array, Array, Array], blocks: Blocks, reach: float) -> tuple[Array, ...]:
        """Columns vertex, solid, triangle, its second and third barycentric coordinate, signed distance."""
        from retarget.contact import kernels

        points, low, high = posed
        tree, room = self.tree, 2 * len(blocks.vertices) + 64
        while True:
            found = [np.empty(room, dtype=np.int32) for _ in range(3)] + [np.empty(room) for _ in range(3)]
            count = kernels.near_pairs(
                points, blocks.vertices, self.excluded, blocks.excluded, self.corners, self.starts, tree.skin_stops,
                tree.roots, tree.lefts, tree.firsts, tree.counts, low, high, float(reach), *found,
            )  # fmt: skip
            if count <= room:
                return tuple(column[:count] for column in found)
            room = count

    def _rows(self, points: Array, found: list[Array]) -> SurfacePairs:
        from retarget.contact import kernels

        order = np.lexsort((found[1], found[0]))
        vertex, solid, triangle, v, w, distance = (column[order] for column in found)
        barycentric, nearest, normal = np.empty((3, len(vertex), 3))
        kernels.nearest_points(points, self.corners, vertex, triangle, v, w, distance, barycentric, nearest, normal)
        return SurfacePairs(
            vertex.astype(np.int64), self.solid_parts[solid], distance, nearest, normal, self.mesh_faces[triangle],
            barycentric,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Blocks:
    """Tested vertices in blocks of neighbours, `kernels.BLOCK` each (the last may be shorter)."""

    vertices: Int[Array, "_"]
    excluded: Bool[Array, "blocks solids"]
    """Blocks whose vertices are all excluded from a solid."""

    def share(self, number: int, of: int, size: int) -> Blocks:
        """Every `of`-th block of `size` vertices: parts that touch are spread over all shares."""
        starts = range(number * size, len(self.vertices), of * size)
        chosen = [self.vertices[start : start + size] for start in starts]
        return Blocks(np.concatenate([self.vertices[:0], *chosen]), np.ascontiguousarray(self.excluded[number::of]))


@dataclass(frozen=True, eq=False)
class BoxTree:
    """Boxes over the skin triangles of every solid, parents before children; the right child follows the left."""

    roots: Int[Array, "solids"]
    skin_stops: Int[Array, "solids"]
    """End of each solid's skin triangles; its fans follow."""
    lefts: Int[Array, "nodes"]
    """Left child, -1 for leaves."""
    firsts: Int[Array, "nodes"]
    counts: Int[Array, "nodes"]


@lru_cache(maxsize=8)
def prepare_collider(character: Character, humanoid: Humanoid, parts: BodyParts | None = None) -> Collider:
    """Solids, exclusions and search structures of a character, kept for the last few. Raises `RetargetError` for one
    without a surface."""
    parts = body_parts(character, humanoid) if parts is None else parts
    rest = rest_vertices(character)
    return part_collider(rest, character.mesh.faces, parts, body_height(rest, parts, humanoid))


def part_collider(
    rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], parts: BodyParts, height: float,
    neighbourhood: float = NEIGHBOURHOOD,
) -> Collider:  # fmt: skip
    """The same of a bare surface whose parts are known; lengths in metres, `neighbourhood` a share of `height`."""
    corners_of_mesh = parts.welded[faces]
    groups = _solid_faces(parts)
    triangles, mesh_faces, starts, stops, rims = [], [], [0], [], []
    roots, lefts, firsts, counts = [], [], [], []
    for _, own in groups:
        order, nodes = _boxes(rest[corners_of_mesh[own]].mean(axis=1))
        skin = corners_of_mesh[own[order]]
        caps, own_rims = closing_fans(skin, len(rest) + len(rims))
        shift = starts[-1]
        roots.append(len(lefts))
        lefts += [left + roots[-1] if left >= 0 else -1 for left, _, _ in nodes]
        firsts += [first + shift for _, first, _ in nodes]
        counts += [count for _, _, count in nodes]
        triangles += [skin, caps]
        mesh_faces += [own[order], np.full(len(caps), -1)]
        rims += own_rims
        stops.append(shift + len(skin))
        starts.append(shift + len(skin) + len(caps))
    integers = [np.array(column, dtype=np.int32) for column in (roots, stops, lefts, firsts, counts)]
    tested = _neighbours_together(np.unique(corners_of_mesh[parts.body_faces]), rest, parts)
    excluded = np.zeros((len(rest), len(groups)), dtype=bool)
    collider = Collider(
        parts,
        np.array([part for part, _ in groups], dtype=np.int64),
        excluded,
        Blocks(tested, excluded[:0]),
        (),
        np.concatenate(triangles).astype(np.int32) if triangles else np.zeros((0, 3), dtype=np.int32),
        np.concatenate(mesh_faces) if mesh_faces else np.zeros(0, dtype=np.int64),
        np.array(starts),
        np.concatenate([np.zeros(0, dtype=np.int64), *rims]),
        np.cumsum([0, *map(len, rims)]),
        BoxTree(*integers),
    )
    excluded = _near_at_rest(collider, rest, corners_of_mesh, groups, height, neighbourhood * height)
    return _without_overlaps_at_rest(_with_exclusions(collider, excluded), rest)


def _solid_faces(parts: BodyParts) -> list[tuple[int, Int[Array, "_"]]]:
    """(part, faces) of every solid: each body piece's share of each part."""
    groups = []
    for piece, kind in enumerate(parts.piece_kinds):
        if kind == "body":
            own = np.flatnonzero(parts.face_pieces == piece)
            groups += [(int(part), own[parts.face_parts[own] == part]) for part in np.unique(parts.face_parts[own])]
    return groups


def _boxes(centres: Float[Array, "faces 3"]) -> tuple[Int[Array, "faces"], list[tuple[int, int, int]]]:
    """Order of the faces and nodes (left, first, count) of a hierarchy of halves along the longest side."""
    order = np.arange(len(centres))
    nodes = [(-1, 0, len(centres))]
    waiting = [0]
    while waiting:
        node = waiting.pop()
        _, first, count = nodes[node]
        if count <= LEAF:
            continue
        own = order[first : first + count]
        axis = int(np.ptp(centres[own], axis=0).argmax())
        half = count // 2
        order[first : first + count] = own[np.argpartition(centres[own, axis], half)]
        nodes[node] = (len(nodes), first, count)
        waiting += [len(nodes), len(nodes) + 1]
        nodes += [(-1, first, half), (-1, first + half, count - half)]
    return order, nodes


def _near_at_rest(
    collider: Collider, rest: Array, corners: Array, groups: Sequence[tuple[int, Array]], height: float, reach: float
) -> Bool[Array, "vertices solids"]:
    """A vertex and its own part, and what lies within `reach` of it along the skin."""
    graph = edge_graph(rest, corners, *_bridges(collider, rest, corners, groups, BRIDGE * height))
    excluded = np.zeros((len(rest), len(groups)), dtype=bool)
    for solid, (part, faces) in enumerate(groups):
        near = within(graph, np.unique(corners[faces]), reach)
        excluded[:, solid] = near | (collider.parts.vertex_parts == part)
    return excluded


def _bridges(
    collider: Collider, rest: Array, corners: Array, groups: Sequence[tuple[int, Array]], reach: float
) -> tuple[Int[Array, "bridges 2"], Float[Array, "bridges"]]:
    """Ways from piece to piece of a body, as pairs of vertices with their lengths: where parts meet in a joint (an arm
    stuck into the trunk, a ball between two bones), from each vertex that is inside or close to the skin."""
    parts = collider.parts
    pieces = np.array([int(parts.face_pieces[faces[0]]) for _, faces in groups])
    if len(np.unique(pieces)) < 2:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    counting = parts.face_pieces >= 0
    own_piece = np.full(len(rest), -1)
    own_piece[corners[counting]] = parts.face_pieces[counting, None]
    jointed = np.eye(len(PARTS), dtype=bool)
    for a, b in map(tuple, _ADJACENT):
        jointed[PARTS.index(a), PARTS.index(b)] = jointed[PARTS.index(b), PARTS.index(a)] = True
    apart = (own_piece[:, None] == pieces) | ~jointed[parts.vertex_parts][:, collider.solid_parts]
    found = _with_exclusions(collider, apart).pairs(rest, reach)
    ends = corners[found.face]
    lengths = np.linalg.norm(rest[ends] - found.point[:, None], axis=2) + np.maximum(found.distance, 0.0)[:, None]
    return np.stack([np.repeat(found.vertex, 3), ends.ravel()], axis=1), lengths.ravel()


def _without_overlaps_at_rest(collider: Collider, rest: Float[Array, "vertices 3"]) -> Collider:
    """What overlaps at rest was built so (a hand in a sleeve, a belt): those pairs are left out."""
    vertex, solid, *_ = collider._search(collider._posed(rest), collider.blocks, 0.0)
    excluded = collider.excluded.copy()
    excluded[vertex, solid] = True
    return _with_exclusions(collider, excluded)


def _with_exclusions(collider: Collider, excluded: Bool[Array, "vertices solids"]) -> Collider:
    """The collider with these exclusions, its blocks told which of them are excluded as a whole."""
    from retarget.contact import kernels

    vertices = collider.blocks.vertices
    starts = np.arange(0, len(vertices), kernels.BLOCK)
    alike = np.logical_and.reduceat(excluded[vertices], starts, axis=0) if len(vertices) else excluded[:0]
    blocks = Blocks(vertices, alike)
    shares = tuple(blocks.share(number, THREADS, kernels.BLOCK) for number in range(THREADS))
    return replace(collider, excluded=excluded, blocks=blocks, shares=shares)


def _neighbours_together(tested: Int[Array, "_"], rest: Array, parts: BodyParts) -> Int[Array, "_"]:
    """The tested vertices part by part, and neighbours beside each other."""
    part = parts.vertex_parts[tested]
    groups = [tested[part == each] for each in np.unique(part)]
    return np.concatenate([tested[:0], *(own[_boxes(rest[own])[0]] for own in groups)])


def compile_kernels() -> None:
    """Compile the kernels and keep them on disk, so that no first user waits. Set-up calls this."""
    from retarget.contact import kernels

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
    tree = BoxTree(*(np.array(column, dtype=np.int32) for column in ([0], [4], [-1], [0], [4])))
    parts = BodyParts(PARTS, np.zeros(4, int), np.zeros(4, int), np.arange(4), np.zeros(4, int), ("body",), triangles)
    blocks = Blocks(np.arange(4), np.zeros((1, 1), dtype=bool))
    Collider(
        parts, np.zeros(1, int), np.zeros((4, 1), dtype=bool), blocks, (blocks,), triangles, np.arange(4),
        np.array([0, 4]), np.zeros(0, int), np.array([0]), tree,
    ).pairs(corners, 0.1)  # fmt: skip
    assert kernels.compiled()


_announced = False


def _announce() -> None:
    """Say so when the kernels are about to be compiled."""
    global _announced
    if not _announced:
        _announced = True
        from retarget.contact import kernels

        if not kernels.compiled():
            log.warning("compiling the collision kernels (once, about ten seconds)")
