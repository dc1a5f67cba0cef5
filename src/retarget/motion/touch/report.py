"""What the interaction solver changed, and what it could not mend."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from retarget.contact.ground import intervals
from retarget.contact.parts import PARTS
from retarget.motion.touch.equations import PoseEquations
from retarget.motion.touch.goals import ClipGoals, FrameGoals

Array = np.ndarray

NOTABLE = np.radians(2.0)
"""Turns smaller than this are not listed."""
MOST = 20
"""Lines of each list."""
EVERY = 0.2
"""Seconds between the frames that are looked at for what is left."""
DEEP = 0.006
"""Share of the height: what is inside another part by more than this, and more than in the source, is told."""
OFF = 3.0
"""Contact thresholds: contacts that are missed by more than this, on the average of their parts, are told."""


def corrections(
    equations: PoseEquations, x: Float[Array, "frames unknowns"], seconds: Float[Array, "frames"]
) -> dict[str, Any]:
    """Which joints were turned when, and by how much at most; degrees, centimetres and seconds."""
    angle = np.linalg.norm(x[:, :-3].reshape(len(x), -1, 3), axis=-1)
    rows = []
    for number, name in enumerate(equations.levers.names):
        for start, stop in intervals(angle[:, number] > NOTABLE):
            rows.append({
                "joint": name, "start": round(float(seconds[start]), 3), "end": round(float(seconds[stop - 1]), 3),
                "degrees": round(float(np.degrees(angle[start:stop, number].max())), 2),
            })  # fmt: skip
    largest = angle.max(axis=1, initial=0.0)
    return {
        "corrections": sorted(rows, key=lambda row: (-row["degrees"], row["start"], row["joint"]))[:MOST],
        "corrected_seconds": round(float((largest > np.radians(0.5)).mean() * (seconds[-1] - seconds[0])), 3),
        "largest_correction_degrees": round(float(np.degrees(largest.max(initial=0.0))), 2),
        "largest_hip_shift_cm": round(100 * float(np.linalg.norm(x[:, -3:], axis=1).max(initial=0.0)), 2),
    }


def remaining(
    equations: PoseEquations,
    goals: ClipGoals,
    seconds: Float[Array, "frames"],
    posed: Callable[[int], Shaped[Array, "vertices 3"]],
) -> tuple[str, dict[str, Any]]:
    """What is still inside another part, and contacts that are not reached, on some frames of the result: a status and the
    lists. `posed` gives the result's vertices (metres) on a frame. Where not everything can hold, closeness to the copied pose
    gives way first, then contacts, penetration last."""
    step = max(1, round(EVERY / max(float(seconds[1] - seconds[0]), 1e-6))) if len(seconds) > 1 else 1
    deepest: dict[tuple[str, str], tuple[float, float]] = {}
    missed: dict[tuple[str, str], tuple[float, float]] = {}
    for frame in range(0, len(seconds), step):
        vertices = np.asarray(posed(frame), dtype=np.float64)
        if not np.isfinite(vertices).all():
            return "the solution is not finite on some frames", {}
        own = goals.frame(frame)
        for found, rows in ((deepest, _inside(equations, own, vertices)), (missed, _off(equations, own, vertices))):
            for pair, value in rows:
                if value > found.get(pair, (0.0, 0.0))[0]:
                    found[pair] = (value, float(seconds[frame]))
    lists = {
        name: [
            {"parts": list(pair), "cm": round(100 * value, 2), "at": round(at, 3)}
            for pair, (value, at) in sorted(rows.items(), key=lambda row: (-row[1][0], row[0]))[:MOST]
        ]
        for name, rows in (("still_inside", deepest), ("not_reached", missed))
    }
    words = []
    for name, text in (("still_inside", "inside"), ("not_reached", "away from")):
        if lists[name]:
            worst = lists[name][0]
            words.append(f"{worst['parts'][0]} is {worst['cm']} cm {text} {worst['parts'][1]} at {worst['at']:.2f} s")
    return ("not everything could hold: " + "; ".join(words) if words else "ok"), lists


def _inside(equations: PoseEquations, own: FrameGoals, vertices: Array) -> Iterator[tuple[tuple[str, str], float]]:
    """(parts, metres) of vertices deeper inside another part than they may be."""
    near = equations.collider.pairs(vertices)
    if len(near.vertex) == 0:
        return
    allowed = np.zeros(len(vertices))
    allowed[own.sunk] = own.depth
    deep = -near.distance - allowed[near.vertex]
    parts = equations.collider.parts.vertex_parts[near.vertex]
    for row in np.flatnonzero(deep > DEEP * equations.actor.height):
        yield (PARTS[parts[row]], PARTS[near.part[row]]), float(deep[row])


def _off(equations: PoseEquations, own: FrameGoals, vertices: Array) -> Iterator[tuple[tuple[str, str], float]]:
    """(parts, metres) of contacts that are missed, on the average of two parts."""
    full = own.weight > 0.5
    if not full.any():
        return
    points, others = (
        np.einsum("pc,pci->pi", shares[full], vertices[corners[full]])
        for corners, shares in ((own.first, own.first_shares), (own.second, own.second_shares))
    )
    away = np.maximum(np.linalg.norm(points - others, axis=1) - own.gap[full], 0.0)
    parts = equations.collider.parts.vertex_parts
    first, second = parts[own.first[full, 0]], parts[own.second[full, 0]]
    for pair in np.unique(np.stack([first, second], axis=1), axis=0):
        chosen = (first == pair[0]) & (second == pair[1])
        mean = float(away[chosen].mean())
        if mean > OFF * equations.threshold:
            yield (PARTS[pair[0]], PARTS[pair[1]]), mean
