"""glTF 2.0 and GLB, read and written with json, struct and numpy alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from retarget.character import Character
from retarget.io.asset import MOST_JOINTS, Asset, Convention
from retarget.io.gltf_bind import read_bindings, rest_skeleton
from retarget.io.gltf_clips import list_clips, moving_nodes, read_motion, scaling_joints
from retarget.io.gltf_document import Document, files_beside, read_document
from retarget.io.gltf_draco import decompressed
from retarget.io.gltf_morph import animates_weights, read_sequence
from retarget.io.gltf_nodes import (
    GltfOrigin,
    NodeTree,
    animated_nodes,
    is_uniform,
    joint_names,
    joint_nodes,
    make_rig,
    read_tree,
)
from retarget.io.gltf_surface import read_still_mesh, read_surface
from retarget.io.gltf_write import save
from retarget.io.vrm import FORWARD, NamedBones, named_bones

__all__ = ["GltfOrigin", "load", "save"]

# What the specification says of every file (section 3.4); whether a file keeps to it is another matter.
CONVENTION = Convention(metres_per_unit=1.0, up="+y", forward="+z")


def load(path: str | Path) -> Asset:
    """Read a .glb, .gltf, .vrm or .vrma file: skeleton, surface, materials, and its clips, decoded when asked for.

    The kind is 'character' for a file with a surface that its joints move, 'motion' for a skeleton without, 'mesh' for
    one without a skeleton, 'mesh sequence' where
    animated morph targets move that. The rest pose is the one in which the mesh was bound, if the file tells it. Joints are
    rigid: scaled nodes become lengths, and `Skin.inverse_binds` carries their scale. Vertices lie where they stood in
    the world at binding. Data compressed with Draco or meshopt are unfolded; the humanoid that a VRM names comes along.

    Raises `FileError` for whatever cannot be read, with its place in the file.
    """
    document = read_document(Path(path))
    return replace(from_document(decompressed(document)), beside=files_beside(document.path, document.json))


def from_document(document: Document) -> Asset:
    """What a parsed document holds; as `load`."""
    tree, bones = read_tree(document), named_bones(document)
    in_skins = {node for skin in document.entries("skins") for node in skin["joints"]}
    moving = moving_nodes(document, animated_nodes(document) - in_skins)
    nodes = joint_nodes(document, tree, moving | set(bones.nodes.values() if bones else ()))
    if len(nodes) > MOST_JOINTS:
        raise document.fail(f"has {len(nodes)} joints, more than {MOST_JOINTS}; this is no skeleton")
    if nodes:
        asset = _skeletal(document, tree, nodes)
        asset = replace(asset, notes=(*document.notes, *asset.notes))
        return asset if bones is None else _with_humanoid(asset, bones, nodes)
    mesh, notes = read_still_mesh(document, tree)
    if mesh is None:
        raise document.fail("holds neither a skeleton nor a mesh")
    sequence = read_sequence(document, tree, mesh) if animates_weights(document) else None
    if sequence is not None:
        return Asset(document.path, "mesh sequence", sequence=sequence, convention=CONVENTION, notes=tuple(notes))
    left = len(document.entries("animations"))
    if left:
        notes.append(f"{left} animations move no node and are left out")
    return Asset(document.path, "mesh", mesh=mesh, convention=CONVENTION, notes=(*document.notes, *notes))


def _skeletal(document: Document, tree: NodeTree, nodes: list[int]) -> Asset:
    rig = make_rig(tree, nodes)
    size = max(float(np.ptp(tree.world[nodes][:, :3, 3], axis=0).max()), 1e-6)
    names = joint_names(document, nodes)
    bindings, notes = read_bindings(document, tree, rig, size)
    skeleton, more = rest_skeleton(names, rig, bindings, size)
    notes += more
    surface = read_surface(document, tree, rig, skeleton, bindings, size)
    mesh, skin = (surface.mesh(), surface.skin()) if surface.faces else (None, None)
    notes += surface.notes
    binds = {number: binding.inverse_binds for number, binding in enumerate(bindings) if not binding.clean}
    clips, numbers, more = list_clips(document, rig)
    notes += more
    if mesh is not None and animates_weights(document):
        notes.append("its morph targets are animated: a written glTF keeps that, all else shows them at their default weights")
    uneven = [joint for joint in range(len(names)) if not is_uniform(rig.stretch[joint])]
    if uneven:
        notes.append(f"{_some(names, uneven)} scaled unevenly: the surface is exact at rest, near it in other poses")
    scaling = scaling_joints(document, rig)
    if scaling:
        notes.append(f"{_some(names, scaling)} scaled by animations, which rigid joints do not follow")

    def read_clip(number: int):
        return read_motion(document, rig, skeleton, numbers[number])

    return Asset(
        document.path,
        "motion" if mesh is None else "character",
        character=Character(
            skeleton, mesh, skin, document.path.stem, GltfOrigin(document, rig, skeleton, binds, surface.repaired)
        ),
        clips=clips,
        convention=CONVENTION,
        notes=tuple(notes),
        read_clip=read_clip,
    )


def _with_humanoid(asset: Asset, bones: NamedBones, nodes: list[int]) -> Asset:
    """The asset with the humanoid that its file names, in terms of its joints."""
    names, humanoid, outside = asset.character.skeleton.names, {}, []
    for bone, node in bones.nodes.items():
        if node in nodes:
            humanoid[bone] = names[nodes.index(node)]
        else:
            outside.append(bone)
    notes = [f"its humanoid, of {len(humanoid)} joints, is the one that the file names ({bones.version})"] if humanoid else []
    if outside:
        notes.append(f"the humanoid bones {', '.join(outside)} are left out: their nodes are no part of the skeleton")
    forward = FORWARD.get(bones.extension, CONVENTION.forward)
    return replace(
        asset,
        humanoid=humanoid or None,
        convention=replace(CONVENTION, forward=forward),
        notes=(*notes, *bones.notes, *asset.notes),
    )


def _some(names: tuple[str, ...], joints: list[int]) -> str:
    listed = ", ".join(repr(names[joint]) for joint in joints[:3]) + (", ..." if len(joints) > 3 else "")
    return f"joint {listed} is" if len(joints) == 1 else f"{len(joints)} joints ({listed}) are"
