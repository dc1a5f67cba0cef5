"""Rigs whose feet hang under the root perform like those whose feet hang on the legs."""

from dataclasses import replace

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human, human_model
from retarget.body.kinematics import rest_pose, world_pose
from retarget.body.skinning import skin_motion
from retarget.casting import cast
from retarget.character import Skeleton
from retarget.motion.align import with_grafts
from retarget.motion.library import PERFORMER, embedded_motion
from retarget.retargeting import prepare


def with_feet_aside(character, keep_ankles=True):
    """The same body with its feet under the hips, as rigs for inverse kinematics have them, and bare ankles on the legs."""
    skeleton = character.skeleton
    names, parents, offsets = list(skeleton.names), skeleton.parents.copy(), skeleton.offsets.copy()
    rotations = skeleton.rest_rotations.copy()
    _, rest = rest_pose(skeleton)
    extra = []
    for side in ("left", "right"):
        foot = names.index(f"{side}Foot")
        if keep_ankles:
            extra.append((f"{side}LowerLeg_end", parents[foot], offsets[foot].copy()))
        offsets[foot] = rest[foot] - rest[0]
        parents[foot] = 0
    for name, parent, offset in extra:
        names.append(name)
        parents, offsets = np.append(parents, parent), np.concatenate([offsets, offset[None]])
        rotations = np.concatenate([rotations, [[0.0, 0.0, 0.0, 1.0]]])
    return replace(character, skeleton=Skeleton(tuple(names), parents, offsets, rotations))


@pytest.fixture(scope="module")
def performances():
    source = cast(human(**PRESETS[PERFORMER]))
    plain = human(**PRESETS["heavy"], name="heavy")
    motion = embedded_motion("walk")
    return source, plain, motion, prepare(source, cast(plain), "copy-rotations")(motion)


def test_feet_aside_walk_as_feet_on_legs(performances):
    source, plain, motion, expected = performances
    aside = with_feet_aside(plain)
    found = prepare(source, cast(aside), "copy-rotations")(motion)
    assert found.file_motion.skeleton.names == aside.skeleton.names
    away = np.abs(skin_motion(aside, found.file_motion) - skin_motion(plain, expected.file_motion)).max(axis=(0, 2))
    hands = [name.endswith("Hand") for name in human_model().part_names]  # fingers may be told apart otherwise
    assert away[~np.array(hands)[human_model().vertex_parts]].max() < 1e-4


@pytest.mark.parametrize("keep_ankles", [True, False])
def test_feet_stay_on_their_legs(performances, keep_ankles):
    source, plain, motion, _ = performances
    aside = with_feet_aside(plain, keep_ankles)
    found = prepare(source, cast(aside), "copy-rotations")(motion).file_motion
    skeleton = aside.skeleton
    foot, shin = skeleton.index("leftFoot"), skeleton.index("leftLowerLeg")
    assert foot in found.moved
    rest_turns, rest = rest_pose(skeleton)
    turns, places = world_pose(found)
    on_leg = rot.rotate(rot.multiply(turns[:, shin], rot.inverse(rest_turns[shin])), rest[foot] - rest[shin])
    assert np.allclose(places[:, foot], places[:, shin] + on_leg, atol=1e-9)
    assert np.ptp(places[:, foot], axis=0).max() > 0.1


def test_bodies_with_feet_on_their_legs_stay_as_they_are(performances):
    _, plain, _, _ = performances
    actor = cast(plain)
    assert with_grafts(actor) is actor


def test_a_grafted_body_rests_as_before(performances):
    _, plain, _, _ = performances
    aside = cast(with_feet_aside(plain))
    grafted = with_grafts(aside)
    assert grafted.graft is not None
    assert (grafted.skeleton.parents < np.arange(len(grafted.skeleton))).all()
    world, places = rest_pose(grafted.skeleton)
    before, there = rest_pose(aside.skeleton)
    assert np.allclose(places, there[grafted.graft.order], atol=1e-12)
    assert np.allclose(np.abs((world * before[grafted.graft.order]).sum(axis=1)), 1, atol=1e-12)
    assert with_grafts(grafted) is grafted


def test_all_clips_of_a_grafted_body_share_a_file(performances, tmp_path):
    from retarget.io import load
    from retarget.methods import save_results

    source, plain, motion, _ = performances
    target = cast(with_feet_aside(plain))
    results = [prepare(source, target, "copy-rotations")(motion) for _ in range(2)]
    save_results(tmp_path / "both.glb", results)
    assert len(load(tmp_path / "both.glb").clips) == 2
