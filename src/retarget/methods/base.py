"""The contract of a method: settings that prepare a pair of bodies into a retargeter.

A method is a frozen dataclass of settings. `prepare` does everything that depends on the pair only (matching, rest
poses, factorisations). The `Retargeter` it returns steps frame by frame, or takes a whole clip, where it may look ahead.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from retarget.body.skinning import bake
from retarget.character import Character, MeshMotion, Motion, PointMotion, Pose
from retarget.errors import RetargetError
from retarget.io import save, save_sequence
from retarget.motion.align import Actor

# Names of the laws of tests/laws; a method lists those that it promises.
LAWS = frozenset(
    {
        "same body, same motion",
        "turning the world turns the result",
        "scaling both bodies scales the path",
        "mirrored in, mirrored out",
        "equal results for equal input",
        "stepping equals the clip",
        "permuting vertices permutes the result",
        "names, order and axes of joints and the rest pose do not matter",
    }
)


@dataclass(frozen=True, eq=False)
class Result:
    """A retargeted clip."""

    target: Actor
    """Who performs it; rigged on the way if it came bare."""
    motion: Motion
    """Over the target's skeleton, in metres with +Y up."""
    status: str = "ok"
    """'ok', or what did not go as it should; output is finite either way."""
    stats: dict[str, Any] = field(default_factory=dict)
    """What was inferred, matched and measured."""
    surface: MeshMotion | None = None
    """The target's surface on every frame, in metres with +Y up, where the method makes one of its own: what `motion` and the
    skin do not tell. None where the skin tells all."""

    @property
    def character(self) -> Character:
        """The target in metres with +Y up, as `motion` wants it."""
        return self.target.character

    @property
    def file_motion(self) -> Motion:
        """The motion in the unit and axes of the target's own file."""
        graft = self.target.graft
        motion = self.motion if graft is None else graft.back(self.motion)
        return self.target.house_from_file.inverse().motion(motion)

    @property
    def file_surface(self) -> MeshMotion:
        """The moving surface in the unit and axes of the target's own file: the method's own, else what the skin makes of the
        motion. Raises `RetargetError` for a target without a surface."""
        surface = bake(self.character, self.motion) if self.surface is None else self.surface
        back = self.target.house_from_file.inverse()
        frames = back.points(surface.vertices.astype(np.float64))
        return replace(surface, mesh=replace(surface.mesh, vertices=frames[0]), vertices=frames.astype(np.float32))

    @property
    def file_cloud(self) -> PointMotion:
        """The points of a target that came as a cloud, on every frame, in its file's unit and axes: point for point, in the order
        of the file. Raises `RetargetError` for a target that came with a surface."""
        if self.target.cloud is None:
            raise RetargetError("the target came with a surface; only those that came as a cloud move as one")
        surface = bake(self.character, self.motion) if self.surface is None else self.surface
        back = self.target.house_from_file.inverse()
        clouds = tuple(back.points(self.target.cloud.of(frame)).astype(np.float32) for frame in surface.vertices)
        return PointMotion(clouds, surface.fps, surface.name)

    def save(self, path: str | Path, **options: Any) -> None:
        """Write the target with this motion: a glTF target keeps all it had and gains a clip. See `io.save`."""
        save(path, self.target.original, [self.file_motion], **options)

    def save_surface(self, path: str | Path) -> None:
        """Write the moving surface without a skeleton, exact to the vertex; of a target that came as a cloud, its points
        (`file_cloud`). See `io.save_sequence` for the formats."""
        save_sequence(path, self.file_surface if self.target.cloud is None else self.file_cloud, tracked=True)


def save_results(path: str | Path, results: Sequence[Result], **options: Any) -> None:
    """Write several clips of one target into one file. Raises `RetargetError` where the targets differ."""
    target = results[0].target
    if any(result.target.original is not target.original for result in results):
        raise RetargetError("results of different targets cannot share a file")
    save(path, target.original, [result.file_motion for result in results], **options)


class Retargeter(ABC):
    """A prepared pair of bodies."""

    takes_surface: ClassVar[bool] = False
    """Whether a call takes `surface` too: the source's posed vertices on every frame, where its skin does not tell them."""

    @abstractmethod
    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip of the source skeleton, in metres with +Y up."""

    @abstractmethod
    def step(self, pose: Pose) -> Pose:
        """Retarget the next frame, online; keeps what it needs of the frames before."""


class Method(ABC):
    """Settings of one way to retarget."""

    laws: ClassVar[frozenset[str]] = frozenset()

    @abstractmethod
    def prepare(self, source: Actor, target: Actor) -> Retargeter:
        """Everything that depends on the pair of bodies only. Raises `RetargetError` if they cannot be matched."""
