"""Basset 2019, `Contact preserving shape transfer`, as published: kept to measure against.

The posed source is given the target's shape. Every iteration moves all vertices a little towards their place in the target's
local frames and along their normals towards the target's volumes, then takes one step of steepest descent in the contact
energy by the rotations of the parts (section 5). Meshes in complete correspondence, metres, up +Y.

The paper gives neither the step of the rotations nor the tolerance of its stopping rule, nor the threshold of contact: those
are ours, and marked. It differentiates automatically, we by hand.

Its faults are kept. Measured on the embedded human, the thin one's poses of self-contact given to other bodies:

- Nothing holds the pose. By shape and volume alone hands on hips, made heavy, have a part turned by up to 6, 43 and 75 degrees
  after 100, 1,000 and 4,000 iterations: the result is there because the iterations stop.
- Low frequencies hardly move: the same pose made a child is 1.64, 1.62 and 1.55 m tall by then, the child 1.20 m. When
  the rule stops, half of the parts' volumes are off by more than 1 to 36 % on heavy bodies, 10 to 55 % on a child.
- The rule may stop where the sum of the energies turns from falling to rising: after 4 to 400 iterations, once 833.
- The step of the rotations depends on the mesh and on how many vertices touch. At .004 no case of 72 diverges, with twice the
  vertices four of 48 (squats, hands on knees).
- The body as a whole is not moved: made a toddler, hands on hips hang 9 mm over the ground after 100 iterations.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.contact.collide import Collider, part_collider
from retarget.contact.parts import BodyParts
from retarget.errors import RetargetError
from retarget.evaluate.reference.contact_terms import (
    THRESHOLD,
    UP,
    SourceContacts,
    attraction,
    repulsion,
    source_contacts,
)
from retarget.evaluate.reference.part_tree import PartTree, Solids, closed_parts, part_tree
from retarget.evaluate.reference.shape_terms import TargetShape, part_volumes, target_shape, volume_step
from retarget.geometry.topology import signed_volume

Array = np.ndarray

TERMS = ("shape", "volume", "repulsion", "attraction")
MOST_TURN = 0.5
"""Radians that a part may turn in one step; a longer one is no small correction any more: the descent diverges. Ours."""
FARTHEST_OUT = 1e40
"""Metres; the squares of volumes up to here are finite."""
SMALLEST = 1e-12
"""Energy that counts as none."""
VOLUMES = ("parts", "body", "none")


@dataclass(frozen=True)
class ReferenceSettings:
    """How the reference runs, and what is left out of it (the ablations of the paper's figures 4 and 5)."""

    offset: float = 0.3
    """The paper's epsilon: share of the way that vertices move in one iteration."""
    turn_step: float = 0.004
    """Radians a unit of the contact energy's derivative (square metres a radian). Ours."""
    tolerance: float = 1e-3
    """Relative change of the sum of the energies from one iteration to the next at which to stop. Ours."""
    still_for: int = 1
    """Iterations in a row whose change must be so small. With one, as the paper has it, the rule can fire where the sum of
    the energies merely turns."""
    most_iterations: int = 1000
    repulsion: bool = True
    attraction: bool = True
    volume: str = "parts"
    """'parts', 'body' (one volume for the whole body) or 'none'."""
    near_joints: bool = False
    """Whether what lies close along the skin at rest is tested for penetration as well, as equation 6 says. Rigid turns
    cannot take skin out of the fold of a joint; left out by default."""

    def __post_init__(self) -> None:
        if self.volume not in VOLUMES:
            raise RetargetError(f"volume is one of {', '.join(VOLUMES)}, received {self.volume!r}")
        for name in ("offset", "turn_step", "tolerance"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise RetargetError(f"{name} is a number from 0 on, received {getattr(self, name)}")
        for name in ("still_for", "most_iterations"):
            if getattr(self, name) < 1:
                raise RetargetError(f"{name} is at least 1, received {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class ReferenceResult:
    """One transferred pose."""

    vertices: Float[Array, "vertices 3"]
    """Metres; finite, whatever the status."""
    turns: Float[Array, "parts 3 3"]
    """What each part of the tree was turned by in all, in the world."""
    energies: dict[str, Float[Array, "states"]]
    """Every term of `TERMS` and 'total', from the posed source on, one more than iterations. Terms that the settings leave
    out are nought. The contact terms of a state are those that its turn started from."""
    iterations: int
    status: str
    """'converged'; 'unconverged' (the iterations ran out); 'diverged' (a part would turn by more than `MOST_TURN`, or a
    vertex leave all measure): then the state of least energy of those before."""
    seconds: float
    """Wall time of the iterations."""
    cpu_seconds: float
    contacts: SourceContacts


@dataclass(frozen=True, eq=False)
class _State:
    """Where the descent stands."""

    vertices: Float[Array, "vertices 3"]
    world: Float[Array, "parts 3 3"]
    """Turns of the parts so far."""
    step: Float[Array, "vertices 3"]
    """d_s + d_v of section 5."""
    energies: tuple[float, float, float, float]
    """By `TERMS`; those of contact from before the last turn."""


@dataclass(frozen=True, eq=False)
class ShapeTransferReference:
    """A pair of bodies made ready; `prepare_reference` makes one."""

    settings: ReferenceSettings
    faces: Int[Array, "faces 3"]
    source_rest: Float[Array, "vertices 3"]
    tree: PartTree
    shape: TargetShape
    solids: Solids
    volumes: Float[Array, "parts"]
    """Of the target's parts, cubic metres."""
    body: Solids
    """The whole body as one solid."""
    body_volume: Float[Array, "1"]
    threshold: float
    """Of contact, metres."""
    source_collider: Collider
    collider: Collider
    """Of the target; what is close along its skin at rest is left out, and what overlaps there."""
    run_collider: Collider
    """The one that is descended by: the same, or with what is close along the skin."""

    def contacts(
        self, posed_source: Float[Array, "vertices 3"], floor: float = 0.0, before: ReferenceResult | None = None
    ) -> SourceContacts:
        """What the posed source touches. Raises as `run`."""
        posed = _surface(posed_source, len(self.source_rest), "the posed source")
        if not np.isfinite(floor):
            raise RetargetError(f"the floor is a height in metres, received {floor}")
        last = None if before is None else (before.contacts.ground, before.vertices)
        return source_contacts(
            self.source_collider, self.faces, self.source_rest, posed, self.threshold, float(floor), last
        )

    def energy(self, vertices: Float[Array, "vertices 3"], contacts: SourceContacts) -> dict[str, float]:
        """Equation 1 of any vertices, this reference's or another method's: each of `TERMS`, and their 'total'.

        All terms with the paper's weights, whatever the settings leave out; pairs that are close along the skin at rest do
        not count. Square metres, the volume's square cubic metres. Raises `RetargetError` for another number of vertices
        or one that is not finite."""
        vertices = _surface(vertices, len(self.source_rest), "the surface")
        step, _ = self.shape.step(vertices)
        found = {
            "shape": float((step**2).sum()),
            "volume": float(((part_volumes(self.solids, vertices) - self.volumes) ** 2).sum()),
            "repulsion": repulsion(self.collider, self.faces, vertices, contacts.floor)[0],
            "attraction": attraction(contacts, vertices)[0],
        }
        return found | {"total": sum(found.values())}

    def run(
        self,
        posed_source: Float[Array, "vertices 3"],
        iterations: int | None = None,
        floor: float = 0.0,
        before: ReferenceResult | None = None,
    ) -> ReferenceResult:
        """The posed source in the target's shape. `iterations` asks for exactly so many, without the stopping rule; `before`
        is the result of the frame before, whose ground contacts stay in their places (section 6). Raises `RetargetError`
        for another number of vertices, or one that is not finite."""
        if iterations is not None and iterations < 0:
            raise RetargetError(f"iterations is a number from 0 on, received {iterations}")
        contacts = self.contacts(posed_source, floor, before)
        limit = self.settings.most_iterations if iterations is None else iterations
        wall, cpu = time.perf_counter(), time.process_time()
        state = self._start(np.array(posed_source, dtype=np.float64), contacts)
        least, rows, status, still = (np.inf, state), [state.energies], "unconverged", 0
        for _ in range(limit):
            last, state = state, self._next(state, contacts)
            if state is None:
                state, status = least[1], "diverged"
                break
            rows.append(state.energies)
            # What contact the last state had is known now, after the vertices' own small step.
            least = min(least, (sum(last.energies[:2]) + sum(state.energies[2:]), last), key=lambda each: each[0])
            now, then = sum(state.energies), sum(last.energies)
            still = still + 1 if abs(now - then) <= self.settings.tolerance * max(then, SMALLEST) else 0
            if iterations is None and still >= self.settings.still_for:
                status = "converged"
                break
        seconds, cpu_seconds = time.perf_counter() - wall, time.process_time() - cpu
        table = np.array(rows)
        energies = {term: table[:, column] for column, term in enumerate(TERMS)} | {"total": table.sum(axis=1)}
        return ReferenceResult(
            state.vertices, state.world, energies, len(rows) - 1, status, seconds, cpu_seconds, contacts
        )

    def _start(self, vertices: Array, contacts: SourceContacts) -> _State:
        step, shape, volume = self._steps(vertices)
        world = np.tile(np.eye(3), (len(self.tree.names), 1, 1))
        return _State(vertices, world, step, (shape, volume, *self._touch(vertices, contacts)[0]))

    def _next(self, state: _State, contacts: SourceContacts) -> _State | None:
        """One iteration of section 5; None where it leads out of all measure."""
        moved = state.vertices + self.settings.offset * state.step
        if not np.abs(moved).max() < FARTHEST_OUT:
            return None
        touch, gradient = self._touch(moved, contacts)
        turns = -self.settings.turn_step * self.tree.turn_gradient(moved, gradient)
        if not np.linalg.norm(turns, axis=1).max() <= MOST_TURN:
            return None
        vertices, turned = self.tree.turned(moved, turns)
        step, shape, volume = self._steps(vertices)
        return _State(vertices, turned @ state.world, step, (shape, volume, *touch))

    def _steps(self, vertices: Array) -> tuple[Array, float, float]:
        """Where shape and volume draw the vertices, and the energies of the two."""
        step, normals = self.shape.step(vertices)
        if self.settings.volume == "none":
            return step, float((step**2).sum()), 0.0
        whole = self.settings.volume == "body"
        solids, wanted = (self.body, self.body_volume) if whole else (self.solids, self.volumes)
        missing = wanted - part_volumes(solids, vertices)
        owners = np.zeros_like(self.tree.vertex_parts) if whole else self.tree.vertex_parts
        energies = float((step**2).sum()), float((missing**2).sum())
        return step + volume_step(normals, owners, missing), *energies

    def _touch(self, vertices: Array, contacts: SourceContacts) -> tuple[tuple[float, float], Array]:
        """Repulsion and attraction, and their derivative by the vertices; nought where the settings leave them out."""
        repelled, attracted, gradient = 0.0, 0.0, np.zeros_like(vertices)
        if self.settings.repulsion:
            repelled, gradient = repulsion(self.run_collider, self.faces, vertices, contacts.floor)
        if self.settings.attraction:
            attracted, pull = attraction(contacts, vertices)
            gradient = gradient + pull
        return (repelled, attracted), gradient


def prepare_reference(
    source_rest: Float[Array, "source_vertices 3"],
    target_rest: Float[Array, "target_vertices 3"],
    faces: Int[Array, "faces 3"],
    parts: BodyParts,
    settings: ReferenceSettings | None = None,
) -> ShapeTransferReference:
    """Make ready source and target at rest (metres), of one topology, divided into the same parts. Raises `RetargetError`
    for surfaces of different numbers of vertices, not finite, turned inside out, in several pieces, or not oriented."""
    settings = settings or ReferenceSettings()
    source_rest = _surface(source_rest, len(parts.vertex_parts), "the source at rest")
    target_rest = _surface(target_rest, len(source_rest), "the target at rest")
    if len(faces) != len(parts.face_parts):
        raise RetargetError(f"the parts are those of {len(parts.face_parts)} faces, received {len(faces)}")
    corners, tree = parts.welded[faces], part_tree(faces, parts)
    counted = tree.face_parts >= 0
    for name, rest in (("source", source_rest), ("target", target_rest)):
        volume = float(signed_volume(rest, corners[counted]))
        if not volume > 0:
            raise RetargetError(f"the {name}'s faces look inwards (volume {volume:.3g} m³); turn them over")
    solids = closed_parts(corners, tree.face_parts, len(tree.names), len(source_rest))
    body = closed_parts(corners, np.where(counted, 0, -1), 1, len(source_rest))
    heights = [float(np.ptp(rest[corners[counted], UP])) for rest in (source_rest, target_rest)]
    collider = part_collider(target_rest, faces, parts, heights[1])
    return ShapeTransferReference(
        settings,
        faces,
        source_rest,
        tree,
        target_shape(target_rest, corners[counted]),
        solids,
        part_volumes(solids, target_rest),
        body,
        part_volumes(body, target_rest),
        THRESHOLD * heights[0],
        part_collider(source_rest, faces, parts, heights[0]),
        collider,
        part_collider(target_rest, faces, parts, heights[1], 0.0) if settings.near_joints else collider,
    )


def _surface(vertices: Array, count: int, what: str) -> Float[Array, "vertices 3"]:
    vertices = np.asarray(vertices, dtype=np.float64)
    if vertices.shape != (count, 3):
        raise RetargetError(
            f"{what} has an array of {vertices.shape}; the topology has {count} vertices, so ({count}, 3)"
        )
    if not np.isfinite(vertices).all():
        first = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
        raise RetargetError(f"{what} is not finite, first at vertex {first}: {vertices[first]}")
    if np.abs(vertices).max(initial=0.0) >= FARTHEST_OUT:
        raise RetargetError(f"{what} lies beyond all measure: {np.abs(vertices).max():.3g} m from the origin")
    return vertices
