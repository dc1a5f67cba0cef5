"""The finer shape components of the embedded human: MakeHuman's detail targets under plain names."""

from __future__ import annotations

import numpy as np
from human_source import Source, read_target

# name: target files without their ending; "-decr" is the component at -1, "-incr" at +1; several are added up.
DETAILS: dict[str, tuple[str, ...]] = {
    "belly": ("stomach/stomach-pregnant",),
    "stomach_tone": ("stomach/stomach-tone",),
    "waist": ("torso/measure-waist-circ",),
    "hips": ("torso/measure-hips-circ",),
    "hip_width": ("hip/hip-scale-horiz",),
    "buttocks": ("buttocks/buttocks-volume",),
    "bust": ("torso/measure-bust-circ",),
    "underbust": ("torso/measure-underbust-circ",),
    "pectorals": ("torso/torso-muscle-pectoral",),
    "back_muscles": ("torso/torso-muscle-dorsi",),
    "v_shape": ("torso/torso-vshape",),
    "shoulder_width": ("torso/measure-shoulder-dist",),
    "torso_width": ("torso/torso-scale-horiz",),
    "torso_depth": ("torso/torso-scale-depth",),
    "torso_length": ("torso/torso-scale-vert",),
    "neck_girth": ("neck/measure-neck-circ",),
    "neck_length": ("neck/measure-neck-height",),
    "double_chin": ("neck/neck-double",),
    "head_size": ("head/head-scale-horiz", "head/head-scale-depth", "head/head-scale-vert"),
    "head_width": ("head/head-scale-horiz",),
    "head_height": ("head/head-scale-vert",),
    "face_fat": ("head/head-fat",),
    "head_age": ("head/head-age",),
    "upper_arm_length": ("arms/measure-upperarm-length",),
    "forearm_length": ("arms/measure-lowerarm-length",),
    "upper_arm_girth": ("arms/measure-upperarm-circ",),
    "upper_arm_fat": ("arms/l-upperarm-fat", "arms/r-upperarm-fat"),
    "upper_arm_muscle": ("arms/l-upperarm-muscle", "arms/r-upperarm-muscle"),
    "shoulder_muscle": ("arms/l-upperarm-shoulder-muscle", "arms/r-upperarm-shoulder-muscle"),
    "forearm_fat": ("arms/l-lowerarm-fat", "arms/r-lowerarm-fat"),
    "forearm_muscle": ("arms/l-lowerarm-muscle", "arms/r-lowerarm-muscle"),
    "wrist_girth": ("hands/measure-wrist-circ",),
    "hand_size": ("hands/l-hand-scale", "hands/r-hand-scale"),
    "finger_length": ("hands/l-hand-fingers-length", "hands/r-hand-fingers-length"),
    "finger_thickness": ("hands/l-hand-fingers-diameter", "hands/r-hand-fingers-diameter"),
    "thigh_length": ("legs/measure-upperleg-height",),
    "shin_length": ("legs/measure-lowerleg-height",),
    "thigh_girth": ("legs/measure-thigh-circ",),
    "thigh_fat": ("legs/l-upperleg-fat", "legs/r-upperleg-fat"),
    "thigh_muscle": ("legs/l-upperleg-muscle", "legs/r-upperleg-muscle"),
    "knee_girth": ("legs/measure-knee-circ",),
    "calf_girth": ("legs/measure-calf-circ",),
    "calf_muscle": ("legs/l-lowerleg-muscle", "legs/r-lowerleg-muscle"),
    "ankle_girth": ("feet/measure-ankle-circ",),
    "knock_knees": ("legs/l-leg-valgus", "legs/r-leg-valgus"),
    "foot_size": ("feet/l-foot-scale", "feet/r-foot-scale"),
}


def detail_targets(source: Source, count: int) -> np.ndarray:
    """Offsets (2 a component, count, 3) in metres: the component at -1, then at +1."""
    return np.array(
        [
            sum(read_target(source, f"{file}-{end}", count) for file in files)
            for files in DETAILS.values()
            for end in ("decr", "incr")
        ],
        dtype=np.float32,
    )
