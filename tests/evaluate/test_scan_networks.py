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
    still, same = np.zeros((2, CONTEXT, 3), np.float32), np.zeros(2, np.float32)
    terms = recipe.losses(players, (turns, still, skeletons, skeletons[::-1].copy(), same))
    terms["real"].backward(retain_graph=True)
    assert all(each.grad is None for each in players.critic.parameters())
    assert any(each.grad is not None for each in players.retargeter.parameters())
    players.zero_grad(set_to_none=True)
    terms["critic"].backward()
    assert all(each.grad is None for each in players.retargeter.parameters())
    assert all(each.grad is not None for each in players.critic.parameters())


def test_the_pipeline_moves_a_body_as_its_networks_say(monkeypatch):
    """Stand-ins that know the truth: the pipeline's joints and skin are then the truth."""
    from dataclasses import replace

    from retarget.body.kinematics import world_pose
    from retarget.body.skinning import skin_motion
    from retarget.character import PointMotion
    from retarget.evaluate.reference.scan_pipeline import Published
    from retarget.motion.library import embedded_motion, performer

    body, walk = performer(), embedded_motion("walk")
    rotations = walk.rotations[:6].copy()
    rotations[:, 22:] = rot.IDENTITY
    walk = replace(walk, skeleton=body.skeleton, rotations=rotations, translations=walk.translations[:6])
    places, surface = world_pose(walk)[1], skin_motion(body, walk)
    weights = np.zeros((len(body.mesh.vertices), len(body.skeleton)))
    np.put_along_axis(weights, body.skin.columns, body.skin.weights, axis=1)
    parents = body.skeleton.parents
    for joint in range(len(parents) - 1, 21, -1):
        weights[:, parents[joint]] += weights[:, joint]
    windows = []

    def retargeter(joints, moves, skeleton):
        windows.append((joints, moves, skeleton))
        return torch.from_numpy(rotations[:, None, :22]), torch.from_numpy(np.diff(places[:, :1], axis=0, prepend=places[:1, :1]))

    def regressor(points):
        assert points.shape == (6, 512, 3)
        return torch.from_numpy(places[:, :22] - middles[:, None])

    clouds = tuple(frame.astype(np.float32) for frame in surface)
    from retarget.methods.scan.features import thinned

    middles = np.stack([thinned(cloud.astype(np.float64)).middles[0] for cloud in clouds])
    networks = Published(regressor, retargeter, lambda *_: torch.from_numpy(weights[None, :, :22]), 4, {})
    joints, vertices = networks.retargeted(PointMotion(clouds, 30.0), body, places[0, 0])
    assert np.allclose(joints, places[:, :22], atol=1e-6)
    assert np.abs(vertices - surface).mean() < 5e-4, "skinning from level arms is nearly that from the rest pose"
    monkeypatch.setattr("retarget.evaluate.reference.scan_pipeline.LEVEL", 0.0)
    assert np.abs(networks.retargeted(PointMotion(clouds, 30.0), body, places[0, 0])[1] - surface).max() < 1e-4
    seen, moves, skeleton = windows[0]
    assert seen.shape == (6, 4, 22, 3) and moves.shape == (6, 4, 3) and skeleton.shape == (6, 22, 3)
    assert np.allclose(seen[5, -1].numpy(), places[5, :22] - places[5, 0], atol=1e-5)
    assert np.allclose(seen[5, 0].numpy(), places[2, :22] - places[2, 0], atol=1e-5), "a window ends with its frame"


def test_weights_are_found_by_variant_and_refused_where_they_are_not_there(tmp_path):
    from retarget.errors import FileError
    from retarget.evaluate.reference.scan_networks import MotionRetargeter, SkeletonRegressor, SkinningPredictor
    from retarget.evaluate.reference.scan_pipeline import load_published
    from retarget.train.export import save_reference

    told = {"seconds": "7"}
    for name, network in (
        ("paper-skr", SkeletonRegressor()), ("paper-skin", SkinningPredictor()), ("paper-smrm-context-5", MotionRetargeter())
    ):  # fmt: skip
        save_reference(network, tmp_path, {"network": name, **told})
    with pytest.raises(FileError, match="paper-smrm.pt"):
        load_published(tmp_path)
    save_reference(MotionRetargeter(), tmp_path, {"network": "paper-smrm", **told})
    found = load_published(tmp_path)
    assert {name: each.context for name, each in found.items()} == {"": 30, "paper-smrm-context-5": 5}
    assert found[""].seconds == {"paper-skr": 7.0, "paper-smrm": 7.0, "paper-skin": 7.0}
    save_reference(SkinningPredictor(), tmp_path, {"network": "paper-smrm", **told})
    with pytest.raises(FileError, match="another network"):
        load_published(tmp_path)
