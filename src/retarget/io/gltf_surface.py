"""Meshes of a glTF document as one surface: primitives, weights and materials put together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from retarget.body.kinematics import joint_transforms, rest_pose
from retarget.character import Material, Mesh, Skeleton, Skin
from retarget.errors import FileError
from retarget.io.gltf_bind import Binding, same_placement
from retarget.io.gltf_document import Document, resource
from retarget.io.gltf_nodes import NodeTree, Rig, node_name

Array = np.ndarray

MAX_VERTICES = 20_000_000
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
    count: int = 0

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
        if "bufferView" not in self.document.json["accessors"][attributes["POSITION"]] and (
            "KHR_draco_mesh_compression" in primitive.get("extensions", ())
        ):
            raise self.document.fail(
                "is compressed with Draco, which cannot be read yet; export it without compression", place
            )
        points = self.document.floats(attributes["POSITION"], ("VEC3",))
        points = self._morphed(node, primitive, points, place)
        self.count += len(points)
        if self.count > MAX_VERTICES:
            raise self.document.fail(f"more than {MAX_VERTICES} vertices", place)
        self.vertices.append(points @ T_world_mesh[:3, :3].T + T_world_mesh[:3, 3])
        uvs = self.document.floats(attributes["TEXCOORD_0"], ("VEC2",)) if "TEXCOORD_0" in attributes else None
        if uvs is not None and len(uvs) != len(points):
            raise self.document.fail(f"has {len(uvs)} texture coordinates for {len(points)} vertices", place)
        self.uvs.append(uvs)
        if skinned:
            which, weights = self._influences(attributes, len(points), len(columns), place)
            self.columns.append(columns[which])
            self.weights.append(weights)
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

    def _influences(self, attributes: dict, count: int, joints: int, place: str) -> tuple[Array, Array]:
        """Skin joints and weights of each vertex, all sets side by side, repaired where they are not weights."""
        which, weights = [], []
        for number in range(64):
            if f"JOINTS_{number}" not in attributes or f"WEIGHTS_{number}" not in attributes:
                break
            which.append(self.document.integers(attributes[f"JOINTS_{number}"], ("VEC4",)))
            weights.append(self.document.decoded(attributes[f"WEIGHTS_{number}"], ("VEC4",)))
            if len(which[-1]) != count or len(weights[-1]) != count:
                raise self.document.fail(
                    f"has {len(which[-1])} joint and {len(weights[-1])} weight rows for {count} vertices", place
                )
        which, weights = np.concatenate(which, axis=1), np.concatenate(weights, axis=1)
        spoilt = ~np.isfinite(weights) | (weights < 0)
        if spoilt.any():
            self._note(
                f"{place}: {int(spoilt.any(axis=1).sum())} vertices have weights below zero or not a number; they are set to zero"
            )
            weights[spoilt] = 0.0
        which[weights == 0] = 0
        if which.size and which.max() >= joints:
            raise self.document.fail(
                f"vertex {int(which.max(axis=1).argmax())} follows joint {int(which.max())} of a skin of {joints}",
                place,
            )
        total = weights.sum(axis=1)
        loose = total <= 1e-9
        if loose.any():
            self._note(f"{place}: {int(loose.sum())} vertices have no weights; they follow the skin's first joint")
            weights[loose], which[loose] = 0.0, 0
            weights[loose, 0] = 1.0
        uneven = ~loose & (np.abs(total - 1) > 0.02)
        if uneven.any():
            self._note(f"{place}: the weights of {int(uneven.sum())} vertices do not sum to one; they are scaled")
        return which, weights / weights.sum(axis=1, keepdims=True)

    def _add_faces(self, primitive: dict, place: str, start: int, count: int, mirrored: bool) -> None:
        if "indices" in primitive:
            corners = self.document.integers(primitive["indices"], ("SCALAR",))[:, 0]
            if len(corners) and corners.max() >= count:
                raise self.document.fail(f"a triangle names vertex {int(corners.max())} of {count}", place)
        else:
            corners = np.arange(count)
        faces = triangles(corners, primitive.get("mode", TRIANGLES))
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
    """Vertex triples of a triangle list, strip or fan; an incomplete last triangle is dropped, as the specification says."""
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


def read_material(document: Document, number: int | None, note) -> Material:
    if number is None:
        return Material("", (1.0, 1.0, 1.0, 1.0))
    entry = document.json["materials"][number]
    look = entry.get("pbrMetallicRoughness", {})
    image = None
    if "baseColorTexture" in look:
        texture = document.json["textures"][look["baseColorTexture"]["index"]]
        if "source" in texture:
            image = read_image(document, texture["source"], note)
        else:
            note(f"the picture of material {number} is in a form that cannot be read")
    colour = tuple(float(part) for part in look.get("baseColorFactor", (1, 1, 1, 1)))
    return Material(entry.get("name", ""), colour, image, entry.get("doubleSided", False))


def read_image(document: Document, number: int, note) -> bytes | None:
    """The encoded picture; None with a note if it is missing or neither PNG nor JPEG. `FileError` for URIs that leave the folder."""
    entry, place = document.json["images"][number], f"images[{number}]"
    if "bufferView" in entry:
        data = bytes(document.view(entry["bufferView"], place))
    elif "uri" not in entry:
        raise document.fail("has neither a uri nor a bufferView", place)
    else:
        try:
            data = resource(document.path, entry["uri"], place)
        except FileError as error:
            if "is not in its folder" not in error.problem:
                raise
            note(error.problem)
            return None
    if not data.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")):
        note(f"picture {number} is neither PNG nor JPEG and is left out")
        return None
    return data


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
) -> tuple[Mesh | None, Skin | None, list[str]]:
    """Everything that moves with the skeleton: skinned meshes, and what hangs rigidly from its joints."""
    surface = Surface(document, size)
    T_world_joint = joint_transforms(*rest_pose(skeleton))
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    carrier = np.full(len(tree.order), -1)  # the nearest joint at or above each node
    for node in tree.order:
        above = carrier[tree.parents[node]] if tree.parents[node] >= 0 else -1
        carrier[node] = joint_of.get(node, above)
    tables: dict[int, Array] = {}
    left_out = []
    for node in mesh_nodes(document, tree, surface.notes):
        entry = document.json["nodes"][node]
        primitives = document.json["meshes"][entry["mesh"]]["primitives"]
        if "skin" in entry and all({"JOINTS_0", "WEIGHTS_0"} <= set(part["attributes"]) for part in primitives):
            number = entry["skin"]
            binding = bindings[number]
            if number not in tables:
                stretched = np.tile(np.eye(4), (len(binding.joints), 1, 1))
                stretched[:, :3, :3] = rig.stretch[binding.joints]
                matrices = stretched @ binding.inverse_binds @ np.linalg.inv(binding.T_world_mesh)
                tables[number] = np.array([surface.column(int(j), m) for j, m in zip(binding.joints, matrices)])
            surface.add_mesh(node, binding.T_world_mesh, tables[number], skinned=True)
        elif carrier[node] >= 0:
            # Seen from the node's joint the mesh never moves; in the rest pose it stands where that joint stands.
            joint = int(carrier[node])
            above = rig.nodes[joint]
            local, at = np.eye(4), node
            while at != above:
                step = np.eye(4)
                step[:3, :3], step[:3, 3] = tree.matrix(at), tree.translations[at]
                local, at = step @ local, int(tree.parents[at])
            stretched = np.eye(4)
            stretched[:3, :3] = rig.stretch[joint]
            column = surface.column(joint, np.linalg.inv(T_world_joint[joint]))
            surface.add_mesh(node, T_world_joint[joint] @ stretched @ local, np.array([column]), skinned=False)
        else:
            left_out.append(node_name(document, node))
    notes = surface.notes
    if left_out:
        notes.append(
            f"{len(left_out)} meshes hang from no joint and are left out: {', '.join(map(repr, left_out[:3]))}"
        )
    if not surface.faces:
        return None, None, notes
    return surface.mesh(), surface.skin(), notes


def read_still_mesh(document: Document, tree: NodeTree) -> tuple[Mesh | None, list[str]]:
    """The meshes of a document without skeleton, in world coordinates."""
    surface = Surface(document, 1.0)
    for node in mesh_nodes(document, tree, surface.notes):
        surface.add_mesh(node, tree.world[node], np.zeros(1, dtype=int), skinned=False)
    return (surface.mesh() if surface.faces else None), surface.notes
