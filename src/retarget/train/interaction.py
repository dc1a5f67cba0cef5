"""Recipe of the interaction network: from how two bodies stand to how the target's joints should turn.

Two networks, one after the other: the first looks at the copied pose, the second at what an earlier look has made of it, and
learns from poses that earlier looks leave. Both learn what the solver did (distillation), by the solver's own measure: a miss d of
the correction costs d' M d, with the matrix M of the solver's problem at its solution. A plain squared error learns poses that are
near in joints and lose contacts, because an elbow that opens by two degrees lifts the hand off the hip. What they say is mostly what
the rows of a small linear system weigh (`methods/interaction/part_equations.py`), and they learn through its solution.
`methods/interaction/network.py` uses what is learnt here.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from retarget.body.kinematics import world_pose
from retarget.character import Motion
from retarget.contact.part_field import PAIRS
from retarget.evaluate.scan_split import TRAINING, VALIDATION
from retarget.methods.interaction.looker import SEEN, Looker, Posed, beside_seen, nothing_turned, prepare_looker
from retarget.methods.interaction.mirrored import mirror_of_features, mirror_of_said, mirror_of_turned
from retarget.methods.interaction.network import FILES, KIND, VERSION, bounded
from retarget.methods.interaction.part_equations import HELD, PAIRED, SAID, STIFF, TURNED, part_steps
from retarget.methods.interaction.unknowns import SIZE
from retarget.motion.touch.equations import TALL
from retarget.motion.touch.mend import frames_of
from retarget.motion.touch.solve import STIFFNESS
from retarget.train.export import Graph
from retarget.train.interaction_takes import body_of, keep_takes
from retarget.train.loop import Recipe, Settings
from retarget.train.part_equations import steps
from retarget.train.poses import FPS

Array = np.ndarray

TAKES, VALIDATION_TAKES = 337, 6
WIDTH, DEPTH = 448, 3
ENERGY = 0.02
"""Energies well beyond this count by their root: few frames must not outweigh all others."""
SHAKEN = 0.02
"""Standard deviation of what is added to the corrections that the second network starts from, radians, at most."""
FIRST_PAIR = (4.0, 1.0, 2.5, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0)
"""What is said of every pair before anything is learnt (`part_equations.SAYS`): alone it leaves half of the copied poses' miss."""
FIRST_STIFFNESS = 0.2
"""Likewise every joint's stiffness, times the solver's."""
FIRST_HELD = 5.0
"""Likewise of distances of hands."""
SWIFT = 5.0
"""How many times faster what is said of all frames alike is learnt, without decay."""
SETTINGS = Settings(steps=1_700, batch=512, rate=1e-3, warm=200, decay=1.0, rough=0.9, every=100, checks=400)


class LookNetwork(nn.Module):
    """A residual network over standardised features; says what `part_steps` reads, on top of what holds for all frames."""

    def __init__(self, middle: Tensor, spread: Tensor) -> None:
        super().__init__()
        self.register_buffer("middle", middle)
        self.register_buffer("spread", spread)
        self.enter = nn.Linear(len(middle), WIDTH)
        self.norms = nn.ModuleList(nn.LayerNorm(WIDTH) for _ in range(DEPTH))
        self.blocks = nn.ModuleList(nn.ModuleList([nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)]) for _ in range(DEPTH))
        self.leave = nn.Linear(WIDTH, SAID)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)
        self.always = nn.Parameter(_usual())

    def forward(self, features: Tensor) -> Tensor:
        """What is seen (frames, SEEN) to what is said (frames, SAID)."""
        x = self.enter((features - self.middle) / self.spread)
        for norm, (first, second) in zip(self.norms, self.blocks):
            x = x + second(torch.relu(first(norm(x))))
        return self.leave(torch.relu(x)).float() + self.always


def _usual() -> Tensor:
    """What the equations start from: nothing added, all pairs alike, joints as stiff as the solver has them."""
    said = torch.zeros(SAID)
    said[PAIRED] = torch.tensor(FIRST_PAIR).repeat(len(PAIRS))
    stiff = [STIFFNESS.get(name.removeprefix("left").removeprefix("right"), 1.0) for name in TURNED]
    said[HELD] = FIRST_HELD
    said[STIFF] = torch.tensor(stiff).mul(FIRST_STIFFNESS).log().repeat_interleave(3)
    return said


@dataclass(frozen=True, eq=False)
class Frames:
    """All frames of a set of takes, end to end."""

    features: Array
    """(looks, features), half precision: what is seen and what stands behind it."""
    turned: Array
    """(looks, SIZE): where a look starts; there may be several of a frame, the second of all behind the first of all."""
    wanted: Array
    """(frames, SIZE): what the solver made."""
    matters: Array
    """(frames, triangle), half precision."""


@dataclass(frozen=True, eq=False)
class TakeFrames:
    """A clip of a take, with the bodies ready."""

    looker: Looker
    source: Posed
    copied: Motion
    world: Array
    wanted: Array
    matters: Array

    def features(self, turned: Float[Array, "frames SIZE"]) -> Array:
        """What a look sees that starts at `turned`."""
        return self.looker.features(self.source, self.copied, self.world, turned).astype(np.float16)


def load_takes(paths: list[Path], data: Path | None) -> list[TakeFrames]:
    """The clips of files of takes; characters are below `data`."""
    found, bodies = [], {}
    for path in paths:
        with np.load(path) as stored:
            for place in range(sum(name.startswith("turned_") for name in stored.files)):
                told = tuple(tuple(map(tuple, stored[f"{name}_{place}"])) for name in ("source", "target"))
                if told not in bodies:
                    source, target = (body_of(dict(each), data) for each in told)
                    bodies = {told: (prepare_looker(source, target), source, target)} | dict(list(bodies.items())[:3])
                looker, source, target = bodies[told]
                motions = []
                for name, actor in (("performed", source), ("copied", target)):
                    places = stored[f"{name}_path_{place}"]
                    moved = (0, actor.humanoid.joints["hips"])[: places.shape[1]]  # hips below a root move too
                    motions.append(Motion(actor.skeleton, stored[f"{name}_{place}"].astype(np.float64), places, FPS, moved))
                alike = (TALL / target.height) ** 2  # the solver's measure grows with the body
                matters = alike * stored[f"matters_{place}"].astype(np.float32)
                held = np.flatnonzero((np.abs(matters) < np.finfo(np.float16).max).all(axis=1))
                if not len(held):
                    continue
                performed, copied = (frames_of(motion, held) for motion in motions)
                found.append(
                    TakeFrames(
                        looker, looker.source(performed), copied, world_pose(copied)[0],
                        stored[f"turned_{place}"][held], matters[held].astype(np.float16),
                    )
                )  # fmt: skip
    return found


def first_frames(takes: list[TakeFrames]) -> Frames:
    """Copied poses: what the first look starts from."""
    starts = [nothing_turned(len(take.wanted)) for take in takes]
    return Frames(
        np.concatenate([take.features(start) for take, start in zip(takes, starts)]),
        np.concatenate(starts).astype(np.float32),
        np.concatenate([take.wanted for take in takes]).astype(np.float32),
        np.concatenate([take.matters for take in takes]),
    )


def later_frames(takes: list[TakeFrames], first: Frames, network: nn.Module, seed: int | None) -> Frames:
    """Poses that the first look leaves; with a `seed`, shaken, and followed by others between those and the solver's."""
    reached = bounded(first.turned + _changes(network, first.features, first.turned))
    if seed is None:
        turned = reached
    else:
        draw = np.random.default_rng([seed, 43])
        count = len(reached)
        nearer = first.wanted + draw.uniform(0.0, 0.7, (count, 1)) * (reached - first.wanted)
        shake = draw.uniform(0.0, SHAKEN, (2 * count, 1)) * draw.normal(size=(2 * count, SIZE))
        shake[:, -3:] *= 0.1
        turned = np.concatenate([reached, nearer]) + shake * np.tile(np.abs(first.wanted).max(axis=1, keepdims=True) > 0, (2, 1))
    ends = np.cumsum([len(take.wanted) for take in takes])
    features = [
        take.features(turned[round_ * ends[-1] + end - len(take.wanted) : round_ * ends[-1] + end])
        for round_ in range(len(turned) // ends[-1]) for take, end in zip(takes, ends)
    ]  # fmt: skip
    return Frames(np.concatenate(features), turned.astype(np.float32), first.wanted, first.matters)


def end_to_end(parts: Sequence[Frames]) -> Frames:
    """Frames of several files, all of one number of looks, as those of one."""
    looks = len(parts[0].turned) // len(parts[0].wanted)
    features, turned = (
        np.concatenate([getattr(part, name).reshape(looks, len(part.wanted), -1) for part in parts], axis=1)
        for name in ("features", "turned")
    )
    wanted, matters = (np.concatenate([getattr(part, name) for part in parts]) for name in ("wanted", "matters"))
    return Frames(features.reshape(-1, features.shape[-1]), turned.reshape(-1, turned.shape[-1]), wanted, matters)


def _changes(network: nn.Module, features: Array, turned: Array) -> Array:
    chunks = range(0, len(features), 1024)
    return np.concatenate(
        [_evened(network, features[at : at + 1024].astype(np.float32), turned[at : at + 1024]) for at in chunks], dtype=np.float64
    )


@torch.no_grad()
def _evened(network: nn.Module, features: Float[Array, "frames features"], turned: Float[Array, "frames SIZE"]) -> Array:
    """The change of corrections in use: by what the network says of the frames and of their mirror images."""
    seen = features[:, :SEEN]
    own, other = (network(torch.from_numpy(each)).numpy() for each in (seen, mirror_of_features().beginning(SEEN)(seen)))
    places, axes, asked = beside_seen(features)
    return part_steps(features, places, axes, turned, asked, 0.5 * (own + mirror_of_said()(other)))


class LookRecipe(Recipe):
    """One of the two networks."""

    name: ClassVar[str] = KIND

    def __init__(self, learnt: Frames, judged: Frames) -> None:
        self.learnt, self.judged = learnt, judged

    def network(self) -> nn.Module:
        """Fresh, 2.8 million weights."""
        seen = self.learnt.features[:: max(1, len(self.learnt.features) // 20_000), :SEEN].astype(np.float32)
        return LookNetwork(torch.from_numpy(seen.mean(axis=0)), torch.from_numpy(seen.std(axis=0) + 1e-3))

    def groups(self, network: nn.Module) -> list[dict[str, Any]]:
        """What holds for all frames apart."""
        rest = [weight for name, weight in network.named_parameters() if name != "always"]
        return [{"params": rest}, {"params": [network.always], "faster": SWIFT, "weight_decay": 0.0}]

    def batch(self, number: int, count: int) -> Any:
        """Random frames, half of them mirrored."""
        draw = np.random.default_rng([number, 41])
        chosen = draw.integers(len(self.learnt.turned), size=count)
        return _chosen(self.learnt, chosen, draw.random(count) < 0.5)

    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """The solver's measure of the miss, by its root where it is large."""
        features, turned, wanted, matters = batch
        said = network(features[:, :SEEN])
        with torch.autocast("cpu", enabled=False):
            energy = _energy(turned + steps(features, turned, said) - wanted, matters)
        return {"energy": 2.0 * ((1.0 + energy / ENERGY).sqrt() - 1.0).mean(), "energy_seen": energy.mean()}

    def check(self, network: nn.Module) -> dict[str, float]:
        """The share of the copied pose's miss that is left on the validation set."""
        left, before, turns = [], [], []
        for start in range(0, len(self.judged.wanted), 2048):
            features, turned, wanted, matters = _chosen(self.judged, np.arange(start, min(start + 2048, len(self.judged.wanted))))
            miss = turned + torch.from_numpy(_evened(network, features.numpy(), turned.numpy())).float() - wanted
            left.append(_energy(miss, matters))
            before.append(_energy(wanted, matters))
            turns.append(miss.square().sum(dim=1))
        left, before = torch.cat(left), torch.cat(before)
        return {
            "energy left": float(left.sum() / before.sum()), "root left": float(left.sqrt().sum() / before.sqrt().sum()),
            "miss": float(torch.cat(turns).mean().sqrt()),
        }  # fmt: skip


STAGES = (1_700, 1_000)
"""Steps of the networks, one learnt after the other; the second overfits beyond."""


def recipe(data: Path | None, cache: Path, before: Sequence[nn.Module] = ()) -> LookRecipe:
    """The recipe of the network that comes after those learnt `before`; takes are made, and kept, in `cache`. Files whose measures are
    all beyond half precision are left out."""
    sets = []
    for which, count in ((TRAINING, TAKES), (VALIDATION, VALIDATION_TAKES)):
        parts = []
        for number, path in enumerate(keep_takes(which, count, data, cache, os.cpu_count() or 1)):
            clips = load_takes([path], data)  # a file at a time: where all sensors are takes much more memory than what is seen
            if not clips:
                continue
            frames = first_frames(clips)
            for network in before:
                frames = later_frames(clips, frames, network, number if which == TRAINING else None)
            parts.append(frames)
        sets.append(end_to_end(parts))
    return LookRecipe(*sets)


def export(networks: Sequence[nn.Module], folder: Path, told: Mapping[str, str]) -> None:
    """Write the networks as ONNX files into a folder; `told` goes into them too."""
    for name, network in zip(FILES, networks, strict=True):
        graph = Graph()
        scaled = nn.Linear(len(network.middle), WIDTH)  # standardises and enters at once
        scaled.weight.data = network.enter.weight / network.spread
        scaled.bias.data = network.enter.bias - scaled.weight.data @ network.middle
        x = graph.linear(scaled, "features")
        for norm, (first, second) in zip(network.norms, network.blocks):
            x = graph.apply("Add", [x, graph.linear(second, graph.apply("Relu", [graph.linear(first, graph.norm(norm, x))]))])
        leave = copy.deepcopy(network.leave)
        leave.bias.data += network.always.data
        out = graph.linear(leave, graph.apply("Relu", [x]))
        graph.save(folder / name, out, SEEN, SAID, {**told, "network": KIND, "version": VERSION})


def _chosen(frames: Frames, chosen: Array, mirrored: Array | None = None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Features, where a look starts, what the solver made and how much each miss matters; of frames, or their mirror images."""
    frame = chosen % len(frames.wanted)
    features, turned, wanted = frames.features[chosen].astype(np.float32), frames.turned[chosen], frames.wanted[frame]
    matters = whole_matters(frames.matters[frame])
    if mirrored is not None:
        seen, said = mirror_of_features(), mirror_of_turned()
        features[mirrored] = seen(features[mirrored])
        turned[mirrored], wanted[mirrored] = said(turned[mirrored]), said(wanted[mirrored])
        signs = said.signs.astype(np.float32)
        matters[mirrored] = matters[mirrored][:, said.rows[:, None], said.rows] * (signs[:, None] * signs)
    return tuple(torch.from_numpy(each) for each in (features, turned, wanted, matters))


def whole_matters(triangles: Array) -> Array:
    """Symmetric matrices (frames, SIZE, SIZE) of their lower triangles."""
    rows, columns = np.tril_indices(SIZE)
    matters = np.zeros((len(triangles), SIZE, SIZE), dtype=np.float32)
    matters[:, rows, columns] = matters[:, columns, rows] = triangles
    return matters


def _energy(miss: Tensor, matters: Tensor) -> Tensor:
    with torch.autocast("cpu", enabled=False):
        return torch.einsum("fn,fnm,fm->f", miss.float(), matters, miss.float()).clamp(min=0.0)
