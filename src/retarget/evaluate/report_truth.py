"""The part of a report that needs the true animation of the result's own character: Rekik 2023's errors and their kin."""

from __future__ import annotations

import numpy as np

from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.contact.carried import same_topology
from retarget.errors import RetargetError
from retarget.evaluate import metrics
from retarget.evaluate.metrics.surface import NEIGHBOURS
from retarget.evaluate.report_joints import ENDS, Figures
from retarget.evaluate.take import Take
from retarget.geometry.topology import weld

Array = np.ndarray

CHUNK = 16
"""Frames of two surfaces in memory at a time."""
OTHER_HEIGHT = 0.05
"""Share by which the heights of one character in two files may differ."""


def require_one_body(result: Take, truth: Take) -> None:
    """Raises `RetargetError` where the truth is another body."""
    names, theirs = (set(each.actor.skeleton.names) for each in (result, truth))
    if names != theirs:
        strange = sorted(names ^ theirs)[0]
        raise RetargetError(
            f"the truth must be an animation of the result's character; only one of them has a joint {strange!r}"
        )
    if abs(truth.actor.height / result.actor.height - 1) > OTHER_HEIGHT:
        raise RetargetError(
            "the truth must be an animation of the result's character; "
            f"it is {truth.actor.height:.2f} m tall, the result {result.actor.height:.2f} m"
        )


def truth_figures(result: Take, truth: Take) -> Figures:
    """Errors of the humanoid's joints, hips first, and of the vertices where both have them. The truth must be of the
    result's body (`require_one_body`) and as long."""
    joints = result.actor.humanoid.joints
    names = sorted(joints, key=lambda name: name != "hips")
    mine = [joints[name] for name in names]
    theirs = [truth.actor.skeleton.index(result.actor.skeleton.names[joint]) for joint in mine]
    made, right, height = result.positions[:, mine], truth.positions[:, theirs], result.actor.height
    figures: Figures = {
        "mpjpe": metrics.mpjpe(made, right),
        "pa_mpjpe": metrics.pa_mpjpe(made, right),
        "acc": metrics.acc(made, right),
        "pa_acc": metrics.pa_acc(made, right),
    }
    for local in (False, True):
        for definition in metrics.MSE_DEFINITIONS:
            key = f"{'local_' if local else ''}mse_{definition}"
            figures[key] = metrics.mse_over_height(made, right, height, definition, local)
    ends = [names.index(name) for name in ENDS if name != "hips"]
    distance = metrics.end_effector_position_error_cm(made[:, ends], right[:, ends], height)
    turn = metrics.end_effector_orientation_error_degrees(
        result.rotations[:, mine][:, ends], truth.rotations[:, theirs][:, ends]
    )
    figures["end_effector_position_error_cm"] = float(distance.mean())
    figures["end_effector_orientation_error_degrees"] = float(turn.mean())
    return figures | (_vertex_figures(result, truth) if result.has_surface and truth.has_surface else {})


def _vertex_figures(result: Take, truth: Take) -> Figures:
    """Means over frames, a few frames at a time; one vertex of each place. Empty where the meshes differ."""
    if not same_topology(result.actor.character, truth.actor.character):
        return {}
    rest = rest_vertices(result.actor.character)
    vertices = np.unique(weld(rest))
    if len(vertices) <= NEIGHBOURS:
        return {}
    skinners = [prepare_skinning(each.actor.character) for each in (result, truth)]
    sums: dict[str, float] = {}
    for start in range(0, len(result), CHUNK):
        part = slice(start, start + CHUNK)
        made, right = (
            skinner.vertices(each.rotations[part], each.positions[part])[:, vertices].astype(np.float64)
            for skinner, each in zip(skinners, (result, truth))
        )
        for name, metric in (("mpvd", metrics.mpvd), ("pa_mpvd", metrics.pa_mpvd), ("mdel", metrics.mdel)):
            sums[name] = sums.get(name, 0.0) + metric(made, right) * len(made)
    return {name: total / len(result) for name, total in sums.items()}
