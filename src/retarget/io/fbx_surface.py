"""Meshes of an FBX file with their skins and coordinates of pictures, as meshes of a GLB. Runs in the child.

Vertices keep the file's order and number. Where a picture is shown, a vertex on a seam has several coordinates: the
first stays with it, and a copy of the vertex for each further one comes behind all others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.fbx_looks import Looks
from retarget.io.fbx_scene import hold, integers, items, vectors
from retarget.io.fbx_shapes import Morph, add_targets, read_shapes
from retarget.io.glb import FLOAT, UNSIGNED, Glb, fan_triangles

MOST_INFLUENCES = 8
"""Joints that move one vertex; the lightest of more are left out."""
FARTHEST = 1e6
"""No picture's coordinate is larger."""


def add_mesh(
    glb: Glb, place: int, node: Any, mesh: Any, number: dict[int, int], looks: Looks, notes: list[str]
) -> list[Morph]:
    """The mesh of a node: its positions, skin, shapes, and triangles by material; returns its shapes, if it has any."""
    points, corners = vectors(mesh.vertices, 3), integers(mesh.vertex_indices)
    faces = np.array([tuple(face) for face in items(mesh.faces)], dtype=np.int64).reshape(-1, 2)
    of_face = integers(mesh.face_material)
    of_face = of_face if len(of_face) == len(faces) else np.zeros(len(faces), dtype=np.int64)
    triangles, owners = fan_triangles(faces[:, 1], faces[:, 0], np.arange(len(corners)))
    if not len(triangles):
        return []
    own, of_triangle = looks.of_node(node), of_face[owners]
    shown = sorted({own[material] for material in np.unique(of_triangle).tolist() if material < len(own)})
    named = set().union(*(looks.uv_sets[material] for material in shown))
    uvs = _coordinates(mesh, named, notes) if named else None
    origin, copies = (np.arange(len(points)), corners) if uvs is None else cut_at_seams(corners, uvs, len(points))
    attributes = {"POSITION": glb.add(points[origin].astype(np.float32), "VEC3", FLOAT, bounds=True)}
    if uvs is not None:
        at_vertex = np.zeros((len(origin), 2))
        at_vertex[copies] = uvs
        attributes["TEXCOORD_0"] = glb.add(at_vertex.astype(np.float32), "VEC2", FLOAT)
    attributes |= _skin(glb, place, mesh, len(points), origin, number, notes)
    morph = read_shapes(mesh, place, len(points))
    targets, told = add_targets(glb, morph, origin) if morph else ([], {})
    primitives = []
    for material in np.unique(of_triangle).tolist():
        indices = copies[triangles[of_triangle == material].ravel()].astype(np.uint32)
        entry: dict[str, Any] = {"attributes": attributes, "indices": glb.add(indices, "SCALAR", UNSIGNED)}
        entry |= {"material": own[material]} if material < len(own) else {}
        primitives.append(entry | ({"targets": targets} if targets else {}))
    glb.json["nodes"][place]["mesh"] = glb.append("meshes", {"name": mesh.name, "primitives": primitives, **told})
    return [morph] if morph else []


def _coordinates(mesh: Any, named: set[str], notes: list[str]) -> np.ndarray | None:
    """Coordinates of pictures at each corner (corners, 2), from the top left: the mesh's first set. None without one."""
    first = hold(mesh.vertex_uv)
    if not first.exists:
        return None
    others = {each.name for each in items(mesh.uv_sets)[1:]} & named
    if others:
        notes.append(f"pictures on the mesh {mesh.name!r} lie on its first coordinates, not on {', '.join(map(repr, sorted(others)))}")
    values, which = vectors(first.values, 2), integers(first.indices)
    if len(which) != mesh.num_indices or not len(values) or not 0 <= which.min() <= which.max() < len(values):
        return None
    if not np.isfinite(values).all() or np.abs(values).max() > FARTHEST:
        notes.append(f"the mesh {mesh.name!r} has texture coordinates that are no numbers; they are left out")
        return None
    return (values * [1, -1] + [0, 1])[which]


def cut_at_seams(corners: np.ndarray, uvs: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Copies of vertices, so that each has one coordinate: the vertex that each copy (all vertices first, in their
    order) is of, and the copy at each corner."""
    _, same = np.unique(uvs.astype(np.float32), axis=0, return_inverse=True)
    same = same.reshape(-1)
    _, first, pair = np.unique(corners * (int(same.max()) + 1) + same, return_index=True, return_inverse=True)
    by_corner = np.argsort(first)
    owner = corners[first[by_corner]]
    kept = np.zeros(len(owner), dtype=bool)
    kept[np.unique(owner, return_index=True)[1]] = True
    number = np.empty(len(owner), dtype=np.int64)
    number[by_corner[kept]] = owner[kept]
    number[by_corner[~kept]] = count + np.arange(int((~kept).sum()))
    return np.concatenate([np.arange(count), owner[~kept]]), number[pair.reshape(-1)]


def _skin(
    glb: Glb, place: int, mesh: Any, count: int, origin: np.ndarray, number: dict[int, int], notes: list[str]
) -> dict[str, int]:
    """The attributes of a skinned mesh; its node gets the skin."""
    skins = items(mesh.skin_deformers)
    if len(skins) > 1:
        notes.append(f"of {len(skins)} skins of the mesh {mesh.name!r} only the first is used")
    clusters = items(skins[0].clusters) if skins else []
    if not clusters:
        return {}
    spans = np.array([tuple(vertex)[:2] for vertex in items(skins[0].vertices)], dtype=np.int64).reshape(-1, 2)[:count]
    rows = np.array([tuple(weight) for weight in items(skins[0].weights)], dtype=np.float64).reshape(-1, 2)
    joints, weights = heaviest(spans, rows, count)
    binds = np.stack([_matrix(cluster.geometry_to_bone).T for cluster in clusters]).astype(np.float32)
    glb.json["nodes"][place]["skin"] = glb.append("skins", {
        "joints": [number[hold(cluster.bone_node).element_id] for cluster in clusters],
        "inverseBindMatrices": glb.add(binds, "MAT4", FLOAT),
    })  # fmt: skip
    return glb.add_influences(joints[origin], weights[origin])


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
