"""Runs in a process of its own: one USD file, written as the GLB it would be.

The stage becomes a root node that turns and scales to metres with +Y up, below it the skeleton's prim, below that its
joints by their rest transforms. Skinned meshes hang from the skeleton's node, whose space UsdSkel skins in:

    p_skeleton = sum_k w_k J_k B_k^-1 G p      (J joint, B bind transform, G geomBindTransform; columns as in glTF)

so that J is the joint's node, and B^-1 G the inverse bind matrix of glTF.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from retarget.io.child import Refused
from retarget.io.glb import Glb
from retarget.io.usd_clips import add_clips
from retarget.io.usd_layers import home_of, in_plain_words, neighbours, open_stage, prims_of, size_within
from retarget.io.usd_looks import Looks
from retarget.io.usd_points import add_meshes
from retarget.io.usd_surface import bindings_of, skinned_meshes
from retarget.io.usd_transforms import decomposed, placement

FROM_Z_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
MOST_JOINTS = 20_000
MEMORY, MEMORY_A_BYTE = 5 << 29, 16
"""Bytes that the work may take, and how many more for each byte of what it may read. A damaged count is met only when the
memory is full, and to fill all that a child may have takes ten seconds."""


@dataclass
class Bones:
    """The skeleton that is read."""

    prim: Any
    tokens: list[str]
    """Paths of the joints, as animations and meshes name them."""
    names: list[str]
    parents: list[int]
    rest: np.ndarray
    """(joints, 4, 4) parent-from-joint, columns."""
    bind: np.ndarray
    """(joints, 4, 4) skeleton-from-joint at binding, columns."""
    nodes: list[int] = field(default_factory=list)
    """The GLB's node of each joint."""
    node: int = 0
    """The GLB's node of the skeleton itself."""


def memory(source: str, *_: str) -> int:
    """Bytes of memory for reading a file, with all layers that it may refer to."""
    return MEMORY + MEMORY_A_BYTE * size_within(source)


def work(source: str, output: str) -> dict[str, Any]:
    """Write the GLB; returns what the file says of itself."""
    return in_plain_words(lambda: convert(source, output))


def convert(source: str, output: str) -> dict[str, Any]:
    """As `work`; errors of usd-core as they come."""
    stage, notes, _ = open_stage(source)
    prims, glb = prims_of(stage), Glb()
    looks = Looks(glb, home_of(source), notes)
    told = _add_stage(glb, stage)
    skeleton, bound = choose_skeleton(prims, notes)
    if skeleton is not None:
        bones = read_bones(skeleton, notes)
        _add_bones(glb, bones, notes)
        skinned_meshes(glb, bones, bound, looks, notes)
        told["bound"] = add_clips(glb, stage, bones, prims, notes)
        told |= {"skeleton": str(skeleton.GetPath()), "joints": dict(zip(map(str, bones.nodes), bones.tokens))}
    else:
        told["sequence"] = add_meshes(glb, stage, prims, looks, f"{output}.points")
    glb.write(output)
    return told | {"notes": list(dict.fromkeys(notes)), "beside": neighbours(source)}


def _add_stage(glb: Glb, stage: Any) -> dict[str, Any]:
    from pxr import UsdGeom

    unit, up = float(UsdGeom.GetStageMetersPerUnit(stage)), str(UsdGeom.GetStageUpAxis(stage))
    if not 1e-9 < unit < 1e9:
        raise Refused(f"says that a unit has {unit:g} metres")
    if up not in ("Y", "Z"):
        raise Refused(f"says that {up!r} points up; Y and Z can")
    rate = float(stage.GetTimeCodesPerSecond())
    if not 1e-3 < rate < 1e6:
        raise Refused(f"says that a second has {rate:g} time codes")
    node: dict[str, Any] = {"name": "stage", "scale": [unit] * 3}
    if up == "Z":
        node["rotation"] = FROM_Z_UP
    glb.append("nodes", node | {"children": []})
    glb.json |= {"scene": 0, "scenes": [{"nodes": [0]}]}
    stated = bool(UsdGeom.StageHasAuthoredMetersPerUnit(stage))
    return {"unit_m": unit, "unit_stated": stated, "up": up.lower(), "rate": rate}


def choose_skeleton(prims: list[Any], notes: list[str]) -> tuple[Any, list[Any]]:
    """The skeleton that moves the most points (has the most joints, where none moves any), and its meshes."""
    from pxr import UsdSkel

    skeletons = {prim.GetPath(): prim for prim in prims if prim.IsA(UsdSkel.Skeleton)}
    if not skeletons:
        return None, []
    bound = bindings_of(prims, set(skeletons), notes)

    def weight(path: Any) -> tuple[int, int]:
        points = sum(len(mesh.GetAttribute("points").Get(1.0) or ()) for mesh in bound.get(path, ()))
        return points, len(skeletons[path].GetAttribute("joints").Get() or ())

    best = max(skeletons, key=weight)
    if len(skeletons) > 1:
        others = ", ".join(sorted(path.name for path in skeletons if path != best)[:3])
        notes.append(f"of {len(skeletons)} skeletons {best.name!r} is read, which moves the most; left out: {others}")
    return skeletons[best], bound.get(best, [])


def read_bones(prim: Any, notes: list[str]) -> Bones:
    """Joints and their transforms. Raises `Refused` for a skeleton without joints, or with matrices that fit none."""
    tokens = [str(token) for token in prim.GetAttribute("joints").Get() or ()]
    path = prim.GetPath()
    if not tokens or len(tokens) > MOST_JOINTS:
        raise Refused(f"the skeleton {path} has {len(tokens)} joints")
    if len(set(tokens)) != len(tokens):
        raise Refused(f"the skeleton {path} names a joint twice")
    place = {token: number for number, token in enumerate(tokens)}
    parents = [_parent(token, place) for token in tokens]
    names = [str(name) for name in prim.GetAttribute("jointNames").Get() or ()]
    if len(names) != len(tokens):
        names = [token.rsplit("/", 1)[-1] or f"joint_{number}" for number, token in enumerate(tokens)]
    rest, bind = (_matrices(prim, name, len(tokens)) for name in ("restTransforms", "bindTransforms"))
    if rest is None and bind is None:
        raise Refused(f"the skeleton {path} has neither rest nor bind transforms for its {len(tokens)} joints")
    order = sorted(range(len(tokens)), key=lambda joint: tokens[joint].count("/"))  # parents first
    if rest is None:
        notes.append("the skeleton has no rest transforms; it rests as it was bound")
        rest = np.stack([
            bind[joint] if parent < 0 else np.linalg.solve(bind[parent], bind[joint])
            for joint, parent in enumerate(parents)
        ])  # fmt: skip
    if bind is None:
        notes.append("the skeleton has no bind transforms; it was bound as it rests")
        bind = rest.copy()
        for joint in order:
            if parents[joint] >= 0:
                bind[joint] = bind[parents[joint]] @ rest[joint]
    return Bones(prim, tokens, names, parents, rest, bind)


def _parent(token: str, place: dict[str, int]) -> int:
    """The nearest joint above, by paths; joints in between may be left out."""
    while "/" in token:
        token = token.rsplit("/", 1)[0]
        if token in place:
            return place[token]
    return -1


def _matrices(prim: Any, name: str, count: int) -> np.ndarray | None:
    """(count, 4, 4) as columns; None where they are not there or of another number."""
    value = prim.GetAttribute(name).Get()
    if value is None or len(value) != count:
        return None
    matrices = np.swapaxes(np.array(value, dtype=np.float64).reshape(-1, 4, 4), 1, 2).copy()
    size = np.abs(matrices[:, :3]).max(axis=(1, 2))
    if not np.isfinite(matrices).all() or (size > 1e12).any() or (np.linalg.matrix_rank(matrices[:, :3, :3]) < 3).any():
        raise Refused(f"{prim.GetPath()}: {name} has a matrix that cannot be inverted")
    matrices[:, 3] = 0, 0, 0, 1
    return matrices


def _add_bones(glb: Glb, bones: Bones, notes: list[str]) -> None:
    placed = decomposed(placement(bones.prim))
    bones.node = glb.append("nodes", {"name": bones.prim.GetName(), **placed, "children": []})
    glb.json["nodes"][0]["children"].append(bones.node)
    for name, matrix in zip(bones.names, bones.rest):
        entry = decomposed(matrix)
        if "matrix" in entry:
            notes.append(f"the rest transform of the joint {name!r} is sheared")
        bones.nodes.append(glb.append("nodes", {"name": name, **entry}))
    for node, parent in zip(bones.nodes, bones.parents):
        above = glb.json["nodes"][bones.node if parent < 0 else bones.nodes[parent]]
        above.setdefault("children", []).append(node)
    glb.append("skins", {"joints": list(bones.nodes)})  # all of them, those too that move no vertex
