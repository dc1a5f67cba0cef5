"""Anatomical frames: one way of saying how a limb is turned, the same on every skeleton.

Rigs disagree on rest pose, bone axes and roll. What they share is anatomy: an upper arm points from shoulder to
elbow, a palm has a back, a foot has a sole. For each canonical joint we fix, at rest, the world rotation of a frame
built from that alone; `joint_from_frame` then tells how the joint's own axes sit in it, in every pose. Copying the
world rotation of these frames from one body to another copies directions exactly and neither invents nor loses twist.

Frames by kind (x, y, z of the frame):
- trunk, head, shoulders, eyes, jaw: left, up, forward of the body at rest: such joints keep the target's own posture;
- limbs and fingers: the bone's direction, then a second axis carried over from the T-pose by the smallest turn (up for
  arms, forward for legs), or measured where the body shows it (back of the hand from the knuckles);
- feet and toes: heading of the foot, sole normal.
This replaces the ritual of T-poses; the choice of axes is ours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton
from retarget.correspond.joints import HUMANOID_JOINTS, Humanoid

Array = np.ndarray

SIDES = ("left", "right")
FINGERS = ("Index", "Middle", "Ring", "Little")
LIMBS = {
    f"{side}{part}": f"{side}{end}"
    for side in SIDES
    for part, end in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot"))
}
"""Each limb segment and the joint where it ends."""
UPRIGHT = np.cos(np.radians(25))
"""A trunk within 25 degrees of the vertical stands upright: its lean is the character's shape, not a pose."""


def trunk_frame(axes: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Left, up, forward of the body at rest; exactly upright when nearly so."""
    left, up = axes[0], axes[1]
    if up[1] > UPRIGHT:
        up = np.array([0.0, 1.0, 0.0])
    return rot.from_frame(left - (left @ up) * up, up)


Soles = dict[str, Float[Array, "3"]]
"""Upward normals of the soles in their foot joints' frames, by side, where they are known better than from the rest pose."""


def rest_frames(skeleton: Skeleton, humanoid: Humanoid, soles: Soles | None = None) -> dict[str, Float[Array, "4"]]:
    """World rotation, at rest, of the anatomical frame of every matched joint."""
    body = _Body(skeleton, humanoid, soles or {})
    frames = {}
    for name in HUMANOID_JOINTS:
        if name in humanoid.joints:
            frames[name] = body.frame(name, frames)
    return frames


def joint_from_frame(
    skeleton: Skeleton, humanoid: Humanoid, soles: Soles | None = None
) -> dict[str, Float[Array, "4"]]:
    """The constant K with `R_world_frame = R_world_joint · K` in every pose, for every matched joint."""
    rotations, _ = rest_pose(skeleton)
    return {
        name: rot.multiply(rot.inverse(rotations[humanoid.joints[name]]), frame)
        for name, frame in rest_frames(skeleton, humanoid, soles).items()
    }


def bend_directions(skeleton: Skeleton, humanoid: Humanoid) -> dict[str, Float[Array, "3"]]:
    """Where knees and elbows point when they bend (knees forward, elbows back), in the frame of the limb's first joint."""
    K = joint_from_frame(skeleton, humanoid)
    y, z = np.eye(3)[1:]
    back = {"left": -z, "right": z}  # the arm's frame has x outward and y up, so its z is forward on the left only
    return {f"{side}Leg": rot.rotate(K[f"{side}UpperLeg"], y) for side in SIDES} | {
        f"{side}Arm": rot.rotate(K[f"{side}UpperArm"], back[side]) for side in SIDES
    }


class _Body:
    """What the frames are measured from: rest positions by canonical name, and the trunk's axes."""

    def __init__(self, skeleton: Skeleton, humanoid: Humanoid, soles: Soles) -> None:
        self.skeleton, self.joints, self.soles = skeleton, humanoid.joints, soles
        self.rotations, self.positions = rest_pose(skeleton)
        self.trunk = trunk_frame(humanoid.axes)
        self.left, self.up, self.forward = (rot.rotate(self.trunk, axis) for axis in np.eye(3))

    def frame(self, name: str, done: dict[str, Array]) -> Float[Array, "4"]:
        side = (
            name[: len("left")] if name.startswith("left") else name[: len("right")] if name.startswith("right") else ""
        )
        if name in LIMBS and LIMBS[name] in self.joints:
            return self._limb(name, side)
        if name.endswith("Hand"):
            return self._hand(side)
        if name.endswith(("Foot", "Toes")):
            return self._foot(side)
        if "Thumb" in name or any(finger in name for finger in FINGERS):
            return self._finger(name, side, done.get(f"{side}Hand"))
        return self.trunk

    def place(self, name: str) -> Float[Array, "3"] | None:
        return self.positions[self.joints[name]] if name in self.joints else None

    def outward(self, side: str) -> Float[Array, "3"]:
        return self.left if side == "left" else -self.left

    def end(self, joint: int) -> Float[Array, "3"] | None:
        """World place where a childless bone ends, if the skeleton says so; a single child also ends its parent."""
        ends = self.skeleton.end_offsets or {}
        if joint in ends:
            return self.positions[joint] + rot.rotate(self.rotations[joint], ends[joint])
        children = self.skeleton.children(joint)
        return self.positions[children[0]] if len(children) == 1 else None

    def _limb(self, name: str, side: str) -> Float[Array, "4"]:
        along = self.place(LIMBS[name]) - self.place(name)
        arm = name.endswith("Arm")
        resting, second = (self.outward(side), self.up) if arm else (-self.up, self.forward)
        carried = rot.rotate(rot.swing_between(resting, along), second)
        if name.endswith("LowerArm"):
            # Turning the palm turns the forearm with it: follow the hand, where the hand shows its back.
            hand = self._back_of_hand(side)
            carried = carried if hand is None else _normal_to(hand, along, carried)
        return rot.from_frame(along, carried)

    def _hand(self, side: str) -> Float[Array, "4"]:
        along = self._hand_direction(side)
        back = self._back_of_hand(side)
        carried = rot.rotate(rot.swing_between(self.outward(side), along), self.up)
        return rot.from_frame(along, carried if back is None else _normal_to(back, along, carried))

    def _hand_direction(self, side: str) -> Float[Array, "3"]:
        hand = self.place(f"{side}Hand")
        knuckles = [self.place(f"{side}{finger}Proximal") for finger in ("Middle", "Index", "Ring")]
        knuckles = [knuckle for knuckle in knuckles if knuckle is not None]
        forearm = hand - self.place(f"{side}LowerArm")
        if not knuckles:
            # Fingerless rigs show no wrist bend at rest: the hand goes on where the forearm points.
            return forearm
        along = knuckles[0] - hand
        return along if np.linalg.norm(along) > 0.05 * np.linalg.norm(forearm) else forearm

    def _back_of_hand(self, side: str) -> Float[Array, "3"] | None:
        """Direction out of the back of the hand, from the row of knuckles; None for a hand that does not show it."""
        first = next((p for f in ("Index", "Middle") if (p := self.place(f"{side}{f}Proximal")) is not None), None)
        last = next((p for f in ("Little", "Ring") if (p := self.place(f"{side}{f}Proximal")) is not None), None)
        along = self._hand_direction(side)
        if first is None or last is None:
            return None
        across = first - last
        across = across - (across @ rot.unit(along)) * rot.unit(along)
        if np.linalg.norm(across) < 0.02 * np.linalg.norm(self.place(f"{side}Hand") - self.place(f"{side}LowerArm")):
            return None
        back = np.cross(across, along)
        return back if side == "left" else -back

    def _foot(self, side: str) -> Float[Array, "4"]:
        """Heading of the foot and the sole's normal. At rest a foot stands flat, whatever its ankle bone's slope."""
        foot, toes = self.place(f"{side}Foot"), self.place(f"{side}Toes")
        toes = self.end(self.joints[f"{side}Foot"]) if toes is None else toes
        along = self.forward if toes is None else toes - foot
        if side in self.soles:
            normal = rot.rotate(self.rotations[self.joints[f"{side}Foot"]], self.soles[side])
            return rot.from_frame(along - (along @ normal) * normal, normal)
        heading = along - (along @ self.up) * self.up
        length = np.linalg.norm(along)
        if np.linalg.norm(heading) > 0.35 * length and heading @ self.forward > 0 and along @ self.up < 0.5 * length:
            return rot.from_frame(heading, self.up)
        # A foot hanging down at rest, or pointing up as in sitting on the ground: turn it from the usual slope
        # of an ankle bone, 30 degrees below the horizontal.
        usual = np.cos(np.pi / 6) * self.forward - np.sin(np.pi / 6) * self.up
        turn = rot.swing_between(usual, along)
        return rot.from_frame(rot.rotate(turn, self.forward), rot.rotate(turn, self.up))

    def _finger(self, name: str, side: str, hand: Array | None) -> Float[Array, "4"]:
        joint = self.joints[name]
        following = self.end(joint)
        if following is None:
            above = self.skeleton.parents[joint]
            following = 2 * self.positions[joint] - self.positions[above]
        along = following - self.positions[joint]
        if np.linalg.norm(along) < 1e-9 or hand is None:
            return hand if hand is not None else self.trunk
        turn = rot.swing_between(rot.rotate(hand, np.array([1.0, 0, 0])), along)
        return rot.from_frame(along, rot.rotate(turn, rot.rotate(hand, np.array([0, 1.0, 0]))))


def _normal_to(
    measured: Float[Array, "3"], along: Float[Array, "3"], otherwise: Float[Array, "3"]
) -> Float[Array, "3"]:
    """`measured` made normal to `along`, or `otherwise` where the two are nearly parallel."""
    line = rot.unit(along)
    normal = rot.unit(measured) - (rot.unit(measured) @ line) * line
    return normal if np.linalg.norm(normal) > 0.3 else otherwise
