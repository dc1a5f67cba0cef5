"""A network in the manner of R2ET (Zhang et al. 2023, "Skinned motion retargeting with residual perception of motion semantics and
geometry"), to measure against: copied rotations, changed a little by what skeletons ask and then by what shapes ask.

After its published code: tokens of joints through two one-layer transformers give the skeleton's residual; four limb networks and a
gate give the shape's, from rotations and the boxes around the skin of each joint. Ours: both parts learn together, and the distance
field is that of planes around the trunk and head at rest, which go with the chest (the code samples a grid inside the same hull). Needs
torch: import only where used.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

JOINTS = 22
TOKEN = 64
LIMBS = {"leftArm": (7, 8, 9), "rightArm": (15, 16, 17), "leftLeg": (10, 11), "rightLeg": (18, 19)}
"""Joints that each limb network turns (embedded human's order)."""
SHARE = 0.8
"""Of the gate, in use."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Bodies as this network sees them."""

    boxes: Float[Tensor, "bodies joints 3"]
    """Edges of the boxes around what each joint carries at rest, metres."""
    normals: Float[Tensor, "bodies planes 3"]
    """Outward, of the hull of trunk and head at rest."""
    levels: Float[Tensor, "bodies planes"]
    """How far each plane is from the rest place of the chest."""


class ResidualRetargeter(nn.Module):
    """Local rotations of the target from those of the source (quaternions xyzw)."""

    def __init__(self) -> None:
        super().__init__()
        self.turn_token, self.bone_token = nn.Linear(4, TOKEN), nn.Linear(3, TOKEN)
        self.place = nn.Parameter(0.02 * torch.randn(JOINTS, TOKEN))
        options = dict(dim_feedforward=2 * TOKEN, dropout=0.0, batch_first=True)
        self.turns = nn.TransformerEncoderLayer(TOKEN, 4, **options)
        self.bones = nn.TransformerEncoderLayer(TOKEN, 2, **options)
        self.pool_turns, self.pool_bones = nn.Linear(JOINTS * TOKEN, 256), nn.Linear(JOINTS * TOKEN, 128)
        self.skeleton = nn.Sequential(nn.Linear(512 + TOKEN, 128), nn.ReLU(), nn.Linear(128, 4))
        seen = JOINTS * (4 + 3 + 3)
        self.limbs = nn.ModuleList(
            nn.Sequential(nn.Linear(seen, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 4 * len(own)))
            for own in LIMBS.values()
        )
        self.gate = nn.Sequential(
            nn.Linear(seen, 512), nn.ReLU(), nn.Linear(512, 512), nn.ReLU(), nn.Linear(512, 256), nn.ReLU(), nn.Linear(256, JOINTS)
        )
        for net in (self.skeleton, *self.limbs):
            nn.init.normal_(net[-1].weight, std=1e-3)
            nn.init.zeros_(net[-1].bias)

    def forward(
        self, q: Float[Tensor, "frames joints 4"], offsets: tuple[Tensor, Tensor], shapes: tuple[Shapes, Shapes],
        opened: Bool[Tensor, "frames"] | None = None,
    ) -> tuple[Float[Tensor, "frames joints 4"], Float[Tensor, "frames joints 4"], Float[Tensor, "frames joints"]]:
        """Rotations after both residuals, after the skeleton's alone, and the gate. `offsets` of source and target are (frames, joints, 3),
        metres; where `opened`, the gate counts as open (training)."""
        scale = 1.0 / offsets[0].abs().sum(dim=(1, 2), keepdim=True), 1.0 / offsets[1].abs().sum(dim=(1, 2), keepdim=True)
        tokens = self.turn_token(q) + self.place
        bodies = [self.pool_bones(self.bones(self.bone_token(20 * own * by) + self.place).flatten(1)) for own, by in zip(offsets, scale)]
        whole = torch.cat([self.pool_turns(self.turns(tokens).flatten(1)), *bodies], dim=1)
        asked = torch.cat([whole[:, None].expand(-1, JOINTS, -1), tokens], dim=2)
        base = product(q, _turn(self.skeleton(asked)))
        boxes = [(20 * shape.boxes * by).flatten(1) for shape, by in zip(shapes, scale)]
        seen = torch.cat([base.flatten(1), *boxes], dim=1)
        gate = torch.sigmoid(self.gate(seen))
        much = gate * SHARE if opened is None else torch.where(opened[:, None], torch.ones_like(gate), gate)
        made = base.clone()
        for net, own in zip(self.limbs, LIMBS.values()):
            turned = product(base[:, own], _turn(net(seen).unflatten(1, (len(own), 4))))
            sign = torch.where((turned * base[:, own]).sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
            mixed = base[:, own] + much[:, own, None] * (sign * turned - base[:, own])
            made[:, own] = nn.functional.normalize(mixed, dim=-1)
        return made, base, gate


def product(a: Float[Tensor, "*batch 4"], b: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Hamilton's product of quaternions xyzw."""
    u, v, s, t = a[..., :3], b[..., :3], a[..., 3:], b[..., 3:]
    return torch.cat([s * v + t * u + torch.linalg.cross(u, v), s * t - (u * v).sum(dim=-1, keepdim=True)], dim=-1)


def hull_distance(
    points: Float[Tensor, "frames points 3"], chest_turns: Float[Tensor, "frames 3 3"], chest: Float[Tensor, "frames 3"], shapes: Shapes
) -> Float[Tensor, "frames points"]:
    """Signed distance to the hull of trunk and head: exact inside, where it is negative."""
    local = torch.matmul(points - chest[:, None], chest_turns)
    return (torch.matmul(local, shapes.normals.transpose(1, 2)) - shapes.levels[:, None]).amax(dim=2)


def _turn(change: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """A unit quaternion near none."""
    return nn.functional.normalize(change + torch.tensor([0.0, 0.0, 0.0, 1.0]), dim=-1)
