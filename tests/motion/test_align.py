"""Into the house's space and back: units, up axes, turns and scales."""

from dataclasses import replace

import numpy as np
import pytest
from made_motions import body, cast_by_names, stand, walk

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, still_motion, world_pose
from retarget.body.skinning import rest_vertices, skin_motion
from retarget.correspond.joints import humanoid_from_names
from retarget.errors import RetargetError
from retarget.io.asset import Convention
from retarget.motion.align import Similarity, body_height, facing_name, infer_unit, infer_up, make_actor, same_skeleton

Z_UP = Similarity(rot.from_rotation_vector(np.array([np.pi / 2, 0, 0])), 1.0)
"""From +Y up to +Z up."""
ODD = Similarity(rot.from_rotation_vector(np.array([0.3, -1.2, 0.7])), 37.0)


def humanoid(character):
    return humanoid_from_names(character.skeleton, {name: name for name in character.skeleton.names})


def actor_of(character, convention=None, motion=None, **hints):
    return make_actor(
        character, humanoid(character), convention, motion, rest_surface=rest_vertices(character), **hints
    )


def make_on(skeleton, motion):
    """The same rotations over another skeleton."""
    return replace(motion, skeleton=skeleton)


def lying(motion):
    """The motion on its back: the whole world tipped, in a file that still is +Y up."""
    return make_on(motion.skeleton, Z_UP.inverse().motion(motion))


def test_a_similarity_moves_joints_and_surface_alike():
    motion = stand()
    _, before = world_pose(motion)
    rotations, after = world_pose(ODD.motion(motion))
    assert np.abs(after - ODD.points(before)).max() < 1e-9
    _, rest = rest_pose(ODD.skeleton(motion.skeleton))
    assert np.abs(rest - ODD.points(rest_pose(motion.skeleton)[1])).max() < 1e-9
    large = ODD.character(body())
    assert np.abs(large.mesh.vertices - ODD.points(body().mesh.vertices)).max() < 1e-9
    posed, expected = skin_motion(large, ODD.motion(motion)), ODD.points(skin_motion(body(), motion).astype(float))
    assert np.abs(posed - expected).max() < 1e-3 * ODD.scale * 0.1


def test_there_and_back_again():
    motion = stand()
    back = ODD.inverse()
    again = back.motion(ODD.motion(motion))
    assert np.abs(world_pose(again)[1] - world_pose(motion)[1]).max() < 1e-12
    character = back.character(ODD.character(body()))
    assert np.abs(character.mesh.vertices - body().mesh.vertices).max() < 1e-12
    assert np.abs(character.skin.inverse_binds - body().skin.inverse_binds).max() < 1e-12
    assert np.abs(character.skeleton.offsets - body().skeleton.offsets).max() < 1e-12


def test_bone_ends_scale_without_turning():
    skeleton = body().skeleton
    for joint, end in ODD.skeleton(skeleton).end_offsets.items():
        assert np.allclose(end, skeleton.end_offsets[joint] * ODD.scale)


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.1, 0.001, 0.0254])
def test_the_unit_is_inferred_from_the_height(unit):
    found, why = infer_unit(1.7 / unit)
    assert found == pytest.approx(unit), why


def test_an_impossible_height_becomes_a_typical_body():
    found, why = infer_unit(3e6)
    assert found * 3e6 == pytest.approx(1.7) and "no known unit" in why


@pytest.mark.parametrize("tip", [None, Z_UP], ids=["y up", "z up"])
def test_the_up_axis_of_a_silent_file(tip):
    character = tip.character(body()) if tip else body()
    motion = tip.motion(walk()) if tip else walk()
    axis, _ = infer_up(humanoid(character), motion)
    assert np.allclose(axis, [0, 0, 1] if tip else [0, 1, 0])
    actor = actor_of(character, motion=motion)
    assert np.allclose(actor.humanoid.axes[1], [0, 1, 0], atol=0.1)
    assert actor.house_from_file.motion(motion).translations[:, 0, 1].min() > 0.5, "the hips are above the ground"


def test_a_rest_pose_that_lies_is_put_right_by_how_the_body_stands():
    laid = Z_UP.inverse().character(body())  # the rest pose lies on its back, but the clip stands
    standing = np.array([0.0, 1, 0])
    axis, why = infer_up(humanoid(laid), make_on(laid.skeleton, walk()))
    assert np.allclose(axis, standing) and "average" in why


def test_a_clip_that_lies_does_not_tip_a_file_that_says_where_up_is():
    motion = lying(stand())
    assert not np.allclose(infer_up(humanoid(body()), motion)[0], [0, 1, 0]), "a silent file would be turned"
    actor = actor_of(body(), Convention(1.0, "+y"), motion)
    assert np.allclose(actor.house_from_file.rotation, rot.IDENTITY)
    assert not [note for note in actor.notes if "up axis" in note]


def test_what_is_said_overrides_what_is_inferred():
    actor = actor_of(body(), None, walk(), up="-z", unit=2.0)
    assert actor.house_from_file.scale == 2.0
    assert np.allclose(rot.rotate(actor.house_from_file.rotation, np.array([0, 0, -1.0])), [0, 1, 0])


@pytest.mark.parametrize("unit", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_units_are_refused(unit):
    with pytest.raises(RetargetError, match="unit must be positive"):
        actor_of(body(), unit=unit)


def test_unknown_axes_are_refused():
    with pytest.raises(RetargetError, match=r"\+z"):
        actor_of(body(), up="up")


def test_centimetres_are_brought_to_metres_and_said_so():
    large = Similarity(rot.IDENTITY, 100.0).character(body())
    actor = actor_of(large)
    assert actor.height == pytest.approx(body_height(body().skeleton, humanoid(body()), body().mesh.vertices), rel=1e-6)
    assert any("cm" in note for note in actor.notes)
    assert actor_of(body(), Convention(1.0, "+y")).notes == ()


def test_the_height_of_a_skeleton_is_near_that_of_its_surface():
    character = body()
    bare = body_height(character.skeleton, humanoid(character))
    assert bare == pytest.approx(np.ptp(character.mesh.vertices[:, 1]), rel=0.05)


def test_facing_and_sameness():
    assert facing_name(cast_by_names(body()).humanoid.axes) == "+z"
    quarter = Similarity(rot.from_rotation_vector(np.array([0, np.pi / 2, 0])), 1.0).character(body())
    assert facing_name(cast_by_names(quarter).humanoid.axes) == "+x"
    assert same_skeleton(body().skeleton, still_motion(body().skeleton).skeleton)
    assert not same_skeleton(body().skeleton, body("heavy").skeleton)
