"""What a start is worth to the interaction solver: how far its rounds come from key frames, and from what a network says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import local_positions, world_pose
from retarget.character import Motion
from retarget.methods.interaction.looker import Looker
from retarget.methods.interaction.method import Interaction
from retarget.methods.interaction.network import InteractionNetwork
from retarget.methods.interaction.retargeter import LEARNED_STAYED
from retarget.motion.align import Actor
from retarget.motion.touch.equations import Linearised, PoseEquations
from retarget.motion.touch.faults import needs
from retarget.motion.touch.goals import ClipGoals
from retarget.motion.touch.mend import frames_of, solve_clip
from retarget.motion.touch.solve import CALM, CURVATURE, PRIOR, SPEED, STAYED, TOGETHER, Solver

Array = np.ndarray

ALONG = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
BOOLE = np.array([7.0, 32.0, 12.0, 32.0, 7.0]) / 90.0
"""Where gradients are looked at between two solutions, and what each counts (Boole's rule)."""


@dataclass(frozen=True, eq=False)
class Counting(PoseEquations):
    """Equations that count how often they are set up."""

    count: list[int] = field(default_factory=lambda: [0], kw_only=True)

    def linearise(self, copied: Array, offsets: Array, goals: Any, x: Array) -> Linearised:
        """As always."""
        self.count[0] += 1
        return super().linearise(copied, offsets, goals, x)


@dataclass(frozen=True, eq=False)
class Problem:
    """A clip of a pair of bodies as the solver has it."""

    solver: Solver
    frames: Motion
    goals: ClipGoals
    fps: float
    need: Float[Array, "frames"]
    performed: Motion

    def solved(self, start: Array | None, together: int, stayed: float) -> tuple[Float[Array, "frames unknowns"], int]:
        """Corrections, and how many frames' equations were set up for them."""
        equations = self.solver.equations
        counting = Counting(**{name: getattr(equations, name) for name in equations.__dataclass_fields__})
        solver = replace(self.solver, equations=counting)
        x = solve_clip(solver, self.frames, self.goals, self.fps, start=start, together=together, stayed=stayed)
        return x, counting.count[0]

    def energy_above(self, a: Float[Array, "frames unknowns"], b: Float[Array, "frames unknowns"]) -> float:
        """The energy of b less that of a: gradients along the way between them, and the terms that are plain squares."""
        offsets = local_positions(self.frames.skeleton, self.frames.translations, self.frames.moved)
        solver, total = self.solver, 0.0
        for f in np.flatnonzero(self.need).tolist():
            goals, way = self.goals.frame(f).weakened(self.need[f]), b[f] - a[f]
            if not way.any():
                continue
            for share, weight in zip(ALONG, BOOLE):
                found = solver.equations.linearise(self.frames.rotations[f], offsets[f], goals, a[f] + share * way)
                total -= weight * float(found.right @ way)
        return total + self._squares(b) - self._squares(a)

    def _squares(self, x: Array) -> float:
        solver, rate = self.solver, self.fps / 30.0
        prior = PRIOR * (solver.stiffness + CALM * (1.0 - self.need)[:, None] * solver.inertia)
        first, second = np.diff(x, axis=0), np.diff(x, n=2, axis=0)
        over_time = CURVATURE * rate**4 * second**2, SPEED * rate**2 * first**2
        return 0.5 * float((prior * x**2).sum() + sum((solver.inertia * each).sum() for each in over_time))


def problem(source: Actor, target: Actor, motion: Motion) -> Problem:
    """A clip at its own rate, copied."""
    prepared = Interaction().prepare(source, target)
    copied = prepared.copier.clip(motion)
    frames = frames_of(copied.motion, np.arange(len(motion)))
    touching = None if copied.contacts is None else copied.contacts.touching
    _, goals = prepared.goals.clip(motion, frames, prepared.solver.equations, touching)
    offsets = local_positions(frames.skeleton, frames.translations, frames.moved)
    return Problem(prepared.solver, frames, goals, motion.fps, needs(prepared.solver.equations, frames, offsets, goals), motion)


def rounds(asked: Problem, looker: Looker, network: InteractionNetwork) -> Iterator[dict[str, Any]]:
    """Energies (less that of the copied pose) and set-ups per frame that needs any: of both starts, and of none to three rounds each; in
    rounds that look again at frames that have hardly moved, as the solver's own do, and in such that do not."""
    turned = network.clip(looker, asked.performed, asked.frames, asked.fps)
    said = looker.unknowns.to_solver(turned, world_pose(asked.frames)[0]) * (asked.need > 0)[:, None]
    still, frames = np.zeros_like(said), max(1, int(np.count_nonzero(asked.need)))
    yield {"start": "network", "stayed": STAYED, "rounds": -1, "set_ups": 0.0, "energy": asked.energy_above(still, said)}
    for (name, start), stayed in product((("keys", None), ("network", said)), (STAYED, LEARNED_STAYED)):
        for together in range(TOGETHER + 1):
            x, count = asked.solved(start, together, stayed)
            energy = asked.energy_above(still, x)
            yield {"start": name, "stayed": stayed, "rounds": together, "set_ups": count / frames, "energy": energy}
