"""Legs and arms by shape: three joints down one path, two such paths alike.

Every candidate gets a cost, roughly a negative log-likelihood under proportions of people, of cartoon figures and of
rest poses. All terms are ratios and angles: unit, axes, facing and joint order do not matter. The proportions are ours,
measured on about twenty rigs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from retarget.correspond.joints_by_name import NameScores
from retarget.correspond.skeleton_tree import Tree, outside

Array = np.ndarray

LIMB_PARTS = {"leg": ("UpperLeg", "LowerLeg", "Foot"), "arm": ("UpperArm", "LowerArm", "Hand")}
MAX_STEPS = 12  # joints between the ends of a limb's half; keeps ropes of thousands of joints cheap


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
