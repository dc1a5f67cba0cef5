"""Where a glTF skin was bound: inverse bind matrices checked and repaired, and the rest pose that they tell of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.character import Skeleton
from retarget.io.gltf_document import Document
from retarget.io.gltf_nodes import NodeTree, Rig, rigid_part

Array = np.ndarray

# Two placements count as equal when they differ by less than this part of the skeleton's size, or of their scale.
TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Binding:
    """One skin, tied to the skeleton."""

    joints: Int[Array, "columns"]
    """Our joint behind each joint of the skin."""
    inverse_binds: Float[Array, "columns 4 4"]
    """As in the file, faulty ones replaced."""
    clean: bool
    """Whether the file's own matrices may stay in a written file."""
    T_world_mesh: Float[Array, "4 4"]
    """Where the skin's mesh space lies in the world: at binding, vertices stood at T_world_mesh v."""
    tells_pose: bool
    """Whether the matrices describe a pose (they are there, and not all the same)."""


def read_bindings(document: Document, tree: NodeTree, rig: Rig, size: float) -> tuple[list[Binding], list[str]]:
    """All skins of the document, with notes about repairs. `size` is the extent of the skeleton, for tolerances."""
    joint_of = {int(node): joint for joint, node in enumerate(rig.nodes)}
    mesh_node = {
        node["skin"]: number for number, node in reversed(list(enumerate(document.entries("nodes")))) if "skin" in node
    }
    bindings, notes = [], []
    for number, skin in enumerate(document.entries("skins")):
        joints = np.array([joint_of[node] for node in skin["joints"]])
        world = tree.world[skin["joints"]]
        placed = tree.world[mesh_node[number]] if number in mesh_node else np.eye(4)
        if "inverseBindMatrices" not in skin:
            identity = np.tile(np.eye(4), (len(joints), 1, 1))
            bindings.append(Binding(joints, identity, True, np.eye(4), False))
            continue
        matrices = _matrices(document, skin["inverseBindMatrices"], len(joints), f"skins[{number}]")
        faulty = ~_invertible(matrices)
        # Validators refuse a last row that is not exactly 0 0 0 1, to the last digit.
        clean = not faulty.any() and bool((matrices[:, 3] == [0, 0, 0, 1]).all())
        matrices[:, 3] = 0, 0, 0, 1
        usable = np.flatnonzero(~faulty & _invertible(world))
        usable = usable[np.argsort(joints[usable])]  # the topmost first
        seen = np.einsum("jab,jbc->jac", world[usable], matrices[usable])
        T_world_mesh = _mesh_placement(seen, placed, size)
        if faulty.any():
            names = ", ".join(
                repr(document.json["nodes"][skin["joints"][i]].get("name", "")) for i in np.flatnonzero(faulty)[:3]
            )
            notes.append(
                f"skin {number} has {int(faulty.sum())} inverse bind matrices that cannot be inverted "
                f"({names}); they are taken from the nodes instead"
            )
            rest = np.where(_invertible(world)[:, None, None], world, np.eye(4))
            matrices[faulty] = np.linalg.inv(rest[faulty]) @ T_world_mesh
        distinct = len(joints) == 1 or np.abs(np.diff(matrices, axis=0)).max() > 1e-9
        bindings.append(Binding(joints, matrices, clean, T_world_mesh, bool(len(usable) and distinct)))
    return bindings, notes


def _matrices(document: Document, accessor: int, count: int, place: str) -> Float[Array, "columns 4 4"]:
    values = document.decoded(accessor, ("MAT4",))
    if len(values) < count:
        raise document.fail(f"has {len(values)} inverse bind matrices for {count} joints", place)
    return np.swapaxes(values[:count].reshape(-1, 4, 4), 1, 2).copy()


def _invertible(matrices: Float[Array, "columns 4 4"]) -> Bool[Array, "columns"]:
    """Finite, affine, of sensible scale and not flattened."""
    usable = np.isfinite(matrices).all(axis=(1, 2)) & (np.abs(np.nan_to_num(matrices)).max(axis=(1, 2)) < 1e9)
    safe = np.where(usable[:, None, None], matrices, np.eye(4))
    axes = np.linalg.svd(safe[:, :3, :3], compute_uv=False)
    affine = np.abs(safe[:, 3] - [0, 0, 0, 1]).max(axis=1) < 1e-3
    return usable & affine & (axes[:, 0] > 1e-9) & (axes[:, 2] > 1e-6 * axes[:, 0])


def _mesh_placement(seen: Float[Array, "usable 4 4"], placed: Float[Array, "4 4"], size: float) -> Float[Array, "4 4"]:
    """Where the mesh stood at binding, from what each joint says of it in the nodes' pose (`seen`, the topmost first).

    If all agree that is it. If not, the nodes are posed: exporters then bind in the world or in the mesh's own node;
    the one of these that has the right scale and the nearest orientation is taken, else what the topmost joint says.
    """
    if not len(seen):
        return np.eye(4)
    if same_placement(seen, seen[0], size).all():
        return seen[0]
    scale = np.cbrt(abs(np.linalg.det(seen[0, :3, :3])))
    best, smallest = seen[0], np.radians(60.0)
    for candidate in (np.eye(4), placed):
        its_scale = np.cbrt(abs(np.linalg.det(candidate[:3, :3])))
        angle = rot.angle_between(rigid_part(seen[0, :3, :3]), rigid_part(candidate[:3, :3]))
        if abs(its_scale - scale) < 0.02 * scale and angle < smallest - 1e-9:
            best, smallest = candidate, angle
    return best


def same_placement(
    a: Float[Array, "*#n 4 4"], b: Float[Array, "*#n 4 4"], size: float, tolerance: float = TOLERANCE
) -> Bool[Array, "*n"] | np.bool_:
    """Whether affine matrices agree: axes relative to their length, positions relative to `size`."""
    length = np.maximum(np.linalg.norm(b[..., :3, :3], axis=(-2, -1)), 1e-12)
    axes = np.linalg.norm(a[..., :3, :3] - b[..., :3, :3], axis=(-2, -1)) <= tolerance * length
    return axes & (np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1) <= tolerance * size)


def rest_skeleton(names: tuple[str, ...], rig: Rig, bindings: list[Binding], size: float) -> tuple[Skeleton, list[str]]:
    """The skeleton in the pose its mesh was bound in, where the bind matrices tell one that rigid joints can take.

    Joints outside every skin keep their node's transform; so does every joint if the matrices are scaled against the
    nodes, or if skins contradict each other.
    """
    positions, rotations = rig.to_skeleton(rig.translations, rig.rotations)
    in_nodes = Skeleton(names, rig.parents, positions, rotations)
    bound, problem = _bind_poses(rig, bindings, size)
    if problem:
        return in_nodes, [f"{problem}; the nodes' own pose is the rest pose"]
    if not bound:
        return in_nodes, []
    turned, at = forward(rig.parents, rotations, positions)
    far = [
        joint for joint, (q, p) in bound.items()
        if rot.angle_between(q, turned[joint]) > TOLERANCE or np.linalg.norm(p - at[joint]) > TOLERANCE * size
    ]  # fmt: skip
    if not far:
        return in_nodes, []
    world: list[tuple[Array, Array]] = []
    for joint, parent in enumerate(rig.parents):
        if joint in bound:
            world.append(bound[joint])
        elif parent < 0:
            world.append((rotations[0], positions[0]))
        else:
            q, p = world[parent]
            world.append((rot.multiply(q, rotations[joint]), p + rot.rotate(q, positions[joint])))
    for joint, parent in enumerate(rig.parents):
        q, p = world[joint]
        if parent >= 0:
            back = rot.inverse(world[parent][0])
            q, p = rot.multiply(back, q), rot.rotate(back, p - world[parent][1])
        # Nodes and matrices are rounded differently; where both mean the same, the node's numbers stay.
        if rot.angle_between(q, rotations[joint]) > TOLERANCE:
            rotations[joint] = q
        if np.linalg.norm(p - positions[joint]) > 0.1 * TOLERANCE * size:
            positions[joint] = p
    note = (
        f"the mesh was bound in another pose than the nodes stand in ({len(far)} joints, such as {names[far[0]]!r}); "
        "that is the rest pose"
    )
    return Skeleton(names, rig.parents, positions, rotations), [note]


def _bind_poses(rig: Rig, bindings: list[Binding], size: float) -> tuple[dict[int, tuple[Array, Array]], str]:
    """World rotation and position of each bound joint, or what is wrong with the matrices."""
    poses: dict[int, tuple[Array, Array]] = {}
    for number, binding in enumerate(bindings):
        if not binding.tells_pose:
            continue
        stretch = rig.stretch[binding.joints]
        sound = np.abs(np.linalg.det(stretch)) > 1e-18
        T_world_bind = binding.T_world_mesh @ np.linalg.inv(binding.inverse_binds)
        for joint, D, T in zip(binding.joints[sound].tolist(), stretch[sound], T_world_bind[sound]):
            turn = T[:3, :3] @ np.linalg.inv(D)
            if np.abs(turn.T @ turn - np.eye(3)).max() > 0.02 or np.linalg.det(turn) < 0:
                return {}, f"skin {number} was bound at another scale than its nodes have"
            pose = rigid_part(turn), T[:3, 3]
            if joint not in poses:
                poses[joint] = pose
            elif (
                rot.angle_between(pose[0], poses[joint][0]) > 0.01
                or np.linalg.norm(pose[1] - poses[joint][1]) > 3 * TOLERANCE * size
            ):
                return {}, f"skin {number} was bound in another pose than the skins before it"
    return poses, ""
