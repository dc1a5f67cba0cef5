"""How fast and how right the collision test is: the part of the contact bench that no method has a share in."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Mesh, Skin
from retarget.contact.collide import Collider, prepare_collider
from retarget.contact.detect import LEAVE, THRESHOLD, prepare_contacts
from retarget.evaluate.contact_cases import embedded_actor
from retarget.motion.align import Actor
from retarget.motion.library import PERFORMER, embedded_motion
from retarget.progress import Tell, untold
from retarget.retargeting import prepare

Array = np.ndarray

TIMED = ("hands_on_hips", "arms_crossed", "squat_hands_on_knees", "walk")
"""Motions whose frames are timed, on the heavy body: copied rotations push its hands deep into it."""
TIMED_FRAMES = 8
"""Frames of each."""
POSED_BODIES = ("thin", "heavy", "toddler", "muscular")
MARGIN = 0.002
"""Share of the height within which the fast level looks outside: what a solver that pushes surfaces apart asks for."""
SPREAD = 0.45
"""Standard deviation of the random turns of every joint, radians an axis: many poses tie the body in knots."""
DEEP = 0.001
"""Metres below the surface from which the fast test and the reference must agree."""
LARGE = 13_000
"""Vertices of the larger body."""


def figures(quick: bool, seed: int, tell: Tell = untold) -> dict[str, float | int | None]:
    """All figures of the collision test."""
    tell("timing the collision test")
    small = embedded_actor("heavy")
    large = replace(small, character=refined(small.character, LARGE))
    frames = _timed_frames(small)
    found: dict[str, float | int | None] = {}
    reach = LEAVE * THRESHOLD * small.height
    for key, actor in (("6k9", small), ("13k", large)):
        collider = prepare_collider(actor.character, actor.humanoid)
        posed = prepare_skinning(actor.character).vertices(*(np.stack(column) for column in zip(*frames)))
        found[f"collide_ms_{key}"] = _milliseconds(lambda v, c=collider: c.pairs(v, reach), posed)
        found[f"collide_fast_ms_{key}"] = _milliseconds(lambda v, c=collider: c.pairs(v, MARGIN * small.height), posed)
    detector = prepare_contacts(small.character, small.humanoid)
    found["detect_ms_6k9"] = _detection_milliseconds(detector, frames)
    found["cold_start_seconds"] = _cold_start_seconds(2 if quick else 4)
    poses = 8 if quick else 200
    found["parity_poses"] = poses
    found |= parity(poses, seed, tell)
    return found


def _timed_frames(actor: Actor) -> list[tuple[Array, Array]]:
    """World poses of the body, from motions copied onto it."""
    frames = []
    copied = prepare(embedded_actor(PERFORMER), actor, "copy-rotations").retargeter
    for name in TIMED:
        rotations, positions = world_pose(copied(embedded_motion(name)).motion)
        chosen = np.linspace(0.3, 0.7, TIMED_FRAMES) * (len(rotations) - 1)
        frames += [(rotations[int(frame)], positions[int(frame)]) for frame in chosen]
    return frames


def _milliseconds(work: Callable[[Array], object], posed: Float[Array, "frames vertices 3"]) -> float:
    """Mean over the poses of the best of five, after a warm-up over all of them."""
    for vertices in posed:
        work(vertices)
    return 1000 * statistics.mean(min(_seconds(lambda v=v: work(v)) for _ in range(5)) for v in posed)


def _detection_milliseconds(detector, frames: list[tuple[Array, Array]]) -> float:
    """Whole detection of a clip, a frame: skinning, slimmer bodies and tracking included; best of three."""
    rotations, positions = (np.stack(column) for column in zip(*frames))
    return 1000 * min(_seconds(lambda: detector.clip(rotations, positions, 30.0)) for _ in range(3)) / len(frames)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _cold_start_seconds(runs: int) -> float:
    """What preparing and testing one body adds to a fresh process, kernels compiled before."""
    plain = "from retarget.body.human import human; from retarget.casting import cast; a = cast(human())"
    tested = f"{plain}; from retarget.contact.collide import prepare_collider; prepare_collider(a.character, a.humanoid).pairs(a.character.mesh.vertices)"

    def best(code: str) -> float:
        command = [sys.executable, "-c", code]
        return min(_seconds(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(runs))

    return best(tested) - best(plain)


def parity(poses: int, seed: int, tell: Tell = untold) -> dict[str, int | float]:
    """Disagreements with brute-force ray parity on vertices deeper than 1 mm, over random poses of several bodies; and the
    largest difference of depth (mm)."""
    random = np.random.default_rng(seed)
    disagreements, inside, worst = 0, 0, 0.0
    for number in range(poses):
        tell(f"brute-force parity, pose {number + 1} of {poses}", 1)
        actor = embedded_actor(POSED_BODIES[number % len(POSED_BODIES)])
        skeleton = actor.skeleton
        turns = rot.from_rotation_vector(random.normal(scale=SPREAD, size=(1, len(skeleton), 3)))
        pose = forward(skeleton.parents, rot.multiply(skeleton.rest_rotations, turns), skeleton.offsets[None])
        posed = prepare_skinning(actor.character).vertices(*pose)[0]
        wrong, checked, apart = compare_with_reference(_collider(actor), posed, rot.unit(random.normal(size=3)))
        disagreements, inside, worst = disagreements + wrong, inside + checked, max(worst, apart)
    return {"parity_disagreements": disagreements, "parity_inside": inside, "parity_depth_error_mm": 1000 * worst}


_colliders: dict[int, Collider] = {}


def _collider(actor: Actor) -> Collider:
    if id(actor) not in _colliders:
        _colliders[id(actor)] = prepare_collider(actor.character, actor.humanoid)
    return _colliders[id(actor)]


def compare_with_reference(
    collider: Collider, posed: Float[Array, "vertices 3"], direction: Float[Array, "3"]
) -> tuple[int, int, float]:
    """(vertices deeper than 1 mm on which both disagree, vertices that are inside by the reference, largest difference of
    depth in metres) of one pose."""
    from retarget.evaluate.reference.ray_parity import distance_to_faces, inside_by_parity

    pairs = collider.pairs(posed)
    ours = np.zeros((len(posed), int(collider.solid_parts.max()) + 1))
    ours[pairs.vertex, pairs.part] = -pairs.distance
    points = collider.points(posed)
    wrong, checked, worst = 0, 0, 0.0
    for part in np.unique(collider.solid_parts):
        theirs = np.zeros(len(posed))
        for solid in np.flatnonzero(collider.solid_parts == part):
            tested = collider.blocks.vertices[~collider.excluded[collider.blocks.vertices, solid]]
            faces = collider.corners[collider.starts[solid] : collider.starts[solid + 1]].astype(np.int64)
            skin = faces[collider.mesh_faces[collider.starts[solid] : collider.starts[solid + 1]] >= 0]
            within = tested[inside_by_parity(points[tested], points, faces, direction)]
            theirs[within] = np.maximum(theirs[within], distance_to_faces(points[within], points, skin))
        deepest = np.maximum(ours[:, part], theirs)
        wrong += int((((ours[:, part] > 0) != (theirs > 0)) & (deepest > DEEP)).sum())
        checked += int((theirs > DEEP).sum())
        both = (ours[:, part] > 0) & (theirs > 0)
        worst = max(worst, float(np.abs(ours[:, part] - theirs)[both].max(initial=0.0)))
    return wrong, checked, worst


def refined(character: Character, vertices: int) -> Character:
    """The same body with at least so many vertices: long edges are halved, the surface stays where it was."""
    mesh, skin = character.mesh, character.skin
    places, faces = mesh.vertices, mesh.faces
    dense = np.zeros((len(places), len(skin.joints)))
    np.add.at(
        dense, (np.repeat(np.arange(len(places)), skin.columns.shape[1]), skin.columns.ravel()), skin.weights.ravel()
    )
    while len(places) < vertices:
        edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        length = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
        faces, halved = _halve(faces, edges[np.argsort(-length)][: vertices - len(places)], len(places))
        places = np.concatenate([places, places[halved].mean(axis=1)])
        dense = np.concatenate([dense, dense[halved].mean(axis=1)])
    columns = np.argsort(-dense, axis=1)[:, :8]
    weights = np.take_along_axis(dense, columns, axis=1)
    skin = Skin(skin.joints, skin.inverse_binds, columns, weights / weights.sum(axis=1, keepdims=True))
    return replace(character, mesh=Mesh(places, faces), skin=skin)


def _halve(faces: Array, edges: Array, first: int) -> tuple[Array, Array]:
    """Halve as many of the edges, in order, as share no face; returns the faces and the edges halved."""
    at: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(faces.tolist()):
        for edge in ((a, b), (b, c), (c, a)):
            at.setdefault((min(edge), max(edge)), []).append(face)
    taken = np.zeros(len(faces), dtype=bool)
    kept, added, halved = faces.copy(), [], []
    for a, b in edges.tolist():
        around = at[a, b]
        if taken[around].any():
            continue
        taken[around] = True
        middle = first + len(halved)
        halved.append((a, b))
        for face in around:
            corners = faces[face].tolist()
            kept[face] = [middle if corner == b else corner for corner in corners]
            added.append([middle if corner == a else corner for corner in corners])
    return np.concatenate([kept, np.array(added).reshape(-1, 3)]), np.array(halved).reshape(-1, 2)
