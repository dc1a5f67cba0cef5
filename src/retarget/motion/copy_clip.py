"""The whole copy of a clip: rotations, path, limits, shake, ground contacts.

Anatomical frames are carried over in world space, so limbs point where the source's point and palms, feet and head
are turned as the source's are, whatever the two rest poses. The root path scales with the leg length. What rests on the
ground in the source is found and held in the result (`foot_lock`). Shake that the target's proportions would enlarge is
filtered (`steady`); all else is the source's rotation, untouched. The method `copy-rotations` is this and no more; others
start from it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_positions, local_rotations, rest_pose, world_pose
from retarget.character import Motion, Pose
from retarget.contact.ground import GroundContacts
from retarget.contact.support import (
    SupportLimb,
    descendants,
    leg_length,
    stand_up,
    support_limbs,
    support_points,
)
from retarget.errors import RetargetError
from retarget.motion.align import Actor, same_skeleton
from retarget.motion.anatomy import bend_directions
from retarget.motion.copy import CopyPlan, complete, copy_rotations, plan_copy, positions_of
from retarget.motion.filter import FASTEST
from retarget.motion.foot_lock import body_lift, hip_drop, limb_goal, reach_goals
from retarget.motion.limits import Limit, ease_into_limits, joint_limits
from retarget.motion.standing import LEGS, carrier_positions, standing_contacts
from retarget.motion.steady import END_JOINTS, LONGEST_SIGMA, MORE_SHAKE, STILL, lightest, low_pass, shake

Array = np.ndarray

LOW = 0.15
"""Leg lengths over the floor below which a hip, knee, elbow or shoulder joint, or the head, carries the body."""


@dataclass(frozen=True)
class CopySettings:
    """How a clip is copied."""

    foot_lock: bool = True
    """Hold feet and hands that rest on the ground in the source."""
    steady: bool = True
    """Filter what longer limbs would add to the source's shake (`motion.steady`)."""
    limits: bool = True
    """Ease rotations that no body can do into soft joint limits."""
    in_place: bool = False
    """Drop the horizontal path: the body stays where its first frame stands."""
    one_rig: bool = False
    """Where both bodies are on one rig (same joints, rest rotations), give the target equal rotations: bodies of one parametric
    model mean the same by them. Otherwise limbs point the same way, however bones lie at rest."""


@dataclass(frozen=True, eq=False)
class CopiedClip:
    """A clip copied onto a target."""

    motion: Motion
    """Over the target's skeleton, metres, +Y up."""
    stats: dict[str, Any]
    """What was inferred and measured."""
    contacts: GroundContacts | None
    """Of the source, where they were looked for."""


def prepare_copier(settings: CopySettings, source: Actor, target: Actor) -> Copier:
    """Match the bodies. Raises `RetargetError` where a leg has no length."""
    for actor in (source, target):
        if not leg_length(actor.skeleton, actor.humanoid) > 1e-6:
            raise RetargetError("a leg has no length: its joints lie on one point")
    limbs = {actor: support_limbs(actor.character, actor.humanoid) for actor in (source, target)}
    soles = {actor: _sole_height(actor, limbs[actor]) for actor in (source, target)}
    plan = plan_copy(source, target, soles[source], soles[target], settings.one_rig)
    limits = joint_limits(target) if settings.limits else ()
    floors = _rest_floor(soles[source], plan.source_hip_height), _rest_floor(soles[target], plan.target_hip_height)
    return Copier(settings, source, target, plan, limbs[source], limbs[target], limits, *floors)


def _sole_height(actor: Actor, limbs: tuple[SupportLimb, ...]) -> float:
    rotations, positions = rest_pose(actor.skeleton)
    upright = stand_up(actor.humanoid)
    legs = support_points(limbs[:2], rot.multiply(upright, rotations)[None], rot.rotate(upright, positions)[None])
    return float(min(points[..., 1].min() for points in legs))


def _rest_floor(sole: float, hip_height: float) -> float:
    """A body that stands on its own ground keeps it; one whose file has its origin at the hips gets the world's."""
    return sole if abs(sole) < 0.25 * hip_height else 0.0


@dataclass(frozen=True, eq=False)
class Copier:
    """A matched pair of bodies; `prepare_copier` makes one."""

    settings: CopySettings
    source: Actor
    target: Actor
    plan: CopyPlan
    source_limbs: tuple[SupportLimb, ...]
    target_limbs: tuple[SupportLimb, ...]
    limits: tuple[Limit, ...]
    source_floor: float
    """Height of the source's floor as its rest pose shows it, metres."""
    floor: float
    """Height of the target's floor, metres."""
    first_step: list[Float[Array, "3"]] = field(default_factory=list)
    """Where the hips of the first online frame are, once there was one: what `in_place` keeps of the path."""

    @property
    def target_leg(self) -> float:
        """Length of the target's legs, metres."""
        return leg_length(self.target.skeleton, self.target.humanoid)

    def check(self, motion: Motion) -> None:
        """Raises `RetargetError` for a motion of another skeleton, without frames, or faster than `FASTEST`."""
        if not same_skeleton(motion.skeleton, self.source.skeleton):
            raise RetargetError("the motion belongs to another skeleton than the one that was prepared")
        if len(motion) == 0:
            raise RetargetError(f"the clip {motion.name!r} has no frames")
        if motion.fps > FASTEST:
            raise RetargetError(
                f"the clip {motion.name!r} runs at {motion.fps:g} frames a second; resample it to {FASTEST:g} or less (--fps)"
            )

    def clip(self, motion: Motion, turned: Float[Array, "frames targets 4"] | None = None) -> CopiedClip:
        """Copy a clip; with `turned`, world rotations of the target's joints that are known otherwise than by copying, those
        are kept, and path and ground contacts come from the clip. Raises `RetargetError` as `check` does."""
        self.check(motion)
        rotations, positions = world_pose(motion)
        contacts = None
        if self.settings.foot_lock:
            contacts = standing_contacts(self.source, self.source_limbs, rotations, positions, motion.fps)
        source_floor = self.source_floor
        if contacts is not None:  # a clip that never lands keeps its own ground, unless it sinks below
            source_floor = contacts.floor if contacts.touching.any() else min(contacts.floor, source_floor)
        world, hips = self._copy(rotations, positions, source_floor, turned)
        sigma = self._sigma(positions, world, hips, motion.fps) if self.settings.steady else 0.0
        if sigma > 0:
            world, hips = low_pass(world, hips, sigma * motion.fps)
        placed = positions_of(self.plan.target, world, self.plan.target_hips, hips)
        stats: dict[str, Any] = {
            "scale": self.plan.scale,
            "source_floor_m": source_floor,
            "target_floor_m": self.floor,
            "resting_joints": list(self.plan.unmatched),
            "low_pass_s": sigma,
        }
        if contacts is not None:
            stats["contact_frames"] = int(contacts.touching.any(axis=1).sum())
            body = (carrier_positions(self.source, positions)[..., 1] - source_floor) * self.plan.scale
            if contacts.touching.any() or (body < LOW * self.target_leg).any():
                world, hips = self._hold(world, placed, hips, contacts, body, source_floor, motion.fps)
        if self.settings.in_place:
            hips = hips * [0, 1, 0] + hips[0] * [1, 0, 1]
        return CopiedClip(self._motion(world, hips, motion), stats, contacts)

    def step(self, pose: Pose, turned: Float[Array, "targets 4"] | None = None) -> Pose:
        """The pose of one frame, with no look-ahead: contacts are left as they come. `turned` as in `clip`."""
        skeleton = self.source.skeleton
        if len(pose.rotations) != len(skeleton) or max(pose.moved) >= len(skeleton):
            raise RetargetError(f"the pose has {len(pose.rotations)} joints, the prepared source {len(skeleton)}")
        local = local_positions(skeleton, pose.translations[None], pose.moved)
        rotations, positions = forward(skeleton.parents, pose.rotations[None], local)
        world, hips = self._copy(rotations, positions, self.source_floor, None if turned is None else turned[None])
        if self.settings.in_place:
            self.first_step[:] = self.first_step or [hips[0]]
            hips = hips * [0, 1, 0] + self.first_step[0] * [1, 0, 1]
        result = self._motion(world, hips, None)
        return result.pose(0)

    def _copy(
        self,
        rotations: Float[Array, "frames joints 4"],
        positions: Float[Array, "frames joints 3"],
        source_floor: float,
        turned: Float[Array, "frames targets 4"] | None,
    ) -> tuple[Float[Array, "frames targets 4"], Float[Array, "frames 3"]]:
        """World rotations of the target, and where its hips go: the middle of the hip sockets follows the scaled path."""
        plan = self.plan
        world = copy_rotations(plan, rotations) if turned is None else turned
        if turned is None and self.limits and ease_into_limits(self.limits, world):
            complete(plan, world)
        sockets = positions[:, plan.source_sockets].mean(axis=1) - [0, source_floor, 0]
        sockets = sockets * plan.scale
        # Ankle heights do not scale with leg length: shift by the difference, fading out for a body near the ground.
        extra = plan.target_hip_height - plan.scale * plan.source_hip_height
        standing = np.clip(sockets[:, 1] / (0.5 * plan.target_hip_height), 0, 1)
        sockets[:, 1] += extra * standing + self.floor
        hips = plan.target_hips
        local = positions_of(plan.target, world, hips, np.zeros((len(world), 3)))
        middle = local[:, plan.target_sockets].mean(axis=1)
        return world, sockets - middle

    def _sigma(self, source: Float[Array, "frames joints 3"], world: Array, hips: Array, fps: float) -> float:
        """Seconds of low-pass that keep the result's shake within the source's; 0 for a body that adds none."""
        joints = [self.source.humanoid.joints[name] for name in END_JOINTS]
        allowed = shake(source[:, joints], fps, leg_length(self.source.skeleton, self.source.humanoid))

        def shown(sigma: float) -> float:
            turned, path = low_pass(world, hips, sigma * fps)
            placed = positions_of(self.plan.target, turned, self.plan.target_hips, path)
            joints = [self.target.humanoid.joints[name] for name in END_JOINTS]
            return shake(placed[:, joints], fps, self.target_leg)

        if allowed < STILL:
            return 0.0
        return lightest(shown, MORE_SHAKE * allowed, LONGEST_SIGMA)

    def _hold(
        self,
        world: Array,
        placed: Array,
        hips: Array,
        contacts: GroundContacts,
        body: Float[Array, "frames joints"],
        source_floor: float,
        fps: float,
    ) -> tuple[Array, Array]:
        """The copied pose with its contacts held. `body` is how high the source's `BODY_JOINTS` are, in the target's size."""
        counts = np.cumsum([len(limb.points) for limb in self.target_limbs])[:-1]
        touching = np.split(contacts.touching, counts, axis=1)
        support = np.split((contacts.support - source_floor) * self.plan.scale + self.floor, counts, axis=1)
        points = support_points(self.target_limbs, world, placed)
        # The floor is no obstacle to a foot that goes below it in the source (a step down, a captured slope).
        sources = [
            (heights - source_floor) * self.plan.scale + self.floor
            for heights in np.split(contacts.heights, counts, axis=1)
        ]
        ground = [np.minimum(self.floor, heights.min(axis=1)) for heights in sources]
        leg = self.target_leg
        carriers = list(zip(points[:LEGS], touching[:LEGS], support[:LEGS]))
        own = carrier_positions(self.target, placed)
        for joint, height in enumerate(body.T[..., None]):  # who lies, kneels or crawls keeps those joints on the floor
            carriers.append((own[:, joint, None], height < LOW * leg, np.maximum(height, 0.0) + self.floor))
        lift = body_lift(*map(list, zip(*carriers)), leg, fps)[:, None] * [0.0, 1.0, 0.0]
        placed, hips = placed + lift[:, None], hips + lift
        goals = [
            limb_goal(limb, placed[:, limb.joints[2]], path + lift[:, None], rests, level, lowest, fps)
            for limb, path, rests, level, lowest in zip(self.target_limbs, points, touching, support, ground)
        ]
        drop = hip_drop(goals, placed, fps)
        poles = bend_directions(self.target.skeleton, self.target.humanoid)
        below = {limb.joints[2]: descendants(self.plan.target, limb.joints[2]) for limb in self.target_limbs}
        held = reach_goals(goals, world, placed, poles, drop, below)
        complete(self.plan, held)
        return held, hips - drop[:, None] * [0, 1, 0]

    def _motion(self, world: Array, hips: Float[Array, "frames 3"], source: Motion | None) -> Motion:
        """World rotations and hips as a motion of the target's skeleton."""
        skeleton, joint = self.plan.target, self.plan.target_hips
        rotations = rot.continuous(local_rotations(skeleton.parents, world))
        if joint == 0:
            translations, moved = hips[:, None], (0,)
        else:
            placed = positions_of(skeleton, world, joint, hips)
            above = int(skeleton.parents[joint])
            local = rot.rotate(rot.inverse(world[:, above]), hips - placed[:, above])
            root = np.broadcast_to(skeleton.offsets[0], hips.shape)
            translations, moved = np.stack([root, local], axis=1), (0, joint)
        return Motion(
            skeleton, rotations, translations, source.fps if source else 30.0, moved, source.name if source else ""
        )
