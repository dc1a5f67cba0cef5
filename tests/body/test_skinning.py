"""Linear blend skinning: the rest pose skins to rest, and a frame agrees with the sum written out."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import joint_transforms, still_motion, world_pose
from retarget.body.skinning import prepare_skinning, rest_vertices, skin_motion
from retarget.character import Character
from retarget.errors import RetargetError
from retarget.motion.align import Similarity


def few(motion, count=3):
    return replace(motion, rotations=motion.rotations[::31][:count], translations=motion.translations[::31][:count])


def test_the_rest_pose_skins_to_rest():
    assert np.abs(skin_motion(body(), still_motion(body().skeleton))[0] - body().mesh.vertices).max() < 1e-6
    assert np.abs(rest_vertices(body("heavy")) - body("heavy").mesh.vertices).max() < 1e-6


def test_a_frame_agrees_with_the_sum_written_out():
    motion, character = few(walk()), body()
    T = joint_transforms(*world_pose(motion))
    skin, mesh = character.skin, character.mesh
    homogeneous = np.append(mesh.vertices, np.ones((len(mesh.vertices), 1)), axis=1)
    posed = skin_motion(character, motion)
    for vertex in range(0, len(mesh.vertices), 500):
        expected = sum(
            weight * (T[:, skin.joints[c]] @ skin.inverse_binds[c] @ homogeneous[vertex])
            for c, weight in zip(skin.columns[vertex], skin.weights[vertex])
        )
        assert np.abs(posed[:, vertex] - expected[:, :3]).max() < 1e-6


def test_turning_all_turns_the_surface():
    motion = few(walk())
    turn = Similarity(rot.from_rotation_vector(np.array([0.4, 1.0, -0.3])), 1.0)
    turned = replace(motion, rotations=turn.motion(motion).rotations, translations=turn.motion(motion).translations)
    assert np.abs(skin_motion(body(), turned) - turn.points(skin_motion(body(), motion).astype(float))).max() < 1e-5


def test_frames_do_not_depend_on_their_neighbours():
    skinner, motion = prepare_skinning(body()), few(walk())
    rotations, places = world_pose(motion)
    tiled = skinner.vertices(np.tile(rotations, (12, 1, 1)), np.tile(places, (12, 1, 1)))  # more than one block
    assert np.array_equal(tiled.reshape(12, 3, -1, 3), np.broadcast_to(tiled[:3], (12, *tiled[:3].shape)))


def test_a_bare_skeleton_has_no_surface():
    with pytest.raises(RetargetError, match="no skin"):
        prepare_skinning(Character(body().skeleton, name="bones"))
