"""The networks of others as methods, for embedded humans: Villegas et al. 2018 and Rekik 2023 (recurrent, from joints alone), Zhang et
al. 2023 (copied rotations with residuals) and Ye et al. 2024 (the dense field). Torch is imported where they are used.

All take the path and the fingers of copied rotations: the papers say nothing of them, or work in the hips' space. What rests on the
ground is held, as in all our rows.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from retarget.body import rotations as rot
from retarget.body.kinematics import forward, world_pose
from retarget.character import Motion, Pose
from retarget.contact.interaction_field import FieldPlan, prepare_field
from retarget.contact.sensors import paper_layout
from retarget.errors import FileError, RetargetError
from retarget.evaluate.reference.interaction_bodies import ReferenceBody, bodies_of, body_of, shapes_of
from retarget.methods.base import Method, Result, Retargeter
from retarget.methods.scan.features import JOINTS, PARENTS
from retarget.motion.align import Actor
from retarget.motion.copy_clip import Copier, CopySettings, prepare_copier

Array = np.ndarray

FRAMES, STEP = 30, 10
"""Frames of a stretch that MeshRet sees, and how many of them, in its middle, are taken."""


@dataclass(frozen=True, eq=False)
class Copying(Retargeter):
    """Copied rotations, with those of the 22 joints replaced."""

    copier: Copier

    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip."""
        copied = self.copier.clip(motion)
        rotations = copied.motion.rotations.copy()
        rotations[:, :JOINTS] = rot.continuous(self.rotations(motion, copied.motion))
        moved = replace(copied.motion, rotations=rotations)
        if copied.contacts is not None:
            moved = self.copier.clip(motion, turned=world_pose(moved)[0]).motion
        return Result(self.copier.target, moved)

    def step(self, pose: Pose) -> Pose:
        """Raises `RetargetError`: these are measured on clips."""
        raise RetargetError("reference networks take whole clips")

    @abstractmethod
    def rotations(self, performed: Motion, copied: Motion) -> Float[Array, "frames joints 4"]:
        """Local rotations of the 22 joints."""


@dataclass(frozen=True)
class ReferenceNetwork(Method):
    """One of the networks, by the file of its weights."""

    path: Path

    def prepare(self, source: Actor, target: Actor) -> Copying:
        """Raises `FileError` for weights that are missing or of another network, `RetargetError` where torch is not installed."""
        copier = prepare_copier(CopySettings(one_rig=True), source, target)
        kind = "-".join(self.path.stem.split("-")[:2])
        network, layout = _loaded(self.path, kind)
        if kind == "paper-smrm":
            return Recurrent(copier, network)
        bodies = tuple(body_of(actor, paper_layout(*layout)) for actor in (source, target))
        if kind == "paper-r2et":
            return Residual(copier, network, bodies)
        nearest = int(self.path.stem.rpartition("nearest-")[2]) if "nearest-" in self.path.stem else 4
        return Dense(copier, network, bodies, prepare_field(bodies[0].sensors, bodies[1].sensors, nearest, 8 - nearest))


def _loaded(path: Path, kind: str) -> tuple[Any, tuple[int, int]]:
    """A network with its weights, and how many places and angles its sensors have."""
    try:
        import torch
    except ModuleNotFoundError:
        raise RetargetError("reference networks need torch, which is not installed: pip install 'retarget[train]'") from None
    if not path.is_file():
        raise FileError(path, "the network's weights are not there; retarget train makes them")
    stored = torch.load(path, weights_only=True)
    layout = (2 if path.stem.endswith("half-along") else 4, 2 if path.stem.endswith("half-around") else 4)
    try:
        network = _fresh(kind, layout)
        network.load_state_dict(stored["weights"])
    except (KeyError, RuntimeError) as error:
        raise FileError(path, f"weights of another network ({type(error).__name__})") from None
    return network.eval(), layout


def _fresh(kind: str, layout: tuple[int, int]) -> Any:
    import torch

    if kind == "paper-smrm":
        from retarget.evaluate.reference.scan_networks import MotionRetargeter

        return MotionRetargeter()
    if kind == "paper-r2et":
        from retarget.evaluate.reference.residual_network import ResidualRetargeter

        return ResidualRetargeter()
    from retarget.evaluate.reference.interaction_networks import TRAINED, MeshRet

    sensors = paper_layout(*layout)
    numbers = (torch.from_numpy(each.astype(np.float32)) for each in (sensors.along, sensors.around))
    return MeshRet(*numbers, torch.from_numpy(sensors.bones), TRAINED)


@dataclass(frozen=True, eq=False)
class Recurrent(Copying):
    """SMRM, a retargeter of NKN's kind: joints of one skeleton to rotations of another."""

    network: Any

    def rotations(self, performed: Motion, copied: Motion) -> Float[Array, "frames joints 4"]:
        """From places of joints, a window of 30 frames at a time."""
        import torch

        from retarget.evaluate.reference.scan_networks import CONTEXT

        joints = world_pose(performed)[1][:, :JOINTS]
        moves = np.diff(joints[:, 0], axis=0, prepend=joints[:1, 0])
        offsets = copied.skeleton.offsets[:JOINTS].copy()
        rest = forward(PARENTS, np.tile(rot.IDENTITY, (JOINTS, 1)), offsets)[1]
        frames = np.maximum(np.arange(len(joints))[:, None] + np.arange(1 - CONTEXT, 1), 0)
        windows = [torch.from_numpy(each[frames].astype(np.float32)) for each in (joints - joints[:, :1], moves)]
        skeleton = torch.from_numpy((rest - rest[:1]).astype(np.float32)).expand(len(joints), -1, -1)
        with torch.no_grad():
            return self.network(*windows, skeleton)[0][:, -1].numpy().astype(np.float64)


@dataclass(frozen=True, eq=False)
class Residual(Copying):
    """R2ET's ideas: frame by frame."""

    network: Any
    bodies: tuple[ReferenceBody, ReferenceBody]

    def rotations(self, performed: Motion, copied: Motion) -> Float[Array, "frames joints 4"]:
        """From the source's rotations and both shapes."""
        import torch

        count = len(performed)
        offsets = tuple(bodies_of([body] * count).offsets for body in self.bodies)
        shapes = tuple(shapes_of([body] * count) for body in self.bodies)
        q = torch.from_numpy(copied.rotations[:, :JOINTS].astype(np.float32))
        with torch.no_grad():
            return self.network(q, offsets, shapes)[0].numpy().astype(np.float64)


@dataclass(frozen=True, eq=False)
class Dense(Copying):
    """MeshRet: stretches of 30 frames, of which the middle is taken."""

    network: Any
    bodies: tuple[ReferenceBody, ReferenceBody]
    plan: FieldPlan

    def rotations(self, performed: Motion, copied: Motion) -> Float[Array, "frames joints 4"]:
        """From the source's rotations, its field and both geometries."""
        import torch

        from retarget.evaluate.reference import interaction_networks as networks

        count, margin = len(performed), (FRAMES - STEP) // 2
        first = np.arange(0, count, STEP)
        frames = np.clip(first[:, None] + np.arange(-margin, FRAMES - margin), 0, count - 1)
        local = torch.from_numpy(rot.to_matrix(performed.rotations[:, :JOINTS])[frames].astype(np.float32))
        source, target = (bodies_of([body] * len(frames)) for body in self.bodies)
        parents = torch.from_numpy(PARENTS)
        with torch.no_grad():
            where, turned = networks.posed_sensors(*networks.placed(parents, local, source), parents, source)
            chosen = [self.plan.select(each.numpy().astype(np.float64)) for each in where]
            entries = networks.entries_of(self.plan, chosen)
            seen = networks.field_of(where, turned, entries)
            made = self.network(networks.six_numbers(local), seen, entries, source, target)
            middle = networks.orthonormal(made[:, margin : margin + STEP]).flatten(0, 1)[:count]
        return rot.from_matrix(middle.numpy().astype(np.float64))


def trained_seconds(path: Path) -> float:
    """Processor time that a file's network was trained for."""
    import torch

    return float(torch.load(path, weights_only=True)["seconds"])
