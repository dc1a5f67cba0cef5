"""Joint limits as soft bounds: a copied rotation that no body can do is eased back towards what it can.

Limits are stated between anatomical frames (`anatomy.py`), so one table serves every rig. They are generous: captured
people stay inside, only broken or cartoon input is touched, and beyond a limit the angle still grows, ever less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.motion.align import Actor
from retarget.motion.anatomy import SIDES, joint_from_frame

Array = np.ndarray

MARGIN = np.radians(10)
"""How far an angle can go beyond its limit at most."""
X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class Limit:
    """Bounds of one joint against another that carries it."""

    joint: int
    carrier: int
    frame: Float[Array, "4"]
    """Joint-from-frame."""
    carrier_frame: Float[Array, "4"]
    """Carrier-from-frame, in the pose that counts as zero."""
    axis: Float[Array, "3"]
    """What twist turns about, in the joint's frame."""
    swing: float
    twist: float
    """Radians."""
    hinge: Float[Array, "3"] | None = None
    """Axis, in the carrier's frame, about which the joint must hardly turn the positive way: a knee does not bend
    forward. None for joints that bend any way (and for elbows, whose hinge a rest pose does not show reliably)."""


# Canonical joint, what carries it, largest swing and twist in degrees (ours; about 1.2 times what physiotherapy tables
# give for active movement, because captured joints are not anatomical ones). Twist turns about the bone.
_TABLE = (
    ("LowerArm", "UpperArm", 165, 140),
    ("Hand", "LowerArm", 105, 130),
    ("UpperLeg", "hips", 150, 85),
    ("LowerLeg", "UpperLeg", 165, 75),
    ("Foot", "LowerLeg", 85, 70),
)
_HEAD = ("head", "chest", 95, 110)
HYPEREXTENSION = np.radians(15)
"""How far a hinge opens beyond straight."""


def joint_limits(actor: Actor) -> tuple[Limit, ...]:
    """The limits that apply to a body."""
    K = joint_from_frame(actor.skeleton, actor.humanoid)
    joints = actor.humanoid.joints
    limits = []
    for side in SIDES:
        for part, carrier, swing, twist in _TABLE:
            below, above = f"{side}{part}", carrier if carrier == "hips" else f"{side}{carrier}"
            zero = rot.multiply(K[above], _neutral(part, side))
            hinge = Z if part == "LowerLeg" else None
            bounds = np.radians(swing), np.radians(twist)
            limits.append(Limit(joints[below], joints[above], K[below], zero, X, *bounds, hinge))
    name, carrier, swing, twist = _HEAD
    above = next(each for each in ("upperChest", carrier, "spine", "hips") if each in joints)
    limits.append(Limit(joints[name], joints[above], K[name], K[above], Y, np.radians(swing), np.radians(twist)))
    return tuple(limits)


def _neutral(part: str, side: str) -> Float[Array, "4"]:
    """The joint's frame seen from its carrier's, standing with straight limbs."""
    if part == "UpperLeg":
        return rot.from_frame(-Y, Z)
    if part == "Foot":
        return rot.from_frame(Y, -X)
    return rot.IDENTITY


def ease_into_limits(limits: tuple[Limit, ...], world: Float[Array, "frames joints 4"]) -> int:
    """Ease world rotations into the limits, in place; returns on how many frames something changed.

    Only the joint itself turns: what it carries keeps its world rotation, so hands and feet stay as they were copied.
    """
    touched = np.zeros(len(world), dtype=bool)
    for limit in limits:
        zero = rot.multiply(world[:, limit.carrier], limit.carrier_frame)
        turn = rot.multiply(rot.inverse(zero), rot.multiply(world[:, limit.joint], limit.frame))
        twist = rot.twist_about(turn, limit.axis)
        swing = rot.multiply(turn, rot.inverse(twist))
        over = (_angle(swing) > limit.swing) | (_angle(twist) > limit.twist)
        if limit.hinge is not None:
            over |= rot.to_rotation_vector(swing) @ limit.hinge > HYPEREXTENSION
        if not over.any():
            continue
        touched |= over
        eased = rot.multiply(_closed(_eased(swing[over], limit.swing), limit.hinge), _eased(twist[over], limit.twist))
        world[over, limit.joint] = rot.multiply(rot.multiply(zero[over], eased), rot.inverse(limit.frame))
    return int(touched.sum())


def _angle(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch"]:
    return 2 * np.arctan2(np.linalg.norm(q[..., :3], axis=-1), np.abs(q[..., 3]))


def _eased(q: Float[Array, "frames 4"], limit: float) -> Float[Array, "frames 4"]:
    """The same axis with the angle bent towards limit + margin, smoothly from the limit on."""
    vector = rot.to_rotation_vector(q)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return rot.from_rotation_vector(vector * _bent(angle, limit) / np.maximum(angle, 1e-12))


def _closed(swing: Float[Array, "frames 4"], hinge: Float[Array, "3"] | None) -> Float[Array, "frames 4"]:
    """The swing whose part about the hinge hardly opens beyond straight."""
    if hinge is None:
        return swing
    vector = rot.to_rotation_vector(swing)
    open_by = vector @ hinge
    return rot.from_rotation_vector(vector + (_bent(open_by, HYPEREXTENSION) - open_by)[:, None] * hinge)


def _bent(angle: Float[Array, "*frames"], limit: float) -> Float[Array, "*frames"]:
    return np.where(angle > limit, limit + MARGIN * (1 - np.exp(-np.maximum(angle - limit, 0) / MARGIN)), angle)


@dataclass(frozen=True, eq=False)
class LimitBounds:
    """The limits of a body side by side, for solvers; `stack_limits` makes one. Fields as in `Limit`."""

    joints: Int[Array, "limits"]
    carriers: Int[Array, "limits"]
    frames: Float[Array, "limits 4"]
    carrier_frames: Float[Array, "limits 4"]
    axes: Float[Array, "limits 3"]
    most: Float[Array, "limits 3"]
    """Largest swing, twist and turn about the hinge, radians."""
    hinges: Float[Array, "limits 3"]
    """Zero where there is none."""

    def allowed(self, world: Float[Array, "frames joints 4"]) -> Float[Array, "frames limits 3"]:
        """How far each joint may swing, twist and turn about its hinge where a pose (world rotations) may stay: the limits
        with their margin, or what the pose itself has."""
        zero = rot.multiply(world[:, self.carriers], self.carrier_frames)
        turn = rot.multiply(rot.inverse(zero), rot.multiply(world[:, self.joints], self.frames))
        twist = rot.twist_about(turn, self.axes)
        swing = rot.multiply(turn, rot.inverse(twist))
        about = (rot.to_rotation_vector(swing) * self.hinges).sum(axis=-1)
        return np.maximum(self.most + MARGIN, np.stack([_angle(swing), _angle(twist), about], axis=-1))


def stack_limits(limits: tuple[Limit, ...]) -> LimitBounds:
    """The same limits as arrays."""
    return LimitBounds(
        np.array([limit.joint for limit in limits]),
        np.array([limit.carrier for limit in limits]),
        np.array([limit.frame for limit in limits]),
        np.array([limit.carrier_frame for limit in limits]),
        np.array([limit.axis for limit in limits]),
        np.array([(limit.swing, limit.twist, np.inf if limit.hinge is None else HYPEREXTENSION) for limit in limits]),
        np.array([np.zeros(3) if limit.hinge is None else limit.hinge for limit in limits]),
    )
