"""The node tree of a glTF document and the rigid skeleton inside it.

A glTF node may be scaled, our joints are rigid. With W the world matrix of a node and Q the product of the node
rotations down to it, `stretch` D = Q^-1 W (its 3x3 part) carries every scale, so that

    position in the parent's rigid frame = D_parent t,     vertex = T_world_joint [D 0; 0 1] inverse_bind v.

Both are exact in every pose while D is a uniform scale; where it is not, they are exact at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.character import Skeleton
from retarget.io.gltf_document import Document
from retarget.io.gltf_weights import Influences

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class NodeTree:
    """All nodes of a document with their transforms at rest."""

    parents: Int[Array, "nodes"]
    order: list[int]
    """Nodes with parents before children, depth first."""
    translations: Float[Array, "nodes 3"]
    rotations: Float[Array, "nodes 4"]
    shapes: Float[Array, "nodes 3 3"]
    """What the rotation leaves of the node's 3x3 matrix: its scale, for nearly every node a diagonal."""
    world: Float[Array, "nodes 4 4"]

    def local(self, node: int) -> Float[Array, "4 4"]:
        """Parent-from-node, as the file has it."""
        return _affine(self.translations[node], self.rotations[node], self.shapes[node])


def _affine(
    translation: Float[Array, "3"], rotation: Float[Array, "4"], shape: Float[Array, "3 3"]
) -> Float[Array, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rot.to_matrix(rotation) @ shape, translation
    return matrix


@dataclass(frozen=True, eq=False)
class Rig:
    """How joints of our skeleton and nodes of the document turn into each other."""

    nodes: Int[Array, "joints"]
    """The node behind each joint."""
    parents: Int[Array, "joints"]
    translations: Float[Array, "joints 3"]
    """The nodes' own translations, before any animation."""
    rotations: Float[Array, "joints 4"]
    """The nodes' own rotations."""
    stretch: Float[Array, "joints 3 3"]
    """D of each joint (see the module)."""
    stretch_above: Float[Array, "joints 3 3"]
    """D of each joint's parent; for the root that of the nodes above it."""
    rotation_above: Float[Array, "4"]
    """World rotation of what the root hangs on."""
    position_above: Float[Array, "3"]

    def to_skeleton(
        self, translations: Float[Array, "*frames joints 3"], rotations: Float[Array, "*frames joints 4"]
    ) -> tuple[Float[Array, "*frames joints 3"], Float[Array, "*frames joints 4"]]:
        """Local positions and rotations of rigid joints from node translations and rotations."""
        positions = np.einsum("jab,...jb->...ja", self.stretch_above, translations)
        positions[..., 0, :] = self.position_above + rot.rotate(self.rotation_above, positions[..., 0, :])
        turned = rotations.copy()
        turned[..., 0, :] = rot.multiply(self.rotation_above, rotations[..., 0, :])
        return positions, turned

    def to_nodes(
        self, positions: Float[Array, "*frames joints 3"], rotations: Float[Array, "*frames joints 4"]
    ) -> tuple[Float[Array, "*frames joints 3"], Float[Array, "*frames joints 4"]]:
        """The inverse of `to_skeleton`. Below a node scaled to nothing no position can be kept: it gets its own."""
        back = rot.inverse(self.rotation_above)
        local, turned = positions.copy(), rotations.copy()
        local[..., 0, :] = rot.rotate(back, positions[..., 0, :] - self.position_above)
        turned[..., 0, :] = rot.multiply(back, rotations[..., 0, :])
        whole = np.linalg.matrix_rank(self.stretch_above) == 3
        inverse = np.zeros_like(self.stretch_above)
        inverse[whole] = np.linalg.inv(self.stretch_above[whole])
        local = np.einsum("jab,...jb->...ja", inverse, local)
        return np.where(whole[:, None], local, self.translations), turned


def read_tree(document: Document) -> NodeTree:
    """Parents and transforms of all nodes. Raises `FileError` for cycles, two parents and unusable transforms."""
    nodes = document.entries("nodes")
    parents = np.full(len(nodes), -1)
    for number, node in enumerate(nodes):
        for child in node.get("children", ()):
            if parents[child] >= 0:
                raise document.fail(f"is a child of node {parents[child]} and of node {number}", f"nodes[{child}]")
            parents[child] = number
    order, stack = [], [int(i) for i in np.flatnonzero(parents < 0)[::-1]]
    while stack:
        node = stack.pop()
        order.append(node)
        stack.extend(reversed(nodes[node].get("children", ())))
    if len(order) < len(nodes):
        lost = next(iter(sorted(set(range(len(nodes))) - set(order))))
        raise document.fail("the nodes form a cycle", f"nodes[{lost}]")
    translations, rotations, shapes = (
        np.zeros((len(nodes), 3)),
        np.tile(rot.IDENTITY, (len(nodes), 1)),
        np.zeros((len(nodes), 3, 3)),
    )
    world = np.zeros((len(nodes), 4, 4))
    for node in order:
        translations[node], rotations[node], shapes[node] = _checked_transform(document, node)
        local = _affine(translations[node], rotations[node], shapes[node])
        world[node] = local if parents[node] < 0 else world[parents[node]] @ local
    far = np.abs(world).max(axis=(1, 2)) > 1e12 if len(nodes) else np.zeros(0, bool)
    if far.any():
        raise document.fail("is placed or scaled beyond all measure", f"nodes[{int(np.flatnonzero(far)[0])}]")
    return NodeTree(parents, order, translations, rotations, shapes, world)


def _checked_transform(document: Document, number: int) -> tuple[Array, Array, Array]:
    node = document.json["nodes"][number]
    if "matrix" in node and np.abs(np.array(node["matrix"], float)[3::4] - [0, 0, 0, 1]).max() > 1e-4:
        raise document.fail("the last row of the matrix is not 0 0 0 1", f"nodes[{number}]")
    if "matrix" not in node:
        length = np.linalg.norm(node.get("rotation", rot.IDENTITY))
        if not 0.5 < length < 2.0:
            raise document.fail(f"the rotation is no unit quaternion (its length is {length:.3g})", f"nodes[{number}]")
    return node_transform(node)


def node_transform(node: dict[str, Any]) -> tuple[Float[Array, "3"], Float[Array, "4"], Float[Array, "3 3"]]:
    """Translation, rotation, and what remains of the 3x3 matrix below the rotation (the scale), of a node's JSON."""
    if "matrix" not in node:
        rotation = rot.normalise(np.array(node.get("rotation", rot.IDENTITY), float))
        scale = np.array(node.get("scale", (1, 1, 1)), float)
        return np.array(node.get("translation", (0, 0, 0)), float), rotation, np.diag(scale)
    matrix = np.array(node["matrix"], float).reshape(4, 4).T
    rotation = rigid_part(matrix[:3, :3])
    return matrix[:3, 3], rotation, rot.to_matrix(rotation).T @ matrix[:3, :3]


def rigid_part(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """The rotation nearest to a 3x3 matrix (polar decomposition); a mirroring matrix is taken times -1."""
    u, _, vt = np.linalg.svd(matrix if np.linalg.det(matrix) >= 0 else -matrix)
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return rot.from_matrix(u @ vt)


def is_uniform(stretch: Float[Array, "3 3"]) -> bool:
    """Whether a 3x3 matrix is a number times the identity, to a thousandth."""
    return bool(np.abs(stretch - np.eye(3) * stretch[0, 0]).max() <= 1e-3 * max(abs(stretch[0, 0]), 1e-12))


def animated_nodes(document: Document) -> set[int]:
    """Nodes whose translation or rotation some animation sets."""
    return {
        channel["target"]["node"]
        for animation in document.entries("animations")
        for channel in animation["channels"]
        if "node" in channel["target"] and channel["target"]["path"] in ("translation", "rotation")
    }


def joint_nodes(document: Document, tree: NodeTree, moving: set[int]) -> list[int]:
    """The nodes that make the skeleton, parents before children; empty for a file without bones.

    All joints of all skins, what lies between them, their lowest common ancestor, and any of `moving` (nodes that
    really move in some clip) above or below. A file without skin takes its moving nodes for joints, with all bare nodes
    beside and below them, or, if it shows nothing at all, its whole tree. Raises `FileError` for separate trees.
    """
    joints = {node for skin in document.entries("skins") for node in skin["joints"]}
    bare = {node for node in tree.order if not _shows(document, node)}
    if joints:
        holding = _counts_below(tree, joints)
        joints |= {node for node in moving if holding[node]} | (_below(tree, joints) & moving)
    elif moving:
        joints = moving | (_below(tree, {_common_root(document, tree, moving)}) & bare)
    elif not document.entries("meshes") and len(tree.order) > 1:
        joints = bare
    if not joints:
        return []
    wanted = _below(tree, {_common_root(document, tree, joints)})
    holding = _counts_below(tree, joints)
    return [node for node in tree.order if holding[node] and node in wanted]


def _shows(document: Document, node: int) -> bool:
    entry = document.json["nodes"][node]
    return "mesh" in entry or "camera" in entry or "KHR_lights_punctual" in (entry.get("extensions") or ())


def _counts_below(tree: NodeTree, nodes: set[int]) -> list[int]:
    """How many of `nodes` each node has at or below itself."""
    counts = [int(node in nodes) for node in range(len(tree.order))]
    for node in reversed(tree.order):
        if tree.parents[node] >= 0:
            counts[tree.parents[node]] += counts[node]
    return counts


def _below(tree: NodeTree, nodes: set[int]) -> set[int]:
    """The nodes and everything below them."""
    found: set[int] = set()
    for node in tree.order:
        if node in nodes or int(tree.parents[node]) in found:
            found.add(node)
    return found


def _common_root(document: Document, tree: NodeTree, nodes: set[int]) -> int:
    counts = _counts_below(tree, nodes)
    holding_all = [node for node in tree.order if counts[node] == len(nodes)]
    if not holding_all:
        roots = [node for node in tree.order if tree.parents[node] < 0 and counts[node]]
        names = ", ".join(repr(node_name(document, root)) for root in roots[:4])
        raise document.fail(
            f"its joints hang in {len(roots)} separate trees ({names}); put them below one node", "nodes"
        )
    return holding_all[-1]  # they lie on one path, the lowest last


def node_name(document: Document, node: int) -> str:
    return document.json["nodes"][node].get("name") or f"node_{node}"


def joint_names(document: Document, nodes: Sequence[int]) -> tuple[str, ...]:
    """Node names made unique: the second 'arm' becomes 'arm_2'."""
    taken: set[str] = set()
    count: dict[str, int] = {}
    names = []
    for node in nodes:
        name = base = node_name(document, node)
        while name in taken:
            count[base] = count.get(base, 1) + 1
            name = f"{base}_{count[base]}"
        taken.add(name)
        names.append(name)
    return tuple(names)


def make_rig(tree: NodeTree, nodes: Sequence[int]) -> Rig:
    """Separate rotations from scales along the joints `nodes` (parents first)."""
    position = {node: joint for joint, node in enumerate(nodes)}
    parents = np.array([-1] + [position[int(tree.parents[node])] for node in nodes[1:]])
    index = np.array(nodes)
    above = int(tree.parents[nodes[0]])
    outer = np.eye(4) if above < 0 else tree.world[above]
    rotation_above = rot.IDENTITY if above < 0 else rigid_part(outer[:3, :3])
    local = tree.rotations[index].copy()
    local[0] = rot.multiply(rotation_above, local[0])
    turned, _ = forward(parents, local, np.zeros((len(nodes), 3)))
    stretch = np.swapaxes(rot.to_matrix(turned), -1, -2) @ tree.world[index][:, :3, :3]
    stretch_above = np.concatenate([(rot.to_matrix(rotation_above).T @ outer[:3, :3])[None], stretch[parents[1:]]])
    return Rig(
        index,
        parents,
        tree.translations[index],
        tree.rotations[index],
        stretch,
        stretch_above,
        rotation_above,
        outer[:3, 3],
    )


@dataclass(frozen=True, eq=False)
class GltfOrigin:
    """What a character remembers of the glTF file it came from, so that the writer can append to it."""

    document: Document
    rig: Rig
    skeleton: Skeleton
    """The skeleton as it was read."""
    binds: dict[int, Float[Array, "columns 4 4"]]
    """Inverse bind matrices of the skins (by number) whose own ones must not be repeated."""
    influences: dict[tuple[int, int], Influences]
    """Joints and weights to write instead of faulty ones, by the accessors of these (JOINTS_0, WEIGHTS_0)."""
