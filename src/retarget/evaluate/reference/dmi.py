"""Ye 2024's interaction field as the only thing that is minimised, frame by frame: what the field itself is worth.

The paper trains a network on the field's consistency; no code or weights were released. Here the same entries (chosen on the
source: nearest, farthest or both of every observer and part, section 3.3) are the residuals of our Gauss-Newton solver, in
place of contacts and repulsion, under the paper's own loss: the cosine of t_i^-1 (p_j - p_i) on the target and on the source,
as 1 - cos = |u_B - u_A|^2 / 2 for the unit vectors u. A pair's pull on places is therefore the stronger the closer the pair:
with the difference of the vectors themselves, scaled by height, entries across the body decide, and less is kept than without
the field. `distances` takes the length of the same entries alone, as the distance-matrix loss that the paper compares with
(R2ET's is over joints). Targets of the sensors' frames turn with the observer: a virtual point on its skin.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.interaction_field import FieldPlan, interaction_field, prepare_field
from retarget.contact.sensors import SensorSkinner, place_sensors, prepare_sensor_skinning
from retarget.methods.base import Method
from retarget.methods.interaction.method import Interaction
from retarget.methods.interaction.retargeter import PreparedInteraction
from retarget.motion.align import Actor
from retarget.motion.touch.equations import PosedBody, PoseEquations, Weights
from retarget.motion.touch.goals import FrameGoals, GoalMaker, NearRows

Array = np.ndarray

ROWS = {"nearest": (10, 0), "farthest": (0, 10), "both": (10, 10), "distances": (10, 10)}
"""Nearest and farthest targets of an observer."""
DIRECTION = 6e-4
"""Weight of the direction of an entry: of a pair's |u_B - u_A|^2."""
LENGTHS = 300.0
"""Sum of the weights of all entries' lengths on a frame, where these are compared."""
CLOSEST = 0.001
"""Metres: the direction of entries that are closer than this is as weak a witness as at this distance."""


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
        skinner, directions = prepare_sensor_skinning(sensors[1]), self.kind != "distances"
        equations = prepared.solver.equations
        own = {name: getattr(equations, name) for name in equations.__dataclass_fields__}
        solver = replace(prepared.solver, equations=FieldEquations(**own, skinner=skinner, directions=directions))
        goals = {name: getattr(prepared.goals, name) for name in prepared.goals.__dataclass_fields__}
        return replace(prepared, solver=solver, goals=FieldGoals(**goals, plan=plan))


@dataclass(frozen=True, eq=False)
class FieldGoals(GoalMaker):
    """Entries of the field in place of near sensors: `apart` holds vectors in the observer's frame."""

    plan: FieldPlan = field(kw_only=True)

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
    directions: bool
    """Compare the directions of entries; else their lengths."""

    def _add_near(self, body: PosedBody, goals: FrameGoals, places: Array, matrix: Array, right: Array) -> None:
        from retarget.contact import pair_kernels

        if not len(goals.apart):
            return
        second, first = goals.near[1], goals.near[0]
        at, turned = (each[0].astype(np.float64) for each in self.skinner.pose(body.world[None], body.places[None]))
        away = at[first] - at[second]
        length = np.maximum(np.linalg.norm(away, axis=1), CLOSEST)
        if self.directions:
            # The target sensor shall go, at its distance, to where the observer's frame sees it in the source's direction.
            wanted = _unit(np.einsum("pij,pj->pi", turned[second], goals.apart)) * length[:, None]
            wanted_at, missing, direction = at[second] + wanted, wanted - away, _unit(wanted)
            along, across = np.zeros(len(first)), DIRECTION / length**2
        else:
            direction = _unit(away)
            missing = (np.linalg.norm(goals.apart, axis=1) - length)[:, None] * direction
            wanted_at, along, across = at[second], np.full(len(first), LENGTHS / len(first)), np.zeros(len(first))
        pair_kernels.add_pairs(
            self.sensors[first], self.sensor_shares[first], at[first], self.sensors[second], self.sensor_shares[second],
            wanted_at, direction, missing, along, across, self.levers.joints, self.levers.weights, places, matrix, right,
        )  # fmt: skip


def _unit(vectors: Float[Array, "pairs 3"]) -> Float[Array, "pairs 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
