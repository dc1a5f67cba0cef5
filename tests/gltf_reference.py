"""The glTF 2.0 specification read literally, slowly, separately from the reader: what does a file show at time t?"""

import base64
import json
import struct
from pathlib import Path

import numpy as np

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Reference:
    def __init__(self, path: Path) -> None:
        data = Path(path).read_bytes()
        binary = None
        if data[:4] == b"glTF":
            size = struct.unpack_from("<I", data, 12)[0]
            text, binary = data[20 : 20 + size], data[28 + size :]
        else:
            text = data
        self.json = json.loads(text)
        self.buffers = []
        for buffer in self.json.get("buffers", []):
            uri = buffer.get("uri")
            if uri is None:
                self.buffers.append(binary)
            elif uri.startswith("data:"):
                self.buffers.append(base64.b64decode(uri.partition(",")[2]))
            else:
                self.buffers.append((Path(path).parent / uri).read_bytes())
        self.nodes = self.json["nodes"]
        self.parent = {child: i for i, node in enumerate(self.nodes) for child in node.get("children", [])}

    def elements(self, view, offset, count, width, dtype, stride=None):
        view = self.json["bufferViews"][view]
        data, start = self.buffers[view["buffer"]], view.get("byteOffset", 0) + offset
        step = stride or width * np.dtype(dtype).itemsize
        return np.array([np.frombuffer(data, dtype, width, start + i * step) for i in range(count)]).reshape(
            count, width
        )

    def accessor(self, number):
        a = self.json["accessors"][number]
        dtype, width = DTYPES[a["componentType"]], WIDTHS[a["type"]]
        if "bufferView" in a:
            stride = self.json["bufferViews"][a["bufferView"]].get("byteStride")
            out = self.elements(a["bufferView"], a.get("byteOffset", 0), a["count"], width, dtype, stride).copy()
        else:
            out = np.zeros((a["count"], width), dtype)
        if "sparse" in a:
            s = a["sparse"]
            kind = DTYPES[s["indices"]["componentType"]]
            where = self.elements(s["indices"]["bufferView"], s["indices"].get("byteOffset", 0), s["count"], 1, kind)
            what = self.elements(s["values"]["bufferView"], s["values"].get("byteOffset", 0), s["count"], width, dtype)
            for i, row in zip(where[:, 0], what):
                out[i] = row
        if a.get("normalized"):
            return np.maximum(out / {"i1": 127.0, "u1": 255.0, "i2": 32767.0, "u2": 65535.0}[dtype[1:]], -1.0)
        return out.astype(float) if dtype == "<f4" else out

    def pose(self, clip=None, t=0.0, scales=True):
        """Local translation, rotation, scale (or matrix) of every node at time t."""
        local = []
        for node in self.nodes:
            here = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
            here.update({key: node[key] for key in (*here, "matrix") if key in node})
            local.append(here)
        if clip is not None:
            animation = self.json["animations"][clip]
            for channel in animation["channels"]:
                path = channel["target"]["path"]
                if "node" in channel["target"] and path != "weights" and (scales or path != "scale"):
                    sampler = animation["samplers"][channel["sampler"]]
                    local[channel["target"]["node"]][path] = self.interpolate(sampler, t, path == "rotation")
        return local

    def interpolate(self, sampler, t, turn):
        times, values = self.accessor(sampler["input"])[:, 0], self.accessor(sampler["output"])
        mode = sampler.get("interpolation", "LINEAR")
        if mode == "CUBICSPLINE":
            values = values.reshape(len(times), 3, -1)
        point = (lambda k: values[k, 1]) if mode == "CUBICSPLINE" else (lambda k: values[k])
        if t <= times[0]:
            return point(0)
        if t >= times[-1]:
            return point(-1)
        k = int(np.searchsorted(times, t, side="right")) - 1
        dt = times[k + 1] - times[k]
        u = (t - times[k]) / dt
        a, b = point(k), point(k + 1)
        if mode == "STEP":
            return a
        if mode == "CUBICSPLINE":
            out, into = values[k, 2], values[k + 1, 0]
            v = (
                (2 * u**3 - 3 * u**2 + 1) * a
                + dt * (u**3 - 2 * u**2 + u) * out
                + (3 * u**2 - 2 * u**3) * b
                + dt * (u**3 - u**2) * into
            )
            return v / np.linalg.norm(v) if turn else v
        if not turn:
            return a + u * (b - a)
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)  # stored in bytes they are not quite of unit length
        cosine = float(a @ b)
        if cosine < 0:
            b, cosine = -b, -cosine
        angle = np.arccos(min(cosine, 1.0))
        if angle < 1e-6:
            return a
        return (np.sin((1 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle)

    def world(self, clip=None, t=0.0, scales=True):
        local = [matrix(here) for here in self.pose(clip, t, scales)]
        result = []
        for node in range(len(self.nodes)):
            m, at = local[node], node
            while at in self.parent:
                at = self.parent[at]
                m = local[at] @ m
            result.append(m)
        return np.array(result)

    def vertices(self, clip=None, t=0.0, scales=True):
        """World positions of the vertices of all meshes, nodes depth first, primitives that share their data once."""
        world, parts = self.world(clip, t, scales), []
        for node in self.depth_first():
            entry = self.nodes[node]
            if "mesh" not in entry:
                continue
            seen = set()
            for primitive in self.json["meshes"][entry["mesh"]]["primitives"]:
                attributes = primitive["attributes"]
                if tuple(attributes.items()) in seen:
                    continue
                seen.add(tuple(attributes.items()))
                points = self.accessor(attributes["POSITION"]).astype(float)
                points = np.concatenate([points, np.ones((len(points), 1))], axis=1)
                if "skin" not in entry:
                    parts.append((points @ world[node].T)[:, :3])
                    continue
                skin = self.json["skins"][entry["skin"]]
                count = len(skin["joints"])
                inverse = np.tile(np.eye(4), (count, 1, 1))
                if "inverseBindMatrices" in skin:
                    inverse = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)[:count]
                joint = world[skin["joints"]] @ inverse
                total = np.zeros((len(points), 4, 4))
                for k in range(4):
                    if f"JOINTS_{k}" in attributes:
                        which = self.accessor(attributes[f"JOINTS_{k}"]).astype(int)
                        weight = self.accessor(attributes[f"WEIGHTS_{k}"])
                        total += np.einsum("vk,vkab->vab", weight, joint[which])
                parts.append(np.einsum("vab,vb->va", total, points)[:, :3])
        return np.concatenate(parts)

    def depth_first(self):
        order, stack = [], [i for i in range(len(self.nodes) - 1, -1, -1) if i not in self.parent]
        while stack:
            order.append(stack.pop())
            stack.extend(reversed(self.nodes[order[-1]].get("children", [])))
        return order


def matrix(here):
    if "matrix" in here:
        return np.array(here["matrix"], float).reshape(4, 4).T
    x, y, z, w = np.array(here["rotation"], float) / np.linalg.norm(here["rotation"])
    m = np.eye(4)
    m[:3, :3] = np.array([
        [1 - 2*(y*y + z*z), 2*(x*y - z*w), 2*(x*z + y*w)],
        [2*(x*y + z*w), 1 - 2*(x*x + z*z), 2*(y*z - x*w)],
        [2*(x*z - y*w), 2*(y*z + x*w), 1 - 2*(x*x + y*y)],
    ]) * np.array(here["scale"], float)  # fmt: skip
    m[:3, 3] = here["translation"]
    return m
