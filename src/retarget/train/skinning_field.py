"""Recipe of the skinning field: from where a point lies among the joints of a resting body to its skinning weights.

`methods/scan/skinning_field.py` uses what is learnt here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import forward
from retarget.evaluate.scan_split import BODY_SEEDS, TRAINING, VALIDATION
from retarget.methods.scan.features import JOINTS
from retarget.methods.scan.regressor import VERSION
from retarget.methods.scan.skinning_field import FILE, KIND, field_features
from retarget.train.data import SAMPLES, Wardrobe, bake_bodies
from retarget.train.export import Graph
from retarget.train.loop import Recipe, Settings
from retarget.train.poses import still_poses

Array = np.ndarray

INPUTS, WIDTH = 6 * JOINTS, 256
POINTS = 128
"""Of every body in a batch."""
SHAKEN = 0.5
"""Share of bodies whose joints are a little off, as a regressor's are,"""
OFF, TURNED = 0.012, np.radians(6.0)
"""by these standard deviations at most (metres, radians)."""
CLOTH = 0.025
"""How far the points of half of the bodies stand off the skin, at most (metres)."""
STANCES = {"T": (48.0,), "A": (0.0, 20.0), "arms down": (-34.0, -38.0)}
"""Rest poses that are judged, by how far arms are lifted."""
SETTINGS = Settings(steps=9000, batch=24, rate=2e-3, warm=200, every=250, checks=1000)


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


class FieldRecipe(Recipe):
    """Points of training bodies in rest poses; looks at validation bodies."""

    name: ClassVar[str] = KIND

    def __init__(self, cache: Path) -> None:
        self.bodies = bake_bodies(BODY_SEEDS[TRAINING], cache)
        self.judged = bake_bodies(BODY_SEEDS[VALIDATION], cache)

    def network(self) -> nn.Module:
        """Fresh, .17 million weights."""
        return FieldNetwork()

    def batch(self, number: int, count: int) -> tuple[Array, Array]:
        """Features and true weights of the points of so many bodies."""
        draw = np.random.default_rng([number, 5])
        rows = [self._rows(int(body), draw) for body in draw.integers(len(self.bodies.joints), size=count)]
        features, weights = (np.concatenate(column) for column in zip(*rows))
        return features, weights

    def _rows(self, body: int, draw: np.random.Generator) -> tuple[Array, Array]:
        samples = draw.integers(SAMPLES, size=POINTS)
        cloth = draw.uniform(0.0, CLOTH) if draw.random() < 0.5 else 0.0
        points, weights, joints, turns = resting(self.bodies, body, still_poses(1, draw)[0], samples, cloth)
        if draw.random() < SHAKEN:
            joints = joints + draw.normal(size=joints.shape) * draw.uniform(0.0, OFF)
            wobble = draw.normal(size=joints.shape) * draw.uniform(0.0, TURNED)
            turns = np.matmul(rot.to_matrix(rot.from_rotation_vector(wobble)), turns)
        return field_features(points, joints, turns), weights

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Cross-entropy; the squared error of the weights is only looked at."""
        scores, weights = network(torch.from_numpy(batch[0])), torch.from_numpy(batch[1])
        squares = (torch.softmax(scores, dim=1) - weights).square().mean()
        return {"entropy": nn.functional.cross_entropy(scores, weights), "square_seen": squares}

    def check(self, network: nn.Module) -> dict[str, float]:
        """Mean squared errors of weights on the validation set."""
        return {f"mse {stance}": weight_error(network, self.judged, lifts) for stance, lifts in STANCES.items()}


@torch.no_grad()
def weight_error(network: nn.Module, bodies: Wardrobe, lifts: tuple[float, ...]) -> float:
    """Mean squared error of the weights of 2,000 points of every body in a stance, true joints given."""
    squares = []
    for body in range(len(bodies.joints)):
        draw = np.random.default_rng([body, 11])
        samples = draw.integers(SAMPLES, size=2000)
        points, weights, joints, turns = resting(bodies, body, still_poses(1, draw, lifts)[0], samples, 0.0)
        found = torch.softmax(network(torch.from_numpy(field_features(points, joints, turns))), dim=1)
        squares.append(float(((found.numpy() - weights) ** 2).mean()))
    return float(np.mean(squares))


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
