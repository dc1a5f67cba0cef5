"""A matched pair of bodies, ready to be made to touch as the source does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from retarget.contact.carried import carry_vertices
from retarget.contact.contact_file import ContactEdits
from retarget.contact.detect import prepare_contacts
from retarget.contact.near_sensors import hand_pairs
from retarget.contact.sensors import place_sensors, prepare_sensor_skinning
from retarget.contact.slim import arm_radius
from retarget.motion.align import Actor
from retarget.motion.touch.equations import Weights, prepare_equations
from retarget.motion.touch.goals import GoalMaker
from retarget.motion.touch.solve import Solver, prepare_solver

SPACING = 0.006
"""Share of the performer's height between vertices that are looked at: about a centimetre."""


def prepare_touch(
    performer: Actor,
    target: Actor,
    weights: Weights,
    edits: ContactEdits,
    stands_in: bool = False,
    may_sink: bool = True,
) -> tuple[GoalMaker, Solver]:
    """What finds the goals of a pair, and what reaches them. `stands_in` says that the performer is only the body of a source
    without surface; `may_sink` leaves inside each other what the performer has inside itself. Raises `RetargetError` for
    bodies without a surface, or that share too little of it."""
    detector = prepare_contacts(performer.character, performer.humanoid, spacing=SPACING)
    sensors = tuple(place_sensors(actor.character, actor.humanoid) for actor in (performer, target))
    size = target.height / performer.height
    weights = replace(weights, support=edits.kind("ground") * weights.support)
    equations = prepare_equations(target, weights, detector.threshold * size, sensors[1])
    carried = carry_vertices(performer.character, performer.humanoid, target.character, target.humanoid)
    radii = (
        arm_radius(performer.character, performer.humanoid, detector.collider.parts),
        arm_radius(target.character, target.humanoid, equations.collider.parts),
    )
    goals = GoalMaker(
        detector, carried, carried.backwards(), stands_in, may_sink, prepare_sensor_skinning(sensors[0]),
        hand_pairs(*sensors) if weights.near else (np.zeros(0, dtype=np.int64),) * 2, radii, size, edits,
    )  # fmt: skip
    return goals, prepare_solver(equations)
