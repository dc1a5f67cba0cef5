"""The step that a network learns through is the one that is used."""

import numpy as np
import pytest
from made_motions import actor

torch = pytest.importorskip("torch")

from retarget.body.kinematics import world_pose  # noqa: E402
from retarget.methods.interaction.looker import SEEN, beside_seen, prepare_looker  # noqa: E402
from retarget.methods.interaction.part_equations import PAIRED, SAID, STIFF, part_steps  # noqa: E402
from retarget.methods.interaction.unknowns import SIZE  # noqa: E402
from retarget.motion.library import embedded_motion  # noqa: E402
from retarget.motion.touch.mend import frames_of  # noqa: E402
from retarget.retargeting import prepare  # noqa: E402
from retarget.train.interaction import LookNetwork  # noqa: E402
from retarget.train.part_equations import steps  # noqa: E402


def seen():
    motion = frames_of(embedded_motion("hands_on_hips"), np.array([20, 45, 60]))
    looker = prepare_looker(actor(), actor("heavy"))
    copied = prepare(actor(), actor("heavy"), "copy-rotations").retargeter(motion).motion
    turned = np.random.default_rng(0).normal(size=(3, SIZE)) * 0.02
    return looker.features(looker.source(motion), copied, world_pose(copied)[0], turned), turned


def stepped(seen, turned, says):
    places, axes, asked = beside_seen(seen)
    return part_steps(seen, places, axes, turned, asked, says)


def test_both_say_the_same():
    features, turned = seen()
    network = LookNetwork(torch.zeros(SEEN), torch.ones(SEEN))
    said = network.always.detach().numpy() + 0.5 * np.random.default_rng(1).normal(size=(3, SAID)).astype(np.float32)
    here = stepped(features, turned, said)
    there = steps(torch.from_numpy(features), torch.from_numpy(turned.astype(np.float32)), torch.from_numpy(said)).numpy()
    assert np.abs(here - said[:, :SIZE]).max() > 0.05
    assert np.abs(here - there).max() < 2e-3 * np.abs(here).max()


def test_gradients_reach_all_that_is_said():
    features, turned = (torch.from_numpy(each.astype(np.float32)) for each in seen())
    said = LookNetwork(torch.zeros(SEEN), torch.ones(SEEN)).always.detach().repeat(3, 1).requires_grad_()
    steps(features, turned, said).square().sum().backward()
    assert torch.isfinite(said.grad).all()
    for part in (slice(0, SIZE), PAIRED, STIFF):
        assert (said.grad[:, part] != 0).any(dim=0).float().mean() > 0.3, part
