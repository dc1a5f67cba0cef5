"""A new glTF document for a character that came from elsewhere: nodes, mesh, skin, materials."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import joint_transforms, rest_pose
from retarget.character import Character, Material, Mesh, Skin
from retarget.errors import RetargetError
from retarget.io.gltf_draft import INDEX_DATA, PICTURES, VERTEX_DATA, Draft
from retarget.io.gltf_nodes import GltfOrigin, Rig, read_tree
from retarget.io.gltf_weights import merge_influences

Array = np.ndarray


def character_document(character: Character, animation_only: bool) -> tuple[Draft, Rig]:
    """A draft with the character in its rest pose, and how its joints became nodes."""
    draft, skeleton = Draft.empty(), character.skeleton
    count = len(skeleton)
    for joint in range(count):
        node: dict[str, Any] = {
            "name": skeleton.names[joint],
            "translation": skeleton.offsets[joint].tolist(),
            "rotation": skeleton.rest_rotations[joint].tolist(),
        }
        children = skeleton.children(joint)
        if children:
            node["children"] = children
        draft.add("nodes", node)
    roots = [0]
    T_world_rest = joint_transforms(*rest_pose(skeleton))
    surface = None if animation_only else character.mesh
    if surface is not None:
        vertices, inverse_binds, joints, weights = bound_surface(surface, character.skin, T_world_rest)
        mesh = add_mesh(draft, surface, vertices, joints, weights, character.name or "body")
        roots.append(draft.add("nodes", {"name": character.name or "body", "mesh": mesh, "skin": 0}))
    else:
        inverse_binds = np.linalg.inv(T_world_rest)
    add_skin(draft, list(range(count)), inverse_binds, character.name or "skeleton")
    draft.add("scenes", {"nodes": roots})
    draft.json["scene"] = 0
    unit = np.tile(np.eye(3), (count, 1, 1))
    rig = Rig(
        np.arange(count),
        skeleton.parents,
        skeleton.offsets,
        skeleton.rest_rotations,
        unit,
        unit,
        rot.IDENTITY,
        np.zeros(3),
    )
    return draft, rig


def bare_document(character: Character, origin: GltfOrigin) -> tuple[Draft, Rig]:
    """The nodes of a glTF skeleton and those above it, transforms unchanged, without anything that shows."""
    draft, rig, document = Draft.empty(), origin.rig, origin.document
    if "copyright" in document.json["asset"]:
        draft.json["asset"]["copyright"] = document.json["asset"]["copyright"]
    tree = read_tree(document)
    above, node = [], int(tree.parents[rig.nodes[0]])
    while node >= 0:
        above.insert(0, node)
        node = int(tree.parents[node])
    kept = above + rig.nodes.tolist()
    number = {node: i for i, node in enumerate(kept)}
    for node in kept:
        source = document.json["nodes"][node]
        entry = {key: source[key] for key in ("name", "matrix", "translation", "rotation", "scale") if key in source}
        children = [number[child] for child in source.get("children", ()) if child in number]
        draft.add("nodes", {**entry, "children": children} if children else entry)
    nodes = np.arange(len(above), len(kept))
    if (np.abs(np.linalg.det(rig.stretch)) > 1e-18).all():
        T_world_rest = joint_transforms(*rest_pose(character.skeleton))
        T_world_rest[:, :3, :3] = T_world_rest[:, :3, :3] @ rig.stretch
        add_skin(draft, nodes.tolist(), np.linalg.inv(T_world_rest), character.name or "skeleton")
    draft.add("scenes", {"nodes": [0]})
    draft.json["scene"] = 0
    moved = Rig(
        nodes,
        rig.parents,
        rig.translations,
        rig.rotations,
        rig.stretch,
        rig.stretch_above,
        rig.rotation_above,
        rig.position_above,
    )
    return draft, moved


def add_skin(draft: Draft, nodes: list[int], inverse_binds: Float[Array, "joints 4 4"], name: str) -> int:
    matrices = add_matrices(draft, inverse_binds)
    return draft.add("skins", {"name": name, "inverseBindMatrices": matrices, "joints": nodes, "skeleton": nodes[0]})


def add_matrices(draft: Draft, matrices: Float[Array, "joints 4 4"]) -> int:
    """An accessor of affine matrices, column by column as glTF stores them."""
    exact = matrices.copy()
    exact[:, 3] = 0, 0, 0, 1  # inversion leaves 0.9999..., which validators refuse
    return draft.add_accessor(np.swapaxes(exact, 1, 2).reshape(-1, 16).astype(np.float32))


def add_influences(
    draft: Draft, joints: Int[Array, "vertices influences"], weights: Float[Array, "vertices influences"]
) -> dict[str, int]:
    """Accessors of joints and weights, four influences a set, by the names of their attributes."""
    joints, weights = merge_influences(joints, weights)
    small = np.uint8 if joints.max(initial=0) < 256 else np.uint16
    attributes = {}
    for k in range(0, joints.shape[1], 4):
        attributes[f"JOINTS_{k // 4}"] = draft.add_accessor(joints[:, k : k + 4].astype(small), target=VERTEX_DATA)
        attributes[f"WEIGHTS_{k // 4}"] = draft.add_accessor(weights[:, k : k + 4], target=VERTEX_DATA)
    return attributes


def bound_surface(
    mesh: Mesh, skin: Skin, T_world_rest: Float[Array, "joints 4 4"]
) -> tuple[Array, Array, Array, Array]:
    """Vertices, one inverse bind a joint, joints and weights of each vertex, as one glTF skin holds them.

    A skin with one column a joint is written as it is. A joint with two different columns cannot be: then vertices are
    carried to the rest pose and bound there, which is the same in every pose if each vertex's columns agree on where it
    stands at rest. Raises `RetargetError` if they do not.
    """
    joints, weights = skin.joints[skin.columns], skin.weights
    if len(np.unique(skin.joints)) == len(skin.joints):
        inverse_binds = np.linalg.inv(T_world_rest)
        inverse_binds[skin.joints] = skin.inverse_binds
        return mesh.vertices, inverse_binds, joints, weights
    T_rest_mesh = T_world_rest[skin.joints] @ skin.inverse_binds
    points = np.concatenate([mesh.vertices, np.ones((len(mesh.vertices), 1))], axis=1)
    each = np.einsum("vkab,vb->vka", T_rest_mesh[skin.columns][..., :3, :], points)
    placed = (skin.weights[..., None] * each).sum(axis=1)
    apart = np.where(skin.weights > 0, np.linalg.norm(each - placed[:, None], axis=-1), 0.0)
    size = max(float(np.ptp(placed, axis=0).max()), 1e-9)
    if apart.max() > 1e-4 * size:
        raise RetargetError(
            f"vertex {int(apart.max(axis=1).argmax())} is bound in two poses at once ({apart.max():.3g} m apart at "
            "rest); one glTF skin cannot hold that: save to the file format it came from"
        )
    return placed, np.linalg.inv(T_world_rest), joints, weights


def add_mesh(
    draft: Draft, mesh: Mesh, vertices: Array, joints: Array | None, weights: Array | None, name: str
) -> int:
    """The mesh with one primitive a material, and what moves it, if anything; all share the vertex data. Normals are smooth across texture seams."""
    target = {"target": VERTEX_DATA}
    attributes = {
        "POSITION": draft.add_accessor(vertices.astype(np.float32), bounds=True, **target),
        "NORMAL": draft.add_accessor(smooth_normals(vertices, mesh.faces).astype(np.float32), **target),
    }
    if mesh.uvs is not None:
        attributes["TEXCOORD_0"] = draft.add_accessor(mesh.uvs.astype(np.float32), **target)
    if joints is not None:
        attributes |= add_influences(draft, joints, weights)
    materials = mesh.materials or (Material(),)
    groups = np.zeros(len(mesh.faces), int) if mesh.face_materials is None else mesh.face_materials
    numbers: dict[bytes, int] = {}
    primitives = []
    for material in range(len(materials)):
        corners = mesh.faces[groups == material].reshape(-1, 1)
        if len(corners):
            index = np.uint16 if len(vertices) < 65535 else np.uint32
            entry = {"attributes": attributes, "indices": draft.add_accessor(corners.astype(index), target=INDEX_DATA)}
            primitives.append(
                {**entry, "material": add_material(draft, materials[material], mesh.uvs is not None, numbers)}
            )
    if not primitives:
        raise RetargetError("the mesh has no faces to write")
    return draft.add("meshes", {"name": name, "primitives": primitives})


def add_material(draft: Draft, material: Material, textured: bool, pictures: dict[bytes, int]) -> int:
    look: dict[str, Any] = {
        "baseColorFactor": [float(part) for part in material.base_color],
        "metallicFactor": 0.0,
        "roughnessFactor": 0.8,
    }
    if material.image is not None and textured:
        if material.image not in pictures:
            mime = next((m for head, m in PICTURES.items() if material.image.startswith(head)), None)
            if mime not in ("image/png", "image/jpeg"):
                raise RetargetError(f"the picture of material {material.name!r} is neither PNG nor JPEG")
            image = draft.add("images", {"bufferView": draft.add_view(material.image), "mimeType": mime})
            pictures[material.image] = draft.add("textures", {"source": image})
        look["baseColorTexture"] = {"index": pictures[material.image]}
    entry: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": look}
    if material.double_sided:
        entry["doubleSided"] = True
    if material.base_color[3] < 1:
        entry["alphaMode"] = "BLEND"
    return draft.add("materials", entry)


def smooth_normals(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> Float[Array, "vertices 3"]:
    """Unit normals, area-weighted over all faces at the same place, so that texture seams do not show."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    _, place = np.unique(np.round(vertices / (1e-6 * size)).astype(np.int64), axis=0, return_inverse=True)
    place = place.reshape(-1)
    total = np.zeros((int(place.max()) + 1, 3))
    for k in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(place[faces[:, k]], normal[:, axis], len(total))
    result = total[place]
    length = np.linalg.norm(result, axis=1, keepdims=True)
    return np.where(length > 1e-30, result / np.maximum(length, 1e-30), [0.0, 1.0, 0.0])
