"""What is usual of poses: how far joints turn from the rest pose, and how steadily they move."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.methods.scan.scan_body import BODY, scan_body

Array = np.ndarray

SWINGS: dict[str, tuple[float, float, float]] = {
    # joint: standard deviations in radians about the bone, about the hinge, and about what is left
    "spine": (0.25, 0.25, 0.25), "chest": (0.2, 0.2, 0.2), "upperChest": (0.2, 0.2, 0.2), "neck": (0.3, 0.3, 0.3),
    "head": (0.35, 0.35, 0.35), "Shoulder": (0.2, 0.2, 0.2), "UpperArm": (0.8, 1.2, 1.2), "LowerArm": (0.5, 1.5, 0.7),
    "Hand": (0.4, 0.5, 0.5), "UpperLeg": (0.4, 1.2, 0.6), "LowerLeg": (0.2, 1.5, 0.12), "Foot": (0.3, 0.8, 0.35),
    "Toes": (0.1, 0.3, 0.1),
}  # fmt: skip
"""Ours: wide where the points tell anyway. An elbow and a knee bend about one axis."""
UNSTEADY: dict[str, float] = {
    "hips": 0.05, "spine": 0.03, "chest": 0.02, "upperChest": 0.02, "neck": 0.05, "head": 0.05, "Shoulder": 0.03, "UpperArm": 0.08,
    "LowerArm": 0.1, "Hand": 0.1, "UpperLeg": 0.06, "LowerLeg": 0.08, "Foot": 0.08, "Toes": 0.05,
}  # fmt: skip
"""Standard deviation, in radians, of a joint's turn from what its speed foretells a thirtieth of a second later. Ours."""


def part_of(name: str) -> str:
    """The joint's name without its side."""
    return name.removeprefix("left").removeprefix("right")


@lru_cache(maxsize=1)
def usual_precision() -> Float[Array, "joints 3 3"]:
    """Inverse covariance of each joint's turn from its parent, about the parent's axes at rest; the root may turn freely."""
    body, names, precision = scan_body(), human_model().joint_names[:BODY], np.zeros((BODY, 3, 3))
    for joint in range(1, BODY):
        spread = np.array(SWINGS[part_of(names[joint])])
        below = np.flatnonzero(body.parents == joint)
        above = int(body.parents[joint])
        own = body.joints[joint] - body.joints[above]
        bone = rot.unit(body.joints[below].mean(axis=0) - body.joints[joint]) if len(below) else rot.unit(own)
        hinge = np.array([1.0, 0.0, 0.0])
        if part_of(names[joint]) == "LowerArm":
            hinge = rot.unit(np.cross(own, bone))  # forearms are bent a little at rest: about what they bend about
        hinge = rot.unit(hinge - (hinge @ bone) * bone)
        axes = np.stack([bone, hinge, np.cross(bone, hinge)])
        precision[joint] = axes.T @ (axes / spread[:, None] ** 2)
    return precision


@lru_cache(maxsize=1)
def steadiness() -> Float[Array, "joints"]:
    """Inverse squares of `UNSTEADY`, a joint each."""
    return np.array([UNSTEADY[part_of(name)] ** -2.0 for name in human_model().joint_names[:BODY]])
