"""What is measured, on plain numpy arrays: every figure exactly once, its formula, unit and source in its docstring and in
one sentence in `formulas.py`.

`skeletal` compares joints, `surface` vertices, `interaction` contacts and penetration, `rig` weights, joints, maps and rest shapes.
`result` is what a method made, `truth` what it should have made (same body), `source` what it was made from.
Lengths named cm or mm are quoted at a body height of 1.7 m, so that a child and a giant read alike; lengths in metres are
as they are, as in the papers. A mean over nothing (no contact, too few frames) is nan: neither good nor bad.
"""

from retarget.evaluate.metrics.basis import REFERENCE_HEIGHT, procrustes
from retarget.evaluate.metrics.interaction import (
    SLACK,
    contact_error,
    contacts_gained,
    contacts_kept,
    depth_mean_mm,
    depth_p95_mm,
    excess_penetration_percent,
    new_part_penetration_percent,
    new_penetration_percent,
    part_penetration_percent,
    penetration_percent,
)
from retarget.evaluate.metrics.rig import (
    flipped_percent,
    joint_error_cm,
    map_error_percent,
    registration_mm,
    rest_vertex_error_cm,
    torn_percent,
    weight_mse_x100,
)
from retarget.evaluate.metrics.skeletal import (
    MSE_DEFINITIONS,
    acc,
    angle_error_degrees,
    end_effector_orientation_error_degrees,
    end_effector_position_error_cm,
    floor_error_cm,
    foot_slide_cm,
    jerk,
    mpjpe,
    mse_over_height,
    pa_acc,
    pa_mpjpe,
    position_error_cm,
)
from retarget.evaluate.metrics.surface import mdel, mpvd, pa_mpvd, volume_error_percent

__all__ = [
    "MSE_DEFINITIONS",
    "REFERENCE_HEIGHT",
    "SLACK",
    "acc",
    "angle_error_degrees",
    "contact_error",
    "contacts_gained",
    "contacts_kept",
    "depth_mean_mm",
    "depth_p95_mm",
    "end_effector_orientation_error_degrees",
    "end_effector_position_error_cm",
    "excess_penetration_percent",
    "flipped_percent",
    "floor_error_cm",
    "foot_slide_cm",
    "jerk",
    "joint_error_cm",
    "map_error_percent",
    "mdel",
    "mpjpe",
    "mpvd",
    "mse_over_height",
    "new_part_penetration_percent",
    "new_penetration_percent",
    "pa_acc",
    "pa_mpjpe",
    "pa_mpvd",
    "part_penetration_percent",
    "penetration_percent",
    "position_error_cm",
    "procrustes",
    "registration_mm",
    "rest_vertex_error_cm",
    "torn_percent",
    "volume_error_percent",
    "weight_mse_x100",
]
