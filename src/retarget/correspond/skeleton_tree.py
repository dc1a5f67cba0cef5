"""A skeleton as a tree of points, with what matching asks of it: path lengths, subtree sizes, branches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose
from retarget.character import Skeleton

Array = np.ndarray


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
