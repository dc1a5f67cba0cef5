"""Which of two is left: the body's own axes, and which way it faces, from the rest pose."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.body.rotations import unit
from retarget.correspond.joints_by_name import NameScores
from retarget.correspond.joints_by_shape import Body
from retarget.correspond.skeleton_tree import Tree

Array = np.ndarray


def body_axes(tree: Tree, body: Body) -> Float[Array, "3 3"]:
    """Rows left, up, forward if side 0 of the body is the left one; unit and orthogonal.

    Left is the mean of hip line and shoulder line. Up leads from the ankles to the head; where the trunk disagrees by
    more than 40 degrees (sitting, bent over) the trunk decides alone.
    """
    hip, shoulder, foot = body.legs.points(tree, 0), body.arms.points(tree, 0), body.legs.points(tree, 2)
    left = unit(hip[0] - hip[1] + shoulder[0] - shoulder[1])
    top = shoulder.mean(axis=0) if body.head is None else tree.positions[body.head]
    up, trunk = unit(top - foot.mean(axis=0)), body.up
    if up @ trunk < np.cos(np.radians(40.0)):
        up = trunk
    up = unit(up - (up @ left) * left)
    return np.stack([left, up, np.cross(left, up)])


def left_evidence(tree: Tree, body: Body, axes: Float[Array, "3 3"]) -> dict[str, float]:
    """What speaks for side 0 being the left one (positive) or the right one (negative), each about -1 to 1.

    With `axes` computed for side 0 = left, anything that points forward speaks for it.
    """
    left, up, forward = axes
    evidence = {"toes": 0.0, "knees": 0.0, "elbows": 0.0, "thumbs": 0.0, "face": 0.0}
    for leg, arm in zip(body.legs.limbs, body.arms.limbs):
        hip, knee, ankle = tree.positions[list(leg.nodes)]
        evidence["toes"] += 0.5 * _toe_direction(tree, leg.nodes[2], leg.length, forward, up)
        evidence["knees"] += 0.5 * _bend(hip, knee, ankle, forward)
        shoulder, elbow, wrist = tree.positions[list(arm.nodes)]
        evidence["elbows"] -= 0.5 * _bend(shoulder, elbow, wrist, forward)
        evidence["thumbs"] += 0.5 * _thumb_direction(tree, arm.nodes[2], wrist - elbow, forward)
    evidence["face"] = _face_direction(tree, body, axes)
    return evidence


WEIGHTS = {"toes": 3.0, "knees": 1.0, "elbows": 0.7, "thumbs": 1.5, "face": 1.0}


def weigh(evidence: dict[str, float]) -> float:
    return sum(WEIGHTS[cue] * value for cue, value in evidence.items())


def name_evidence(names: NameScores, body: Body) -> float:
    """Do the side words of the limbs' joints call side 0 left (1) or right (-1)? Zero where they are silent."""
    votes = [
        int(names.sides[node]) * (1 if side == 0 else -1)
        for pair in (body.legs, body.arms)
        for side, limb in enumerate(pair.limbs)
        for node in limb.nodes
        if node < len(names.sides)
    ]
    return sum(votes) / len(votes) if votes else 0.0


def _toe_direction(tree: Tree, ankle: int, length: float, forward: Array, up: Array) -> float:
    """How clearly the foot points forward: its farthest end, seen from the ankle, without its height."""
    rel = tree.positions[tree.below(ankle)] - tree.positions[ankle]
    rel = rel - np.outer(rel @ up, up)
    along = rel @ forward
    far = float(along[np.abs(along).argmax()])
    return float(np.clip(far / (0.08 * length), -1.0, 1.0)) if abs(far) > 0.015 * length else 0.0


def _bend(start: Array, middle: Array, end: Array, forward: Array) -> float:
    """How far the middle joint stands forward of the line from start to end; a tenth of a degree says nothing."""
    line = end - start
    length = float(np.linalg.norm(line))
    if length == 0.0:
        return 0.0
    off = middle - start - ((middle - start) @ line) / length**2 * line
    return float(np.clip((off @ forward) / length / 0.04, -1.0, 1.0)) if np.linalg.norm(off) > 0.003 * length else 0.0


def _thumb_direction(tree: Tree, wrist: int, arm: Array, forward: Array) -> float:
    """The thumb leaves the hand off the fingers' direction; in common rest poses it does so forward."""
    tips = [node for node in tree.below(wrist) if not tree.children[node] and node != wrist]
    rel = tree.positions[tips] - tree.positions[wrist]
    far = np.linalg.norm(rel, axis=1)
    if len(tips) < 2 or far.max() == 0.0:
        return 0.0
    fingers = unit(rel[far.argmax()])
    aside = rel - np.outer(rel @ fingers, fingers)
    short = far < 0.85 * far.max()
    if not short.any():
        return 0.0
    aside, far = aside[short], far[short]
    thumb = int((np.linalg.norm(aside, axis=1) / np.maximum(far, 1e-12)).argmax())
    share = float(aside[thumb] @ forward) / max(float(far[thumb]), 1e-12)
    return float(np.clip(share / 0.4, -1.0, 1.0)) if abs(share) > 0.1 else 0.0


def _face_direction(tree: Tree, body: Body, axes: Array) -> float:
    """Eyes, jaw and nose lie in front of the head joint; hair hangs behind it, and is told by its length."""
    if body.head is None:
        return 0.0
    left, up, forward = axes
    height = float(np.linalg.norm(body.arms.points(tree, 0).mean(axis=0) - body.legs.points(tree, 0).mean(axis=0)))
    rel = tree.positions[tree.below(body.head)[1:]] - tree.positions[body.head]
    near = rel[(np.abs(rel @ left) < 0.15 * height) & (np.abs(rel @ up) < 0.3 * height)]
    if not len(near):
        return 0.0
    mean = float((near @ forward).mean()) / height
    return float(np.clip(mean / 0.1, -1.0, 1.0)) if abs(mean) > 0.02 else 0.0
