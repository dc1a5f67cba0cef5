"""Body parts read from weights: they are the embedded human's own, whatever the file looks like."""

from dataclasses import replace

import numpy as np
import pytest
from made_bodies import (
    ball,
    box,
    box_figure,
    sheet,
    tube,
    with_faces,
    with_joint,
    with_piece,
    with_skin_of_nearest,
)
from made_motions import actor, body, cast_by_names, fingerless, in_other_order, with_vertices_permuted

from retarget.body.human import PRESETS, human_model, textured
from retarget.body.kinematics import rest_pose
from retarget.character import Character, Mesh, Skin
from retarget.contact.parts import LIMBS, PARTS, body_height, body_parts, joint_parts, weight_by_part
from retarget.errors import RetargetError


def parts_of(character, names=None):
    person = cast_by_names(character, names or {name: name for name in body().skeleton.names[:22]})
    return body_parts(person.character, person.humanoid)


def true_parts():
    """The embedded human's own segmentation as indices into PARTS."""
    model = human_model()
    return np.array([PARTS.index(name) for name in model.part_names])[model.vertex_parts]


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_has_the_parts_of_its_model(preset):
    model, found = human_model(), body_parts(actor(preset).character, actor(preset).humanoid)
    assert (found.vertex_parts == true_parts()).mean() > 0.99
    own = np.array([PARTS.index(name) for name in model.part_names])[model.face_parts]
    assert (found.face_parts == own).mean() > 0.98  # faces over a seam may go either way
    assert found.piece_kinds == ("body",) and found.body_vertices.all() and found.body_faces.all()
    assert np.array_equal(found.welded, np.arange(len(found.welded)))
    assert found.limb_vertices.sum() == np.isin(found.vertex_parts, [PARTS.index(name) for name in LIMBS]).sum()


def test_fewer_joints_and_copies_along_seams_change_nothing():
    plain = parts_of(body("heavy"))
    assert np.array_equal(parts_of(fingerless(body("heavy"))).vertex_parts, plain.vertex_parts)
    character = textured(body("heavy"))
    copies = parts_of(character)
    assert np.array_equal(copies.face_parts, plain.face_parts) and copies.piece_kinds == ("body",)
    corners, plainly = character.mesh.faces, body("heavy").mesh.faces
    assert np.array_equal(copies.vertex_parts[corners], plain.vertex_parts[plainly])
    assert copies.body_vertices.all()


def test_joints_and_vertices_in_another_order_permute_the_parts():
    plain = parts_of(body("child"))
    mixed, _ = in_other_order(body("child"), 5, rename=lambda name: f"b_{name}")
    names = {name: f"b_{name}" for name in body().skeleton.names}
    assert np.array_equal(parts_of(mixed, names).vertex_parts, plain.vertex_parts)
    permuted, order = with_vertices_permuted(body("child"), 6)
    found = parts_of(permuted)
    assert np.array_equal(found.vertex_parts, plain.vertex_parts[order])
    assert np.array_equal(found.face_parts, plain.face_parts)


def test_joints_without_a_name_of_their_own_follow_the_one_they_hang_on():
    person = actor("thin")
    part = joint_parts(person.skeleton, person.humanoid)
    named = {name: PARTS[part[joint]] for name, joint in person.humanoid.joints.items()}
    assert named["hips"] == "pelvis" and named["leftShoulder"] == "chest" and named["rightToes"] == "rightFoot"
    assert named["leftIndexDistal"] == named["leftHand"] == "leftHand"
    few = replace(person.humanoid, joints={n: j for n, j in person.humanoid.joints.items() if "Index" not in n})
    assert np.array_equal(joint_parts(person.skeleton, few), part)
    share = weight_by_part(person.character, person.humanoid)
    assert share.min() >= 0 and share.sum(axis=1) == pytest.approx(1)


@pytest.mark.parametrize(
    "missing", [("neck",), ("chest", "upperChest"), ("leftToes", "rightToes"), ("neck", "chest", "upperChest")]
)
def test_a_humanoid_may_lack_joints(missing):
    person = actor("average")
    joints = {name: joint for name, joint in person.humanoid.joints.items() if name not in missing}
    found = body_parts(person.character, replace(person.humanoid, joints=joints))
    empty = {PARTS[part] for part in range(17) if not (found.face_parts == part).any()}
    gone = {"neck": "neck", "chest": "abdomen"}  # without a chest joint the spine moves the chest
    assert empty == {gone[name] for name in missing if name in gone}
    sides = np.isin(found.vertex_parts, [PARTS.index(name) for name in LIMBS])
    assert np.array_equal(found.vertex_parts[sides], true_parts()[sides])


def test_left_parts_lie_left_and_every_part_of_boxes_is_one_box():
    person = cast_by_names(box_figure(), {name: name for name in box_figure().skeleton.names})
    found = body_parts(person.character, person.humanoid)
    assert np.bincount(found.face_parts, minlength=17).tolist() == [12] * 17
    assert found.piece_kinds == ("body",) * 17
    middle = person.character.mesh.vertices[:, 0]
    for part, name in enumerate(PARTS):
        if name.startswith("left"):
            assert (middle[found.vertex_parts == part] > -0.01).all()
            assert (middle[found.vertex_parts == PARTS.index("right" + name[4:])] < 0.01).all()


def with_painted(character, weights_of):
    """The character with some vertices wholly on a joint: {vertex: joint name}."""
    skin = character.skin
    columns, weights = skin.columns.copy(), skin.weights.copy()
    names = [character.skeleton.names[joint] for joint in skin.joints]
    for vertex, name in weights_of.items():
        columns[vertex], weights[vertex] = names.index(name), np.eye(columns.shape[1])[0]
    return replace(character, skin=Skin(skin.joints, skin.inverse_binds, columns, weights))


def test_a_speck_of_paint_makes_no_part_of_its_own():
    model = human_model()
    navel = model.landmark("navel")
    around = np.unique(model.faces[(model.faces == navel).any(axis=1)])
    found = parts_of(with_painted(body("average"), {int(vertex): "leftHand" for vertex in around}))
    assert PARTS[found.vertex_parts[navel]] == "abdomen"
    assert np.array_equal(found.vertex_parts, true_parts())


def hand_place(side="left"):
    skeleton = body("average").skeleton
    return rest_pose(skeleton)[1][skeleton.index(f"{side}Hand")]


@pytest.mark.parametrize(("length", "kind"), [(1.2, "prop"), (0.2, "body")])
def test_what_a_hand_moves_is_held_if_it_is_longer_than_an_arm(length, kind):
    """A sword bound to the hand itself, and a knob that might be a cartoon's fingers."""
    blade = box(hand_place() - [0.03, 0.03, 0.1], hand_place() + [0.03, 0.03, length - 0.1])
    found = parts_of(with_piece(body("average"), blade, {"leftHand": 1.0}))
    assert found.piece_kinds == ("body", kind)


def test_what_is_held_on_a_joint_of_its_own_is_a_prop_and_leaves_the_hand_alone():
    armed = with_joint(body("average"), "sword_slot", "leftHand", [0.05, 0, 0])
    blade = box(hand_place() - [0.3, 0.6, 0.02], hand_place() + [0.3, 0.6, 0.02])
    found = parts_of(with_piece(armed, blade, {"sword_slot": 1.0}))
    assert found.piece_kinds == ("body", "prop")
    count = len(body("average").mesh.vertices)
    assert np.array_equal(found.vertex_parts[:count], true_parts()), "a shield is no reason for the hand to vanish"
    assert not found.body_vertices[count:].any() and not found.limb_vertices[count:].any()
    assert body_height(
        np.concatenate([body("average").mesh.vertices, blade[0] + [0, 5, 0]]), found, actor("average").humanoid
    ) == pytest.approx(np.ptp(body("average").mesh.vertices[:, 1]), rel=1e-3)


HEAD = np.array([0, 1.62, 0])
PIECES = {
    "a strand of hair": (sheet([-0.02, 1.7, -0.12], [0.04, 0, 0], [0, -0.4, -0.05]), "sheet"),
    "a cape": (sheet([-0.25, 1.4, -0.2], [0.5, 0, 0], [0, -0.9, -0.1]), "sheet"),
    "a cape with two sides": (
        (lambda v, f: (v, np.concatenate([f, f[:, ::-1]])))(*sheet([-0.25, 1.4, -0.2], [0.5, 0, 0], [0, -0.9, -0.1])),
        "sheet",
    ),
    "a thick cape": (box([-0.3, 0.5, -0.2], [0.3, 1.5, -0.193]), "sheet"),
    "a short collar": (tube([0, 1.40, 0], [0, 1.43, 0], 0.1), "sheet"),
    "a sleeve": (tube([0.25, 1.3, 0], [0.45, 1.1, 0], 0.08), "body"),
    "a helmet": ((lambda v, f: (0.15 * v[v[:, 1] > -0.3] + HEAD, f))(*ball(2, 8)), None),
    "a button": (tuple(map(np.asarray, (0.01 * ball(8, 8)[0] + [0, 1.2, 0.2], ball(8, 8)[1]))), "body"),
}


@pytest.mark.parametrize("name", [name for name, (_, kind) in PIECES.items() if kind])
def test_what_encloses_nothing_is_a_sheet(name):
    surface, kind = PIECES[name]
    assert parts_of(with_skin_of_nearest(body("average"), surface)).piece_kinds == ("body", kind)


def test_hair_is_known_by_its_material_and_joints():
    wig = (0.15 * ball(12, 16)[0] + HEAD, ball(12, 16)[1])
    character = with_piece(body("average"), wig, {"head": 1.0})
    materials = (body("average").mesh.materials[0], replace(body("average").mesh.materials[0], name="LongHair"))
    which = np.r_[np.zeros(len(body("average").mesh.faces), int), np.ones(len(wig[1]), int)]
    named = replace(character, mesh=replace(character.mesh, materials=materials, face_materials=which))
    assert parts_of(character).piece_kinds == ("body", "body")
    assert parts_of(named).piece_kinds == ("body", "hair")
    tailed = with_joint(body("average"), "ponytail_01", "head", [0, 0, -0.1])
    assert parts_of(with_piece(tailed, wig, {"ponytail_01": 1.0})).piece_kinds == ("body", "hair")


def test_faces_held_twice_and_faces_without_area_do_not_count():
    faces = body("average").mesh.faces
    doubled = np.concatenate([faces, faces[:, ::-1], [[0, 0, 1], [5, 5, 5]]])
    found, plain = parts_of(with_faces(body("average"), doubled)), parts_of(body("average"))
    assert np.array_equal(found.face_parts[: len(faces)], plain.face_parts)
    assert (found.face_parts[len(faces) :] == -1).all() and (found.face_pieces[len(faces) :] == -1).all()
    assert np.array_equal(found.vertex_parts, plain.vertex_parts) and found.piece_kinds == ("body",)


def bare(vertices, faces):
    """Vertices and faces on the embedded skeleton, all on the hips."""
    thin, count = body("thin"), len(vertices)
    skin = Skin(thin.skin.joints, thin.skin.inverse_binds, np.zeros((count, 1), int), np.ones((count, 1)))
    return Character(thin.skeleton, Mesh(np.asarray(vertices, float), np.asarray(faces)), skin, "scrap")


def test_a_character_without_a_surface_is_refused_and_scraps_are_not():
    person = actor("thin")
    with pytest.raises(RetargetError, match="no surface"):
        body_parts(Character(person.skeleton, name="bones"), person.humanoid)
    with pytest.raises(RetargetError, match="no surface"):
        body_parts(bare(np.zeros((0, 3)), np.zeros((0, 3), int)), person.humanoid)
    for faces, kinds in (([[0, 1, 2]], ("sheet",)), (np.zeros((0, 3), int), ())):
        found = body_parts(bare([[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces), person.humanoid)
        assert found.piece_kinds == kinds and not found.body_vertices.any()
        assert [PARTS[part] for part in found.vertex_parts] == ["pelvis"] * 3


def test_an_unknown_part_is_refused_by_name():
    found = parts_of(body("thin"))
    assert found.names[found.index("leftHand")] == "leftHand"
    with pytest.raises(RetargetError, match="leftHnad.*nearest: 'leftHand'"):
        found.index("leftHnad")
