"""A take: who performs what, posed once for all measures; and several of them brought onto one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.support import SupportLimb, leg_length, support_limbs, support_points
from retarget.errors import RetargetError
from retarget.evaluate.metrics import REFERENCE_HEIGHT
from retarget.motion.align import Actor
from retarget.motion.filter import resample

Array = np.ndarray

FPS = 30.0
"""Frames a second at which results are judged, unless they or their sources have fewer."""
SAME_RATE = 1e-4
"""Rates that differ by less than this share are one rate: a BVH says 0.0333333 s a frame."""


@dataclass(frozen=True, eq=False)
class Take:
    """An actor and what it performs, both in metres with +Y up."""

    actor: Actor
    motion: Motion

    @cached_property
    def pose(self) -> tuple[Float[Array, "frames joints 4"], Float[Array, "frames joints 3"]]:
        """World rotations and positions of all joints."""
        return world_pose(self.motion)

    @property
    def rotations(self) -> Float[Array, "frames joints 4"]:
        return self.pose[0]

    @property
    def positions(self) -> Float[Array, "frames joints 3"]:
        return self.pose[1]

    @cached_property
    def limbs(self) -> tuple[SupportLimb, ...]:
        return support_limbs(self.actor.character, self.actor.humanoid)

    @cached_property
    def support(self) -> Float[Array, "frames points 3"]:
        """Heel and ball of the left foot, of the right foot, then both palms."""
        return np.concatenate(support_points(self.limbs, *self.pose), axis=1)

    @property
    def leg(self) -> float:
        return leg_length(self.actor.skeleton, self.actor.humanoid)

    @property
    def has_surface(self) -> bool:
        return self.actor.character.skin is not None

    @property
    def fps(self) -> float:
        return self.motion.fps

    def __len__(self) -> int:
        return len(self.motion)

    def joints(self, names: Sequence[str]) -> Float[Array, "frames named 3"]:
        """World positions of canonical joints."""
        return self.positions[:, [self.actor.humanoid.joints[name] for name in names]]

    def own_size(self, metres_at_reference: float) -> float:
        """A length given for a body of 1.7 m, on this one."""
        return metres_at_reference * self.actor.height / REFERENCE_HEIGHT


def on_one_clock(takes: dict[str, Take], fps: float | None = None) -> tuple[list[Take], list[str]]:
    """The same takes at one frame rate and of one length, and notes on what was left out.

    `fps` None: 30 frames a second, or fewer where one of them has fewer. Keys name them in the notes. Raises
    `RetargetError` for a motion without frames.
    """
    for name, each in takes.items():
        if len(each) == 0:
            raise RetargetError(f"the {name}'s clip {each.motion.name!r} has no frames")
    rate = fps if fps is not None else min(FPS, *(each.fps for each in takes.values()))
    notes, motions = [], {}
    for name, each in takes.items():
        if abs(each.fps - rate) < SAME_RATE * rate:
            motions[name] = replace(each.motion, fps=rate)
        else:
            motions[name] = resample(each.motion, rate)
            notes.append(f"the {name} is resampled from {each.fps:g} to {rate:g} frames a second")
    frames = {name: len(motion) for name, motion in motions.items()}
    shared = min(frames.values())
    if max(frames.values()) - shared > 1:  # one more or less is rounding
        lengths = ", ".join(f"{name} {motion.seconds:.2f} s" for name, motion in motions.items())
        notes.append(f"lengths differ ({lengths}): the first {(shared - 1) / rate:.2f} s are compared")
    cut = [
        replace(motion, rotations=motion.rotations[:shared], translations=motion.translations[:shared])
        for motion in motions.values()
    ]
    return [Take(each.actor, motion) for each, motion in zip(takes.values(), cut)], notes
