"""Recipe of the skinning field: from where a point lies among the joints of a resting body to its skinning weights.

`methods/scan/skinning_field.py` uses what is learnt here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import forward
from retarget.evaluate.scan_split import BODY_SEEDS, TRAINING, VALIDATION
from retarget.methods.scan.features import JOINTS
from retarget.methods.scan.regressor import load_regressor
from retarget.methods.scan.skinning_field import FILE, KIND, SPREADS, VERSION, field_features, flesh
from retarget.train.data import SAMPLES, Wardrobe, bake_bodies
from retarget.train.export import Graph
from retarget.train.loop import Recipe, Settings
from retarget.train.poses import still_poses

Array = np.ndarray

INPUTS, WIDTH = 6 * JOINTS + 4 * JOINTS * len(SPREADS), 256
POINTS = 128
"""Of every body in a batch."""
RESTS = 14
"""Rest poses of every training body."""
SEEN = 6000
"""Points of a cloud that the regressor sees."""
REGRESSED = 0.7
"""Share of bodies whose joints are the regressor's; those of the others are true."""
CLOTH = 0.025
"""How far the points of half of the bodies stand off the skin, at most (metres)."""
STANCES = {"T": (48.0,), "A": (0.0, 20.0), "arms down": (-34.0, -38.0)}
"""Rest poses that are judged, by how far arms are lifted."""
SETTINGS = Settings(steps=12_000, batch=24, rate=2e-3, warm=200, every=250, checks=1000)


class FieldNetwork(nn.Module):
    """Three layers with room for the paper's (22-256-256-22), and one more."""

    def __init__(self) -> None:
        super().__init__()
        widths = (INPUTS, WIDTH, WIDTH, WIDTH)
        self.norm = nn.LayerNorm(INPUTS)
        self.hidden = nn.ModuleList(nn.Linear(*pair) for pair in zip(widths, widths[1:]))
        self.leave = nn.Linear(WIDTH, JOINTS)

    def forward(self, features: Tensor) -> Tensor:
        """(points, features) to scores (points, joints); their softmax are weights."""
        x = self.norm(features)
        for layer in self.hidden:
            x = torch.relu(layer(x))
        return self.leave(x)


@dataclass(frozen=True, eq=False)
class Rests:
    """Resting bodies, as the field sees them through true joints and through the regressor's: axis `sorts` in this order."""

    bodies: Int[Array, "rests"]
    rotations: Float[Array, "rests joints 4"]
    cloth: Float[Array, "rests"]
    joints: Float[Array, "rests sorts body 3"]
    turns: Float[Array, "rests sorts body 3 3"]
    flesh: Float[Array, "rests sorts figures"]


class FieldRecipe(Recipe):
    """Points of training bodies in rest poses; looks at validation bodies."""

    name: ClassVar[str] = KIND

    def __init__(self, cache: Path) -> None:
        self.bodies = bake_bodies(BODY_SEEDS[TRAINING], cache)
        self.judged = bake_bodies(BODY_SEEDS[VALIDATION], cache)
        self.rests = _kept_rests(self.bodies, cache / f"rests_{RESTS}.npz")

    def network(self) -> nn.Module:
        """Fresh, .22 million weights."""
        return FieldNetwork()

    def batch(self, number: int, count: int) -> tuple[Array, Array]:
        """Features and true weights of the points of so many bodies."""
        draw = np.random.default_rng([number, 5])
        rows = [self._rows(int(rest), draw) for rest in draw.integers(len(self.rests.bodies), size=count)]
        features, weights = (np.concatenate(column) for column in zip(*rows))
        return features, weights

    def _rows(self, rest: int, draw: np.random.Generator) -> tuple[Array, Array]:
        own, sort = self.rests, int(draw.random() < REGRESSED)
        samples = draw.integers(SAMPLES, size=POINTS)
        points, weights, _, _ = resting(self.bodies, int(own.bodies[rest]), own.rotations[rest], samples, float(own.cloth[rest]))
        return field_features(points, own.joints[rest, sort], own.turns[rest, sort], own.flesh[rest, sort]), weights

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Cross-entropy; the squared error of the weights is only looked at."""
        scores, weights = network(torch.from_numpy(batch[0])), torch.from_numpy(batch[1])
        squares = (torch.softmax(scores, dim=1) - weights).square().mean()
        return {"entropy": nn.functional.cross_entropy(scores, weights), "square_seen": squares}

    def check(self, network: nn.Module) -> dict[str, float]:
        """Mean squared errors of weights on the validation set."""
        found = {}
        for stance, lifts in STANCES.items():
            errors = weight_errors(network, self.judged, lifts)
            found |= {f"mse {stance}": errors[0], f"mse {stance} regressed": errors[1]}
        return found


def _kept_rests(bodies: Wardrobe, path: Path) -> Rests:
    """The rests of training, taken from a file where it is there."""
    if path.exists():
        with np.load(path) as stored:
            return Rests(**{name: stored[name] for name in stored.files})
    rows = []
    for number in range(len(bodies.joints) * RESTS):
        draw = np.random.default_rng([number, 11])
        rotations, cloth = still_poses(1, draw)[0], draw.uniform(0.0, CLOTH) * (draw.random() < 0.5)
        samples = draw.choice(SAMPLES, size=SEEN, replace=False)
        points, _, joints, turns = resting(bodies, number // RESTS, rotations, samples, cloth)
        rows.append((number // RESTS, rotations, cloth, *_seen(points, joints, turns)))
    rests = Rests(*(np.stack([np.asarray(row[place]) for row in rows]) for place in range(6)))
    part = path.with_suffix(".part.npz")
    np.savez(part, **vars(rests))
    part.rename(path)
    return rests


def _seen(points: Array, joints: Array, turns: Array) -> tuple[Array, Array, Array]:
    """Joints, their turns and the flesh around them: true ones, then the regressor's."""
    found = load_regressor().glance(points)
    sorts = ((joints, turns), (found.places, rot.to_matrix(found.turns)))
    return *(np.stack(column) for column in zip(*sorts)), np.stack([flesh(points, *sort) for sort in sorts])


@torch.no_grad()
def weight_errors(network: nn.Module, bodies: Wardrobe, lifts: tuple[float, ...]) -> Float[Array, "sorts"]:
    """Mean squared error of the weights of 2,000 points of every body in a stance, through true joints and the regressor's."""
    squares = []
    for body in range(len(bodies.joints)):
        draw = np.random.default_rng([body, 12])
        samples = draw.choice(SAMPLES, size=SEEN, replace=False)
        points, weights, joints, turns = resting(bodies, body, still_poses(1, draw, lifts)[0], samples, 0.0)
        for sort in zip(*_seen(points, joints, turns)):
            found = torch.softmax(network(torch.from_numpy(field_features(points[:2000], *sort))), dim=1)
            squares.append(float(((found.numpy() - weights[:2000]) ** 2).mean()))
    return np.reshape(squares, (-1, 2)).mean(axis=0)


def resting(
    bodies: Wardrobe, body: int, rotations: Float[Array, "joints 4"], samples: Array, cloth: float
) -> tuple[Array, Array, Array, Array]:
    """Points of a body in a pose, `cloth` metres off the skin: places, weights over 22 joints (fingers belong to hands), and the
    joints and their turns."""
    parents, joints = human_model().parents, bodies.joints[body]
    offsets = joints - np.where(parents[:, None] >= 0, joints[parents], 0.0)
    turns, places = forward(parents, rotations, offsets)
    matrices = rot.to_matrix(turns)
    rest = bodies.rests[body, samples] + cloth * bodies.normals[body, samples]
    columns, shares = bodies.columns[body, samples], bodies.weights[body, samples]
    arms = rest[:, None] - joints[columns]
    points = np.einsum("sk,skab,skb->sa", shares, matrices[columns], arms) + np.einsum("sk,ska->sa", shares, places[columns])
    weights = np.zeros((len(samples), JOINTS), dtype=np.float32)
    np.add.at(weights, (np.arange(len(samples))[:, None], _body_joints()[columns]), shares)
    return points, weights, places[:JOINTS], matrices[:JOINTS]


def _body_joints() -> Array:
    """Of every joint of the embedded human the one of the body that it belongs to."""
    owners = np.arange(len(human_model().parents))
    for joint in range(JOINTS, len(owners)):
        owners[joint] = owners[human_model().parents[joint]]
    return owners


def recipe(data: Path | None, cache: Path) -> FieldRecipe:
    """The recipe, with bodies baked into `cache`; it takes no clips."""
    return FieldRecipe(cache)


def export(network: FieldNetwork, folder: Path, told: Mapping[str, str]) -> None:
    """Write the network as an ONNX file into a folder; `told` goes into it too."""
    graph = Graph()
    x = graph.norm(network.norm, "features")
    for layer in network.hidden:
        x = graph.apply("Relu", [graph.linear(layer, x)])
    graph.save(folder / FILE, graph.linear(network.leave, x), INPUTS, JOINTS, {"network": KIND, "version": VERSION, **told})
