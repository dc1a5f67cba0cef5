"""The network of Ye et al. 2024, "Skinned motion retargeting with dense geometric interaction perception" (MeshRet), as printed, to
measure against: geometry encoders, encoders of the dense interaction field, a transformer with frame-aligned cross-attention.

No code or weights were released. What the paper leaves open, and our choices: the discriminator (strided convolutions over rotations);
how groups are joined (one linear layer); sines and cosines of places in time for the transformer; and that what comes out is added to the
source's rotations, which the paper does not say: trained for minutes instead of 40 hours, it would else learn to copy before all. Sizes
are arguments, the paper's the defaults. Needs torch: import only where used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from retarget.contact.interaction_field import GROUPS, PARTS, FieldPlan, Selection
from retarget.contact.sensor_bones import BONES

JOINTS = 22
EMBEDDING = 8
GEOMETRY = {"body": ("torso",), "head": ("head",), "arms": ("leftArm", "rightArm"), "legs": ("leftLeg", "rightLeg")}
"""Parts that share a geometry encoder."""


@dataclass(frozen=True)
class Sizes:
    """How large the network is."""

    width: int = 256
    layers: int = 6
    """Of every PointNet."""
    blocks: int = 8
    """Of the transformer's encoder and decoder each."""
    heads: int = 4


TRAINED = Sizes(width=48, layers=3, blocks=2)
"""What is trained here: a fifth of the width, half and a quarter of the depth."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies in a batch, on the 22 joints; fingers go with their hands."""

    offsets: Float[Tensor, "bodies joints 3"]
    """From the joint above, at rest; rest rotations are the identity."""
    places: Float[Tensor, "bodies sensors 3"]
    """The paper's 288 sensors at rest, metres."""
    frames: Float[Tensor, "bodies sensors 3 3"]
    weights: Float[Tensor, "bodies sensors joints"]
    valid: Bool[Tensor, "bodies sensors"]


@dataclass(frozen=True, eq=False)
class Entries:
    """Which pairs make up the field of each frame (`contact/interaction_field.py`)."""

    observers: Int[Tensor, "rows"]
    groups: tuple[tuple[int, int], ...]
    """Rows of each limb."""
    targets: Int[Tensor, "clips frames rows targets"]
    source: Bool[Tensor, "clips frames rows targets"]
    both: Bool[Tensor, "clips frames rows targets"]


class PointNet(nn.Module):
    """Layers that all points share, without a transform (appendix C), and the largest of each number."""

    def __init__(self, inner: int, sizes: Sizes) -> None:
        super().__init__()
        widths = [inner] + [sizes.width] * sizes.layers
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in zip(widths, widths[1:]))

    def forward(self, x: Float[Tensor, "*batch points inner"], mask: Bool[Tensor, "*batch points"]) -> Float[Tensor, "*batch width"]:
        """Points that the mask leaves out do not count; without any, zero."""
        for number, layer in enumerate(self.layers):
            x = layer(x)
            x = torch.relu(x) if number + 1 < len(self.layers) else x
        x = torch.where(mask[..., None], x, torch.full_like(x, -1e4)).amax(dim=-2)
        return torch.where(mask.any(dim=-1, keepdim=True), x, torch.zeros_like(x))


class MeshRet(nn.Module):
    """Rotations of the target from those of the source, the source's field and both geometries."""

    def __init__(self, along: Tensor, around: Tensor, bones: Tensor, sizes: Sizes = Sizes()) -> None:
        super().__init__()
        for name, value in (("along", along), ("around", around), ("bones", bones)):
            self.register_buffer(name, value, persistent=False)
        part_of_bone = {bone: part for part, own in PARTS.items() for bone in own}
        kinds = [next(kind for kind, parts in GEOMETRY.items() if part_of_bone[bone] in parts) for bone in BONES]
        self.kind = torch.tensor([list(GEOMETRY).index(kind) for kind in kinds])[bones]
        self.embedding = nn.Embedding(len(BONES), EMBEDDING)
        self.geometry = nn.ModuleList(PointNet(12 + EMBEDDING + 2, sizes) for _ in GEOMETRY)
        self.join_geometry = nn.Linear(len(GEOMETRY) * sizes.width, sizes.width)
        self.sensor = nn.ModuleList(PointNet(3 + 2 * EMBEDDING + 4, sizes) for _ in GROUPS)
        self.frame = nn.ModuleList(PointNet(sizes.width, sizes) for _ in GROUPS)
        self.join_field = nn.Linear(len(GROUPS) * sizes.width, sizes.width)
        self.motion = nn.Sequential(nn.Linear(6 * JOINTS, sizes.width), nn.ReLU(), nn.Linear(sizes.width, sizes.width))
        options = dict(nhead=sizes.heads, dim_feedforward=sizes.width, dropout=0.0, batch_first=True)
        self.encoder = nn.TransformerEncoder(
            nn.TransformerEncoderLayer(sizes.width, **options), sizes.blocks, enable_nested_tensor=False
        )
        self.decoder = nn.TransformerDecoder(nn.TransformerDecoderLayer(sizes.width, **options), sizes.blocks)
        self.leave = nn.Linear(sizes.width, 6 * JOINTS)
        nn.init.normal_(self.leave.weight, std=1e-3)
        nn.init.zeros_(self.leave.bias)

    def forward(
        self, rotations: Float[Tensor, "clips frames joints 6"], field: Float[Tensor, "clips frames rows targets 3"], entries: Entries,
        source: Bodies, target: Bodies,
    ) -> Float[Tensor, "clips frames joints 6"]:
        """The first two columns of local rotation matrices (Zhou 2019's six numbers), not yet orthonormal."""
        count = rotations.shape[1]
        seen = self.join_field(torch.cat([self._group(number, field, entries) for number in range(len(GROUPS))], dim=-1))
        place = _places_in_time(count + 1, seen.shape[-1])
        memory = self.encoder(torch.cat([self.shape(target)[:, None], seen], dim=1) + place)
        asked = torch.cat([self.shape(source)[:, None], self.motion(rotations.flatten(2))], dim=1) + place
        own = ~torch.eye(count + 1, dtype=torch.bool)  # True: may not look
        own[:, 0] = False
        said = self.decoder(asked, memory, memory_mask=own)[:, 1:]
        return rotations + self.leave(said).unflatten(-1, (JOINTS, 6))

    def shape(self, bodies: Bodies) -> Float[Tensor, "bodies width"]:
        """A body's geometry."""
        bones = self.embedding(self.bones).expand(len(bodies.places), -1, -1)
        coordinates = torch.stack([self.along, self.around], dim=-1).expand(len(bodies.places), -1, -1)
        seen = torch.cat([bodies.places, bodies.frames.flatten(2), bones, coordinates], dim=-1)
        found = [net(seen, bodies.valid & (self.kind == number)) for number, net in enumerate(self.geometry)]
        return self.join_geometry(torch.cat(found, dim=-1))

    def _group(self, number: int, field: Tensor, entries: Entries) -> Float[Tensor, "clips frames width"]:
        start, stop = entries.groups[number]
        targets, mask = entries.targets[:, :, start:stop], entries.source[:, :, start:stop]
        own = entries.observers[start:stop][:, None].expand(targets.shape)
        bones, along, around = (
            torch.stack([values[own], values[targets]], dim=-1) for values in (self.bones, self.along, self.around)
        )
        named = self.embedding(bones).flatten(-2)
        x = self.sensor[number](torch.cat([field[:, :, start:stop], named, along, around], dim=-1), mask)
        return self.frame[number](x, mask.any(dim=-1))


class RotationCritic(nn.Module):
    """Tells rotations of recorded clips from made ones; the paper does not say how its own is built."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv1d(6 * JOINTS, width, 3, stride=2, padding=1), nn.LeakyReLU(0.2),
            nn.Conv1d(width, width, 3, stride=2, padding=1), nn.LeakyReLU(0.2), nn.Conv1d(width, 1, 1),
        )  # fmt: skip

    def forward(self, rotations: Float[Tensor, "clips frames joints 6"]) -> Float[Tensor, "clips windows"]:
        """Scores before a sigmoid, higher for what looks recorded."""
        return self.layers(rotations.flatten(2).transpose(1, 2)).squeeze(1)


def orthonormal(six: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of six numbers: two columns made orthonormal (Gram-Schmidt), and their product."""
    first = nn.functional.normalize(six[..., :3], dim=-1)
    second = six[..., 3:] - (first * six[..., 3:]).sum(dim=-1, keepdim=True) * first
    second = nn.functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def six_numbers(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 6"]:
    """The first two columns, one after the other."""
    return torch.cat([matrices[..., 0], matrices[..., 1]], dim=-1)


def placed(
    parents: Int[Tensor, "joints"], local: Float[Tensor, "clips frames joints 3 3"], bodies: Bodies
) -> tuple[Float[Tensor, "clips frames joints 3 3"], Float[Tensor, "clips frames joints 3"]]:
    """World rotations and places, from the hips."""
    turns, places = [local[:, :, 0]], [torch.zeros_like(local[:, :, 0, 0])]
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        places.append(places[above] + torch.matmul(turns[above], bodies.offsets[:, None, joint, :, None])[..., 0])
        turns.append(torch.matmul(turns[above], local[:, :, joint]))
    return torch.stack(turns, dim=2), torch.stack(places, dim=2)


def posed_sensors(
    turns: Float[Tensor, "clips frames joints 3 3"], places: Float[Tensor, "clips frames joints 3"], parents: Int[Tensor, "joints"],
    bodies: Bodies,
) -> tuple[Float[Tensor, "clips frames sensors 3"], Float[Tensor, "clips frames sensors 3 3"]]:
    """Sensors through linear blend skinning; frames made orthonormal again (the paper leaves them blended)."""
    rest = [torch.zeros_like(bodies.offsets[:, 0])]
    for joint in range(1, len(parents)):
        rest.append(rest[int(parents[joint])] + bodies.offsets[:, joint])
    rest = torch.stack(rest, dim=1) + bodies.offsets[:, :1]
    shift = places - torch.einsum("cfjab,cjb->cfja", turns, rest)
    blended = torch.einsum("csj,cfjab->cfsab", bodies.weights, turns)
    where = torch.einsum("cfsab,csb->cfsa", blended, bodies.places) + torch.einsum("csj,cfja->cfsa", bodies.weights, shift)
    turned = torch.matmul(blended, bodies.frames[:, None])
    normal = nn.functional.normalize(turned[..., 2], dim=-1)
    tangent = turned[..., 0] - (turned[..., 0] * normal).sum(dim=-1, keepdim=True) * normal
    tangent = nn.functional.normalize(tangent, dim=-1)
    return where, torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], dim=-1)


def field_of(
    where: Float[Tensor, "clips frames sensors 3"], frames: Float[Tensor, "clips frames sensors 3 3"], entries: Entries
) -> Float[Tensor, "clips frames rows targets 3"]:
    """Entries t_i^-1 (p_j - p_i)."""
    clips, count, rows, many = entries.targets.shape
    flat = entries.targets.reshape(clips, count, rows * many, 1).expand(-1, -1, -1, 3)
    seen = torch.gather(where, 2, flat).reshape(clips, count, rows, many, 3)
    away = seen - where[:, :, entries.observers, None]
    return torch.matmul(away, frames[:, :, entries.observers])


def distance_shares(places: Float[Tensor, "clips frames joints 3"]) -> Float[Tensor, "clips frames joints joints"]:
    """Distances between all joints, each row divided by its sum (R2ET's, as `contact.field_losses.distance_shares`)."""
    away = (places[:, :, :, None] - places[:, :, None] + 1e-9).norm(dim=-1)
    return away / away.sum(dim=-1, keepdim=True)


def entries_of(plan: FieldPlan, chosen: list[Selection]) -> Entries:
    """Selections of clips, of one plan's rows."""
    groups = tuple((plan.rows(limb).start, plan.rows(limb).stop) for limb in dict.fromkeys(block.limb for block in plan.blocks))
    targets = torch.from_numpy(np.stack([each.targets for each in chosen]).astype(np.int64))
    source, both = (torch.from_numpy(np.stack([getattr(each, name) for each in chosen])) for name in ("source", "both"))
    return Entries(torch.from_numpy(chosen[0].observers), groups, targets, source, both)


def _places_in_time(count: int, width: int) -> Float[Tensor, "count width"]:
    step = torch.arange(count, dtype=torch.float32)[:, None]
    rate = torch.exp(-torch.arange(0, width, 2, dtype=torch.float32) * (4.0 * 2.302585 / width))
    return torch.stack([torch.sin(step * rate), torch.cos(step * rate)], dim=-1).flatten(1)
