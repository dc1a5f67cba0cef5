"""Meshes of a glTF document as one surface: primitives, weights and materials put together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import joint_transforms, rest_pose
from retarget.character import Mesh, Skeleton, Skin
from retarget.io.gltf_bind import Binding, same_placement
from retarget.io.gltf_document import Document
from retarget.io.gltf_materials import read_material
from retarget.io.gltf_nodes import NodeTree, Rig, node_name
from retarget.io.gltf_weights import Influences, read_influences

Array = np.ndarray

TRIANGLES, STRIP, FAN = 4, 5, 6


@dataclass(eq=False)
class Surface:
    """Primitives gathered so far, in the world of the rest pose, and the columns that move them."""

    document: Document
    size: float
    notes: list[str] = field(default_factory=list)
    vertices: list[Float[Array, "part 3"]] = field(default_factory=list)
    faces: list[Int[Array, "triangles 3"]] = field(default_factory=list)
    face_materials: list[Int[Array, "triangles"]] = field(default_factory=list)
    uvs: list[Float[Array, "part 2"] | None] = field(default_factory=list)
    columns: list[Int[Array, "part influences"]] = field(default_factory=list)
    weights: list[Float[Array, "part influences"]] = field(default_factory=list)
    materials: dict[int | None, int] = field(default_factory=dict)
    bound: list[tuple[int, Float[Array, "4 4"]]] = field(default_factory=list)
    """Joint and inverse bind of each column."""
    columns_of: dict[int, list[int]] = field(default_factory=dict)
    """The columns of each joint."""
    repaired: dict[tuple[int, int], Influences] = field(default_factory=dict)
    """Weights that a written file must not repeat, by their accessors (JOINTS_0, WEIGHTS_0)."""
    count: int = 0
    """Vertices so far."""
    triangles: int = 0

    def column(self, joint: int, inverse_bind: Float[Array, "4 4"]) -> int:
        """The column of this joint and matrix: an earlier one where there is an equal."""
        for number in self.columns_of.setdefault(joint, []):
            if same_placement(inverse_bind, self.bound[number][1], self.size, 2e-6):
                return number
        self.columns_of[joint].append(len(self.bound))
        self.bound.append((joint, inverse_bind))
        return len(self.bound) - 1

    def add_mesh(
        self, node: int, T_world_mesh: Float[Array, "4 4"], columns: Int[Array, "bound"], skinned: bool
    ) -> None:
        """All primitives of a node's mesh, placed in the world; skin joint number i moves by column `columns[i]`."""
        entry = self.document.json["nodes"][node]
        mesh = entry["mesh"]
        shared: dict[tuple, tuple[int, int]] = {}
        for number, primitive in enumerate(self.document.json["meshes"][mesh]["primitives"]):
            place = f"meshes[{mesh}].primitives[{number}]"
            if primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN):
                self._note(f"points and lines of mesh {mesh} are left out")
                continue
            if "POSITION" not in primitive["attributes"]:
                self._note(f"{place} has no positions and is left out")
                continue
            key = tuple(sorted(primitive["attributes"].items())), str(primitive.get("targets"))
            if key not in shared:
                start = self.count
                self._add_vertices(node, primitive, place, T_world_mesh, columns, skinned)
                shared[key] = start, self.count - start
            self._add_faces(primitive, place, *shared[key], bool(np.linalg.det(T_world_mesh[:3, :3]) < 0))

    def _add_vertices(
        self, node: int, primitive: dict, place: str, T_world_mesh: Array, columns: Array, skinned: bool
    ) -> None:
        attributes = primitive["attributes"]
        points = self.document.floats(attributes["POSITION"], ("VEC3",))
        points = self._morphed(node, primitive, points, place)
        self.count += len(points)
        if self.count > self.document.room:
            raise self.document.fail(f"the same data shown again and again: {self.count} vertices", place)
        self.vertices.append(points @ T_world_mesh[:3, :3].T + T_world_mesh[:3, 3])
        uvs = self.document.floats(attributes["TEXCOORD_0"], ("VEC2",)) if "TEXCOORD_0" in attributes else None
        if uvs is not None and len(uvs) != len(points):
            raise self.document.fail(f"has {len(uvs)} texture coordinates for {len(points)} vertices", place)
        self.uvs.append(uvs)
        if skinned:
            read = read_influences(self.document, attributes, len(points), len(columns), place)
            for fault in read.faults:
                self._note(fault)
            # Compressed weights stay as they are: quantised, their sums are off, and every reader scales them.
            if not read.clean and attributes["WEIGHTS_0"] not in self.document.filled:
                self.repaired[attributes["JOINTS_0"], attributes["WEIGHTS_0"]] = read
            self.columns.append(columns[read.joints])
            self.weights.append(read.weights)
        else:
            self.columns.append(np.broadcast_to(columns[:1], (len(points), 1)))
            self.weights.append(np.ones((len(points), 1)))

    def _morphed(self, node: int, primitive: dict, points: Array, place: str) -> Array:
        """The base shape with morph targets at their default weights."""
        entry, targets = self.document.json["nodes"][node], primitive.get("targets", [])
        weights = entry.get("weights", self.document.json["meshes"][entry["mesh"]].get("weights", []))
        for target, weight in zip(targets, weights):
            if weight and "POSITION" in target:
                change = self.document.floats(target["POSITION"], ("VEC3",))
                if len(change) != len(points):
                    raise self.document.fail(
                        f"a morph target has {len(change)} positions for {len(points)} vertices", place
                    )
                points = points + weight * change
        return points

    def _add_faces(self, primitive: dict, place: str, start: int, count: int, mirrored: bool) -> None:
        if "indices" in primitive:
            corners = self.document.integers(primitive["indices"], ("SCALAR",))[:, 0]
            if len(corners) and corners.max() >= count:
                raise self.document.fail(f"a triangle names vertex {int(corners.max())} of {count}", place)
        else:
            corners = np.arange(count)
        faces = triangles(corners, primitive.get("mode", TRIANGLES))
        self.triangles += len(faces)
        if self.triangles > self.document.room:
            raise self.document.fail(f"the same data shown again and again: {self.triangles} triangles", place)
        self.faces.append(start + (faces[:, ::-1] if mirrored else faces))
        material = self.materials.setdefault(primitive.get("material"), len(self.materials))
        self.face_materials.append(np.full(len(faces), material))

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def mesh(self) -> Mesh:
        uvs = None
        if any(part is not None for part in self.uvs):
            uvs = np.concatenate(
                [np.zeros((len(v), 2)) if part is None else part for v, part in zip(self.vertices, self.uvs)]
            )
        return Mesh(
            np.concatenate(self.vertices),
            np.concatenate(self.faces),
            uvs,
            tuple(read_material(self.document, number, self._note) for number in self.materials),
            np.concatenate(self.face_materials),
        )

    def skin(self) -> Skin:
        width = max(part.shape[1] for part in self.weights)
        padded = [np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in self.weights]
        columns = [np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in self.columns]
        return Skin(
            np.array([joint for joint, _ in self.bound]),
            np.stack([matrix for _, matrix in self.bound]),
            np.concatenate(columns),
            np.concatenate(padded),
        )


def triangles(corners: Int[Array, "corners"], mode: int) -> Int[Array, "triangles 3"]:
    """Vertex triples of a triangle list, strip or fan; an incomplete last triangle is dropped, as specified."""
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == FAN:
        faces = np.stack([corners[1:-1], corners[2:], np.broadcast_to(corners[0], len(corners) - 2)], axis=1)
    else:
        odd = np.arange(len(corners) - 2) % 2
        first = np.arange(len(corners) - 2)
        faces = np.stack([corners[first], corners[first + 1 + odd], corners[first + 2 - odd]], axis=1)
    degenerate = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
    return faces[~degenerate]


def mesh_nodes(document: Document, tree: NodeTree, notes: list[str]) -> list[int]:
    """Nodes with a mesh: those of the default scene, or all where that scene shows none."""
    shown = [node for node in tree.order if "mesh" in document.json["nodes"][node]]
    scenes = document.entries("scenes")
    if len(scenes) < 2:
        return shown
    default = document.json.get("scene", 0)
    inside: set[int] = set(scenes[default].get("nodes", ()))
    for node in tree.order:
        if int(tree.parents[node]) in inside:
            inside.add(node)
    visible = [node for node in shown if node in inside]
    if visible and len(visible) < len(shown):
        notes.append(
            f"of {len(scenes)} scenes only the default one, {scenes[default].get('name', str(default))!r}, is read"
        )
    return visible or shown


def read_surface(
    document: Document, tree: NodeTree, rig: Rig, skeleton: Skeleton, bindings: list[Binding], size: float
) -> Surface:
    """Everything that moves with the skeleton: skinned meshes, and what hangs rigidly from its joints."""
    surface = Surface(document, size)
    T_world_joint = joint_transforms(*rest_pose(skeleton))
    carrier, T_joint_node = _carriers(tree, rig)
    tables: dict[int, Array] = {}
    left_out = []
    for node in mesh_nodes(document, tree, surface.notes):
        entry, joint = document.json["nodes"][node], carrier[node]
        primitives = document.json["meshes"][entry["mesh"]]["primitives"]
        if "skin" in entry and all({"JOINTS_0", "WEIGHTS_0"} <= set(part["attributes"]) for part in primitives):
            number, binding = entry["skin"], bindings[entry["skin"]]
            if number not in tables:
                tables[number] = _bound_columns(surface, rig, binding)
            surface.add_mesh(node, binding.T_world_mesh, tables[number], skinned=True)
        elif joint >= 0:
            # Seen from its joint the mesh never moves; in the rest pose it stands where that joint stands.
            column = surface.column(joint, np.linalg.inv(T_world_joint[joint]))
            surface.add_mesh(node, T_world_joint[joint] @ T_joint_node[node], np.array([column]), skinned=False)
        else:
            left_out.append(node_name(document, node))
    if left_out:
        listed = ", ".join(map(repr, left_out[:3]))
        surface.notes.append(f"{len(left_out)} meshes hang from no joint and are left out: {listed}")
    return surface


def _carriers(tree: NodeTree, rig: Rig) -> tuple[list[int], dict[int, Float[Array, "4 4"]]]:
    """The nearest joint at or above each node (-1: none), and where the node stands in that rigid joint's frame."""
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    carrier, T_joint_node = [-1] * len(tree.order), {}
    for node in tree.order:
        parent = int(tree.parents[node])
        if node in joint_of:
            carrier[node] = joint_of[node]
            T_joint_node[node] = np.eye(4)
            T_joint_node[node][:3, :3] = rig.stretch[joint_of[node]]
        elif parent >= 0 and carrier[parent] >= 0:
            carrier[node] = carrier[parent]
            T_joint_node[node] = T_joint_node[parent] @ tree.local(node)
    return carrier, T_joint_node


def _bound_columns(surface: Surface, rig: Rig, binding: Binding) -> Int[Array, "bound"]:
    """Columns of a skin's joints, with vertices given where they stood in the world at binding."""
    stretched = np.tile(np.eye(4), (len(binding.joints), 1, 1))
    stretched[:, :3, :3] = rig.stretch[binding.joints]
    matrices = stretched @ binding.inverse_binds @ np.linalg.inv(binding.T_world_mesh)
    return np.array([surface.column(int(joint), matrix) for joint, matrix in zip(binding.joints, matrices)])


def read_still_mesh(document: Document, tree: NodeTree) -> tuple[Mesh | None, list[str]]:
    """The meshes of a document without skeleton, in world coordinates."""
    surface = Surface(document, 1.0)
    for node in mesh_nodes(document, tree, surface.notes):
        surface.add_mesh(node, tree.world[node], np.zeros(1, dtype=int), skinned=False)
    return (surface.mesh() if surface.faces else None), surface.notes
