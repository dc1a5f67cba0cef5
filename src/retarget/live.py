"""Online: a cloud in, a pose of the target out, in the space of the target's own file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from retarget.body import rotations as rot
from retarget.casting import cast
from retarget.character import Motion, Pose
from retarget.errors import RetargetError
from retarget.methods.scan.starts import Regressor, own_regressor
from retarget.methods.scan.tracker import Tracked, Tracker
from retarget.motion.align import AXES, Actor, Similarity, with_grafts
from retarget.retargeting import Production, prepare

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class LivePose:
    """What came of one cloud."""

    frame: int
    motion: Motion | None
    """One frame of the target's skeleton, in metres with +Y up; None as long as nobody was found."""
    status: str
    """As in `methods.scan.tracker.Tracked`."""
    confidence: float


class LiveRetargeter:
    """Clouds of one actor onto one target, one frame in, one frame out; keeps what it needs of the frames before.

    The pair is prepared at the first frame in which a body is found, in the shape seen there (bones are within a hundredth of
    what later frames show); the pose of every frame is that of `Tracker.step`, then of the method's `step`. Raises
    `RetargetError` for an unknown axis, a unit or a rate that is not positive, and, once somebody is found, for a target that
    the method cannot serve.
    """

    def __init__(
        self, target: Actor, method: str = "auto", fps: float = 30.0, up: str = "+y", unit: float = 1.0,
        regressor: Regressor | None = None,
    ) -> None:  # fmt: skip
        if up not in AXES:
            raise RetargetError(f"the up axis is one of {', '.join(AXES)}, received {up!r}")
        if not (0.0 < unit < float("inf") and 0.0 < fps < float("inf")):
            raise RetargetError(f"unit and frame rate must be positive, received {unit} and {fps}")
        self.target, self.method = with_grafts(target), method
        self.space = Similarity(rot.swing_between(AXES[up], AXES["+y"]), unit)
        self.tracker = Tracker(regressor or own_regressor(), fps)
        self.production: Production | None = None
        self.frames = 0

    def step(self, points: Shaped[Array, "points 3"]) -> LivePose:
        """The next cloud, in the stream's unit and axes."""
        seen = self.tracker.step(self.space.points(np.asarray(points, dtype=np.float64)))
        self.frames += 1
        motion = None if seen.pose is None else self._moved(seen)
        return LivePose(self.frames - 1, motion, seen.status, seen.confidence)

    def _moved(self, seen: Tracked) -> Motion:
        if self.production is None:
            self.production = prepare(cast(self.tracker.character()), self.target, self.method, one_rig=True)
        pose: Pose = self.production.retargeter.step(seen.pose)
        skeleton = self.production.target.skeleton
        return Motion(skeleton, pose.rotations[None], pose.translations[None], self.tracker.fps, pose.moved)

    def in_file(self, motion: Motion) -> Motion:
        """A pose in the unit and axes of the target's own file."""
        graft = self.target.graft
        return self.target.house_from_file.inverse().motion(motion if graft is None else graft.back(motion))

    def header(self) -> dict[str, Any]:
        """What a reader of the lines needs to know first: the joints of the target's file."""
        skeleton = self.target.original.skeleton
        return {"joints": list(skeleton.names), "parents": skeleton.parents.tolist(), "fps": self.tracker.fps}

    def line(self, pose: LivePose) -> dict[str, Any]:
        """A pose as an object of JSON: local rotations (xyzw, parent-from-joint) of all joints of the target's file, and local
        positions of those that move, both null as long as nobody was found."""
        told: dict[str, Any] = {"frame": pose.frame, "status": pose.status, "confidence": round(pose.confidence, 3)}
        if pose.motion is None:
            return told | {"rotations": None, "moved": None, "translations": None}
        own = self.in_file(pose.motion)
        return told | {
            "rotations": _rounded(own.rotations[0]), "moved": list(own.moved), "translations": _rounded(own.translations[0]),
        }  # fmt: skip


def _rounded(values: Float[Array, "rows columns"]) -> list[list[float]]:
    return np.round(values, 6).tolist()
