"""Skin that gives way: what turning bones leaves inside itself, or out of touch, is settled by a small, smooth displacement.

Rigid parts cannot lie on each other as flesh does: an arm on a belly dents both. The displacement is the least one, in
size and in curvature, that brings penetrating vertices out (along the other part's normal) and lost contacts back; both
sides give way. Basset 2019 turns rigid parts alone. Terms are weighed by area, so that results do not depend on the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.collide import Collider
from retarget.geometry.cholesky import Factor, factor
from retarget.geometry.topology import adjacency, areas, proper
from retarget.motion.touch.goals import FrameGoals

Array = np.ndarray

TALL = 1.7
"""Metres; lengths below are those of a body as tall."""
WIDTH = 0.03
"""Metres over which a displacement fades."""
MARGIN = 0.001
"""Metres that surfaces keep apart."""
OUT, BACK = 60.0, 12.0
"""Weights of a vertex that is inside, and of a contact that is lost, over that of the displacement itself."""
DEEPEST = 0.04
"""Metres: what is deeper inside than that is no dent, and is left."""
KEPT, LOST = 1.0, 3.0
"""Thresholds: a contact within the first needs nothing, one beyond the second is out of reach."""
STEPS, FOLLOWING = 6, 3
"""Conjugate gradient steps a round, on a first frame and on one that follows another."""
ENOUGH = 1e-3
"""Share of the first residual at which they end."""
FADED = 0.8
"""Share of a displacement that the next frame begins with."""
STEADY = 1.0
"""Weight of closeness to it, over that of the displacement itself."""
SMALLEST = 0.05
"""Least area of a vertex, over the mean: needles would be as soft as nothing."""


@dataclass(frozen=True, eq=False)
class Flesh:
    """A body whose skin can give way; `prepare_flesh` makes one."""

    collider: Collider
    faces: Int[Array, "faces 3"]
    """Of the mesh."""
    area: Float[Array, "vertices"]
    """Around each place at rest, square metres at a height of `TALL`; 0 where no face is."""
    stiffness: Factor
    """Of the displacement: its size and its curvature."""
    size: float
    """Height of the body over `TALL`."""
    threshold: float
    """Metres within which skin touches."""

    def given(
        self,
        vertices: Float[Array, "vertices 3"],
        goals: FrameGoals,
        rounds: int,
        before: Float[Array, "vertices 3"] | None = None,
        floor: float | None = None,
    ) -> Float[Array, "vertices 3"]:
        """The displacement (metres) of a posed surface. `before` is that of the frame before, which this one then stays near;
        `floor` a height that nothing near it may be below."""
        steady = 0.0 if before is None else STEADY
        start = np.zeros_like(vertices) if before is None else (FADED * steady / (1.0 + steady)) * before
        found = start
        for _ in range(rounds):
            rows = self._rows(vertices + found, goals, floor)
            if rows is None:
                break
            found = start + self._solved(rows, found - start, 1.0 + steady, STEPS if before is None else FOLLOWING)
        return found[self.collider.parts.welded]

    def _rows(self, posed: Array, goals: FrameGoals, floor: float | None) -> _Rows | None:
        """What should move, along which direction and how far, from where it is now."""
        margin = MARGIN * self.size
        near = self.collider.pairs(posed, margin)
        allowed = np.zeros(len(posed))
        allowed[goals.sunk] = goals.depth
        missing = margin - near.distance - allowed[near.vertex]
        out = np.flatnonzero((missing > 0) & (near.distance > -DEEPEST * self.size))
        vertex = near.vertex[out]
        blocks = [
            (vertex[:, None], np.ones((len(out), 1)), self.faces[near.face[out]], near.barycentric[out], near.normal[out],
             missing[out], OUT * self.area[vertex]),
        ]  # fmt: skip
        if len(goals.weight):
            first, second = (
                np.einsum("pc,pci->pi", shares, posed[corners])
                for corners, shares in ((goals.first, goals.first_shares), (goals.second, goals.second_shares))
            )
            away = first - second
            length = np.linalg.norm(away, axis=1)
            reach = np.maximum(KEPT * self.threshold, np.abs(goals.gap))
            lost = np.flatnonzero((length > reach) & (length < LOST * self.threshold))
            own = goals.first[lost, goals.first_shares[lost].argmax(axis=1)]
            weight = BACK * self.area[own] * goals.count[lost] * np.minimum(goals.weight[lost], 1.0)
            blocks.append((
                goals.first[lost], goals.first_shares[lost], goals.second[lost], goals.second_shares[lost],
                away[lost] / length[lost, None], reach[lost] - length[lost], weight,
            ))  # fmt: skip
        if floor is not None:
            below = floor - posed[:, 1]
            firsts = self.collider.parts.welded == np.arange(len(below))
            low = np.flatnonzero((below > 0) & (below < DEEPEST * self.size) & (self.area > 0) & firsts)
            up = np.tile([0.0, 1.0, 0.0], (len(low), 1))
            none = np.zeros((len(low), 1))
            blocks.append((low[:, None], none + 1.0, low[:, None], none, up, below[low], OUT * self.area[low]))
        if not any(len(block[5]) for block in blocks):
            return None
        return _assembled(blocks, self.collider.parts.welded)

    def _solved(self, rows: _Rows, at: Array, stiff: float, steps: int) -> Float[Array, "vertices 3"]:
        """Conjugate gradients for x in min stiff/2 xᵀKx + 1/2 Σ weight (normal · D(x - at) - missing)², from nothing and with
        K's factor before them; what K makes of directions follows from the residuals, so that K itself is not needed."""
        x = np.zeros_like(at)
        residual = rows.spread(rows.weight * (rows.missing + rows.along(at)))
        z = self.stiffness.solve(residual) / stiff
        direction, stiff_direction = z.copy(), residual.copy()
        old = float((residual * z).sum())
        first = old
        for left in reversed(range(steps)):
            if not old > ENOUGH**2 * first:
                break
            product = stiff_direction + rows.spread(rows.weight * rows.along(direction))
            step = old / float((direction * product).sum())
            x += step * direction
            if not left:
                break
            residual -= step * product
            z = self.stiffness.solve(residual) / stiff
            new = float((residual * z).sum())
            direction = z + (new / old) * direction
            stiff_direction = residual + (new / old) * stiff_direction
            old = new
        return x


@dataclass(frozen=True, eq=False)
class _Rows:
    """Differences of points, D, along normals."""

    matrix: Any
    """Sparse, rows x vertices."""
    transposed: Any
    normals: Float[Array, "rows 3"]
    missing: Float[Array, "rows"]
    """How much each difference should grow along its normal."""
    weight: Float[Array, "rows"]

    def along(self, moved: Float[Array, "vertices 3"]) -> Float[Array, "rows"]:
        """How much a displacement lets each grow."""
        return ((self.matrix @ moved) * self.normals).sum(axis=1)

    def spread(self, amounts: Float[Array, "rows"]) -> Float[Array, "vertices 3"]:
        """The transpose of `along`."""
        return self.transposed @ (amounts[:, None] * self.normals)


def _assembled(blocks: list[tuple[Array, ...]], welded: Int[Array, "vertices"]) -> _Rows:
    from scipy import sparse

    rows, columns, values, start = [], [], [], 0
    for first, first_shares, second, second_shares, *_ in blocks:
        number = start + np.arange(len(first))
        start += len(first)
        for corners, shares, sign in ((first, first_shares, 1.0), (second, second_shares, -1.0)):
            rows.append(np.repeat(number, corners.shape[1]))
            columns.append(welded[corners].ravel())
            values.append(sign * shares.ravel())
    matrix = sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(start, len(welded))
    )
    normals, missing, weight = (np.concatenate([block[place] for block in blocks]) for place in (4, 5, 6))
    return _Rows(matrix, matrix.T.tocsr(), normals, missing, weight)


def prepare_flesh(
    collider: Collider, rest: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], height: float, threshold: float
) -> Flesh:
    """Prepare a body (rest vertices and height in metres) whose skin touches within `threshold` metres."""
    from scipy import sparse

    count, size = len(rest), height / TALL
    corners = collider.parts.welded[faces]
    corners = corners[proper(corners)]
    area = np.bincount(corners.ravel(), np.repeat(areas(rest, corners) / 3.0, 3), count) / size**2
    used = area > 0
    softest = np.maximum(area, SMALLEST * area[used].mean()) if used.any() else np.ones(count)
    graph = adjacency(corners, count)
    laplacian = sparse.diags_array(np.asarray(graph.sum(axis=1)).ravel()) - graph
    # Over a regular triangulation the graph's Laplacian is three of a vertex's areas times the surface's.
    curvature = laplacian.T @ sparse.diags_array(1.0 / (3.0 * softest)) @ laplacian
    stiffness = sparse.diags_array(softest) + WIDTH**4 * curvature
    around = np.where(used, softest, 0.0)[collider.parts.welded]
    return Flesh(collider, faces, around, factor(stiffness, single=True), size, threshold)
