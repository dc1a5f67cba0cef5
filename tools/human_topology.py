"""From MakeHuman's closed quad skin (13,380 vertices) to a lighter closed triangle mesh, exactly mirror symmetric.

Only the left half (x >= 0 with the midline) is worked on; `unfold` mirrors it. A vertex of the result is an original
vertex, or a fixed convex combination of a few (welded lips, eye patches), so that every target carries over linearly.
"""

from __future__ import annotations

import heapq

import numpy as np
from human_source import BaseMesh
from scipy.spatial import Delaunay

MOUTH_START = 520  # midline vertex of the upper lip where the lips meet; its edge loop bounds the mouth's inside
EYE_START = 13352  # upper lid, the last edge loop in front of the left eyeball
IRIS, PUPIL = 0.0050, 0.0021  # radii in metres on the average adult


class Half:
    """The left half while it is worked on: triangles over rows of `combine` (rows: original vertex -> weight)."""

    def __init__(self, base: BaseMesh, shapes: np.ndarray) -> None:
        self.base = base
        self.on_mid = base.mirror == np.arange(len(base.mirror))
        self.combine: dict[int, dict[int, float]] = {}
        self.shapes = shapes  # (shapes, vertices, 3), grows with new vertices
        keep = (base.left | self.on_mid)[base.quads].all(axis=1)
        self.quads = base.quads[keep]
        self.mid = set(np.unique(self.quads)[self.on_mid[np.unique(self.quads)]].tolist())
        self.locked: set[int] = set()
        self.eye_faces: dict[str, list[tuple[int, int, int]]] = {}
        self.triangles: set[tuple[int, int, int]] = set()

    def add_vertex(self, weights: dict[int, float]) -> int:
        index = self.shapes.shape[1]
        rows = np.array(list(weights))
        value = np.einsum("svx,v->sx", self.shapes[:, rows], np.array(list(weights.values())))
        self.shapes = np.concatenate([self.shapes, value[:, None]], axis=1)
        self.combine[index] = weights
        return index

    def weights(self, vertex: int) -> dict[int, float]:
        return self.combine.get(vertex, {vertex: 1.0})


def edge_loop(quads: np.ndarray, start: int, toward: int) -> list[int]:
    """Vertices of the quad edge loop that leaves `start` for `toward`, until it closes or meets an irregular vertex."""
    around: dict[int, set[int]] = {}
    faces: dict[frozenset[int], list[int]] = {}
    for k, quad in enumerate(quads.tolist()):
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            around.setdefault(a, set()).add(b)
            around.setdefault(b, set()).add(a)
            faces.setdefault(frozenset((a, b)), []).append(k)
    loop = [start, toward]
    while loop[-1] != loop[0] and len(around[loop[-1]]) == 4:
        near = {v for k in faces[frozenset(loop[-2:])] for v in quads[k].tolist()}
        ahead = around[loop[-1]] - near
        if len(ahead) != 1:
            break
        loop.append(ahead.pop())
    return loop


def cut_inside(quads: np.ndarray, loop: list[int], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Splits the quads along a closed loop: (those on the far side of `seed`, those around `seed`)."""
    barrier = {frozenset(pair) for pair in zip(loop, loop[1:] + loop[:1], strict=True)}
    owners: dict[frozenset[int], list[int]] = {}
    for k, quad in enumerate(quads.tolist()):
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            owners.setdefault(frozenset((a, b)), []).append(k)
    inside = set(np.flatnonzero((quads == seed).any(axis=1)).tolist())
    front = list(inside)
    while front:
        quad = quads[front.pop()].tolist()
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            if frozenset((a, b)) not in barrier:
                for k in owners[frozenset((a, b))]:
                    if k not in inside:
                        inside.add(k)
                        front.append(k)
    mask = np.zeros(len(quads), bool)
    mask[list(inside)] = True
    return quads[~mask], quads[mask]


def weld_mouth(half: Half) -> None:
    """Removes the inside of the mouth and welds the upper to the lower lip along the line where they meet."""
    base = half.base
    sideways = [
        b for quad in base.quads.tolist() for a, b in zip(quad, quad[1:] + quad[:1], strict=True) if a == MOUTH_START
    ]
    toward = next(v for v in sideways if base.vertices[v, 0] > 1e-6)
    loop = edge_loop(base.quads, MOUTH_START, toward)[:-1]
    bottom = len(loop) // 2
    assert half.on_mid[loop[bottom]], "the mouth loop is not symmetric"
    depth = base.vertices[:, 2] + 1e3 * (np.arange(len(base.vertices)) >= 13380)
    mouth = base.joint("mouth", base.vertices)
    near = np.flatnonzero(half.on_mid & (np.linalg.norm(base.vertices - mouth, axis=1) < 0.03) & (depth < 100))
    seed = min(near, key=lambda v: np.linalg.norm(base.vertices[v] - mouth))
    outer, inner = cut_inside(base.quads, loop, int(seed))
    assert len(inner) < len(outer)
    gone = {tuple(quad) for quad in inner.tolist()}
    half.quads = np.array([quad for quad in half.quads.tolist() if tuple(quad) not in gone])
    half.mid = {v for v in half.mid if (half.quads == v).any()}
    for upper, lower in zip(loop[: bottom // 2 + 1], loop[bottom : bottom // 2 : -1], strict=False):
        joined = half.add_vertex({upper: 0.5, lower: 0.5})
        half.quads[np.isin(half.quads, (upper, lower))] = joined
        if upper in half.mid:
            half.mid = (half.mid - {upper, lower}) | {joined}


def fill_eye(half: Half) -> None:
    """Replaces the eye socket by a patch that lies on the eyeball, with triangles named sclera, iris and pupil."""
    base, average = half.base, half.shapes[0]
    ball_faces = base.helper_quads["helper-l-eye"]
    ball_faces = np.concatenate([ball_faces[:, [0, 1, 2]], ball_faces[:, [0, 2, 3]]])
    centre = average[np.unique(ball_faces)].mean(axis=0)
    toward = next(
        b for quad in half.quads.tolist() for a, b in zip(quad, quad[1:] + quad[:1], strict=True)
        if a == EYE_START and abs(average[b, 1] - average[a, 1]) < abs(average[b, 0] - average[a, 0])
    )  # fmt: skip
    loop = edge_loop(half.quads, EYE_START, toward)[:-1]
    distance = np.linalg.norm(average[:13380] - (centre - [0, 0, 0.012]), axis=1)
    half.quads, _ = cut_inside(half.quads, loop, int(distance.argmin()))
    rim = average[loop][:, :2]
    points = _eye_points(rim, centre[:2])
    new = [half.add_vertex(_on_surface(average, ball_faces, point)) for point in points]
    everything, ids = np.concatenate([rim, points]), loop + new
    for simplex in Delaunay(everything).simplices:
        corners = everything[simplex]
        if not _inside(rim, corners.mean(axis=0)[None])[0]:
            continue
        (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
        face = tuple(ids[i] for i in (simplex if ax * by - ay * bx > 0 else simplex[::-1]))
        radius = np.linalg.norm(corners.mean(axis=0) - centre[:2])
        kind = "pupil" if radius < PUPIL else "iris" if radius < IRIS else "sclera"
        half.eye_faces.setdefault(kind, []).append(face)
        half.triangles.add(face)
    half.locked |= set(ids)


def _eye_points(rim: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Points of the patch: centre, pupil and iris circles, two in the white; those too near the lids are left out."""
    points = [centre]
    for radius, count in ((PUPIL, 6), (IRIS, 12)):
        angle = np.arange(count) * 2 * np.pi / count
        points += list(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    middle = rim[:, 1].mean()
    points += [np.array([centre[0] + side * 1.6 * IRIS, middle]) for side in (-1, 1)]
    points = np.array(points)
    gap = np.linalg.norm(points[:, None] - rim[None], axis=2).min(axis=1)
    return points[_inside(rim, points) & (gap > 0.0009)]


def _inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Even-odd rule."""
    a, b = polygon[None], np.roll(polygon, -1, axis=0)[None]
    x, y = points[:, None, 0], points[:, None, 1]
    crosses = (a[..., 1] > y) != (b[..., 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[..., 0] + (y - a[..., 1]) / (b[..., 1] - a[..., 1]) * (b[..., 0] - a[..., 0])
    return (crosses & (x < at)).sum(axis=1) % 2 == 1


def _on_surface(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray) -> dict[int, float]:
    """Barycentric weights of the frontmost surface point above a point of the x-y plane."""
    best: tuple[float, dict[int, float]] = (-np.inf, {})
    for face in faces:
        corners = vertices[face]
        matrix = np.vstack([corners[:, :2].T, np.ones(3)])
        if abs(np.linalg.det(matrix)) < 1e-14:
            continue
        weights = np.linalg.solve(matrix, np.append(point, 1.0))
        if weights.min() > -1e-6 and weights @ corners[:, 2] > best[0]:
            weights = np.clip(weights, 0, None) / np.clip(weights, 0, None).sum()
            best = (float(weights @ corners[:, 2]), {int(v): float(w) for v, w in zip(face, weights, strict=True) if w})
    assert best[1], "the eyeball does not reach below the eye's opening"
    return best[1]


def triangulate(half: Half) -> None:
    """Splits every quad along its shorter diagonal (on the average shape); welded corners leave a triangle."""
    for quad in half.quads.tolist():
        corners = [v for i, v in enumerate(quad) if v != quad[i - 1]]
        if len(corners) == 3:
            half.triangles.add(tuple(corners))
        elif len(corners) == 4:
            a, b, c, d = half.shapes[0][corners]
            i = 0 if np.linalg.norm(a - c) <= np.linalg.norm(b - d) else 1
            corners = corners[i:] + corners[:i]
            half.triangles |= {(corners[0], corners[1], corners[2]), (corners[0], corners[2], corners[3])}


class Decimation:
    """Half-edge collapses by quadric error summed over several body shapes, within a vertex budget a region.

    A collapse is refused where it would break the manifold, flip a triangle or make a sliver in any of the shapes, or
    touch a locked vertex. Midline vertices only merge along the midline, others never into it.
    """

    def __init__(self, half: Half, region: dict[int, str], budget: dict[str, int]) -> None:
        self.half, self.region, self.budget = half, region, budget
        self.faces = {i: face for i, face in enumerate(sorted(half.triangles))}
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
        ring = self.neighbours(v)
        for f in sorted(self.around[v]):
            face = self.faces[f]
            if u in face:
                del self.faces[f]
                for w in face:
                    self.around[w].discard(f)
            else:
                self.faces[f] = tuple(u if w == v else w for w in face)
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


def flip_edges(half: Half, faces: list[tuple[int, int, int]], fixed: set[tuple[int, int, int]], sweeps: int = 8) -> list:
    """Swaps diagonals where that makes the worse of two triangles rounder on all shapes and bends the surface no more."""
    faces = [tuple(face) for face in faces]
    points = half.shapes
    for _ in range(sweeps):
        owner = {(face[i], face[(i + 1) % 3]): k for k, face in enumerate(faces) for i in range(3)}
        changed: set[int] = set()
        for (a, b), k in sorted(owner.items()):
            m = owner.get((b, a))
            if a > b or m is None or k in changed or m in changed or faces[k] in fixed or faces[m] in fixed:
                continue
            c = next(v for v in faces[k] if v not in (a, b))
            d = next(v for v in faces[m] if v not in (a, b))
            if (c, d) in owner or (d, c) in owner or (c in half.mid and d in half.mid):
                continue
            old, new = points[:, [(a, b, c), (b, a, d)]], points[:, [(a, d, c), (d, b, c)]]
            gain = _quality(new).min(axis=1).mean() - _quality(old).min(axis=1).mean()
            if gain > 0.02 and _bend(new).min() > min(0.8, _bend(old).min()) and _agrees(old, new):
                faces[k], faces[m] = (a, d, c), (d, b, c)
                changed |= {k, m}
        if not changed:
            break
    return faces


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


def unfold(half: Half, faces: list[tuple[int, int, int]]) -> tuple[list[dict[int, float]], np.ndarray, np.ndarray, dict]:
    """The whole body: (rows of the combination matrix, faces, mirror map, index of each half vertex).

    Vertices come left, middle, right; `mirror[i] = i + left + middle` for the left ones.
    """
    used = sorted({v for face in faces for v in face})
    left, middle = [v for v in used if v not in half.mid], [v for v in used if v in half.mid]
    index = {v: i for i, v in enumerate(left + middle)}
    offset = len(left) + len(middle)
    rows = [half.weights(v) for v in left + middle]
    rows += [{int(half.base.mirror[o]): w for o, w in half.weights(v).items()} for v in left]
    mirror = np.concatenate([np.arange(len(left)) + offset, np.arange(len(left), offset), np.arange(len(left))])
    ours = np.array([[index[v] for v in face] for face in faces])
    return rows, np.concatenate([ours, mirror[ours][:, ::-1]]), mirror, index
