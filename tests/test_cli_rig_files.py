"""What people hand to `retarget rig`: polygons, mirrored meshes, characters that have a rig already."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent / "rig"))
from gltf_maker import Maker  # noqa: E402
from rig_bodies import case  # noqa: E402

from retarget.body.kinematics import rest_pose  # noqa: E402
from retarget.io import load  # noqa: E402

BODY = case(3)
"""Legs together; the embedded topology itself is written here, whose joints are known."""
VERTICES, FACES = BODY.posed / BODY.scale, BODY.character.mesh.faces


def polygons(faces, count):
    """The same surface in stars and quads: the triangles around every twentieth vertex become one polygon, whose middle is then
    a vertex of no face, and the others become quads where two meet."""
    around = {vertex: np.flatnonzero((faces == vertex).any(axis=1)) for vertex in range(0, count, 20)}
    taken, found = np.zeros(len(faces), dtype=bool), []
    for vertex, own in around.items():
        if not taken[own].any():
            turned = [np.roll(face, -face.tolist().index(vertex)).tolist() for face in faces[own]]
            after = {face[1]: face[2] for face in turned}
            loop = [turned[0][1]]
            while len(loop) < len(own):
                loop.append(after[loop[-1]])
            found.append(loop)
            taken[own] = True
    beyond = {(a, b): (number, c) for number, face in enumerate(faces.tolist())
              for a, b, c in (face, face[1:] + face[:1], face[2:] + face[:2])}  # fmt: skip
    for number, (a, b, c) in enumerate(faces.tolist()):
        other, corner = beyond[b, a]
        if not taken[number]:
            found.append([a, b, c] if taken[other] else [a, corner, b, c])
            taken[[number, other]] = True
    return found


def write_obj(path, vertices, faces):
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    path.write_text(
        "\n".join([*lines, *("f " + " ".join(str(corner + 1) for corner in face) for face in faces)]) + "\n"
    )
    return path


def own_rest():
    character = BODY.character
    return dict(zip(character.skeleton.names, rest_pose(character.skeleton)[1]))


def bones(places):
    """Lengths by the name of a bone's end."""
    ends = {"LowerArm": "UpperArm", "Hand": "LowerArm", "LowerLeg": "UpperLeg", "Foot": "LowerLeg"}
    return {
        side + end: float(np.linalg.norm(places[side + end] - places[side + start]))
        for side in ("left", "right") for end, start in ends.items()
    }  # fmt: skip


def rigged(command, path, output):
    code, out, err = command("rig", path, "-o", output, "--json")
    assert code == 0 and not err, err
    character = load(output).character
    return json.loads(out), character, dict(zip(character.skeleton.names, rest_pose(character.skeleton)[1]))


def test_polygons_are_rigged_and_vertices_of_no_face_are_no_height(command, tmp_path):
    faces = polygons(FACES, len(VERTICES))
    used = np.unique(np.concatenate(faces))
    assert max(map(len, faces)) > 5 and 100 < len(VERTICES) - len(used)
    told, character, places = rigged(
        command, write_obj(tmp_path / "body.obj", VERTICES, faces), tmp_path / "rigged.glb"
    )
    assert told["confidence"] > 0.8 and len(character.mesh.vertices) == len(VERTICES)
    assert told["height_m"] == pytest.approx(np.ptp(character.mesh.vertices[used, 1]), abs=1e-3)
    assert told["height_m"] == pytest.approx(BODY.height / BODY.scale, rel=0.01)
    assert bones(places) == pytest.approx(bones(own_rest()), abs=0.015)


def movers(character):
    """The joint that moves each vertex most, by name."""
    skin = character.skin
    heaviest = np.take_along_axis(skin.columns, skin.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    return [character.skeleton.names[joint] for joint in skin.joints[heaviest]]


def other_side(name):
    sides = {"left": "right", "right": "left"}
    return next((name.replace(side, other, 1) for side, other in sides.items() if name.startswith(side)), name)


def test_a_mesh_under_a_mirroring_node_has_its_sides_exchanged(command, tmp_path):
    maker, scale = Maker(), (-100.0, -100.0, -100.0)
    attributes = {"POSITION": maker.accessor(VERTICES / abs(scale[0]))}
    mesh = maker.add(
        "meshes", {"primitives": [{"attributes": attributes, "indices": maker.accessor(FACES.ravel(), "u4")}]}
    )
    maker.add("scenes", {"nodes": [maker.add("nodes", {"mesh": mesh, "scale": scale})]})
    _, character, places = rigged(command, maker.glb(tmp_path / "body.glb"), tmp_path / "rigged.glb")
    true = [other_side(name) for name in movers(BODY.character)]
    exchanged = [other_side(mine) == own != mine for mine, own in zip(movers(character), true)]
    assert np.mean(exchanged) < 0.01
    assert np.mean([mine == own for mine, own in zip(movers(character), true)]) > 0.95
    mirrored = {other_side(name): place for name, place in own_rest().items()}
    assert bones(places) == pytest.approx(bones(mirrored), abs=0.015)
    corners = character.mesh.vertices[character.mesh.faces]
    assert (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum() > 0, "its outside stays outside"


def test_of_a_rigged_character_the_surface_is_rigged_anew(command, tmp_path):
    path = tmp_path / "hero.glb"
    assert command("body", "-o", path, "--preset", "heavy", "--motion", "wave")[0] == 0
    told, character, places = rigged(command, path, tmp_path / "again.glb")
    before = load(path).character
    assert told["confidence"] > 0.8 and len(character.mesh.vertices) == len(before.mesh.vertices)
    true = dict(zip(before.skeleton.names, rest_pose(before.skeleton)[1]))
    assert np.linalg.norm([places[name] - true[name] for name in bones(true)], axis=1).max() < 0.015


def test_a_file_with_a_skeleton_alone_is_refused(command, tmp_path):
    path = tmp_path / "hero.bvh"
    assert command("body", "-o", path, "--motion", "wave")[0] == 0
    code, out, err = command("rig", path, "-o", tmp_path / "again.glb")
    assert code == 2 and not out and err.count("\n") == 1 and "holds a motion without surface" in err
    assert not (tmp_path / "again.glb").exists()
