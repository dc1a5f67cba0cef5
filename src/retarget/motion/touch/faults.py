"""Which frames of the copied motion need anything mended at all: where nothing does, the copied pose is the result."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.character import Motion
from retarget.motion.touch.equations import TALL, PosedBody, PoseEquations
from retarget.motion.touch.goals import ClipGoals, FrameGoals

Array = np.ndarray

DEEPER_THAN, ABOUT = 0.0015, 0.1
"""Metres, on a body of `TALL`: what is inside another part by more than this, and more than in the source, is a fault. How
deep the source is, is known to about a tenth."""
LOST, BEYOND = 1.5, 0.3
"""Thresholds: a contact whose points are farther apart is lost, or farther than it asks for by this much."""
MEANT = 0.02
"""Contacts that weigh less are no reason to change a pose."""
AROUND = 0.1
"""Seconds around a fault over which the pose leaves the copied one and returns to it."""

FADING = 0.4
"""Seconds that leaving it, and returning, take online, where no later frame is known."""


def needs(
    equations: PoseEquations, copied: Motion, offsets: Float[Array, "frames joints 3"], goals: ClipGoals
) -> Float[Array, "frames"]:
    """How much each frame may be changed: 1 where the copied pose has a fault, falling to 0 at `AROUND` from it."""
    still = np.zeros(equations.size)
    faulty = np.zeros(len(copied), dtype=bool)
    for f in range(len(copied)):
        own = goals.frame(f)
        faulty[f] = has_fault(equations, equations.pose(copied.rotations[f], offsets[f], still, own.surface), own)
    faults = np.flatnonzero(faulty)
    if len(faults) == 0:
        return np.zeros(len(copied))
    frames = np.arange(len(copied))
    after = np.clip(np.searchsorted(faults, frames), 0, len(faults) - 1)
    before = np.maximum(after - 1, 0)
    away = np.minimum(np.abs(faults[after] - frames), np.abs(faults[before] - frames)) / copied.fps
    return np.clip(1.0 - away / AROUND, 0.0, 1.0)


def has_fault(equations: PoseEquations, body: PosedBody, goals: FrameGoals) -> bool:
    """Whether a pose loses a contact it should have, or is deeper inside itself than it may be."""
    return _loses_contact(equations, body, goals) or _is_inside_itself(equations, body, goals)


def _loses_contact(equations: PoseEquations, body: PosedBody, goals: FrameGoals) -> bool:
    meant = goals.weight > MEANT
    if not meant.any():
        return False
    first, second = (
        np.einsum("pc,pci->pi", shares[meant], body.vertices[corners[meant]])
        for corners, shares in ((goals.first, goals.first_shares), (goals.second, goals.second_shares))
    )
    apart, threshold = np.linalg.norm(first - second, axis=1), equations.threshold
    return bool((apart > np.maximum(LOST * threshold, np.abs(goals.gap[meant]) + BEYOND * threshold)).any())


def _is_inside_itself(equations: PoseEquations, body: PosedBody, goals: FrameGoals) -> bool:
    inside = equations.collider.pairs(body.vertices)
    allowed = np.zeros(len(body.vertices))
    allowed[goals.sunk] = goals.depth
    limit = DEEPER_THAN * equations.actor.height / TALL
    return bool((-inside.distance - (1.0 + ABOUT) * allowed[inside.vertex] > limit).any())
