"""Metrics on joints and single points.

MPJPE, PA-MPJPE, Acc and PA-Acc are those of Rekik 2023 (3DV, section 4); what that paper leaves open is decided here
and said to be ours. The mean squared errors over height are those of four papers that share a name, not a formula.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.contact.ground import intervals
from retarget.errors import unknown_name
from retarget.evaluate.metrics.basis import at_reference_height, mean, positive, procrustes, require_alike

Array = np.ndarray


def angle_error_degrees(
    source: Float[Array, "frames directions 3"], target: Float[Array, "frames directions 3"]
) -> Float[Array, "frames directions"]:
    """Angle between two directions: atan2(|s x t|, s · t), degrees."""
    require_alike(source=source, target=target)
    source, target = rot.unit(source), rot.unit(target)
    sine = np.linalg.norm(np.cross(source, target), axis=-1)
    return np.degrees(np.arctan2(sine, (source * target).sum(axis=-1)))


def foot_slide_cm(
    points: Float[Array, "frames points 3"], touching: Bool[Array, "frames points"], height: float
) -> Float[Array, "contacts"]:
    """Horizontal slide of each contact: the largest horizontal distance between the point on any frame of the contact
    and its mean place over the contact, in cm at 1.7 m. One value a contact (point and interval)."""
    slides = []
    for point in range(points.shape[1]):
        for start, stop in intervals(touching[:, point]):
            path = points[start:stop, point][:, [0, 2]]
            slides.append(np.linalg.norm(path - path.mean(axis=0), axis=-1).max())
    return 100 * at_reference_height(np.array(slides), height)


def floor_error_cm(
    points: Float[Array, "frames points 3"],
    touching: Bool[Array, "frames points"],
    support: Float[Array, "frames points"],
    height: float,
) -> Float[Array, "contacts"]:
    """On each frame on which some point rests: |height above its support| of the lowest resting point, cm at 1.7 m."""
    over = np.where(touching, points[..., 1] - support, np.inf).min(axis=1)
    return 100 * at_reference_height(np.abs(over[np.isfinite(over)]), height)


def jerk(points: Float[Array, "frames points 3"], fps: float, leg_length: float) -> float:
    """Mean length of the third difference times fps³, over leg length (leg lengths a second cubed); 0 for fewer than
    four frames."""
    if len(points) < 4:
        return 0.0
    return float(np.linalg.norm(np.diff(points, n=3, axis=0), axis=-1).mean()) * fps**3 / leg_length


def position_error_cm(a: Float[Array, "frames joints 3"], b: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean joint distance (`mpjpe`), cm at 1.7 m."""
    return 100 * at_reference_height(mpjpe(a, b), height)


def mpjpe(result: Float[Array, "frames joints 3"], truth: Float[Array, "frames joints 3"]) -> float:
    """Mean per-joint position error: mean over frames and joints of |r - t|, metres (Rekik 2023, table 4)."""
    require_alike(truth=truth, result=result)
    return mean(np.linalg.norm(result - truth, axis=-1))


def pa_mpjpe(result: Float[Array, "frames joints 3"], truth: Float[Array, "frames joints 3"]) -> float:
    """MPJPE after Procrustes alignment, metres (Rekik 2023, table 4).

    Every frame is aligned on its own by rotation and translation, without scale (`procrustes`). The paper says only that
    alignment "eliminates the error in global displacement"; frame by frame and no scale are our choice: a result that
    is too large stays wrong.
    """
    return mpjpe(procrustes(result, truth), truth)


def acc(result: Float[Array, "frames joints 3"], truth: Float[Array, "frames joints 3"]) -> float:
    """Acceleration error: mean over joints and inner frames of |(r[f-1] - 2 r[f] + r[f+1]) - (t[f-1] - 2 t[f] + t[f+1])|,
    metres per frame squared (Rekik 2023, table 4). nan for fewer than three frames.

    The paper gives neither unit nor formula: the unit, and the length of the difference (not the difference of the
    lengths), are ours. Times fps² it is metres per second squared; compare only at one frame rate.
    """
    require_alike(truth=truth, result=result)
    return mean(np.linalg.norm(np.diff(result - truth, n=2, axis=0), axis=-1))


def pa_acc(result: Float[Array, "frames joints 3"], truth: Float[Array, "frames joints 3"]) -> float:
    """`acc` after the alignment of `pa_mpjpe`, metres per frame squared (Rekik 2023, table 4).

    Each frame has its own alignment (ours), so a smooth result whose error changes from frame to frame is moved
    unsmoothly: small figures mean more than large ones.
    """
    return acc(procrustes(result, truth), truth)


def _nkn(difference: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean over frames and joints of sum_xyz d² / h with lengths in centimetres: cm."""
    return 100 * mean((difference**2).sum(axis=-1)) / height


def _meshret(difference: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean over frames and joints of |d|² / h with lengths in metres: m."""
    return mean((difference**2).sum(axis=-1)) / height


def _san(difference: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean over frames, joints and the three axes of (d / h)²: no unit."""
    return mean((difference / height) ** 2)


def _star(difference: Float[Array, "frames joints 3"], height: float) -> float:
    """Mean over frames and joints of |d| / h, nothing squared: no unit."""
    return mean(np.linalg.norm(difference, axis=-1)) / height


MSE_DEFINITIONS = {"nkn": _nkn, "meshret": _meshret, "san": _san, "star": _star}
"""The four published errors that are all called MSE (over height), each of a difference in metres and a height."""


def mse_over_height(
    result: Float[Array, "frames joints 3"],
    truth: Float[Array, "frames joints 3"],
    height: float,
    definition: str = "meshret",
    local: bool = False,
) -> float:
    """The retargeting papers' "MSE", d = r - t, h = height in metres; `local`: both with their root (joint 0) subtracted.

    - `nkn` (Villegas 2018, PMnet 2019, by their code): mean of sum_xyz d² / h in centimetres, so 100 sum_xyz d² / h here;
    - `meshret` (Ye 2024, appendix B): mean of |d|² / h, metres;
    - `san` (Aberman 2020, by its code): mean, over the three axes too, of (d / h)², no unit;
    - `star` (STaR 2025, by its code): mean of |d| / h, no unit and not squared.

    So nkn = 100 meshret = 300 h san. Ye 2024 prints neither unit nor what the norm runs over; metres and the mean over
    frames and joints are ours. NKN and PMnet take as height the bones from hips to head plus one leg, less than the body's
    height: give that one to compare with their tables. STaR's local error also turns the body to face forward, ours does
    not. Raises `RetargetError` for an unknown definition.
    """
    require_alike(truth=truth, result=result)
    if definition not in MSE_DEFINITIONS:
        raise unknown_name("definition", definition, MSE_DEFINITIONS, "the published errors over height")
    difference = result - truth
    if local:
        difference = difference - difference[:, :1]
    return MSE_DEFINITIONS[definition](difference, positive("height", height))


def end_effector_position_error_cm(
    result: Float[Array, "frames effectors 3"], truth: Float[Array, "frames effectors 3"], height: float
) -> Float[Array, "effectors"]:
    """Mean over frames of |r - t| for each end effector (hands, feet, head), cm at 1.7 m. World positions, or both
    relative to their roots, on bodies of one height. The measure is common; no one paper is its source."""
    require_alike(truth=truth, result=result)
    return 100 * at_reference_height(_over_frames(np.linalg.norm(result - truth, axis=-1)), height)


def end_effector_orientation_error_degrees(
    result: Float[Array, "frames effectors 4"], truth: Float[Array, "frames effectors 4"]
) -> Float[Array, "effectors"]:
    """Mean over frames of the angle of r^-1 t for each end effector, degrees in [0, 180]; quaternions xyzw, rotations of
    the end effectors in the world.

    The quantity of Ye 2024's end-effector loss, |R_A - R_B|, as an angle (the paper names no norm). Between foreign rigs
    give the rotations since rest (R R_rest^-1), or the bones' own axes are measured.
    """
    require_alike(truth=truth, result=result)
    return np.degrees(_over_frames(rot.angle_between(result, truth)))


def _over_frames(values: Float[Array, "frames effectors"]) -> Float[Array, "effectors"]:
    """Mean over the frames, nan without a warning where there are none."""
    return values.mean(axis=0) if len(values) else np.full(values.shape[1], np.nan)
