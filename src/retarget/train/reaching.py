"""Arms that reach for places on the body, for clips in which they touch something.

Contacts are few in recorded motions, and always the same ones. Here a spot of a hand, or of a forearm, is brought to a spot of any
other part: places are the sensors of `contact/part_field.py`, so what can be touched is what the network can see.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, world_pose
from retarget.character import Motion
from retarget.contact.part_field import FIGURES, PAIRS, PartField
from retarget.contact.sensor_bones import BONES
from retarget.train.poses import ARMS, drawn_arms

Array = np.ndarray

TRIES, CLOSER = 1500, 400
"""Arms that are drawn for each reach, and then around the best of them."""
NEARBY = np.radians(9.0)
"""How far around: standard deviation of every joint's turn."""
BEST = 7
"""Of each arm that are looked at together."""
CLOSE, DEEPEST = 0.15, 0.06
"""A hand is so close to some other part, mostly (`part_field_kernels`: one where surfaces meet), and no arm deeper in anything, in
shares of the height: mending takes it out."""
FACING = 0.05
"""What a hand that lies on a place with its wrong side costs, in shares of the height."""
IDLE, FOREARM = 0.12, 0.2
"""Shares of arms that go anywhere, and of reaches with the forearm."""
LIKELY = {
    "head": 3.0, "neck": 1.5, "chest": 2.0, "spine": 2.0, "Shoulder": 1.5, "UpperArm": 1.5, "LowerArm": 1.5, "Hand": 3.0,
    "UpperLeg": 1.5, "LowerLeg": 1.0, "Foot": 0.3,
}  # fmt: skip
"""How often each part is reached for; of paired ones each side's."""
HANDS = [number for number, (own, _) in enumerate(PAIRS) if own.endswith("Hand")]
ARM_PAIRS = [number for number, (own, _) in enumerate(PAIRS) if "Arm" in own or "Hand" in own]


@dataclass(frozen=True, eq=False)
class Arm:
    """One side's joints, and sensors that reach."""

    side: str
    joints: tuple[int, ...]
    """Shoulder, upper arm, forearm, hand."""
    rows: slice
    """Of `ARMS`."""


SIDES = (Arm("left", ARMS[:4], slice(0, 4)), Arm("right", ARMS[4:], slice(4, 8)))


def reaching_arms(motion: Motion, frame: int, field: PartField, draw: np.random.Generator) -> Float[Array, "arms 4"]:
    """Local rotations of both arms with which they touch the body in a frame, where some of those drawn do. `field` is the
    performer's own."""
    pose = replace(motion, rotations=motion.rotations[frame : frame + 1], translations=motion.translations[frame : frame + 1])
    found: list[Array] = []
    for arm in SIDES if draw.random() < 0.5 else SIDES[::-1]:
        found = [*found, _reached(pose, arm, field, draw)]
        turns = pose.rotations.copy()
        turns[0, arm.joints] = found[-1][0]
        pose = replace(pose, rotations=turns)
        if len(found) == 1:
            first = arm
    second = SIDES[1 - SIDES.index(first)]
    tried = np.repeat(pose.rotations, len(found[0]) * len(found[1]), axis=0)
    for row, (one, other) in enumerate(product(*found)):
        tried[row, first.joints], tried[row, second.joints] = one, other
    count = len(tried)
    seen = figures_of_pairs(replace(pose, rotations=tried, translations=np.repeat(pose.translations, count, axis=0)), field)
    nearest, deepest = seen[:, HANDS, 0].max(axis=1), seen[:, ARM_PAIRS, 15].max(axis=1)
    good = np.flatnonzero((nearest > CLOSE) & (deepest < DEEPEST))
    return tried[good[0] if len(good) else (nearest - 10.0 * deepest).argmax()][list(ARMS)]


def figures_of_pairs(motion: Motion, field: PartField) -> Float[Array, "frames pairs figures"]:
    """What a body's own field sees of its poses."""
    placed = world_pose(motion)
    seen = field.figures(field.source(*placed), field.target(*placed), *placed)[:, : len(PAIRS) * FIGURES]
    return seen.reshape(len(motion), len(PAIRS), FIGURES)


def _reached(pose: Motion, arm: Arm, field: PartField, draw: np.random.Generator) -> Float[Array, "best 4 4"]:
    """Turns of an arm that bring a spot of it to a spot of another part, the best first; now and then any."""
    if draw.random() < IDLE:
        return drawn_arms(1, draw)[:, arm.rows]
    world, places = world_pose(pose)
    spots, frames = (each[0] for each in field.source(world, places))
    own = arm.side + ("LowerArm" if draw.random() < FOREARM else "Hand")
    joint = arm.joints[2] if own.endswith("LowerArm") else arm.joints[3]
    reaching, wanted = _spot(own, field, draw), _spot(_wanted(arm.side, draw), field, draw)
    back = rot.inverse(world[0, joint])
    spot, normal = rot.rotate(back, spots[reaching] - places[0, joint]), rot.rotate(back, frames[reaching, :, 2])
    above = pose.skeleton.parents[arm.joints[0]]
    base, offsets = world[0, above], pose.skeleton.offsets[list(arm.joints)]

    def missed(turns: Float[Array, "tries 4 4"]) -> Float[Array, "tries"]:
        local = np.concatenate([np.broadcast_to(base, (len(turns), 1, 4)), turns], axis=1)
        chain = np.concatenate([places[:1, above], offsets])
        turned, placed = forward(np.arange(-1, 4), local, np.broadcast_to(chain, (len(turns), 5, 3)))
        which = 1 + arm.joints.index(joint)
        away = placed[:, which] + rot.rotate(turned[:, which], spot) - spots[wanted]
        against = rot.rotate(turned[:, which], normal) @ frames[wanted, :, 2]
        return np.linalg.norm(away, axis=1) / field.heights[0] + FACING * 0.5 * (1.0 + against)

    turns = drawn_arms(TRIES, draw)[:, arm.rows]
    best = turns[np.argsort(missed(turns))[:BEST]]
    around = rot.from_rotation_vector(NEARBY * draw.normal(size=(CLOSER, 4, 3)))
    turns = np.concatenate([best, rot.multiply(best[np.arange(CLOSER) % len(best)], around)])
    return turns[np.argsort(missed(turns))[:BEST]]


def _wanted(side: str, draw: np.random.Generator) -> str:
    """A part that an arm of this side may touch."""
    parts = [bone for bone in BONES if not (bone.startswith(side) and ("Arm" in bone or "Hand" in bone or "Shoulder" in bone))]
    chances = np.array([LIKELY[bone.removeprefix("left").removeprefix("right")] for bone in parts])
    return parts[int(draw.choice(len(parts), p=chances / chances.sum()))]


def _spot(bone: str, field: PartField, draw: np.random.Generator) -> int:
    """A sensor of a bone, among those used."""
    number = BONES.index(bone)
    return int(draw.integers(field.starts[number], field.starts[number + 1]))
