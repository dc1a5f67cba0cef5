"""What the reader makes of a file: skeletons, rest poses, surfaces, clips, notes."""

import numpy as np
import pytest
from gltf_maker import Maker, turn, worm
from gltf_reference import Reference

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.errors import RetargetError
from retarget.io import gltf, load
from retarget.io.gltf_surface import triangles
from retarget.io.gltf_weights import merge_influences
from retarget.io.timeline import timeline


def loaded(m, tmp_path):
    return gltf.load(m.glb(tmp_path / "a.glb"))


def test_a_character(tmp_path):
    asset = load(worm(texture=True, clips=2).glb(tmp_path / "a.glb"))
    assert asset.kind == "character" and asset.notes == ()
    assert asset.character.skeleton.names == ("hips", "spine", "head") and asset.character.name == "a"
    assert asset.convention.up == "+y" and asset.convention.metres_per_unit == 1.0
    assert [(c.name, c.frames, c.fps) for c in asset.clips] == [("clip0", 5, 30.0), ("clip1", 5, 30.0)]
    assert asset.motion("clip1").name == "clip1" and len(asset.motion(1)) == 5
    with pytest.raises(RetargetError, match="clip 'clip9'"):
        asset.motion("clip9")
    material = asset.character.mesh.materials[0]
    assert material.base_color == (0.5, 1, 1, 1) and material.image.startswith(b"\x89PNG") and material.double_sided
    assert asset.character.mesh.uvs.shape == (54, 2)


def test_rest_pose_is_where_the_mesh_was_bound(tmp_path):
    straight = loaded(worm(), tmp_path)
    posed = loaded(worm(bound={1: turn("x", 70)}), tmp_path)
    assert any("bound in another pose" in note for note in posed.notes)
    tube_points = posed.character.mesh.vertices
    np.testing.assert_allclose(rest_vertices(posed.character), tube_points, atol=1e-6)
    np.testing.assert_allclose(tube_points, straight.character.mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(posed.character.skeleton.rest_rotations[1], turn("x", 70), atol=1e-6)
    np.testing.assert_allclose(posed.character.skeleton.offsets, straight.character.skeleton.offsets, atol=1e-6)
    # The root has turned since as well: the mesh still lies in the world where its data says.
    whole = loaded(worm(bound={0: turn("y", 0), 1: turn("x", 70)}), tmp_path).character
    np.testing.assert_allclose(whole.mesh.vertices, straight.character.mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(whole.skeleton.rest_rotations[0], turn("y", 0), atol=1e-6)
    np.testing.assert_allclose(whole.skeleton.rest_rotations[1], turn("x", 70), atol=1e-6)


def test_joints_that_move_are_listed(tmp_path):
    assert loaded(worm(), tmp_path).motion(0).moved == (0,)
    assert loaded(worm(stretchy=True), tmp_path).motion(0).moved == (0, 1)
    # Bound longer than the nodes stand: without any channel the joint is away from its rest position.
    m = worm(bound={1: turn("x", 70)})
    m.json["nodes"][2]["translation"] = [0, 0.75, 0]
    assert loaded(m, tmp_path).motion(0).moved == (0, 2)


def test_integers_are_normalised_as_specified(tmp_path):
    m = worm()
    cases = {"i1": ([-128, -127, 0, 127], 127), "i2": ([-32768, -32767, 0, 32767], 32767), "u1": ([0, 255, 51, 1], 255)}
    numbers = {}
    for dtype, (values, _) in cases.items():
        numbers[dtype] = m.accessor(values, dtype)
        m.json["accessors"][numbers[dtype]]["normalized"] = True
    document = loaded(m, tmp_path).character.origin.document
    for dtype, (values, top) in cases.items():
        expected = np.maximum(np.array(values) / top, -1)
        np.testing.assert_array_equal(document.floats(numbers[dtype], ("SCALAR",))[:, 0], expected)


def test_influences_take_the_form_that_gltf_wants():
    rng = np.random.default_rng(0)
    weights = rng.random((5000, 9)) * (rng.random((5000, 9)) < 0.6) + 0.1
    weights /= weights.sum(axis=1, keepdims=True)
    joints = rng.integers(0, 12, (5000, 9))
    merged, single = merge_influences(joints, weights)
    assert merged.shape == single.shape and merged.shape[1] % 4 == 0 and single.dtype == np.float32
    assert np.abs(single.sum(axis=1, dtype=float) - 1).max() < 3e-8
    for row in range(500):
        used = merged[row][single[row] > 0]
        assert len(set(used)) == len(used) and (merged[row][single[row] == 0] == 0).all()
        dense = np.bincount(joints[row], weights[row], 12)
        np.testing.assert_allclose(np.bincount(merged[row], single[row], 12), dense, atol=1e-6)


def test_scaled_nodes_become_lengths(tmp_path):
    m = worm(armature={"scale": [0.01] * 3, "rotation": turn("x", -90)}, joint_scale=3.0)
    asset = loaded(m, tmp_path)
    world = Reference(tmp_path / "a.glb").world()
    _, positions = rest_pose(asset.character.skeleton)
    np.testing.assert_allclose(positions, world[asset.character.origin.rig.nodes][:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(asset.character.skeleton.offsets[1:], axis=1), [0.007, 0.021])
    moved = asset.motion(0)
    np.testing.assert_allclose(moved.translations[0, 0], positions[0] + moved.translations[0, 0] - positions[0])


def test_uneven_scale_is_exact_at_rest_and_said(tmp_path):
    asset = loaded(worm(joint_scale=(1.0, 2.0, 1.0)), tmp_path)
    assert any("'spine', 'head'" in note and "scaled unevenly" in note for note in asset.notes)
    np.testing.assert_allclose(rest_vertices(asset.character), Reference(tmp_path / "a.glb").vertices(), atol=1e-5)


def test_scale_in_clips(tmp_path):
    for size, said in ((1.0, False), (1.3, True)):
        m = worm()
        clip = m.json["animations"][0]
        clip["samplers"].append({"input": clip["samplers"][0]["input"], "output": m.accessor(np.full((5, 3), size))})
        clip["channels"].append({"sampler": 3, "target": {"node": 1, "path": "scale"}})
        asset = loaded(m, tmp_path)
        assert any("'spine' is scaled by animations" in note for note in asset.notes) == said
        assert len(asset.motion(0)) == 5


def test_missing_inverse_binds_are_identities(tmp_path):
    asset = loaded(worm(inverse_binds=False), tmp_path)
    np.testing.assert_allclose(rest_vertices(asset.character), Reference(tmp_path / "a.glb").vertices(), atol=1e-5)
    np.testing.assert_allclose(asset.character.skeleton.offsets[1:], [[0, 0.7, 0]] * 2, atol=1e-9)


def test_equal_columns_of_several_skins_are_one(tmp_path):
    asset = loaded(worm(skins=3), tmp_path)
    assert len(asset.character.skin.joints) == 3 and len(asset.character.mesh.vertices) == 3 * 54


def test_meshes_that_hang_from_nothing_are_left_out(tmp_path):
    m = worm()
    m.add("nodes", {"name": "floor", "mesh": 0})
    m.json["scenes"][0]["nodes"].append(len(m.json["nodes"]) - 1)
    asset = loaded(m, tmp_path)
    assert any("'floor'" in note for note in asset.notes) and len(asset.character.mesh.vertices) == 54


def test_only_the_default_scene_is_read(tmp_path):
    m = worm(skins=2)
    body = m.json["scenes"][0]["nodes"].pop()
    m.add("scenes", {"nodes": [body], "name": "other"})
    asset = loaded(m, tmp_path)
    assert len(asset.character.mesh.vertices) == 54 and any("scenes" in note for note in asset.notes)


def test_morph_targets_count_at_their_default_weight(tmp_path):
    m = worm()
    m.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": m.accessor(np.full((54, 3), 0.5))}]
    plain = loaded(m, tmp_path).character.mesh.vertices
    m.json["meshes"][0]["weights"] = [0.5]
    np.testing.assert_allclose(loaded(m, tmp_path).character.mesh.vertices, plain + 0.25, atol=1e-6)


def test_double_and_missing_names(tmp_path):
    m = worm()
    m.json["nodes"][0].pop("name")
    m.json["nodes"][1]["name"] = m.json["nodes"][2]["name"] = "arm"
    assert loaded(m, tmp_path).character.skeleton.names == ("node_0", "arm", "arm_2")


def test_an_animated_armature_is_a_joint(tmp_path):
    for path, joints in (([0, 0, 0], 3), ([1, 0, 0], 4)):
        m = worm(armature={"rotation": turn("x", -90)})
        clip = m.json["animations"][0]
        clip["samplers"].append({"input": clip["samplers"][0]["input"], "output": m.accessor([path] * 5)})
        clip["channels"].append({"sampler": 3, "target": {"node": 3, "path": "translation"}})
        asset = loaded(m, tmp_path)
        assert len(asset.character.skeleton) == joints
        assert asset.character.skeleton.names[0] == ("Armature" if joints == 4 else "hips")


def test_rigid_parts_on_animated_nodes_are_a_character(tmp_path):
    m = Maker()
    part = {"attributes": {"POSITION": m.accessor([[0, 0, 0], [1, 0, 0], [0, 1, 0]])}}
    m.add("meshes", {"primitives": [part]})
    m.json["nodes"] = [
        {"name": "body", "mesh": 0, "children": [1, 2], "translation": [0, 1, 0]},
        {"name": "arm", "mesh": 0, "translation": [1, 0, 0], "scale": [2, 2, 2]},
        {"name": "socket"},
    ]
    times, values = m.accessor([0, 0.5]), m.accessor([turn("z", 0), turn("z", 90)])
    channels = [{"sampler": 0, "target": {"node": node, "path": "rotation"}} for node in (0, 1)]
    m.add("animations", {"samplers": [{"input": times, "output": values}], "channels": channels})
    asset = loaded(m, tmp_path)
    assert asset.kind == "character" and asset.character.skeleton.names == ("body", "arm", "socket")
    assert asset.clips[0].name == "clip_0" and asset.clips[0].frames == 16
    from retarget.body.skinning import skin_motion

    reference = Reference(tmp_path / "a.glb")
    expected = np.stack([reference.vertices(0, frame / 30) for frame in range(16)])
    np.testing.assert_allclose(skin_motion(asset.character, asset.motion(0)), expected, atol=1e-5)


def test_a_still_mesh(tmp_path):
    m = worm(clips=0)
    m.json["nodes"] = [{"mesh": 0, "scale": [-2, 2, 2], "translation": [1, 0, 0]}]
    m.json["scenes"] = [{"nodes": [0]}]
    del m.json["skins"]
    asset = loaded(m, tmp_path)
    assert asset.kind == "mesh" and asset.character is None
    np.testing.assert_allclose(asset.mesh.vertices, Reference(tmp_path / "a.glb").vertices(), atol=1e-6)
    corners = asset.mesh.vertices[asset.mesh.faces]
    volume = (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum()
    assert volume > 0, "a mirrored mesh keeps its outside outside"


def test_a_skeleton_alone(tmp_path):
    m = worm()
    del m.json["meshes"]
    m.json["nodes"] = m.json["nodes"][:3]
    m.json["scenes"][0]["nodes"] = [0]
    assert loaded(m, tmp_path).kind == "motion"
    del m.json["skins"], m.json["animations"]
    asset = loaded(m, tmp_path)
    assert asset.kind == "motion" and asset.clips == () and len(asset.character.skeleton) == 3
    with pytest.raises(RetargetError, match="no animation clip"):
        asset.motion()


def test_animations_of_something_else_are_no_clips(tmp_path):
    m = worm()
    m.json["animations"].append({"name": "empty", "channels": [], "samplers": []})
    asset = loaded(m, tmp_path)
    assert [clip.name for clip in asset.clips] == ["clip0"] and any("'empty'" in note for note in asset.notes)


def test_points_and_lines_are_left_out(tmp_path):
    m = worm()
    m.json["meshes"][0]["primitives"].append(
        {"attributes": m.json["meshes"][0]["primitives"][0]["attributes"], "mode": 1}
    )
    asset = loaded(m, tmp_path)
    assert len(asset.character.mesh.vertices) == 54 and any("lines" in note for note in asset.notes)


def test_primitives_that_share_vertices_share_them(tmp_path):
    m = worm(texture=True)
    first = m.json["meshes"][0]["primitives"][0]
    m.json["meshes"][0]["primitives"].append({"attributes": first["attributes"], "indices": first["indices"]})
    mesh = loaded(m, tmp_path).character.mesh
    assert len(mesh.vertices) == 54 and len(mesh.materials) == 2 and set(mesh.face_materials) == {0, 1}


def test_strips_and_fans():
    strip = triangles(np.array([0, 1, 2, 3, 4]), 5)
    assert strip.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert triangles(np.array([0, 1, 2, 3]), 6).tolist() == [[1, 2, 0], [2, 3, 0]]
    assert triangles(np.array([0, 1, 2, 2, 3]), 5).tolist() == [[0, 1, 2]]
    assert triangles(np.array([0, 1, 2, 3]), 4).tolist() == [[0, 1, 2]]
    assert triangles(np.array([0, 1]), 5).shape == (0, 3)


@pytest.mark.parametrize("fps", [24, 25, 30, 50, 60, 90, 100, 120, 240, 30000 / 1001, 24000 / 1001, 37.0, 12.5])
def test_key_times_tell_the_rate(fps):
    frames = 400
    grid = timeline((0.5 + np.arange(frames) / fps).astype(np.float32).astype(float))
    assert grid.fps == pytest.approx(fps if fps != 12.5 else 25.0) and grid.start == 0.5
    assert grid.frames == (frames if fps != 12.5 else 2 * frames - 1)


def test_rates_from_few_or_odd_keys():
    assert timeline(np.array([0.0, 1.0])).fps == 30.0
    assert timeline(np.array([0.0, 5 / 24])).fps == 24.0
    assert timeline(np.array([0.0, 0.033, 0.067, 0.1, 0.133])).fps == 30.0, "times rounded to milliseconds"
    odd = timeline(np.array([0.0, 0.0123, 0.4567, 1.0]))
    assert odd.fps == 30.0 and odd.frames == 31
    assert timeline(np.array([2.0])).frames == 1


def test_key_frames_are_hit_exactly(tmp_path):
    asset = loaded(worm(keys=9, fps=25.0), tmp_path)
    reference = Reference(tmp_path / "a.glb")
    keys = reference.accessor(reference.json["animations"][0]["samplers"][0]["output"])
    np.testing.assert_allclose(
        asset.motion(0).rotations[:, 1], keys / np.linalg.norm(keys, axis=1, keepdims=True), rtol=0, atol=1e-12
    )
