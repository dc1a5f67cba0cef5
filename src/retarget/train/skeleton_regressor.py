"""Recipe of the skeleton regressor: three networks, each looking closer at a cloud than the one before.

`methods/scan/regressor.py` uses what is learnt here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from retarget.methods.scan.features import BASIS, BONES, JOINTS, ORDER, Bodies, Clouds, closer_look, first_look
from retarget.methods.scan.regressor import FILES, VERSION
from retarget.train.data import SORTS, CloudMaker, prepare_clouds
from retarget.train.export import Graph
from retarget.train.loop import Recipe, Settings

Array = np.ndarray

POSE = 9 * JOINTS + 4
"""Numbers that tell the pose found so far: places, two columns of each turn, the vertical, the size."""
INPUTS = (3 * BASIS, 3 * (BASIS + JOINTS * BONES) + POSE, 3 * JOINTS * BONES + POSE)
OUTPUTS = (9 * JOINTS, 9 * JOINTS, 10 * JOINTS)
"""Places and turns; the last look also says how far off each joint may be."""
WIDTHS, BLOCKS = (640, 768, 512), (2, 2, 2)
TURN_WEIGHT, DOUBT_WEIGHT = 0.06, 0.2
"""Of the distance between rotation matrices (Frobenius) beside that of joints (metres); of the error of the expected error."""
LOOK_WEIGHTS = (0.5, 1.0, 1.0, 1.0)
"""For every look of `features.ORDER`."""
SETTINGS = Settings(steps=6_700, batch=256, rate=1e-3, rough=0.93)


class Block(nn.Module):
    """Two layers, whose result is added to what they were given."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm, self.inner, self.outer = nn.LayerNorm(width), nn.Linear(width, width), nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(clouds, width) to the same."""
        return x + self.outer(torch.relu(self.inner(self.norm(x))))


class Look(nn.Module):
    """A residual network from features to what is to be mended."""

    def __init__(self, inputs: int, width: int, blocks: int, outputs: int) -> None:
        super().__init__()
        self.enter = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(Block(width) for _ in range(blocks))
        self.norm, self.leave = nn.LayerNorm(width), nn.Linear(width, outputs)
        nn.init.zeros_(self.leave.bias)
        self.leave.weight.data *= 0.1

    def forward(self, features: Tensor) -> Tensor:
        """(clouds, inputs) to (clouds, outputs); the last layer in single precision, always."""
        x = self.enter(features)
        for block in self.blocks:
            x = block(x)
        with torch.autocast("cpu", enabled=False):
            return self.leave(self.norm(x.float()))


class SkeletonRegressor(nn.Module):
    """The three networks; the last one looks twice."""

    def __init__(self) -> None:
        super().__init__()
        self.looks = nn.ModuleList(Look(*sizes) for sizes in zip(INPUTS, WIDTHS, BLOCKS, OUTPUTS))

    def forward(
        self, clouds: Clouds, first: Float[Array, "clouds features"] | None = None
    ) -> list[tuple[Tensor, Tensor, Tensor | None]]:
        """After each look: places (clouds, joints, 3), turns (clouds, joints, 3, 3), and the expected error of each joint after
        the last one. Gradients stay within a look. `first` is what the first look sees, where that is at hand."""
        found, steps = None, []
        for number in ORDER:
            if found is not None:
                features = closer_look(clouds, found, whole=number == 1)
            else:
                features = first_look(clouds) if first is None else first
            out = self.looks[number](torch.from_numpy(features))
            with torch.autocast("cpu", enabled=False):  # geometry in single precision
                step = moved(found, out)
            found = Bodies(step[0].detach().numpy(), step[1].detach().numpy())
            steps.append(step)
        return steps


def moved(found: Bodies | None, out: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """What the outputs of a look make of the joints found before: moves and turns are in each joint's own axes."""
    places = out[:, : 3 * JOINTS].reshape(-1, JOINTS, 3)
    six = out[:, 3 * JOINTS : 9 * JOINTS].reshape(-1, JOINTS, 6) + torch.tensor([1.0, 0, 0, 0, 1, 0])
    turns = gathered(six)
    if found is not None:
        before = torch.from_numpy(found.turns)
        moves = torch.matmul(before, places[..., None])[..., 0]
        places = torch.from_numpy(found.places) + torch.from_numpy(found.sizes) * moves
        turns = torch.matmul(before, turns)
    doubts = nn.functional.softplus(out[:, 9 * JOINTS :] - 4.0) if out.shape[1] > 9 * JOINTS else None
    return places, turns, doubts


def gathered(six: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """As `features.gathered`."""
    first = nn.functional.normalize(six[..., :3], dim=-1)
    second = six[..., 3:] - (first * six[..., 3:]).sum(dim=-1, keepdim=True) * first
    second = nn.functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


class SkeletonRecipe(Recipe):
    """Joints and turns of clouds of the training set; looks at the validation set."""

    name: ClassVar[str] = "skeleton-regressor"

    def __init__(self, data: Path | None, cache: Path, bodies: int | None = None) -> None:
        self.maker = prepare_clouds("training", data, cache, bodies=bodies)
        self.judge = prepare_clouds("validation", data, cache, seed=1)

    def network(self) -> nn.Module:
        """Fresh, 8.8 million weights."""
        return SkeletonRegressor()

    def batch(self, number: int, count: int) -> tuple[Clouds, Bodies, Array]:
        """Clouds with all troubles, their true joints, and what the first look sees."""
        clouds, truth = self.maker.batch(number, count)
        return clouds, truth, first_look(clouds)

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Distances of joints (metres) and of turns after each look, and how wrong the expected errors are."""
        clouds, truth, first = batch
        places, turns = torch.from_numpy(truth.places), torch.from_numpy(truth.turns)
        terms: dict[str, Tensor] = {}
        for number, (weight, (found, turned, doubts)) in enumerate(zip(LOOK_WEIGHTS, network(clouds, first)), 1):
            away = (found - places).norm(dim=-1)
            terms[f"joints_{number}"] = weight * away.mean()
            terms[f"turns_{number}"] = weight * TURN_WEIGHT * ((turned - turns).square().sum(dim=(-2, -1)) + 1e-8).sqrt().mean()
            if doubts is not None:
                terms[f"doubts_{number}"] = DOUBT_WEIGHT * (doubts - away.detach()).abs().mean()
        return terms

    def check(self, network: nn.Module) -> dict[str, float]:
        """Mean errors (mm, degrees) on the validation set, for each sort of trouble."""
        pure = replace(self.judge, made_up=False)
        found = {name: value for sort in SORTS for name, value in errors(network, pure, sort).items()}
        return found | {f"made_up_{name}": value for name, value in errors(network, self.judge, "clean").items()}


@torch.no_grad()
def errors(network: nn.Module, maker: CloudMaker, sort: str, batches: int = 2, count: int = 256) -> dict[str, float]:
    """Mean distance of joints (mm) after every look, mean turn error (degrees), the share of bodies whose hips are turned by more
    than 90 degrees (percent)."""
    away, turned = [], []
    for number in range(batches):
        clouds, truth = maker.batch(number, count, sort)
        steps = network(clouds)
        away.append([np.linalg.norm(step[0].numpy() - truth.places, axis=-1).mean() for step in steps])
        cosine = 0.5 * (np.einsum("cjab,cjab->cj", steps[-1][1].numpy(), truth.turns) - 1.0)
        turned.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    angles = np.concatenate(turned)
    mean = 1000.0 * np.mean(away, axis=0)
    looks = {f"{sort}_look_{number}_mm": float(value) for number, value in enumerate(mean[:-1], 1)}
    return looks | {
        f"{sort}_mm": float(mean[-1]), f"{sort}_deg": float(angles.mean()),
        f"{sort}_flips": float(100.0 * (angles[:, 0] > 90.0).mean()),
    }  # fmt: skip


def recipe(data: Path | None, cache: Path) -> SkeletonRecipe:
    """The recipe over clips below `data`, with bodies baked into `cache`."""
    return SkeletonRecipe(data, cache)


def export(network: SkeletonRegressor, folder: Path, told: Mapping[str, str]) -> None:
    """Write the three looks as ONNX files into a folder; `told` goes into them too."""
    for look, name, inputs, outputs in zip(network.looks, FILES, INPUTS, OUTPUTS):
        graph = Graph()
        x = graph.linear(look.enter, "features")
        for block in look.blocks:
            inner = graph.apply("Relu", [graph.linear(block.inner, graph.norm(block.norm, x))])
            x = graph.apply("Add", [x, graph.linear(block.outer, inner)])
        x = graph.linear(look.leave, graph.norm(look.norm, x))
        graph.save(folder / name, x, inputs, outputs, {"network": SkeletonRecipe.name, "version": VERSION, **told})
