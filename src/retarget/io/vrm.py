"""Which joints of a VRM avatar are which: VRM 0.x and 1.0 files are GLB files that say it themselves.

Extensions `VRM` (0.x: a list of bone and node) and `VRMC_vrm` (1.0: an object). What the file says is trusted over names and
shape. All else that VRM adds (materials, springs, constraints, who may use it) stays in the file untouched.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from retarget.io.gltf_document import Document
from retarget.io.gltf_nodes import Rig

REQUIRED = ("hips", "spine", "head", *(
    f"{side}{part}" for side in ("left", "right")
    for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
))  # fmt: skip
"""Without these the specification knows no humanoid."""
THUMBS = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}
"""What VRM 0.x calls the bones of a thumb, by VRM 1.0's names."""
BONES = 64
"""More entries than VRM has bones are not looked at."""


def is_vrm(document: Document) -> bool:
    """Whether a document is an avatar of either version."""
    extensions = document.json.get("extensions")
    return isinstance(extensions, dict) and bool({"VRM", "VRMC_vrm"} & set(extensions))


def humanoid_map(document: Document, rig: Rig, names: tuple[str, ...]) -> tuple[dict[str, str] | None, list[str]]:
    """Canonical name (VRM 1.0's) to joint name, and notes; None for a file that is no VRM or whose map misses required bones.

    Raises `FileError` for a map that names nodes which do not exist, or one node for two bones.
    """
    said = _bones(document)
    if said is None:
        return None, []
    joint_of = {int(node): joint for joint, node in enumerate(np.asarray(rig.nodes))}
    found, away, nodes = {}, [], {}
    for bone, node in said.items():
        if type(node) is not int or not 0 <= node < len(document.entries("nodes")):
            raise document.fail(f"the humanoid bone {bone!r} is node {str(node)[:20]}, which does not exist", "extensions")
        if node in nodes:
            raise document.fail(f"node {node} is two humanoid bones, {nodes[node]!r} and {bone!r}", "extensions")
        nodes[node] = bone
        if node in joint_of:
            found[bone] = names[joint_of[node]]
        else:
            away.append(bone)
    notes = [f"VRM's humanoid bone{'s' if len(away) > 1 else ''} {', '.join(away[:4])} move no surface and are left out"] if away else []
    missing = [bone for bone in REQUIRED if bone not in found]
    if missing:
        notes.append(f"VRM's humanoid has no {', '.join(missing[:4])}: joints are matched by names and shape")
        return None, notes
    return found, notes


def _bones(document: Document) -> dict[str, Any] | None:
    """Bones by VRM 1.0's names with their nodes; None where the file has no such extension, or an unknown form of it."""
    extensions = document.json.get("extensions")
    if not isinstance(extensions, dict):
        return None
    newer, older = (_within(extensions, name, "humanoid", "humanBones") for name in ("VRMC_vrm", "VRM"))
    if isinstance(newer, dict):
        rows = [(bone, each.get("node")) for bone, each in list(newer.items())[:BONES] if isinstance(each, dict)]
    elif isinstance(older, list):
        rows = [(each.get("bone"), each.get("node")) for each in older[:BONES] if isinstance(each, dict)]
        rows = [(_renamed(bone), node) for bone, node in rows if isinstance(bone, str)]
        rows = [(bone, node) for bone, node in rows if node != -1]  # how some exporters say that there is none
    else:
        return None
    twice = next((bone for number, (bone, _) in enumerate(rows) if bone in [each for each, _ in rows[:number]]), None)
    if twice is not None:
        raise document.fail(f"names the humanoid bone {twice!r} twice", "extensions")
    return dict(rows)


def _within(data: Any, *path: str) -> Any:
    for key in path:
        data = data.get(key) if isinstance(data, dict) else None
    return data


def _renamed(bone: str) -> str:
    """The name in VRM 1.0 of a bone of VRM 0.x."""
    for side in ("left", "right"):
        part = bone.removeprefix(side)
        if part != bone:
            return side + THUMBS.get(part, part)
    return bone
