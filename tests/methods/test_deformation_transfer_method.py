"""The baseline as a method: its surface is the transfer's, its joints are those of that surface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_bodies import with_faces
from made_motions import actor, body, cast_by_names, fingerless, in_other_order, walk

from retarget import load
from retarget.body import rotations as rot
from retarget.body.kinematics import world_pose
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.errors import RetargetError
from retarget.methods import DeformationTransfer
from retarget.motion.align import Similarity
from retarget.motion.deformation_transfer import prepare_deformation_transfer
from retarget.motion.filter import cut
from retarget.motion.library import embedded_motion
from retarget.retargeting import prepare


@cache
def clip():
    return cut(embedded_motion("hands_on_hips"), 1.0, 1.3)


@cache
def retargeter(preset):
    return prepare(actor(), actor(preset), "deformation-transfer").retargeter


@cache
def moved(preset):
    return retargeter(preset)(clip())


def test_the_surface_is_the_transfers_own():
    rest = (rest_vertices(body(preset)) for preset in ("thin", "heavy"))
    expected = prepare_deformation_transfer(*rest, body().mesh.faces).frames(skin_motion(body(), clip()))
    assert np.abs(moved("heavy").surface.vertices - expected).max() < 1e-5
    assert moved("heavy").surface.fps == moved("heavy").motion.fps == clip().fps


def test_the_same_body_keeps_surface_and_joints():
    assert np.abs(moved("thin").surface.vertices - skin_motion(body(), clip())).max() < 1e-3
    (world, places), (found, at) = world_pose(clip()), world_pose(moved("thin").motion)
    assert np.degrees(rot.angle_between(world, found)).max() < 1.0
    assert np.linalg.norm(places - at, axis=-1).max() < 0.005


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_the_skin_lies_near_the_surface(preset):
    away = np.linalg.norm(skin_motion(body(preset), moved(preset).motion) - moved(preset).surface.vertices, axis=-1)
    assert np.sqrt((away**2).mean()) < 0.01 and away.max() < 0.05
    assert moved(preset).stats["skin_worst_mm"] == pytest.approx(1000 * away.max(), abs=0.01)


def test_joint_lengths_are_the_targets_own():
    _, places = world_pose(moved("child").motion)
    skeleton = body("child").skeleton
    lengths = np.linalg.norm(places - places[:, skeleton.parents], axis=-1)[:, 1:]
    assert np.abs(lengths - np.linalg.norm(skeleton.offsets[1:], axis=1)).max() < 1e-9


def test_a_walk_goes_as_far_as_the_body_is_high():
    motion = cut(walk(), 0.0, 1.0)
    ways = [
        world_pose(each)[1][-1, 0] - world_pose(each)[1][0, 0] for each in (motion, retargeter("child")(motion).motion)
    ]
    assert np.linalg.norm(ways[1]) / np.linalg.norm(ways[0]) == pytest.approx(
        actor("child").height / actor().height, rel=0.03
    )


def test_stepping_is_the_clip():
    for frame in (0, 5):
        pose = retargeter("heavy").step(clip().pose(frame))
        assert rot.angle_between(pose.rotations, moved("heavy").motion.rotations[frame]).max() < 1e-6
        assert np.abs(pose.translations - moved("heavy").motion.translations[frame]).max() < 1e-6


def test_a_target_whose_joints_come_in_another_order():
    target, order = in_other_order(body("heavy"), seed=2)
    names = {name: name for name in body().skeleton.names}
    result = prepare(actor(), cast_by_names(target, names), DeformationTransfer()).retargeter(clip())
    assert np.abs(result.surface.vertices - moved("heavy").surface.vertices).max() < 1e-5
    gap = rot.angle_between(world_pose(result.motion)[0], world_pose(moved("heavy").motion)[0][:, order])
    assert np.degrees(gap).max() < 0.5


def test_other_faces_and_missing_surfaces_are_refused():
    bare = cast_by_names(replace(body(), mesh=None, skin=None))
    with pytest.raises(RetargetError, match="the source has no surface"):
        prepare(bare, actor(), "deformation-transfer")
    with pytest.raises(RetargetError, match="the target has no surface"):
        prepare(actor(), bare, "deformation-transfer")
    fewer = cast_by_names(with_faces(body("heavy"), body().mesh.faces[:-1]))
    with pytest.raises(RetargetError, match="the same faces; the source has 13762 over 6883.*the target 13761"):
        prepare(actor(), fewer, "deformation-transfer")
    mixed = cast_by_names(with_faces(body("heavy"), body().mesh.faces[::-1]))
    with pytest.raises(RetargetError, match="in another order"):
        prepare(actor(), mixed, "deformation-transfer")


def test_foreign_motions_are_refused():
    with pytest.raises(RetargetError, match="another skeleton"):
        retargeter("heavy")(fingerless(clip()))
    none = replace(clip(), rotations=clip().rotations[:0], translations=clip().translations[:0])
    with pytest.raises(RetargetError, match="no frames"):
        retargeter("heavy")(none)
    with pytest.raises(RetargetError, match="the pose has 22 joints"):
        retargeter("heavy").step(fingerless(clip()).pose(0))


def test_results_are_files(tmp_path):
    result = prepare(actor(), actor("child"), "deformation-transfer")(clip())
    result.save(tmp_path / "made.glb")
    result.save_surface(tmp_path / "made.npz")
    assert len(load(tmp_path / "made.glb").motion()) == len(clip())
    assert np.abs(load(tmp_path / "made.npz").sequence.vertices - result.surface.vertices).max() < 1e-5


def test_the_surface_comes_in_the_files_unit_and_axes():
    """A target whose file is in centimetres with +Z up: the method's own surface and a skin's are led back alike."""
    house_from_file = Similarity(rot.from_rotation_vector(np.array([-np.pi / 2, 0, 0])), 0.01)
    own = replace(moved("heavy"), target=replace(actor("heavy"), house_from_file=house_from_file))
    metres = moved("heavy").surface.vertices
    expected = 100 * np.stack([metres[..., 0], -metres[..., 2], metres[..., 1]], axis=-1)
    assert np.abs(own.file_surface.vertices - expected).max() < 1e-3
    assert np.abs(own.file_surface.mesh.vertices - expected[0]).max() < 1e-3
    skinned = replace(own, surface=None).file_surface.vertices
    assert 0.01 < np.abs(skinned - expected).max() < 5, "what the skin makes of the motion, in the same place"
    bare = replace(own, surface=None, target=cast_by_names(replace(body("heavy"), mesh=None, skin=None)))
    with pytest.raises(RetargetError):
        _ = bare.file_surface
