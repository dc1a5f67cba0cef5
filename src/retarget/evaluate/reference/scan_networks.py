"""The three networks of Rekik et al. 2023, "Correspondence-free online human motion retargeting", as printed, to measure
against: SKR (joints of a cloud), SMRM (motion of one skeleton to another) and SKIN (skinning weights of a point).

The tables of the supplement have lost their numbers; sizes are those that give the printed counts of parameters: 1.6,
5.8 and .2 million, the last of which no three layers of 256 give (theirs would have .08). What the paper leaves open, or
its text has lost, is marked as ours. Needs torch: import only where used.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

JOINTS = 22
CONTEXT = 30
"""Frames of a training sequence: one second."""
RATE = 30.0
"""Frames a second: inside the network moves are metres a second, or they would be small beside joints and hardly be learnt (ours)."""
FEWEST_CHANGES = 8
"""That the critic reads; shorter sequences stand still at their end."""


class InputTransform(nn.Module):
    """PointNet's 3 x 3 transform of a cloud (Qi et al. 2017); batch normalisation as there. .80 million weights."""

    def __init__(self) -> None:
        super().__init__()
        self.points = nn.Sequential(*_shared(3, 64), *_shared(64, 128), *_shared(128, 1024))
        self.whole = nn.Sequential(*_layer(1024, 512), *_layer(512, 256), nn.Linear(256, 9))
        nn.init.zeros_(self.whole[-1].weight)
        nn.init.zeros_(self.whole[-1].bias)

    def forward(self, points: Float[Tensor, "clouds 3 points"]) -> Float[Tensor, "clouds 3 3"]:
        """One matrix a cloud, near the identity at first."""
        found = self.whole(self.points(points).amax(dim=2)).reshape(-1, 3, 3)
        return found + torch.eye(3, dtype=found.dtype)


class SkeletonRegressor(nn.Module):
    """SKR (section 3.2, table 5): a cloud's 22 joints by a PointNet. 1.61 million weights, batch normalisation apart.

    Table 5 also has a transform of features; the usual one, 64 x 64, would make 3.5 million weights of it, so it is
    left out. The share of dropout is PointNet's.
    """

    def __init__(self) -> None:
        super().__init__()
        self.transform = InputTransform()
        self.points = nn.Sequential(*_shared(3, 64), *_shared(64, 128), nn.Conv1d(128, 1024, 1))
        inner = (nn.Linear(512, 256), nn.Dropout(0.3), nn.ReLU())
        self.whole = nn.Sequential(*_layer(1024, 512), *inner, nn.Linear(256, 3 * JOINTS))

    def forward(self, points: Float[Tensor, "clouds points 3"]) -> Float[Tensor, "clouds joints 3"]:
        """Joints in the cloud's own axes and unit. Clouds come centred (ours: the paper does not say)."""
        turned = torch.matmul(self.transform(points.transpose(1, 2)).transpose(1, 2), points.transpose(1, 2))
        return self.whole(self.points(turned).amax(dim=2)).reshape(-1, JOINTS, 3)


class MotionRetargeter(nn.Module):
    """SMRM (section 3.3, table 6): two recurrent networks of two layers of 512, no feedback of frames. 5.77 million weights.

    Its inputs: joints relative to the root and the root's move since the frame before (ours: which "displacement" it is is
    not said; a move does not depend on where a clip begins). Its outputs: local rotations, and the target's move.
    """

    def __init__(self, dropout: float = 0.2) -> None:
        super().__init__()
        self.encoder = nn.GRU(3 * JOINTS + 3, 512, num_layers=2, batch_first=True, dropout=dropout)
        self.decoder = nn.GRU(512 + 3 * JOINTS, 512, num_layers=2, batch_first=True, dropout=dropout)
        self.rotations, self.move = nn.Linear(512, 4 * JOINTS), nn.Linear(512, 3)
        nn.init.normal_(self.rotations.weight, std=0.002)
        nn.init.zeros_(self.rotations.bias)
        self.rotations.bias.data[3::4] = 1.0

    def forward(
        self,
        joints: Float[Tensor, "clips frames joints 3"],
        moves: Float[Tensor, "clips frames 3"],
        target: Float[Tensor, "clips joints 3"],
    ) -> tuple[Float[Tensor, "clips frames joints 4"], Float[Tensor, "clips frames 3"]]:
        """Unit quaternions (xyzw) of the target's joints, and its root's moves, metres a frame. `target` are its joints in the
        T pose, relative to the root."""
        read, _ = self.encoder(torch.cat([joints.flatten(2), RATE * moves], dim=2))
        skeleton = target.flatten(1)[:, None].expand(-1, joints.shape[1], -1)
        written, _ = self.decoder(torch.cat([read, skeleton], dim=2))
        turns = self.rotations(written).reshape(*joints.shape[:3], 4)
        return nn.functional.normalize(turns, dim=-1), self.move(written) / RATE


class MotionCritic(nn.Module):
    """The network that tells real motions from retargeted ones (Villegas et al. 2018, whose discriminator this is): strided
    convolutions over changes of joints and moves, with the skeleton beside them."""

    def __init__(self) -> None:
        super().__init__()
        widths = (6 * JOINTS + 3, 32, 64, 128)
        layers: list[nn.Module] = []
        for inner, outer in zip(widths, widths[1:]):
            layers += [nn.Conv1d(inner, outer, 4, stride=2, padding=1), nn.LeakyReLU(0.2)]
        self.layers = nn.Sequential(*layers, nn.Conv1d(128, 1, 1))

    def forward(
        self,
        joints: Float[Tensor, "clips frames joints 3"],
        moves: Float[Tensor, "clips frames 3"],
        target: Float[Tensor, "clips joints 3"],
    ) -> Float[Tensor, "clips windows"]:
        """Scores, higher for what looks real."""
        changes = (joints[:, 1:] - joints[:, :-1]).flatten(2)
        skeleton = target.flatten(1)[:, None].expand(-1, changes.shape[1], -1)
        seen = torch.cat([changes, moves[:, 1:], skeleton], dim=2).transpose(1, 2)
        short = max(FEWEST_CHANGES - seen.shape[2], 0)  # three strides leave nothing of the shortest contexts (ours)
        return self.layers(nn.functional.pad(seen, (0, short), mode="replicate")).squeeze(1)


class SkinningPredictor(nn.Module):
    """SKIN (section 3.4, table 7): from a point's distances to the 22 joints to its weights, three layers of 256. .08 million
    weights; the share of dropout is ours."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(JOINTS, 256), nn.ReLU(), nn.Dropout(0.1),
            nn.Linear(256, 256), nn.ReLU(), nn.Dropout(0.1),
            nn.Linear(256, JOINTS),
        )  # fmt: skip

    def forward(
        self, points: Float[Tensor, "bodies points 3"], joints: Float[Tensor, "bodies joints 3"]
    ) -> Float[Tensor, "bodies points joints"]:
        """Weights that sum to one; points and joints in a T pose, metres."""
        return torch.softmax(self.layers(torch.cdist(points, joints)), dim=-1)


def forward_kinematics(
    parents: Int[Tensor, "joints"],
    rotations: Float[Tensor, "*batch joints 4"],
    offsets: Float[Tensor, "*batch joints 3"],
) -> tuple[Float[Tensor, "*batch joints 3 3"], Float[Tensor, "*batch joints 3"]]:
    """World rotations and places (relative to the root) of local unit quaternions; rest rotations are the identity."""
    local = matrices(rotations)
    turns, places = [local[..., 0, :, :]], [torch.zeros_like(offsets[..., 0, :])]
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        places.append(places[above] + torch.matmul(turns[above], offsets[..., joint, :, None])[..., 0])
        turns.append(torch.matmul(turns[above], local[..., joint, :, :]))
    return torch.stack(turns, dim=-3), torch.stack(places, dim=-2)


def matrices(q: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of unit quaternions xyzw."""
    x, y, z, w = q.unbind(dim=-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*q.shape[:-1], 3, 3)


def skinned(
    points: Float[Tensor, "bodies points 3"],
    weights: Float[Tensor, "bodies points joints"],
    joints: Float[Tensor, "bodies joints 3"],
    turns: Float[Tensor, "bodies joints 3 3"],
    places: Float[Tensor, "bodies joints 3"],
) -> Float[Tensor, "bodies points 3"]:
    """Linear blend skinning, for SKIN's loss: the distance between what it makes of a T pose and the posed points."""
    arms = points[:, :, None] - joints[:, None]
    moved = torch.einsum("bjac,bpjc->bpja", turns, arms) + places[:, None]
    return (weights[..., None] * moved).sum(dim=2)


def _shared(inner: int, outer: int) -> tuple[nn.Module, ...]:
    return nn.Conv1d(inner, outer, 1), nn.BatchNorm1d(outer), nn.ReLU()


def _layer(inner: int, outer: int) -> tuple[nn.Module, ...]:
    return nn.Linear(inner, outer), nn.BatchNorm1d(outer), nn.ReLU()
