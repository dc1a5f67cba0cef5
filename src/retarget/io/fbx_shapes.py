"""Blend shapes of an FBX mesh, as morph targets of a GLB. Runs in the child.

A channel has one weight and leads through one shape or several (in-betweens), each of which is full at a weight of its
own. glTF knows a weight a shape only: every shape becomes a target, and the channel's weight is dealt out between the
two neighbours that it lies between, as FBX blends them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from retarget.io.fbx_scene import hold, integers, items, vectors
from retarget.io.glb import Glb


@dataclass
class Shape:
    """One morph target."""

    name: str
    rows: np.ndarray
    """The vertices that move, ascending."""
    moves: np.ndarray
    """(rows, 3), metres."""


@dataclass
class Channel:
    """Shapes that follow one weight."""

    wrapper: Any
    """The channel of ufbx, asked for its weight at each instant."""
    full: np.ndarray
    """The weight at which each shape is full, ascending, none 0."""
    shapes: list[Shape]


@dataclass
class Morph:
    """The shapes of one mesh."""

    channels: list[Channel]
    node: int
    """The GLB's node that shows it."""

    @property
    def rest(self) -> np.ndarray:
        """(1, targets) weights without animation."""
        return self.weights(np.array([[float(channel.wrapper.weight) for channel in self.channels]]))

    def weights(self, values: np.ndarray) -> np.ndarray:
        """Weights of all targets (frames, targets) from those of the channels (frames, channels)."""
        dealt = [shares(values[:, place], channel.full) for place, channel in enumerate(self.channels)]
        return np.concatenate(dealt, axis=1)


def read_shapes(mesh: Any, node: int, count: int) -> Morph | None:
    """All blend shapes of a mesh of `count` vertices; None where nothing moves."""
    channels = []
    for deformer in items(mesh.blend_deformers):
        for channel in items(deformer.channels):
            frames = items(channel.keyframes)
            full, first = np.unique([float(frame.target_weight) for frame in frames], return_index=True)
            usable = np.isfinite(full) & (full != 0)
            shapes = [_shape(hold(frames[place].shape), channel.name, count) for place in first[usable].tolist()]
            if any(len(shape.rows) for shape in shapes):
                channels.append(Channel(channel, full[usable], shapes))
    return Morph(channels, node) if channels else None


def _shape(shape: Any, channel: str, count: int) -> Shape:
    vertices, offsets = integers(shape.offset_vertices), vectors(shape.position_offsets, 3)
    number = min(len(vertices), len(offsets))
    vertices, offsets = vertices[:number], offsets[:number]
    moving = (vertices >= 0) & (vertices < count) & (offsets != 0).any(axis=1)
    rows, first = np.unique(vertices[moving], return_index=True)
    return Shape(shape.name or channel, rows, offsets[moving][first])


def shares(weights: np.ndarray, full: np.ndarray) -> np.ndarray:
    """How much of each shape is shown (frames, shapes) at some weights of their channel (frames,): linear between
    neighbours, of which nothing at weight 0 is one, and on beyond the last."""
    knots = np.unique(np.append(full, 0.0))
    left = np.clip(np.searchsorted(knots, weights, side="right") - 1, 0, len(knots) - 2)
    part = (weights - knots[left]) / (knots[left + 1] - knots[left])
    dealt = np.zeros((len(weights), len(knots)))
    frames = np.arange(len(weights))
    dealt[frames, left], dealt[frames, left + 1] = 1 - part, part
    return np.delete(dealt, np.searchsorted(knots, 0.0), axis=1)


def add_targets(glb: Glb, morph: Morph, origin: np.ndarray) -> tuple[list[dict[str, int]], dict[str, Any]]:
    """Targets of a primitive whose vertices are copies of the file's (`origin`), and what the mesh says of them."""
    shapes = [shape for channel in morph.channels for shape in channel.shapes]
    targets = []
    for shape in shapes:
        own = np.flatnonzero(np.isin(origin, shape.rows))
        moves = shape.moves[np.searchsorted(shape.rows, origin[own])]
        targets.append({"POSITION": glb.add_moves(own, moves, len(origin))})
    names = [shape.name for shape in shapes]
    return targets, {"weights": morph.rest[0].tolist(), "extras": {"targetNames": names}}
