"""Ye 2024's interaction field as the only thing that is minimised, frame by frame: what the field itself is worth.

The paper trains a network on the field's consistency; no code or weights were released. Here the same entries (chosen on the
source: nearest, farthest or both of every observer and part, section 3.3) are the residuals of our Gauss-Newton solver, in
place of contacts and repulsion: t_i^-1 (p_j - p_i) on the target against the source's, scaled by height. The paper's loss is
the cosine of both vectors; their difference is used here, because it was measured to keep more contacts. `distances` takes
the length of the same entries alone, as the distance-matrix loss that the paper compares with (R2ET's is over joints).
Targets of the sensors' frames turn with the observer: a virtual point on its skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.interaction_field import FieldPlan, interaction_field, prepare_field
from retarget.contact.sensors import SensorSkinner, place_sensors, prepare_sensor_skinning
from retarget.methods.base import Method
from retarget.methods.interaction.equations import PosedBody, PoseEquations, Weights
from retarget.methods.interaction.goals import FrameGoals, GoalMaker, NearRows
from retarget.methods.interaction.method import Interaction
from retarget.methods.interaction.retargeter import PreparedInteraction
from retarget.motion.align import Actor

Array = np.ndarray

ROWS = {"nearest": (10, 0), "farthest": (0, 10), "both": (10, 10), "distances": (10, 10)}
"""Nearest and farthest targets of an observer."""
TOTAL = 300.0
"""Sum of all entries' weights on a frame."""


@dataclass(frozen=True)
class FieldOnly(Method):
    """The interaction solver with the field's terms alone."""

    kind: str = "both"
    """A key of `ROWS`."""

    def prepare(self, source: Actor, target: Actor) -> PreparedInteraction:
        """Raises `RetargetError` as the interaction method."""
        weights = Weights(contact=0.0, across=0.0, repulsion=0.0)
        prepared = Interaction(weights=weights).prepare(source, target)
        sensors = [place_sensors(actor.character, actor.humanoid) for actor in (source, target)]
        plan = prepare_field(*sensors, *ROWS[self.kind])
        skinner, exact = prepare_sensor_skinning(sensors[1]), self.kind != "distances"
        equations = prepared.solver.equations
        own = {name: getattr(equations, name) for name in equations.__dataclass_fields__}
        solver = replace(prepared.solver, equations=FieldEquations(**own, skinner=skinner, exact=exact))
        goals = {name: getattr(prepared.goals, name) for name in prepared.goals.__dataclass_fields__}
        return replace(prepared, solver=solver, goals=FieldGoals(**goals, plan=plan))


@dataclass(frozen=True, eq=False)
class FieldGoals(GoalMaker):
    """Entries of the field in place of near sensors: `apart` holds vectors in the observer's frame."""

    plan: FieldPlan

    def _near(self, performed: Motion, busy: Array) -> NearRows:
        places, turned = self.sensors.pose(*world_pose(performed))
        chosen = self.plan.select(places)
        field = interaction_field(places, turned, chosen.observers, chosen.targets, chosen.both)
        frame, row, entry = np.nonzero(chosen.both)
        return NearRows(
            np.searchsorted(frame, np.arange(len(places) + 1)), chosen.targets[frame, row, entry].astype(np.int64),
            chosen.observers[row], self.size * field[frame, row, entry].astype(np.float64), np.ones(len(frame)),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class FieldEquations(PoseEquations):
    """Rows of the field: the target sensor shall be where the observer's frame wants it."""

    skinner: SensorSkinner
    exact: bool
    """Vectors; else lengths alone."""

    def _add_near(self, body: PosedBody, goals: FrameGoals, places: Array, matrix: Array, right: Array) -> None:
        from retarget.contact import pair_kernels

        if not len(goals.apart):
            return
        second, first = goals.near[1], goals.near[0]
        at, turned = (each[0].astype(np.float64) for each in self.skinner.pose(body.world[None], body.places[None]))
        weight = np.full(len(first), TOTAL / len(first))
        if self.exact:
            wanted_at = at[second] + np.einsum("pij,pj->pi", turned[second], goals.apart)
            direction, across = np.tile([1.0, 0.0, 0.0], (len(first), 1)), weight
        else:
            wanted_at, direction, across = at[second], _unit(at[first] - at[second]), np.zeros(len(first))
        missing = wanted_at - at[first]
        if not self.exact:
            length = np.linalg.norm(goals.apart, axis=1) - np.linalg.norm(at[first] - at[second], axis=1)
            missing = length[:, None] * direction
        pair_kernels.add_pairs(
            self.sensors[first], self.sensor_shares[first], at[first], self.sensors[second], self.sensor_shares[second],
            wanted_at, direction, missing, weight, across, self.levers.joints, self.levers.weights, places, matrix, right,
        )  # fmt: skip


def _unit(vectors: Float[Array, "pairs 3"]) -> Float[Array, "pairs 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
