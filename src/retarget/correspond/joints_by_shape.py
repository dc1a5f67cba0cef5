"""Which joints form a human body: topology and rest geometry, with names as one more witness.

A body is a trunk that leads from the hips to a chest, a pair of legs that leave the trunk at its lower end, a pair of
arms and a head at its upper end. Pairs of limbs come from `limbs`; the combination with the lowest cost wins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.correspond.joints_by_name import NameScores
from retarget.correspond.limbs import Pair, limbs, pairs
from retarget.correspond.skeleton_tree import Tree, outside

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """One reading of a skeleton as a human. Sides are still unknown: 0 and 1, the same in legs and arms."""

    hips: int
    trunk: list[int]
    """From the joint after the hips to the one that carries the arms; empty where the hips carry them."""
    legs: Pair
    arms: Pair
    neck: list[int]
    """Joints between the trunk and the head."""
    head: int | None
    up: Float[Array, "3"]
    """From the middle of the hips to the middle of the shoulders, a unit vector."""
    shape_cost: float
    name_cost: float
    preference: float = 0.0
    """Larger limbs are preferred among equals; no part of the judgement whether it is a human."""

    @property
    def cost(self) -> float:
        return self.shape_cost + self.name_cost + self.preference


def bodies(tree: Tree, names: NameScores) -> list[Body]:
    """Readings of the skeleton as a human, the cheapest first."""
    found = limbs(tree, names)
    legs, arms = (pairs(tree, names, kind, found[kind]) for kind in ("leg", "arm"))
    drafts: list[Body] = []
    for leg in legs:
        up_leg = tree.above(leg.trunk)
        for arm in arms:
            preference = -1.5 * float(np.log(leg.length / tree.scale) + np.log(arm.length / tree.scale))
            if drafts and leg.cost + arm.cost + preference - 2.0 > drafts[0].cost + 12.0:
                continue  # no head can make up for this
            draft = _draft(tree, names, leg, arm, up_leg, preference)
            if draft is not None:
                drafts.append(draft)
                drafts.sort(key=lambda body: body.cost)
    near = [draft for draft in drafts[:12] if draft.cost < drafts[0].cost + 12.0]
    return sorted((_with_head(tree, names, draft) for draft in near), key=lambda body: body.cost)


def _draft(tree: Tree, names: NameScores, legs: Pair, arms: Pair, up_leg: list[int], preference: float) -> Body | None:
    """A body without its head; None where legs and arms cannot belong together."""
    if legs.trunk == arms.trunk and set(legs.tops) & set(arms.tops):
        return None
    up_arm = tree.above(arms.trunk)
    if set(legs.tops) & set(up_arm) or set(arms.tops) & set(up_leg):
        return None
    hips = next(node for node in up_arm if node in up_leg)
    hip, shoulder = legs.points(tree, 0), arms.points(tree, 0)
    trunk = shoulder.mean(axis=0) - hip.mean(axis=0)
    height = float(np.sqrt(trunk @ trunk))
    if height < 1e-6 * tree.scale:
        return None
    up = trunk / height
    if (hip[0] - hip[1]) @ (shoulder[0] - shoulder[1]) < 0:
        arms = replace(arms, tops=arms.tops[::-1], limbs=arms.limbs[::-1])
        shoulder = shoulder[::-1]
    cost = legs.shape_cost + arms.shape_cost + _frame_cost(tree, legs, arms, hips, up, height)
    named = legs.name_cost + arms.name_cost - 2.0 * float(names.parts["hips"][hips])
    for x, y in zip(legs.limbs, arms.limbs):  # the same side for leg and arm
        a, b = names.sides[x.nodes[0]], names.sides[y.nodes[0]]
        named += 1.0 if a and b and a != b else 0.0
    spine = tree.path(hips, arms.trunk)[1:]
    return Body(hips, spine, legs, arms, [], None, up, float(cost), float(named), preference)


def _frame_cost(tree: Tree, legs: Pair, arms: Pair, hips: int, up: Array, height: float) -> float:
    """Do legs, trunk and arms stand to each other as in a human?"""
    hip, foot, shoulder = legs.points(tree, 0), legs.points(tree, 2), arms.points(tree, 0)
    down = foot - hip
    along = float(np.mean(down @ up / np.maximum(np.linalg.norm(down, axis=1), 1e-12)))
    left, right = hip[0] - hip[1], shoulder[0] - shoulder[1]
    agree = float(left @ right / max(np.linalg.norm(left) * np.linalg.norm(right), 1e-12))
    tilt = max(abs(float(v @ up)) / max(float(np.linalg.norm(v)), 1e-12) for v in (left, right))
    cost = outside(along, -1.0, -0.8, 0.2)  # quadrupeds and birds have their trunk across their legs
    cost += min(5.0 * (1.0 - agree), 6.0) + outside(tilt, 0.0, 0.3, 0.2)
    cost += 0.5 * (np.log(legs.length / height / 1.5) / 0.5) ** 2
    cost += 0.5 * (np.log(arms.length / height / 1.1) / 0.45) ** 2
    off = float(np.linalg.norm(hip.mean(axis=0) - tree.positions[hips])) / height
    return float(cost + outside(off, 0.0, 0.45, 0.2))


def _with_head(tree: Tree, names: NameScores, body: Body) -> Body:
    """Add the head: the medial joint a good way above the shoulders, where the neck ends."""
    carriers = [body.hips, *body.trunk]
    taken = {*body.arms.tops, *body.legs.tops, *carriers}
    hip, shoulder = body.legs.points(tree, 0), body.arms.points(tree, 0)
    middle = shoulder.mean(axis=0)
    height = float(np.linalg.norm(middle - hip.mean(axis=0)))
    left = rot.unit(shoulder[0] - shoulder[1])
    best, best_shape, head, top = 5.0, 5.0, None, None
    for carrier in carriers:
        start = 0.0 if carrier == body.arms.trunk else 0.4  # the neck leaves the trunk where the arms do
        todo = [(child, child, start) for child in tree.children[carrier] if child not in taken]
        while todo:
            node, branch, shape = todo.pop(0)
            if node >= tree.joints:
                continue
            below = shape + 1.5 * _forks(tree, node)  # the face is not the head
            todo += [(child, branch, below) for child in tree.children[node]]
            shape += _head_cost(tree, node, middle, body.up, left, height)
            fit = float(names.parts["head"][node])
            other = max(names.best(node, but="spine") - fit, 0.0)  # Rigify's head is called spine.006
            cost = shape - 3.0 * fit + 1.5 * other + 2.0 * bool(names.auxiliary[node])
            if cost < best:
                best, best_shape, head, top = cost, shape, node, branch
    neck = [] if head is None else tree.path(top, head)[:-1]
    shape_cost, name_cost = body.shape_cost + best_shape, body.name_cost + best - best_shape
    return replace(body, neck=neck, head=head, shape_cost=shape_cost, name_cost=name_cost)


def _forks(tree: Tree, node: int) -> bool:
    """Does more than one thing hang on this joint (eyes, jaw, hair), as on a head?"""
    return bool(tree.branches[node] > 1 or len(tree.children[node]) > 2)


def _head_cost(tree: Tree, node: int, shoulder: Array, up: Array, left: Array, height: float) -> float:
    away = tree.positions[node] - shoulder
    rise, aside = float(away @ up) / height, abs(float(away @ left)) / height
    front = float(np.linalg.norm(away - (away @ up) * up - (away @ left) * left)) / height
    cost = 0.5 * ((rise - 0.28) / 0.15) ** 2 + outside(aside, 0.0, 0.03, 0.06) + outside(front, 0.0, 0.12, 0.12)
    ends = []
    for child in tree.children[node]:  # a doubled joint counts as what it carries
        ends += [child] if tree.steps[child] > 1e-4 * tree.scale else tree.children[child]
    if len(ends) >= 2:
        cost -= 1.0  # eyes, jaw, hair
    elif len(ends) == 1 and tree.steps[ends[0]] < 0.12 * height:
        cost += 0.7  # a head is longer than a neck joint
    elif not ends:
        cost += 0.3
    if rise > 0.15 and len(ends) == 1 and not tree.children[ends[0]] and tree.steps[ends[0]] > 1.3 * tree.steps[node]:
        cost -= 0.5  # a long bone that ends: from the head to its top
    return float(min(cost, 20.0))
