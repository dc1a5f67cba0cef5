"""Real characters: their parts are sensible, and what is reported as penetration is a body in a body."""

import json
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices
from retarget.casting import cast
from retarget.contact.collide import prepare_collider
from retarget.contact.parts import LIMBS, PARTS
from retarget.evaluate.cases import in_other_rest_pose
from retarget.evaluate.reference.ray_parity import inside_by_parity
from retarget.geometry.topology import closing_fans
from retarget.io import load
from retarget.motion.filter import resample

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "characters"


def characters():
    """Every file that holds a surface on a skeleton, by what its JSON says: to load them all takes seconds before the first test."""
    return [path.relative_to(DATA).as_posix() for path in sorted(DATA.rglob("*.gl*")) if holds_a_character(path.read_bytes())]


def holds_a_character(data):
    text = data[20 : 20 + int.from_bytes(data[12:16], "little")] if data[:4] == b"glTF" else data
    return any("skin" in node and "mesh" in node for node in json.loads(text)["nodes"])


@cache
def prepared(name):
    person = cast(load(DATA / name))
    return person, prepare_collider(person.character, person.humanoid)


every = pytest.mark.parametrize("name", characters())


@every
def test_every_limb_has_faces_on_its_side(name):
    person, collider = prepared(name)
    parts, rest = collider.parts, rest_vertices(person.character)
    on_body = parts.body_faces
    leftwards = rest @ person.humanoid.axes[0]
    middle = np.median(leftwards[parts.body_vertices])
    for part in ("head", "chest", "pelvis", *LIMBS):
        own = np.unique(person.character.mesh.faces[on_body & (parts.face_parts == PARTS.index(part))])
        assert len(own) >= 8, part
        side = (leftwards[own] - middle).mean() / person.height
        assert (side > 0.02) if part.startswith("left") else (side < -0.02) if part.startswith("right") else True, part
        if not part.startswith(("left", "right")):
            assert abs(side) < 0.05, part


@every
def test_left_and_right_are_alike(name):
    """These bodies are built in mirror image (what they hold and wear apart)."""
    person, collider = prepared(name)
    area = np.zeros(17)
    rest, faces = rest_vertices(person.character), person.character.mesh.faces
    a, b, c = (rest[faces[:, corner]] for corner in range(3))
    size = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    own = collider.parts.body_faces
    np.add.at(area, collider.parts.face_parts[own], size[own])
    for part in (name.removeprefix("left") for name in LIMBS if name.startswith("left")):
        left, right = (area[PARTS.index(side + part)] for side in ("left", "right"))
        assert 0.5 < left / right < 2, part


@every
def test_nothing_penetrates_at_rest_nor_in_the_joints_of_a_small_movement(name):
    """A body whose arms, legs and head are pieces of their own has them stuck into the trunk; that is no penetration."""
    person, collider = prepared(name)
    character = person.character
    assert collider.depths(rest_vertices(character)[None]).max() == 0
    skeleton, joints = character.skeleton, person.humanoid.joints
    left, up, _ = np.eye(3)
    turns = [
        ("head", 25 * up), ("head", 10 * left), ("spine", 10 * left), ("leftUpperArm", 20 * left), ("rightUpperArm", 20 * up),
        ("leftLowerArm", -30 * up), ("rightLowerArm", 30 * left), ("leftUpperLeg", -25 * left), ("rightUpperLeg", 25 * left),
        ("rightLowerLeg", 30 * left), ("leftHand", 25 * left), ("rightFoot", 15 * left),
    ]  # fmt: skip
    for canonical, turn in turns:
        turned = in_other_rest_pose(character, {skeleton.names[joints[canonical]]: np.radians(turn)}).skeleton
        vertices = prepare_skinning(character).vertices(*rest_world(turned))
        assert collider.depths(vertices)[0].max() < 0.005 * person.height, (canonical, turn)


def rest_world(skeleton):
    rotations, positions = rest_pose(skeleton)
    return rotations[None], positions[None]


def some_frames(person, asset, clips=12, fps=3.0):
    """Posed bodies of the character's own clips, spread over them."""
    skinner = prepare_skinning(person.character)
    chosen = np.unique(np.linspace(0, len(asset.clips) - 1, clips).astype(int)) if asset.clips else []
    for number in chosen:
        motion = person.house_from_file.motion(asset.motion(int(number)))
        motion = resample(motion, fps) if len(motion) > 1 else motion
        yield asset.clips[number].name, skinner.vertices(*world_pose(motion)).astype(np.float64)


@every
def test_what_is_reported_in_its_own_clips_lies_inside_the_whole_body(name):
    """The parts' closing fans do not make it up: a vertex reported in one part is, by brute force, inside the surface of
    the pieces that part belongs to (closed as whole pieces, without seams between parts)."""
    person, collider = prepared(name)
    parts, faces = collider.parts, collider.parts.welded[person.character.mesh.faces]
    direction = np.array([0.36, 0.48, 0.8])
    told, false = 0, Counter()
    for clip, frames in some_frames(person, load(DATA / name)):
        for vertices in frames[:: max(1, len(frames) // 4)]:
            found = collider.pairs(vertices)
            deep = found.distance < -0.01 * person.height
            pieces = parts.face_pieces[found.face]
            for piece in np.unique(pieces[deep]):
                rows = np.flatnonzero(deep & (pieces == piece))
                skin = faces[parts.face_pieces == piece]
                caps, rims = closing_fans(skin, len(vertices))
                centres = np.array([vertices[rim].mean(axis=0) for rim in rims]).reshape(-1, 3)
                inside = inside_by_parity(
                    vertices[found.vertex[rows]], np.concatenate([vertices, centres]), np.concatenate([skin, caps]), direction
                )
                told += len(rows)
                # A vertex of the same piece lies on its surface: inside or outside by rounding, and by folds.
                other = ~np.isin(found.vertex[rows], skin)
                for row in rows[other & ~inside]:
                    own = PARTS[parts.vertex_parts[found.vertex[row]]]
                    false[clip, own, PARTS[found.part[row]]] += 1
    assert false.total() <= 0.02 * told, false.most_common(5)


@every
def test_props_hair_and_sheets_are_never_reported(name):
    person, collider = prepared(name)
    still = ~collider.parts.body_vertices
    for _, frames in some_frames(person, load(DATA / name), clips=4):
        assert collider.depths(frames[::4])[:, still].max(initial=0.0) == 0


def test_a_shield_does_not_swallow_the_hand_that_holds_it(data):
    for name in ("kaykit/Knight.glb", "kaykit/Barbarian.glb"):
        _, collider = prepared(name)
        faces = collider.parts.face_parts[collider.parts.body_faces]
        left, right = (int((faces == PARTS.index(f"{side}Hand")).sum()) for side in ("left", "right"))
        assert left > 50 and right > 50
        assert "prop" in collider.parts.piece_kinds
