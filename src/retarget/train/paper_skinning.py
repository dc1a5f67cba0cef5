"""Recipe of the paper's skinning predictor (SKIN): pairs of a T pose and another pose of one body, point by point, and the
rotations between them (section 3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.body.kinematics import forward
from retarget.evaluate.reference.scan_networks import SkinningPredictor, skinned
from retarget.methods.scan.features import JOINTS
from retarget.train.data import SAMPLES, CloudMaker, prepare_clouds
from retarget.train.export import save_reference
from retarget.train.loop import Recipe, Settings
from retarget.train.poses import drawn_poses, still_poses
from retarget.train.skinning_field import resting

Array = np.ndarray

POINTS = 256
"""Of every body in a batch."""
AUTHORS_EXAMPLES = 200 * 63_520
SETTINGS = Settings(steps=2_000, batch=24, rate=1e-3, decay=0.0, every=200, checks=2000)


@dataclass(frozen=True, eq=False)
class PaperSkinningRecipe(Recipe):
    """SKIN on training bodies."""

    name: ClassVar[str] = "paper-skin"
    maker: CloudMaker

    def network(self) -> nn.Module:
        """Fresh, .08 million weights."""
        return SkinningPredictor()

    def batch(self, number: int, count: int) -> tuple[Array, ...]:
        """Points and joints in a T pose; turns from it and places of joints in another pose; points and weights there.

        Fingers stay as they are in the T pose: the network has 22 joints.
        """
        draw = np.random.default_rng([number, 17])
        rows = [self._pair(int(body), draw) for body in draw.integers(len(self.maker.wardrobe.joints), size=count)]
        return tuple(np.stack(column).astype(np.float32) for column in zip(*rows))

    def _pair(self, body: int, draw: np.random.Generator) -> tuple[Array, ...]:
        own, parents = self.maker.wardrobe, human_model().parents
        samples = draw.integers(SAMPLES, size=POINTS)
        stance = still_poses(1, draw, (48.0,))[0]
        points, weights, joints, before = resting(own, body, stance, samples, 0.0)
        rotations = drawn_poses(self.maker.poses, 1, draw)[0]
        rotations[JOINTS:] = rot.IDENTITY
        posed, _, _, _ = resting(own, body, rotations, samples, 0.0)
        offsets = own.joints[body] - np.where(parents[:, None] >= 0, own.joints[body][parents], 0.0)
        turns, places = forward(parents, rotations, offsets)
        after = np.matmul(rot.to_matrix(turns[:JOINTS]), before.transpose(0, 2, 1))
        return points, joints, after, places[:JOINTS], posed, weights

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Mean squared distance between skinned and posed points; the error of the weights is only looked at."""
        points, joints, turns, places, posed, weights = (torch.from_numpy(each) for each in batch)
        found = network(points, joints)
        away = skinned(points, found, joints, turns, places) - posed
        return {"square": away.square().mean(), "weights_seen": (found - weights).square().mean()}


def recipe(data: Path | None, cache: Path) -> PaperSkinningRecipe:
    """The recipe over clips below `data`, with bodies baked into `cache`."""
    return PaperSkinningRecipe(prepare_clouds("training", data, cache))


def export(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """Write the weights into a folder; `told` goes with them."""
    save_reference(network, folder, told)
