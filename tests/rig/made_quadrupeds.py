"""Rigged quadrupeds of any proportions, made once: their rig, pose and place are known."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from retarget.body import rotations as rot
from retarget.body.kinematics import forward
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh, Skeleton, Skin
from retarget.geometry.resample import decimate
from retarget.geometry.shell import shell

LEGS = {"FrontLeft": (1, 1), "FrontRight": (1, -1), "HindLeft": (-1, 1), "HindRight": (-1, -1)}
"""Along +Z (front) and +X (left)."""
ENDS = ("Head_end", "TailTip", *(f"{leg}Paw" for leg in LEGS))


@dataclass(frozen=True)
class Build:
    """Proportions in metres."""

    leg: float = 0.5
    trunk: float = 0.6
    neck: float = 0.25
    head: float = 0.2
    tail: float = 0.4
    girth: float = 1.0


@dataclass(frozen=True, eq=False)
class Quadruped:
    character: Character
    joints: np.ndarray
    """At rest."""


def bones(build):
    """Name, parent, joint, end of the bone, radius."""
    leg, long, girth = build.leg, build.trunk, build.girth
    hips, chest = np.array([0, leg * 1.05, -long / 2]), np.array([0, leg * 1.08, long / 2])
    nape = chest + [0, build.neck * 0.75, build.neck * 0.65]
    muzzle, rump = nape + [0, -0.25 * build.head, build.head], hips + [0, 0.03, -0.1]
    middle, half, tip = (
        (hips + chest) / 2,
        rump + [0, 0.1 * build.tail, -0.5 * build.tail],
        rump + [0, 0.1 * build.tail, -build.tail],
    )
    found = [
        ("Root", None, np.zeros(3), None, 0.0),
        ("Pelvis", "Root", hips, middle, 0.12 * girth),
        ("Chest", "Pelvis", middle, chest, 0.135 * girth),
        ("Neck", "Chest", chest, nape, 0.075 * girth),
        ("Head", "Neck", nape, muzzle, 0.07),
        ("Head_end", "Head", muzzle, None, 0.0),
        ("TailBase", "Pelvis", rump, half, 0.035),
        ("TailTip", "TailBase", half, tip, 0.03),
    ]
    for name, (ahead, aside) in LEGS.items():
        top = (chest if ahead > 0 else hips) + [0.13 * max(girth, 1) * aside, -0.06, 0.02 * ahead]
        knee = np.array([top[0], 0.5 * top[1], top[2] + 0.04 * ahead])
        ankle = np.array([top[0], 0.09, top[2] - 0.02])
        found += [
            (f"{name}Upper", "Chest" if ahead > 0 else "Pelvis", top, knee, 0.06 * girth),
            (f"{name}Lower", f"{name}Upper", knee, ankle, 0.042),
            (f"{name}Paw", f"{name}Lower", ankle, ankle + [0, -0.045, 0.09], 0.042),
        ]
    return found


@cache
def quadruped(build, cells=110, vertices=None):
    """At rest, facing +Z; its weights fall off smoothly with the distance from the bones."""
    parts = bones(build)
    names = [part[0] for part in parts]
    joints = np.array([part[2] for part in parts], dtype=float)
    parents = np.array([-1 if part[1] is None else names.index(part[1]) for part in parts])
    solid = [part for part in parts if part[3] is not None]
    draw, points = np.random.default_rng(0), []
    for _, _, start, end, radius in solid:
        along, around = draw.random((20_000, 1)), rot.unit(draw.normal(size=(20_000, 3)))
        points.append(start + along * (end - start) + radius * around)
    surface = shell(np.concatenate(points), 1, cells)
    surface = surface if vertices is None else decimate(surface, vertices)
    away = np.stack([_outside(surface.vertices, *part[2:]) for part in solid], axis=1)
    weights = np.exp(-np.maximum(away - away.min(axis=1, keepdims=True), 0) / 0.02)
    weights[weights < 0.02] = 0
    order = np.argsort(-weights, axis=1)[:, :4]
    own = np.take_along_axis(weights, order, axis=1)
    columns = np.array([names.index(part[0]) for part in solid])[order]
    offsets = joints.copy()
    offsets[1:] -= joints[parents[1:]]
    binds = np.tile(np.eye(4), (len(names), 1, 1))
    binds[:, :3, 3] = -joints
    skeleton = Skeleton(tuple(names), parents, offsets, np.tile([0.0, 0, 0, 1], (len(names), 1)))
    skin = Skin(np.arange(len(names)), binds, columns, own / own.sum(axis=1, keepdims=True))
    return Quadruped(Character(skeleton, Mesh(surface.vertices, surface.faces), skin, name="dog"), joints)


def _outside(points, start, end, radius):
    """Distance from a capsule's surface."""
    bone = end - start
    along = np.clip((points - start) @ bone / (bone @ bone), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * bone, axis=1) - radius


POSES = {
    "standing": {},
    "walking": {"FrontLeftUpper": (-35, 0, 0), "FrontLeftLower": (25, 0, 0), "FrontRightUpper": (25, 0, 0), "HindLeftUpper": (30, 0, 0),
                "HindLeftLower": (-20, 0, 0), "HindRightUpper": (-30, 0, 0), "HindRightLower": (35, 0, 0), "Neck": (15, 20, 0),
                "TailBase": (25, 30, 0)},
    "sitting": {"Root": (-30, 40, 0), "HindLeftUpper": (-75, 0, 10), "HindRightUpper": (-75, 0, -10), "HindLeftLower": (95, 0, 0),
                "HindRightLower": (95, 0, 0), "FrontLeftUpper": (25, 0, 0), "FrontRightUpper": (35, 0, 0), "Chest": (0, 15, 0),
                "Head": (20, -25, 0), "TailBase": (20, -30, 0)},
}  # fmt: skip
"""Degrees about x, y and z."""


def posed(dog, pose):
    """Vertices and joints in a pose."""
    skeleton = dog.character.skeleton
    turns = np.tile([0.0, 0, 0, 1], (len(skeleton), 1))
    for name, degrees in POSES[pose].items():
        turns[skeleton.index(name)] = rot.from_rotation_vector(np.radians(np.array(degrees, dtype=float)))
    world, places = forward(skeleton.parents, turns, skeleton.offsets)
    return prepare_skinning(dog.character).vertices(world[None], places[None])[0].astype(float), places


def end_vertices(build, dog):
    """Vertices at the very ends of muzzle, tail and paws: what a user would point at, by the template's names."""
    parts, vertices, found = {part[0]: part for part in bones(build)}, dog.character.mesh.vertices, {}
    for name in ENDS:
        _, _, start, end, radius = parts["Head" if name == "Head_end" else name]
        away = vertices - end
        near = np.linalg.norm(away, axis=1) < 2 * radius
        found[name] = int(np.where(near, away @ (end - start), -np.inf).argmax())
    return found
