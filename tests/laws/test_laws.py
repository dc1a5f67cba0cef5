"""What every method must obey: each law runs for each method that promises it."""

import inspect
from dataclasses import fields, replace
from functools import cache, partial

import numpy as np
import pytest
from made_motions import (
    actor,
    body,
    cast_by_names,
    in_other_order,
    mirrored,
    prepared,
    scaled,
    stand,
    turned,
    walk,
    with_vertices_permuted,
)

from retarget.body import rotations as rot
from retarget.body.kinematics import local_positions, world_pose
from retarget.body.skinning import skin_motion
from retarget.evaluate.cases import arms_turned, in_other_rest_pose, with_other_joint_axes
from retarget.methods import METHODS
from retarget.methods.base import LAWS
from retarget.motion.align import Similarity
from retarget.motion.filter import cut
from retarget.retargeting import prepare


def law(name):
    """Run a test for every method that promises the law, with and without looking ahead where the method can do both."""
    assert name in LAWS
    cases = []
    for method, kind in METHODS.items():
        if name in kind.laws:
            looking = {"foot_lock", "steady"} & {field.name for field in fields(kind)}
            for ahead in (True, False) if looking else (True,):
                settings = dict.fromkeys(sorted(looking), ahead)
                cases.append(pytest.param(partial(kind, **settings), id=f"{method}-{ahead}"))
    return pytest.mark.parametrize("make", cases)


def perform(make, motion, target, source=None):
    """The motion retargeted from the thin human onto a target actor."""
    return prepared(source or actor(), target, make())(motion).motion


@cache
def walked(method, preset):
    """The walk on another embedded body: what a changed input is compared with."""
    return prepared(actor(), actor(preset), method)(walk()).motion


def surface(character, motion):
    """Posed vertices on a few frames."""
    few = slice(None, None, 15)
    return skin_motion(
        character, replace(motion, rotations=motion.rotations[few], translations=motion.translations[few])
    )


def joint_gap(motion, expected):
    """Largest distance between the joints of two motions, metres."""
    return float(np.abs(world_pose(motion)[1] - world_pose(expected)[1]).max())


def turn_gap(motion, expected):
    """Largest angle between the world rotations of two motions, degrees."""
    return float(np.degrees(rot.angle_between(world_pose(motion)[0], world_pose(expected)[0]).max()))


def test_every_promised_law_exists_and_is_tested():
    tested = inspect.getsource(inspect.getmodule(law))
    for name in LAWS:
        assert f'@law("{name}")' in tested, f"no test for {name!r}"
    for name, method in METHODS.items():
        assert method.laws <= LAWS, name


@law("same body, same motion")
def test_same_body_same_motion(make):
    free = "False" in repr(make())
    for motion in (walk(), stand()) if free else (stand(),):
        same = perform(make, motion, actor())
        assert joint_gap(same, motion) < (1e-9 if free else 0.01)
        assert turn_gap(same, motion) < (1e-6 if free else 1.5)
        assert len(same) == len(motion) and same.fps == motion.fps and same.name == motion.name


@law("turning the world turns the result")
@pytest.mark.parametrize("angle", [1.1, -2.5])
def test_turning_the_world_turns_the_result(make, angle):
    plain = walked(make(), "heavy")
    moved = perform(make, turned(walk(), angle), actor("heavy"))
    assert joint_gap(moved, turned(plain, angle)) < 1e-5


@law("turning the world turns the result")
def test_the_way_the_source_faces_at_rest_does_not_matter(make):
    around = Similarity(rot.from_rotation_vector(np.array([0.0, 2.0, 0.0])), 1.0)
    moved = perform(make, around.motion(walk()), actor("heavy"), cast_by_names(around.character(body())))
    assert joint_gap(moved, turned(walked(make(), "heavy"), 2.0)) < 1e-5


@law("scaling both bodies scales the path")
@pytest.mark.parametrize("factor", [0.5, 1.7])
def test_scaling_both_bodies_scales_the_path(make, factor):
    source, target = (cast_by_names(scaled(body(name), factor)) for name in ("thin", "child"))
    large = perform(make, scaled(walk(), factor), target, source)
    small = walked(make(), "child")
    assert joint_gap(large, scaled(small, factor)) < 1e-3 * factor
    assert turn_gap(large, small) < 0.5


@law("scaling both bodies scales the path")
def test_a_target_of_twice_the_size_goes_twice_as_far(make):
    motion = walk()
    large = perform(make, motion, cast_by_names(scaled(body(), 2.0)))
    way = world_pose(large)[1][-1, 0] - world_pose(large)[1][0, 0]
    expected = motion.translations[-1, 0] - motion.translations[0, 0]
    assert np.abs(way - 2 * expected).max() < 0.005 * np.linalg.norm(way)


@law("mirrored in, mirrored out")
@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_mirrored_in_mirrored_out(make, preset):
    plain = walked(make(), preset)
    assert joint_gap(perform(make, mirrored(walk()), actor(preset)), mirrored(plain)) < 1e-5


@law("equal results for equal input")
def test_equal_input_gives_equal_bits(make):
    motion = cut(walk(), 0.0, 1.0)
    first, second = (prepare(actor(), actor("muscular"), make())(motion).motion for _ in range(2))
    assert np.array_equal(first.rotations, second.rotations)
    assert np.array_equal(first.translations, second.translations)


@law("stepping equals the clip")
@pytest.mark.parametrize("settings", [{}, {"in_place": True}], ids=["on its path", "in place"])
def test_stepping_equals_the_clip(make, settings):
    method = make()
    if getattr(method, "foot_lock", False):
        pytest.skip("looks ahead: not causal")
    settings = {name: value for name, value in settings.items() if hasattr(method, name)}
    retargeter = prepare(actor(), actor("heavy"), replace(method, **settings)).retargeter
    motion = cut(walk(), 1.0, 1.6)
    clip = retargeter(motion).motion
    for frame in range(len(motion)):
        pose = retargeter.step(motion.pose(frame))
        assert np.abs(np.abs((pose.rotations * clip.rotations[frame]).sum(axis=-1)) - 1).max() < 1e-9
        assert np.abs(pose.translations - clip.translations[frame]).max() < 1e-9


@law("permuting vertices permutes the result")
def test_permuting_vertices_permutes_the_result(make):
    mixed, order = with_vertices_permuted(body("heavy"), seed=3)
    plain = surface(body("heavy"), walked(make(), "heavy"))
    posed = surface(mixed, perform(make, walk(), cast_by_names(mixed)))
    assert np.abs(posed - plain[:, order]).max() < 1e-5


def elbows_bent():
    return {"leftLowerArm": np.array([0.0, -0.7, 0.0]), "rightLowerArm": np.array([0.0, 0.9, 0.0])}


SAME_LOOKING = {
    "other axes": lambda character: with_other_joint_axes(character, seed=5),
    "T rest": lambda character: in_other_rest_pose(character, arms_turned(-35.0)),
    "arms-down rest": lambda character: in_other_rest_pose(character, arms_turned(30.0)),
    "bent elbows, other axes": lambda character: in_other_rest_pose(with_other_joint_axes(character, 2), elbows_bent()),
}


@law("names, order and axes of joints and the rest pose do not matter")
@pytest.mark.parametrize("change", SAME_LOOKING.values(), ids=list(SAME_LOOKING))
def test_axes_and_rest_pose_of_the_target_do_not_show(make, change):
    target = change(body("heavy"))
    plain = surface(body("heavy"), walked(make(), "heavy"))
    posed = surface(target, perform(make, walk(), cast_by_names(target)))
    assert np.abs(posed - plain).max() < 1e-3


@law("names, order and axes of joints and the rest pose do not matter")
def test_axes_and_rest_pose_of_the_source_do_not_show(make):
    source = with_other_joint_axes(body(), seed=8)
    motion = with_axes_of(source, walk())
    assert joint_gap(motion, walk()) < 1e-9, "the rolled source moves as the plain one"
    rolled = perform(make, motion, actor("child"), cast_by_names(source))
    assert joint_gap(rolled, walked(make(), "child")) < 2e-4


def with_axes_of(character, motion):
    """The motion over a character whose joints only have other axes."""
    unroll = rot.multiply(rot.inverse(world_rest(character)), world_rest(body()))  # new joint from old joint
    world = rot.multiply(world_pose(motion)[0], rot.inverse(unroll))
    parents = motion.skeleton.parents
    local = world.copy()
    local[:, 1:] = rot.multiply(rot.inverse(world[:, parents[1:]]), world[:, 1:])
    return replace(motion, skeleton=character.skeleton, rotations=local)


def world_rest(character):
    from retarget.body.kinematics import rest_pose

    return rest_pose(character.skeleton)[0]


@law("names, order and axes of joints and the rest pose do not matter")
def test_names_and_order_of_the_target_do_not_matter(make):
    def rename(name):
        return f"knochen_{name[::-1]}"

    target, order = in_other_order(body("heavy"), seed=4, rename=rename)
    other = cast_by_names(target, {name: rename(name) for name in body().skeleton.names})
    plain, posed = walked(make(), "heavy"), perform(make, walk(), other)
    assert posed.skeleton.names == tuple(rename(body().skeleton.names[joint]) for joint in order)
    assert np.abs(surface(target, posed) - surface(body("heavy"), plain)).max() < 1e-4


def test_a_walk_stands_on_its_feet():
    """The laws above mean little unless the made walk walks: its feet stand still, and it goes a metre."""
    motion = walk()
    _, places = world_pose(motion)
    foot = places[:, body().skeleton.index("leftFoot")]
    assert (np.linalg.norm(np.diff(foot, axis=0), axis=1) < 1e-9).mean() > 0.5
    assert 0.9 < motion.translations[-1, 0, 2] - motion.translations[0, 0, 2] < 1.2
    assert local_positions(motion.skeleton, motion.translations, motion.moved).shape == places.shape
