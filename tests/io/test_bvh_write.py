import os
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from retarget.body import rotations as rot
from retarget.body.kinematics import rest_pose, world_pose
from retarget.character import Motion, Skeleton
from retarget.errors import FileError, RetargetError
from retarget.io import bvh

LETTERS = st.characters(min_codepoint=32, exclude_categories=["Cs"], exclude_characters="{}")
NAMES = st.text(LETTERS, min_size=1, max_size=8).filter(lambda name: name.encode() == name.encode().strip())


@st.composite
def recipes(draw):
    """What `cook` makes a motion of. (Nouns made inside a strategy would trip hypothesis over the type checks.)"""
    count = draw(st.integers(1, 6))
    names = draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))
    parents = [-1] + [draw(st.integers(0, joint - 1)) for joint in range(1, count)]
    ends = [joint for joint in range(count) if draw(st.booleans())]
    moved = tuple([0] + [joint for joint in range(1, count) if draw(st.booleans())])
    fps = draw(st.sampled_from([24.0, 29.97, 30.0, 33.7, 120.0, 1000.0, 0.3]))
    scale = draw(st.sampled_from([0.01, 1.0, 100.0]))
    return names, parents, ends, moved, fps, scale, draw(st.integers(1, 5)), draw(st.integers(0, 2**32 - 1))


def cook(names, parents, ends, moved, fps, scale, frames, seed, identity_rest=False):
    rng, count = np.random.default_rng(seed), len(names)
    rest = np.tile(rot.IDENTITY, (count, 1)) if identity_rest else rot.normalise(rng.normal(size=(count, 4)))
    ends = {joint: rng.normal(size=3) for joint in ends}
    skeleton = Skeleton(tuple(names), np.array(parents), scale * rng.normal(size=(count, 3)), rest, ends or None)
    return Motion(
        skeleton,
        rot.normalise(rng.normal(size=(frames, count, 4))),
        scale * rng.normal(size=(frames, len(moved), 3)),
        fps,
        moved,
    )


def by_name(values, skeleton, names):
    return np.take(values, [skeleton.names.index(name) for name in names], axis=-2)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(recipe=recipes(), order=st.permutations("XYZ"))
def test_written_and_read_back_every_joint_is_where_it_was(tmp_path, recipe, order):
    path, motion = tmp_path / "out.bvh", cook(*recipe)
    bvh.save(path, motion, order="".join(order))
    again = bvh.load(path).motion()
    names, scale = motion.skeleton.names, np.abs(motion.skeleton.offsets).max()
    assert sorted(again.skeleton.names) == sorted(names) and again.fps == pytest.approx(motion.fps, rel=1e-9)
    assert {again.skeleton.names[joint] for joint in again.moved} <= {names[joint] for joint in motion.moved}

    rest_rotations, rest_positions = rest_pose(motion.skeleton)
    assert np.abs(by_name(rest_pose(again.skeleton)[1], again.skeleton, names) - rest_positions).max() < 2e-5 * scale
    rotations, positions = world_pose(motion)
    again_rotations, again_positions = world_pose(again)
    assert np.abs(by_name(again_positions, again.skeleton, names) - positions).max() < 2e-5 * scale
    turns = rot.multiply(rotations, rot.inverse(rest_rotations))  # from rest to now, in the world
    assert np.asarray(rot.angle_between(by_name(again_rotations, again.skeleton, names), turns)).max() < 1e-6

    ends = motion.skeleton.end_offsets or {}
    ends = {names[joint]: rot.rotate(rest_rotations[joint], end) for joint, end in ends.items()}
    again_ends = {again.skeleton.names[joint]: end for joint, end in (again.skeleton.end_offsets or {}).items()}
    assert ends.keys() == again_ends.keys()
    assert all(np.abs(ends[name] - again_ends[name]).max() < 1e-6 for name in ends)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(recipe=recipes())
def test_a_skeleton_with_identity_rest_is_written_as_it_is(tmp_path, recipe):
    motion = cook(*recipe, identity_rest=True)
    bvh.save(tmp_path / "out.bvh", motion)
    again = bvh.load(tmp_path / "out.bvh").motion()
    order = [again.skeleton.names.index(name) for name in motion.skeleton.names]
    assert np.abs(again.skeleton.offsets[order] - motion.skeleton.offsets).max() <= 5.1e-7
    assert np.asarray(rot.angle_between(again.rotations[:, order], motion.rotations)).max() < 1e-6


def chain(joints=20, frames=50, length=0.1):
    rng = np.random.default_rng(0)
    names = tuple(f"j{i}" for i in range(joints))
    rest = rot.normalise(rng.normal(size=(joints, 4)))
    skeleton = Skeleton(names, np.arange(joints) - 1, np.tile([0, length, 0.0], (joints, 1)), rest)
    return Motion(skeleton, rot.normalise(rng.normal(size=(frames, joints, 4))), rng.normal(size=(frames, 1, 3)), 60.0)


def test_a_long_chain_comes_back_within_a_tenth_of_a_millimetre(tmp_path):
    motion = chain(joints=60, frames=100)
    bvh.save(tmp_path / "out.bvh", motion)
    error = np.abs(world_pose(bvh.load(tmp_path / "out.bvh").motion())[1] - world_pose(motion)[1]).max()
    assert error < 1e-4 / 4


def test_written_angles_do_not_jump_by_a_turn(tmp_path):
    motion = chain(joints=1, frames=100)
    spin = rot.from_rotation_vector(np.linspace(0, 12, 100)[:, None, None] * [0, 0, 1.0])
    bvh.save(tmp_path / "out.bvh", replace(motion, rotations=spin))
    lines = (tmp_path / "out.bvh").read_text().splitlines()[-100:]
    angles = np.array([line.split() for line in lines], float)[:, 3:]
    assert np.abs(np.diff(angles, axis=0)).max() < 10 and np.ptp(angles[:, 0]) > 600


@pytest.mark.parametrize(
    "motion, order, message",
    [
        (chain(), "XXY", "rotation order"),
        (replace(chain(), rotations=np.zeros((0, 20, 4)), translations=np.zeros((0, 1, 3))), "ZXY", "has no frame"),
        *[
            (replace(chain(1), skeleton=replace(chain(1).skeleton, names=(name,))), "ZXY", "cannot be written")
            for name in ("", " a", "a{", "a\nb", "a\x00b", "\ud800")
        ],
    ],
)
def test_what_bvh_cannot_hold_is_refused_and_nothing_written(tmp_path, motion, order, message):
    with pytest.raises(RetargetError, match=message):
        bvh.save(tmp_path / "out.bvh", motion, order)
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_written_is_told_and_a_failure_leaves_the_old_file(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="cannot be written"):
        bvh.save(tmp_path / "absent" / "out.bvh", chain())
    path = tmp_path / "out.bvh"
    path.write_text("old")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bvh.save(path, chain())
    assert os.listdir(tmp_path) == ["out.bvh"] and path.read_text() == "old"


@pytest.mark.slow
def test_three_thousand_frames_of_sixty_joints_are_written_in_a_second_and_a_half(tmp_path):
    motion = chain(joints=60, frames=3000)
    start = time.process_time()
    bvh.save(tmp_path / "out.bvh", motion)
    assert time.process_time() - start < 1.5
