"""Which joints form a human body: topology and rest geometry, with names as one more witness.

A body is a trunk that leads from the hips to a chest, a pair of legs that leave the trunk at its lower end, a pair of arms
and a head at its upper end. A limb is three joints down one path (hip, knee, ankle; shoulder, elbow, wrist). Every
candidate gets a cost, roughly a negative log-likelihood under proportions of people, of cartoon figures and of rest
poses; the cheapest combination wins. All terms are ratios and angles: unit, axes, facing and joint order do not matter.
The proportions are ours, measured on about twenty rigs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton
from retarget.correspond.joints_by_name import NameScores

Array = np.ndarray

LIMB_PARTS = {"leg": ("UpperLeg", "LowerLeg", "Foot"), "arm": ("UpperArm", "LowerArm", "Hand")}
MAX_STEPS = 12  # joints between the ends of a limb's half; keeps ropes of thousands of joints cheap


@dataclass(frozen=True, eq=False)
class Tree:
    """The skeleton as a tree of points; known bone ends are nodes after the joints."""

    parents: Int[Array, "nodes"]
    positions: Float[Array, "nodes 3"]
    joints: int
    """How many of the nodes are joints; the others are bone ends."""
    children: list[list[int]]
    steps: Float[Array, "nodes"]
    """Distance to the parent."""
    reach: Float[Array, "nodes"]
    """Length of the longest path below each node."""
    sizes: Int[Array, "nodes"]
    """Joints in the subtree, the node included."""
    branches: Int[Array, "nodes"]
    """Children that lead to two joints or more and to somewhere else."""
    scale: float

    def above(self, node: int) -> list[int]:
        """The node and its ancestors, upwards."""
        path = []
        while node >= 0:
            path.append(node)
            node = int(self.parents[node])
        return path

    def below(self, node: int) -> list[int]:
        """The node and all nodes under it."""
        found = [node]
        for each in found:
            found.extend(self.children[each])
        return found

    def path(self, top: int, bottom: int) -> list[int]:
        """Nodes from `top` down to `bottom`, both included."""
        up = self.above(bottom)
        return up[: up.index(top) + 1][::-1]


def build_tree(skeleton: Skeleton) -> Tree:
    rotations, positions = rest_pose(skeleton)
    parents, count = list(skeleton.parents), len(skeleton)
    ends = []
    for joint, offset in (skeleton.end_offsets or {}).items():
        if np.linalg.norm(offset) > 0:
            ends.append(positions[joint] + rot.rotate(rotations[joint], np.asarray(offset, dtype=np.float64)))
            parents.append(joint)
    points = np.concatenate([positions, np.array(ends).reshape(-1, 3)])
    parents = np.array(parents)
    children: list[list[int]] = [[] for _ in parents]
    for node, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(node)
    steps = np.where(parents >= 0, np.linalg.norm(points - points[parents], axis=1), 0.0)
    reach, sizes = np.zeros(len(parents)), (np.arange(len(parents)) < count).astype(np.int64)
    for node in _upwards(parents, count):
        if parents[node] >= 0:
            reach[parents[node]] = max(reach[parents[node]], reach[node] + steps[node])
            sizes[parents[node]] += sizes[node]
    scale = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    branches = np.zeros(len(parents), dtype=np.int64)
    for node in range(1, count):
        if sizes[node] >= 2 and steps[node] + reach[node] > 1e-3 * scale:
            branches[parents[node]] += 1
    return Tree(parents, points, count, children, steps, reach, sizes, branches, scale)


def _upwards(parents: Array, count: int) -> list[int]:
    """Nodes in an order in which children come before parents: ends first, then joints backwards."""
    return [*range(count, len(parents)), *range(count - 1, -1, -1)]


def outside(value: Array | float, low: float, high: Array | float, width: float, most: float = 12.0) -> Array | float:
    """Cost that is zero inside [low, high] and grows like a Gaussian's outside, up to `most`."""
    excess = np.maximum(np.maximum(low - value, value - high), 0.0) / width
    return np.minimum(0.5 * excess * excess, most)


# --- one limb -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Limb:
    """Three joints down one path: hip, knee and ankle, or shoulder, elbow and wrist."""

    nodes: tuple[int, int, int]
    lengths: tuple[float, float]
    shape_cost: float
    name_cost: float
    lead: float = 0.0
    """Length of the path from the branch off the trunk to the first joint (collar bone, hip joint)."""

    @property
    def length(self) -> float:
        return self.lengths[0] + self.lengths[1]

    @property
    def cost(self) -> float:
        return self.shape_cost + self.name_cost


def limbs(tree: Tree, names: NameScores) -> dict[str, dict[int, list[Limb]]]:
    """Per kind ('leg', 'arm') and child of the trunk: the cheapest limbs inside that child's branch."""
    halves = _halves(tree)
    upper, middle, lower, lengths, shape = _triples(tree, halves)
    found: dict[str, dict[int, list[Limb]]] = {"leg": {}, "arm": {}}
    if not len(upper):
        return found
    for kind, branches in found.items():
        cost = shape + _proportion_cost(tree, kind, lower, lengths)
        named = _name_cost(names, tree.joints, LIMB_PARTS[kind], (upper, middle, lower))
        keep = np.flatnonzero(cost + named < 14.0)
        for t in keep[np.argsort((cost + named)[keep], kind="stable")]:
            top, lead = int(upper[t]), 0.0
            for _ in range(5):  # collar bones and helpers between the trunk and the limb
                if top == 0:
                    break
                free = 0.95 if kind == "arm" else 0.45
                shape_cost = float(cost[t] + outside(lead / lengths[t, 0], 0.0, free, 0.2) + 0.15 * (lead > 0))
                shape_cost += 1.5 * (kind == "leg" and lead > 0 and _in_line(tree, int(upper[t]), int(middle[t])))
                triple = (int(upper[t]), int(middle[t]), int(lower[t]))
                pair = (float(lengths[t, 0]), float(lengths[t, 1]))
                branches.setdefault(top, []).append(Limb(triple, pair, shape_cost, float(named[t]), lead))
                lead += float(tree.steps[top])
                top = int(tree.parents[top])
        for top in branches:
            branches[top] = sorted(branches[top], key=lambda limb: limb.cost)[:8]
    return found


def _in_line(tree: Tree, upper: int, middle: int) -> bool:
    """Does the bone before the limb's first joint run along the limb? Then the limb began a joint earlier."""
    before = tree.positions[upper] - tree.positions[tree.parents[upper]]
    first = tree.positions[middle] - tree.positions[upper]
    return bool(before @ first > 0.95 * tree.steps[upper] * np.linalg.norm(first) > 0.0)


def _halves(tree: Tree) -> dict[int, list[tuple[int, float, float]]]:
    """Straight stretches: per lower node the upper nodes with length and the cost of the joints between them."""
    halves: dict[int, list[tuple[int, float, float]]] = {}
    shortest = 0.02 * tree.scale
    for low in range(1, len(tree.parents)):
        between: list[int] = []
        up = int(tree.parents[low])
        for _ in range(MAX_STEPS):
            if up < 0:
                break
            line = tree.positions[low] - tree.positions[up]
            length = float(np.sqrt(line @ line))
            if length > shortest:
                bend = bend_cost = 0.0
                if between:
                    rel = tree.positions[between] - tree.positions[up]
                    off = np.linalg.norm(rel - np.outer(rel @ line, line) / length**2, axis=1)
                    # Off the line, and off in direction as seen from the start (a helper joint before the real one).
                    away = np.maximum(np.linalg.norm(rel, axis=1), 1e-9)
                    early = np.where(away > 0.02 * length, off / away, 0.0) * (away < 0.35 * length)
                    bend = max(float(off.max()) / length, 0.15 * float(early.max()))
                    # Joints between the ends are rare, and joints that branch belong to the end of a limb.
                    inner = int(((away > 1e-3 * length) & (away < 0.999 * length)).sum())
                    bend_cost = float(outside(bend, 0.0, 0.02, 0.08)) + min(0.4 * inner, 1.2)
                    bend_cost += 2.0 * float((tree.branches[between] > 1).sum())
                if bend < 0.35:
                    halves.setdefault(low, []).append((up, length, bend_cost))
            between.append(up)
            up = int(tree.parents[up])
    return halves


def _triples(tree: Tree, halves: dict[int, list[tuple[int, float, float]]]) -> tuple[Array, Array, Array, Array, Array]:
    """Two straight stretches in a row, with the part of their cost that legs and arms share."""
    rows = [
        (up, mid, low, first, second, cost + more)
        for low, stretches in halves.items()
        for mid, second, more in stretches
        for up, first, cost in halves.get(mid, ())
        if 0.4 < second / first < 2.5
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    upper, middle, lower = (table[:, column].astype(np.int64) for column in range(3))
    lengths = table[:, 3:5]
    direct = np.linalg.norm(tree.positions[lower] - tree.positions[upper], axis=1)
    cost = outside(direct / lengths.sum(axis=1), 0.8, 1.01, 0.15) + table[:, 5]
    cost = cost + np.where(tree.branches[middle] > 1, 2.0, 0.0)  # limbs do not branch at the knee or the elbow
    for nodes in (upper, middle, lower):  # of two joints in one place the first one moves the other
        cost = cost + np.where(tree.steps[nodes] < 1e-4 * tree.scale, 0.5, 0.0)
    return upper, middle, lower, lengths, cost


def _proportion_cost(tree: Tree, kind: str, lower: Array, lengths: Array) -> Array:
    """Length ratio of the two halves, and of what hangs on their end (foot, hand) to the lower one."""
    mean, width = (0.0, 0.18) if kind == "leg" else (-0.12, 0.2)
    ratio = np.log(lengths[:, 1] / lengths[:, 0])
    cost = np.minimum(0.5 * ((ratio - mean) / width) ** 2, 12.0)
    rest = tree.reach[lower] / lengths[:, 1]
    long = np.where(tree.branches[lower] > 1, 1.6, 0.8 if kind == "arm" else 0.9)  # fingers may be long, a palm not
    cost = cost + np.where(rest > 0, outside(rest, 0.1, long, 0.25, most=5.0), 0.7)  # it may hold a sword
    cost = cost - np.where(tree.branches[lower] > 2, 1.5, np.where(tree.branches[lower] > 1, 1.0, 0.0))
    return cost


def _name_cost(names: NameScores, joints: int, parts: tuple[str, ...], columns: tuple[Array, ...]) -> Array:
    """Names that fit make a limb cheaper; names of other parts and of helpers make it dearer."""
    cost = np.zeros(len(columns[0]))
    best = np.max(np.stack(list(names.parts.values())), axis=0)
    for part, nodes in zip(parts, columns):
        inside = nodes < joints
        node = np.where(inside, nodes, 0)
        fit = names.parts[part][node]
        other = np.maximum(best[node] - fit, 0.0)
        each = -3.0 * fit + 1.5 * other + 1.5 * names.auxiliary[node] + 1.5 * names.twists[node]
        each = each + 6.0 * names.foreign[node]
        cost += np.where(inside, each, 0.3)
    return cost


# --- two limbs ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Pair:
    """Two like limbs that leave the trunk at one joint."""

    trunk: int
    tops: tuple[int, int]
    """The children of the trunk joint that lead to them."""
    limbs: tuple[Limb, Limb]
    shape_cost: float
    name_cost: float

    @property
    def cost(self) -> float:
        return self.shape_cost + self.name_cost

    @property
    def length(self) -> float:
        return 0.5 * (self.limbs[0].length + self.limbs[1].length)

    def points(self, tree: Tree, which: int) -> Float[Array, "2 3"]:
        """Positions of the first (0), second (1) or third (2) joint of both limbs."""
        return tree.positions[[limb.nodes[which] for limb in self.limbs]]


def pairs(tree: Tree, names: NameScores, kind: str, branches: dict[int, list[Limb]], most: int = 40) -> list[Pair]:
    """The cheapest pairs of limbs of one kind."""
    by_trunk: dict[int, list[int]] = {}
    for top in branches:
        by_trunk.setdefault(int(tree.parents[top]), []).append(top)
    found: list[Pair] = []
    for trunk, tops in by_trunk.items():
        tops = sorted(tops, key=lambda top: branches[top][0].cost)[:10]
        for i, a in enumerate(tops):
            for b in tops[i + 1 :]:
                best = min(
                    (_join(tree, names, kind, trunk, (a, b), (x, y)) for x in branches[a] for y in branches[b]),
                    key=lambda pair: pair.cost,
                )
                found.append(best)
    return sorted(found, key=lambda pair: pair.cost - 2.0 * np.log(pair.length))[:most]


def _join(tree: Tree, names: NameScores, kind: str, trunk: int, tops: tuple[int, int], two: tuple[Limb, Limb]) -> Pair:
    a, b = two
    uneven = sum(min(0.5 * (np.log(x / y) / 0.12) ** 2, 6.0) for x, y in zip(a.lengths, b.lengths))
    if tree.sizes[tops[0]] == tree.sizes[tops[1]] and _depths(tree, a, tops[0]) != _depths(tree, b, tops[1]):
        uneven += 1.0
    away = [float(np.linalg.norm(tree.positions[limb.nodes[0]] - tree.positions[trunk])) for limb in two]
    uneven += min(0.5 * (np.log(max(away[0], 1e-9) / max(away[1], 1e-9)) / 0.3) ** 2, 3.0)
    apart = tree.positions[a.nodes[0]] - tree.positions[b.nodes[0]]
    wide = float(np.sqrt(apart @ apart)) / (0.5 * (a.length + b.length))
    if kind == "arm":
        spread = outside(wide, 0.35, 1.7, 0.1 if wide < 0.35 else 0.5)
    else:
        spread = outside(wide, 0.09, 1.2, 0.025 if wide < 0.09 else 0.5)
    named = a.name_cost + b.name_cost
    for x, y in zip(a.nodes, b.nodes):
        if x < tree.joints and y < tree.joints and names.sides[x] and names.sides[y]:
            named += 1.5 if names.sides[x] == names.sides[y] else -0.3
    return Pair(trunk, tops, two, float(a.shape_cost + b.shape_cost + uneven + spread), float(named))


def _depths(tree: Tree, limb: Limb, top: int) -> list[int]:
    return [len(tree.path(top, node)) for node in limb.nodes]


# --- the body -----------------------------------------------------------------------------------------------------


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
    feet: tuple[int | None, int | None] = field(default=(None, None))

    @property
    def cost(self) -> float:
        return self.shape_cost + self.name_cost + self.preference


def bodies(tree: Tree, names: NameScores) -> list[Body]:
    """Readings of the skeleton as a human, the cheapest first."""
    found = limbs(tree, names)
    legs, arms = (pairs(tree, names, kind, found[kind]) for kind in ("leg", "arm"))
    drafts = []
    for leg in legs:
        up_leg = tree.above(leg.trunk)
        for arm in arms:
            draft = _draft(tree, names, leg, arm, up_leg)
            if draft is not None:
                drafts.append(draft)
    drafts.sort(key=lambda body: body.cost)
    complete = [_with_head(tree, names, draft) for draft in drafts[:12]]
    return sorted(complete, key=lambda body: body.cost)


def _draft(tree: Tree, names: NameScores, legs: Pair, arms: Pair, up_leg: list[int]) -> Body | None:
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
        arms = Pair(arms.trunk, arms.tops[::-1], arms.limbs[::-1], arms.shape_cost, arms.name_cost)
        shoulder = shoulder[::-1]
    cost = legs.shape_cost + arms.shape_cost + _frame_cost(tree, legs, arms, hips, up, height)
    named = legs.name_cost + arms.name_cost - 2.0 * float(names.parts["hips"][hips])
    for x, y in zip(legs.limbs, arms.limbs):  # the same side for leg and arm
        a, b = names.sides[x.nodes[0]], names.sides[y.nodes[0]]
        named += 1.0 if a and b and a != b else 0.0
    preference = -1.5 * float(np.log(legs.length / tree.scale) + np.log(arms.length / tree.scale))
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
    taken = set(body.arms.tops) | set(body.legs.tops)
    carriers = [body.hips, *body.trunk]
    hip, shoulder = body.legs.points(tree, 0), body.arms.points(tree, 0)
    height = float(np.linalg.norm(shoulder.mean(axis=0) - hip.mean(axis=0)))
    left = rot.unit(shoulder[0] - shoulder[1])
    best, head, neck = 5.0, None, []
    best_shape = best
    for carrier in carriers:
        # Over all of the trunk only the joint that carries the arms may hold a head without being told by its place.
        for top in tree.children[carrier]:
            if top in taken or top in carriers or top >= tree.joints:
                continue
            for node in tree.below(top):
                if node >= tree.joints:
                    continue
                shape = _head_cost(tree, node, shoulder.mean(axis=0), body.up, left, height)
                shape += 0.4 * (body.arms.trunk != carrier)
                fit = float(names.parts["head"][node])
                other = max(names.best(node, but="spine") - fit, 0.0)  # Rigify's head is called spine.006
                shape += 1.5 * sum(_forks(tree, up) for up in tree.path(top, node)[:-1])  # the face is not the head
                cost = shape - 3.0 * fit + 1.5 * other + 2.0 * bool(names.auxiliary[node])
                if cost < best:
                    best, best_shape, head, neck = cost, shape, node, tree.path(top, node)[:-1]
    return Body(
        body.hips, body.trunk, body.legs, body.arms, neck, head, body.up,
        body.shape_cost + best_shape, body.name_cost + best - best_shape, body.preference,
    )  # fmt: skip


def _forks(tree: Tree, node: int) -> bool:
    """Does more than one thing hang on this joint (eyes, jaw, hair), as on a head?"""
    return tree.branches[node] > 1 or len(tree.children[node]) > 2


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


def reaches(tree: Tree, body: Body) -> Bool[Array, "nodes"]:
    """Nodes that the body already uses: trunk, limbs with their joints between, neck and head."""
    used = np.zeros(len(tree.parents), dtype=bool)
    used[[body.hips, *body.trunk, *body.neck]] = True
    if body.head is not None:
        used[body.head] = True
    for pair in (body.legs, body.arms):
        for top, limb in zip(pair.tops, pair.limbs):
            used[tree.path(top, limb.nodes[2])] = True
    return used
