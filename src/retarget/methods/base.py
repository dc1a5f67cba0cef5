"""The contract of a method: settings that prepare a pair of bodies into a retargeter.

A method is a frozen dataclass of settings. `prepare` does everything that depends on the pair only (matching, rest
poses, factorisations). The `Retargeter` it returns steps frame by frame, or takes a whole clip, where it may look ahead.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

from retarget.character import Character, Motion, Pose
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

    character: Character
    """The target, in the house's space; rigged on the way if it came bare."""
    motion: Motion
    """Over the target's skeleton, in the house's space."""
    status: str = "ok"
    """'ok', or what did not go as it should; output is finite either way."""
    stats: dict[str, Any] = field(default_factory=dict)
    """What was inferred, matched and measured."""


class Retargeter(ABC):
    """A prepared pair of bodies."""

    @abstractmethod
    def __call__(self, motion: Motion) -> Result:
        """Retarget a clip of the source skeleton, in the house's space."""

    @abstractmethod
    def step(self, pose: Pose) -> Pose:
        """Retarget the next frame, online; keeps what it needs of the frames before."""


class Method(ABC):
    """Settings of one way to retarget."""

    laws: ClassVar[frozenset[str]] = frozenset()

    @abstractmethod
    def prepare(self, source: Actor, target: Actor) -> Retargeter:
        """Everything that depends on the pair of bodies only. Raises `RetargetError` if they cannot be matched."""
