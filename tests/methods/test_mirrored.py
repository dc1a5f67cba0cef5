"""The mirror image of what the network sees is what it sees of the mirror image."""

import numpy as np
from made_motions import actor, mirrored

from retarget.body.kinematics import world_pose
from retarget.methods.interaction.looker import beside_seen, prepare_looker
from retarget.methods.interaction.mirrored import mirror_of_features, mirror_of_said, mirror_of_turned
from retarget.methods.interaction.part_equations import SAID, STIFF, part_steps
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.library import embedded_motion
from retarget.motion.touch.mend import frames_of
from retarget.retargeting import prepare


def seen():
    """What is seen of a pair of bodies, of their mirror images, and where corrections of the former stand."""
    motion = frames_of(embedded_motion("arms_crossed"), np.array([30, 60, 90]))
    looker = prepare_looker(actor(), actor("heavy"))
    copied = prepare(actor(), actor("heavy"), "copy-rotations", foot_lock=False, one_rig=True).retargeter(motion).motion
    turned = np.random.default_rng(0).normal(size=(3, SIZE)) * 0.05
    said = mirror_of_turned()
    here = looker.features(looker.source(motion), copied, world_pose(copied)[0], turned)
    other = mirrored(copied)
    there = looker.features(looker.source(mirrored(motion)), other, world_pose(other)[0], said(turned))
    return here, there, turned


def test_seen_in_a_mirror():
    here, there, turned = seen()
    said = mirror_of_turned()
    assert np.abs(mirror_of_features()(here) - there).max() < 1e-5
    assert np.abs(here - there).max() > 0.1
    assert np.array_equal(said(said(turned)), turned)


def test_equations_in_a_mirror():
    here, there, turned = seen()
    draw = np.random.default_rng(1)
    says = 0.3 * draw.normal(size=(3, SAID))
    says[:, STIFF] += 3.0
    steps = []
    for features, corrections, numbers in ((here, turned, says), (there, mirror_of_turned()(turned), mirror_of_said()(says))):
        places, axes, asked = beside_seen(features)
        steps.append(part_steps(features, places, axes, corrections, asked, numbers))
    assert np.abs(mirror_of_turned()(steps[0]) - steps[1]).max() < 1e-4 < 0.01 < np.abs(steps[0] - says[:, :SIZE]).max()
    assert np.abs(steps[0] - steps[1]).max() > 0.1
