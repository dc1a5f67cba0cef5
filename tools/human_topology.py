"""From MakeHuman's closed quad skin (13,380 vertices) to a lighter closed triangle mesh, exactly mirror symmetric.

Only the left half (x >= 0 with the midline) is worked on; `unfold` mirrors it. A vertex of the result is an original
vertex, or a fixed convex combination of a few (welded lips, eye patches), so that every target carries over linearly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from human_source import BODY_VERTICES, BaseMesh
from scipy.spatial import Delaunay

Face = tuple[int, int, int]

MOUTH_START = 520  # midline vertex of the upper lip where the lips meet; its edge loop bounds the mouth's inside
EYE_START = 13352  # upper lid, the last edge loop in front of the left eyeball
IRIS, PUPIL = 0.0050, 0.0021  # radii in metres on the average adult
EYE_UV = np.array([[0.12, 0.59], [0.045, 0.59]])  # centres of the left and right eye, where the sockets had been
EYE_UV_WIDTH = 0.055


class Half:
    """The left half while it is worked on: faces over original and new vertices, with a texture corner each."""

    def __init__(self, base: BaseMesh, shapes: np.ndarray) -> None:
        self.base = base
        self.on_mid = base.mirror == np.arange(len(base.mirror))
        self.combine: dict[int, dict[int, float]] = {}  # new vertex -> weights of original ones
        self.shapes = shapes  # (shapes, vertices, 3), the average body first; grows with new vertices
        self.uvs = base.uvs.tolist()
        self.mirrored_uv = mirrored_corners(base)
        self.rows = np.flatnonzero((base.left | self.on_mid)[base.quads].all(axis=1))  # of the base's quads
        self.quads, self.quad_uvs = base.quads[self.rows], base.quad_uvs[self.rows]
        self.mid = set(self.quads[self.on_mid[self.quads]].tolist())
        self.locked: set[int] = set()
        self.eye_faces: dict[str, list[Face]] = {}
        self.triangles: dict[Face, Face] = {}  # vertices -> texture corners

    def add_vertex(self, weights: dict[int, float]) -> int:
        index = self.shapes.shape[1]
        value = np.einsum("svx,v->sx", self.shapes[:, list(weights)], list(weights.values()))
        self.shapes = np.concatenate([self.shapes, value[:, None]], axis=1)
        self.combine[index] = weights
        return index

    def add_uv(self, left: np.ndarray, right: np.ndarray) -> int:
        """A new texture corner, with the one of its mirror image."""
        self.uvs += [left.tolist(), right.tolist()]
        self.mirrored_uv[len(self.uvs) - 2] = len(self.uvs) - 1
        return len(self.uvs) - 2

    def weights(self, vertex: int) -> dict[int, float]:
        return self.combine.get(vertex, {vertex: 1.0})

    def drop(self, gone: np.ndarray) -> None:
        """Removes quads by mask."""
        self.rows, self.quads, self.quad_uvs = self.rows[~gone], self.quads[~gone], self.quad_uvs[~gone]
        self.mid &= set(self.quads.ravel().tolist())


def mirrored_corners(base: BaseMesh) -> dict[int, int]:
    """The texture corner on the other side of each one."""
    place = {tuple(sorted(quad)): k for k, quad in enumerate(base.quads.tolist())}
    pairs = {}
    for quad, corners in zip(base.quads.tolist(), base.quad_uvs.tolist(), strict=True):
        other = place[tuple(sorted(base.mirror[quad].tolist()))]
        there = dict(zip(base.quads[other].tolist(), base.quad_uvs[other].tolist(), strict=True))
        pairs |= {corner: there[int(base.mirror[v])] for v, corner in zip(quad, corners, strict=True)}
    return pairs


def edge_loop(quads: np.ndarray, start: int, toward: int) -> list[int]:
    """Vertices of the quad edge loop that leaves `start` for `toward`, until it closes or meets an irregular vertex."""
    around: dict[int, set[int]] = {}
    faces: dict[frozenset[int], list[int]] = {}
    for k, quad in enumerate(quads.tolist()):
        for a, b in cycle(quad):
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


def cycle(corners: list[int]) -> list[tuple[int, int]]:
    """The edges of a polygon."""
    return list(zip(corners, corners[1:] + corners[:1], strict=True))


def enclosed(quads: np.ndarray, loop: list[int], seed: int) -> np.ndarray:
    """Mask of the quads on the side of a closed vertex loop on which `seed` lies."""
    barrier = {frozenset(pair) for pair in cycle(loop)}
    owners: dict[frozenset[int], list[int]] = {}
    for k, quad in enumerate(quads.tolist()):
        for pair in cycle(quad):
            owners.setdefault(frozenset(pair), []).append(k)
    mask = (quads == seed).any(axis=1)
    front = np.flatnonzero(mask).tolist()
    while front:
        for pair in cycle(quads[front.pop()].tolist()):
            if frozenset(pair) not in barrier:
                fresh = [k for k in owners[frozenset(pair)] if not mask[k]]
                mask[fresh] = True
                front += fresh
    return mask


def weld_mouth(half: Half) -> None:
    """Removes the inside of the mouth and welds the upper to the lower lip along the line where they meet."""
    base = half.base
    edges = {pair for quad in base.quads.tolist() for pair in cycle(quad)}
    toward = next(b for a, b in sorted(edges) if a == MOUTH_START and base.vertices[b, 0] > 1e-6)
    loop = edge_loop(base.quads, MOUTH_START, toward)[:-1]
    bottom = len(loop) // 2
    assert half.on_mid[loop[bottom]], "the mouth loop is not symmetric"
    mouth = base.joint("mouth", base.vertices)  # a point inside the head, behind the mouth's own back wall
    seed = min(half.mid, key=lambda v: np.linalg.norm(base.vertices[v] - mouth))
    inside = enclosed(base.quads, loop, seed)
    assert inside.sum() < 0.1 * len(inside), "the mouth loop does not close the mouth off"
    half.drop(inside[half.rows])
    for upper, lower in zip(loop[: bottom // 2 + 1], loop[bottom : bottom // 2 : -1], strict=False):
        joined = half.add_vertex({upper: 0.5, lower: 0.5})
        half.quads[np.isin(half.quads, (upper, lower))] = joined
        if upper in half.mid:
            half.mid = (half.mid - {upper, lower}) | {joined}


def fill_eye(half: Half) -> None:
    """Replaces the eye socket by a patch that lies on the eyeball, with triangles named eyeWhite, iris and pupil."""
    base, average = half.base, half.shapes[0]
    ball_faces = base.helper_quads["helper-l-eye"]
    ball_faces = np.concatenate([ball_faces[:, [0, 1, 2]], ball_faces[:, [0, 2, 3]]])
    centre = average[np.unique(ball_faces)].mean(axis=0)
    edges = {pair for quad in half.quads.tolist() for pair in cycle(quad) if EYE_START in pair}
    step = {b: np.abs(average[b] - average[EYE_START]) for pair in edges for b in pair if b != EYE_START}
    toward = min(step, key=lambda b: step[b][1] / step[b][0])  # along the lid
    loop = edge_loop(half.quads, EYE_START, toward)[:-1]
    distance = np.linalg.norm(average[:BODY_VERTICES] - (centre - [0, 0, 0.012]), axis=1)
    half.drop(enclosed(half.quads, loop, int(distance.argmin())))
    rim = average[loop][:, :2]
    points = _eye_points(rim, centre[:2])
    ids = loop + [half.add_vertex(_on_surface(average, ball_faces, point)) for point in points]
    everything = np.concatenate([rim, points])
    place = (everything - rim.mean(axis=0)) * EYE_UV_WIDTH / np.ptp(rim[:, 0])
    uvs = [half.add_uv(EYE_UV[0] + p, EYE_UV[1] + p * [-1, 1]) for p in place]
    for simplex in Delaunay(everything).simplices:
        corners = everything[simplex]
        if not _inside(rim, corners.mean(axis=0)[None])[0]:
            continue
        (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
        order = simplex if ax * by - ay * bx > 0 else simplex[::-1]
        radius = np.linalg.norm(corners.mean(axis=0) - centre[:2])
        kind = "pupil" if radius < PUPIL else "iris" if radius < IRIS else "eyeWhite"
        face = tuple(ids[i] for i in order)
        half.eye_faces.setdefault(kind, []).append(face)
        half.triangles[face] = tuple(uvs[i] for i in order)
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
    for quad, uvs in zip(half.quads.tolist(), half.quad_uvs.tolist(), strict=True):
        keep = [i for i, v in enumerate(quad) if v != quad[i - 1]]
        if len(keep) == 4:
            a, b, c, d = half.shapes[0][quad]
            start = 0 if np.linalg.norm(a - c) <= np.linalg.norm(b - d) else 1
            keep = keep[start:] + keep[:start]
        for i in range(2, len(keep)):
            corners = (keep[0], keep[i - 1], keep[i])
            half.triangles[tuple(quad[k] for k in corners)] = tuple(uvs[k] for k in corners)


def unfold(half: Half, triangles: dict[Face, Face]) -> Body:
    """Both halves. Vertices come left, middle, right: the mirror of left vertex i is i + left + middle."""
    used = sorted({v for face in triangles for v in face})
    left, middle = [v for v in used if v not in half.mid], [v for v in used if v in half.mid]
    index = {v: i for i, v in enumerate(left + middle)}
    offset = len(left) + len(middle)
    rows = [half.weights(v) for v in left + middle]
    rows += [{int(half.base.mirror[o]): w for o, w in half.weights(v).items()} for v in left]
    mirror = np.concatenate([np.arange(len(left)) + offset, np.arange(len(left), offset), np.arange(len(left))])
    faces = np.array([[index[v] for v in face] for face in triangles])
    corners = np.array(list(triangles.values()))
    other = np.array([[half.mirrored_uv[corner] for corner in face] for face in triangles.values()])
    kept, face_uvs = np.unique(np.concatenate([corners, other[:, ::-1]]), return_inverse=True)
    eyes: dict[str, set[frozenset[int]]] = {}
    for kind, members in half.eye_faces.items():
        ours = np.array([[index[v] for v in face] for face in members])
        eyes[kind] = {frozenset(face) for face in np.concatenate([ours, mirror[ours]]).tolist()}
    return Body(
        rows,
        np.concatenate([faces, mirror[faces][:, ::-1]]),
        mirror,
        np.array(half.uvs)[kept],
        face_uvs.reshape(-1, 3),
        eyes,
    )


class Body(NamedTuple):
    """The finished topology."""

    rows: list[dict[int, float]]  # each vertex as weights of original vertices
    faces: np.ndarray
    mirror: np.ndarray
    uvs: np.ndarray  # texture corners, MakeHuman's layout, origin bottom left
    face_uvs: np.ndarray  # three texture corners a face
    eye_faces: dict[str, set[frozenset[int]]]
