"""The networks of others: sensors and fields as the package has them, sizes as printed, and recipes that learn."""

from functools import cache

import numpy as np
import pytest
from made_motions import actor

torch = pytest.importorskip("torch")

from retarget.body import rotations as rot  # noqa: E402
from retarget.body.kinematics import forward  # noqa: E402
from retarget.contact.interaction_field import interaction_field, prepare_field  # noqa: E402
from retarget.contact.sensors import paper_layout, prepare_sensor_skinning  # noqa: E402
from retarget.errors import FileError  # noqa: E402
from retarget.evaluate.reference import interaction_networks as networks  # noqa: E402
from retarget.evaluate.reference.interaction_bodies import bodies_of, body_of, shapes_of  # noqa: E402
from retarget.evaluate.reference.interaction_methods import ReferenceNetwork  # noqa: E402
from retarget.evaluate.reference.residual_network import ResidualRetargeter, hull_distance, product  # noqa: E402
from retarget.methods.scan.features import JOINTS, PARENTS  # noqa: E402
from retarget.motion.library import embedded_motion  # noqa: E402
from retarget.train.export import save_reference  # noqa: E402
from retarget.train.loop import Settings, train  # noqa: E402
from retarget.train.paper_interaction import PaperInteractionRecipe  # noqa: E402
from retarget.train.paper_residual import ResidualRecipe  # noqa: E402


@cache
def bodies():
    return [body_of(actor(preset), paper_layout()) for preset in ("thin", "heavy")]


@cache
def performed():
    return embedded_motion("arms_crossed").rotations[40:80, :JOINTS].astype(np.float32)


def posed(body, rotations):
    own, parents = bodies_of([body]), torch.from_numpy(PARENTS)
    local = torch.from_numpy(rot.to_matrix(rotations.astype(float))[None].astype(np.float32))
    return networks.posed_sensors(*networks.placed(parents, local, own), parents, own)


def test_sensors_lie_where_the_package_has_them():
    """But for fingers, which go with their hands here."""
    body, skeleton = bodies()[0], actor().character.skeleton
    rotations = np.tile(rot.IDENTITY, (5, len(skeleton), 1))
    rotations[:, :JOINTS] = performed()[:5]
    offsets = np.broadcast_to(skeleton.offsets, (5, len(skeleton), 3)).copy()
    offsets[:, 0] = 0.0
    places, frames = prepare_sensor_skinning(body.sensors).pose(*forward(skeleton.parents, rotations, offsets))
    where, turned = (each[0].numpy() for each in posed(body, performed()[:5]))
    valid = body.sensors.valid
    assert np.abs(where - places)[:, valid].max() < 0.003
    assert np.abs(turned - frames)[:, valid].max() < 1e-4


def test_the_field_is_the_package_s():
    sensors = [body.sensors for body in bodies()]
    plan = prepare_field(*sensors, 4, 4)
    where, turned = posed(bodies()[0], performed()[:3])
    chosen = plan.select(where[0].numpy().astype(float))
    there = networks.field_of(where, turned, networks.entries_of(plan, [chosen]))[0].numpy()
    here = interaction_field(where[0].numpy(), turned[0].numpy(), chosen.observers, chosen.targets, chosen.source)
    assert np.abs((there - here) * chosen.source[..., None]).max() < 1e-5


def test_the_network_has_the_printed_layers():
    layout = paper_layout()
    numbers = (torch.from_numpy(each.astype(np.float32)) for each in (layout.along, layout.around))
    whole = networks.MeshRet(*numbers, torch.from_numpy(layout.bones))
    assert len(whole.encoder.layers) == len(whole.decoder.layers) == 8 and len(whole.geometry) == len(whole.sensor) == 4
    assert all(len(net.layers) == 6 and net.layers[0].in_features == 23 for net in whole.sensor)
    assert whole.encoder.layers[0].self_attn.num_heads == 4 and whole.encoder.layers[0].linear1.out_features == 256


def test_the_hull_is_negative_inside():
    shapes = shapes_of(bodies()[:1])
    chest, turn = torch.zeros(1, 3), torch.eye(3)[None]
    points = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [2.0, 0.0, 0.0]]])
    inside, ahead, aside = hull_distance(points, turn, chest, shapes)[0].tolist()
    assert -0.2 < inside < -0.02 and 0.7 < ahead < 1.0 and 1.0 < aside < 2.0


def test_quaternions_multiply_as_the_package_s():
    a, b = (rot.normalise(np.random.default_rng(seed).normal(size=(7, 4))) for seed in (0, 1))
    assert np.allclose(product(torch.from_numpy(a), torch.from_numpy(b)).numpy(), rot.multiply(a, b))


@pytest.mark.parametrize("make", [lambda *each: PaperInteractionRecipe(*each, 4, False), ResidualRecipe])
def test_recipes_learn(make, tmp_path):
    recipe = make([(performed(), 0)], bodies())
    settings = Settings(steps=12, batch=2 if isinstance(recipe, PaperInteractionRecipe) else 16, rate=1e-3, warm=2, every=6, decay=0.0)
    state = train(recipe, settings, tmp_path)
    fresh = recipe.network()
    totals = []
    with torch.no_grad():
        for network in (fresh, state.network):
            terms = recipe.losses(network, recipe.batch(99, 4))
            totals.append(sum(float(value) for name, value in terms.items() if name not in ("critic", "real") and not name.endswith("_seen")))
    assert totals[1] < totals[0]


def test_networks_are_methods(tmp_path):
    save_reference(ResidualRetargeter(), tmp_path, {"network": "paper-r2et", "seconds": "60"})
    motion = embedded_motion("arms_crossed")
    made = ReferenceNetwork(tmp_path / "paper-r2et.pt").prepare(actor(), actor("heavy"))(motion).motion
    assert np.isfinite(made.rotations).all() and len(made) == len(motion)
    with pytest.raises(FileError, match="paper-meshret.pt: the network's weights are not there"):
        ReferenceNetwork(tmp_path / "paper-meshret.pt").prepare(actor(), actor("heavy"))
    (tmp_path / "paper-r2et.pt").rename(tmp_path / "paper-meshret.pt")
    with pytest.raises(FileError, match="weights of another network"):
        ReferenceNetwork(tmp_path / "paper-meshret.pt").prepare(actor(), actor("heavy"))
