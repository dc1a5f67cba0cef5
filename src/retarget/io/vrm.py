"""The humanoid that a VRM file names: which node is which joint of a human.

A `.vrm` is a GLB with the extension VRM (0.x) or VRMC_vrm (1.0), a `.vrma` one with VRMC_vrm_animation; the glTF reader reads
them all, and asks here. What the file says is trusted over names. Faulty entries are left out and told of; whether what is
left makes a human is for the matching to say. Sources: the VRM 0.0 and VRMC_vrm-1.0 specifications, vrm-c/vrm-specification.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from retarget.io.gltf_document import Document
from retarget.io.gltf_schema import shown

EXTENSIONS = {"VRMC_vrm": "VRM 1.0", "VRM": "VRM 0.x", "VRMC_vrm_animation": "VRM animation 1.0"}
"""Where a humanoid is looked for, the newer first: some files carry both."""
FORWARD = {"VRM": "-z"}
"""Where a body faces, other than along +z."""

_SIDED = (
    "UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand",
    "ThumbMetacarpal", "ThumbProximal", "ThumbDistal",
    *(finger + bone for finger in ("Index", "Middle", "Ring", "Little")
      for bone in ("Proximal", "Intermediate", "Distal")),
)  # fmt: skip
BONES = frozenset(
    ("hips", "spine", "chest", "upperChest", "neck", "head", "leftEye", "rightEye", "jaw",
     *(side + part for side in ("left", "right") for part in _SIDED))
)  # fmt: skip
"""The bones of VRM 1.0, which are our humanoid joints."""
RENAMED = {
    side + old: side + new
    for side in ("left", "right")
    for old, new in (("ThumbProximal", "ThumbMetacarpal"), ("ThumbIntermediate", "ThumbProximal"))
}
"""Bones of VRM 0.x that have another name in 1.0: its thumbs count from the finger, not from the palm."""


@dataclass(frozen=True)
class NamedBones:
    """The bones that a file names."""

    nodes: dict[str, int]
    """Bone of VRM 1.0 to node; every node once."""
    extension: str
    notes: tuple[str, ...]
    """Entries left out, one sentence each."""

    @property
    def version(self) -> str:
        """In words."""
        return EXTENSIONS[self.extension]


def is_vrm(document: Document) -> bool:
    """Whether a document holds a VRM character."""
    return any(name in ("VRM", "VRMC_vrm") for name in _extensions(document))


def _extensions(document: Document) -> dict[str, Any]:
    held = document.json.get("extensions")
    return held if type(held) is dict else {}


def named_bones(document: Document) -> NamedBones | None:
    """The humanoid of a VRM or VRM animation; None for any other file."""
    held = _extensions(document)
    extension = next((name for name in EXTENSIONS if name in held), None)
    if extension is None:
        return None
    count, nodes, notes = len(document.entries("nodes")), {}, []
    try:
        entries = list(_entries(extension, held[extension]))
    except (TypeError, KeyError, AttributeError):
        return NamedBones(
            {}, extension, (f"the humanoid of {EXTENSIONS[extension]} cannot be read and is passed over",)
        )
    for bone, node in entries:
        name = RENAMED.get(bone, bone) if extension == "VRM" and type(bone) is str else bone
        if type(name) is not str or name not in BONES:
            problem = "there is no such bone"
        elif node == -1:
            continue  # how some exporters list bones that the avatar lacks
        elif type(node) is not int or not 0 <= node < count:
            problem = f"there is no node {shown(node)}"
        elif name in nodes:
            problem = "it is named twice, and the first counts"
        elif node in nodes.values():
            problem = f"node {node} is {next(each for each, other in nodes.items() if other == node)} already"
        else:
            nodes[name] = node
            continue
        notes.append(f"the humanoid bone {shown(bone)} is left out: {problem}")
    return NamedBones(nodes, extension, tuple(notes))


def _entries(extension: str, held: Any) -> Iterator[tuple[Any, Any]]:
    """Bone and node as they stand in the file; None for what an entry lacks. Raises where there are no entries."""
    bones = held["humanoid"]["humanBones"]
    entries = [(None, each) for each in bones] if extension == "VRM" else bones.items()
    for bone, each in entries:
        entry = each if type(each) is dict else {}
        yield entry.get("bone") if extension == "VRM" else bone, entry.get("node")
