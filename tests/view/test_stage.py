"""What views show of a body: where it touches and penetrates itself, where it stands, and skins as browsers know them."""

from dataclasses import replace

import numpy as np
import pytest
from made_bodies import ball, box
from made_motions import body, turned
from stage_bodies import bare_walk, belly, belly_take

from retarget.body.human import textured
from retarget.body.kinematics import rest_pose
from retarget.casting import cast
from retarget.character import Material, Mesh
from retarget.contact.parts import PARTS
from retarget.errors import RetargetError
from retarget.evaluate.report_surface import surface_track
from retarget.evaluate.take import Take
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.view import stage
from retarget.view.bones import bone_character, skeleton_mesh


def parts_of(shown, frame, codes):
    vertex, code = shown.spots.of_frame(frame)
    return {PARTS[part] for part in shown.parts[vertex[np.isin(code, codes)]].tolist()}


def test_the_hand_and_what_it_lies_on_are_marked_when_they_touch():
    shown = belly()
    assert {"rightHand", "abdomen"} <= parts_of(shown, shown.frames - 1, [stage.TOUCHES])
    assert "rightHand" not in parts_of(shown, 0, range(256)), "the arm is still on its way"
    assert shown.spots.starts[-1] == len(shown.spots.vertex) and len(shown.spots.starts) == shown.frames + 1


def test_halves_of_a_seam_are_marked_alike():
    character = textured(body())
    take = Take(cast(character), cut(embedded_motion("hand_on_belly"), 1.8, 2.0))
    shown = stage.stage_body("it", take)
    codes = np.zeros(len(shown.parts), dtype=int)
    vertex, code = shown.spots.of_frame(shown.frames - 1)
    codes[vertex] = code
    group = np.unique(np.round(shown.character.mesh.vertices, 7), axis=0, return_inverse=True)[1].ravel()
    highest = np.zeros(group.max() + 1, dtype=int)
    np.maximum.at(highest, group, codes)
    marked = np.flatnonzero(codes)
    assert len(np.unique(group[marked])) < len(marked), "there are seams where it touches"
    assert np.array_equal(codes, highest[group])


def test_depth_is_told_in_millimetres_on_all_halves_of_seams():
    shown, take = belly("heavy"), belly_take("heavy")
    track = surface_track(take, shown.floor)
    frame = int(track.deepest().argmax())
    depth = track.depths.dense(frame, frame + 1, track.parts)[0]
    vertex, code = shown.spots.of_frame(frame)
    deep = code > stage.TOUCHES
    assert deep.any() and np.array_equal(vertex[deep], np.flatnonzero(np.round(1000 * depth) > 0))
    assert np.array_equal(code[deep] - 1, np.round(1000 * depth[vertex[deep]]).astype(int))


def test_a_surface_without_limbs_is_shown_with_a_note(monkeypatch):
    def refuse(*_):
        raise RetargetError("no part of the surface is body")

    monkeypatch.setattr(stage, "surface_track", refuse)
    shown = stage.stage_body("it", belly_take())
    assert len(shown.spots.vertex) == 0 and shown.sensors is None and (shown.parts == -1).all()
    assert len(shown.notes) == 1 and "no part of the surface is body" in shown.notes[0]
    assert shown.sensor_places(shown.vertices(slice(0, 1))[0], 0.0).shape == (0, 3)


def test_sensors_lie_on_the_posed_skin_or_above_it():
    shown = belly()
    vertices = shown.vertices(slice(5, 6))[0]
    on, above = (shown.sensor_places(vertices, height) for height in (0.0, 0.01))
    near = np.linalg.norm(on[:, None] - vertices[None], axis=-1).min(axis=1)
    assert len(on) > 200 and near.max() < 0.03
    assert np.allclose(np.linalg.norm(above - on, axis=1), 0.01)
    rest = shown.character.mesh.vertices
    on, above = (shown.sensor_places(rest, height) for height in (0.0, 0.01))
    near = np.linalg.norm(on[:, None] - rest[None], axis=-1).argmin(axis=1)
    assert (((above - on) * shown.normals[near]).sum(axis=1) > 0).mean() > 0.97, "outward"


# --- bones ----------------------------------------------------------------------------------------------------------


def test_a_skeleton_is_shown_by_bones_that_move_with_its_joints():
    shown = bare_walk()
    take = shown.take
    _, vertices = skeleton_mesh(take.actor.skeleton, take.positions[7:8], take.rotations[7:8])
    balls = len(take.actor.skeleton) * 18

    def ends(vertices):
        """Middles of the balls, and both tips of every bone: its four sides may be turned about it."""
        middles = vertices[:balls].reshape(-1, 18, 3).mean(axis=1)
        return np.concatenate([middles, vertices[balls:].reshape(-1, 6, 3)[:, [0, 5]].reshape(-1, 3)])

    assert shown.bare and np.abs(ends(shown.vertices(slice(7, 8))[0]) - ends(vertices[0])).max() < 1e-4
    rotations, positions = rest_pose(take.actor.skeleton)
    mesh, _ = skeleton_mesh(take.actor.skeleton, positions[None], rotations[None])
    assert np.allclose(bone_character(take.actor.skeleton).mesh.vertices, mesh.vertices)


def test_only_what_hangs_below_the_hips_is_drawn_as_bones():
    shown = belly()
    skeleton, hips = shown.take.actor.skeleton, shown.take.actor.humanoid.joints["hips"]
    drawn = stage.drawn_bones(shown)
    assert hips not in drawn and {skeleton.index("leftHand"), skeleton.index("head")} <= set(drawn.tolist())


# --- skin -----------------------------------------------------------------------------------------------------------


def test_four_influences_over_rigid_bones_move_the_embedded_human_exactly_enough():
    assert stage.rigid_skin(belly()).error < 1e-4


def test_a_joint_bound_in_two_ways_is_noticed():
    shown = belly()
    skin = shown.character.skin
    binds = skin.inverse_binds.copy()
    binds[skin.joints == shown.take.actor.skeleton.index("leftLowerArm"), :3, :3] *= 1.3
    odd = replace(shown, character=replace(shown.character, skin=replace(skin, inverse_binds=binds)))
    assert stage.rigid_skin(odd).error > 0.005


def test_the_strongest_influences_are_kept_and_sum_to_one():
    columns, weights = np.array([[3, 1, 2]]), np.array([[0.2, 0.5, 0.3]])
    kept, share = stage.strongest(columns, weights, 2)
    assert kept.tolist() == [[1, 2]] and np.allclose(share, [[0.625, 0.375]])
    kept, share = stage.strongest(columns, weights, 4)
    assert share.shape == (1, 4) and np.isclose(share.sum(), 1) and share[0, 3] == 0


def test_colours_come_from_the_faces_material():
    vertices, faces = box([0, 0, 0], [1, 1, 1])
    red, grey = Material("red", (1.0, 0.0, 0.0, 1.0)), Material("grey", (0.0, 0.0, 0.0, 1.0))
    of = np.zeros(len(faces), dtype=np.int64)
    assert (stage.vertex_colors(Mesh(vertices, faces, materials=(red, grey), face_materials=of)) == [255, 0, 0]).all()
    assert (stage.vertex_colors(Mesh(vertices, faces, materials=(red, grey), face_materials=of + 1)) == 0).all()


def test_a_textured_vertex_shows_its_texel():
    import io

    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], dtype=np.uint8)).save(file, "png")
    material = Material("two", (1.0, 1.0, 1.0, 1.0), file.getvalue())
    uvs = np.array([[0.1, 0.5], [0.9, 0.5], [0.1, 0.5]])
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), uvs, (material,))
    assert stage.vertex_colors(mesh).tolist() == [[255, 0, 0], [0, 0, 255], [255, 0, 0]]


def test_normals_are_smooth_over_seams_and_sharp_over_edges():
    vertices, faces = ball()
    split = Mesh(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))  # every face for itself
    normals = stage.smooth_vertex_normals(split)
    outward = split.vertices / np.linalg.norm(split.vertices, axis=1, keepdims=True)
    assert (normals * outward).sum(axis=1).min() > 0.98
    vertices, faces = box([0, 0, 0], [1, 1, 1])
    cube = Mesh(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))
    assert np.isclose(np.abs(stage.smooth_vertex_normals(cube)).max(axis=1), 1).all()


def test_sides_have_one_hue_and_all_parts_a_colour():
    colors = stage.part_colors()
    assert len(np.unique(colors, axis=0)) == len(PARTS)


# --- where bodies stand ---------------------------------------------------------------------------------------------


def test_bodies_stand_beside_each_other_the_first_on_the_right_or_in_one_place():
    both = [belly("heavy"), belly()]
    beside, over = stage.layout(both), stage.layout(both, overlaid=True)
    hips = [shown.take.joints(["hips"])[0, 0] for shown in both]
    places = np.array(hips) + beside
    assert places[0, 0] - places[1, 0] > 0.7 * both[0].take.actor.height, "facing +Z, the screen's right is +X"
    assert np.allclose(places.mean(axis=0)[[0, 2]], 0, atol=1e-6)
    assert np.allclose((np.array(hips) + over)[:, [0, 2]], 0, atol=1e-6)
    for shown, move in zip(both, beside):
        assert abs(shown.vertices(slice(0, 1))[0, :, 1].min() + move[1]) < 0.02, "soles are on the floor"


@pytest.mark.parametrize("angle", [0.0, 90.0, 200.0])
def test_facing_turns_with_the_body(angle):
    take = belly_take()
    shown = replace(belly(), take=Take(take.actor, turned(take.motion, np.radians(angle))))
    forward = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    assert stage.facing(shown) @ forward > 0.98


def test_the_camera_follows_the_walk_without_its_sway():
    shown = bare_walk()
    path, hips = stage.camera_path(shown), shown.take.joints(["hips"])[:, 0]
    assert path[-1, 2] - path[0, 2] > 0.7 * (hips[-1, 2] - hips[0, 2])
    assert np.ptp(path[:, 1]) < 1e-9
