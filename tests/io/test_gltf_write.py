"""Appending leaves everything as it was; new files are valid; nothing is ever half-written."""

import json
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_maker import PNG, turn, worm
from gltf_reference import Reference

from retarget.body.kinematics import still_motion
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.character import Character, Material, Mesh, Motion, Skeleton, Skin
from retarget.errors import FileError, RetargetError
from retarget.io import gltf

VALIDATOR = Path(__file__).resolve().parents[2] / "tools" / "validate_gltf.mjs"


def errors_found(*paths):
    """Errors that the Khronos validator finds in each file; skips where Node or the validator is not installed."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    run = subprocess.run(["node", str(VALIDATOR), *map(str, paths)], capture_output=True, text=True, timeout=120)
    if run.returncode == 3:
        pytest.skip("the npm package gltf-validator is not installed")
    assert run.returncode == 0, run.stderr
    return [json.loads(line) for line in run.stdout.splitlines()]


def human_like():
    """A made-up character: two materials, a picture, more than four influences, weights over a column a joint."""
    points = np.random.default_rng(0).normal(size=(40, 3))
    faces = np.array([[i, (i + 1) % 40, (i + 7) % 40] for i in range(40)])
    skeleton = Skeleton(
        ("hips", "spine", "head"), np.array([-1, 0, 1]), np.array([[0, 1, 0], [0, 0.3, 0], [0, 0.3, 0.1]]),
        np.array([[0, 0, 0, 1], turn("x", 20), turn("z", 30)]),
    )  # fmt: skip
    materials = (Material("cloth", (0.2, 0.3, 0.4, 1.0)), Material("skin", (1.0, 1.0, 1.0, 0.5), PNG, True))
    mesh = Mesh(points, faces, points[:, :2], materials, np.arange(40) % 2)
    weights = np.random.default_rng(1).random((40, 6))
    weights[:10, 2:] = 0
    columns = np.random.default_rng(2).integers(0, 3, (40, 6))
    binds = np.linalg.inv(np.array([np.eye(4)] * 3) + np.array([np.diag([0.1, 0.2, 0.3, 0])]))
    skin = Skin(np.array([2, 0, 1]), binds, columns, weights / weights.sum(axis=1, keepdims=True))
    return Character(skeleton, mesh, skin, "doll")


def dance(skeleton, frames=7, name="dance", fps=25.0):
    rng = np.random.default_rng(3)
    rotations = rng.normal(size=(frames, len(skeleton), 4))
    return Motion(skeleton, rotations, rng.normal(size=(frames, 1, 3)), fps, name=name)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_appending_keeps_every_byte(suffix, tmp_path):
    m = worm(texture=True, sparse=True, prop=True, skins=2, extra=3)
    m.json["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
    m.json["extensionsUsed"] = ["KHR_materials_unlit"]
    m.json["nodes"][0]["extras"] = {"note": "kept", "deep": [{"x": None}]}
    target = m.accessor(np.zeros((54, 3)))
    m.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": target}]
    path = m.glb(tmp_path / "a.glb", chunks=[(0x4D455441, b"meta")])
    asset = gltf.load(path)
    gltf.save(tmp_path / f"b{suffix}", asset.character, [asset.motion(0), asset.motion(0)])
    old, new = Reference(path), Reference(tmp_path / f"b{suffix}")
    for key, value in old.json.items():
        if key == "asset":
            assert new.json[key] == {**value, "generator": "retarget"}
        elif key == "buffers":
            assert len(new.json[key]) == 1
        elif isinstance(value, list):
            assert new.json[key][: len(value)] == value, key
        else:
            assert new.json[key] == value, key
    assert (
        new.buffers[0][: old.json["buffers"][0]["byteLength"]] == old.buffers[0][: old.json["buffers"][0]["byteLength"]]
    )
    assert [a["name"] for a in new.json["animations"]] == ["clip0", "clip0_2", "clip0_3"]
    if suffix == ".glb":
        assert (tmp_path / "b.glb").read_bytes().endswith(struct.pack("<II", 4, 0x4D455441) + b"meta")
    assert not list(tmp_path.glob(".*"))


def test_clips_can_be_left_out(tmp_path):
    asset = gltf.load(worm(clips=3).glb(tmp_path / "a.glb"))
    gltf.save(tmp_path / "b.glb", asset.character, [asset.motion(1)], keep_clips=False)
    assert [clip.name for clip in gltf.load(tmp_path / "b.glb").clips] == ["clip1"]


def test_buffers_and_pictures_beside_the_source_come_along(tmp_path):
    source, target = tmp_path / "source", tmp_path / "target"
    (source / "tex").mkdir(parents=True)
    target.mkdir()
    m = worm()
    (source / "tex" / "my skin.png").write_bytes(PNG)
    m.add("images", {"uri": "tex/my%20skin.png"})
    m.add("textures", {"source": 0})
    m.add("materials", {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    m.json["meshes"][0]["primitives"][0]["material"] = 0
    asset = gltf.load(m.gltf(source / "a.gltf", uri="a.bin"))
    assert asset.character.mesh.materials[0].image == PNG
    for name in ("b.gltf", "b.glb"):
        gltf.save(target / name, asset.character, [asset.motion(0)])
        again = gltf.load(target / name)
        assert again.character.mesh.materials[0].image == PNG and len(again.clips) == 2
    assert sorted(str(p.relative_to(target)) for p in target.rglob("*") if p.is_file()) == [
        "b.bin",
        "b.glb",
        "b.gltf",
        "tex/my skin.png",
    ]
    # A different picture of the same name is another character's: it stays, ours goes beside it.
    (target / "tex" / "my skin.png").write_bytes(b"another")
    gltf.save(target / "c.gltf", asset.character, [asset.motion(0)])
    assert (target / "tex" / "my skin.png").read_bytes() == b"another"
    assert gltf.load(target / "c.gltf").character.mesh.materials[0].image == PNG


def test_a_file_may_be_written_over_itself(tmp_path):
    m = worm(texture=True)
    for path in (m.glb(tmp_path / "a.glb"), m.gltf(tmp_path / "b.gltf", uri="b.bin")):
        asset = gltf.load(path)
        expected = skin_motion(asset.character, asset.motion(0))
        gltf.save(path, asset.character, [asset.motion(0)])
        again = gltf.load(path)
        assert len(again.clips) == 2
        np.testing.assert_allclose(skin_motion(again.character, again.motion(1)), expected, atol=1e-5)


def test_several_buffers_stay_several(tmp_path):
    m = worm()
    extra = np.float32([[1, 2, 3]]).tobytes()
    (tmp_path / "first.bin").write_bytes(m.binary)
    (tmp_path / "second.bin").write_bytes(extra)
    m.json["buffers"] = [{"byteLength": len(m.binary), "uri": "first.bin"}, {"byteLength": 12, "uri": "second.bin"}]
    view = m.add("bufferViews", {"buffer": 1, "byteLength": 12})
    number = m.add("accessors", {"bufferView": view, "componentType": 5126, "count": 1, "type": "VEC3"})
    (tmp_path / "a.gltf").write_text(json.dumps(m.json))
    asset = gltf.load(tmp_path / "a.gltf")
    for name in ("b.glb", "b.gltf"):
        gltf.save(tmp_path / name, asset.character, [asset.motion(0)])
        assert Reference(tmp_path / name).accessor(number).tolist() == [[1, 2, 3]]


def test_a_new_file_holds_the_character(tmp_path):
    doll = human_like()
    motion = dance(doll.skeleton)
    gltf.save(tmp_path / "doll.glb", doll, [motion, still_motion(doll.skeleton)])
    asset = gltf.load(tmp_path / "doll.glb")
    assert asset.notes == () and [clip.name for clip in asset.clips] == ["dance", "rest"]
    again = asset.character
    assert again.skeleton.names == doll.skeleton.names
    np.testing.assert_allclose(skin_motion(again, asset.motion("dance")), skin_motion(doll, motion), atol=1e-5)
    np.testing.assert_allclose(rest_vertices(again), rest_vertices(doll), atol=1e-5)
    assert [m.name for m in again.mesh.materials] == ["cloth", "skin"]
    assert again.mesh.materials[1].image == PNG and again.mesh.materials[1].double_sided
    np.testing.assert_allclose(again.mesh.uvs, doll.mesh.uvs, atol=1e-6)
    order = np.argsort(doll.mesh.face_materials, kind="stable")
    np.testing.assert_array_equal(again.mesh.faces, doll.mesh.faces[order])
    assert asset.motion(0).fps == 25.0


def test_a_bare_skeleton_is_written_and_read(tmp_path):
    skeleton = human_like().skeleton
    gltf.save(tmp_path / "bare.glb", Character(skeleton), [dance(skeleton)])
    asset = gltf.load(tmp_path / "bare.glb")
    assert asset.kind == "motion"
    np.testing.assert_allclose(asset.character.skeleton.offsets, skeleton.offsets, atol=1e-6)
    np.testing.assert_allclose(asset.motion(0).translations, dance(skeleton).translations, atol=1e-6)


def test_large_meshes_get_wide_indices(tmp_path):
    doll = human_like()
    points = np.random.default_rng(0).normal(size=(70_000, 3))
    mesh = Mesh(points, np.array([[0, 1, 69_999]]))
    skin = Skin(np.array([0]), np.eye(4)[None], np.zeros((70_000, 1), int), np.ones((70_000, 1)))
    gltf.save(tmp_path / "big.glb", replace(doll, mesh=mesh, skin=skin))
    assert gltf.load(tmp_path / "big.glb").character.mesh.faces.tolist() == [[0, 1, 69_999]]


def test_normals_are_smooth_across_seams(tmp_path):
    """The same place twice (a texture seam) gets one normal, pointing outwards."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) - 0.5
    faces = np.array(
        [
            [0, 1, 3],
            [0, 3, 2],
            [4, 6, 7],
            [4, 7, 5],
            [0, 4, 5],
            [0, 5, 1],
            [2, 3, 7],
            [2, 7, 6],
            [0, 2, 6],
            [0, 6, 4],
            [1, 5, 7],
            [1, 7, 3],
        ]
    )
    mesh = Mesh(np.concatenate([corners, corners]), np.where(np.arange(12)[:, None] % 2, faces + 8, faces))
    skin = Skin(np.array([0]), np.eye(4)[None], np.zeros((16, 1), int), np.ones((16, 1)))
    gltf.save(tmp_path / "cube.glb", Character(human_like().skeleton, mesh, skin))
    reference = Reference(tmp_path / "cube.glb")
    normals = reference.accessor(reference.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    np.testing.assert_allclose(normals[:8], normals[8:], atol=1e-6)
    assert ((normals[:8] * corners).sum(axis=1) > 0.5).all()


def test_faults_are_written_repaired(tmp_path):
    m = worm()
    skin = m.json["skins"][0]
    flat = np.array([np.eye(4).T.ravel()] * 3)
    flat[:] = Reference(m.glb(tmp_path / "x.glb")).accessor(skin["inverseBindMatrices"])
    flat[1] = np.nan
    skin["inverseBindMatrices"] = m.accessor(np.zeros((3, 16)))
    start = m.json["bufferViews"][-1]["byteOffset"]
    m.binary[start : start + 192] = flat.astype("<f4").tobytes()
    weights = m.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    start = m.json["bufferViews"][m.json["accessors"][weights]["bufferView"]]["byteOffset"]
    m.binary[start : start + 48] = np.float32([[0, 0, 0, 0], [-1, 1, np.nan, 0], [2, 2, 0, 0]]).tobytes()
    m.json["accessors"][weights].pop("min"), m.json["accessors"][weights].pop("max")
    m.json["accessors"][-1].pop("min", None), m.json["accessors"][-1].pop("max", None)
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    assert len(asset.notes) == 4 and "inverse bind" in asset.notes[0]
    for phrase in ("negative or not numbers", "have no weights", "do not sum to one"):
        assert any(phrase in note for note in asset.notes), phrase
    np.testing.assert_allclose(rest_vertices(asset.character), Reference(tmp_path / "x.glb").vertices(), atol=1e-5)
    character = asset.character
    followed = character.skin.joints[character.skin.columns[0][character.skin.weights[0] > 0]]
    assert followed.tolist() == [0], "a vertex without weights follows the first joint"
    gltf.save(tmp_path / "b.glb", character, [asset.motion(0)])
    assert gltf.load(tmp_path / "b.glb").notes == ()
    shown = np.stack([Reference(tmp_path / "b.glb").vertices(1, k / 30) for k in range(5)])
    np.testing.assert_allclose(shown, skin_motion(asset.character, asset.motion(0)), atol=1e-5)
    assert errors_found(tmp_path / "b.glb") == [[]]


def test_a_clip_sets_whatever_the_others_set(tmp_path):
    """Players keep what a clip does not set: it must not come from the clip played before."""
    m = worm(stretchy=True, joint_scale=2.0)
    clip = m.json["animations"][0]
    clip["samplers"].append({"input": clip["samplers"][0]["input"], "output": m.accessor(np.full((5, 3), 3.0))})
    clip["channels"].append({"sampler": 4, "target": {"node": 1, "path": "scale"}})
    character = gltf.load(m.glb(tmp_path / "a.glb")).character
    moving = replace(dance(character.skeleton), moved=(0, 2), translations=np.ones((7, 2, 3)))
    gltf.save(tmp_path / "b.glb", character, [still_motion(character.skeleton, 4), moving])
    reference = Reference(tmp_path / "b.glb")
    for clip in reference.json["animations"][1:]:
        targets = {(c["target"]["node"], c["target"]["path"]): clip["samplers"][c["sampler"]] for c in clip["channels"]}
        assert set(targets) == {(j, "rotation") for j in range(3)} | {(j, "translation") for j in range(3)} | {
            (1, "scale")
        }
        assert (reference.accessor(targets[1, "scale"]["output"]) == 2.0).all()
    rest = reference.accessor(targets[1, "translation"]["output"])
    np.testing.assert_allclose(rest, [[0, 0.7, 0]] * 2, atol=1e-6)


def test_joints_scaled_to_nothing_stay_finite(tmp_path):
    m = worm()
    m.json["nodes"][1]["scale"] = [0, 0, 0]
    character = gltf.load(m.glb(tmp_path / "a.glb")).character
    gltf.save(tmp_path / "b.glb", character, [dance(character.skeleton)])
    gltf.save(tmp_path / "c.glb", character, [dance(character.skeleton)], animation_only=True)
    moving = replace(dance(character.skeleton), moved=(0, 2), translations=np.ones((7, 2, 3)))
    gltf.save(tmp_path / "d.glb", character, [moving])
    for name in ("b.glb", "c.glb", "d.glb"):
        assert gltf.load(tmp_path / name).motion(0).rotations.shape[1] == 3
    # What stands at a point has no place to keep: the node's own is written.
    pose = Reference(tmp_path / "d.glb").pose(1, 0.0)
    np.testing.assert_allclose(pose[2]["translation"], [0, 0.7, 0], atol=1e-6)


def test_inverse_binds_rounded_in_the_last_row_are_written_exactly(tmp_path):
    m = worm()
    number = m.json["skins"][0]["inverseBindMatrices"]
    start = m.json["bufferViews"][m.json["accessors"][number]["bufferView"]]["byteOffset"]
    m.binary[start + 60 : start + 64] = np.float32([0.9999999]).tobytes()
    asset = gltf.load(m.glb(tmp_path / "a.glb"))
    assert asset.notes == () and asset.character.skin.inverse_binds[0, 3, 3] == 1
    gltf.save(tmp_path / "b.glb", asset.character)
    reference = Reference(tmp_path / "b.glb")
    written = reference.accessor(reference.json["skins"][0]["inverseBindMatrices"])
    assert (written[:, [3, 7, 11, 15]] == [0, 0, 0, 1]).all()


def test_joints_placed_by_matrices_can_be_animated(tmp_path):
    asset = gltf.load(worm(as_matrix=True, joint_scale=1.5).glb(tmp_path / "a.glb"))
    assert asset.clips == ()
    motion = dance(asset.character.skeleton)
    gltf.save(tmp_path / "b.glb", asset.character, [motion])
    ours = skin_motion(asset.character, motion)
    shown = np.stack([Reference(tmp_path / "b.glb").vertices(0, k / 25) for k in range(7)])
    np.testing.assert_allclose(shown, ours, atol=1e-5)
    again = gltf.load(tmp_path / "b.glb")
    np.testing.assert_allclose(skin_motion(again.character, again.motion(0)), ours, atol=1e-5)


def test_refusals(tmp_path):
    doll = human_like()
    asset = gltf.load(worm().glb(tmp_path / "a.glb"))
    out = tmp_path / "out.glb"
    with pytest.raises(FileError, match="'.fbx'"):
        gltf.save(tmp_path / "out.fbx", doll)
    with pytest.raises(RetargetError, match="another skeleton"):
        gltf.save(
            out,
            asset.character,
            [dance(Skeleton(("a",), np.array([-1]), np.zeros((1, 3)), np.array([[0, 0, 0, 1.0]])))],
        )
    with pytest.raises(RetargetError, match="another skeleton"):
        gltf.save(out, replace(asset.character, skeleton=replace(asset.character.skeleton, names=("x", "y", "z"))))
    with pytest.raises(RetargetError, match="no frames"):
        gltf.save(out, doll, [dance(doll.skeleton, frames=0)])
    with pytest.raises(RetargetError, match="neither PNG nor JPEG"):
        spoilt = replace(doll.mesh, materials=(Material("x", image=b"GIF89a"),) * 2)
        gltf.save(out, replace(doll, mesh=spoilt))
    with pytest.raises(RetargetError, match="no faces"):
        gltf.save(out, replace(doll, mesh=Mesh(doll.mesh.vertices, np.zeros((0, 3), int))))
    with pytest.raises(RetargetError, match="two poses at once"):
        moved = doll.skin.inverse_binds.copy()
        moved[0, 0, 3] += 1
        gltf.save(out, replace(doll, skin=replace(doll.skin, joints=np.array([0, 0, 1]), inverse_binds=moved)))
    with pytest.raises(FileError, match="sheared"):
        m = worm(as_matrix=True)
        m.json["nodes"][1]["matrix"][4] = 0.5
        sheared = gltf.load(m.glb(tmp_path / "s.glb")).character
        gltf.save(out, sheared, [still_motion(sheared.skeleton)])
    with pytest.raises(FileError, match="JSON cannot express"):
        text = json.dumps(worm().json | {"extras": 0.125}).replace("0.125", "1e999")
        (tmp_path / "inf.gltf").write_text(
            text.replace('"asset"', f'"buffers": [{{"byteLength": {len(worm().binary)}, "uri": "w.bin"}}], "asset"', 1)
        )
        (tmp_path / "w.bin").write_bytes(worm().binary)
        gltf.save(out, gltf.load(tmp_path / "inf.gltf").character)
    with pytest.raises(FileError, match="cannot be written"):
        (tmp_path / "folder.glb").mkdir()
        gltf.save(tmp_path / "folder.glb", doll)
    assert not out.exists() and not list(tmp_path.glob(".*")), "nothing half-written"


def test_written_files_are_valid(tmp_path):
    doll = human_like()
    asset = gltf.load(worm(texture=True, armature={"scale": [0.01] * 3}, prop=True).glb(tmp_path / "a.glb"))
    paths = []
    for suffix in (".glb", ".gltf"):
        for name, character in (("new", doll), ("appended", asset.character), ("bare", Character(doll.skeleton))):
            for only in (False, True):
                paths.append(tmp_path / f"{name}_{only}{suffix}")
                gltf.save(
                    paths[-1],
                    character,
                    [dance(character.skeleton), still_motion(character.skeleton)],
                    animation_only=only,
                )
    found = errors_found(*paths)
    assert len(found) == len(paths) and not any(found), found
