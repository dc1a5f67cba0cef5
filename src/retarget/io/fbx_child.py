"""Runs in a process of its own (`child.py`): one FBX file, read by ufbx, written as the GLB it would be.

ufbx 0.0.5 stops the whole process where a wrapper outlives what it wraps, or dies while its owner is used; so every wrapper
is kept alive to the end.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np

MOST_KEYS = 40_000_000
"""Transforms of all takes together; more is no animation that anyone made."""
MOST_INFLUENCES = 8
"""Joints that move one vertex; the lightest of more are left out."""
STILL = 1e-7
"""Change of a transform's numbers below which it does not move."""
FLOAT, UNSIGNED, SHORT = 5126, 5125, 5123
"""Component types of glTF."""

_kept: list[Any] = []


def hold(wrapper: Any) -> Any:
    """The wrapper, kept alive to the end."""
    _kept.append(wrapper)
    return wrapper


def items(listed: Any) -> list[Any]:
    """All members of a list of ufbx, kept alive, and the list with them."""
    hold(listed)
    return [hold(listed[number]) for number in range(len(listed))]


class Glb:
    """A GLB in the making."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.parts: list[bytes] = []
        self.size = 0

    def add(self, array: np.ndarray, kind: str, component: int, bounds: bool = False) -> int:
        """Number of a new accessor over the rows of an array."""
        data = np.ascontiguousarray(array).tobytes()
        self.append("bufferViews", {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)})
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.parts[-1])
        accessor = {
            "bufferView": len(self.json["bufferViews"]) - 1, "componentType": component, "count": len(array), "type": kind
        }  # fmt: skip
        if bounds and len(array):
            rows = np.asarray(array).reshape(len(array), -1)
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.append("accessors", accessor)

    def append(self, kind: str, entry: dict[str, Any]) -> int:
        """Number of a new entry."""
        self.json.setdefault(kind, []).append(entry)
        return len(self.json[kind]) - 1

    def write(self, path: str) -> None:
        if self.size:
            self.json["buffers"] = [{"byteLength": self.size}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        with open(path, "wb") as file:
            whole = 12 + 8 + len(text) + (8 + self.size if self.size else 0)
            file.write(struct.pack("<4sII", b"glTF", 2, whole) + struct.pack("<I4s", len(text), b"JSON") + text)
            if self.size:
                file.write(struct.pack("<I4s", self.size, b"BIN\0") + b"".join(self.parts))


def convert(source: str, output: str) -> dict[str, Any]:
    """Write the GLB; returns what the file says of itself."""
    import ufbx

    scene = hold(ufbx.load_file(
        source,
        target_axes=ufbx.axes_right_handed_y_up,
        target_unit_meters=1.0,
        space_conversion=ufbx.SpaceConversion.MODIFY_GEOMETRY,
        geometry_transform_handling=ufbx.GeometryTransformHandling.MODIFY_GEOMETRY,
        inherit_mode_handling=ufbx.InheritModeHandling.COMPENSATE,
        ignore_embedded=True,
        load_external_files=False,
        clean_skin_weights=True,
    ))  # fmt: skip
    settings = hold(scene.settings)
    glb, nodes, notes = Glb(), items(scene.nodes), []
    number = {node.element_id: place for place, node in enumerate(nodes)}
    roots = [place for place, node in enumerate(nodes) if node.is_root]
    glb.json |= {"scene": 0, "scenes": [{"nodes": roots}]}
    for place, node in enumerate(nodes):
        glb.append("nodes", _node(node, place, number))
    materials = {material.element_id: _add_material(glb, material) for material in items(scene.materials)}
    for place, node in enumerate(nodes):
        mesh = hold(node.mesh)
        if mesh is not None and mesh.num_vertices and mesh.num_indices:
            _add_mesh(glb, place, node, mesh, number, materials, notes)
    bones = [place for place, node in enumerate(nodes) if hold(node.bone) is not None]
    if bones:  # all of them, as in Blender: those that move no vertex hold skeletons together and end their limbs
        glb.append("skins", {"joints": bones})
    fps = float(settings.frames_per_second) or 30.0
    keys = 0
    for stack in items(scene.anim_stacks):
        start, end = _span(stack)
        frames = max(round((end - start) * fps) + 1, 1)
        keys += frames * len(nodes)
        if keys > MOST_KEYS:
            raise ValueError(f"its takes have {keys} transforms, more than {MOST_KEYS}; this is no animation")
        _add_take(ufbx, glb, stack, nodes, start, frames, fps)
    glb.write(output)
    version = int(hold(scene.metadata).version)
    return {
        "version": version, "fps": fps, "notes": notes, "unit_m": float(settings.original_unit_meters),
        "up": hold(settings.original_axis_up).name,
    }  # fmt: skip


def _node(node: Any, place: int, number: dict[int, int]) -> dict[str, Any]:
    transform = hold(node.local_transform)
    entry: dict[str, Any] = {
        "name": node.name or ("root" if node.is_root else f"node_{place}"),
        "translation": list(transform.translation), "rotation": list(transform.rotation), "scale": list(transform.scale),
    }  # fmt: skip
    children = [number[child.element_id] for child in items(node.children)]
    return entry | ({"children": children} if children else {})


def _add_material(glb: Glb, material: Any) -> int:
    """A material with its base colour; the number of its entry."""
    color = hold(hold(material.pbr).base_color)
    value = [float(part) for part in hold(color.value_vec4)][:3] if color.has_value else [0.8, 0.8, 0.8]
    clipped = [min(max(part, 0.0), 1.0) for part in value]
    return glb.append("materials", {
        "name": material.name, "pbrMetallicRoughness": {"baseColorFactor": [*clipped, 1.0], "metallicFactor": 0.0}
    })  # fmt: skip


def _add_mesh(
    glb: Glb, place: int, node: Any, mesh: Any, number: dict[int, int], materials: dict[int, int], notes: list[str]
) -> None:
    """The mesh of a node: its positions, skin, and triangles by material. Vertices keep the file's order and number."""
    points = np.array([tuple(point) for point in items(mesh.vertices)], dtype=np.float64)
    corners = np.array(items(mesh.vertex_indices), dtype=np.int64)
    faces = np.array([tuple(face) for face in items(mesh.faces)], dtype=np.int64).reshape(-1, 2)
    of_face = np.array(items(mesh.face_material), dtype=np.int64)
    of_face = of_face if len(of_face) == len(faces) else np.zeros(len(faces), dtype=np.int64)
    triangles, of_triangle = fans(faces, corners, of_face)
    if not len(triangles):
        return
    attributes = {"POSITION": glb.add(points.astype(np.float32), "VEC3", FLOAT, bounds=True)}
    skins = items(mesh.skin_deformers)
    if len(skins) > 1:
        notes.append(f"of {len(skins)} skins of the mesh {mesh.name!r} only the first is used")
    if skins:
        clusters = items(skins[0].clusters)
        if clusters:
            _add_skin(glb, place, skins[0], clusters, len(points), attributes, number)
    own = [materials[material.element_id] for material in items(node.materials)]
    primitives = []
    for material in np.unique(of_triangle).tolist():
        indices = glb.add(triangles[of_triangle == material].ravel().astype(np.uint32), "SCALAR", UNSIGNED)
        named = {"material": own[material]} if 0 <= material < len(own) else {}
        primitives.append({"attributes": attributes, "indices": indices, **named})
    glb.json["nodes"][place]["mesh"] = glb.append("meshes", {"name": mesh.name, "primitives": primitives})


def fans(faces: np.ndarray, corners: np.ndarray, of_face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons (first corner, count) as fans, and the material of each; in the order of the polygons."""
    triangles, materials, order = [], [], []
    for count in range(3, int(faces[:, 1].max(initial=0)) + 1):
        which = np.flatnonzero(faces[:, 1] == count)
        first = faces[which, 0]
        for step in range(1, count - 1):
            triangles.append(np.stack([corners[first], corners[first + step], corners[first + step + 1]], axis=1))
            materials.append(of_face[which])
            order.append(which)
    if not triangles:
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)
    sorted_ = np.argsort(np.concatenate(order), kind="stable")
    return np.concatenate(triangles)[sorted_], np.concatenate(materials)[sorted_]


def _add_skin(
    glb: Glb, place: int, skin: Any, clusters: list[Any], count: int, attributes: dict[str, int], number: dict[int, int]
) -> None:
    spans = np.array([tuple(vertex)[:2] for vertex in items(skin.vertices)], dtype=np.int64).reshape(-1, 2)[:count]
    rows = np.array([tuple(weight) for weight in items(skin.weights)], dtype=np.float64).reshape(-1, 2)
    joints, weights = heaviest(spans, rows, count)
    for start in range(0, joints.shape[1], 4):
        own = slice(start, start + 4)
        attributes[f"JOINTS_{start // 4}"] = glb.add(joints[:, own].astype(np.uint16), "VEC4", SHORT)
        attributes[f"WEIGHTS_{start // 4}"] = glb.add(weights[:, own].astype(np.float32), "VEC4", FLOAT)
    binds = np.stack([_matrix(cluster.geometry_to_bone).T for cluster in clusters]).astype(np.float32)
    glb.json["nodes"][place]["skin"] = glb.append("skins", {
        "joints": [number[hold(cluster.bone_node).element_id] for cluster in clusters],
        "inverseBindMatrices": glb.add(binds, "MAT4", FLOAT),
    })  # fmt: skip


def heaviest(spans: np.ndarray, rows: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints and weights of each vertex side by side, the heaviest first, from its span (first row, count) of all rows
    (joint, weight); a multiple of four wide, weights with the sum 1."""
    owner = np.repeat(np.arange(len(spans)), spans[:, 1])
    within = np.arange(len(owner)) - np.repeat(np.cumsum(spans[:, 1]) - spans[:, 1], spans[:, 1])
    picked = rows[np.repeat(spans[:, 0], spans[:, 1]) + within]
    order = np.lexsort((within, -picked[:, 1], owner))
    owner, picked = owner[order], picked[order]
    width = 4 * max(1, -(-min(int(spans[:, 1].max(initial=1)), MOST_INFLUENCES) // 4))
    kept = within < width  # rows of one owner stay together, so places within it count up as before
    joints, weights = np.zeros((count, width), dtype=np.int64), np.zeros((count, width))
    joints[owner[kept], within[kept]] = picked[kept, 0].astype(np.int64)
    weights[owner[kept], within[kept]] = picked[kept, 1]
    return joints, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)


def _matrix(value: Any) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3] = np.array([value.c0, value.c1, value.c2, value.c3]).T
    return matrix


def _span(stack: Any) -> tuple[float, float]:
    """First and last second of a take: as it says itself, else those of its keys."""
    start, end = float(stack.time_begin), float(stack.time_end)
    if end > start:
        return start, end
    curves = [
        hold(curve) for layer in items(stack.layers) for value in items(layer.anim_values)
        for curve in hold(value.curves) if curve is not None
    ]  # fmt: skip
    keyed = [curve for curve in curves if len(hold(curve.keyframes))]
    if not keyed:
        return start, start
    return min(float(curve.min_time) for curve in keyed), max(float(curve.max_time) for curve in keyed)


def _add_take(ufbx: Any, glb: Glb, stack: Any, nodes: Iterable[Any], start: float, frames: int, fps: float) -> None:
    """An animation stack, sampled at the file's frame rate."""
    animation = hold(stack.anim)
    times = np.arange(frames) / fps
    samplers: list[dict[str, int]] = []
    channels: list[dict[str, Any]] = []
    clock = None
    for place, node in enumerate(nodes):
        if node.is_root:
            continue
        rest = hold(node.local_transform)
        posed = [ufbx.evaluate_transform(animation, node, start + time) for time in times.tolist()]
        for path, kind in (("translation", "VEC3"), ("rotation", "VEC4"), ("scale", "VEC3")):
            values = np.array([tuple(getattr(transform, path)) for transform in posed])
            if np.abs(values - np.array(tuple(getattr(rest, path)))).max() < STILL:
                continue
            clock = glb.add(times.astype(np.float32), "SCALAR", FLOAT, bounds=True) if clock is None else clock
            channels.append({"sampler": len(samplers), "target": {"node": place, "path": path}})
            samplers.append({"input": clock, "output": glb.add(values.astype(np.float32), kind, FLOAT)})
    if channels:
        glb.append("animations", {"name": stack.name, "samplers": samplers, "channels": channels})
