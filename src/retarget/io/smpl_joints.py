"""The joints of the SMPL family: which bodies there are, what their joints are called, and which hangs on which.

Order and hierarchy are those of the published models: SMPL (Loper 2015), SMPL+H (Romero 2017), SMPL-X (Pavlakos 2019).
All share the first 22 joints. At rest every local rotation is the identity: the body stands in a T, +Y up, facing +Z,
its left at +X.
"""

from __future__ import annotations

from dataclasses import dataclass

_TRUNK = {
    "pelvis": "", "left_hip": "pelvis", "right_hip": "pelvis", "spine1": "pelvis", "left_knee": "left_hip",
    "right_knee": "right_hip", "spine2": "spine1", "left_ankle": "left_knee", "right_ankle": "right_knee",
    "spine3": "spine2", "left_foot": "left_ankle", "right_foot": "right_ankle", "neck": "spine3",
    "left_collar": "spine3", "right_collar": "spine3", "head": "neck", "left_shoulder": "left_collar",
    "right_shoulder": "right_collar", "left_elbow": "left_shoulder", "right_elbow": "right_shoulder",
    "left_wrist": "left_elbow", "right_wrist": "right_elbow",
}  # fmt: skip
_HAND_ENDS = {"left_hand": "left_wrist", "right_hand": "right_wrist"}
_FACE = {"jaw": "head", "left_eye_smplhf": "head", "right_eye_smplhf": "head"}
_FINGERS = {
    f"{side}_{finger}{bone}": f"{side}_wrist" if bone == 1 else f"{side}_{finger}{bone - 1}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for bone in (1, 2, 3)
}


@dataclass(frozen=True)
class Family:
    """One kind of body: its joints, each with its parent ('' for the root), in the order of the files."""

    name: str
    joints: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.joints)

    @property
    def parents(self) -> tuple[int, ...]:
        """Index of each joint's parent, -1 for the root."""
        return tuple(self.names.index(parent) if parent else -1 for parent in self.joints.values())

    @property
    def shape_space(self) -> str:
        """Which models its betas belong to: SMPL and SMPL+H share theirs."""
        return "SMPL-X" if self.name == "SMPL-X" else "SMPL"


FAMILIES: dict[int, Family] = {
    22: Family("SMPL body", _TRUNK),
    24: Family("SMPL", _TRUNK | _HAND_ENDS),
    52: Family("SMPL+H", _TRUNK | _FINGERS),
    55: Family("SMPL-X", _TRUNK | _FACE | _FINGERS),
}
"""By number of joints. The 22 are what all share: archives without hands."""

CANONICAL = {
    "pelvis": "hips",
    "spine1": "spine",
    "spine2": "chest",
    "spine3": "upperChest",
    "neck": "neck",
    "head": "head",
}
CANONICAL |= {
    f"{side}_{name}": f"{side}{part}"
    for side in ("left", "right")
    for name, part in {
        "hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes",
        "collar": "Shoulder", "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand",
        "thumb1": "ThumbMetacarpal", "thumb2": "ThumbProximal", "thumb3": "ThumbDistal",
        **{f"{finger}{bone}": part + phalanx
           for finger, part in {"index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Little"}.items()
           for bone, phalanx in enumerate(("Proximal", "Intermediate", "Distal"), 1)},
    }.items()
}  # fmt: skip
"""SMPL's joints by their names in VRM 1.0, which the embedded human's joints carry; face and hand ends are left out."""
