"""Who performs where no skeleton does: the surface of a mesh sequence gets a rig, and the rig the motion that explains it; a
capture gets an embedded human of the actor's shape that follows its clouds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Shaped

from retarget.body import rotations as rot
from retarget.casting import Hints, cast
from retarget.character import Character, MeshMotion, Motion, PointMotion
from retarget.errors import FileError, RetargetError
from retarget.io.asset import Asset, Convention
from retarget.methods.scan.starts import Regressor
from retarget.motion.align import AXES, Actor
from retarget.motion.filter import cut_clouds, cut_surface
from retarget.motion.fit import fit_motion
from retarget.motion.joint_frames import prepare_frames
from retarget.progress import Tell, untold
from retarget.rig.rigging import Rigged, rig

Array = np.ndarray

TRIED = 5
"""Frames that are tried, evenly spread, until one can be rigged."""


@dataclass(frozen=True, eq=False)
class Performer:
    """A moving surface with a rig that follows it."""

    actor: Actor
    motion: Motion
    """Of the actor, as the surface shows it."""
    surface: Shaped[Array, "frames vertices 3"]
    """The surface itself, metres, +Y up; vertices are the actor's."""
    notes: tuple[str, ...]


def cast_sequence(
    sequence: MeshMotion, hints: Hints | None = None, convention: Convention | None = None, tell: Tell = untold
) -> Performer:
    """Rig a mesh sequence by the first of its frames that can be, and fit that rig to all of them.

    Up axis and unit are the hints', else the file's, else +Y and what makes a plausible height. Raises `RetargetError` where no
    frame can be rigged.
    """
    hints = hints or Hints()
    known = convention or Convention()
    upright = _upright(hints.up or known.up or "+y")
    vertices = sequence.vertices @ rot.to_matrix(upright).T.astype(np.float32)
    rigged, frame = _rigged(sequence, vertices, hints.unit or known.metres_per_unit, tell)
    surface = vertices * np.float32(rigged.unit)
    character: Character = replace(rigged.character, name=sequence.name or "the mesh sequence")
    motion = fit_motion(prepare_frames(character), surface, sequence.fps, sequence.name)
    notes = (f"rigged by frame {frame}, with confidence {rigged.confidence:.2f}", *rigged.notes)
    actor = cast(character)
    return Performer(replace(actor, notes=(*notes, *actor.notes)), motion, surface, notes)


@dataclass(frozen=True, eq=False)
class ScanPerformer:
    """An embedded human in the actor's shape that does what a capture shows."""

    actor: Actor
    motion: Motion
    """Of the actor, in metres with +Y up."""
    shown: Bool[Array, "frames"]
    """Which frames showed the body; on others it is interpolated."""
    notes: tuple[str, ...]


def cast_scan(
    capture: PointMotion,
    hints: Hints | None = None,
    convention: Convention | None = None,
    regressor: Regressor | None = None,
    causal: bool = False,
    tell: Tell = untold,
) -> ScanPerformer:
    """Fit the embedded human to a capture's clouds, in shape and motion.

    Up axis and unit are the hints', else the file's, else what some of the frames show. `regressor` says where to begin (None:
    the one that comes with the program, where there is one); `causal` follows frame by frame, as online. Raises `RetargetError`
    where no frame shows a human body, or where two are seen.
    """
    from retarget.methods.scan.clip import follow_clip
    from retarget.methods.scan.evidence import look_at
    from retarget.methods.scan.starts import own_regressor

    hints, known = hints or Hints(), convention or Convention()
    regressor = regressor or own_regressor()
    tell("looking for the body")
    unit = known.metres_per_unit if hints.unit is None else hints.unit
    seen = look_at(capture.clouds, regressor, hints.up or known.up, unit)
    clouds = tuple(seen.space.points(cloud).astype(np.float32) for cloud in capture.clouds)
    followed = follow_clip(replace(capture, clouds=clouds), regressor, causal, tell)
    notes = (*seen.notes, *followed.notes)
    actor = cast(followed.character)
    return ScanPerformer(replace(actor, notes=(*notes, *actor.notes)), followed.motion, followed.shown, notes)


def cast_moving(
    asset: Asset,
    hints: Hints | None = None,
    fps: float | None = None,
    start: float | None = None,
    end: float | None = None,
    tell: Tell = untold,
) -> Performer | ScanPerformer | None:
    """Who performs a file that holds a mesh sequence or a capture, or its part from `start` to `end` seconds; None for
    what has joints. `fps` is the rate of its frames, where the user knows it better. Raises `FileError` where nobody is
    seen, and for a part without frames."""
    moving = asset.sequence or asset.clouds
    if moving is None:
        return None
    moving = moving if fps is None else replace(moving, fps=fps)
    try:
        if isinstance(moving, PointMotion):
            return cast_scan(cut_clouds(moving, start, end), hints, asset.convention, tell=tell)
        return cast_sequence(cut_surface(moving, start, end), hints, asset.convention, tell=tell)
    except RetargetError as error:
        raise FileError(asset.path, str(error)) from None


def _rigged(sequence: MeshMotion, vertices: Array, unit: float | None, tell: Tell) -> tuple[Rigged, int]:
    tried = np.unique(np.linspace(0, len(vertices) - 1, TRIED).round().astype(int))
    why: RetargetError | None = None
    for frame in tried.tolist():
        try:
            return rig(replace(sequence.mesh, vertices=vertices[frame].astype(np.float64)), unit=unit, tell=tell), frame
        except RetargetError as error:
            why = why or error
    raise RetargetError(f"none of its {len(tried)} frames that were tried can be rigged; of the first: {why}")


def _upright(up: str) -> Float[Array, "4"]:
    """The turn that brings an axis to +Y."""
    if up not in AXES:
        raise RetargetError(f"the up axis is one of {', '.join(AXES)}, received {up!r}")
    return rot.swing_between(AXES[up], np.array([0.0, 1.0, 0.0]))
