"""Recipe of the paper's skeleton regressor (SKR): joints of points drawn from clouds, by their mean squared error (eq. 1).

Ours: the data (`data.py`; the paper has uniform samples of clean bodies), and how long it is trained. The bone-length loss,
which the paper tried and left out, can be switched on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from retarget.evaluate.reference.scan_networks import SkeletonRegressor
from retarget.evaluate.reference.scan_pipeline import POINTS
from retarget.methods.scan.features import PARENTS, Clouds
from retarget.train.data import CloudMaker, prepare_clouds
from retarget.train.export import save_reference
from retarget.train.loop import Recipe, Settings

Array = np.ndarray

AUTHORS_EXAMPLES = 100 * 63_520
"""What the authors' network saw."""
SETTINGS = Settings(steps=1_400, batch=32, rate=1e-3, decay=0.0, rough=0.8, every=100, checks=1000)


@dataclass(frozen=True, eq=False)
class PaperRegressorRecipe(Recipe):
    """SKR on the training set."""

    name: ClassVar[str] = "paper-skr"
    maker: CloudMaker
    judge: CloudMaker
    bone_weight: float = 0.0
    """Of the mean squared error of bones' lengths."""

    def network(self) -> nn.Module:
        """Fresh, 1.6 million weights."""
        return SkeletonRegressor()

    def batch(self, number: int, count: int) -> tuple[Array, Array]:
        """Points (clouds, points, 3) and joints, from the clouds' middles."""
        clouds, truth = self.maker.batch(number, count)
        return drawn_points(clouds, number), truth.places

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Mean squared error; the mean distance is only looked at."""
        found, true = network(torch.from_numpy(batch[0])), torch.from_numpy(batch[1])
        terms = {"square": (found - true).square().mean(), "away_seen": (found - true).norm(dim=-1).mean()}
        if self.bone_weight:
            lengths = [(each[:, 1:] - each[:, PARENTS[1:]]).norm(dim=-1) for each in (found, true)]
            terms["bones"] = self.bone_weight * (lengths[0] - lengths[1]).square().mean()
        return terms

    @torch.no_grad()
    def check(self, network: nn.Module) -> dict[str, float]:
        """Mean distance of joints on clean validation clouds, mm."""
        clouds, truth = self.judge.batch(0, 256, "clean")
        found = network(torch.from_numpy(drawn_points(clouds, 0)))
        return {"clean_mm": float(1000 * (found - torch.from_numpy(truth.places)).norm(dim=-1).mean())}


def drawn_points(clouds: Clouds, number: int) -> Array:
    """Some points of each thinned cloud (with repetition)."""
    draw = np.random.default_rng([number, 13])
    counts = clouds.firsts[np.arange(len(clouds.blocks)), clouds.blocks]
    chosen = (draw.random((len(counts), POINTS)) * counts[:, None]).astype(np.int64)
    return np.take_along_axis(clouds.places, chosen[..., None], axis=1)


def recipe(data: Path | None, cache: Path, bone_weight: float = 0.0) -> PaperRegressorRecipe:
    """The recipe over clips below `data`, with bodies baked into `cache`."""
    judge = prepare_clouds("validation", data, cache, seed=1)
    return PaperRegressorRecipe(prepare_clouds("training", data, cache), judge, bone_weight)


def export(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """Write the weights into a folder; `told` goes with them."""
    save_reference(network, folder, told)
