"""A hand that goes to its place on the body, stays, and comes back: in time, and never through the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from motion_body import Performer
from motion_hands import Hold, arm_problem, body_faces, keep_hold, limb_vertices, one_frame, settle
from motion_pose import ARM, Channels
from motion_time import FPS, ease
from motion_touch import PosedSurface

from retarget.motion.filter import gaussian

Array = np.ndarray
LATE = np.array([-0.05, -0.04, -0.02, -0.02, 0.0, 0.0, 0.02, 0.05, 0.05, *[0.07] * 3, 0.05, 0.06, 0.07, 0.08, 0.05])
"""Seconds by which each arm angle follows: the shoulder leads, wrist and fingers trail."""


def reach(
    performer: Performer, act: Channels, t: Array, hold: Hold, guess: Array, times: tuple[float, float, float, float],
    away: tuple[float, float, float], lift: float = 0.07, close: float = 0.3, back: Array | None = None,
) -> None:  # fmt: skip
    """Let one hand touch from times[1] to times[2]; it sets out at times[0] and is back at times[3].

    The contact pose is solved on the skin, then a pose `lift` metres off it in the direction `away`; the way leads from
    what the arm does anyway through the second to the first within `close` seconds, and back.
    """
    start, arrive, leave, end = times
    angles = act.arms[hold.side]
    frame = int(round(0.5 * (arrive + leave) * FPS))
    contact = settle(arm_problem(performer, act, frame, hold), guess)
    off = arm_problem(performer, act, frame, hold, lift, away)
    hover = off.solve(contact, rounds=25)
    fingers = ARM.index("adduct")
    hover[fingers:] = 0.5 * (hover + angles[frame])[fingers:]
    when = t[:, None] - LATE
    near = ease(when, arrive - close, arrive) * (1 - ease(when, leave, leave + close))
    own = ease(when, start, arrive - 0.25 * close) * (1 - ease(when, leave + 0.25 * close, end))
    path = hover + (contact - hover) * near
    act.arms[hold.side] = angles * (1 - own) + path * own
    keep_hold(performer, act, hold, arrive + 0.05, leave - 0.02)


def sunk(performer: Performer, act: Channels, side: str, frames: Array, clear: tuple[str, ...] = ()) -> Array:
    """How deep the arm lies in the rest of the body at some frames, metres (0 where it does not)."""
    limb, faces = limb_vertices(performer, side), body_faces(performer, side, *clear)
    depth = []
    for frame in frames:
        posed = performer.skin(performer.world(*one_frame(performer, act, int(frame))))[0]
        distance = PosedSurface(posed, performer.faces, faces).nearest(posed[limb])[3]
        depth.append(max(0.0, -distance[distance > -0.05].min(initial=0.0)))
    return np.array(depth)


def keep_out(
    performer: Performer, act: Channels, side: str, start: float, end: float, clear: tuple[str, ...] = (), rounds: int = 3
) -> None:  # fmt: skip
    """Bend the way of an arm between two times (seconds) so that it leaves the body where it would sink in by over 1 mm."""
    frames = np.arange(max(int(start * FPS), 0), min(int(end * FPS) + 1, act.frames))
    for _ in range(rounds):
        depth = sunk(performer, act, side, frames, clear)
        if depth.max(initial=0.0) < 0.0012:
            return
        correction = np.zeros_like(act.arms[side])
        for frame in frames[depth > 0.0008]:
            problem = arm_problem(performer, act, int(frame), Hold(side, (), (), {}, clear=clear), lift=1e-9)
            problem = replace(problem, aparts=tuple(replace(apart, margin=0.002) for apart in problem.aparts), prior=problem.prior * 0.5)
            angles = act.arms[side][frame]
            correction[frame] = problem.solve(angles, rounds=8) - angles
        # Widened before it is smoothed, so that the frames in need keep what they need.
        peak = np.abs(correction).max(axis=1)
        spread = gaussian(correction, 2.0)
        gain = peak.max() / max(np.abs(spread).max(axis=1).max(), 1e-9)
        act.arms[side] = act.arms[side] + spread * min(gain, 3.0)
