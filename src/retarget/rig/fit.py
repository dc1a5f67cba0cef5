"""A template's body laid into a surface: Gauss-Newton over turns, place and shape.

Points are drawn to points: to given ones first, where a map is at hand, then to the nearest with a like normal, both ways,
along the normal more than across it. What has no counterpart (a hat, a hole, a hand grown into a hip) counts for little, by
the weights of Geman and McClure. Turns and coefficients stay near what is usual.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.geodesic import farthest_points
from retarget.geometry.resample import Surface
from retarget.geometry.topology import vertex_normals
from retarget.rig.fit_model import BodyState, FitModel, PosedBody, moved_state, pose_body

Array = np.ndarray

HEIGHT = 1.7
"""Metres: about the height of the bodies that are fitted, on which all lengths here rest."""
AREA = 1.69
"""Square metres of the skin of a body `HEIGHT` tall: by this the unit of a surface is guessed, which the fit then mends."""
LIKE_NORMALS = 0.08 * HEIGHT
"""How far apart opposite normals put two places when the nearest is sought, half of it in metres."""
SINGULAR = 1e-12
"""Of the largest, what is added to a point's metric, which pairs along one normal leave singular."""
WORST = 0.1
"""Metres beyond which a distance counts as this in the misfit."""
LIMB = 2e-3
"""Inertia of a limb (m²): joints that move less, like fingers, are held less, or nothing would turn them."""
NO_FEET = 0.12
"""Metres of misfit of the feet from which there are none, and nothing more is to be said of them."""
LEAST_AGREEMENT = 0.5
"""Cosine between normals below which a nearest place is of another part."""
LARGEST_TURN = 0.6
"""Radians in one step."""


@dataclass(frozen=True, eq=False)
class Target:
    """A surface prepared to be fitted: `prepare_target` makes one. In metres of a body about `HEIGHT` tall."""

    vertices: Float[Array, "vertices 3"]
    normals: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    spread: Int[Array, "spread"]
    """Vertices spread evenly, so that any first ones are spread too."""
    tree: Any
    unit: float
    """Metres in a unit of the surface."""
    origin: Float[Array, "3"]
    """Its middle, in its own units: `vertices = (surface - origin) unit`."""

    def inside(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Points of the surface's own space in these metres and place."""
        return (points - self.origin) * self.unit

    def outside(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Points in the surface's own units and place."""
        return points / self.unit + self.origin


@dataclass(frozen=True)
class Pull:
    """How one round of the fit weighs."""

    reach: float
    """Metres at which a distance begins to count for less."""
    across: float
    """Weight of moves across the normal; along it is 1."""
    pose: float
    """Weight of a squared radian between a joint and its parent; less where it moves less than a limb."""
    shape: float
    """Weight of a squared standard deviation."""
    fingers: float = 0.0
    """Weight of a squared radian between a finger's joint and what is expected of it, at least."""


@dataclass(frozen=True)
class Misfit:
    """How far a fitted body is from its surface."""

    template: float
    """Metres, root mean square from the template's points to the surface, each at most `WORST`."""
    surface: float
    """The same from the surface to the template: large for what the template has not, like hats and swords."""
    feet: float
    """Both of these together on the feet alone, which fit one way round only; 0 for a template without feet."""

    @property
    def total(self) -> float:
        """What readings are compared by, metres."""
        return self.template + self.surface + 0.5 * min(self.feet, NO_FEET)


def prepare_target(surface: Surface, unit: float, count: int = 1200) -> Target:
    """A surface whose unit is so many metres, for a body about `HEIGHT` tall."""
    from scipy.spatial import cKDTree

    origin = surface.vertices.mean(axis=0)
    vertices = (surface.vertices - origin) * unit
    normals = vertex_normals(surface.vertices, surface.faces)
    first = int(np.linalg.norm(vertices, axis=1).argmax())
    spread = farthest_points(vertices, count, first)
    tree = cKDTree(lifted(vertices, normals))
    return Target(vertices, normals, surface.faces, spread, tree, unit, origin)


def fit_to_places(
    model: FitModel, state: BodyState, places: Float[Array, "points 3"], rounds: int, pull: Pull
) -> BodyState:
    """Draw every point of the model to a place of its own."""
    for _ in range(rounds):
        posed = pose_body(model, state, derivatives=True)
        away = places - posed.points
        weight = _robust(np.linalg.norm(away, axis=1), pull.reach) / len(away)
        normal, gradient = _everywhere(posed.jacobian, away, weight)
        state = _step(model, state, normal, gradient, pull)
    return state


def fit_to_surface(
    model: FitModel, state: BodyState, target: Target, pulls: Iterator[Pull] | list[Pull], count: int | None = None
) -> BodyState:
    """Draw the model's points to the nearest of the surface, and the surface's (the first `count` spread ones) to the
    model's, a round for every pull."""
    from scipy.spatial import cKDTree

    spread = target.spread[:count]
    seen = lifted(target.vertices[spread], target.normals[spread])
    for pull in pulls:
        posed = pose_body(model, state, derivatives=True)
        own = lifted(posed.points, posed.normals)
        _, near = target.tree.query(own)
        _, back = cKDTree(own).query(seen)
        index = np.concatenate([np.arange(len(own)), back])
        found = np.concatenate([near, spread])
        away = target.vertices[found] - posed.points[index]
        share = np.repeat([1.0 / len(own), 1.0 / len(spread)], [len(own), len(spread)])
        weight = _robust(np.linalg.norm(away, axis=1), pull.reach) * share
        normal, gradient = _along(posed, index, target.normals[found], away, weight, pull.across)
        state = _step(model, state, normal, gradient, pull)
    return state


def prepare_skin(mesh: Surface) -> SurfaceIndex:
    """A surface on which places with like normals are sought. In metres of a body about `HEIGHT` tall."""
    return SurfaceIndex(lifted(mesh.vertices, vertex_normals(mesh.vertices, mesh.faces)), mesh.faces)


def fit_to_skin(
    model: FitModel,
    state: BodyState,
    skin: SurfaceIndex,
    pulls: list[Pull],
    back: Target | None = None,
    free: Int[Array, "free"] | None = None,
) -> BodyState:
    """Draw the model's points to the nearest places of a surface, a round for every pull; and those of `back`, if any, to
    the model's.

    `fit_to_surface` goes to vertices and finds a body from afar; this is for the last millimetres. Places whose normals turn
    elsewhere do not count. `free` are the parameters that may change, in the order of `PosedBody.jacobian`.
    """
    for pull in pulls:
        posed = pose_body(model, state, derivatives=True)
        there = skin.closest(lifted(posed.points, posed.normals)).of(skin.vertices)
        index, places, normals = np.arange(len(there)), there[:, :3], rot.unit(there[:, 3:])
        share = np.full(len(index), 1.0 / len(index))
        if back is not None:
            index, places, normals, share = _with_back(posed, back, (index, places, normals, share))
        away = places - posed.points[index]
        alike = (normals * posed.normals[index]).sum(axis=1) > LEAST_AGREEMENT
        weight = _robust(np.linalg.norm(away, axis=1), pull.reach) * alike * share
        normal, gradient = _along(posed, index, normals, away, weight, pull.across)
        state = _step(model, state, normal, gradient, pull, free)
    return state


def _with_back(posed: PosedBody, back: Target, pairs: tuple[Array, ...]) -> tuple[Array, ...]:
    from scipy.spatial import cKDTree

    seen = lifted(back.vertices[back.spread], back.normals[back.spread])
    _, near = cKDTree(lifted(posed.points, posed.normals)).query(seen)
    more = near, seen[:, :3], back.normals[back.spread], np.full(len(near), 1.0 / len(near))
    return tuple(np.concatenate(both) for both in zip(pairs, more))


def misfit(model: FitModel, state: BodyState, target: Target, feet: Bool[Array, "points"]) -> Misfit:
    """How far the fitted body is from the surface; `feet` are the model's points on them."""
    from scipy.spatial import cKDTree

    posed = pose_body(model, state)
    own = lifted(posed.points, posed.normals)
    _, near = target.tree.query(own)
    _, back = cKDTree(own).query(lifted(target.vertices[target.spread], target.normals[target.spread]))
    there = np.linalg.norm(target.vertices[near] - posed.points, axis=1)
    here = np.linalg.norm(target.vertices[target.spread] - posed.points[back], axis=1)
    on_feet = _root_mean_square(there[feet]) + _root_mean_square(here[feet[back]]) if feet.any() else 0.0
    return Misfit(_root_mean_square(there), _root_mean_square(here), on_feet)


def _root_mean_square(distances: Float[Array, "_"]) -> float:
    """With every distance at most `WORST`; `WORST` for none at all."""
    return float(np.sqrt((np.minimum(distances, WORST) ** 2).mean())) if len(distances) else WORST


def state_from_places(model: FitModel, places: Float[Array, "points 3"], shape: Float[Array, "shapes"]) -> BodyState:
    """A first state: each part turned as its points were (Kabsch 1976, by skinning weight), and the whole body scaled (its
    last shape) and moved to where they lie."""
    rest, count = model.points_of(shape), len(model.parents)
    turns = np.empty((count, 3, 3))
    grown = spread = 0.0
    for joint in range(count):
        weight = model.weights[:, joint]
        total = float(weight.sum())
        if total < 1e-6 * len(weight):
            if joint:
                turns[joint] = turns[model.parents[joint]]
                continue
            weight, total = (
                np.ones(len(weight)),
                float(len(weight)),
            )  # a root that moves no skin of its own turns with all of it
        here, there = rest - weight @ rest / total, places - weight @ places / total
        u, sizes, vt = np.linalg.svd((weight[:, None] * here).T @ there)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
        turns[joint] = vt.T @ (sign[:, None] * u.T)
        grown, spread = grown + float(sizes @ sign), spread + float(weight @ (here**2).sum(axis=1))
    scaled = scaled_shape(shape, max(grown / max(spread, 1e-12), 0.1))
    first = BodyState(scaled, turns, np.zeros(3))
    trunk = model.weights[:, :3].sum(axis=1) + 1e-9
    return BodyState(scaled, turns, trunk @ (places - pose_body(model, first).points) / trunk.sum())


def similarity(
    here: Float[Array, "points 3"], there: Float[Array, "points 3"]
) -> tuple[Float[Array, "3 3"], float, Float[Array, "3"]]:
    """Turn, scale and shift that bring points nearest to others: there = scale * turn @ here + shift (Umeyama 1991)."""
    middle, other = here.mean(axis=0), there.mean(axis=0)
    u, sizes, vt = np.linalg.svd((here - middle).T @ (there - other))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = vt.T @ (sign[:, None] * u.T)
    scale = float(sizes @ sign) / max(float(((here - middle) ** 2).sum()), 1e-12)
    return turn, scale, other - scale * turn @ middle


def scaled_shape(shape: Float[Array, "shapes"], factor: float) -> Float[Array, "shapes"]:
    """The shape of the same body `factor` times as large. The last shape of a model is the mean body itself."""
    scaled = shape * factor
    scaled[-1] = (1.0 + shape[-1]) * factor - 1.0
    return scaled


def lifted(points: Float[Array, "points 3"], normals: Float[Array, "points 3"]) -> Float[Array, "points 6"]:
    """Points with their normals beside them, `LIKE_NORMALS` long: neighbours are then near and turned alike."""
    return np.concatenate([points, LIKE_NORMALS * normals], axis=1)


def _robust(distance: Float[Array, "points"], reach: float) -> Float[Array, "points"]:
    """Geman and McClure's weights: one near by, falling with the fourth power beyond the reach."""
    return 1.0 / (1.0 + (distance / reach) ** 2) ** 2


def _along(
    posed: PosedBody,
    index: Int[Array, "pairs"],
    normals: Float[Array, "pairs 3"],
    away: Float[Array, "pairs 3"],
    weight: Float[Array, "pairs"],
    across: float,
) -> tuple[Float[Array, "parameters parameters"], Float[Array, "parameters"]]:
    """Normal equations of pairs that pull along their normals in full, and by `across` in every direction.

    Pairs of one point share its derivatives, so their 3x3 metrics are added up first.
    """
    from retarget.rig.fit_kernels import rooted

    metric = weight[:, None, None] * (normals[:, :, None] * normals[:, None, :] + across * np.eye(3))
    force = np.einsum("pab,pb->pa", metric, away)
    count = len(posed.points)
    metrics = np.stack([np.bincount(index, metric[:, a, b], count) for a in range(3) for b in range(3)], axis=1)
    forces = np.stack([np.bincount(index, force[:, a], count) for a in range(3)], axis=1)
    jacobian = posed.jacobian
    flat = jacobian.reshape(-1, jacobian.shape[2])
    metrics = metrics.reshape(-1, 3, 3)
    roots = np.linalg.cholesky(metrics + SINGULAR * float(metrics.max()) * np.eye(3))
    half = np.empty(flat.shape)
    rooted(roots, jacobian, half.reshape(jacobian.shape))
    return half.T @ half, flat.T @ forces.ravel()  # half the work of a product that is not known to be symmetric


def _everywhere(
    jacobian: Float[Array, "points 3 parameters"], away: Float[Array, "points 3"], weight: Float[Array, "points"]
) -> tuple[Float[Array, "parameters parameters"], Float[Array, "parameters"]]:
    flat, heavy = jacobian.reshape(-1, jacobian.shape[2]), np.repeat(weight, 3)
    half = flat * np.sqrt(heavy)[:, None]
    return half.T @ half, flat.T @ (heavy * away.ravel())


def _step(
    model: FitModel,
    state: BodyState,
    normal: Float[Array, "parameters parameters"],
    gradient: Float[Array, "parameters"],
    pull: Pull,
    free: Int[Array, "free"] | None = None,
) -> BodyState:
    """Add what is usual of poses and shapes, solve, and move; only the `free` parameters, if any are named."""
    count, parents = len(model.parents), model.parents
    relative = np.matmul(state.turns[parents[1:]].transpose(0, 2, 1), state.turns[1:])
    bent = rot.to_rotation_vector(rot.from_matrix(relative)) - model.bends[1:]
    diagonal = np.zeros(len(gradient))
    held = pull.pose * np.minimum(1.0, np.sqrt(model.inertia[1:] / LIMB))
    held[model.fingers - 1 :] = np.maximum(held[model.fingers - 1 :], pull.fingers)
    usual = np.repeat(held, 3)
    diagonal[3 : 3 * count] = usual
    gradient[3 : 3 * count] -= usual * np.einsum("jab,jb->ja", state.turns[parents[1:]], bent).ravel()
    stiff = pull.shape / model.spread**2
    diagonal[3 * count + 3 :] = stiff
    gradient[3 * count + 3 :] -= stiff * (state.shape - model.usual)
    diagonal += min(1e-6, 0.1 * pull.pose) + 1e-9 * np.trace(normal) / len(gradient)
    matrix = normal + np.diag(diagonal)
    step = np.zeros(len(gradient))
    if free is None:
        step = np.linalg.solve(matrix, gradient)
    else:
        step[free] = np.linalg.solve(matrix[np.ix_(free, free)], gradient[free])
    largest = np.abs(step[: 3 * count]).max()
    return moved_state(state, step * min(1.0, LARGEST_TURN / max(largest, 1e-12)), parents)
