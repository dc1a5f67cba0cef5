"""The loop that all recipes share: batches by number, a cosine of the rate, running means of the weights, and a state on disk
from which a training that was cut off goes on as if it had not been."""

from __future__ import annotations

import copy
import csv
import logging
import math
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

log = logging.getLogger("retarget")

AHEAD = 3
"""Batches that are made while the network learns from the one before."""
LAST_RATE = 0.01
"""What is left of the rate in the end."""


@dataclass(frozen=True)
class Settings:
    """How long and how fast to learn."""

    steps: int
    batch: int = 256
    rate: float = 1e-3
    warm: int = 300
    """Steps in which the rate rises."""
    decay: float = 0.01
    """Of the weights, by AdamW."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    smooth: float = 0.999
    """How much of the running mean of the weights a step keeps; less at first."""
    rough: float = 0.0
    """Share of the steps, the first ones, that multiply in bfloat16."""
    seed: int = 0
    every: int = 100
    """Steps between two lines of the log, with the state written."""
    checks: int = 1000
    """Steps between two looks at the validation set."""


class Recipe(ABC):
    """What is learnt, from what, and by which losses."""

    name: ClassVar[str]

    @abstractmethod
    def network(self) -> nn.Module:
        """A fresh network."""

    def groups(self, network: nn.Module) -> list[dict[str, Any]]:
        """What is learnt, in groups as torch's optimizers take them; `faster` times the rate where a group says so."""
        return [{"params": list(network.parameters())}]

    @abstractmethod
    def batch(self, number: int, count: int) -> Any:
        """What the network learns from in a step: a function of its arguments alone. Runs in a thread of its own."""

    @abstractmethod
    def losses(self, network: nn.Module, batch: Any) -> dict[str, Tensor]:
        """Terms by name; their sum is what is minimised, but for those whose name ends in `_seen`, which are only logged."""

    def check(self, network: nn.Module) -> dict[str, float]:
        """Figures on the validation set."""
        return {}


@dataclass(eq=False)
class State:
    """Where a training stands."""

    network: nn.Module
    mean: nn.Module
    """The network with the running means of the weights: what is kept in the end."""
    optimizer: torch.optim.Optimizer
    step: int = 0
    seconds: float = 0.0
    """Processor time of the training so far, of all its threads."""


def train(recipe: Recipe, settings: Settings, folder: Path, stop: int | None = None) -> State:
    """Learn, from the state in `folder` where there is one, up to the last step (or `stop`).

    Writes `state.pt` and `log.csv` there. Equal settings give equal numbers, interrupted or not.
    """
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(settings.seed)
    network = recipe.network()
    optimizer = torch.optim.AdamW(recipe.groups(network), lr=settings.rate, weight_decay=settings.decay, fused=True)
    state = State(network, copy.deepcopy(network).requires_grad_(False), optimizer)
    _resume(state, folder)
    last = settings.steps if stop is None else min(stop, settings.steps)
    sums, counted = {}, 0
    spent, started = state.seconds, time.process_time()
    for batch in _batches(recipe, settings, state.step, last):
        for name, value in _step(recipe, settings, state, batch).items():
            sums[name] = sums.get(name, 0.0) + value
        state.step, counted = state.step + 1, counted + 1
        state.seconds = spent + time.process_time() - started
        if state.step % settings.every == 0 or state.step == last:
            row = {name: value / counted for name, value in sums.items()}
            sums, counted = {}, 0
            if state.step % settings.checks == 0 or state.step == last:
                row |= recipe.check(state.mean.eval())
            _record(folder, state, row)
            _keep(state, folder)
    return state


def _batches(recipe: Recipe, settings: Settings, first: int, last: int) -> Iterator[Any]:
    """The batches from one number up to another, made ahead in a thread that gives way a little."""

    def give_way() -> None:
        if hasattr(os, "setpriority"):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + 2)

    with ThreadPoolExecutor(1, initializer=give_way) as maker:
        waiting: list[Future[Any]] = []
        for number in range(first, last):
            while len(waiting) < AHEAD and number + len(waiting) < last:
                waiting.append(maker.submit(recipe.batch, number + len(waiting), settings.batch))
            yield waiting.pop(0).result()


def _step(recipe: Recipe, settings: Settings, state: State, batch: Any) -> dict[str, float]:
    share = state.step / settings.steps
    rate = settings.rate * (LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 + math.cos(math.pi * share)))
    for group in state.optimizer.param_groups:
        group["lr"] = group.get("faster", 1.0) * rate * min(1.0, (state.step + 1) / settings.warm)
    torch.manual_seed(settings.seed + 1_000_003 * state.step)
    state.network.train()
    rough = torch.autocast("cpu", dtype=torch.bfloat16) if share < settings.rough else nullcontext()
    with rough:
        terms = recipe.losses(state.network, batch)
    loss = torch.stack([term for name, term in terms.items() if not name.endswith("_seen")]).sum()
    state.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(state.network.parameters(), settings.clip)
    state.optimizer.step()
    kept = min(settings.smooth, (1.0 + state.step) / (10.0 + state.step))
    with torch.no_grad():
        torch._foreach_lerp_(list(state.mean.parameters()), list(state.network.parameters()), 1.0 - kept)
        for mean, now in zip(state.mean.buffers(), state.network.buffers()):
            mean.copy_(now)
    return {name: float(term.detach()) for name, term in terms.items()}


def _resume(state: State, folder: Path) -> None:
    path = folder / "state.pt"
    if not path.exists():
        return
    stored = torch.load(path, weights_only=True)
    state.network.load_state_dict(stored["network"])
    state.mean.load_state_dict(stored["mean"])
    state.optimizer.load_state_dict(stored["optimizer"])
    state.step, state.seconds = stored["step"], stored["seconds"]


def _keep(state: State, folder: Path) -> None:
    stored = {name: getattr(state, name).state_dict() for name in ("network", "mean", "optimizer")}
    torch.save(stored | {"step": state.step, "seconds": state.seconds}, folder / "state.part")
    (folder / "state.part").rename(folder / "state.pt")


def _record(folder: Path, state: State, row: dict[str, float]) -> None:
    """A line of the log: step, processor seconds, mean losses since the last line, figures on the validation set."""
    text = ", ".join(f"{name} {value:.5g}" for name, value in row.items())
    log.info("step %d, %.0f s: %s", state.step, state.seconds, text)
    with (folder / "log.csv").open("a", newline="") as file:
        writer = csv.writer(file)
        writer.writerows((state.step, f"{state.seconds:.1f}", name, f"{value:.6g}") for name, value in row.items())
