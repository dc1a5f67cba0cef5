"""Contacts that are true on the skin: signed distances to the posed surface, and poses solved against it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from motion_body import Performer
from scipy.spatial import cKDTree

Array = np.ndarray


def closest_on_triangles(points: Array, corners: Array) -> Array:
    """Barycentric coordinates (n, 3) of the nearest point of each triangle (n, 3, 3) to each point (n, 3).

    Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap, bp, cp = b - a, c - a, points - a, points - b, points - c
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)  # noqa: E731
    d1, d2, d3, d4, d5, d6 = dot(ab, ap), dot(ac, ap), dot(ab, bp), dot(ac, bp), dot(ab, cp), dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    safe = lambda x: np.where(np.abs(x) > 1e-18, x, 1e-18)  # noqa: E731
    out = np.stack([va, vb, vc], axis=1) / safe(va + vb + vc)[:, None]
    edge_ab, edge_ac = d1 / safe(d1 - d3), d2 / safe(d2 - d6)
    edge_bc = (d4 - d3) / safe((d4 - d3) + (d5 - d6))
    zero, one = np.zeros(len(points)), np.ones(len(points))
    # Later rows win: vertices after edges after the interior.
    for mask, rows in (
        ((va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0), (zero, 1 - edge_bc, edge_bc)),
        ((vb <= 0) & (d2 >= 0) & (d6 <= 0), (1 - edge_ac, zero, edge_ac)),
        ((vc <= 0) & (d1 >= 0) & (d3 <= 0), (1 - edge_ab, edge_ab, zero)),
        ((d6 >= 0) & (d5 <= d6), (zero, zero, one)),
        ((d3 >= 0) & (d4 <= d3), (zero, one, zero)),
        ((d1 <= 0) & (d2 <= 0), (one, zero, zero)),
    ):
        out[mask] = np.stack(rows, axis=1)[mask]
    return out


class PosedSurface:
    """Part of a posed surface that can be asked for its nearest point."""

    def __init__(self, vertices: Array, faces: Array, chosen: Array, candidates: int = 12) -> None:
        self.vertices, self.faces, self.chosen, self.candidates = vertices, faces, chosen, min(candidates, len(chosen))
        corners = vertices[faces[chosen]]
        self.tree = cKDTree(corners.mean(axis=1))
        normals = np.zeros_like(vertices)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(cross, axis=1)
        for k in range(3):
            u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
            share = cross * (np.arctan2(area, (u * v).sum(axis=1)) / np.maximum(area, 1e-15))[:, None]
            for axis in range(3):
                normals[:, axis] += np.bincount(faces[chosen][:, k], share[:, axis], len(vertices))
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]

    def nearest(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """(faces, barycentrics, normals, signed distances, positive outside) of the nearest surface points."""
        _, near = self.tree.query(points, k=self.candidates)
        faces = self.chosen[near.reshape(len(points), -1)]
        corners = self.vertices[self.faces[faces.ravel()]]
        barycentrics = closest_on_triangles(np.repeat(points, faces.shape[1], axis=0), corners)
        feet = np.einsum("ij,ijk->ik", barycentrics, corners).reshape(*faces.shape, 3)
        distance = np.linalg.norm(points[:, None] - feet, axis=-1)
        best = distance.argmin(axis=1)
        rows = np.arange(len(points))
        face, distance, foot = faces[rows, best], distance[rows, best], feet[rows, best]
        barycentric = barycentrics.reshape(*faces.shape, 3)[rows, best]
        # Angle-weighted vertex normals decide the side (Baerentzen and Aanaes 2005, interpolated over edges: ours).
        normal = np.einsum("ij,ijk->ik", barycentric, self.normals[self.faces[face]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
        offset = points - foot
        sign = np.where((offset * normal).sum(axis=1) < 0, -1.0, 1.0)
        # Off the surface the direction to it is the exact derivative of the distance; on it the normal is.
        direction = np.where(distance[:, None] > 2e-4, sign[:, None] * offset / np.maximum(distance, 1e-12)[:, None], normal)
        return face, barycentric, direction, sign * distance


@dataclass(frozen=True, eq=False)
class Touch:
    """Points of a limb that shall lie on a part of the surface."""

    points: Array
    """Vertices of the limb."""
    faces: Array
    """Faces that they touch."""
    weight: float | Array = 1.0
    gap: float = 0.0008
    """Metres between them."""


@dataclass(frozen=True, eq=False)
class Meet:
    """One vertex that shall come near a vertex (or a fixed mix of three) of another part, along the surface too."""

    point: int
    corners: Array
    """Vertices of the other part, (3,)."""
    mix: Array
    """Their weights, (3,)."""
    weight: float = 0.3
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Metres in the world by which the goal lies off that place."""


@dataclass(frozen=True, eq=False)
class Aim:
    """The direction between two vertices of a limb, in the world, as an animator wants it."""

    start: int
    end: int
    direction: tuple[float, float, float]
    weight: float = 0.1


@dataclass(frozen=True, eq=False)
class Apart:
    """Vertices that shall stay outside a part of the surface."""

    vertices: Array
    faces: Array
    margin: float = 0.0
    weight: float = 5.0
    depth: float = 0.05
    """Metres: deeper points are taken for lying on the far side, not for sunk in."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Free angles of a pose, and what they shall fulfil. `build` maps (poses, angles) to local rotations and hips."""

    performer: Performer
    build: Callable[[Array], tuple[Array, Array]]
    lowest: Array
    highest: Array
    prior: Array
    """Weight of staying near the guess, one an angle (metres per radian)."""
    touches: Sequence[Touch] = ()
    meets: Sequence[Meet] = ()
    aims: Sequence[Aim] = ()
    aparts: Sequence[Apart] = field(default_factory=tuple)

    def solve(self, start: Array, guess: Array | None = None, rounds: int = 18, step: float = 0.12) -> Array:
        """Angles after Levenberg-Marquardt steps; the nearest surface points are found anew in every round.

        Steps that make things worse are taken back and shortened (Nielsen 1999 changes the damping more finely).
        """
        x, guess = np.clip(start, self.lowest, self.highest), start if guess is None else guess
        residual, jacobian = self._linearise(x)(x, guess)
        cost, damping = residual @ residual, 1e-3
        for _ in range(rounds):
            slope = jacobian.T @ residual
            # Angles that lie at a limit and want beyond it are left out of the step.
            free = ~(((x <= self.lowest) & (slope > 0)) | ((x >= self.highest) & (slope < 0)))
            hessian = jacobian[:, free].T @ jacobian[:, free]
            hessian += damping * np.diag(np.diag(hessian)) + 1e-9 * np.eye(int(free.sum()))
            delta = np.zeros(len(x))
            delta[free] = -np.linalg.solve(hessian, slope[free])
            delta *= min(1.0, step / max(np.abs(delta).max(), 1e-9))
            tried = np.clip(x + delta, self.lowest, self.highest)
            new_residual, new_jacobian = self._linearise(tried)(tried, guess)
            new_cost = new_residual @ new_residual
            if new_cost < cost:
                settled = cost - new_cost < 1e-4 * cost and np.abs(delta).max() < 2e-3
                x, residual, jacobian, cost = tried, new_residual, new_jacobian, new_cost
                damping = max(damping / 3, 1e-6)
                if settled:
                    break
            else:
                damping *= 6
                if damping > 1e4 or np.abs(delta).max() < 1e-5:
                    break
        return x

    def _linearise(self, x: Array) -> Callable[[Array, Array], tuple[Array, Array]]:
        """Fix the nearest surface points at `x`; the result gives residuals and their central differences there."""
        body = self.performer
        posed = body.skin(body.world(*self.build(x[None])))[0]
        surfaces: dict[int, PosedSurface] = {}

        def surface(faces: Array) -> PosedSurface:
            return surfaces.setdefault(id(faces), PosedSurface(posed, body.faces, faces))

        rows: list[tuple[Array, Array, Array, Array, Array, Array]] = []  # points, corners, mixes, normals, gaps, weights
        for touch in self.touches:
            face, mix, normal, _ = surface(touch.faces).nearest(posed[touch.points])
            count = len(touch.points)
            rows.append((touch.points, body.faces[face], mix, normal, np.full(count, touch.gap), np.broadcast_to(touch.weight, (count,))))
        for apart in self.aparts:
            face, mix, normal, distance = surface(apart.faces).nearest(posed[apart.vertices])
            sunk = (distance < apart.margin) & (distance > -apart.depth)
            count = int(sunk.sum())
            rows.append((
                apart.vertices[sunk], body.faces[face[sunk]], mix[sunk], normal[sunk],
                np.full(count, apart.margin), np.full(count, apart.weight),
            ))  # fmt: skip
        points, corners, mixes, normals, gaps, weights = (np.concatenate(column) for column in zip(*rows, strict=True)) if rows else _nothing()
        meets, aims = self.meets, self.aims
        near = np.array([meet.point for meet in meets], dtype=int)
        goals = np.array([meet.corners for meet in meets], dtype=int).reshape(-1, 3)
        ends = np.array([(aim.start, aim.end) for aim in aims], dtype=int).reshape(-1, 2)
        needed, place = np.unique(np.concatenate([points, corners.ravel(), near, goals.ravel(), ends.ravel()]), return_inverse=True)
        cuts = np.cumsum([len(points), corners.size, len(near), goals.size])
        at = np.split(place, cuts)

        def residuals(angles: Array) -> Array:
            vertices = body.skin(body.world(*self.build(angles)), needed)
            foot = np.einsum("vk,bvkj->bvj", mixes, vertices[:, at[1].reshape(-1, 3)])
            gap = np.einsum("bvj,vj->bv", vertices[:, at[0]] - foot, normals) - gaps
            parts = [gap * weights]
            if len(meets):
                mix = np.array([meet.mix for meet in meets])
                goal = np.einsum("vk,bvkj->bvj", mix, vertices[:, at[3].reshape(-1, 3)])
                goal = goal + np.array([meet.shift for meet in meets])
                miss = (vertices[:, at[2]] - goal) * np.array([meet.weight for meet in meets])[:, None]
                parts.append(miss.reshape(len(angles), -1))
            if len(aims):
                ways = vertices[:, at[4].reshape(-1, 2)]
                ways = ways[:, :, 1] - ways[:, :, 0]
                ways = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
                wanted = np.array([np.divide(aim.direction, np.linalg.norm(aim.direction)) for aim in aims])
                parts.append(((ways - wanted) * np.array([aim.weight for aim in aims])[:, None]).reshape(len(angles), -1))
            return np.concatenate(parts, axis=1)

        def linear(angles: Array, guess: Array) -> tuple[Array, Array]:
            h = 1e-4
            shifts = np.concatenate([np.zeros((1, len(angles))), h * np.eye(len(angles))])
            values = residuals(angles + shifts)
            jacobian = (values[1:] - values[0]).T / h
            return (
                np.concatenate([values[0], self.prior * (angles - guess)]),
                np.concatenate([jacobian, np.diag(self.prior)]),
            )

        return linear


def _nothing() -> tuple[Array, ...]:
    return (np.zeros(0, int), np.zeros((0, 3), int), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def faces_of(performer: Performer, vertices: Array) -> Array:
    """Faces whose corners all belong to a set of vertices."""
    inside = np.zeros(len(performer.vertices), dtype=bool)
    inside[vertices] = True
    return np.flatnonzero(inside[performer.faces].all(axis=1))
