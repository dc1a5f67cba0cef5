"""The stand-in: a source without a skin gets a body whose joints stand where the source's do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, prepared

from retarget.body.human import human_model
from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Character, Motion, Skeleton
from retarget.contact.detect import prepare_contacts
from retarget.errors import RetargetError
from retarget.motion.library import embedded_motion
from retarget.motion.stand_in import SLACK, fit_stand_in

SHARED = [f"{side}{name}" for side in ("left", "right") for name in (
    "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")] + ["head"]  # fmt: skip


@cache
def stripped(preset):
    return cast_by_names(Character(body(preset).skeleton, name="bare joints"))


@cache
def stand_in(preset):
    return fit_stand_in(stripped(preset))


def performed(name, preset, every=5):
    """A motion on the skeleton of a body, thinned out."""
    motion = embedded_motion(name)
    if preset != "thin":
        motion = prepared(actor("thin"), actor(preset), "copy-rotations")(motion).motion
    few = slice(None, None, every)
    return replace(
        motion, skeleton=stripped(preset).skeleton, rotations=motion.rotations[few],
        translations=motion.translations[few], fps=motion.fps / every,
    )  # fmt: skip


def distances(preset, motion):
    """Metres between the joints of the source and of the stand-in, frames by `SHARED`."""
    source, fitted = stripped(preset), stand_in(preset)
    _, there = world_pose(motion)
    _, here = world_pose(fitted.motion(motion))
    rows = [source.humanoid.joints[name] for name in SHARED], [fitted.actor.humanoid.joints[name] for name in SHARED]
    return np.linalg.norm(there[:, rows[0]] - here[:, rows[1]], axis=2)


@pytest.mark.parametrize("preset", ["thin", "muscular", "child", "tall", "woman", "toddler"])
def test_joints_stand_where_the_sources_do(preset):
    assert distances(preset, performed("arms_crossed", preset)).max() < 1e-3
    assert stand_in(preset).bone_error < 1e-6


def test_the_stand_in_is_a_valid_embedded_body_standing_on_the_floor():
    model = human_model()
    for preset in ("thin", "child", "tall"):
        character = stand_in(preset).actor.character
        assert (character.mesh.faces == model.faces).all()
        np.testing.assert_allclose(rest_vertices(character), character.mesh.vertices, atol=1e-5)
        assert abs(character.mesh.vertices[:, 1].min()) < 1e-6
        assert stand_in(preset).actor.height == pytest.approx(stripped(preset).height, rel=0.1)


def touching(person, motion):
    contacts = prepare_contacts(person.character, person.humanoid).clip(*world_pose(motion), motion.fps)
    tracks = contacts.tracks
    pose = tracks.pose_probability[contacts.track] >= 0.5
    pairs = np.sort(np.stack([tracks.own_part[contacts.track], contacts.part], axis=1), axis=1)
    return {(frame, *pair) for frame, pair in zip(contacts.frame[pose].tolist(), map(tuple, pairs[pose].tolist()))}


@pytest.mark.parametrize("preset", ["thin", "muscular"])
@pytest.mark.parametrize("name", ["hands_on_hips", "arms_crossed"])
def test_parts_that_touch_on_the_performer_touch_on_the_stand_in(name, preset):
    motion = performed(name, preset)
    true = touching(actor(preset), motion)
    found = touching(stand_in(preset).actor, stand_in(preset).motion(motion))
    assert len(true) > 10
    assert len(true & found) >= 0.9 * len(true)
    assert len(true & found) >= 0.75 * len(found)


def test_poses_one_by_one_equal_the_clip():
    motion = performed("clap", "woman", 20)
    clip = stand_in("woman").motion(motion)
    assert clip.fps == motion.fps and len(clip) == len(motion)
    for number in range(len(motion)):
        pose, expected = stand_in("woman").pose(motion.pose(number)), clip.pose(number)
        assert pose.moved == expected.moved
        np.testing.assert_allclose(pose.translations, expected.translations, atol=1e-9)
        turn = np.abs((pose.rotations * expected.rotations).sum(axis=1))
        np.testing.assert_allclose(turn, 1.0, atol=1e-9)


def scaled(skeleton, factor_of):
    """The skeleton with the offsets of some joints longer or shorter."""
    return replace(skeleton, offsets=skeleton.offsets * np.array([[factor_of(name)] for name in skeleton.names]))


@pytest.mark.parametrize("factor_of", [
    lambda name: 6.0 if name.endswith(("LowerArm", "Hand")) else 1.0,
    lambda name: 5.0 if name in ("neck", "head") else 0.4 if "Leg" in name else 1.0,
    lambda name: 0.0 if name.endswith(("Toes", "Shoulder", "Proximal")) else 1.0,
])  # fmt: skip
def test_odd_skeletons_get_a_finite_body_and_a_bounded_pull(factor_of):
    skeleton = scaled(body().skeleton, factor_of)
    fitted = fit_stand_in(cast_by_names(Character(skeleton)))
    moved = fitted.motion(replace(performed("clap", "thin", 30), skeleton=skeleton))
    assert np.isfinite(fitted.actor.character.mesh.vertices).all()
    assert np.isfinite(moved.rotations).all() and np.isfinite(moved.translations).all()
    away = moved.translations[:, 1:] - fitted.actor.skeleton.offsets[list(moved.moved[1:])]
    assert np.linalg.norm(away, axis=2).max() <= SLACK * fitted.actor.height + 1e-9


def test_what_cannot_be_stretched_is_said():
    skeleton = scaled(body().skeleton, lambda name: 6.0 if name.endswith("LowerArm") else 1.0)
    fitted = fit_stand_in(cast_by_names(Character(skeleton)))
    assert "leftUpperArm, rightUpperArm" in fitted.notes[0]
    assert fitted.bone_error > 0.05
    assert "beyond" not in stand_in("thin").notes[0]


def test_a_source_with_fewer_joints_keeps_the_humans_proportions():
    full = body("tall").skeleton
    gone = [name for name in full.names if "Proximal" in name or "Intermediate" in name or "Distal" in name or "Meta" in name]
    gone += ["leftToes", "rightToes", "chest", "upperChest"]
    _, places = rest_pose(full)
    kept = [joint for joint, name in enumerate(full.names) if name not in gone]
    parents = []
    for joint in kept:
        above = int(full.parents[joint])
        while above >= 0 and above not in kept:
            above = int(full.parents[above])
        parents.append(-1 if above < 0 else kept.index(above))
    offsets = [places[joint] - (places[kept[up]] if up >= 0 else 0) for joint, up in zip(kept, parents)]
    names = tuple(full.names[joint] for joint in kept)
    skeleton = Skeleton(names, np.array(parents), np.array(offsets), full.rest_rotations[kept])
    source = cast_by_names(Character(skeleton), {name: name for name in names})
    fitted = fit_stand_in(source)
    motion = performed("hands_on_hips", "tall")
    bare = Motion(skeleton, motion.rotations[:, kept], motion.translations, motion.fps)
    _, there = world_pose(bare)
    _, here = world_pose(fitted.motion(bare))
    rows = [source.humanoid.joints[name] for name in SHARED], [fitted.actor.humanoid.joints[name] for name in SHARED]
    assert np.linalg.norm(there[:, rows[0]] - here[:, rows[1]], axis=2).max() < 1e-3


def test_a_motion_of_another_skeleton_is_refused():
    with pytest.raises(RetargetError, match="another skeleton"):
        stand_in("thin").motion(performed("clap", "tall"))
    pose = performed("clap", "thin").pose(0)
    with pytest.raises(RetargetError, match="joints"):
        stand_in("thin").pose(replace(pose, rotations=pose.rotations[:5]))


def test_a_skeleton_without_height_is_refused():
    with pytest.raises(RetargetError, match="height"):
        fit_stand_in(replace(stripped("thin"), height=0.0))
    flat = scaled(body().skeleton, lambda name: 0.0 if name.endswith(("LowerLeg", "Foot")) else 1.0)
    with pytest.raises(RetargetError, match="legs"):
        fit_stand_in(replace(stripped("thin"), character=Character(flat)))
