"""Motions into USD files: into the stage a character came from, or with a stage made new. usd-core works in a process
of its own here too, for what it opens may be a stage from anywhere.

The child gets one JSON file and one file of arrays, and leaves the bytes of the finished file.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body.kinematics import joint_transforms, local_positions, rest_pose
from retarget.body.rotations import continuous, normalise, to_matrix
from retarget.character import Character, Material, Mesh, Motion, Skeleton
from retarget.errors import FileError, RetargetError
from retarget.io.child import ChildError, ChildFailed, run_child
from retarget.io.gltf_build import bound_surface, smooth_normals
from retarget.io.gltf_nodes import node_transform
from retarget.io.gltf_weights import merge_influences
from retarget.io.gltf_write import check_skeleton
from retarget.io.provenance import provenance_record
from retarget.io.usd import UsdOrigin, require_usd
from retarget.io.usd_transforms import split
from retarget.io.whole_file import written_whole

Array = np.ndarray
SECONDS = 300.0
"""How long writing may take."""


def save(
    path: str | Path,
    character: Character,
    motions: Sequence[Motion] = (),
    *,
    animation_only: bool = False,
    keep_clips: bool = True,
) -> None:
    """Write a character with its motions as .usda (text), .usdc and .usd (binary), or .usdz (a package).

    A character that was read from USD keeps its stage: everything in it stays, each motion becomes one SkelAnimation
    more below the skeleton, and the first of them is the one that plays. A stage of several layers is written as one;
    where prims carry the skeleton about, the motions say it instead, and the skeleton's prim stays in its place.
    `keep_clips=False` leaves out the animations it had. Any other character is written anew, in metres with +Y up, with
    base colours; pictures go into a .usdz only. `animation_only` writes the skeleton and the motions.

    UsdSkel binds a skeleton to one animation, so of several motions the first plays; the others stand beside it.

    Raises `RetargetError` if a motion belongs to another skeleton or has no frames, `FileError` if usd-core is not
    installed, the stage that is to be kept has changed since, or `path` cannot be written. The file appears whole or
    not at all, and equal input gives equal bytes.
    """
    path = Path(path)
    require_usd(path)
    for motion in motions:
        check_skeleton(f"the motion {motion.name!r}", motion.skeleton, character.skeleton)
        if not len(motion):
            raise RetargetError(f"the motion {motion.name!r} has no frames to write")
    folder = str(path.parent.absolute())
    order: dict[str, Any] = {"suffix": path.suffix.lower(), "stem": identifier(path.stem), "folder": folder}
    arrays: dict[str, Array] = {}
    origin = character.origin if isinstance(character.origin, UsdOrigin) and not animation_only else None
    if origin is not None:
        check_skeleton("the character", character.skeleton, origin.skeleton)
        order |= _kept_stage(path, origin, keep_clips)
        clips = [_joint_values(path, motion, origin) for motion in motions]
        order["settle"] = len(origin.rig.nodes) > len(origin.tokens)
    else:
        order |= _new_stage(character, arrays, animation_only)
        clips = [_own_values(motion) for motion in motions]
    order["clips"] = [
        {"name": motion.name or "motion", "prim": identifier(motion.name or "motion"), "fps": motion.fps}
        | ({} if motion.made_from is None else {"made_from": provenance_record(motion.made_from)})
        for motion in motions
    ]
    for number, (translations, rotations, scales) in enumerate(clips):
        arrays[f"translations_{number}"] = translations.astype(np.float32)
        arrays[f"rotations_{number}"] = continuous(normalise(rotations)).astype(np.float32)
        arrays[f"scales_{number}"] = scales.astype(np.float16)
    run_write(path, order, arrays)


def run_write(path: Path, order: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Have the child make the file. Raises `FileError` where it cannot."""
    with tempfile.TemporaryDirectory(prefix="retarget-") as folder:
        output = Path(folder) / "finished"
        (Path(folder) / "order.json").write_text(json.dumps(order))
        np.savez(Path(folder) / "arrays.npz", **arrays)
        try:
            run_child("usd_write_child", [folder, output], SECONDS)
        except ChildFailed as failure:
            raise FileError(path, f"cannot be written as USD ({failure})") from None
        except ChildError as error:
            raise FileError(path, str(error)) from None
        with open(output, "rb") as finished, written_whole(path) as file:
            shutil.copyfileobj(finished, file)


def _kept_stage(path: Path, origin: UsdOrigin, keep_clips: bool) -> dict[str, Any]:
    try:
        state = origin.source.stat()
    except OSError:
        raise FileError(path, f"cannot keep what {origin.source} holds: the file is gone") from None
    if (state.st_size, state.st_mtime_ns) != origin.stamp:
        problem = f"cannot keep what {origin.source} holds: it has changed since it was read; read it again"
        raise FileError(path, problem)
    kept = {"source": str(origin.source), "skeleton": origin.skeleton_path, "keep_clips": keep_clips}
    return kept | {"tokens": list(origin.tokens.values())}


def _joint_values(path: Path, motion: Motion, origin: UsdOrigin) -> tuple[Array, Array, Array]:
    """Local translations, rotations and scales of the stage's joints (frames first; scales: joints first).

    Joints of ours that are prims in the stage (the skeleton's own) have no place in a SkelAnimation: what they do goes
    into the joints that hang from them, seen from where the skeleton's prim stays.
    """
    rig, nodes = origin.rig, origin.document.json["nodes"]
    positions = local_positions(motion.skeleton, motion.translations, motion.moved)
    translations, rotations = rig.to_nodes(positions, motion.rotations)
    scales = np.stack([_scale(path, nodes[node]) for node in rig.nodes.tolist()])
    translations, rotations = translations.copy(), rotations.copy()
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    order = [joint_of[node] for node in origin.tokens]
    above: dict[int, Array] = {-1: np.eye(4)}
    for joint, node in enumerate(rig.nodes.tolist()):  # parents first
        parent = int(rig.parents[joint])
        if node not in origin.tokens:
            rest = _affine(rig.translations[joint], rig.rotations[joint], scales[joint])
            moved = _affine(translations[:, joint], rotations[:, joint], scales[joint])
            # where the prim's own motion would put its children, seen from the prim at rest; its parent's comes before
            above[joint] = np.linalg.inv(rest) @ above[parent] @ moved
        elif parent in above and parent >= 0:
            local = above[parent] @ _affine(translations[:, joint], rotations[:, joint], scales[joint])
            translations[:, joint], rotations[:, joint], _, _ = split(local)
    return translations[:, order], rotations[:, order], scales[order]


def _affine(translation: Array, rotation: Array, scale: Array) -> Array:
    matrices = np.zeros(translation.shape[:-1] + (4, 4))
    matrices[..., :3, :3] = to_matrix(rotation) * scale
    matrices[..., :3, 3], matrices[..., 3, 3] = translation, 1.0
    return matrices


def _scale(path: Path, node: dict[str, Any]) -> Float[Array, "3"]:
    _, _, shape = node_transform(node)
    scale = np.diag(shape)
    if np.abs(shape - np.diag(scale)).max() > 1e-4 * np.abs(shape).max():
        raise FileError(path, f"the joint {node.get('name')!r} has a sheared rest transform, which USD cannot animate")
    return scale


def _own_values(motion: Motion) -> tuple[Array, Array, Array]:
    positions = local_positions(motion.skeleton, motion.translations, motion.moved)
    return positions, motion.rotations, np.ones((len(motion.skeleton), 3))


def _new_stage(character: Character, arrays: dict[str, Array], animation_only: bool) -> dict[str, Any]:
    """What a stage of our own says of a character; its arrays go into `arrays` (matrices as rows, as USD has them)."""
    skeleton = character.skeleton
    T_world_rest = joint_transforms(*rest_pose(skeleton))
    rest = joint_transforms(skeleton.rest_rotations, skeleton.offsets)
    binds = T_world_rest
    told: dict[str, Any] = {"name": identifier(character.name or "character"), "tokens": _tokens(skeleton)}
    told["names"] = skeleton.names
    mesh = None if animation_only else character.mesh
    if mesh is not None:
        if not len(mesh.faces):
            raise RetargetError("the character's mesh has no faces to write")
        vertices, inverse_binds, joints, weights = bound_surface(mesh, character.skin, T_world_rest)
        binds = np.linalg.inv(inverse_binds)
        joints, weights = merge_influences(joints, weights)
        told["materials"] = surface_arrays(mesh, vertices, arrays)
        arrays |= {"normals": smooth_normals(vertices, mesh.faces).astype(np.float32)}
        arrays |= {"joints": joints.astype(np.int32), "weights": weights.astype(np.float32)}
    arrays |= {"rest": np.swapaxes(rest, 1, 2), "bind": np.swapaxes(binds, 1, 2)}
    return told


def surface_arrays(mesh: Mesh, vertices: Float[Array, "vertices 3"], arrays: dict[str, Array]) -> list[dict[str, Any]]:
    """What a stage says of a mesh's materials; places, faces, colours and pictures go into `arrays`."""
    arrays |= {"points": vertices.astype(np.float32), "faces": mesh.faces.astype(np.int32)}
    arrays["face_materials"] = (
        np.zeros(len(mesh.faces), np.int32) if mesh.face_materials is None else mesh.face_materials.astype(np.int32)
    )
    if mesh.uvs is not None:
        arrays["uvs"] = (mesh.uvs * [1, -1] + [0, 1]).astype(np.float32)  # USD has the origin bottom left
    return [_material(material, number, arrays) for number, material in enumerate(mesh.materials or (Material(),))]


def _material(material: Material, number: int, arrays: dict[str, Array]) -> dict[str, Any]:
    if material.image is not None:
        arrays[f"picture_{number}"] = np.frombuffer(material.image, np.uint8)
    color = [float(part) for part in material.base_color]
    name = identifier(material.name or f"material_{number}")
    return {"name": name, "color": color, "double_sided": material.double_sided}


def _tokens(skeleton: Skeleton) -> list[str]:
    """Each joint's path of identifiers, which USD names it by."""
    taken: set[str] = set()
    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents.tolist()):
        free, number = identifier(name), 2
        while free.lower() in taken:
            free, number = f"{identifier(name)}_{number}", number + 1
        taken.add(free.lower())
        paths.append(free if parent < 0 else f"{paths[parent]}/{free}")
    return paths


def identifier(name: str) -> str:
    """A name that USD takes for a prim: letters, digits and underscores, the first no digit."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain and not plain[0].isdigit() else f"_{plain}"
