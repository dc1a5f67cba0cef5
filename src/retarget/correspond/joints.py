"""Joint matching: which joint of any skeleton is which joint of a human."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body.rotations import unit
from retarget.character import Skeleton
from retarget.correspond import joints_detail as detail
from retarget.correspond.joints_by_name import NameScores, score_names
from retarget.correspond.joints_by_shape import Body, bodies
from retarget.correspond.limbs import LIMB_PARTS, Limb
from retarget.correspond.sides import body_axes, left_evidence, name_evidence, weigh
from retarget.correspond.skeleton_tree import Tree, build_tree
from retarget.errors import MatchError, RetargetError, unknown_name

Array = np.ndarray

_SIDED = (
    "UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand",
    "ThumbMetacarpal", "ThumbProximal", "ThumbDistal",
    *(finger + bone for finger in ("Index", "Middle", "Ring", "Little") for bone in detail.PHALANGES),
)  # fmt: skip
HUMANOID_JOINTS: tuple[str, ...] = (
    "hips", "spine", "chest", "upperChest", "neck", "head", "leftEye", "rightEye", "jaw",
    *(side + part for side in ("left", "right") for part in _SIDED),
)  # fmt: skip
"""The humanoid joints of VRM 1.0, by their names there."""

REQUIRED_JOINTS: tuple[str, ...] = (
    "hips", "spine", "head",
    *(side + part for side in ("left", "right") for kind in ("leg", "arm") for part in LIMB_PARTS[kind]),
)  # fmt: skip
"""The fifteen that VRM requires of every humanoid."""

PLAUSIBLE = 11.5
"""Shape cost up to which a skeleton is a human whatever its joints are called: real rigs stay below 9, a chair with
arms reaches 12.6, a bird 14, dogs and horses 17."""
PLAUSIBLE_IF_NAMED = 40.0
"""The same where most of the required joints carry the right names (folded or unusual rest poses)."""


@dataclass(frozen=True, eq=False)
class Humanoid:
    """The human in a skeleton."""

    joints: dict[str, int]
    """Canonical name to joint index; joints that the skeleton lacks are absent."""
    confidence: dict[str, float]
    """0 to 1 for each of them."""
    twists: dict[int, str]
    """Twist joints, to the canonical joint whose limb segment they share."""
    axes: Float[Array, "3 3"]
    """Rows: the body's left, up and forward in the skeleton's rest world space, unit and orthogonal."""
    evidence: str
    """What the match rests on: 'names', 'shape', 'names and shape', 'map', or 'the file' that names its humanoid (VRM)."""


def match_humanoid(skeleton: Skeleton) -> Humanoid:
    """Find the humanoid joints of a skeleton in whatever units, axes and rest pose it comes.

    Topology, rest geometry and names decide together; a name that contradicts the shape loses, and a skeleton with
    meaningless names is matched by its shape. Left is the side that is left of a body facing the way its toes, knees,
    thumbs and face point; where the shape is silent the names decide.

    Raises `MatchError`, with the line to put into a map file, for what is no humanoid or could be read in two ways.
    """
    tree, names = build_tree(skeleton), score_names(skeleton.names)
    readings = bodies(tree, names)
    body = readings[0] if readings else None
    named = _named_share(names, body, tree.joints) if body else 0.0
    if body is None or body.shape_cost > (PLAUSIBLE_IF_NAMED if named > 0.6 else PLAUSIBLE):
        return _match_by_names_alone(skeleton, tree, names, body)
    _refuse_animal(skeleton, names, body.up, body.legs.points(tree, 2) - body.legs.points(tree, 0))
    _refuse_ambiguity(skeleton, names, readings)
    axes = body_axes(tree, body)
    by_shape, by_names = weigh(left_evidence(tree, body, axes)), name_evidence(names, body)
    verdict = float(np.clip(by_shape, -4.0, 4.0)) + 3.0 * by_names
    sides = ("left", "right") if verdict >= 0 else ("right", "left")
    if verdict < 0:
        axes = axes * np.array([[-1.0], [1.0], [-1.0]])
    return _describe(tree, names, body, sides, axes, named, abs(verdict))


def _named_share(names: NameScores, body: Body, joints: int) -> float:
    """Which share of hips, head and the twelve limb joints carries a fitting name."""
    scores = [names.parts["hips"][body.hips], names.parts["head"][body.head] if body.head is not None else 0.0]
    for kind, pair in (("leg", body.legs), ("arm", body.arms)):
        for limb in pair.limbs:
            named = zip(LIMB_PARTS[kind], limb.nodes)
            scores += [names.parts[part][node] if node < joints else 0.0 for part, node in named]
    return float(np.mean(np.array(scores) > 0.45))


def _refuse_ambiguity(skeleton: Skeleton, names: NameScores, readings: list[Body]) -> None:
    """A second reading that is as good and uses other limbs means that nothing tells them apart (spiders)."""
    best = readings[0]
    for other in readings[1:]:
        if other.cost > best.cost + 1.0:
            return
        for kind, mine, theirs in (("legs", best.legs, other.legs), ("arms", best.arms, other.arms)):
            a, b = ({limb.nodes[1] for limb in pair.limbs} for pair in (mine, theirs))
            if not a & b:
                listed = ", ".join(repr(skeleton.names[limb.nodes[0]]) for limb in mine.limbs + theirs.limbs)
                raise _no_humanoid(skeleton, names, f"two pairs of {kind} are equally likely ({listed})")


def _refuse_animal(skeleton: Skeleton, names: NameScores, up: Array, legs: Array) -> None:
    """Animals may carry human joint names (Biped cats): their trunk lies across their legs, and they have tails."""
    across = float((unit(legs) @ up).mean()) > -0.4
    if across and names.animal.any():
        tail = skeleton.names[int(names.animal.argmax())]
        raise _no_humanoid(skeleton, names, f"its trunk lies across its legs and it has {tail!r}: an animal")


def _no_humanoid(skeleton: Skeleton, names: NameScores, reason: str) -> MatchError:
    found = _joints_named(names)
    missing = tuple(name for name in REQUIRED_JOINTS if name not in found) or REQUIRED_JOINTS
    listed = ", ".join(skeleton.names[:4]) + (", ..." if len(skeleton) > 4 else "")
    return MatchError(
        f"the skeleton of {len(skeleton)} joints ({listed}) matches no humanoid: {reason}; "
        f"not found: {', '.join(missing)}; "
        f'if it is one, name its joints in a map file, a line each: {missing[0]} = "name of the joint"',
        missing,
    )


# --- names alone --------------------------------------------------------------------------------------------------


def _joints_named(names: NameScores) -> dict[str, int]:
    """For each required joint the one that carries its name best, where one does.

    A word that means another part first ('shoulder': the collar bone, then the upper arm) counts only where another
    joint of that side is better called that.
    """
    table = np.stack(list(names.parts.values()))
    first = table.argmax(axis=0)
    found: dict[str, int] = {}
    for canonical in REQUIRED_JOINTS:
        side = 1 if canonical.startswith("left") else -1 if canonical.startswith("right") else 0
        own = names.sides == side
        score = np.where(own, names.parts[_part(canonical)], 0.0)
        rival = np.where(own, table, 0.0).max(axis=1)[first]
        score[(score < table.max(axis=0)) & (rival <= table.max(axis=0))] = 0.0
        score[list(found.values())] = 0.0
        if score.max() >= 0.5:
            found[canonical] = int(score.argmax())
    return found


def _match_by_names_alone(skeleton: Skeleton, tree: Tree, names: NameScores, body: Body | None) -> Humanoid:
    """What the names say, for skeletons whose branches say nothing (all joints below the root, one arm lost)."""
    reason = "its proportions are not those of a human" if body else "no trunk with two legs and two arms was found"
    found = _joints_named(names)
    if len(found) < 12 or names.foreign.any() or not _limbs_agree(tree, found):
        raise _no_humanoid(skeleton, names, reason)
    try:
        human = humanoid_from_names(skeleton, {canonical: skeleton.names[joint] for canonical, joint in found.items()})
    except MatchError:
        raise _no_humanoid(skeleton, names, reason) from None
    knees = [tree.positions[found[name]] for name in ("leftLowerLeg", "rightLowerLeg") if name in found]
    _refuse_animal(skeleton, names, human.axes[1], np.array(knees) - tree.positions[found.get("hips", 0)])
    confidence = {name: round(0.6 * float(names.parts[_part(name)][joint]), 3) for name, joint in human.joints.items()}
    return replace(human, confidence=confidence, evidence="names")


def _limbs_agree(tree: Tree, joints: dict[str, int]) -> bool:
    """Limbs found by name have two like halves, and are alike on both sides."""
    for parts in LIMB_PARTS.values():
        both = []
        for side in ("left", "right"):
            nodes = [joints[side + part] for part in parts if side + part in joints]
            if len(nodes) == 3:
                both.append(np.linalg.norm(np.diff(tree.positions[nodes], axis=0), axis=1))
        lengths = np.array(both).reshape(-1, 2)
        if (lengths <= 0.0).any() or (np.abs(np.log(lengths[:, 0] / lengths[:, 1])) > np.log(2.5)).any():
            return False
        if len(lengths) == 2 and (np.abs(np.log(lengths[0] / lengths[1])) > np.log(1.4)).any():
            return False
    return True


def _part(canonical: str) -> str:
    """The part without its side: 'leftHand' is 'Hand'."""
    return canonical.removeprefix("left").removeprefix("right")


# --- from a reading to canonical names ----------------------------------------------------------------------------


def _describe(
    tree: Tree, names: NameScores, body: Body, sides: tuple[str, str], axes: Array, named: float, certainty: float
) -> Humanoid:
    shape = float(np.exp(-max(body.shape_cost, 0.0) / 20.0))
    sided = 0.5 + 0.5 * float(np.tanh(certainty))
    joints: dict[str, int] = {}
    confidence: dict[str, float] = {}
    twists: dict[int, str] = {}

    def add(name: str, joint: int | None, part: str, trust: float = 1.0) -> None:
        if joint is None or joint >= tree.joints or joint in joints.values():
            return
        fit = float(names.parts[part][joint]) if part in names.parts else 0.0
        joints[name] = int(joint)
        certain = 1.0 - (1.0 - 0.9 * shape * trust) * (1.0 - 0.9 * fit)
        confidence[name] = round(certain * (sided if name.startswith(("left", "right")) else 1.0), 3)

    hips = detail.pelvis(tree, names, body)
    add("hips", hips, "hips")
    add("head", body.head, "head")
    for name, joint in detail.spine_joints(tree, names, body, hips).items():
        add(name, joint, name)
    for which, side in enumerate(sides):
        leg, arm = body.legs.limbs[which], body.arms.limbs[which]
        for kind, limb in (("leg", leg), ("arm", arm)):
            ends = (*limb.nodes[:2], _end_joint(tree, names, limb, kind))
            for part, joint in zip(LIMB_PARTS[kind], ends):
                add(side + part, joint, part)
            twists.update(detail.twist_joints(tree, limb, kind, side, names))
        add(side + "Shoulder", detail.shoulder_joint(tree, names, body.arms.tops[which], arm), "Shoulder")
        foot, hand = joints.get(side + "Foot"), joints.get(side + "Hand")
        if foot is not None:
            add(side + "Toes", detail.toe_joint(tree, names, foot, leg), "Toes")
        if hand is not None:
            _add_fingers(tree, names, hand, arm, side, add)
    if body.head is not None:
        for name, (joint, trust) in detail.face_joints(tree, names, body.head, axes).items():
            add(name, joint, "Eye" if name.endswith("Eye") else "jaw", trust)
    taken = set(joints.values())
    twists = {joint: name for joint, name in twists.items() if joint not in taken and name in joints}
    ordered = {name: joints[name] for name in HUMANOID_JOINTS if name in joints}
    evidence = "shape" if named < 0.25 else "names and shape" if body.shape_cost <= PLAUSIBLE else "names"
    return Humanoid(ordered, {name: confidence[name] for name in ordered}, twists, axes, evidence)


def _end_joint(tree: Tree, names: NameScores, limb: Limb, kind: str) -> int | None:
    """Ankle or wrist. Where the limb's last node only ends its bone, a foot that stands there by itself (driven by
    inverse kinematics, so not below the leg) is the real one."""
    end = limb.nodes[2]
    if tree.children[end] or kind == "arm":
        return end
    part = LIMB_PARTS[kind][2]
    apart = np.linalg.norm(tree.positions[: tree.joints] - tree.positions[end], axis=1)
    near = [int(joint) for joint in np.flatnonzero(apart < 0.04 * limb.length) if tree.children[joint]]
    near = [joint for joint in near if limb.nodes[1] not in tree.above(joint)]
    near = [joint for joint in near if not names.auxiliary[joint] or names.parts[part][joint] > 0.1]
    if near:
        return max(near, key=lambda joint: (names.parts[part][joint], -apart[joint]))
    return end


def _add_fingers(tree: Tree, names: NameScores, hand: int, arm: Limb, side: str, add) -> None:
    for finger, (chain, trust) in detail.fingers(tree, names, hand, arm).items():
        for name, joint in detail.phalanges(tree, names, hand, finger, chain).items():
            add(side + name, joint, finger, trust)


# --- from a map ---------------------------------------------------------------------------------------------------


def humanoid_from_names(skeleton: Skeleton, names: Mapping[str, str]) -> Humanoid:
    """The humanoid that a map file describes: canonical name to the skeleton's joint name.

    Raises `RetargetError` for names that do not exist and for joints used twice, `MatchError` where upper legs or
    upper arms, from which the body's axes are measured, are missing.
    """
    joints: dict[str, int] = {}
    for canonical, name in names.items():
        if canonical not in HUMANOID_JOINTS:
            raise unknown_name("humanoid joint", canonical, HUMANOID_JOINTS, "VRM 1.0")
        joint = skeleton.index(name)
        if joint in joints.values():
            first = next(each for each, index in joints.items() if index == joint)
            raise RetargetError(f"joint {name!r} is mapped twice, to {first} and {canonical}; give each its own joint")
        joints[canonical] = joint
    tree = build_tree(skeleton)
    missing = tuple(name for name in REQUIRED_JOINTS if name not in joints)
    axes = _axes_of(tree, joints, missing)
    scores = score_names(skeleton.names)
    twists: dict[int, str] = {}
    for side in ("left", "right"):
        for kind, parts in LIMB_PARTS.items():
            nodes = tuple(joints.get(side + part, -1) for part in parts)
            if min(nodes) >= 0 and nodes[0] in tree.above(nodes[1]) and nodes[1] in tree.above(nodes[2]):
                twists.update(detail.twist_joints(tree, Limb(nodes, (1.0, 1.0), 0.0, 0.0), kind, side, scores))
    twists = {joint: name for joint, name in twists.items() if joint not in joints.values()}
    ordered = {name: joints[name] for name in HUMANOID_JOINTS if name in joints}
    return Humanoid(ordered, dict.fromkeys(ordered, 1.0), twists, axes, "map")


def _axes_of(tree: Tree, joints: dict[str, int], missing: tuple[str, ...]) -> Float[Array, "3 3"]:
    """Left from the hip and shoulder lines, up from ankles or hips to head or shoulders."""
    at = {name: tree.positions[joint] for name, joint in joints.items()}

    def middle(*choices: tuple[str, ...]) -> Array:
        """The mean of the first group of joints of which any is mapped."""
        for group in choices:
            points = [at[name] for name in group if name in at]
            if points:
                return np.mean(points, axis=0)
        return np.zeros(3)

    left = np.zeros(3)
    for part in ("UpperLeg", "UpperArm"):
        if "left" + part in at and "right" + part in at:
            left = left + at["left" + part] - at["right" + part]
    top = middle(("head",), ("neck",), ("leftUpperArm", "rightUpperArm"))
    up = top - middle(("leftFoot", "rightFoot"), ("hips",), ("leftUpperLeg", "rightUpperLeg"))
    left = left / max(float(np.linalg.norm(left)), 1e-12)
    up = up - (up @ left) * left
    if np.linalg.norm(left) < 0.5 or np.linalg.norm(up) < 1e-9 * tree.scale:
        raise MatchError(
            "the map names too few joints to tell left and up; it needs leftUpperLeg and rightUpperLeg, hips and head; "
            f"missing: {', '.join(missing) or 'none, but they lie in one place'}",
            missing,
        )
    up = up / np.linalg.norm(up)
    return np.stack([left, up, np.cross(left, up)])


def scrambled(skeleton: Skeleton, seed: int) -> Skeleton:
    """The same skeleton with meaningless names: what matching must do without them."""
    letters, rng = "abcdefghijklmnopqrstuvwxyz", random.Random(seed)
    names: dict[str, None] = {}
    while len(names) < len(skeleton):
        names["".join(rng.choice(letters) for _ in range(8))] = None
    return replace(skeleton, names=tuple(names))
