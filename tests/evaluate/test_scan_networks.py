"""The paper's networks: sizes as published, and what forward kinematics and skinning must do."""

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.body.kinematics import forward
from retarget.methods.scan.features import PARENTS

torch = pytest.importorskip("torch")


def weights(network):
    """Without batch normalisation, which the paper does not count."""
    norms = [module for module in network.modules() if isinstance(module, torch.nn.BatchNorm1d)]
    return sum(each.numel() for each in network.parameters()) - sum(each.numel() for norm in norms for each in norm.parameters())


def test_sizes_are_those_of_the_paper():
    from retarget.evaluate.reference.scan_networks import MotionRetargeter, SkeletonRegressor, SkinningPredictor

    assert weights(SkeletonRegressor()) == pytest.approx(1.6e6, rel=0.02)
    assert weights(MotionRetargeter()) == pytest.approx(5.8e6, rel=0.01)
    assert weights(SkinningPredictor()) == 77_334  # the paper says .2 million; see the docstring


def test_the_order_of_points_does_not_matter():
    from retarget.evaluate.reference.scan_networks import SkeletonRegressor

    torch.manual_seed(0)
    network, points = SkeletonRegressor().eval(), torch.randn(2, 300, 3)
    with torch.no_grad():
        assert torch.allclose(network(points), network(points[:, torch.randperm(300)]), atol=1e-5)


def test_kinematics_and_skinning_are_the_packages_own():
    from retarget.evaluate.reference.scan_networks import forward_kinematics, matrices, skinned

    model = human_model()
    joints = model.joints(human().mesh.vertices)[:22]
    offsets = joints - np.where(PARENTS[:, None] >= 0, joints[PARENTS], joints[:1])
    draw = np.random.default_rng(0)
    rotations = rot.from_rotation_vector(draw.normal(size=(3, 22, 3)) * 0.5)
    turns, places = forward(PARENTS, rotations, np.broadcast_to(offsets, (3, 22, 3)))
    spread = torch.from_numpy(offsets).expand(3, -1, -1)
    found, where = forward_kinematics(torch.from_numpy(PARENTS), torch.from_numpy(rotations), spread)
    assert np.allclose(found.numpy(), rot.to_matrix(turns)) and np.allclose(where.numpy(), places)
    assert np.allclose(matrices(torch.from_numpy(rotations)).numpy(), rot.to_matrix(rotations))
    single = torch.eye(22, dtype=torch.float64).expand(3, -1, -1)  # each point goes with one joint, and lies on it
    at_joints = torch.from_numpy(joints).expand(3, -1, -1)
    assert np.allclose(skinned(at_joints, single, at_joints, found, where).numpy(), places)


def test_the_critic_learns_from_its_own_term_alone():
    from retarget.evaluate.reference.scan_networks import CONTEXT
    from retarget.train.paper_motion import PaperMotionRecipe, Players

    torch.manual_seed(0)
    players, draw = Players(), np.random.default_rng(1)
    turns = rot.from_rotation_vector(draw.normal(size=(2, CONTEXT, 22, 3)) * 0.3).astype(np.float32)
    skeletons = np.stack([human(height=height).mesh.vertices for height in (1.5, 1.9)])
    skeletons = human_model().joints(skeletons)[:, :22].astype(np.float32)
    recipe = PaperMotionRecipe.__new__(PaperMotionRecipe)
    recipe.rotation_weight = 1.0
    terms = recipe.losses(players, (turns, np.zeros((2, CONTEXT, 3), np.float32), skeletons, skeletons[::-1].copy()))
    terms["real"].backward(retain_graph=True)
    assert all(each.grad is None for each in players.critic.parameters())
    assert any(each.grad is not None for each in players.retargeter.parameters())
    players.zero_grad(set_to_none=True)
    terms["critic"].backward()
    assert all(each.grad is None for each in players.retargeter.parameters())
    assert all(each.grad is not None for each in players.critic.parameters())
