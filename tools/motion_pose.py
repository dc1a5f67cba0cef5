"""What an animator moves: anatomical channels over time, and the joint rotations they stand for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from motion_body import FINGERS, SIDES, SIGN, Performer, X, Y, Z

from retarget.body import rotations as rot

Array = np.ndarray

ARM = (
    "raise", "forward",  # of the shoulder girdle
    "flex", "abduct", "internal",  # of the upper arm, from hanging straight down
    "elbow", "pronate", "wrist", "radial",
    "adduct", "oppose", "thumb",  # of the thumb
    "index", "middle", "ring", "little", "spread",  # of the fingers
)  # fmt: skip
"""The angles of one arm, radians; signs are the same on both sides. `elbow` 0 is straight, `pronate` 0 a palm to the thigh."""
LIMITS = np.radians([
    (-8, 32), (-15, 28), (-50, 175), (-45, 150), (-75, 95), (2, 148), (-85, 85), (-70, 75), (-18, 32),
    (-25, 35), (-20, 45), (-15, 60), (-15, 85), (-15, 85), (-15, 85), (-15, 85), (-12, 20),
])  # fmt: skip
"""Lowest and highest value of each of `ARM`: what shoulders, elbows, wrists and fingers of most adults do."""
RELAXED = dict(
    flex=3, abduct=7, internal=12, elbow=17, pronate=12, wrist=4, adduct=6, oppose=4, thumb=8,
    index=16, middle=22, ring=26, little=28, spread=-4,
)  # fmt: skip
"""An arm that hangs, degrees."""
FINGER_SHARES = {"Proximal": 0.85, "Intermediate": 1.05, "Distal": 0.6}
PRONATION_SHARE = 0.55
"""Part of the pronation that the forearm shows at the elbow; the rest happens at the wrist."""
SPINE = {"spine": 0.3, "chest": 0.4, "upperChest": 0.3}


def arm(**degrees: float) -> Array:
    """The angles (17,) of an arm, radians, from degrees by name; what is not named is as in a hanging arm."""
    unknown = set(degrees) - set(ARM)
    if unknown:
        raise KeyError(f"an arm has no angle {sorted(unknown)[0]!r}; it has {', '.join(ARM)}")
    values = RELAXED | degrees
    return np.radians([values.get(name, 0.0) for name in ARM])


@dataclass
class Channels:
    """One clip as its animator sees it; every array has a row a frame. Angles in radians, lengths in metres."""

    frames: int
    hips: Array = field(init=False)
    """World position of the hips joint."""
    turn: Array = field(init=False)
    """Of the pelvis: yaw (to the left), pitch (tilting forward), roll (left side up)."""
    trunk: Array = field(init=False)
    """Of the spine from hips to upper chest: flexion forward, twist to the left, lean to the right; a rotation vector."""
    look: Array = field(init=False)
    """Of the head in the world: yaw to the left, pitch downward, roll (left ear up)."""
    arms: dict[str, Array] = field(init=False)
    """Side: the angles named by `ARM`, (frames, 17)."""
    ankles: dict[str, Array] = field(init=False)
    """Side: world position of the foot joint."""
    feet: dict[str, Array] = field(init=False)
    """Side: of the foot in the world: yaw, pitch (toes down), roll (outer edge up on the left)."""
    toes: dict[str, Array] = field(init=False)
    """Side: how far the toes are bent up."""
    knees: dict[str, Array] = field(init=False)
    """Side: yaw of the direction in which the knee bends, in the world."""

    def __post_init__(self) -> None:
        n = self.frames
        self.hips, self.turn, self.trunk, self.look = (np.zeros((n, 3)) for _ in range(4))
        self.arms = {side: np.tile(arm(), (n, 1)) for side in SIDES}
        self.ankles, self.feet = ({side: np.zeros((n, 3)) for side in SIDES} for _ in range(2))
        self.toes, self.knees = ({side: np.zeros(n) for side in SIDES} for _ in range(2))


def yaw_pitch_roll(angles: Array) -> Array:
    """Quaternion of yaw about +Y, then pitch about the turned +X, then roll about the turned +Z."""
    return rot.from_euler(angles, "YXZ")


def pose(performer: Performer, act: Channels) -> tuple[Array, Array]:
    """Local rotations (frames, joints, 4) and hips positions (frames, 3) of a clip."""
    turns = np.broadcast_to(rot.IDENTITY, (act.frames, len(performer.names), 4)).copy()
    turns[:, 0] = yaw_pitch_roll(act.turn)
    pose_trunk(performer, act, turns)
    for side in SIDES:
        pose_arm(performer, side, act.arms[side], turns)
        pose_leg(performer, side, act, turns)
    return turns, act.hips


def pose_trunk(performer: Performer, act: Channels, turns: Array) -> None:
    """The spine bends evenly; neck and head make up what is missing to where the head looks."""
    chest = turns[:, 0]
    for name, share in SPINE.items():
        turns[:, performer.joint[name]] = rot.from_rotation_vector(act.trunk * share)
        chest = rot.multiply(chest, turns[:, performer.joint[name]])
    missing = rot.to_rotation_vector(rot.multiply(rot.inverse(chest), yaw_pitch_roll(act.look)))
    turns[:, performer.joint["neck"]] = rot.from_rotation_vector(missing * 0.45)
    turns[:, performer.joint["head"]] = rot.from_rotation_vector(missing * 0.55)


def pose_arm(performer: Performer, side: str, angles: Array, turns: Array) -> None:
    """Write the rotations of one arm and hand into `turns` (frames, joints, 4)."""
    axes, sign = performer.arms[side], SIGN[side]
    value = dict(zip(ARM, angles.T, strict=True))

    def about(axis: Array, angle: Array) -> Array:
        return rot.from_rotation_vector(axis * np.asarray(angle)[..., None])

    def put(name: str, *rotations: Array) -> None:
        total = rotations[0]
        for rotation in rotations[1:]:
            total = rot.multiply(total, rotation)
        turns[:, performer.joint[side + name]] = total

    put("Shoulder", rot.from_rotation_vector(sign * (Z * value["raise"][:, None] - Y * value["forward"][:, None])))
    swing = rot.from_rotation_vector(sign * Z * value["abduct"][:, None] - X * value["flex"][:, None])
    put("UpperArm", swing, about(-sign * Y, value["internal"]), axes.hang)
    pronate = sign * (value["pronate"] - axes.pronated)
    put("LowerArm", about(axes.elbow, value["elbow"] - axes.bent), about(axes.forearm, pronate * PRONATION_SHARE))
    bend = rot.from_rotation_vector(axes.wrist * value["wrist"][:, None] + axes.radial * value["radial"][:, None])
    put("Hand", about(axes.forearm, pronate * (1 - PRONATION_SHARE)), bend)
    for finger in FINGERS:
        for bone, share in FINGER_SHARES.items():
            curl = about(axes.fingers[finger + bone], value[finger.lower()] * share)
            put(finger + bone, about(axes.spread[f"{finger}Proximal"], value["spread"]), curl) if bone == "Proximal" else put(finger + bone, curl)
    put("ThumbMetacarpal", about(axes.thumb["oppose"], value["oppose"]), about(axes.thumb["adduct"], value["adduct"]))
    for bone, share in (("Proximal", 0.6), ("Distal", 0.9)):
        put("Thumb" + bone, about(axes.thumb["curl"], value["thumb"] * share))


def pose_leg(performer: Performer, side: str, act: Channels, turns: Array) -> None:
    """The leg that reaches from the hips to the ankle, in closed form; the knee is a hinge. `turns[:, 0]` is the pelvis."""
    axes, pelvis = performer.legs[side], turns[:, 0]
    hip = act.hips + rot.rotate(pelvis, performer.skeleton.offsets[performer.joint[side + "UpperLeg"]])
    line = act.ankles[side] - hip
    bend = knee_angle(performer, side, np.linalg.norm(line, axis=-1))
    knee = rot.from_rotation_vector(axes.hinge * bend[:, None])
    reach = axes.thigh + rot.rotate(knee, axes.shin)
    aside = np.stack([np.cos(act.knees[side]), np.zeros(act.frames), -np.sin(act.knees[side])], axis=-1)
    hinge = np.broadcast_to(axes.hinge, reach.shape)
    thigh = rot.multiply(rot.from_frame(line, aside), rot.inverse(rot.from_frame(reach, hinge)))
    sole = yaw_pitch_roll(act.feet[side])
    turns[:, performer.joint[side + "UpperLeg"]] = rot.multiply(rot.inverse(pelvis), thigh)
    turns[:, performer.joint[side + "LowerLeg"]] = knee
    turns[:, performer.joint[side + "Foot"]] = rot.multiply(rot.inverse(rot.multiply(thigh, knee)), sole)
    turns[:, performer.joint[side + "Toes"]] = rot.from_rotation_vector(-X * act.toes[side][:, None])


def knee_angle(performer: Performer, side: str, distance: Array) -> Array:
    """How far the knee is turned from rest so that hip and ankle are `distance` metres apart (at most stretched)."""
    axes = performer.legs[side]
    along = (axes.thigh @ axes.hinge, axes.shin @ axes.hinge)
    thigh, shin = axes.thigh - along[0] * axes.hinge, axes.shin - along[1] * axes.hinge
    a, b = np.linalg.norm(thigh), np.linalg.norm(shin)
    start = np.arctan2(np.cross(thigh, shin) @ axes.hinge, thigh @ shin)
    cosine = (distance**2 - (along[0] + along[1]) ** 2 - a**2 - b**2) / (2 * a * b)
    return np.arccos(np.clip(cosine, -1.0, np.cos(np.radians(4)))) - start


def leg_reach(performer: Performer, side: str) -> float:
    """The longest distance from hip to ankle that leaves the knee bent by four degrees, metres."""
    axes = performer.legs[side]
    a, b = np.linalg.norm(axes.thigh), np.linalg.norm(axes.shin)
    return float(np.sqrt(a * a + b * b + 2 * a * b * np.cos(np.radians(4))))
