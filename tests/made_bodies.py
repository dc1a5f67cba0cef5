"""Bodies made in code for the tests of surfaces: boxes and balls, a figure of boxes, and pieces hung on other bodies."""

from dataclasses import replace
from functools import cache

import numpy as np
from made_motions import body, fingerless, poses

from retarget.body.kinematics import local_rotations, rest_pose, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh, Motion, Skeleton, Skin
from retarget.geometry.resample import Surface, subdivide

BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
     [1, 3, 5], [3, 7, 5]]
)  # fmt: skip
"""Outward triangles of the corners `box` lists."""


def box(low, high):
    """Corners (x changes fastest, then y, then z) and faces of an upright box."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    return np.asarray(low) + corners * (np.asarray(high) - np.asarray(low)), BOX_FACES


def ball(rows=24, columns=48, radius=1.0):
    """A ball of rings, closed at both poles."""
    down, around = np.linspace(0, np.pi, rows + 1)[1:-1, None], np.arange(columns) / columns * 2 * np.pi
    ring = np.stack(
        [np.sin(down) * np.cos(around), np.cos(down) + 0 * around, -np.sin(down) * np.sin(around)], axis=-1
    ).reshape(-1, 3)
    vertices = radius * np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]])
    i, j = np.meshgrid(np.arange(rows - 2), np.arange(columns), indexing="ij")
    at = lambda row, column: row * columns + column % columns  # noqa: E731
    quads = np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=-1).reshape(-1, 4)
    top, bottom, each = len(ring), len(ring) + 1, np.arange(columns)
    caps = [
        np.stack([np.full(columns, top), at(0, each), at(0, each + 1)], axis=1),
        np.stack([np.full(columns, bottom), at(rows - 2, each + 1), at(rows - 2, each)], axis=1),
    ]
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], *caps])


def tube(start, end, radius, rows=8, columns=16):
    """An open tube around a segment, outward."""
    along = np.asarray(end) - start
    side = np.cross(along, [0.31, 0.2, 0.93])
    side /= np.linalg.norm(side)
    other = np.cross(along / np.linalg.norm(along), side)
    turn = np.arange(columns) / columns * 2 * np.pi
    ring = radius * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other)
    vertices = (start + np.linspace(0, 1, rows)[:, None, None] * along + ring).reshape(-1, 3)
    return vertices, _grid_faces(rows, columns, closed=True)


def sheet(corner, across, down, rows=12, columns=12):
    """A rectangle of triangles; its front looks along across x down."""
    i, j = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    vertices = np.asarray(corner) + j[..., None] * np.asarray(across) + i[..., None] * np.asarray(down)
    return vertices.reshape(-1, 3), _grid_faces(rows, columns, closed=False)[:, ::-1]


def _grid_faces(rows, columns, closed):
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    at = lambda row, column: (row * columns + column % columns).ravel()  # noqa: E731
    quads = np.stack([at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)], axis=1)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def joined(*surfaces):
    """Several (vertices, faces) as one, sharing nothing."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in surfaces)])
    return (
        np.concatenate([vertices for vertices, _ in surfaces]),
        np.concatenate([faces + start for (_, faces), start in zip(surfaces, starts)]),
    )


def with_piece(character, surface, weights):
    """The character wearing one more piece that it shares no vertex with; `weights` gives joint names their share."""
    vertices, faces = surface
    joints, influences = character.skin.joints, character.skin.columns.shape[1]
    names = [character.skeleton.names[joint] for joint in joints]
    columns, shares = np.zeros((len(vertices), influences), dtype=int), np.zeros((len(vertices), influences))
    for place, (name, share) in enumerate(weights.items()):
        columns[:, place], shares[:, place] = names.index(name), share
    return _with_rows(character, vertices, faces, columns, shares)


def with_skin_of_nearest(character, surface):
    """The character wearing one more piece that moves with the skin beneath."""
    vertices, faces = surface
    gaps = np.linalg.norm(vertices[:, None] - character.mesh.vertices[None], axis=2)
    nearest = gaps.argmin(axis=1)
    return _with_rows(character, vertices, faces, character.skin.columns[nearest], character.skin.weights[nearest])


def _with_rows(character, vertices, faces, columns, weights):
    mesh, skin = character.mesh, character.skin
    more = Mesh(np.concatenate([mesh.vertices, vertices]), np.concatenate([mesh.faces, faces + len(mesh.vertices)]))
    rows = Skin(
        skin.joints, skin.inverse_binds, np.concatenate([skin.columns, columns]), np.concatenate([skin.weights, weights])
    )
    return replace(character, mesh=more, skin=rows)


def with_faces(character, faces):
    """The character with other faces over the same vertices."""
    return replace(character, mesh=Mesh(character.mesh.vertices, np.asarray(faces)))


def with_joint(character, name, parent, offset):
    """The character with one joint more, which moves nothing yet."""
    old = character.skeleton
    skeleton = Skeleton(
        (*old.names, name),
        np.append(old.parents, old.index(parent)),
        np.concatenate([old.offsets, [offset]]),
        np.concatenate([old.rest_rotations, [[0.0, 0, 0, 1]]]),
    )
    _, places = rest_pose(skeleton)
    bind = np.eye(4)
    bind[:3, 3] = -places[-1]
    skin = character.skin
    more = Skin(
        np.append(skin.joints, len(old)), np.concatenate([skin.inverse_binds, [bind]]), skin.columns, skin.weights
    )
    return Character(skeleton, character.mesh, more, character.name)


_BOXES = {
    # joint: (end of its box, half the width, half the depth)
    "hips": ("spine", 0.13, 0.09), "spine": ("chest", 0.12, 0.085), "chest": ("neck", 0.14, 0.09),
    "neck": ("head", 0.045, 0.045), "head": (None, 0.08, 0.09),
    **{f"{side}{name}": (f"{side}{end}" if end else None, width, width) for side in ("left", "right")
       for name, end, width in (
        ("UpperArm", "LowerArm", 0.04), ("LowerArm", "Hand", 0.035), ("Hand", None, 0.03), ("UpperLeg", "LowerLeg", 0.06),
        ("LowerLeg", "Foot", 0.045), ("Foot", "Toes", 0.04))},
}  # fmt: skip


@cache
def box_figure():
    """A figure on the embedded skeleton without fingers, one closed box a bone, stuck into each other at the joints."""
    skeleton = fingerless(body("average")).skeleton
    _, places = rest_pose(skeleton)
    surfaces, leads = [], []
    for name, (end, width, depth) in _BOXES.items():
        joint = skeleton.index(name)
        start = places[joint]
        tip = places[skeleton.index(end)] if end else start + skeleton.end_offsets.get(joint, [0, 0.2, 0])
        along = (tip - start) / np.linalg.norm(tip - start)
        side = np.cross(along, [0, 0, 1.0]) if abs(along[2]) < 0.8 else np.array([1.0, 0, 0])
        side /= np.linalg.norm(side)
        corners, faces = box([-width, -0.02, -depth], [width, np.linalg.norm(tip - start) + 0.02, depth])
        frame = np.stack([side, along, np.cross(side, along)])
        surfaces.append((start + corners @ frame, faces))
        leads += [joint] * len(corners)
    vertices, faces = joined(*surfaces)
    binds = np.broadcast_to(np.eye(4), (len(skeleton), 4, 4)).copy()
    binds[:, :3, 3] = -places
    skin = Skin(np.arange(len(skeleton)), binds, np.array(leads)[:, None], np.ones((len(leads), 1)))
    return Character(skeleton, Mesh(vertices, faces), skin, "figure of boxes")


def pose(character, turns, frames=1):
    """World rotations and positions of a body on (the start of) the embedded skeleton; `turns` as `made_motions.poses`."""
    skeleton = character.skeleton
    world = poses(frames, turns)[:, : len(skeleton)]
    extra = len(skeleton) - world.shape[1]
    if extra:  # joints hung on it go with their parents
        world = np.concatenate([world, world[:, skeleton.parents[-extra:]]], axis=1)
    offsets = np.broadcast_to(skeleton.offsets[:1], (frames, 1, 3))
    return world_pose(Motion(skeleton, local_rotations(skeleton.parents, world), offsets, 30.0))


def posed(character, turns):
    """Vertices of the body in a pose, metres."""
    return prepare_skinning(character).vertices(*pose(character, turns))[0].astype(np.float64)


ARMS_AT_WORK = {
    "leftUpperArm": [0.3, 0, -0.3], "rightUpperArm": [0.5, 0, 0.2], "leftLowerArm": [-0.7, -1.4, 0.2],
    "rightLowerArm": [-0.7, 1.4, -0.2], "leftUpperLeg": [-1.0, 0, -0.2], "leftLowerLeg": [1.4, 0, 0],
}  # fmt: skip
"""Both hands on the belly, in it where there is much of it, and one leg drawn up."""


def random_turns(seed):
    """A wild but human pose: every large joint turned at random."""
    rng = np.random.default_rng(seed)
    size = {"spine": 0.3, "chest": 0.3, "neck": 0.4, "head": 0.4}
    size |= {f"{side}{joint}": 1.1 for side in ("left", "right") for joint in ("UpperArm", "LowerArm")}
    size |= {f"{side}{joint}": 0.7 for side in ("left", "right") for joint in ("UpperLeg", "LowerLeg", "Hand")}
    return {name: rng.normal(size=3) * most for name, most in size.items()}


def sphere(rounds=4):
    """A ball of radius one with even triangles: an octahedron, subdivided."""
    corners = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    surface = Surface(corners, np.array(faces))
    for _ in range(rounds):
        surface, _ = subdivide(surface)
        surface = Surface(
            surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True), surface.faces
        )
    return surface
