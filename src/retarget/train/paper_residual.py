"""Recipe of the network in the manner of R2ET: no pairs; a copied pose is changed so that joints stay as far from each other as on the source
(skeleton), limbs leave the trunk, and those near it on the source are near it (shape).

Terms and weights after its published code: distance matrices 100, closeness to the copied and to the first part's pose 1, the gate .005,
repulsion and attraction .5. Left out: its critic (weight 2), which keeps what learns from joint places alone from looking odd; here
rotations are copied at the start. Attraction is to the source's distance where that is small; the code's is to none.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from retarget.contact.interaction_field import PARTS
from retarget.contact.sensor_bones import BONES
from retarget.contact.sensors import paper_layout
from retarget.evaluate.reference.interaction_bodies import CHEST, ReferenceBody, bodies_of, shapes_of
from retarget.evaluate.reference.interaction_networks import distance_shares, placed, posed_sensors
from retarget.evaluate.reference.residual_network import ResidualRetargeter, hull_distance
from retarget.evaluate.reference.scan_networks import matrices
from retarget.evaluate.scan_split import TRAINING
from retarget.methods.scan.features import PARENTS
from retarget.train.export import save_reference
from retarget.train.interaction_takes import keep_takes
from retarget.train.loop import Recipe, Settings
from retarget.train.paper_interaction import TAKES, performances_of

Array = np.ndarray

SEMANTIC, CLOSE, GATE, FIELD = 100.0, 1.0, 0.005, 0.5
REPEL, ATTRACT, REACH = 1000.0, 1000.0, 0.05
"""Weights of squared metres inside the hull, and off the source's distance, within so many metres of the hull on the source."""
OPENED = 0.4
"""Chance that the gate counts as open."""
SETTINGS = Settings(steps=2_500, batch=64, rate=1e-3, decay=0.0, warm=100, every=100, checks=20_000)


class ResidualRecipe(Recipe):
    """R2ET's ideas on performances of training takes."""

    name: ClassVar[str] = "paper-r2et"

    def __init__(self, performances: list[tuple[Array, int]], bodies: list[ReferenceBody]) -> None:
        self.performances, self.bodies = performances, bodies
        self.parents = torch.from_numpy(PARENTS)
        limbs = [bone for limb in ("leftArm", "rightArm", "leftLeg", "rightLeg") for bone in PARTS[limb] if "UpperLeg" not in bone]
        self.limbs = torch.from_numpy(np.flatnonzero(np.isin(bodies[0].sensors.layout.bones, [BONES.index(bone) for bone in limbs])))

    def network(self) -> nn.Module:
        """Fresh."""
        return ResidualRetargeter()

    def batch(self, number: int, count: int) -> Any:
        """Single frames, and both bodies."""
        draw = np.random.default_rng([number, 59])
        turns, sources, targets = [], [], []
        for _ in range(count):
            performed, source = self.performances[int(draw.integers(len(self.performances)))]
            turns.append(performed[int(draw.integers(len(performed)))])
            sources.append(source)
            targets.append(source if draw.random() < 0.5 else int(draw.integers(len(self.bodies))))
        pairs = [[self.bodies[each] for each in chosen] for chosen in (sources, targets)]
        opened = torch.from_numpy(draw.random(count) < OPENED)
        return torch.from_numpy(np.stack(turns)), [bodies_of(each) for each in pairs], [shapes_of(each) for each in pairs], opened

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Both parts' terms."""
        q, bodies, shapes, opened = batch
        made, base, gate = network(q, tuple(each.offsets for each in bodies), tuple(shapes), opened)
        source = placed(self.parents, matrices(q)[:, None], bodies[0])
        middle = placed(self.parents, matrices(base)[:, None], bodies[1])
        last = placed(self.parents, matrices(made)[:, None], bodies[1])
        own, there = (self._distances(*each) for each in ((source, bodies[0], shapes[0]), (last, bodies[1], shapes[1])))
        near = (own < REACH) & (own > 0)
        semantic = (distance_shares(source[1]) - distance_shares(middle[1])).square().sum(dim=(2, 3)).mean()
        return {
            "semantic": SEMANTIC * semantic,
            "close": CLOSE * ((made - base).square().sum(dim=(1, 2)).mean() + (base - q).square().sum(dim=(1, 2)).mean()),
            "gate": GATE * gate.square().sum(dim=1).mean(),
            "repulsion": FIELD * REPEL * torch.relu(torch.clamp(own, max=0.0) - there).square().sum(dim=1).mean(),
            "attraction": FIELD * ATTRACT * (near * (there - own).square()).sum(dim=1).mean(),
        }

    def _distances(self, pose: tuple[Tensor, Tensor], bodies: Any, shapes: Any) -> Tensor:
        where, _ = posed_sensors(*pose, self.parents, bodies)
        return hull_distance(where[:, 0, self.limbs], pose[0][:, 0, CHEST], pose[1][:, 0, CHEST], shapes)


def recipe(data: Path | None, cache: Path) -> ResidualRecipe:
    """The recipe; takes are made, and kept, in `cache`."""
    import os

    return ResidualRecipe(*performances_of(keep_takes(TRAINING, TAKES, data, cache, os.cpu_count() or 1), paper_layout()))


def export(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """Write the network's weights into a folder; `told` goes with them."""
    save_reference(network, folder, told)
