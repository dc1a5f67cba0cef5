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


def limbs(tree: Tree, names: NameScores, keep: int = 6) -> dict[str, dict[int, list[Limb]]]:
    """Per kind ('leg', 'arm') and child of the trunk: the cheapest limbs inside that child's branch."""
    upper, middle, lower, lengths, shape = _triples(tree)
    in_line = _in_line(tree, upper, middle)
    found: dict[str, dict[int, list[Limb]]] = {"leg": {}, "arm": {}}
    for kind, branches in found.items():
        cost = shape + _proportion_cost(tree, kind, lower, lengths)
        named = _name_cost(names, tree.joints, LIMB_PARTS[kind], (upper, middle, lower))
        rows = np.flatnonzero(cost + named < 14.0)
        top, lead = upper[rows], np.zeros(len(rows))
        free = 0.95 if kind == "arm" else 0.45
        options = []
        for _ in range(5):  # collar bones and helpers between the trunk and the limb
            rows, top, lead = rows[top > 0], top[top > 0], lead[top > 0]
            total = cost[rows] + outside(lead / lengths[rows, 0], 0.0, free, 0.2) + 0.15 * (lead > 0)
            total = total + 1.5 * ((kind == "leg") & (lead > 0) & in_line[rows])
            options.append(np.stack([top, rows, lead, total], axis=1))
            top, lead = tree.parents[top], lead + tree.steps[top]
        table = np.concatenate(options)
        table = table[np.lexsort((table[:, 3] + named[table[:, 1].astype(int)], table[:, 0]))]
        for at, row, path, total in table:
            mine, t = branches.setdefault(int(at), []), int(row)
            if len(mine) < keep:
                triple = (int(upper[t]), int(middle[t]), int(lower[t]))
                pair = (float(lengths[t, 0]), float(lengths[t, 1]))
                mine.append(Limb(triple, pair, float(total), float(named[t]), float(path)))
    return found


def _in_line(tree: Tree, upper: Array, middle: Array) -> Array:
    """Does the bone before the limb's first joint run along the limb? Then the limb began a joint earlier."""
    before = tree.positions[upper] - tree.positions[tree.parents[upper]]
    first = tree.positions[middle] - tree.positions[upper]
    along = (before * first).sum(axis=1)
    return (along > 0.95 * tree.steps[upper] * np.linalg.norm(first, axis=1)) & (along > 0)


def _halves(tree: Tree) -> tuple[Array, Array, Array, Array]:
    """Straight stretches of bones: upper node, lower node, length, and the cost of the joints between them."""
    above = [np.arange(len(tree.parents))]
    for _ in range(MAX_STEPS):
        above.append(np.where(above[-1] >= 0, tree.parents[above[-1]], -1))
    found = []
    for steps in range(1, MAX_STEPS + 1):
        low = np.flatnonzero(above[steps] >= 0)
        up = above[steps][low]
        line = tree.positions[low] - tree.positions[up]
        length = np.linalg.norm(line, axis=1)
        long = length > 0.02 * tree.scale
        low, up, line, length = low[long], up[long], line[long], length[long]
        bend, early, inner, forks = (np.zeros(len(low)) for _ in range(4))
        for step in range(1, steps):
            mid = above[step][low]
            rel = tree.positions[mid] - tree.positions[up]
            away, along = np.linalg.norm(rel, axis=1), (rel * line).sum(axis=1) / length
            off = np.sqrt(np.maximum(away**2 - along**2, 0.0))
            bend = np.maximum(bend, off / length)
            # Off in direction as seen from the start: a helper joint before the real one.
            begins = (away > 0.02 * length) & (away < 0.35 * length)
            early = np.maximum(early, np.where(begins, off / np.maximum(away, 1e-12), 0.0))
            inner += (away > 1e-3 * length) & (away < 0.999 * length)
            forks += tree.branches[mid] > 1
        bend = np.maximum(bend, 0.15 * early)
        # Joints between the ends are rare, and joints that branch belong to the end of a limb.
        cost = outside(bend, 0.0, 0.02, 0.08) + np.minimum(0.4 * inner, 1.2) + 2.0 * forks
        straight = bend < 0.35
        found.append((up[straight], low[straight], length[straight], cost[straight]))
    return tuple(np.concatenate(column) for column in zip(*found))


def _triples(tree: Tree) -> tuple[Array, Array, Array, Array, Array]:
    """Two straight stretches in a row, with the part of their cost that legs and arms share."""
    up, low, length, cost = _halves(tree)
    order = np.argsort(low, kind="stable")
    up, low, length, cost = up[order], low[order], length[order], cost[order]
    first = np.searchsorted(low, up, side="left")  # of the stretches that end where this one begins
    count = np.searchsorted(low, up, side="right") - first
    second = np.repeat(np.arange(len(up)), count)
    first = np.repeat(first, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ratio = length[second] / length[first]
    alike = (ratio > 0.4) & (ratio < 2.5)
    first, second = first[alike], second[alike]
    upper, middle, lower = up[first], up[second], low[second]
    lengths = np.stack([length[first], length[second]], axis=1)
    direct = np.linalg.norm(tree.positions[lower] - tree.positions[upper], axis=1)
    total = cost[first] + cost[second] + outside(direct / lengths.sum(axis=1), 0.8, 1.01, 0.15)
    total = total + np.where(tree.branches[middle] > 1, 2.0, 0.0)  # limbs do not branch at the knee or the elbow
    for nodes in (upper, middle, lower):  # of two joints in one place the first one moves the other
        total = total + np.where(tree.steps[nodes] < 1e-4 * tree.scale, 0.5, 0.0)
    return upper, middle, lower, lengths, total


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


def pairs(tree: Tree, names: NameScores, kind: str, branches: dict[int, list[Limb]], most: int = 24) -> list[Pair]:
    """The cheapest pairs of limbs of one kind."""
    by_trunk: dict[int, list[int]] = {}
    for top in branches:
        by_trunk.setdefault(int(tree.parents[top]), []).append(top)
    found: list[Pair] = []
    for trunk, tops in by_trunk.items():
        tops = sorted(tops, key=lambda top: branches[top][0].cost)[:10]
        for i, a in enumerate(tops):
            for b in tops[i + 1 :]:
                if branches[a][0].cost + branches[b][0].cost < 20.0:
                    found.append(_best_pair(tree, names, kind, trunk, (a, b), branches))
    return sorted(found, key=lambda pair: pair.cost - 2.0 * np.log(pair.length))[:most]


def _best_pair(
    tree: Tree, names: NameScores, kind: str, trunk: int, tops: tuple[int, int], branches: dict[int, list[Limb]]
) -> Pair:
    """The cheapest of all limbs of one branch with all of another."""
    best: Pair | None = None
    choices = [(x, y) for x in branches[tops[0]] for y in branches[tops[1]]]
    for two in sorted(choices, key=lambda two: two[0].cost + two[1].cost):
        if best is not None and two[0].cost + two[1].cost - 0.9 >= best.cost:
            break  # joining two limbs earns 0.9 at most
        pair = _join(tree, names, kind, trunk, tops, two)
        best = pair if best is None or pair.cost < best.cost else best
    return best


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
