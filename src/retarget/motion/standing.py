"""How an actor stands over a clip: which of its support points rest on the ground, and where the ground is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.contact.ground import HELD_RULE, GroundContacts, RestingRule, ground_contacts
from retarget.contact.support import BODY_JOINTS, SupportLimb, leg_length, support_points
from retarget.motion.align import Actor

Array = np.ndarray

LEGS = 2
"""The first two support limbs are the legs."""


def carrier_positions(actor: Actor, positions: Float[Array, "frames joints 3"]) -> Float[Array, "frames carriers 3"]:
    """World places of the joints that a body rests on besides feet and hands."""
    return positions[:, [actor.humanoid.joints[name] for name in BODY_JOINTS]]


def standing_contacts(
    actor: Actor,
    limbs: tuple[SupportLimb, ...],
    rotations: Float[Array, "frames joints 4"],
    positions: Float[Array, "frames joints 3"],
    fps: float,
    rule: RestingRule = HELD_RULE,
) -> GroundContacts:
    """Ground contacts of all points of an actor's support limbs, from its world pose. The feet, and for who never
    stands up the rest of the body, tell where the floor is."""
    points = support_points(limbs, rotations, positions)
    feet = sum(path.shape[1] for path in points[:LEGS])
    leg = leg_length(actor.skeleton, actor.humanoid)
    return ground_contacts(np.concatenate(points, axis=1), fps, leg, feet, carrier_positions(actor, positions), rule)
