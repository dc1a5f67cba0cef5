"""Data that nothing refers to any more, taken out of a glTF document that is about to be written.

The clips of a game character are often most of its file. Where they are left out, so are their numbers.
"""

from __future__ import annotations

from typing import Any

from retarget.io.gltf_draft import Draft

HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_punctual", "KHR_mesh_quantization", "EXT_texture_", "VRM")
"""Beginnings of extensions that refer to no accessor and no buffer view; with any other one everything is kept."""


def prune(draft: Draft) -> None:
    """Drop accessors and buffer views that nothing refers to, and the bytes of such views in the first buffer.

    What remains keeps its order and its bytes and is renumbered. Where the document uses an extension that may refer
    to data in its own way, nothing is done.
    """
    used = draft.json.get("extensionsUsed", ())
    if not all(any(name.startswith(start) for start in HARMLESS) for name in used):
        return
    accessors, views = draft.json.get("accessors", []), draft.json.get("bufferViews", [])
    kept = sorted({holder[key] for holder, key in _to_accessors(draft.json)})
    _renumber(draft, "accessors", kept, _to_accessors)
    seen = sorted({holder[key] for holder, key in _to_views(draft.json)})
    if len(seen) < len(views) or len(kept) < len(accessors):
        _renumber(draft, "bufferViews", seen, _to_views)
        _close_gaps(draft)


def _renumber(draft: Draft, kind: str, kept: list[int], references) -> None:
    if kind not in draft.json:
        return
    entries = draft.json[kind]
    new = {old: number for number, old in enumerate(kept)}
    _own(draft.json)
    for holder, key in references(draft.json):
        holder[key] = new[holder[key]]
    draft.json[kind] = [draft.json[kind][number] for number in kept]
    if not draft.json[kind] and entries:
        del draft.json[kind]


def _own(json: dict[str, Any]) -> None:
    """Entries of a draft are shared with the document it began as: before they change they are copied."""
    import copy

    for kind in ("accessors", "bufferViews", "meshes", "skins", "animations", "images"):
        if kind in json:
            json[kind] = [copy.deepcopy(entry) for entry in json[kind]]  # apart: one entry may stand in two places


def _to_accessors(json: dict[str, Any]) -> list[tuple[dict, str]]:
    """Every place that names an accessor, as an object and its key (glTF 2.0, section 5)."""
    found: list[tuple[dict, str]] = []
    for mesh in json.get("meshes", ()):
        for primitive in mesh["primitives"]:
            for group in (primitive["attributes"], *primitive.get("targets", ())):
                found += [(group, name) for name in group]
            found += [(primitive, "indices")] if "indices" in primitive else []
    found += [(skin, "inverseBindMatrices") for skin in json.get("skins", ()) if "inverseBindMatrices" in skin]
    for animation in json.get("animations", ()):
        found += [(sampler, key) for sampler in animation["samplers"] for key in ("input", "output")]
    return found


def _to_views(json: dict[str, Any]) -> list[tuple[dict, str]]:
    """Every place that names a buffer view."""
    holders: list[dict] = [*json.get("accessors", ()), *json.get("images", ())]
    for accessor in json.get("accessors", ()):
        if "sparse" in accessor:
            holders += [accessor["sparse"]["indices"], accessor["sparse"]["values"]]
    return [(holder, "bufferView") for holder in holders if "bufferView" in holder]


def _close_gaps(draft: Draft) -> None:
    """Write the first buffer anew from what its views show; views may overlap, and each place is written once."""
    views = [view for view in draft.json.get("bufferViews", ()) if view["buffer"] == 0]
    binary, end_old, shift = bytearray(), 0, 0
    for view in sorted(views, key=lambda each: each.get("byteOffset", 0)):
        start = view.get("byteOffset", 0)
        end = start + view["byteLength"]
        if start >= end_old:  # a gap: what follows moves up, as aligned as it was
            binary.extend(b"\0" * ((start - len(binary)) % 16))
            shift, end_old = start - len(binary), start
        binary.extend(draft.binary[max(start, end_old) : end])
        end_old = max(end, end_old)
        view["byteOffset"] = start - shift
    draft.binary = binary
    if not binary and len(draft.json.get("buffers", ())) == 1:
        del draft.json["buffers"]
