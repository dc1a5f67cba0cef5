"""`retarget convert`: the same motion and body in another file, in the space that its format demands."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, fingerless, scaled, stand, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Character, Motion, Skeleton
from retarget.io import load, save
from retarget.motion.align import Similarity


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A walk in metres, the same in centimetres with +Z up, a body with two clips, a surface, a cloud, a stick."""
    folder = tmp_path_factory.mktemp("made")
    save(folder / "walk.bvh", fingerless(body()), [fingerless(walk())])
    up = Similarity(rot.from_rotation_vector(np.array([np.pi / 2, 0, 0])), 100.0)
    save(folder / "cm_z.bvh", fingerless(body()), [up.motion(fingerless(walk()))])
    clips = [replace(fingerless(walk()), name="one"), replace(fingerless(stand()), name="two")]
    save(folder / "two.glb", fingerless(body()), clips)
    save(folder / "still.glb", fingerless(body()), [])
    (folder / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "cloud.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    stick = Skeleton(("a", "b"), np.array([-1, 0]), np.array([[0.0, 1, 0], [0, 1, 0]]), np.tile(rot.IDENTITY, (2, 1)))
    turning = Motion(stick, np.tile(rot.IDENTITY, (3, 2, 1)), np.array([[[0.0, 1, z]] for z in range(3)]))
    save(folder / "stick.bvh", Character(stick), [turning])
    return folder


def by_name(motion):
    """Joint positions, joints in the order of their names: formats list them in their own."""
    return world_pose(motion)[1][:, np.argsort(motion.skeleton.names)]


def places(path, clip=None):
    motion = load(path).motion(clip)
    return by_name(motion), motion


def test_bvh_becomes_gltf_in_metres_with_y_up_as_its_body_shows(made, tmp_path, command):
    code, out, err = command("convert", made / "cm_z.bvh", tmp_path / "o.glb")
    assert (code, err) == (0, "") and "up axis +z" in out and "unit: cm" in out
    found, motion = places(tmp_path / "o.glb")
    assert np.abs(found - by_name(fingerless(walk()))).max() < 1e-5
    assert motion.name == "cm_z" and motion.fps == pytest.approx(30)


def test_what_is_given_counts_more_than_what_is_shown(made, tmp_path, command):
    code, out, err = command("convert", made / "cm_z.bvh", tmp_path / "o.glb", "--unit", "0.02", "--up", "+z")
    assert (code, err, len(out.splitlines())) == (0, "", 1)  # nothing was inferred
    assert np.abs(places(tmp_path / "o.glb")[0] - 2 * by_name(fingerless(walk()))).max() < 1e-5


def test_a_skeleton_that_shows_nothing_needs_both(made, tmp_path, command):
    code, out, err = command("convert", made / "stick.bvh", tmp_path / "o.glb")
    assert code == 2 and "does not tell its space, and its body does not show it; give --up and --unit" in err
    assert not list(tmp_path.iterdir())
    code, out, err = command("convert", made / "stick.bvh", tmp_path / "o.glb", "--up", "+z", "--unit", "0.5")
    assert (code, err) == (0, "")
    assert places(tmp_path / "o.glb")[0][2, 0] == pytest.approx([0, 1, -0.5])


def test_bvh_keeps_the_space_of_the_file(made, tmp_path, command):
    assert command("convert", made / "cm_z.bvh", tmp_path / "o.bvh")[0] == 0
    assert np.abs(places(tmp_path / "o.bvh")[0] - places(made / "cm_z.bvh")[0]).max() < 1e-4
    assert command("convert", made / "cm_z.bvh", tmp_path / "m.bvh", "--unit", "0.01", "--up", "+z")[0] == 0
    assert np.abs(places(tmp_path / "m.bvh")[0] - by_name(fingerless(walk()))).max() < 1e-5


def test_there_and_back(made, tmp_path, command):
    assert command("convert", made / "walk.bvh", tmp_path / "a.glb")[0] == 0
    code, out, err = command("convert", tmp_path / "a.glb", tmp_path / "b.bvh", "--json")
    report = json.loads(out)
    assert report["files"] == [
        {"output": str(tmp_path / "b.bvh"), "clips": [{"name": "walk", "frames": 90, "fps": 30.0}]}
    ]
    assert np.abs(places(tmp_path / "b.bvh")[0] - places(made / "walk.bvh")[0]).max() < 1e-5


def test_a_gltf_character_comes_through_with_all_its_clips(made, tmp_path, command):
    assert command("convert", made / "two.glb", tmp_path / "o.gltf")[0] == 0
    before, after = load(made / "two.glb"), load(tmp_path / "o.gltf")
    assert [clip.name for clip in after.clips] == ["one", "two"] and (tmp_path / "o.bin").exists()
    for clip in ("one", "two"):
        skins = [
            prepare_skinning(asset.character).vertices(*world_pose(asset.motion(clip))) for asset in (before, after)
        ]
        assert np.array_equal(*skins)


def test_one_clip_and_another_frame_rate(made, tmp_path, command):
    code, out, err = command("convert", made / "two.glb", tmp_path / "o.glb", "--clip", "two", "--fps", "60")
    assert (code, err) == (0, "") and "'two': 89 frames at 60 fps" in out
    asset = load(tmp_path / "o.glb")
    assert [(clip.name, clip.frames, clip.fps) for clip in asset.clips] == [("two", 89, 60.0)]
    assert np.abs(places(tmp_path / "o.glb")[0][::2] - places(made / "two.glb", "two")[0]).max() < 1e-5


def test_a_file_for_each_clip(made, tmp_path, command):
    code, out, err = command("convert", made / "two.glb", tmp_path / "new" / "k_{clip}.bvh")
    assert (code, err, len(out.splitlines())) == (0, "", 2)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["k_one.bvh", "k_two.bvh"]
    assert np.abs(places(tmp_path / "new" / "k_two.bvh")[0] - places(made / "two.glb", "two")[0]).max() < 1e-5
    assert command("convert", made / "two.glb", tmp_path / "{clip}.glb")[0] == 0
    assert [clip.name for clip in load(tmp_path / "two.glb").clips] == ["two"]


def test_a_character_in_another_unit_keeps_its_skin(made, tmp_path, command):
    big = scaled(fingerless(body()), 100.0)
    save(tmp_path / "big.glb", big, [scaled(fingerless(walk()), 100.0)])
    assert command("convert", tmp_path / "big.glb", tmp_path / "o.glb", "--unit", "0.01")[0] == 0
    asset, clip = load(tmp_path / "o.glb"), fingerless(walk())
    found = prepare_skinning(asset.character).vertices(*world_pose(asset.motion(0)))
    true = prepare_skinning(fingerless(body())).vertices(*world_pose(clip))
    assert np.abs(found[40].max(axis=0) - true[40].max(axis=0)).max() < 1e-4
    assert np.abs(found[40].min(axis=0) - true[40].min(axis=0)).max() < 1e-4


def test_surfaces_and_clouds(made, tmp_path, command):
    code, out, err = command("convert", made / "bare.obj", tmp_path / "o.ply")
    assert (code, err) == (0, "") and "3 vertices" in out
    assert load(tmp_path / "o.ply").mesh.faces.tolist() == [[0, 1, 2]]
    assert command("convert", made / "bare.obj", tmp_path / "mm.obj", "--unit", "0.5", "--up", "+z")[0] == 0
    assert load(tmp_path / "mm.obj").mesh.vertices == pytest.approx(np.array([[0, 0, 0], [0.5, 0, 0], [0, 0, -0.5]]))
    code, out, err = command("convert", made / "cloud.obj", tmp_path / "c.ply")
    assert (code, err) == (0, "") and "3 points" in out


@pytest.mark.parametrize(
    "words, said",
    [
        (["two.glb", "o.bvh"], "holds 2 clips ('one', 'two'), and .bvh holds one; choose one with --clip NAME, or write a file each: '"),
        (["two.glb", "o.bvh", "--clip", "on"], "nearest: 'one'"),
        (["still.glb", "o.bvh"], "holds no animation, and .bvh cannot be without"),
        (["still.glb", "{clip}.glb"], "still.glb: holds no animation"),
        (["two.glb", "two.glb"], "two.glb: is the file that is read; name another"),
        (["two.glb", "link.glb"], "link.glb: is the file that is read; name another"),
        (["one.glb", "{clip}.glb"], "one.glb: is the file that is read; name another"),
        (["two.glb", "folder"], "is a folder; name a file in it, or folder/{clip}.bvh for a file each clip"),
        (["two.glb", "{clip}/o.bvh"], "{clip} stands in the name of a file, not of a folder"),
        (["two.glb", "nowhere/o.glb"], "the folder nowhere does not exist"),
        (["two.glb", "two.glb/{clip}.bvh"], "cannot be made a folder: File exists"),
        (["two.glb", "o.xyz"], "cannot write '.xyz'; use .bvh"),
        (["two.glb", "o"], "holds 2 clips ('one', 'two'), a mesh sequence one; choose one with --clip NAME"),
        (["two.glb", "o.obj"], "is for still surfaces, but two.glb holds an animated body"),
        (["still.glb", "o.ply"], "is for still surfaces, but still.glb holds a body with a skeleton"),
        (["bare.obj", "o.glb"], "bare.obj holds a mesh without skeleton, which is written as .obj or .ply; a .glb needs a skeleton"),
        (["cloud.obj", "o2.obj"], "cloud.obj holds points without faces; write them as .ply"),
        (["bare.obj", "o.ply", "--fps", "30"], "holds no animation: --clip and --fps do not apply"),
        (["bare.obj", "{clip}.ply"], "holds no animation: {clip} does not apply"),
        (["two.glb", "o.glb", "--fps", "0"], "frame rate must be positive"),
        (["two.glb", "o.glb", "--unit", "-1"], "unit must be positive metres per unit"),
        (["two.glb", "o.glb", "--up", "y"], "up axis 'y' is unknown"),
        (["nothing.glb", "o.glb"], "nothing.glb: no such file"),
        (["split.gltf", "other.gltf"], "would replace other.bin, which split.gltf reads; name another"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_line_and_writes_nothing(made, tmp_path, monkeypatch, command, words, said):
    for path in made.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.glb").symlink_to("two.glb")
    save(tmp_path / "one.glb", fingerless(body()), [replace(fingerless(stand()), name="one")])
    save(tmp_path / "other.gltf", fingerless(body()), [])
    (tmp_path / "split.gltf").write_bytes((tmp_path / "other.gltf").read_bytes())
    monkeypatch.chdir(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    code, out, err = command("convert", *words)
    assert (code, out) == (2, "") and said in err and len(err.splitlines()) == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before
