"""What the reader shows and what the writer wrote, against the specification evaluated separately."""

import numpy as np
import pytest
from gltf_maker import turn, worm
from gltf_reference import Reference

from retarget.body.kinematics import still_motion, world_pose
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.io import gltf

CM = {"scale": [0.01] * 3, "rotation": turn("x", -90), "translation": [0.0, 0.5, 0.0]}
Z_UP_CM = np.array([[0.01, 0, 0, 0], [0, 0, 0.01, 0], [0, -0.01, 0, 0], [0, 0, 0, 1.0]])

DISGUISES = {
    "plain": {},
    "armature in centimetres, lying": {"armature": CM},
    "mirrored armature": {"armature": {"scale": [-1, -1, -1]}},
    "scaled joint": {"joint_scale": 1.7},
    "transformed mesh node": {"mesh_node": {"translation": [5, 6, 7], "scale": [3, 3, 3]}},
    "mesh in centimetres, z up": {"placed": Z_UP_CM},
    "all of these": {"armature": CM, "joint_scale": 0.5, "placed": Z_UP_CM, "mesh_node": {"translation": [9, 0, 0]}},
    "bound in another pose": {"bound": {1: turn("x", 70)}},
    "bound in another pose, scaled": {"bound": {1: turn("x", 70)}, "armature": CM, "placed": Z_UP_CM},
    "bound with another root": {"bound": {0: turn("y", 0), 1: turn("x", 0)}},
    "a joint that moves": {"stretchy": True, "mode": "CUBICSPLINE"},
    "node between joints": {"between": True},
    "two skins": {"skins": 2},
    "weights in bytes": {"weights_as": "u1"},
    "weights in shorts": {"weights_as": "u2", "joints_as": "u2"},
    "rotations in bytes": {"turns_as": "i1"},
    "rotations in shorts": {"turns_as": "i2"},
    "positions in shorts": {"positions_as": "i2", "placed": np.diag([0.01, 0.01, 0.01, 1.0])},
    "sparse": {"sparse": True},
    "interleaved": {"stride": 24},
    "eight influences": {"sets": 2},
    "steps": {"mode": "STEP", "fps": 12.0},
    "splines": {"mode": "CUBICSPLINE", "fps": 12.0},
    "lines between frames": {"fps": 12.0},
    "starts late": {"start": 1 / 30},
    "prop": {"prop": True},
    "prop on a scaled joint": {"prop": True, "joint_scale": 2.0, "armature": CM},
}


def shown(path, clip, motion, start=0.0, scales=True):
    reference = Reference(path)
    return np.stack([reference.vertices(clip, start + frame / motion.fps, scales) for frame in range(len(motion))])


@pytest.fixture(params=DISGUISES.values(), ids=DISGUISES.keys())
def disguise(request, tmp_path):
    return worm(**request.param).glb(tmp_path / "worm.glb"), request.param


def test_posed_vertices_are_those_of_the_specification(disguise):
    path, options = disguise
    asset = gltf.load(path)
    motion = asset.motion(0)
    # A step happens at its key: the single precision time of a key may lie just behind our frame.
    just_after = 1e-6 if options.get("mode") == "STEP" else 0.0
    expected = shown(path, 0, motion, options.get("start", 0.0) + just_after)
    np.testing.assert_allclose(skin_motion(asset.character, motion), expected, atol=2e-6 * np.abs(expected).max())


def test_what_is_appended_shows_our_motion(disguise, tmp_path):
    path, _ = disguise
    asset = gltf.load(path)
    motion = asset.motion(0)
    for suffix in (".glb", ".gltf"):
        out = tmp_path / f"out{suffix}"
        gltf.save(out, asset.character, [motion])
        ours = skin_motion(asset.character, motion)
        np.testing.assert_allclose(shown(out, 1, motion), ours, atol=4e-6 * np.abs(ours).max())
        again = gltf.load(out)
        assert [clip.name for clip in again.clips] == ["clip0", "clip0_2"]
        assert again.clips[1].frames == len(motion) and again.clips[1].fps == pytest.approx(motion.fps)
        assert again.notes == asset.notes


def test_written_anew_shows_the_same(disguise, tmp_path):
    from dataclasses import replace

    asset = gltf.load(disguise[0])
    motion = asset.motion(0)
    fresh = replace(asset.character, origin=None)
    gltf.save(tmp_path / "fresh.glb", fresh, [motion])
    ours = skin_motion(asset.character, motion)
    np.testing.assert_allclose(shown(tmp_path / "fresh.glb", 0, motion), ours, atol=4e-6 * np.abs(ours).max())
    again = gltf.load(tmp_path / "fresh.glb")
    assert again.character.skeleton.names == asset.character.skeleton.names
    np.testing.assert_allclose(again.character.skeleton.offsets, asset.character.skeleton.offsets, atol=1e-5)
    np.testing.assert_allclose(rest_vertices(again.character), rest_vertices(asset.character), atol=1e-5)


def test_animation_alone_moves_the_joints_the_same(disguise, tmp_path):
    asset = gltf.load(disguise[0])
    motion = asset.motion(0)
    gltf.save(tmp_path / "bare.glb", asset.character, [motion], animation_only=True)
    bare = gltf.load(tmp_path / "bare.glb")
    assert bare.kind == "motion" and bare.character.mesh is None
    assert "meshes" not in Reference(tmp_path / "bare.glb").json
    for ours, theirs in zip(world_pose(motion), world_pose(bare.motion(0))):
        np.testing.assert_allclose(np.abs(theirs), np.abs(ours), atol=1e-5)
    # At rest joints stand where the mesh was bound.
    for ours, theirs in zip(
        world_pose(still_motion(asset.character.skeleton)), world_pose(still_motion(bare.character.skeleton))
    ):
        np.testing.assert_allclose(np.abs(theirs), np.abs(ours), atol=1e-5)
