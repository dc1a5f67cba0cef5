"""Small glTF files made in code: a bending tube on three joints, in as many disguises as the format allows."""

import base64
import copy
import json
import struct
from pathlib import Path

import numpy as np
from gltf_reference import Reference, matrix

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def turn(axis, degrees):
    q = np.zeros(4)
    q["xyz".index(axis)], q[3] = np.sin(np.radians(degrees) / 2), np.cos(np.radians(degrees) / 2)
    return q.tolist()


class Maker:
    def __init__(self):
        self.json = {"asset": {"version": "2.0", "copyright": "nobody", "extras": {"keep": [1, 2.5]}}}
        self.binary = bytearray()

    def add(self, kind, entry):
        self.json.setdefault(kind, []).append(entry)
        return len(self.json[kind]) - 1

    def view(self, data, **more):
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        start = len(self.binary)
        self.binary.extend(data)
        return self.add("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **more})

    def accessor(self, values, dtype="f4", normalized=False, stride=0, sparse=False):
        """An accessor. Normalised integers are encoded from reals; `stride` interleaves junk; `sparse` hides rows."""
        values = np.asarray(values, float)
        values = values[:, None] if values.ndim == 1 else values
        top = {"i1": 127, "u1": 255, "i2": 32767, "u2": 65535}.get(dtype)
        stored = np.round(values * top) if normalized else values
        if normalized and dtype[0] == "u":  # weights: their sum survives the rounding
            stored[:, 0] += values.sum(axis=1).round(6) * top - stored.sum(axis=1)
        stored = np.ascontiguousarray(stored.astype("<" + dtype))
        entry = {"componentType": CODES[dtype], "count": len(values), "type": TYPES[values.shape[1]]}
        if dtype == "f4":
            entry |= {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()}
        if normalized:
            entry["normalized"] = True
        if sparse:
            rows = np.arange(0, len(values), 2)
            base = stored.copy()
            base[rows] = 0
            entry["bufferView"] = self.view(base.tobytes())
            entry["sparse"] = {
                "count": len(rows),
                "indices": {"bufferView": self.view(rows.astype("<u2").tobytes()), "componentType": 5123},
                "values": {"bufferView": self.view(stored[rows].tobytes())},
            }
        elif stride:
            width = stored.shape[1] * stored.itemsize
            rows = np.full((len(values), stride), 0xAB, np.uint8)
            rows[:, 4 : 4 + width] = np.frombuffer(stored.tobytes(), np.uint8).reshape(len(values), width)
            entry |= {"bufferView": self.view(rows.tobytes(), byteStride=stride), "byteOffset": 4}
        else:
            entry["bufferView"] = self.view(stored.tobytes())
        return self.add("accessors", entry)

    def glb(self, path: Path, chunks=()):
        document = copy.deepcopy(self.json)
        if self.binary and "buffers" not in document:
            document["buffers"] = [{"byteLength": len(self.binary)}]
        path.write_bytes(pack(json.dumps(document).encode(), bytes(self.binary), chunks))
        return path

    def gltf(self, path: Path, uri=None):
        """JSON with the buffer as a data URI, or beside it under the name `uri`."""
        document = copy.deepcopy(self.json)
        if uri:
            (path.parent / uri).write_bytes(self.binary)
        inline = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        document["buffers"] = [{"byteLength": len(self.binary), "uri": uri or inline}]
        path.write_text(json.dumps(document))
        return path


def pack(text, binary=b"", chunks=()):
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        binary += b"\0" * (-len(binary) % 4)
        body += struct.pack("<II", len(binary), 0x004E4942) + binary
    for kind, data in chunks:
        body += struct.pack("<II", len(data), kind) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body


def tube():
    """Rings along +Y from 0 to 2: positions, triangles, weights over three joints at heights 0, 0.7 and 1.4."""
    heights, corners = np.linspace(0, 2, 9), 6
    angle = np.arange(corners) * 2 * np.pi / corners
    points = np.array([[0.2 * np.cos(a), h, 0.2 * np.sin(a)] for h in heights for a in angle])
    faces = []
    for ring in range(len(heights) - 1):
        for k in range(corners):
            a, b = ring * corners + k, ring * corners + (k + 1) % corners
            faces += [[a, a + corners, b], [b, a + corners, b + corners]]
    weights = np.exp(-4 * (points[:, 1:2] - [0.2, 0.9, 1.7]) ** 2)
    return points, np.array(faces), weights / weights.sum(axis=1, keepdims=True)


PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
)


def worm(
    armature=None, joint_scale=None, mesh_node=None, placed=None, bound=None, as_matrix=False, between=False,
    skins=1, weights_as="f4", joints_as="u1", turns_as="f4", positions_as="f4", sparse=False, stride=0,
    mode="LINEAR", sets=1, extra=0, prop=False, inverse_binds=True, fps=30.0, keys=5, clips=1, start=0.0, texture=False,
    stretchy=False,
):  # fmt: skip
    """The tube with its skeleton and clips.

    `armature`: transform of a node above the root; `joint_scale`: scale of the middle joint; `mesh_node`: transform of
    the skinned mesh's own node (which must not matter); `placed`: world-from-mesh matrix at binding; `bound`:
    rotations that nodes had at binding; `between`: a node outside the skin between two joints; `stretchy`: the middle
    joint moves too.
    """
    m = Maker()
    nodes = [
        {"name": "hips", "translation": [0.1, 0.0, 0.2], "rotation": turn("y", 30)},
        {"name": "spine", "translation": [0, 0.7, 0], "rotation": turn("x", 10)},
        {"name": "head", "translation": [0, 0.7, 0], "rotation": turn("z", -20)},
    ]
    if joint_scale:
        nodes[1]["scale"] = [joint_scale] * 3 if np.isscalar(joint_scale) else list(joint_scale)
    nodes[0]["children"], nodes[1]["children"] = [1], [2]
    joints = [0, 1, 2]
    if between:
        nodes.append({"name": "spacer", "translation": [0, 0.1, 0.05], "rotation": turn("x", -15), "children": [2]})
        nodes[1]["children"] = [3]
    if as_matrix:
        nodes = [
            {
                "name": n["name"],
                "matrix": matrix(full(n)).T.ravel().tolist(),
                **({"children": n["children"]} if "children" in n else {}),
            }
            for n in nodes
        ]
    roots = [0]
    if armature:
        nodes.append({"name": "Armature", **armature, "children": [0]})
        roots = [len(nodes) - 1]
    if prop:
        nodes.append({"name": "hat", "mesh": 1, "translation": [0, 0.3, 0], "scale": [2, 1, 1]})
        nodes[2]["children"] = [len(nodes) - 1]
    m.json["nodes"] = nodes
    points, faces, weights = tube()
    placed = np.eye(4) if placed is None else np.asarray(placed, float)
    stored = (np.c_[points, np.ones(len(points))] @ np.linalg.inv(placed).T)[:, :3]
    world = node_worlds(m.json, bound or {})
    binds = [np.linalg.inv(world[j]) @ placed for j in joints]
    which = np.tile([0, 1, 2, 0], (len(points), 1))
    four = np.c_[weights, np.zeros(len(points))]
    attributes = {"POSITION": m.accessor(stored, positions_as, stride=stride, sparse=sparse)}
    if sets == 2:  # the same weights, halved, in two sets
        four = four / 2
        attributes |= {
            "JOINTS_1": m.accessor(which, joints_as),
            "WEIGHTS_1": m.accessor(four, weights_as, weights_as != "f4"),
        }
    attributes |= {
        "JOINTS_0": m.accessor(which, joints_as),
        "WEIGHTS_0": m.accessor(four, weights_as, weights_as != "f4"),
    }
    attributes["TEXCOORD_0"] = m.accessor(stored[:, :2] * 0.1, "f4")
    primitive = {"attributes": attributes, "indices": m.accessor(faces.reshape(-1), "u2")}
    if texture:
        m.add("images", {"bufferView": m.view(PNG), "mimeType": "image/png"})
        m.add("textures", {"source": 0})
        look = {"baseColorFactor": [0.5, 1, 1, 1], "baseColorTexture": {"index": 0}}
        m.add("materials", {"name": "skin", "pbrMetallicRoughness": look, "doubleSided": True})
        primitive["material"] = 0
    m.add("meshes", {"primitives": [primitive]})
    if prop:
        corner = m.accessor([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0]])
        m.add("meshes", {"primitives": [{"attributes": {"POSITION": corner}}]})
    flat = np.array([b.T.ravel() for b in binds])
    for number in range(skins):
        skin = {"joints": joints}
        if inverse_binds:
            skin["inverseBindMatrices"] = m.accessor(flat)
        m.add("skins", skin)
        node = {"name": f"body{number}", "mesh": 0, "skin": number, **(mesh_node or {})}
        roots.append(m.add("nodes", node))
    m.add("scenes", {"nodes": roots})
    m.json["scene"] = 0
    for clip in range(clips):
        add_clip(m, clip, nodes, mode, fps, keys, start, turns_as, as_matrix, stretchy)
    for _ in range(extra):
        m.add("accessors", {"componentType": 5126, "count": 4, "type": "VEC3"})
    return m


def full(node):
    return {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1], **node}


def node_worlds(document, turned):
    """World matrices of the nodes, some of them with another rotation."""
    reference = Reference.__new__(Reference)
    nodes = [dict(node) for node in document["nodes"]]
    for node, rotation in turned.items():
        nodes[node]["rotation"] = rotation
    reference.nodes = nodes
    reference.parent = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}
    return reference.world()


def add_clip(m, number, nodes, mode, fps, keys, start, turns_as, as_matrix, stretchy):
    # A matrix node cannot be animated; such files get a clip on no node at all.
    if as_matrix:
        return
    times = m.accessor(start + np.arange(keys) / fps)
    swing = [turn("x", 10 + 40 * np.sin(k + number)) for k in range(keys)]
    nod = [turn("z", -20 + 170 * k / keys) for k in range(keys)]
    nod = [np.array(q) * (-1) ** k for k, q in enumerate(nod)]  # signs flip: the shortest way must be found
    path = [[0.1 + 0.05 * k, 0.02 * k * k, 0.2] for k in range(keys)]
    size = 1.0 / max(abs(nodes[-1].get("scale", [1])[0]), 1e-9) if nodes[-1].get("name") == "Armature" else 1.0
    animation = {"name": f"clip{number}", "samplers": [], "channels": []}
    for node, target, values in (
        (1, "rotation", swing),
        (2, "rotation", nod),
        (0, "translation", np.array(path) * size),
        (1, "translation", [[0, 0.7 + 0.1 * np.sin(k), 0.02 * k] for k in range(keys)]),
    )[: 4 if stretchy else 3]:
        values = np.asarray(values, float)
        if mode == "CUBICSPLINE":
            tangent = np.gradient(values, axis=0) * fps * 0.5
            values = np.stack([tangent, values, tangent], axis=1).reshape(-1, values.shape[1])
        small = target == "rotation" and turns_as != "f4"
        output = m.accessor(values, turns_as if small else "f4", small)
        animation["samplers"].append({"input": times, "output": output, "interpolation": mode})
        animation["channels"].append(
            {"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": target}}
        )
    m.add("animations", animation)
