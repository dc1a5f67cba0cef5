"""What some frames of a capture show before it is followed: its unit, which way is up, and that one person is in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from retarget.body import rotations as rot
from retarget.body.human import human_model
from retarget.errors import RetargetError
from retarget.methods.scan.cloud import pieces
from retarget.methods.scan.recover import joints_of
from retarget.methods.scan.scan_body import scan_body
from retarget.methods.scan.starts import Regressor, misfit
from retarget.methods.scan.tracker import ENOUGH, FEWEST, Tracker, ready
from retarget.motion.align import AXES, Similarity, infer_unit
from retarget.rig.fit_model import BodyState

Array = np.ndarray

LOOKED_AT = 3
"""Frames that are looked at, spread over those that hold enough points."""
UPRIGHT = ("+y", "+z", "-y", "-z")
"""Up axes that are tried where nobody says, the likeliest first."""
SURELY = 0.02
"""Metres of misfit at which no other axis is tried for a body that stands."""
BETTER, LYING = 1.2, 2.0
"""How many times better than the likeliest axis another must be, and than standing lying must: the wrong way up bodies came out
1.36 to 3 times as far off in 79 captures of four people, least in skirts; lying ones may fit a little better than standing ones."""
STANDING = 0.7
"""Cosine between up and the line from the feet to the trunk and head from which on a body stands, sits or crouches."""
SECOND_POINTS, SECOND_TALL = 0.35, 0.5
"""A further piece with so large a share of the first one's points and height is a person of its own."""


@dataclass(frozen=True, eq=False)
class Seen:
    """How a capture lies."""

    space: Similarity
    """Into metres with +Y up."""
    notes: tuple[str, ...]


def look_at(
    clouds: Sequence[Shaped[Array, "_ 3"]], regressor: Regressor | None, up: str | None, unit: float | None
) -> Seen:
    """Find unit and up axis, where they are not given, and that there is one body.

    Raises `RetargetError` for an unknown axis, a unit that is no length, a capture in which no frame holds a body, and for one
    that shows two.
    """
    if up is not None and up not in AXES:
        raise RetargetError(f"the up axis is one of {', '.join(AXES)}, received {up!r}")
    if unit is not None and not 0.0 < unit < float("inf"):
        raise RetargetError(f"unit must be positive metres per unit, received {unit}")
    frames = list(_telling(clouds))
    if not frames:
        most = max((len(cloud) for cloud in clouds), default=0)
        raise RetargetError(f"no frame holds enough points for a body: at most {most}, {FEWEST} evenly spread ones are needed")
    notes = []
    if unit is None:
        size = float(np.median([np.ptp(np.percentile(frame, [1, 99], axis=0), axis=0).max() for frame in frames]))
        unit, why = infer_unit(size)
        if unit != 1.0:
            notes.append(f"unit: {why}")
    tried = {axis: _fits(frames, axis, unit, regressor) for axis in ((up,) if up is not None else ())}
    for axis in UPRIGHT if up is None else ():
        tried[axis] = _fits(frames, axis, unit, regressor)
        if tried[axis].standing < SURELY:
            break
    best = _likeliest(tried)
    if tried[best].misfit > ENOUGH:
        raise RetargetError(
            f"nothing like a human body is seen in the {len(frames)} frames that were looked at: the best try is off by "
            f"{tried[best].misfit * 100:.1f} cm (at most {ENOUGH * 100:.1f}); --up and --unit say how a capture lies"
        )
    if up is None and best != "+y":
        stands = np.isfinite(tried[best].standing)
        notes.append(f"up axis {best}: " + ("the body stands that way" if stands else "a body fits best that way, though lying (--up says otherwise)"))
    return Seen(Similarity(rot.swing_between(AXES[best], AXES["+y"]), unit), tuple(notes))


def _telling(clouds: Sequence[Shaped[Array, "_ 3"]]) -> Iterator[Float[Array, "_ 3"]]:
    """Some frames with enough points, as floats without what is not finite."""
    full = [number for number, cloud in enumerate(clouds) if len(cloud) >= FEWEST]
    for place in np.unique(np.linspace(0, len(full) - 1, LOOKED_AT).round().astype(int)) if full else ():
        points = np.asarray(clouds[full[place]], dtype=np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) >= FEWEST:
            yield points


@dataclass(frozen=True)
class Try:
    """What is seen when an axis is up: misfits of the frames that show a body best, metres; infinite where none does."""

    misfit: float
    standing: float
    """Of frames on which it stands: a body that lies is found as well, and does not say which way is up."""


def _likeliest(tried: Mapping[str, Try]) -> str:
    """The axis along which a body stands well: the first one tried, unless another is `BETTER`."""
    first = next(iter(tried))

    def miss(axis: str) -> float:
        seen = tried[axis]
        return min(seen.standing, LYING * seen.misfit) * (1.0 if axis == first else BETTER)

    return min(tried, key=miss)


def _fits(frames: Sequence[Array], axis: str, unit: float, regressor: Regressor | None) -> Try:
    """What the frames show when an axis is up; raises where most show two bodies."""
    space = Similarity(rot.swing_between(AXES[axis], AXES["+y"]), unit)
    misfits, standing, doubles = [], [], 0
    for frame in frames:
        points = ready(space.points(frame))
        if len(points) < FEWEST:
            continue
        doubles += _two_bodies(points)
        fit = Tracker(regressor).found(points)
        if fit is not None:
            misfits.append(misfit(fit))
            standing += misfits[-1:] if _stands(fit.state) else []
    if doubles > len(frames) / 2:
        raise RetargetError("two bodies are seen in the capture; cut it to the one whose motion is wanted")
    return Try(*(float(min(each, default=np.inf)) for each in (misfits, standing)))


def _stands(state: BodyState) -> bool:
    """Whether a body has its trunk and head above its feet."""
    body = scan_body()
    joints = joints_of(body, body.shaped(state.shape), state)
    hips, head, *feet = (joints[human_model().joint_names.index(name)] for name in ("hips", "head", "leftFoot", "rightFoot"))
    up = 0.5 * (hips + head) - np.mean(feet, axis=0)
    return bool(up[1] > STANDING * np.linalg.norm(up))


def _two_bodies(points: Float[Array, "points 3"]) -> bool:
    piece = pieces(points)
    first, second = points[piece == 0], points[piece == 1]
    if len(second) < SECOND_POINTS * len(first):
        return False
    return float(np.ptp(second[:, 1])) > SECOND_TALL * float(np.ptp(first[:, 1]))
