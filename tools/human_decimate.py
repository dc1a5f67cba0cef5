"""Fewer triangles of good shape: half-edge collapses and diagonal swaps that hold on several bodies at once."""

from __future__ import annotations

import heapq

import numpy as np
from human_topology import Face, Half, cycle


class Decimation:
    """Half-edge collapses by quadric error summed over several body shapes, within a vertex budget a region.

    A collapse is refused where it would break the manifold, flip a triangle or make a sliver in any of the shapes, or
    touch a locked vertex. Midline vertices only merge along the midline, others never into it.
    """

    def __init__(self, half: Half, region: dict[int, str], budget: dict[str, int]) -> None:
        self.half, self.region, self.budget = half, region, budget
        self.faces = dict(enumerate(sorted(half.triangles)))
        self.uvs = {i: half.triangles[face] for i, face in self.faces.items()}
        self.around: dict[int, set[int]] = {}
        for i, face in self.faces.items():
            for v in face:
                self.around.setdefault(v, set()).add(i)
        self.count: dict[str, int] = {}
        for v in self.around:
            self.count[region[v]] = self.count.get(region[v], 0) + 1
        self.points = half.shapes
        self.quadric = {v: self._quadric(v) for v in self.around}
        self.version = dict.fromkeys(self.around, 0)
        self.heap: list[tuple[float, int, int, int]] = []

    def _quadric(self, v: int) -> np.ndarray:
        """Area-weighted plane quadrics (shapes, 4, 4) of the faces at a vertex, each shape scaled to the same size."""
        corners = self.points[:, [self.faces[f] for f in sorted(self.around[v])]]  # shapes faces 3 3
        normal = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        area = np.linalg.norm(normal, axis=-1, keepdims=True)
        unit = normal / np.maximum(area, 1e-15)
        plane = np.concatenate([unit, -(unit * corners[:, :, 0]).sum(-1, keepdims=True)], axis=-1)
        return np.einsum("sf,sfi,sfj->sij", area[..., 0], plane, plane)

    def neighbours(self, v: int) -> set[int]:
        return {u for f in self.around[v] for u in self.faces[f]} - {v}

    def cost(self, v: int, u: int) -> float:
        """Error of moving v onto u: quadric distance plus a share of the edge length, which evens out the spacing."""
        target = np.concatenate([self.points[:, u], np.ones((len(self.points), 1))], axis=1)
        quadric = self.quadric[v]
        error = np.einsum("si,sij,sj->", target, quadric, target)
        area = np.einsum("sii->", quadric[:, :3, :3])
        length = ((self.points[:, u] - self.points[:, v]) ** 2).sum(-1).mean()
        return float(error + 0.01 * area * length)

    def allowed(self, v: int, u: int) -> bool:
        half = self.half
        if v in half.locked or (v in half.mid) != (u in half.mid):
            return False
        shared = self.around[v] & self.around[u]
        common = self.neighbours(v) & self.neighbours(u)
        if len(common) != len(shared) or len(shared) != (1 if v in half.mid else 2):
            return False
        if self.carried_uvs(v, u) is None:
            return False
        stays = [self.faces[f] for f in sorted(self.around[v] - shared)]
        if not stays or any(len(self.around[w]) <= 3 + -(w in half.mid) for w in common):
            return False
        if len(self.neighbours(u)) + len(self.neighbours(v)) - len(common) - 2 > 9:
            return False
        old = self.points[:, stays]
        new = self.points[:, [tuple(u if w == v else w for w in face) for face in stays]]
        old_normal = np.cross(old[:, :, 1] - old[:, :, 0], old[:, :, 2] - old[:, :, 0])
        new_normal = np.cross(new[:, :, 1] - new[:, :, 0], new[:, :, 2] - new[:, :, 0])
        size = np.linalg.norm(old_normal, axis=-1) * np.linalg.norm(new_normal, axis=-1)
        if ((old_normal * new_normal).sum(-1) < 0.35 * size).any():
            return False
        return bool(_quality(new).min() > min(0.25, 0.9 * _quality(old).min()))

    def carried_uvs(self, v: int, u: int) -> dict[int, int] | None:
        """Texture corner of u that takes the place of each one of v, or None where the chart would tear."""
        shared = self.around[v] & self.around[u]
        place: dict[int, int] = {}
        for f in shared:
            at_v, at_u = self.uvs[f][self.faces[f].index(v)], self.uvs[f][self.faces[f].index(u)]
            if place.setdefault(at_v, at_u) != at_u:
                return None
        whole = all(self.uvs[f][self.faces[f].index(v)] in place for f in self.around[v] - shared)
        return place if whole else None

    def push(self, v: int) -> None:
        self.version[v] += 1
        if v in self.half.locked or self.count[self.region[v]] <= self.budget.get(self.region[v], 0):
            return
        for cost, u in sorted((self.cost(v, u), u) for u in self.neighbours(v)):
            if self.allowed(v, u):
                heapq.heappush(self.heap, (cost, v, u, self.version[v]))
                return

    def run(self) -> None:
        for v in sorted(self.around):
            self.push(v)
        while self.heap:
            _, v, u, version = heapq.heappop(self.heap)
            if v not in self.around or version != self.version[v]:
                continue
            if self.count[self.region[v]] <= self.budget.get(self.region[v], 0):
                continue
            if u not in self.around or not self.allowed(v, u):
                self.push(v)
                continue
            self.collapse(v, u)

    def collapse(self, v: int, u: int) -> None:
        ring, place = self.neighbours(v), self.carried_uvs(v, u)
        for f in sorted(self.around[v]):
            face = self.faces[f]
            if u in face:
                del self.faces[f], self.uvs[f]
                for w in face:
                    self.around[w].discard(f)
            else:
                self.faces[f] = tuple(u if w == v else w for w in face)
                self.uvs[f] = tuple(place[c] if w == v else c for w, c in zip(face, self.uvs[f], strict=True))
                self.around[u].add(f)
        del self.around[v]
        self.count[self.region[v]] -= 1
        self.quadric[u] = self.quadric[u] + self.quadric[v]
        for w in sorted(ring | self.neighbours(u)):
            self.push(w)


def _quality(corners: np.ndarray) -> np.ndarray:
    """1 for an equilateral triangle, 0 for a sliver: 4 sqrt(3) area / sum of squared edges."""
    edges = np.roll(corners, -1, axis=-2) - corners
    area = 0.5 * np.linalg.norm(np.cross(edges[..., 0, :], edges[..., 1, :]), axis=-1)
    return 4 * np.sqrt(3) * area / np.maximum((edges**2).sum(axis=(-1, -2)), 1e-15)


def flip_edges(half: Half, triangles: dict[Face, Face], fixed: set[Face], sweeps: int = 8) -> dict[Face, Face]:
    """Swaps diagonals where that makes the worse of two triangles rounder on all shapes and bends the surface no more.

    `triangles` maps vertices to texture corners, as does the result; faces in `fixed` and texture seams stay.
    """
    faces, uvs, points = list(triangles), list(triangles.values()), half.shapes
    for _ in range(sweeps):
        owner = {edge: k for k, face in enumerate(faces) for edge in cycle(list(face))}
        changed: set[int] = set()
        for (a, b), k in sorted(owner.items()):
            m = owner.get((b, a))
            if a > b or m is None or k in changed or m in changed or faces[k] in fixed or faces[m] in fixed:
                continue
            here, there = dict(zip(faces[k], uvs[k], strict=True)), dict(zip(faces[m], uvs[m], strict=True))
            (c,), (d,) = set(here) - {a, b}, set(there) - {a, b}
            seam = here[a] != there[a] or here[b] != there[b]
            if seam or (c, d) in owner or (d, c) in owner or (c in half.mid and d in half.mid):
                continue
            old, new = points[:, [(a, b, c), (b, a, d)]], points[:, [(a, d, c), (d, b, c)]]
            gain = _quality(new).min(axis=1).mean() - _quality(old).min(axis=1).mean()
            if gain > 0.02 and _bend(new).min() > min(0.8, _bend(old).min()) and _agrees(old, new):
                corner = here | there
                faces[k], faces[m] = (a, d, c), (d, b, c)
                uvs[k], uvs[m] = (tuple(corner[v] for v in face) for face in (faces[k], faces[m]))
                changed |= {k, m}
        if not changed:
            break
    return dict(zip(faces, uvs, strict=True))


def _normals(corners: np.ndarray) -> np.ndarray:
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)


def _bend(pair: np.ndarray) -> np.ndarray:
    """Cosine between the two triangles of an edge (shapes,)."""
    normal = _normals(pair)
    return (normal[:, 0] * normal[:, 1]).sum(-1)


def _agrees(old: np.ndarray, new: np.ndarray) -> bool:
    """Both new triangles face the same way as the old pair, in every shape."""
    mean = _normals(old).sum(axis=1, keepdims=True)
    return bool(((_normals(new) * mean).sum(-1) > 0.5).all())
