"""Hands that go to their place on the body, stay, and come back: in time, and never through the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from motion_body import Performer
from motion_hands import Hold, arm_problem, body_faces, keep_hold, limb_vertices, one_frame, polish, settle
from motion_pose import ARM, Channels
from motion_time import FPS, ease
from motion_touch import PosedSurface

from retarget.motion.filter import gaussian

Array = np.ndarray
Times = tuple[float, float, float, float]
LATE = np.array([-0.05, -0.04, -0.02, -0.02, 0.0, 0.0, 0.02, 0.05, 0.05, *[0.07] * 3, 0.05, 0.06, 0.07, 0.08, 0.05])
"""Seconds by which each arm angle follows: the shoulder leads, wrist and fingers trail."""


def solve_places(
    performer: Performer, act: Channels, frame: int, holds: Sequence[Hold], guesses: Sequence[Array], lift: float, together: bool = False
) -> tuple[list[Array], list[Array]]:  # fmt: skip
    """(contact poses, poses `lift` metres off) of the arms at one frame; each is placed alone first, in their order.

    With `together` the guesses are taken for places already, from which all arms move at once.
    """
    own = {hold.side: act.arms[hold.side][frame].copy() for hold in holds}
    for hold, guess in zip(holds, guesses, strict=True):
        act.arms[hold.side][frame] = guess
    if not together:
        for hold, guess in zip(_one_by_one(holds), guesses, strict=True):
            act.arms[hold.side][frame] = settle(*(arm_problem(performer, act, frame, [hold], off) for off in (0.0, 0.04)), guess)
    problem = arm_problem(performer, act, frame, holds)
    contact = np.concatenate([act.arms[hold.side][frame] for hold in holds])
    if len(holds) > 1:
        contact = problem.solve(contact, rounds=90 if together else 35)
    contacts = np.split(polish(problem, contact, aim=0.0 if together else 0.3), len(holds))
    for hold, angles in zip(holds, contacts, strict=True):
        act.arms[hold.side][frame] = angles
    hovers, fingers = [], ARM.index("adduct")
    for hold, angles in zip(_one_by_one(holds), contacts, strict=True):
        hover = arm_problem(performer, act, frame, [hold], lift).solve(angles, rounds=30)
        hover[fingers:] = 0.5 * (hover + own[hold.side])[fingers:]
        hovers.append(hover)
    for side, angles in own.items():
        act.arms[side][frame] = angles
    return contacts, hovers


def _one_by_one(holds: Sequence[Hold]) -> list[Hold]:
    """Each hold without heed of those that come after it."""
    return [replace(hold, clear=(*hold.clear, *(later.side for later in holds[k + 1 :]))) for k, hold in enumerate(holds)]


def reach(
    performer: Performer, act: Channels, t: Array, holds: Sequence[Hold], guesses: Sequence[Array], times: Sequence[Times],
    lift: float = 0.07, close: float = 0.3, together: bool = False,
) -> None:  # fmt: skip
    """Let hands touch. Each sets out at its times[0], touches from times[1] to times[2] and is back at times[3].

    The contact poses are solved on the skin together, then poses `lift` metres off it; the way leads from what the arm
    does anyway through the second to the first within `close` seconds, and back.
    """
    arrive, leave = max(each[1] for each in times), min(each[2] for each in times)
    frame = int(round(0.5 * (arrive + leave) * FPS))
    contacts, hovers = solve_places(performer, act, frame, holds, guesses, lift, together)
    when = t[:, None] - LATE
    for hold, contact, hover, own_times in zip(holds, contacts, hovers, times, strict=True):
        start, comes, goes, end = own_times
        near = ease(when, comes - close, comes) * (1 - ease(when, goes, goes + close))
        own = ease(when, start, comes - 0.25 * close) * (1 - ease(when, goes + 0.25 * close, end))
        path = hover + (contact - hover) * near
        act.arms[hold.side] = act.arms[hold.side] * (1 - own) + path * own
    aim = 0.0 if together else 0.3
    keep_hold(performer, act, holds, arrive + 0.05, leave - 0.02, aim=aim)
    _come_and_go(performer, act, holds, times, arrive, leave)
    if together:  # arms that lie on each other: what bent the way of one has moved the hold of both
        keep_hold(performer, act, holds, arrive + 0.05, leave - 0.02, aim=aim)
        _come_and_go(performer, act, holds, times, arrive - 0.1, leave + 0.1)


def _come_and_go(performer: Performer, act: Channels, holds: Sequence[Hold], times: Sequence[Times], arrive: float, leave: float) -> None:
    """Keep arms out of the body on their way to the contact and back."""
    for hold in holds:
        keep_out(performer, act, hold.side, min(each[0] for each in times), arrive, hold.clear)
        keep_out(performer, act, hold.side, leave, max(each[3] for each in times), hold.clear)


def sunk(performer: Performer, act: Channels, side: str, frames: Array, clear: Sequence[str] = ()) -> Array:
    """How deep the arm lies in the rest of the body at some frames, metres (0 where it does not)."""
    limb, faces = limb_vertices(performer, side), body_faces(performer, side, *clear)
    first_corners = performer.faces[faces, 0]
    depth = []
    for frame in frames:
        posed = performer.skin(performer.world(*one_frame(performer, act, int(frame))))[0]
        low, high = posed[limb].min(axis=0) - 0.06, posed[limb].max(axis=0) + 0.06
        around = ((posed[first_corners] > low) & (posed[first_corners] < high)).all(axis=1)
        if not around.any():
            depth.append(0.0)
            continue
        distance = PosedSurface(posed, performer.faces, faces[around]).nearest(posed[limb])[3]
        depth.append(max(0.0, -distance[distance > -0.05].min(initial=0.0)))
    return np.array(depth)


def keep_out(
    performer: Performer, act: Channels, side: str, start: float, end: float, clear: Sequence[str] = (), rounds: int = 4
) -> None:  # fmt: skip
    """Bend the way of an arm between two times (seconds) so that it leaves the body where it would sink in by over 1 mm."""
    frames = np.arange(max(int(start * FPS), 0), min(int(end * FPS) + 1, act.frames))
    for _ in range(rounds):
        depth = sunk(performer, act, side, frames, clear)
        if depth.max(initial=0.0) < 0.0012:
            return
        correction = np.zeros_like(act.arms[side])
        for frame in frames[depth > 0.0008]:
            problem = arm_problem(performer, act, int(frame), [Hold(side, clear=clear)])
            problem = replace(problem, aparts=[replace(apart, margin=0.002) for apart in problem.aparts], prior=problem.prior * 0.5)
            angles = act.arms[side][frame]
            correction[frame] = problem.solve(angles, rounds=8) - angles
        # Smoothing takes some of what the frames in need were given: give it back to all.
        peak = np.abs(correction).max(axis=1).max()
        spread = gaussian(correction, 2.0)
        act.arms[side] = act.arms[side] + spread * min(peak / max(np.abs(spread).max(), 1e-9), 3.0)
