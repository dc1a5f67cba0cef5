"""Sensors that mean the same place on every body: the semantically consistent sensors of Ye 2024, Algorithm 1.

A sensor is named by a semantic coordinate (bone, l, phi). From the bone's point o = (1 - l) parent + l child a ray goes
out normal to the bone, at the angle phi from the direction that the body faces; where it leaves the bone's associated
mesh, there the sensor sits, with a tangent frame. Two bodies need no common mesh: equal coordinates correspond.

    >>> sensors = place_sensors(actor.character, actor.humanoid)             # 288 of them
    >>> dense = place_sensors(actor.character, actor.humanoid, dense_layout())

What the algorithm leaves open, and our choices:
- bones, and the pose in which rays are cast: `contact/sensor_bones.py`;
- n = cos(phi) forward' + sin(phi) other with forward' projected onto the plane normal to the bone and normalised (up for
  feet, which point forward) and other = forward' x bone, so that |n| = 1;
- associated mesh: faces whose corners have a mean skin weight above 0.1 for the bone with all that hangs on it; props
  are left out;
- several hits: the first surface that the ray leaves from inside, so that a cape is not the back and the chin not the
  throat (on bare bodies first or last made no difference); at the head the last, as it has a mouth and eyes inside;
- tangent frame: the bone's direction projected onto the surface, normal x tangent, smooth normal; orthonormal, also in
  motion, where blending shrinks the paper's frames (to a determinant of .4);
- a clavicle's rays count within the clavicle's length: those that leave downwards would run through the trunk and end
  on the waist of one body and on the thigh of another. Dense layouts keep them: where places are carried by many sensors
  together they do more good than harm (contacts judged by them err by .13 instead of .17 on the toddler);
- for density only, l beyond [0, 1): the ray starts at the bone's end and tilts by |excess| x 90 degrees along the bone,
  so that crown, chin, fingertips, heel, toes and crotch are covered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import joint_transforms, rest_pose, world_pose
from retarget.character import Character, Motion
from retarget.contact.sensor_bones import (
    BONES,
    SIDES,
    SensorBone,
    Stance,
    sensor_bones,
    stand,
    vertex_normals,
    welded,
)
from retarget.correspond.joints import Humanoid
from retarget.errors import RetargetError, unknown_name

Array = np.ndarray

ASSOCIATED = 0.1
"""Mean skin weight above which a face belongs to a bone's mesh: on the embedded human 96 to 97% of 288 rays hit; at .25
fewer do, and with all faces some hit a wrong part."""
PAIRS = 40_000
"""Rays times faces looked at in one go: stays in the cache, and below what makes BLAS wake its threads."""

STRETCH = 32
"""Frames posed in one go: stays in the cache."""

DENSE: dict[str, tuple[int, int, int, int]] = {
    # rings along the bone, sensors on a ring, tilted rings at the parent's end, at the child's end
    "spine": (9, 36, 6, 0), "chest": (12, 36, 0, 0), "neck": (5, 18, 0, 0), "head": (7, 28, 4, 8),
    "Shoulder": (8, 20, 0, 0), "UpperArm": (12, 16, 0, 0), "LowerArm": (12, 14, 0, 0), "Hand": (12, 14, 0, 3),
    "UpperLeg": (16, 22, 0, 0), "LowerLeg": (16, 18, 0, 0), "Foot": (8, 16, 6, 6),
}  # fmt: skip
DENSE_COUNT = 4675
"""Sensors of `dense_layout()`: about 2% of height from one to the next."""
COUNTS = (500, 100_000)
"""What `dense_layout` accepts."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Semantic coordinates: which sensors a body gets. Bodies are compared on one layout."""

    bones: Int[Array, "sensors"]
    """Index into `BONES`."""
    along: Float[Array, "sensors"]
    """The paper's l: place along the bone, 0 at the parent; below 0 and from 1 on, tilted rays at the ends (-1 to 2)."""
    around: Float[Array, "sensors"]
    """The paper's phi: angle about the bone, radians."""

    def __post_init__(self) -> None:
        bones = np.asarray(self.bones)
        along, around = np.asarray(self.along, dtype=np.float64), np.asarray(self.around, dtype=np.float64)
        if bones.ndim != 1 or along.shape != bones.shape or around.shape != bones.shape:
            shapes = f"{bones.shape}, {along.shape}, {around.shape}"
            raise RetargetError(f"a layout has one bone, one place and one angle a sensor, received {shapes}")
        if not np.issubdtype(bones.dtype, np.integer) or ((bones < 0) | (bones >= len(BONES))).any():
            raise RetargetError(f"Layout.bones are whole numbers from 0 to {len(BONES) - 1}: indices into BONES")
        if not (np.isfinite(around).all() and ((along >= -1) & (along <= 2)).all()):
            raise RetargetError("Layout.along lies within [-1, 2] (on the bone [0, 1)) and Layout.around is finite")
        for name, value in (("bones", bones.astype(np.int64)), ("along", along), ("around", around)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.bones)


def paper_layout(along: int = 4, around: int = 4) -> Layout:
    """The product of 18 bones, `along` places (l = 0, .25, .5, .75) and `around` angles: 288 sensors, as in Ye 2024."""
    if along < 1 or around < 1:
        raise RetargetError(f"a layout needs at least one place and one angle a bone, received {along} and {around}")
    bone, place, angle = np.meshgrid(np.arange(len(BONES)), np.arange(along), np.arange(around), indexing="ij")
    return Layout(bone.ravel(), place.ravel() / along, angle.ravel() * (2 * np.pi / around))


def dense_layout(count: int = DENSE_COUNT) -> Layout:
    """About `count` sensors spread evenly over a body's whole surface, the ends of head, hands, feet and trunk too.

    Raises `RetargetError` for counts outside 500 to 100,000.
    """
    if not COUNTS[0] <= count <= COUNTS[1]:
        raise RetargetError(f"a dense layout has {COUNTS[0]} to {COUNTS[1]} sensors, received {count}")
    finer = float(np.sqrt(count / DENSE_COUNT))
    bones, places, angles = [], [], []
    for number, name in enumerate(BONES):
        part = next((name[len(side) :] for side in SIDES if name.startswith(side)), name)
        along, around, low, high = (round(steps * finer) for steps in DENSE[part])
        along = max(along, 2)
        below, beyond = -(np.arange(low) + 1) / (low + 0.5), 1 + np.arange(high + 1 if high else 0) / (high + 0.5)
        for place in np.concatenate([below[::-1], np.arange(along) / along, beyond]):
            ring = max(4, round(around * float(np.cos(_tilt(place)))))
            bones.append(np.full(ring, number))
            places.append(np.full(ring, place))
            angles.append(2 * np.pi * np.arange(ring) / ring)
    return Layout(np.concatenate(bones), np.concatenate(places), np.concatenate(angles))


def _tilt(along: Float[Array, "*batch"] | float) -> Float[Array, "*batch"] | float:
    """Angle of a ray out of the plane normal to its bone, radians, towards the child."""
    return 0.5 * np.pi * (np.minimum(along, 0.0) + np.maximum(along - 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Sensors:
    """A layout on a body. Everything of a sensor that misses is zero and `valid` is False; its place stays."""

    character: Character
    layout: Layout
    valid: Bool[Array, "sensors"]
    faces: Int[Array, "sensors"]
    """Face of the character's mesh that each sits on."""
    barycentrics: Float[Array, "sensors 3"]
    positions: Float[Array, "sensors 3"]
    """In the rest pose, metres."""
    frames: Float[Array, "sensors 3 3"]
    """World-from-tangent in the rest pose; columns tangent (along the bone), normal x tangent, outward normal."""
    stance: Stance
    """The body in the common stance."""

    def __len__(self) -> int:
        return len(self.layout)


def place_sensors(character: Character, humanoid: Humanoid, layout: Layout | None = None) -> Sensors:
    """Put the sensors of a layout (default: the paper's 288) on a character in metres with +Y up (`Actor`).

    Ye 2024, Algorithm 1; our choices are listed above. Raises `RetargetError` for a character without skin and for a
    humanoid without head or a whole limb.
    """
    layout = paper_layout() if layout is None else layout
    stance = stand(character, humanoid)
    mesh, count = character.mesh, len(layout)
    tilted = bool(((layout.along < 0) | (layout.along >= 1)).any())
    valid, faces, barycentrics = np.zeros(count, bool), np.zeros(count, np.int64), np.zeros((count, 3))
    along = np.zeros((count, 3, 3))
    for number, (name, bone) in enumerate(sensor_bones(stance).items()):
        which = np.flatnonzero(layout.bones == number)
        weight = bone.weight[mesh.faces].mean(axis=1)
        near = np.flatnonzero((weight > ASSOCIATED) & stance.body)
        origins, directions = _rays(bone, layout.along[which], layout.around[which])
        valid[which], hit, barycentrics[which] = _cast(
            origins, directions, stance.vertices, mesh.faces[near], bone.outermost
        )
        faces[which[valid[which]]] = near[hit[valid[which]]]
        landed = surface_points(stance.vertices, mesh.faces, faces[which], barycentrics[which])
        if not tilted:
            valid[which] &= np.linalg.norm(landed - origins, axis=1) <= bone.reach
        turn = stance.world_from_body
        if name in stance.turns:
            turn = rot.multiply(rot.inverse(stance.turns[name]), turn)
        along[which] = rot.rotate(turn, bone.axes)
    barycentrics[~valid] = 0.0
    positions = surface_points(stance.rest, mesh.faces, faces, barycentrics)
    normals = surface_points(_rest_normals(stance), mesh.faces, faces, barycentrics)
    frames = np.where(valid[:, None, None], _tangent_frames(along[:, 0], along[:, 1], normals), 0.0)
    return Sensors(character, layout, valid, faces, barycentrics, positions, frames, stance)


def surface_points(
    values: Float[Array, "vertices n"],
    faces: Int[Array, "faces 3"],
    which: Int[Array, "points"],
    barycentrics: Float[Array, "points 3"],
) -> Float[Array, "points n"]:
    """What points of a surface have, from its vertices: positions, normals, weights."""
    return np.einsum("pc,pcn->pn", barycentrics, values[faces[which]])


def _rest_normals(stance: Stance) -> Float[Array, "vertices 3"]:
    """Smooth normals in the rest pose."""
    return vertex_normals(stance.rest, stance.faces, welded(stance.rest, stance.height))


def _rays(bone: SensorBone, along: Array, around: Array) -> tuple[Float[Array, "rays 3"], Float[Array, "rays 3"]]:
    """Origins and unit directions in the stance."""
    axis, facing, other = bone.axes
    origins = bone.parent + np.clip(along, 0.0, 1.0)[:, None] * (bone.child - bone.parent)
    out = np.cos(around)[:, None] * facing + np.sin(around)[:, None] * other
    tilt = _tilt(along)[:, None]
    return origins, np.cos(tilt) * out + np.sin(tilt) * axis


def _cast(
    origins: Float[Array, "rays 3"],
    directions: Float[Array, "rays 3"],
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    outermost: bool,
) -> tuple[Bool[Array, "rays"], Int[Array, "rays"], Float[Array, "rays 3"]]:
    """Where rays leave a surface: hit or not, face and barycentrics of the first such place (or of the last).

    A ray o + t n passes a triangle on the side of its edges given by n . ((b - o) x (c - o)), which in Plücker
    coordinates is one product of ray (n, n x o) and edge (b x c, b - c): all rays against all edges is a matrix product.
    """
    hit, best = np.zeros(len(origins), bool), np.zeros(len(origins), np.int64)
    shares = np.zeros((len(origins), 3))
    corners = vertices[faces]
    edges = []
    for i in range(3):
        b, c = corners[:, (i + 1) % 3], corners[:, (i + 2) % 3]
        edges.append(np.ascontiguousarray(np.concatenate([np.cross(b, c), b - c], axis=1).T))
    lines = np.concatenate([directions, np.cross(directions, origins)], axis=1)
    passed = []
    step = max(1, PAIRS // max(len(faces), 1))
    for start in range(0, len(lines), step):
        first, second, third = (lines[start : start + step] @ each for each in edges)
        at = np.nonzero((first >= 0) & (second >= 0) & (third >= 0))  # few: the rest is done for these alone
        passed.append((start + at[0], at[1], np.stack([first[at], second[at], third[at]], axis=1)))
    if not passed:
        return hit, best, shares
    ray, face, three = (np.concatenate(each) for each in zip(*passed))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[face]
    total = three.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((corners[face, 0] - origins[ray]) * normals).sum(axis=1) / total
    good = np.flatnonzero((total > 0) & (distance > 0))
    order = good[np.argsort(-distance[good] if outermost else distance[good], kind="stable")]
    found, first = np.unique(ray[order], return_index=True)
    chosen = order[first]
    hit[found], best[found], shares[found] = True, face[chosen], three[chosen] / total[chosen, None]
    return hit, best, shares


def _tangent_frames(
    along: Float[Array, "sensors 3"], otherwise: Float[Array, "sensors 3"], normals: Float[Array, "sensors 3"]
) -> Float[Array, "sensors 3 3"]:
    """Columns: the bone's direction (or another, where it stands upright on the surface) made tangent; the third of
    the frame; the normal."""
    normals = rot.unit(normals)
    tangent = along - (along * normals).sum(axis=1, keepdims=True) * normals
    instead = otherwise - (otherwise * normals).sum(axis=1, keepdims=True) * normals
    tangent = rot.unit(np.where(np.linalg.norm(tangent, axis=1, keepdims=True) > 0.1, tangent, instead))
    return np.stack([tangent, np.cross(normals, tangent), normals], axis=-1)


# --- in motion ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SensorSkinner:
    """Moves sensors with their character without moving its mesh; `prepare_sensor_skinning` makes one.

    A sensor's place and two axes of its frame are each a fixed linear function of the columns' matrices (the paper's
    4 x 3 feature through linear blend skinning), so that all frames are one sparse product. Places are exactly the
    posed surface's. Single precision.
    """

    sensors: Sensors
    rows: Any
    """Sparse matrix (3 sensors x 4 columns): places, tangents, normals."""

    def pose(
        self, world_rotations: Float[Array, "frames joints 4"], world_positions: Float[Array, "frames joints 3"]
    ) -> tuple[Float[Array, "frames sensors 3"], Float[Array, "frames sensors 3 3"]]:
        """Positions (metres) and orthonormal tangent frames, float32; zero for sensors that are not valid."""
        frames, count = len(world_rotations), len(self.sensors)
        places = np.empty((frames, count, 3), dtype=np.float32)
        turned = np.empty((frames, count, 3, 3), dtype=np.float32)
        for start in range(0, frames, STRETCH):
            part = slice(start, start + STRETCH)
            places[part], turned[part] = self._pose(world_rotations[part], world_positions[part])
        return places, turned

    def _pose(self, world_rotations: Array, world_positions: Array) -> tuple[Array, Array]:
        skin = self.sensors.character.skin
        T = np.matmul(joint_transforms(world_rotations, world_positions)[:, skin.joints, :3], skin.inverse_binds)
        count, frames = len(self.sensors), len(T)
        flat = np.ascontiguousarray(T.transpose(1, 3, 2, 0), dtype=np.float32).reshape(-1, 3 * frames)
        place, tangent, normal = (self.rows @ flat).reshape(3, count, 3, frames)
        turned = np.empty((count, 3, 3, frames), dtype=np.float32)  # frames last: every operation runs along memory
        _normalise(normal)
        tangent -= np.einsum("sif,sif->sf", tangent, normal)[:, None] * normal
        _normalise(tangent)
        turned[:, :, 0], turned[:, :, 2] = tangent, normal
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            np.multiply(normal[:, j], tangent[:, k], out=turned[:, i, 1])
            turned[:, i, 1] -= normal[:, k] * tangent[:, j]
        return (
            place.reshape(-1, frames).T.reshape(frames, count, 3),
            turned.reshape(-1, frames).T.reshape(frames, count, 3, 3),
        )


def _normalise(vectors: Float[Array, "sensors 3 frames"]) -> None:
    """To length one, in place; zero stays zero."""
    square = np.einsum("sif,sif->sf", vectors, vectors)
    vectors /= np.sqrt(np.maximum(square, 1e-24, out=square), out=square)[:, None]


def prepare_sensor_skinning(sensors: Sensors) -> SensorSkinner:
    """Factor out what does not depend on the pose."""
    from scipy import sparse

    mesh, skin, count = sensors.character.mesh, sensors.character.skin, len(sensors)
    corners, influences = mesh.faces[sensors.faces], skin.columns.shape[1]
    columns = skin.columns[corners].reshape(count, -1)
    weights = (skin.weights[corners] * sensors.barycentrics[:, :, None]).reshape(count, -1)
    points = np.repeat(mesh.vertices[corners], influences, axis=1)  # each influence with its own corner: exact
    place = weights[..., None] * np.concatenate([points, np.ones(points.shape[:2] + (1,))], axis=-1)
    # Directions blend by the same weights; they are taken back from the rest pose to where the mesh was bound.
    rotations, positions = rest_pose(sensors.character.skeleton)
    linear = (joint_transforms(rotations, positions)[skin.joints] @ skin.inverse_binds)[:, :3, :3]
    blended = np.einsum("sw,swij->sij", weights, linear[columns])
    blended[~sensors.valid] = np.eye(3)
    bound = np.linalg.solve(blended, sensors.frames)
    zero = np.zeros(weights.shape + (1,))
    axes = [np.concatenate([weights[..., None] * bound[:, None, :, k], zero], axis=-1) for k in (0, 2)]
    values = np.stack([place, *axes]).astype(np.float32)  # (3, sensors, weights, 4)
    at = np.broadcast_to(4 * columns[None, :, :, None] + np.arange(4), values.shape)
    row = np.broadcast_to(np.arange(3 * count).reshape(3, count, 1, 1), values.shape)
    matrix = sparse.coo_matrix((values.ravel(), (row.ravel(), at.ravel())), shape=(3 * count, 4 * len(skin.joints)))
    rows = matrix.tocsr()
    rows.sum_duplicates()
    rows.eliminate_zeros()
    return SensorSkinner(sensors, rows)


def pose_sensors(
    sensors: Sensors, motion: Motion
) -> tuple[Float[Array, "frames sensors 3"], Float[Array, "frames sensors 3 3"]]:
    """Positions (metres) and tangent frames of every frame of a motion; for many calls keep a `SensorSkinner`."""
    return prepare_sensor_skinning(sensors).pose(*world_pose(motion))


def bone_index(name: str) -> int:
    """Index into `BONES`. Raises `RetargetError` naming the nearest ones for an unknown name."""
    if name not in BONES:
        raise unknown_name("sensor bone", name, BONES, "the eighteen")
    return BONES.index(name)
