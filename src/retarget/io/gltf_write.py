"""Motions into glTF files: appended to the file a character came from, or with a document made new."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions
from retarget.character import Character, Motion, Skeleton
from retarget.errors import FileError, RetargetError
from retarget.io.gltf_build import add_influences, add_matrices, bare_document, character_document
from retarget.io.gltf_draft import Draft, write_files
from retarget.io.gltf_nodes import GltfOrigin, Rig, node_transform
from retarget.io.gltf_prune import prune
from retarget.io.provenance import KEY, provenance_record
from retarget.io.vrm import is_vrm

Array = np.ndarray


def save(
    path: str | Path,
    character: Character,
    motions: Sequence[Motion] = (),
    *,
    animation_only: bool = False,
    keep_clips: bool = True,
) -> None:
    """Write a character with its motions as .glb, or as .gltf with a .bin beside it, by the suffix of `path`.

    A character that was read from glTF keeps its file: everything in it stays, byte for byte, and the motions are
    appended as animations, in terms of its own nodes (which is why its mesh and skin are taken from there, whatever
    the character holds now). What had to be repaired on reading is written repaired, behind the faulty data.
    `keep_clips=False` leaves out the clips it had, and their data. Any other character is written anew. `animation_only` writes the
    joints and the motions: no surface, no pictures, no earlier clips. A .vrm is a GLB of a character that came from a VRM,
    whole.

    Raises `RetargetError` if a motion belongs to another skeleton or has no frames, `FileError` if `path` cannot be
    written. The file appears whole or not at all.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".glb", ".gltf", ".vrm"):
        raise FileError(path, f"glTF is written as .glb or .gltf, received the suffix {path.suffix!r}")
    check_holds(path, character, animation_only)
    origin = character.origin if isinstance(character.origin, GltfOrigin) else None
    if origin is not None:
        check_skeleton("the character", character.skeleton, origin.skeleton)
    for motion in motions:
        check_skeleton(f"the motion {motion.name!r}", motion.skeleton, character.skeleton)
        if not len(motion):
            raise RetargetError(f"the motion {motion.name!r} has no frames to write")
    if origin is None:
        draft, rig = character_document(character, animation_only)
    elif animation_only:
        draft, rig = bare_document(character, origin)
    else:
        draft, rig = Draft.of(origin.document, keep_clips), origin.rig
        _repair(draft, origin)
    if motions:
        _free_nodes(draft, rig, path)
        held = _held_channels(draft, rig, motions)
        for motion in motions:
            append_motion(draft, rig, motion, held)
    if origin is not None and not (keep_clips or animation_only):
        prune(draft)
    draft.json["asset"]["generator"] = "retarget"
    write_files(draft.gltf(path) if suffix == ".gltf" else draft.glb(path))


def check_holds(path: Path, character: Character, animation_only: bool) -> None:
    """Refuse a .vrm for what is none, before any work is done. Raises `FileError`."""
    if path.suffix.lower() != ".vrm":
        return
    if animation_only:
        raise FileError(path, "animation alone is no VRM; write a .glb")
    if not isinstance(character.origin, GltfOrigin) or not is_vrm(character.origin.document):
        raise FileError(path, "the character came from no VRM, whose humanoid and terms of use it would need; write a .glb")


def check_skeleton(owner: str, skeleton: Skeleton, expected: Skeleton) -> None:
    """Raises `RetargetError` if a skeleton has other joints than the one that is written."""
    if skeleton.names == expected.names and np.array_equal(skeleton.parents, expected.parents):
        return
    other = next((f"{a!r} instead of {b!r}" for a, b in zip(skeleton.names, expected.names) if a != b), "other parents")
    raise RetargetError(
        f"{owner} has another skeleton than the character written to: {len(skeleton)} joints against "
        f"{len(expected)}, {other}"
    )


def _repair(draft: Draft, origin: GltfOrigin) -> None:
    """Give skins and primitives whose data was faulty mended data, behind everything else.

    The faulty bytes stay where they are; the accessors that showed them show the mended data too.
    """
    accessors = draft.json.get("accessors", [])
    for number, inverse_binds in origin.binds.items():
        skin, matrices = draft.json["skins"][number], add_matrices(draft, inverse_binds)
        accessors[skin["inverseBindMatrices"]] = accessors[matrices]
        draft.json["skins"][number] = {**skin, "inverseBindMatrices": matrices}
    mended = {key: add_influences(draft, each.joints, each.weights) for key, each in origin.influences.items()}
    instead: dict[int, int] = {}
    in_use: set[int] = set()
    for number, mesh in enumerate(draft.json.get("meshes", ())):
        primitives = list(mesh["primitives"])
        for position, primitive in enumerate(primitives):
            attributes = primitive["attributes"]
            new = mended.get((attributes.get("JOINTS_0"), attributes.get("WEIGHTS_0")))
            if new is not None:
                bound = {name: old for name, old in attributes.items() if name.startswith(("JOINTS_", "WEIGHTS_"))}
                instead |= {old: new.get(name, new[name.split("_")[0] + "_0"]) for name, old in bound.items()}
                attributes = {name: old for name, old in attributes.items() if name not in bound} | new
                primitives[position] = {**primitive, "attributes": attributes}
            in_use |= set(attributes.values())
        if mended:
            draft.json["meshes"][number] = {**mesh, "primitives": primitives}
    for old, new in instead.items():
        if old not in in_use:
            accessors[old] = accessors[new]


def _free_nodes(draft: Draft, rig: Rig, path: Path) -> None:
    """Give joints that are placed by a matrix a translation, rotation and scale: only these can be animated."""
    for number in rig.nodes.tolist():
        node = draft.json["nodes"][number]
        if "matrix" not in node:
            continue
        translation, rotation, shape = node_transform(node)
        scale = np.diag(shape)
        if np.abs(shape - np.diag(scale)).max() > 1e-4 * np.abs(shape).max():
            raise FileError(
                path, f"the joint {node.get('name', number)!r} has a sheared matrix, which glTF cannot animate"
            )
        kept = {key: value for key, value in node.items() if key != "matrix"}
        own = {"translation": translation.tolist(), "rotation": rotation.tolist(), "scale": scale.tolist()}
        draft.json["nodes"][number] = {**kept, **own}


def _held_channels(draft: Draft, rig: Rig, motions: Sequence[Motion]) -> set[tuple[int, str]]:
    """Node and path of all channels that a new clip must set.

    Besides the joints that a motion moves, these are the channels of all other clips in the file: where players go from
    one clip to the next, what the next does not set stays as it was (Blender).
    """
    joints = set(rig.nodes.tolist())
    held = {
        (channel["target"]["node"], channel["target"]["path"])
        for animation in draft.json.get("animations", ())
        for channel in animation["channels"]
        if channel["target"].get("node") in joints
    }
    at_rest, _ = rig.to_skeleton(rig.translations, rig.rotations)
    size = max(float(np.ptp(at_rest, axis=0).max()), 1e-9)
    for motion in motions:
        positions = local_positions(motion.skeleton, motion.translations, motion.moved)
        away = np.abs(positions - at_rest).max(axis=(0, 2)) > 5e-7 * size
        held |= {(int(rig.nodes[joint]), "translation") for joint in (*np.flatnonzero(away), *motion.moved)}
    return held


def append_motion(draft: Draft, rig: Rig, motion: Motion, held: set[tuple[int, str]]) -> None:
    """Add one animation: rotations of all joints, positions and scales of those in `held`."""
    positions = local_positions(motion.skeleton, motion.translations, motion.moved)
    translations, rotations = rig.to_nodes(positions, motion.rotations)
    rotations = rot.continuous(rot.normalise(rotations)).astype(np.float32)
    translations = translations.astype(np.float32)
    values, targets = [], []
    for joint, node in enumerate(rig.nodes.tolist()):
        values.append(rotations[:, joint])
        targets.append({"node": node, "path": "rotation"})
        if (node, "translation") in held:
            values.append(translations[:, joint])
            targets.append({"node": node, "path": "translation"})
        if (node, "scale") in held:
            scale = np.array(draft.json["nodes"][node].get("scale", (1, 1, 1)), np.float32)
            values.append(np.tile(scale, (len(motion), 1)))
            targets.append({"node": node, "path": "scale"})
    # A channel that stands still needs its first and last key only; both lists of key times are shared.
    still = [len(each) > 2 and bool((each == each[0]).all()) for each in values]
    times = (np.arange(len(motion)) / motion.fps).astype(np.float32)[:, None]
    every = draft.add_accessor(times, bounds=True) if not all(still) else None
    ends = draft.add_accessor(times[[0, -1]], bounds=True) if any(still) else None
    outputs = draft.add_accessors([each[:2] if quiet else each for each, quiet in zip(values, still)])
    samplers = [{"input": ends if quiet else every, "output": output} for quiet, output in zip(still, outputs)]
    channels = [{"sampler": number, "target": target} for number, target in enumerate(targets)]
    entry = {"name": _free_name(draft, motion.name or "motion"), "samplers": samplers, "channels": channels}
    if motion.made_from is not None:
        entry["extras"] = {KEY: provenance_record(motion.made_from)}
    draft.add("animations", entry)


def _free_name(draft: Draft, name: str) -> str:
    taken = {animation.get("name") for animation in draft.json.get("animations", ())}
    number, free = 2, name
    while free in taken:
        number, free = number + 1, f"{name}_{number}"
    return free
