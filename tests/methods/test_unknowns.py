"""Corrections mean the same on every rig."""

from functools import cache

import numpy as np
import pytest
from made_motions import actor, body, cast_by_names, fingerless

from retarget.body.kinematics import world_pose
from retarget.body.skinning import skin_motion
from retarget.contact.skin_levers import TURNING
from retarget.evaluate.cases import arms_turned, in_other_rest_pose, with_other_joint_axes
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare

CHANGES = [lambda c: with_other_joint_axes(c, 3), lambda c: in_other_rest_pose(c, arms_turned(40.0))]


@cache
def corrections():
    turned = np.random.default_rng(0).normal(size=(2, SIZE)) * 0.1
    turned[:, -3:] *= 0.2
    return turned


def posed(target):
    motion = frames_of(embedded_motion("hand_on_belly"), np.array([20, 75]))
    return prepare(actor(), target, "copy-rotations").retargeter(motion).motion


def test_there_and_back():
    looker, copied = prepare_looker(actor(), actor("child")), posed(actor("child"))
    world = world_pose(copied)[0]
    x = looker.unknowns.to_solver(corrections(), world)
    assert np.allclose(looker.unknowns.from_solver(x, world), corrections())
    matrices = np.random.default_rng(1).normal(size=(2, x.shape[1], x.shape[1]))
    there = looker.unknowns.matrix(matrices, world)
    costs = [np.einsum("fn,fnm,fm->f", each, own, each) for each, own in ((x, matrices), (corrections(), there))]
    assert np.allclose(*costs)


@pytest.mark.parametrize("change", CHANGES)
def test_a_correction_moves_the_same_body_alike_on_another_rig(change):
    surfaces = []
    for target in (actor("child"), cast_by_names(change(body("child")))):
        looker, copied = prepare_looker(actor(), target), posed(target)
        moved = looker.moved(copied, world_pose(copied)[0], corrections())
        surfaces.append([skin_motion(target.character, each) for each in (copied, moved)])
    apart = [np.linalg.norm(one - other, axis=2) for one, other in zip(*surfaces)]
    assert apart[1].mean() < apart[0].mean() + 0.004
    changed = np.linalg.norm(surfaces[0][1] - surfaces[0][0], axis=2)
    assert changed.mean() > 0.03


def test_joints_that_a_rig_lacks_keep_their_places():
    target = cast_by_names(fingerless(body("child")), {name: name for name in fingerless(body()).skeleton.names})
    looker, copied = prepare_looker(actor(), target), posed(target)
    world = world_pose(copied)[0]
    x = looker.unknowns.to_solver(corrections(), world)
    assert x.shape[1] == 3 * 20 + 3 and len(TURNING) == 30
    back = looker.unknowns.from_solver(x, world).reshape(2, -1, 3)
    fingers = [number for number, name in enumerate(TURNING) if "Proximal" in name or "Metacarpal" in name]
    assert not back[:, fingers].any()
    kept = [number for number in range(31) if number not in fingers]
    assert np.allclose(back[:, kept], corrections().reshape(2, -1, 3)[:, kept])
