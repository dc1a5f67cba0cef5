"""Recipe of the paper's motion retargeter (SMRM): from one skeleton to another and back, without pairs (section 3.5, eq. 2).

Cycle of joints, cycle of rotations (the paper's addition), a critic, and small accelerations. The weights of these terms are
lost from the text, and ours. So is one term more: now and then the target is the source itself, which must move as it does (as
Villegas et al. 2018, whose network this builds on, have it); without it two mirrorings close the cycle. The critic learns in the same step, from its own term: gradients of the other terms pass by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from retarget.body import rotations as rot
from retarget.body.human import human, human_model
from retarget.evaluate.reference.scan_networks import (
    CONTEXT,
    RATE,
    MotionCritic,
    MotionRetargeter,
    forward_kinematics,
    matrices,
)
from retarget.evaluate.scan_split import BODY_SEEDS, TRAINING
from retarget.methods.scan.features import JOINTS, PARENTS
from retarget.train.data import bake_bodies
from retarget.train.export import save_reference
from retarget.train.loop import Recipe, Settings
from retarget.train.poses import gather_motions

Array = np.ndarray

JOINT_WEIGHT, PATH_WEIGHT, ROTATION_WEIGHT, CRITIC_WEIGHT, CALM_WEIGHT = 10.0, 1.0, 1.0, 0.05, 1.0
SAME_SHARE = 0.2
"""Of sequences whose target is their source."""
AUTHORS_EXAMPLES = 1000 * 2_330
SETTINGS = Settings(steps=1_200, batch=32, rate=1e-3, decay=0.0, every=50, checks=20_000)


@dataclass(frozen=True)
class Paths:
    """Clips as the recipe needs them, end to end."""

    rotations: Array
    """(frames, joints, 4), local, of the 22 joints."""
    hips: Array
    """(frames, 3): metres on the average body."""
    starts: Array
    """Frames at which a sequence can begin."""


class Players(nn.Module):
    """The retargeter and its critic."""

    def __init__(self) -> None:
        super().__init__()
        self.retargeter, self.critic = MotionRetargeter(), MotionCritic()


class PaperMotionRecipe(Recipe):
    """SMRM on training motions and bodies."""

    name: ClassVar[str] = "paper-smrm"

    def __init__(self, data: Path | None, cache: Path, context: int = CONTEXT, rotation_weight: float = ROTATION_WEIGHT):
        self.context, self.rotation_weight = context, rotation_weight
        self.skeletons = bake_bodies(BODY_SEEDS[TRAINING], cache).joints[:, :JOINTS].astype(np.float32)
        self.paths = _paths(data, context)
        model = human_model()
        self.hips_height = float(model.joints(human().mesh.vertices)[0, 1])

    def network(self) -> nn.Module:
        """Fresh, 5.8 million weights, and the critic's."""
        return Players()

    def batch(self, number: int, count: int) -> tuple[Array, ...]:
        """Rotations and moves of sequences, and the skeletons of those who perform them, of those who shall, and of whoever
        performs a real motion for the critic; 1 where these two are one."""
        draw = np.random.default_rng([number, 19])
        frames = draw.choice(self.paths.starts, size=count)[:, None] + np.arange(self.context)
        rotations, hips = self.paths.rotations[frames].astype(np.float64), self.paths.hips[frames]
        turn = rot.from_rotation_vector(draw.uniform(0, 2 * np.pi, count)[:, None] * np.array([0.0, 1.0, 0.0]))[:, None]
        rotations[:, :, 0] = rot.multiply(turn, rotations[:, :, 0])
        bodies = self.skeletons[draw.integers(len(self.skeletons), size=(2, count))]
        scale = bodies[0][:, 0, 1] / self.hips_height
        moves = np.diff(rot.rotate(turn, hips), axis=1, prepend=rot.rotate(turn, hips[:, :1])) * scale[:, None, None]
        same = draw.uniform(size=count) < SAME_SHARE
        bodies[1][same] = bodies[0][same]
        return rotations.astype(np.float32), moves.astype(np.float32), bodies[0], bodies[1], same.astype(np.float32)

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """The terms of eq. 2, and the critic's own."""
        true_turns, moves, source, target, same = (torch.from_numpy(each) for each in batch)
        joints = performed(true_turns, source)
        turns, target_moves = network.retargeter(joints, moves, _relative(target))
        there = performed(turns, target)
        back_turns, back_moves = network.retargeter(there, target_moves, _relative(source))
        back = performed(back_turns, source)
        fixed = {name: value.detach() for name, value in network.critic.named_parameters()}
        judged = torch.func.functional_call(network.critic, fixed, (there, target_moves, _relative(target)))
        real = network.critic(joints, moves, _relative(source))
        fake = network.critic(there.detach(), target_moves.detach(), _relative(target))
        cycle = (back - joints).square().mean()
        path = (RATE * (back_moves - moves)).square().mean()
        rotations = (matrices(back_turns) - matrices(turns)).square().mean()
        alike = JOINT_WEIGHT * (there - joints).square().mean(dim=(1, 2, 3))
        alike = alike + PATH_WEIGHT * (RATE * (target_moves - moves)).square().mean(dim=(1, 2))
        calm = (there[:, 2:] - 2 * there[:, 1:-1] + there[:, :-2]).square().mean()
        calm = calm + (target_moves[:, 1:] - target_moves[:, :-1]).square().mean()
        return {
            "joints": JOINT_WEIGHT * cycle, "same": (same * alike).mean(), "path": PATH_WEIGHT * path, "rotations": self.rotation_weight * rotations,
            "real": CRITIC_WEIGHT * (judged - 1.0).square().mean(), "calm": CALM_WEIGHT * calm,
            "critic": (real - 1.0).square().mean() + fake.square().mean(),
            "away_seen": (there - performed(true_turns, target)).norm(dim=-1).mean(),
        }  # fmt: skip


def performed(rotations: Tensor, skeleton: Tensor) -> Tensor:
    """Joints (clips, frames, joints, 3), relative to the root, of local rotations on a skeleton (clips, joints, 3) at rest."""
    offsets = skeleton - torch.cat([skeleton[:, :1], skeleton[:, PARENTS[1:]]], dim=1)
    spread = offsets[:, None].expand(-1, rotations.shape[1], -1, -1)
    return forward_kinematics(torch.from_numpy(PARENTS), rotations, spread)[1]


def _relative(skeleton: Tensor) -> Tensor:
    return skeleton - skeleton[:, :1]


def _paths(data: Path | None, context: int) -> Paths:
    motions = [motion for motion in gather_motions(TRAINING, data) if len(motion) >= context]
    ends = np.cumsum([len(motion) for motion in motions])
    starts = [np.arange(end - len(motion), end - context + 1) for motion, end in zip(motions, ends)]
    rotations = np.concatenate([motion.rotations[:, :JOINTS] for motion in motions]).astype(np.float32)
    hips = np.concatenate([motion.translations[:, 0] for motion in motions])
    return Paths(rotations, hips, np.concatenate(starts))


def recipe(data: Path | None, cache: Path, **otherwise: Any) -> PaperMotionRecipe:
    """The recipe over clips below `data`, with bodies baked into `cache`; `otherwise` as `PaperMotionRecipe` takes it."""
    return PaperMotionRecipe(data, cache, **otherwise)


def export(network: nn.Module, folder: Path, told: Mapping[str, str]) -> None:
    """Write the retargeter's weights into a folder; `told` goes with them. The critic has done its work."""
    save_reference(network.retargeter, folder, told)
