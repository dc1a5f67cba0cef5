"""The performer of the embedded motions: anatomical axes of its arms and legs, and its skin, posed many times at once.

All rest rotations of the embedded human are the identity, so that a joint's own axes are the world's axes at rest; every
axis below is written in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, HumanModel, human, human_model
from retarget.body.kinematics import forward, rest_pose
from retarget.character import Character

Array = np.ndarray
SIDES = ("left", "right")
SIGN = {"left": 1.0, "right": -1.0}
X, Y, Z = np.eye(3)
FINGERS = ("Index", "Middle", "Ring", "Little")
PERFORMER = "thin"


@dataclass(frozen=True, eq=False)
class ArmAxes:
    """How one arm is built, at rest."""

    hang: Array
    """Rotation that lets the upper arm hang straight down, the elbow's hinge pointing to the body's right."""
    elbow: Array
    """Hinge of the elbow: turning about it bends the arm."""
    bent: float
    """Angle that the elbow has at rest, radians."""
    forearm: Array
    """Direction from elbow to wrist: turning about it pronates the left and supinates the right hand."""
    pronated: float
    """Pronation at rest, radians; zero has the palm of a hanging hand face the thigh."""
    wrist: Array
    """Turning about it bends the hand towards the palm."""
    radial: Array
    """Turning about it bends the hand towards the thumb."""
    fingers: dict[str, Array]
    """Joint name without side: the axis that curls it."""
    spread: dict[str, Array]
    """Joint name without side: the axis that spreads it, scaled by its share."""
    thumb: dict[str, Array]
    """`adduct` brings the thumb to the index finger, `oppose` before the palm, `curl` bends it."""


@dataclass(frozen=True, eq=False)
class LegAxes:
    """How one leg is built, at rest: bones hip to knee, knee to ankle, ankle to toes, and the knee's hinge."""

    thigh: Array
    shin: Array
    foot: Array
    hinge: Array
    heading: float
    """Angle about +Y of the foot's direction at rest."""


class Performer:
    """The embedded human that performs, with what the tools ask of it."""

    def __init__(self, character: Character, model: HumanModel) -> None:
        self.character, self.model = character, model
        self.skeleton = character.skeleton
        self.names, self.parents = self.skeleton.names, self.skeleton.parents
        self.joint = {name: i for i, name in enumerate(self.names)}
        self.rest = rest_pose(self.skeleton)[1]
        self.vertices, self.faces = character.mesh.vertices, character.mesh.faces
        skin = character.skin
        rows = np.repeat(np.arange(len(self.vertices)), skin.columns.shape[1])
        shape = (len(self.vertices), len(self.names))
        self.weights = sparse.csr_matrix((skin.weights.ravel(), (rows, skin.joints[skin.columns].ravel())), shape=shape)
        self.homogeneous = np.concatenate([self.vertices, np.ones((len(self.vertices), 1))], axis=1)
        self.palms = {}
        """Side: the direction that the palm faces at rest."""
        self.arms = {side: self._arm(side) for side in SIDES}
        self.legs = {side: self._leg(side) for side in SIDES}
        self.marks = dict(model.landmarks) | {name: v for side in SIDES for name, v in self._hand_marks(side).items()}

    def place(self, name: str) -> Array:
        """Rest position of a joint."""
        return self.rest[self.joint[name]]

    def landmark(self, name: str) -> int:
        return self.marks[name]

    def part(self, *names: str) -> Array:
        """Vertices of some body parts."""
        return np.concatenate([self.model.part_vertices(name) for name in names])

    def weight(self, *joints: str) -> Array:
        """How much each vertex follows some joints, from 0 to 1."""
        return np.asarray(self.weights[:, [self.joint[name] for name in joints]].sum(axis=1)).ravel()

    def around(self, landmark: str, radius: float, *parts: str) -> Array:
        """Vertices of some parts within `radius` metres of a landmark at rest, the nearest first."""
        distance = np.linalg.norm(self.vertices - self.vertices[self.landmark(landmark)], axis=1)
        near = self.part(*parts) if parts else np.arange(len(distance))
        near = near[distance[near] < radius]
        return near[np.argsort(distance[near], kind="stable")]

    def world(self, rotations: Array, root: Array) -> tuple[Array, Array]:
        """World rotations and positions (poses, joints, ...) of local rotations (poses, joints, 4) and hips (poses, 3)."""
        positions = np.broadcast_to(self.skeleton.offsets, (len(rotations), len(self.names), 3)).copy()
        positions[:, 0] = root
        return forward(self.parents, rotations, positions)

    def skin(self, world: tuple[Array, Array], chosen: Array | None = None) -> Array:
        """Posed vertices (poses, chosen, 3), in double precision (finite differences are taken of them)."""
        matrices = rot.to_matrix(world[0])
        moves = np.empty(matrices.shape[:-1] + (4,))
        moves[..., :3] = matrices
        moves[..., 3] = world[1] - np.einsum("bjik,jk->bji", matrices, self.rest)
        chosen = np.arange(len(self.vertices)) if chosen is None else chosen
        flat = moves.transpose(1, 0, 2, 3).reshape(len(self.names), -1)
        blended = (self.weights[chosen] @ flat).reshape(len(chosen), len(matrices), 3, 4)
        return np.einsum("vbij,vj->bvi", blended, self.homogeneous[chosen])

    def _hand_marks(self, side: str) -> dict[str, int]:
        """Vertices of palm and finger pads that touch things, by names like those of the model's landmarks."""
        at = lambda name: self.place(side + name)  # noqa: E731
        palm, along = self.palms[side], rot.unit(at("MiddleProximal") - at("Hand"))
        hand = np.isin(np.arange(len(self.vertices)), self.part(side + "Hand", side + "Forearm"))
        out = {}

        def mark(name: str, start: Array, direction: Array, mask: Array) -> None:
            offset = self.vertices - start
            ahead = offset @ direction
            beside = np.linalg.norm(offset - ahead[:, None] * direction, axis=1)
            out[side + name] = int(np.where(mask & (ahead > 0), beside, np.inf).argmin())

        index, little, middle = at("IndexProximal"), at("LittleProximal"), at("MiddleProximal")
        centre = 0.4 * at("Hand") + 0.6 * (index + little + middle) / 3
        mark("Palm", centre, palm, hand)
        mark("BackOfHand", centre, -palm, hand)
        mark("PalmHeel", 0.8 * at("Hand") + 0.2 * little, palm, hand)
        mark("ThumbBase", 0.5 * (at("ThumbMetacarpal") + at("ThumbProximal")), palm, hand)
        mark("IndexBase", index - 0.006 * along, palm, hand)
        mark("LittleBase", little - 0.006 * along, palm, hand)
        mark("MiddleBase", middle - 0.006 * along, palm, hand)
        mark("WristInside", at("Hand"), palm, hand)
        mark("WristOutside", at("Hand"), -palm, hand)
        for share, name in ((0.35, "Upper"), (0.6, ""), (0.85, "Lower")):
            point = at("LowerArm") + share * (at("Hand") - at("LowerArm"))
            mark(f"Forearm{name}Inside", point, palm, hand)
            mark(f"Forearm{name}Outside", point, -palm, hand)
        for finger in ("Thumb", *FINGERS):
            for name, bone in zip(("Near", "Mid", "Pad"), self._phalanges(side, finger), strict=True):
                joint = side + bone[0]
                mine = self.weight(joint) > 0.5
                if mine.any() and not (finger == "Thumb" and name == "Near"):
                    facing = palm - (palm @ rot.unit(bone[1])) * rot.unit(bone[1])
                    if finger == "Thumb":
                        facing = np.cross(self.arms[side].thumb["curl"], rot.unit(bone[1]))
                    mark(finger + name, self.place(joint) + 0.55 * bone[1], rot.unit(facing), mine)
        return out

    def _arm(self, side: str) -> ArmAxes:
        at = lambda name: self.place(side + name)  # noqa: E731
        upper, forearm = rot.unit(at("LowerArm") - at("UpperArm")), rot.unit(at("Hand") - at("LowerArm"))
        elbow = rot.unit(np.cross(upper, forearm))
        hang = rot.multiply(rot.from_frame(-Y, -X), rot.inverse(rot.from_frame(upper, elbow)))
        along = rot.unit(at("MiddleProximal") - at("Hand"))
        across = at("IndexProximal") - at("LittleProximal")
        across = rot.unit(across - (across @ along) * along)
        palm = self.palms[side] = -SIGN[side] * np.cross(across, along)
        medial = SIGN[side] * elbow  # where the palm looks when it faces the thigh
        facing = palm - (palm @ forearm) * forearm
        pronated = SIGN[side] * np.arctan2(np.cross(medial, facing) @ forearm, medial @ facing)
        fingers, spread = {}, {}
        for finger, share in zip(FINGERS, (1.0, 0.25, -0.5, -1.1), strict=True):
            for name, following in self._phalanges(side, finger):
                fingers[name] = rot.unit(np.cross(following, palm))
            spread[f"{finger}Proximal"] = share * rot.unit(np.cross(along, across))
        (_, metacarpal), (_, proximal), _ = self._phalanges(side, "Thumb")
        thumb = {
            "adduct": rot.unit(np.cross(metacarpal, along)),
            "oppose": rot.unit(np.cross(across, palm)),
            "curl": rot.unit(np.cross(proximal, palm - 0.8 * across)),
        }
        return ArmAxes(
            hang, elbow, float(np.arccos(upper @ forearm)), forearm, float(pronated),
            rot.unit(np.cross(along, palm)), rot.unit(np.cross(along, across)), fingers, spread, thumb,
        )  # fmt: skip

    def _phalanges(self, side: str, finger: str) -> list[tuple[str, Array]]:
        """(joint name without side, vector to the end of its bone) of a finger, from the palm to the tip."""
        bones = ("Metacarpal", "Proximal", "Distal") if finger == "Thumb" else ("Proximal", "Intermediate", "Distal")
        joints = [self.joint[f"{side}{finger}{bone}"] for bone in bones]
        ends = [*self.rest[joints[1:]], self.rest[joints[-1]] + self.skeleton.end_offsets[joints[-1]]]
        return [(f"{finger}{bone}", end - self.rest[j]) for bone, j, end in zip(bones, joints, ends, strict=True)]

    def _leg(self, side: str) -> LegAxes:
        hip, knee, ankle, toes = (self.place(side + name) for name in ("UpperLeg", "LowerLeg", "Foot", "Toes"))
        line = rot.unit(ankle - hip)
        foot = toes - ankle
        return LegAxes(knee - hip, ankle - knee, foot, rot.unit(X - (X @ line) * line), float(np.arctan2(foot[0], foot[2])))


@lru_cache(maxsize=1)
def performer() -> Performer:
    return Performer(human(name=PERFORMER, **PRESETS[PERFORMER]), human_model())
