"""The joints that a body may have besides its limbs: spine names, shoulders, toes, fingers, eyes and jaw, twists."""

from __future__ import annotations

import numpy as np

from retarget.body.rotations import unit
from retarget.correspond.aliases import FINGERS
from retarget.correspond.joints_by_name import NameScores
from retarget.correspond.joints_by_shape import Body
from retarget.correspond.limbs import LIMB_PARTS, Limb
from retarget.correspond.skeleton_tree import Tree

Array = np.ndarray

PHALANGES = ("Proximal", "Intermediate", "Distal")
THUMB_PHALANGES = ("Metacarpal", "Proximal", "Distal")


def pelvis(tree: Tree, names: NameScores, body: Body) -> int:
    """The joint where legs and spine part, or its parent where the legs hang on the first spine joint (Biped)."""
    hips, parent = body.hips, int(tree.parents[body.hips])
    if parent < 0:
        return hips
    if names.parts["spine"][hips] >= 0.8 and names.parts["hips"][parent] >= 0.8:
        return parent
    hip, shoulder = body.legs.points(tree, 0).mean(axis=0), body.arms.points(tree, 0).mean(axis=0)
    here, above = (float(np.linalg.norm(tree.positions[joint] - hip)) for joint in (hips, parent))
    raised = here > 0.18 * float(np.linalg.norm(shoulder - hip)) and above < 0.5 * here
    return parent if raised and names.parts["hips"][hips] < 0.5 and not names.auxiliary[parent] else hips


def spine_joints(tree: Tree, names: NameScores, body: Body, hips: int) -> dict[str, int]:
    """spine, chest, upperChest and neck out of the joints between hips and head."""
    trunk, neck = list(body.trunk), list(body.neck)
    if hips != body.hips:
        trunk.insert(0, body.hips)
    if not trunk:  # the hips carry the arms: what lies below the shoulders is spine
        shoulder, hip = body.arms.points(tree, 0).mean(axis=0), body.legs.points(tree, 0).mean(axis=0)
        height = float(np.linalg.norm(shoulder - hip))
        low = [joint for joint in neck if (tree.positions[joint] - shoulder) @ body.up < -0.2 * height]
        trunk, neck = low, neck[len(low) :]
    elif len(trunk) > 1 and not neck and names.parts["neck"][trunk[-1]] > 0.8:
        trunk, neck = trunk[:-1], trunk[-1:]  # collar bones that hang on the neck (Biped)
    while len(trunk) > 1 and names.parts["spine"][trunk[0]] < 0.8 and _below_sockets(tree, body, trunk[0]):
        trunk = trunk[1:]  # a second pelvis, from the crotch up, that the legs do not hang on (Quaternius)
    found = {}
    if trunk:
        found["spine"] = trunk[0]
    if len(trunk) > 1:
        found["chest"] = trunk[len(trunk) // 2]
    if len(trunk) > 2:
        found["upperChest"] = trunk[-1]
    if neck:
        found["neck"] = neck[0]
    return found


def _below_sockets(tree: Tree, body: Body, joint: int) -> bool:
    """Whether a joint lies lower than the hip sockets: no spine starts there."""
    hip, shoulder = body.legs.points(tree, 0).mean(axis=0), body.arms.points(tree, 0).mean(axis=0)
    return float((tree.positions[joint] - hip) @ body.up) < -0.05 * float(np.linalg.norm(shoulder - hip))


def shoulder_joint(tree: Tree, names: NameScores, top: int, limb: Limb) -> int | None:
    """The collar bone: the joint before the upper arm that is called so, else the longest."""
    before = tree.path(top, limb.nodes[0])[:-1]
    before = [joint for joint in before if not names.auxiliary[joint]]
    if not before:
        return None
    bone = dict(zip(tree.path(top, limb.nodes[0]), tree.steps[tree.path(top, limb.nodes[0])[1:]]))
    return max(before, key=lambda joint: 2.0 * names.parts["Shoulder"][joint] + bone[joint] / limb.length)


def toe_joint(tree: Tree, names: NameScores, foot: int, limb: Limb) -> int | None:
    """The ball of the foot: the next joint down the longest path, unless it only marks the end of the bone."""
    options = [joint for joint in tree.children[foot] if joint < tree.joints and not names.auxiliary[joint]]
    options = [joint for joint in options if tree.steps[joint] > 1e-3 * limb.length or tree.children[joint]]
    if not options:
        return None
    return max(options, key=lambda joint: (names.parts["Toes"][joint], tree.steps[joint] + tree.reach[joint]))


# --- fingers ------------------------------------------------------------------------------------------------------


def finger_chains(tree: Tree, names: NameScores, hand: int, limb: Limb) -> list[list[int]]:
    """The joints of each finger, base first: paths below the hand that no other finger shares."""
    leaves = []
    for joint in tree.below(hand)[1:]:
        last = joint < tree.joints and all(child >= tree.joints for child in tree.children[joint])
        away = float(np.linalg.norm(tree.positions[joint] - tree.positions[hand]))
        if last and (away + tree.reach[joint]) > 0.05 * limb.lengths[1]:
            leaves.append(joint)
    paths = [tree.path(hand, leaf)[1:] for leaf in leaves]
    shared: dict[int, int] = {}
    for path in paths:
        for joint in path:
            shared[joint] = shared.get(joint, 0) + 1
    chains = []
    for path in paths:
        own = [joint for joint in path if shared[joint] == 1]
        own = [joint for joint in own if tree.steps[joint] > 1e-4 * tree.scale]  # doubled joints of one place
        while len(own) > 1 and names.auxiliary[own[-1]]:
            own = own[:-1]
        if own and not names.auxiliary[own[0]] and not names.foreign[own[0]]:
            chains.append(own)
    return chains


def fingers(tree: Tree, names: NameScores, hand: int, limb: Limb) -> dict[str, tuple[list[int], float]]:
    """Which chain is which finger, with a confidence: by name where all are named, else by their place in the hand."""
    chains = finger_chains(tree, names, hand, limb)
    if not chains or len(chains) > 6:
        return {}
    named: dict[str, list[int]] = {}
    for chain in chains:
        score = {finger: max(float(names.parts[finger][joint]) for joint in chain) for finger in FINGERS}
        finger = max(FINGERS, key=lambda each: score[each])
        if score[finger] >= 0.5 and finger not in named:
            named[finger] = chain
    if len(named) == len(chains) or len(named) >= 2:
        return {finger: (chain, 0.95) for finger, chain in named.items()}
    by_shape = _order_fingers(tree, hand, chains)
    return {finger: (chain, 0.6) for finger, chain in by_shape.items()}


def _order_fingers(tree: Tree, hand: int, chains: list[list[int]]) -> dict[str, list[int]]:
    """The thumb starts nearest to the wrist and points away from the others, which stand in a row beside it."""
    if len(chains) < 2 or len(chains) > 5:
        return {}
    wrist = tree.positions[hand]
    knuckles = np.array([tree.positions[_knuckle(tree, hand, chain)] for chain in chains])
    tips = np.array([tree.positions[chain[-1]] for chain in chains])
    odd = [_oddness(i, knuckles - wrist, tips - wrist) for i in range(len(chains))]
    thumb = int(np.argmax(odd))
    rest = [i for i in range(len(chains)) if i != thumb]
    along = unit((tips - wrist)[rest].mean(axis=0))
    aside = knuckles[rest] - knuckles[rest].mean(axis=0)
    aside = aside - np.outer(aside @ along, along)
    row = np.linalg.svd(aside)[2][0]
    if row @ (tips[thumb] + knuckles[thumb] - 2.0 * knuckles[rest].mean(axis=0)) > 0:
        row = -row
    rest = [rest[i] for i in np.argsort(aside @ row, kind="stable")]
    order = {1: ("Index",), 2: ("Index", "Middle"), 3: FINGERS[1:4], 4: FINGERS[1:]}[len(rest)]
    return {"Thumb": chains[thumb], **{finger: chains[i] for finger, i in zip(order, rest)}}


def _oddness(i: int, knuckles: Array, tips: Array) -> float:
    """How much chain `i` differs from the others as a thumb does: in direction, and by being shorter."""
    directions = unit(tips)
    away = float(np.arccos(np.clip(directions[i] @ unit(np.delete(directions, i, axis=0).mean(axis=0)), -1.0, 1.0)))
    for reach in (np.linalg.norm(knuckles, axis=1), np.linalg.norm(tips, axis=1)):
        away -= 0.6 * float(reach[i] / max(np.delete(reach, i).mean(), 1e-12))
    return away


def _knuckle(tree: Tree, hand: int, chain: list[int]) -> int:
    """First joint after the palm. A metacarpal begins near the wrist and is longer than its distance from there."""
    if len(chain) >= 4:
        palm = float(np.linalg.norm(tree.positions[chain[0]] - tree.positions[hand]))
        if tree.steps[chain[1]] > 1.3 * palm or any(child >= tree.joints for child in tree.children[chain[-1]]):
            return chain[1]
    return chain[0]


def phalanges(tree: Tree, names: NameScores, hand: int, finger: str, chain: list[int]) -> dict[str, int]:
    """Canonical names (without side) of the joints of one finger; of more than three, those numbered 1 to 3."""
    bones = THUMB_PHALANGES if finger == "Thumb" else PHALANGES
    if len(chain) >= 4:
        numbered = {int(names.numbers[joint]): joint for joint in chain if not names.metacarpals[joint]}
        if {1, 2, 3} <= set(numbered):
            chain = [numbered[1], numbered[2], numbered[3]]
        elif finger != "Thumb":
            chain = chain[1:] if names.metacarpals[chain[0]] else chain[chain.index(_knuckle(tree, hand, chain)) :]
    return {f"{finger}{bone}": joint for bone, joint in zip(bones, chain)}


# --- face ---------------------------------------------------------------------------------------------------------


def face_joints(tree: Tree, names: NameScores, head: int, axes: Array) -> dict[str, tuple[int, float]]:
    """Eyes and jaw, by name; eyes also by shape where the head carries little else."""
    below = [joint for joint in tree.below(head)[1:] if joint < tree.joints]
    found: dict[str, tuple[int, float]] = {}
    left = axes[0]
    eyes = [joint for joint in below if names.parts["Eye"][joint] >= 0.9 and not _has_eye(tree, names, joint)]
    place = {joint: float((tree.positions[joint] - tree.positions[head]) @ left) for joint in below}
    for side, sign in (("left", 1), ("right", -1)):
        mine = [joint for joint in eyes if sign * place[joint] > 0]
        if mine:
            found[f"{side}Eye"] = (max(mine, key=lambda joint: abs(place[joint])), 0.95)
    jaws = [joint for joint in below if names.parts["jaw"][joint] >= 0.9]
    if jaws:
        inner = [joint for joint in jaws if not any(jaw != joint and joint in tree.above(jaw) for jaw in jaws)]
        found["jaw"] = (inner[0], 0.9)
    if not eyes and len(below) in (2, 3):
        leaves = [joint for joint in below if tree.sizes[joint] == 1 and abs(place[joint]) > 1e-3 * tree.scale]
        if len(leaves) == 2 and abs(place[leaves[0]] + place[leaves[1]]) < 0.2 * abs(place[leaves[0]]):
            leaves.sort(key=lambda joint: -place[joint])
            found["leftEye"], found["rightEye"] = (leaves[0], 0.6), (leaves[1], 0.6)
    return found


def _has_eye(tree: Tree, names: NameScores, joint: int) -> bool:
    """Helper joints of the same name stand before the real one ('__Eye_L' before 'Eye_L')."""
    return any(names.parts["Eye"][child] >= 0.9 for child in tree.below(joint)[1:] if child < tree.joints)


# --- twists -------------------------------------------------------------------------------------------------------


def twist_joints(tree: Tree, limb: Limb, kind: str, side: str, names: NameScores) -> dict[int, str]:
    """Joints on a limb's bones that share the turn of a segment, with the canonical joint of that segment."""
    found: dict[int, str] = {}
    for part, start, end in zip(LIMB_PARTS[kind], limb.nodes, limb.nodes[1:]):
        path = tree.path(start, end)
        for joint in path[1:-1]:
            found[joint] = side + part
        line = tree.positions[end] - tree.positions[start]
        length = float(line @ line)
        for carrier in path[:-1]:
            for joint in tree.children[carrier]:
                if joint in path or joint >= tree.joints or tree.sizes[joint] > 1 + names.twists[joint]:
                    continue
                rel = tree.positions[joint] - tree.positions[start]
                along = float(rel @ line) / length
                off = float(np.linalg.norm(rel - along * line)) / length**0.5
                if off < (0.15 if names.twists[joint] else 0.04) and -0.02 <= along <= 0.97:
                    if names.twists[joint] or not names.auxiliary[joint]:
                        found[joint] = side + part
    return found
