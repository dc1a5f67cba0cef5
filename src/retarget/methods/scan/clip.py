"""A whole capture followed with a look ahead: forwards, backwards, and once more between the neighbours of every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from retarget.body import rotations as rot
from retarget.character import Character, Motion, PointMotion
from retarget.errors import RetargetError
from retarget.methods.scan.cloud import binned
from retarget.methods.scan.fit import Expected, fit_cloud, relative_turns, rotation_vectors, turn_matrices, world_turns
from retarget.methods.scan.hanging import skin_only
from retarget.methods.scan.scan_body import BODY, ScanBody, scan_body
from retarget.methods.scan.starts import Regressor
from retarget.methods.scan.tracker import FEWEST, HELD, NOBODY, Tracked, Tracker, ready
from retarget.methods.scan.usual import steadiness, usual_precision
from retarget.progress import Tell, untold
from retarget.rig.fit_model import BodyState

Array = np.ndarray

LONG = 120
"""Well fitted frames that tell of the shape of a clip's actor."""
BETWEEN = (0.045, 0.035)
"""Metres: reaches of the rounds in which a frame is fitted between its neighbours."""
ROOT_BETWEEN = 0.01
"""Metres that the hips are off the middle of their neighbours' places: one standard deviation."""
TIGHTER = 4.0
"""How much more a pose is held between its neighbours than to what its speed foretells."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A capture as the motion of an embedded human."""

    character: Character
    """In the actor's shape."""
    motion: Motion
    """Of its 52 joints, metres, +Y up; on frames that show nobody it is interpolated."""
    shown: Bool[Array, "frames"]
    """Which frames showed the body."""
    distance: Float[Array, "frames"]
    """Metres between skin and cloud, root mean square; infinite on frames that show nobody."""
    notes: tuple[str, ...]


def follow_clip(
    capture: PointMotion, regressor: Regressor | None = None, causal: bool = False, tell: Tell = untold
) -> Followed:
    """Follow the body of a capture, in metres with +Y up. `causal` gives frame by frame what `Tracker.step` gives.

    Raises `RetargetError` where no frame shows a body.
    """
    tell("following the body")
    forward = Tracker(regressor, capture.fps, settled=Tracker.settled if causal else LONG)
    frames = _followed(forward, capture.clouds, regressor)
    if all(each.status == NOBODY for each in frames):
        raise RetargetError(f"no body was found in any of {len(frames)} frames")
    shape = forward.memory[0].state.shape
    if not causal:
        tell("following it backwards")
        backward = Tracker(regressor, capture.fps, shape)
        back = _followed(backward, capture.clouds[::-1], regressor)[::-1]
        frames = [min(pair, key=lambda each: (each.status in (HELD, NOBODY), each.distance)) for pair in zip(frames, back)]
    shown = np.array([each.status not in (HELD, NOBODY) for each in frames])
    body = scan_body()
    relative, root = _filled(body, frames, shown)
    distance = np.array([each.distance for each in frames])
    if not causal:
        tell("smoothing")
        relative, root = _between(body, capture, shape, relative, root, shown)
    character = body.character(shape, capture.name or "the actor")
    rotations = np.tile(rot.IDENTITY, (len(root), len(character.skeleton), 1))
    rotations[:, :BODY] = rot.from_matrix(relative)
    motion = Motion(character.skeleton, rot.continuous(rotations), root[:, None], capture.fps, name=capture.name)
    return Followed(character, motion, shown, distance, tuple(_notes(shown, capture.fps)))


def _followed(tracker: Tracker, clouds: Sequence[Array], regressor: Regressor | None) -> list[Tracked]:
    return [tracker.step(cloud) for cloud in clouds]


def _filled(
    body: ScanBody, frames: Sequence[Tracked], shown: Bool[Array, "frames"]
) -> tuple[Float[Array, "frames joints 3 3"], Float[Array, "frames 3"]]:
    """Turns from parents and root of all frames; those that show nobody lie between those that do."""
    known = np.flatnonzero(shown)
    relative = np.stack([relative_turns(body, frames[frame].state.turns) for frame in known])
    root = np.stack([frames[frame].state.root for frame in known])
    every = np.arange(len(frames))
    place = np.interp(every, known, np.arange(len(known)))
    low = np.minimum(place.astype(int), max(len(known) - 2, 0))
    high = np.minimum(low + 1, len(known) - 1)
    share = place - low
    step = rotation_vectors(np.matmul(relative[high], relative[low].swapaxes(-1, -2)))
    turns = np.matmul(turn_matrices(step * share[:, None, None]), relative[low])
    return turns, root[low] + share[:, None] * (root[high] - root[low])


def _between(
    body: ScanBody,
    capture: PointMotion,
    shape: Float[Array, "shapes"],
    relative: Float[Array, "frames joints 3 3"],
    root: Float[Array, "frames 3"],
    shown: Bool[Array, "frames"],
) -> tuple[Float[Array, "frames joints 3 3"], Float[Array, "frames 3"]]:
    """Every frame fitted once more, expected in the middle of its neighbours: what no speed foretells comes without lag."""
    shaped, turns, path = body.shaped(shape), relative.copy(), root.copy()
    precision = TIGHTER * steadiness() * (capture.fps / 30.0) ** 2
    rigid = body.usual_shape
    for frame in np.flatnonzero(shown):
        before, after = max(frame - 1, 0), min(frame + 1, len(root) - 1)
        if before == frame or after == frame:
            continue
        half = 0.5 * rotation_vectors(relative[after] @ turns[before].swapaxes(-1, -2))
        expected = Expected(
            np.matmul(turn_matrices(half), turns[before]), precision, usual_precision(), 0.5 * (path[before] + root[after]),
            (ROOT_BETWEEN * 30.0 / capture.fps) ** -2, shape, rigid,
        )  # fmt: skip
        state = BodyState(shape, world_turns(body, relative[frame]), root[frame])
        cloud = skin_only(body, (state,), ready(capture.clouds[frame]), shaped)
        if len(cloud) < FEWEST:
            continue
        fit = fit_cloud(body, state, binned(cloud), expected, BETWEEN, False, shaped)
        turns[frame], path[frame] = relative_turns(body, fit.state.turns), fit.state.root
    return turns, path


def _notes(shown: Bool[Array, "frames"], fps: float) -> list[str]:
    missing = np.flatnonzero(~shown)
    if not len(missing):
        return []
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
    told = ", ".join(
        f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs[:5]
    ) + (", ..." if len(runs) > 5 else "")
    return [f"{len(missing)} of {len(shown)} frames show nobody and are interpolated: {told}"]
