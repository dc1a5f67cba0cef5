"""Which of a source's contacts a body can keep at all: a slow search, done once and stored.

A toddler's arms do not reach behind its head. Counting such a contact against a method would measure the body, so those
that no pose within generous bounds brings together are listed and left out. The search asks for reach alone: whatever a
pose that may even penetrate cannot reach, no method can keep. `tools/find_unkeepable.py` runs it and stores the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, joint_transforms, local_positions, local_rotations
from retarget.character import Character, Motion
from retarget.contact.carried import CarriedVertices
from retarget.contact.detect import LEAVE
from retarget.evaluate.touch import SourceTouch
from retarget.motion.align import Actor
from retarget.motion.limits import ease_into_limits, joint_limits

Array = np.ndarray

FILE = Path(__file__).with_name("unkeepable.npz")
ROUNDS = 30
STARTS = 4
"""The copied pose, then the same disturbed at random."""
DISTURBED = 0.5
"""Standard deviation of the disturbance, radians an axis."""
DAMPING = 1e-3
"""Of the least squares, over squared height."""
FREEDOM: dict[str, float] = {
    "spine": 0.5, "chest": 0.4, "upperChest": 0.3, "neck": 0.5, "head": 0.5,
    **{f"{side}{part}": freedom for side in ("left", "right") for part, freedom in (
        ("Shoulder", 0.5), ("UpperArm", 2.0), ("LowerArm", 2.5), ("Hand", 1.0),
        ("UpperLeg", 1.2), ("LowerLeg", 2.0), ("Foot", 0.6))},
}  # fmt: skip
"""How far each joint may turn from the copied pose, radians; besides the joint limits of `motion.limits`."""


def keepable_tracks(touch: SourceTouch, motion: str, target: str) -> Bool[Array, "tracks"]:
    """Which contact tracks of an embedded performance a body of the benchmark set can keep, as stored."""
    tracks = touch.contacts.tracks
    lost = _stored().get(f"{motion}/{target}")
    if lost is None:
        return np.ones(len(tracks.vertex), dtype=bool)
    return ~np.isin(tracks.vertex * 64 + tracks.part, lost[:, 0].astype(np.int64) * 64 + lost[:, 1])


@lru_cache(maxsize=1)
def _stored() -> dict[str, Int[Array, "lost 2"]]:
    """By motion and target: (vertex, part) of the contacts that no pose keeps."""
    if not FILE.exists():
        return {}
    with np.load(FILE) as archive:
        return {name: archive[name] for name in archive.files}


def store(lost: dict[str, Int[Array, "lost 2"]]) -> None:
    """Write what `keepable_tracks` reads; only pairs of motion and body that lose something."""
    np.savez_compressed(FILE, **{name: rows.astype(np.int16) for name, rows in sorted(lost.items()) if len(rows)})


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the skin that move together with the joints: as many as there are contacts."""

    weights: Float[Array, "points joints"]
    homogeneous: Float[Array, "points joints 4"]
    """Each point in the frame of each joint."""
    carried: Float[Array, "points joints"]
    """Weight of all joints at or below each joint."""

    def places(self, T_world_joint: Float[Array, "points joints 4 4"]) -> Float[Array, "points 3"]:
        by_joint = np.einsum("pjkl,pjl->pjk", T_world_joint[..., :3, :], self.homogeneous)
        return (self.weights[..., None] * by_joint).sum(axis=1)


def search(
    touch: SourceTouch, target: Actor, carried: CarriedVertices, copied: Motion, threshold: float, seed: int
) -> Bool[Array, "tracks"]:
    """Which contact tracks some pose of the target brings within `LEAVE` thresholds (metres). The source's vertices are
    `carried` to the target; `copied` is the source's motion with its rotations copied."""
    tracks, faces = touch.contacts.tracks, touch.actor.character.mesh.faces
    if len(tracks.vertex) == 0:
        return np.zeros(0, dtype=bool)
    count = len(tracks.vertex)
    first = _points(target.character, *carried.points(tracks.vertex[:, None], np.ones((count, 1))))
    second = _points(target.character, *carried.points(faces[tracks.face], tracks.barycentric))
    reached = np.zeros(count, dtype=bool)
    random = np.random.default_rng(seed)
    for start in range(STARTS):
        open_ = np.flatnonzero(~reached)
        if len(open_) == 0:
            break
        gap = _closest(
            target, copied, tracks.anchor_frame[open_], _chosen(first, open_), _chosen(second, open_),
            random if start else None,
        )  # fmt: skip
        reached[open_] = gap <= LEAVE * threshold
    return reached


def _points(character: Character, vertices: Int[Array, "points corners"], share: Array) -> _Points:
    """Skinned points from vertices and their shares."""
    skin, mesh = character.skin, character.mesh
    joints = len(character.skeleton)
    points = (share[..., None] * mesh.vertices[vertices]).sum(axis=1)
    weights = np.zeros((len(vertices), joints))
    row = np.repeat(np.arange(len(vertices)), vertices.shape[1] * skin.columns.shape[1])
    np.add.at(
        weights, (row, skin.joints[skin.columns[vertices]].ravel()), (share[..., None] * skin.weights[vertices]).ravel()
    )
    bind = np.zeros((joints, 4, 4))
    bind[skin.joints] = skin.inverse_binds
    homogeneous = np.einsum("jkl,pl->pjk", bind, np.concatenate([points, np.ones((len(points), 1))], axis=1))
    carried = weights.copy()
    for joint in range(joints - 1, 0, -1):
        carried[:, character.skeleton.parents[joint]] += carried[:, joint]
    return _Points(weights, homogeneous, carried)


def _chosen(points: _Points, which: Array) -> _Points:
    return _Points(points.weights[which], points.homogeneous[which], points.carried[which])


def _closest(
    target: Actor, copied: Motion, frame: Int[Array, "points"], first: _Points, second: _Points, random
) -> Float[Array, "points"]:
    """Least distance that damped Gauss-Newton finds for each pair, all pairs side by side as if they were frames."""
    skeleton = target.skeleton
    start = copied.rotations[frame]
    offsets = local_positions(skeleton, copied.translations, copied.moved)[frame]
    free = [(joint, FREEDOM[name]) for name, joint in target.humanoid.joints.items() if name in FREEDOM]
    joints, freedom = np.array([joint for joint, _ in free]), np.array([most for _, most in free])
    limits, local = joint_limits(target), start.copy()
    if random is not None:
        away = random.normal(scale=DISTURBED, size=(len(frame), len(joints), 3))
        local[:, joints] = rot.multiply(local[:, joints], rot.from_rotation_vector(away))
    best = np.full(len(frame), np.inf)
    for _ in range(ROUNDS):
        local[:, joints] = _bounded(start[:, joints], local[:, joints], freedom)
        world, _ = forward(skeleton.parents, local, offsets)
        ease_into_limits(limits, world)
        local = local_rotations(skeleton.parents, world)
        world, positions = forward(skeleton.parents, local, offsets)
        transforms = joint_transforms(world, positions)
        p, q = first.places(transforms), second.places(transforms)
        gap = q - p
        best = np.minimum(best, np.linalg.norm(gap, axis=1))
        # Turning joint j by w moves p by w x (p - x_j), as far as p hangs on j.
        lever = first.carried[:, joints, None] * (p[:, None] - positions[:, joints]) - second.carried[
            :, joints, None
        ] * (q[:, None] - positions[:, joints])
        jacobian = _cross_matrices(lever).transpose(0, 2, 1, 3).reshape(len(frame), 3, -1)
        normal = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING * target.height**2 * np.eye(3)
        turn = (jacobian.transpose(0, 2, 1) @ np.linalg.solve(normal, gap[..., None]))[..., 0]
        turn = turn.reshape(len(frame), len(joints), 3)
        turn *= np.minimum(1.0, 0.3 / np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-12))
        above = world[:, skeleton.parents[joints]]
        own = rot.rotate(rot.inverse(above), turn)
        local[:, joints] = rot.multiply(rot.from_rotation_vector(own), local[:, joints])
    return best


def _cross_matrices(lever: Float[Array, "points joints 3"]) -> Float[Array, "points joints 3 3"]:
    """Matrices M with M w = w x lever."""
    x, y, z = np.moveaxis(lever, -1, 0)
    none = np.zeros_like(x)
    rows = [[none, z, -y], [-z, none, x], [y, -x, none]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _bounded(start: Array, local: Array, freedom: Float[Array, "joints"]) -> Array:
    """Local rotations no further than their freedom from where they started."""
    away = rot.to_rotation_vector(rot.multiply(rot.inverse(start), local))
    angle = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    return rot.multiply(start, rot.from_rotation_vector(away * np.minimum(1.0, freedom[:, None] / angle)))
