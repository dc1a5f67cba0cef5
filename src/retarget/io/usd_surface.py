"""Meshes of a USD stage with their weights, as meshes of a GLB. Runs in the child."""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import FLOAT, UNSIGNED, Glb, fan_triangles
from retarget.io.usd_looks import Looks, first
from retarget.io.usd_transforms import decomposed, placement

MOST_INFLUENCES = 64


def bindings_of(prims: list[Any], skeletons: set[Any], notes: list[str]) -> dict[Any, list[Any]]:
    """The shown meshes that each skeleton moves, by its path: `skel:skeleton` counts for all prims below."""
    found: dict[Any, list[Any]] = {}
    free = 0
    for prim in prims:
        if not is_shown(prim):
            continue
        targets = _inherited_targets(prim, "skel:skeleton")
        if targets and targets[0] in skeletons and _primvar(prim, "skel:jointIndices"):
            found.setdefault(targets[0], []).append(prim)
        else:
            free += 1
    if free:
        notes.append(f"{free} meshes are moved by no skeleton and are left out")
    return found


def is_shown(prim: Any) -> bool:
    """Whether a prim is a mesh that is seen, at first."""
    from pxr import Usd, UsdGeom

    if not prim.IsA(UsdGeom.Mesh):
        return False
    mesh = UsdGeom.Mesh(prim)
    hidden = mesh.ComputeVisibility(Usd.TimeCode.EarliestTime()) == UsdGeom.Tokens.invisible
    return not hidden and mesh.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


def _inherited_targets(prim: Any, name: str) -> list[Any]:
    while prim and not prim.IsPseudoRoot():
        relation = prim.GetRelationship(name)
        if relation and relation.HasAuthoredTargets():
            return list(relation.GetForwardedTargets())
        prim = prim.GetParent()
    return []


def _primvar(prim: Any, name: str) -> Any:
    """The primvar, of the prim or the nearest one above that has it; None where nobody has."""
    from pxr import UsdGeom

    found = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    return found if found and found.HasAuthoredValue() else None


def skinned_meshes(glb: Glb, bones: Any, prims: list[Any], looks: Looks, notes: list[str]) -> None:
    """All meshes of a skeleton, each with a skin; equal skins are one."""
    skins: dict[bytes, int] = {}
    for prim in prims:
        points, triangles, materials, attributes = _geometry(glb, prim, looks)
        if not len(triangles):
            notes.append(f"the mesh {prim.GetName()!r} has no faces and is left out")
            continue
        geometry, columns = _geometry_bind(prim), _joint_map(prim, bones)
        _add_influences(glb, prim, len(points), len(columns), attributes)
        binds = (np.linalg.inv(bones.bind[columns]) @ geometry).astype(np.float32)
        binds[:, 3] = 0, 0, 0, 1
        key = columns.tobytes() + binds.tobytes()
        if key not in skins:
            matrices = glb.add(np.swapaxes(binds, 1, 2), "MAT4", FLOAT)
            skins[key] = glb.append("skins", {
                "joints": [bones.nodes[joint] for joint in columns.tolist()], "inverseBindMatrices": matrices
            })  # fmt: skip
        primitives = _primitives(glb, attributes, triangles, materials)
        _add_node(glb, bones.node, prim, decomposed(geometry), primitives, skins[key])
        _note_left_out(prim, notes)


def add_still_mesh(glb: Glb, prim: Any, looks: Looks) -> np.ndarray | None:
    """A mesh of a stage without skeleton, where it stands in the world; its points, None for what has no surface to show."""
    if not is_shown(prim):
        return None
    points, triangles, materials, attributes = _geometry(glb, prim, looks)
    if not len(triangles):
        return None
    _add_node(glb, 0, prim, decomposed(placement(prim)), _primitives(glb, attributes, triangles, materials), None)
    return points


def _add_node(glb: Glb, above: int, prim: Any, place: dict, primitives: list[dict], skin: int | None) -> None:
    mesh = glb.append("meshes", {"name": prim.GetName(), "primitives": primitives})
    bound = {} if skin is None else {"skin": skin}
    node = glb.append("nodes", {"name": prim.GetName(), **place, "mesh": mesh, **bound})
    glb.json["nodes"][above].setdefault("children", []).append(node)


def _note_left_out(prim: Any, notes: list[str]) -> None:
    if _inherited_targets(prim, "skel:blendShapeTargets"):
        notes.append("blend shapes are left out")
    method = _primvar(prim, "skel:skinningMethod") or prim.GetAttribute("primvars:skel:skinningMethod")
    if method and str(first(method)) == "dualQuaternion":
        notes.append("meshes skinned by dual quaternions are skinned linearly")


def _geometry(glb: Glb, prim: Any, looks: Looks) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, int]]:
    """Points (float32), triangles, the GLB's material of each triangle, and the attributes of what is to be drawn.

    Raises `Refused` for faces that do not fit the points.
    """
    from pxr import UsdGeom

    mesh, path = UsdGeom.Mesh(prim), prim.GetPath()
    points = np.array(first(mesh.GetPointsAttr()) or (), dtype=np.float32).reshape(-1, 3)
    counts = np.array(first(mesh.GetFaceVertexCountsAttr()) or (), dtype=np.int64)
    corners = np.array(first(mesh.GetFaceVertexIndicesAttr()) or (), dtype=np.int64)
    if (counts < 0).any() or counts.sum() != len(corners):
        wanted = f"{int(counts.sum())} corners by their counts, and {len(corners)} indices"
        raise Refused(f"the faces of {path} have {wanted}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        worst = corners.max() if corners.max() >= len(points) else corners.min()
        raise Refused(f"a face of {path} names point {int(worst)} of {len(points)}")
    if not np.isfinite(points).all():
        raise Refused(f"{path} has points that are not numbers")
    of_face, uvs = looks.of_faces(mesh, len(counts), corners, len(points))
    shown, holes = counts.copy(), np.array(first(mesh.GetHoleIndicesAttr()) or (), dtype=np.int64)
    shown[holes[(holes >= 0) & (holes < len(counts))]] = 0
    triangles, owners = fan_triangles(shown, np.cumsum(counts) - counts, corners)
    if str(first(mesh.GetOrientationAttr())) == "leftHanded":
        triangles = triangles[:, ::-1]
    attributes = {"POSITION": glb.add(points, "VEC3", FLOAT, bounds=True)} if len(triangles) else {}
    if uvs is not None and attributes:
        attributes["TEXCOORD_0"] = glb.add(uvs.astype(np.float32), "VEC2", FLOAT)
    return points, triangles, of_face[owners], attributes


def _joint_map(prim: Any, bones: Any) -> np.ndarray:
    """The skeleton's joint behind each joint of a mesh, which may list its own (`skel:joints`)."""
    above = prim
    while above and not above.IsPseudoRoot():
        value = above.GetAttribute("skel:joints").Get() if above.HasAttribute("skel:joints") else None
        if value is not None and len(value):
            place = {token: number for number, token in enumerate(bones.tokens)}
            unknown = [str(token) for token in value if str(token) not in place]
            if unknown:
                raise Refused(f"{prim.GetPath()} follows the joint {unknown[0]!r}, which its skeleton has not")
            return np.array([place[str(token)] for token in value], dtype=np.int64)
        above = above.GetParent()
    return np.arange(len(bones.tokens))


def _geometry_bind(prim: Any) -> np.ndarray:
    primvar = _primvar(prim, "skel:geomBindTransform")
    value = first(primvar.GetAttr()) if primvar else None
    if value is None:
        return np.eye(4)
    matrix = np.array(value, dtype=np.float64).T
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 1e12 or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise Refused(f"{prim.GetPath()} was bound by a matrix that cannot be inverted")
    return matrix


def _add_influences(glb: Glb, prim: Any, count: int, bones: int, attributes: dict[str, int]) -> None:
    """Joints and weights, four a set; those of a rigid mesh (constant) stand for all of its points."""
    path, shaped = prim.GetPath(), []
    for name, kind in (("skel:jointIndices", np.int64), ("skel:jointWeights", np.float64)):
        primvar = _primvar(prim, name)
        if primvar is None:
            raise Refused(f"{path} has joints without weights")
        width, values = primvar.GetElementSize(), np.array(primvar.ComputeFlattened() or (), dtype=kind).ravel()
        rows = 1 if str(primvar.GetInterpolation()) == "constant" else count
        if not 0 < width <= MOST_INFLUENCES or len(values) != rows * width:
            raise Refused(f"{path} has {len(values)} values of {name} for {rows} points with {width} each")
        shaped.append(np.broadcast_to(values.reshape(rows, width), (count, width)))
    joints, weights = shaped
    if joints.shape != weights.shape:
        raise Refused(f"{path} has {joints.shape[1]} joints a point, and {weights.shape[1]} weights")
    used = weights > 0
    if joints[used].size and not 0 <= joints[used].min() <= joints[used].max() < bones:
        raise Refused(f"a point of {path} follows joint {int(joints[used].max())} of {bones}")
    pad = ((0, 0), (0, -joints.shape[1] % 4))
    joints, weights = np.pad(np.where(used, joints, 0), pad), np.pad(np.where(used, weights, 0.0), pad)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, total, out=weights.copy(), where=np.isfinite(total) & (total > 1e-9))
    attributes |= glb.add_influences(joints, weights)


def _primitives(glb: Glb, attributes: dict[str, int], triangles: np.ndarray, materials: np.ndarray) -> list[dict]:
    return [
        {
            "attributes": attributes, "material": material,
            "indices": glb.add(triangles[materials == material].ravel().astype(np.uint32), "SCALAR", UNSIGNED),
        }
        for material in np.unique(materials).tolist()
    ]  # fmt: skip
