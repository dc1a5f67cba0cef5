"""Recipe of the paper's interaction network (MeshRet): no pairs, the source's rotations and its field are the supervision (eq. 5 to 9).

Losses and their weights are the paper's: rotations 1, the field's cosines 5 (a sum over pairs, a mean over frames), a critic 1, turns of end
effectors 1; half of the targets are the performer itself. The critic learns in the same step, from its own term. Clips are those that
`interaction_takes.py` makes, 30 frames of them, fingers left out. Sizes are smaller than the paper's: `TRAINED`, and `NEAREST` + `FARTHEST` targets
a row instead of 10 + 10.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from retarget.body import rotations as rot
from retarget.contact.interaction_field import prepare_field
from retarget.contact.sensors import paper_layout
from retarget.evaluate.reference.interaction_bodies import ReferenceBody, bodies_of, reference_body
from retarget.evaluate.reference.interaction_networks import (
    JOINTS,
    TRAINED,
    MeshRet,
    RotationCritic,
    distance_shares,
    entries_of,
    field_of,
    orthonormal,
    placed,
    posed_sensors,
    six_numbers,
)
from retarget.evaluate.scan_split import TRAINING
from retarget.methods.scan.features import PARENTS
from retarget.train.export import save_reference
from retarget.train.interaction_takes import keep_takes
from retarget.train.loop import Recipe, Settings

Array = np.ndarray

FRAMES, TAKES = 30, 64
NEAREST, FARTHEST = 4, 4
WEIGHTS = {"rotations": 1.0, "field": 5.0, "real": 1.0, "effectors": 1.0}
DISTANCES = 1e4
"""Weight of R2ET's distance-matrix loss in the field's place: about as large as the field's at the start."""
EFFECTORS = (5, 9, 12, 17, 20)
"""Head, hands, feet."""
SETTINGS = Settings(steps=1_200, batch=4, rate=5e-4, decay=0.0, warm=100, every=50, checks=20_000)


class Players(nn.Module):
    """The network and its critic."""

    def __init__(self, network: MeshRet) -> None:
        super().__init__()
        self.retargeter, self.critic = network, RotationCritic()


class PaperInteractionRecipe(Recipe):
    """MeshRet on performances of training takes."""

    name: ClassVar[str] = "paper-meshret"

    def __init__(self, performances: list[tuple[Array, int]], bodies: list[ReferenceBody], nearest: int, distances: bool) -> None:
        self.performances, self.bodies = performances, bodies
        self.nearest, self.farthest = nearest, NEAREST + FARTHEST - nearest
        self.distances = distances
        self.parents = torch.from_numpy(PARENTS)

    def network(self) -> nn.Module:
        """Fresh; the critic's weights too."""
        layout = self.bodies[0].sensors.layout
        numbers = (torch.from_numpy(each.astype(np.float32)) for each in (layout.along, layout.around))
        return Players(MeshRet(*numbers, torch.from_numpy(layout.bones), TRAINED))

    def batch(self, number: int, count: int) -> Any:
        """Rotations of performances, both bodies, and which pairs of sensors are compared."""
        draw = np.random.default_rng([number, 53])
        rotations, sources, targets = [], [], []
        for _ in range(count):
            performed, source = self.performances[int(draw.integers(len(self.performances)))]
            start = int(draw.integers(max(1, len(performed) - FRAMES + 1)))
            frames = np.minimum(np.arange(start, start + FRAMES), len(performed) - 1)
            rotations.append(performed[frames])
            sources.append(source)
            targets.append(source if draw.random() < 0.5 else int(draw.integers(len(self.bodies))))
        local = torch.from_numpy(rot.to_matrix(np.stack(rotations).astype(np.float64)).astype(np.float32))
        here, there = (bodies_of([self.bodies[each] for each in chosen]) for chosen in (sources, targets))
        with torch.no_grad():
            where, frames = posed_sensors(*placed(self.parents, local, here), self.parents, here)
        chosen = []
        for clip, (source, target) in enumerate(zip(sources, targets)):
            plan = prepare_field(self.bodies[source].sensors, self.bodies[target].sensors, self.nearest, self.farthest)
            chosen.append(plan.select(where[clip].numpy().astype(np.float64)))
        return local, here, there, field_of(where, frames, entries_of(plan, chosen)), entries_of(plan, chosen)

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """The terms of eq. 5, and the critic's own."""
        local, source, target, seen, entries = batch
        given = six_numbers(local)
        made = orthonormal(network.retargeter(given, seen, entries, source, target))
        said = six_numbers(made)
        (own_turns, own_places), (turns, places) = placed(self.parents, local, source), placed(self.parents, made, target)
        there = field_of(*posed_sensors(turns, places, self.parents, target), entries)
        cosines = nn.functional.cosine_similarity(seen, there, dim=-1, eps=1e-6) * entries.both
        if self.distances:
            field = DISTANCES * (distance_shares(own_places) - distance_shares(places)).square().sum(dim=(2, 3)).mean()
        else:
            field = -cosines.sum(dim=(2, 3)).mean()
        effectors = [turn[:, :, EFFECTORS] for turn in (own_turns, turns)]
        fixed = {name: value.detach() for name, value in network.critic.named_parameters()}
        judged = torch.func.functional_call(network.critic, fixed, (said,))
        real, fake = network.critic(given), network.critic(said.detach())
        softplus = nn.functional.softplus
        return {
            "rotations": WEIGHTS["rotations"] * (said - given).square().sum(dim=(2, 3)).mean(),
            "field": WEIGHTS["field"] * field,
            "real": WEIGHTS["real"] * softplus(-judged).mean(),
            "effectors": WEIGHTS["effectors"] * (effectors[0] - effectors[1]).square().sum(dim=(3, 4)).clamp(min=1e-9).sqrt().mean(),
            "critic": softplus(-real).mean() + softplus(fake).mean(),
            "cosine_seen": cosines.sum() / entries.both.sum(),
        }  # fmt: skip


def performances_of(paths: list[Path], layout: Any) -> tuple[list[tuple[Array, int]], list[ReferenceBody]]:
    """What is performed in files of takes (local rotations of the 22 joints, and by which body), and all embedded bodies in them."""
    performances, shapes, bodies = [], {}, []
    for path in paths:
        with np.load(path) as stored:
            seen = set()
            for place in range(sum(name.startswith("turned_") for name in stored.files)):
                for name in ("source", "target"):
                    shape = tuple(map(tuple, stored[f"{name}_{place}"]))
                    if shape not in shapes and "file" not in dict(shape):
                        shapes[shape] = len(bodies)
                        bodies.append(reference_body(dict(shape), layout))
                performed = stored[f"performed_{place}"][:, :JOINTS]
                mark = performed.tobytes()
                if mark not in seen:
                    seen.add(mark)
                    performances.append((performed, shapes[tuple(map(tuple, stored[f"source_{place}"]))]))
    return performances, bodies


def recipe(
    data: Path | None, cache: Path, nearest: int = NEAREST, along: int = 4, around: int = 4, distances: bool = False
) -> PaperInteractionRecipe:
    """The recipe; takes are made, and kept, in `cache`. The rest are the paper's ablations: `nearest` of the eight targets of a row, places
    along bones and around them, and the distance-matrix loss in the field's place."""
    import os

    paths = keep_takes(TRAINING, TAKES, data, cache, os.cpu_count() or 1)
    return PaperInteractionRecipe(*performances_of(paths, paper_layout(along, around)), nearest, distances)


def export(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """Write the network's weights into a folder; `told` goes with them. The critic has done its work."""
    save_reference(network.retargeter, folder, told)
