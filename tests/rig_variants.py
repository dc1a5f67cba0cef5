"""The embedded human rigged as other people rig theirs, written by hand as GLB: the same body in every disguise.

A `Rig` lists world places and axes of joints at binding. Each function changes what a file says and leaves what it
shows, so a performance on any of them must look like the performance of the plain body.
"""

from dataclasses import dataclass, replace

import numpy as np
from gltf_maker import Maker
from gltf_reference import Reference

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, local_rotations, rest_pose
from retarget.body.skinning import skin_motion
from retarget.motion.align import Similarity

X, Y, Z = np.eye(3)
HERE = Similarity(rot.IDENTITY, 1.0)


@dataclass(frozen=True, eq=False)
class Rig:
    names: tuple
    parents: tuple
    """Name of each joint's parent, None for the root."""
    places: dict
    """World place of each joint at binding, metres."""
    axes: dict
    """World rotation of each joint at binding."""
    vertices: np.ndarray
    faces: np.ndarray
    weights: dict
    """One number a vertex for each joint that moves some."""

    def children(self, name):
        return [child for child, above in zip(self.names, self.parents) if above == name]


def rig_of(character):
    skeleton, skin = character.skeleton, character.skin
    rotations, places = rest_pose(skeleton)
    names = skeleton.names
    parents = tuple(None if p < 0 else names[p] for p in skeleton.parents)
    dense = np.zeros((len(skin.columns), len(names)))
    np.add.at(dense, (np.arange(len(dense))[:, None], skin.joints[skin.columns]), skin.weights)
    weights = {name: dense[:, joint] for joint, name in enumerate(names) if dense[:, joint].any()}
    return Rig(
        names,
        parents,
        dict(zip(names, places)),
        dict(zip(names, rotations)),
        character.mesh.vertices,
        character.mesh.faces,
        weights,
    )


def renamed(rig, name_of):
    """Every joint named anew by a function of its name."""
    change = lambda table: {name_of(name): value for name, value in table.items()}  # noqa: E731
    names, parents = (tuple(each and name_of(each) for each in row) for row in (rig.names, rig.parents))
    return replace(
        rig, names=names, parents=parents, places=change(rig.places), axes=change(rig.axes), weights=change(rig.weights)
    )


def without(rig, *gone):
    """Joints taken out: their children hang on what they hung on, which also moves their vertices."""
    above = dict(zip(rig.names, rig.parents))

    def kept(name):
        while name in gone:
            name = above[name]
        return name

    weights = {}
    for name, weight in rig.weights.items():
        weights[kept(name)] = weights.get(kept(name), 0) + weight
    names = tuple(name for name in rig.names if name not in gone)
    return replace(rig, names=names, parents=tuple(kept(above[name]) for name in names), weights=weights)


def without_matching(rig, *parts):
    return without(rig, *(name for name in rig.names if any(part in name for part in parts)))


def with_joint(rig, name, parent, place, between=None, axes=rot.IDENTITY):
    """A joint more, that moves nothing; `between` names the child of `parent` that it then carries (None: it is a leaf)."""
    names, parents = list(rig.names), list(rig.parents)
    at = 0 if parent is None else names.index(parent) + 1
    for child in between or ():
        parents[names.index(child)] = name
    names.insert(at, name)
    parents.insert(at, parent)
    return replace(
        rig,
        names=tuple(names),
        parents=tuple(parents),
        places=rig.places | {name: np.asarray(place, float)},
        axes=rig.axes | {name: axes},
    )


def on_roots(rig, *names, place=(0, 0, 0)):
    """A stack of joints above the root, outermost first."""
    for name in reversed(names):
        rig = with_joint(rig, name, None, place, between=[rig.names[0]])
    return rig


def with_more_spine(rig):
    """Five joints between hips and neck instead of three."""
    for number, (low, high) in enumerate((("spine", "chest"), ("chest", "upperChest"))):
        middle = (rig.places[low] + rig.places[high]) / 2
        rig = with_joint(rig, f"extraSpine{number}", low, middle, between=[high])
    return rig


def with_twists(rig, on_path):
    """Twist joints in the middle of arms and legs: between the segment and its end, or beside, as a leaf."""
    for side in ("left", "right"):
        for first, last in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg")):
            first, last = side + first, side + last
            middle = (rig.places[first] + rig.places[last]) / 2
            rig = with_joint(rig, f"{first}_twist_01", first, middle, between=[last] if on_path else None)
            if not on_path:  # half of what the segment moves follows the twist joint
                share = ((rig.vertices - rig.places[first]) @ rot.unit(rig.places[last] - rig.places[first])) / (
                    np.linalg.norm(rig.places[last] - rig.places[first])
                )
                share = np.clip(2 * share - 0.5, 0, 1) * rig.weights[first]
                weights = rig.weights | {first: rig.weights[first] - share, f"{first}_twist_01": share}
                rig = replace(rig, weights=weights)
    return rig


def _bone(rig, name):
    children = [child for child in rig.children(name) if "twist" not in child]
    along = rig.places[children[0]] - rig.places[name] if children else np.zeros(3)
    if np.linalg.norm(along) < 1e-4:
        above = dict(zip(rig.names, rig.parents))[name]
        along = Y if above is None else rig.places[name] - rig.places[above]
    return rot.unit(along) if np.linalg.norm(along) > 1e-4 else Y


def with_axes(rig, style):
    """Joint axes as Blender has them (bone along +Y) or Unreal (along +X, on the right side -X), or rolled at random."""
    axes = {}
    generator = np.random.default_rng(3)
    for name in rig.names:
        bone = _bone(rig, name)
        if style == "random":
            axes[name] = rot.normalise(generator.normal(size=4))
            continue
        along, second = (Y, Z) if style == "blender" else (-X if "right" in name.lower() else X, Y)
        start = rot.from_frame(along, second)
        other = Z if abs(bone @ Z) < 0.9 else Y
        axes[name] = rot.multiply(rot.from_frame(bone, other), rot.inverse(start))
    return replace(rig, axes=axes)


def posed(rig, turns):
    """World rotations and places of the joints with some turned in the world by rotation vectors, all below along."""
    number = {name: joint for joint, name in enumerate(rig.names)}
    parents = np.array([-1 if above is None else number[above] for above in rig.parents])
    axes = np.array([rig.axes[name] for name in rig.names])
    places = np.array([rig.places[name] for name in rig.names])
    carried = np.tile(rot.IDENTITY, (len(parents), 1))
    for joint, name in enumerate(rig.names):
        carried[joint] = rot.IDENTITY if parents[joint] < 0 else carried[parents[joint]]
        if name in turns:
            carried[joint] = rot.multiply(rot.from_rotation_vector(np.array(turns[name], float)), carried[joint])
    local = places.copy()
    local[1:] = rot.rotate(rot.inverse(axes[parents[1:]]), places[1:] - places[parents[1:]])
    turned = rot.multiply(carried, axes)
    _, moved = forward(parents, local_rotations(parents, turned), local)
    return dict(zip(rig.names, turned)), dict(zip(rig.names, moved))


def bound_in(rig, turns):
    """The body modelled in another pose: its surface is skinned there and bound anew (creases aside, the same body)."""
    axes, places = posed(rig, turns)
    vertices = sum(
        weight[:, None]
        * (
            rot.rotate(rot.multiply(axes[name], rot.inverse(rig.axes[name])), rig.vertices - rig.places[name])
            + places[name]
        )
        for name, weight in rig.weights.items()
    )
    return replace(rig, axes=axes, places=places, vertices=vertices)


def matrices(rotation, place, scale=1.0):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rot.to_matrix(rotation) * scale, place
    return T


def write_glb(path, rig, above=(), file=HERE, pose=None, skins=1, extras=None):
    """A GLB of the rig. `above` lists nodes over the root (name, translation, rotation, scale), outermost first; the mesh
    lies in the lowest one's space. `file` leads from metres with +Y up to the file's world. `pose` turns joints of the
    nodes' own pose, which then is not the pose of binding. `extras(maker, number)` may add to the document."""
    maker, outer, last = Maker(), np.eye(4), None
    for name, translation, rotation, scale in above:
        own = {
            "translation": list(map(float, translation)),
            "rotation": list(map(float, rotation)),
            "scale": [scale] * 3,
        }
        node = maker.add("nodes", {"name": name} | own)
        if last is not None:
            maker.json["nodes"][last]["children"] = [node]
        outer, last = outer @ matrices(rotation, translation, scale), node
    top = last
    unit = np.cbrt(np.linalg.det(outer[:3, :3]))

    def world(axes, places):
        return {
            name: matrices(rot.multiply(file.rotation, axes[name]), file.points(places[name]), unit)
            for name in rig.names
        }

    bound, shown = world(rig.axes, rig.places), world(*(posed(rig, pose) if pose else (rig.axes, rig.places)))
    number = {}
    for name, parent in zip(rig.names, rig.parents):
        local = np.linalg.inv(outer if parent is None else shown[parent]) @ shown[name]
        scale = np.cbrt(np.linalg.det(local[:3, :3]))
        own = {"translation": local[:3, 3].tolist(), "rotation": rot.from_matrix(local[:3, :3] / scale).tolist()}
        number[name] = maker.add("nodes", {"name": name} | own)
        above_it = top if parent is None else number[parent]
        if above_it is not None:
            maker.json["nodes"][above_it].setdefault("children", []).append(number[name])
    inverse_binds = [np.linalg.inv(bound[name]) @ outer for name in rig.names]
    points = file.points(rig.vertices) @ np.linalg.inv(outer)[:3, :3].T + np.linalg.inv(outer)[:3, 3]
    dense = np.stack([rig.weights.get(name, np.zeros(len(points))) for name in rig.names], axis=1)
    columns = np.argsort(-dense, axis=1)[:, :4]
    weights = np.take_along_axis(dense, columns, axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    parts = np.array_split(np.arange(len(rig.faces)), skins)
    meshes = []
    for part in parts:
        used, corner = np.unique(rig.faces[part], return_inverse=True)
        binds = maker.accessor(np.array([T.T.ravel() for T in inverse_binds]))
        skin = maker.add("skins", {"joints": [number[name] for name in rig.names], "inverseBindMatrices": binds})
        attributes = {
            "POSITION": maker.accessor(points[used]),
            "JOINTS_0": maker.accessor(columns[used], "u2"),
            "WEIGHTS_0": maker.accessor(weights[used]),
        }
        surface = {"attributes": attributes, "indices": maker.accessor(corner.ravel(), "u4")}
        mesh = maker.add("meshes", {"primitives": [surface]})
        meshes.append(maker.add("nodes", {"name": f"Body{mesh}", "mesh": mesh, "skin": skin}))
    if top is not None:
        maker.json["nodes"][top]["children"].extend(meshes)
    if extras:
        extras(maker, number)
    held = {child for node in maker.json["nodes"] for child in node.get("children", ())}
    maker.add("scenes", {"nodes": [node for node in range(len(maker.json["nodes"])) if node not in held]})
    maker.json["scene"] = 0
    return maker.glb(path)


def shown(path, rig, frames, fps, file=HERE, clip=-1, skins=1):
    """What a GLB shows on some frames of its last clip, read literally: vertices in metres with +Y up."""
    reference = Reference(path)
    clip = len(reference.json["animations"]) + clip if clip < 0 else clip
    parts = np.array_split(np.arange(len(rig.faces)), skins)
    order = np.concatenate([np.unique(rig.faces[part]) for part in parts])
    result = np.empty((len(frames), len(rig.vertices), 3))
    for row, frame in enumerate(frames):
        result[row, order] = reference.vertices(clip, frame / fps)[-len(order) :]
    return file.inverse().points(result)


def performed(character, motion, frames):
    """What the plain body shows on these frames."""
    few = replace(motion, rotations=motion.rotations[frames], translations=motion.translations[frames])
    return skin_motion(character, few)
