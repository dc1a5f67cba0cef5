"""What a technical artist wants to know before accepting a clip: figures, curves over time, and findings in plain words.

    >>> report = evaluate(Take(source, dance), Take(knight, knight_dance))
    >>> report.figures["foot_slide_cm"], report.problems[0].sentence

The figures are those of the benches, by the same formulas (`formulas.py`): lengths named cm and mm at a body height of
1.7 m. Curves and sentences are in the result's own size; what they show of the source is scaled to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from retarget.contact.parts import PARTS
from retarget.errors import RetargetError
from retarget.evaluate.problems import Problem, together, worst_first
from retarget.evaluate.report_contacts import carried_contacts, lost_contacts
from retarget.evaluate.report_joints import Curves, Figures, Grounds, grounds, joint_report, resting_names
from retarget.evaluate.report_surface import (
    SurfaceTrack,
    added_penetration,
    deepest_fact,
    penetration_figures,
    penetrations,
    surface_curves,
    surface_track,
    through_floor,
    touch_curves,
)
from retarget.evaluate.report_truth import require_one_body, truth_figures
from retarget.evaluate.take import Take, on_one_clock
from retarget.progress import Tell, untold

Array = np.ndarray

RESTS = 0.2
"""Seconds that a part rests on the ground in all before it is named."""


@dataclass(frozen=True, eq=False)
class Report:
    """One result against its source."""

    figures: dict[str, float | None]
    """By the names in `formulas.py`; those of the source alone begin with 'source_'. None where there is nothing to
    measure, absent where a body lacks what it takes (a surface, a truth)."""
    curves: dict[str, Array]
    """One value a frame, named KIND/WHO/WHAT: 'ground' and 'touch' are bool, 'depth_cm', 'foot_height_cm' and 'speed_m_s'
    are what they say, WHO is 'result' or 'source'; and 'time_s'."""
    facts: dict[str, str]
    """What is no figure: what the result rests on, where it is deepest in itself."""
    problems: tuple[Problem, ...]
    """The worst first, at most ten."""
    notes: tuple[str, ...]
    """What was inferred, resampled or left out."""
    height: float
    """Of the result's body, metres."""
    source_height: float
    tracks: Mapping[str, SurfaceTrack] = field(default_factory=dict)
    """What the skin of 'result' and 'source' does, for those that have one: for views, not for JSON."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "figures": self.figures,
            "facts": self.facts,
            "problems": [
                {"sentence": each.sentence, "severity": round(each.severity, 3), "time_s": round(each.time, 4)}
                for each in self.problems
            ],
            "notes": list(self.notes),
            "height_m": self.height,
            "source_height_m": self.source_height,
            "curves": {name: _listed(curve) for name, curve in self.curves.items()},
        }


def evaluate(
    source: Take, result: Take, truth: Take | None = None, fps: float | None = None, tell: Tell = untold
) -> Report:
    """Measure a result against its source and, where it is known, the true animation of the same character.

    Bodies are in metres with +Y up. All are brought to `fps` (None: 30, or fewer where one of them has fewer) and to the
    length they share. Raises `RetargetError` for motions without frames and for a truth of another body.
    """
    if truth is not None:
        require_one_body(result, truth)
    takes = {"source": source, "result": result} | ({"truth": truth} if truth is not None else {})
    (source, result, *rest), notes = on_one_clock(takes, fps)
    tell("joints and feet", 0)
    ground = grounds(source, result)
    figures, curves, problems = joint_report(source, result, ground)
    figures = {"frames": float(len(result)), "seconds": result.motion.seconds, "fps": result.fps} | figures
    facts: dict[str, str] = {}
    notes += ground.notes
    tracks = _tracks(source, result, ground, tell)
    if "result" in tracks:
        own_figures, own_curves, own_problems, own_notes = _surface_report(tracks.get("source"), tracks["result"], tell)
        figures, curves = figures | own_figures, curves | own_curves
        problems, notes = [*problems, *own_problems], [*notes, *own_notes]
        facts |= {"deepest": deepest_fact(tracks["result"]) or "nowhere"}
    else:
        notes.append("the result has no surface: penetration and contacts are not measured")
    if "result" in tracks and "source" not in tracks:
        notes.append("the source has no surface: its contacts and penetration are not known")
    facts["rests on"] = ", ".join(_rests_on(result, ground, tracks.get("result"))) or "nothing"
    if rest:
        tell("truth", 0)
        figures |= truth_figures(result, rest[0])
    return Report(
        {name: _known(value) for name, value in figures.items()},
        curves,
        facts,
        worst_first(problems),
        tuple(notes),
        result.actor.height,
        source.actor.height,
        tracks,
    )


def _tracks(source: Take, result: Take, ground: Grounds, tell: Tell) -> dict[str, SurfaceTrack]:
    """What the skin of those does that have one; the source's is of use only beside the result's."""
    tracks = {}
    if result.has_surface:
        tracks["result"] = surface_track(result, ground.floor, lambda doing, n=0: tell(f"result: {doing}", n))
        if source.has_surface:
            floor = ground.source.floor
            tracks["source"] = surface_track(source, floor, lambda doing, n=0: tell(f"source: {doing}", n))
    return tracks


def _surface_report(
    source: SurfaceTrack | None, result: SurfaceTrack, tell: Tell
) -> tuple[Figures, Curves, list[Problem], list[str]]:
    figures, curves = penetration_figures(result), surface_curves("result", result)
    problems = [*penetrations(source, result), *through_floor(source, result)]
    notes: list[str] = []
    if not result.parts.limb_vertices.any():
        notes.append("no arms or legs were found in the result's surface: penetration is not measured")
    curves |= touch_curves(source, result)
    if source is None:
        return figures, curves, problems, notes
    bigger = result.take.actor.height / source.take.actor.height
    curves |= surface_curves("source", source, bigger)
    figures |= {f"source_{name}": value for name, value in penetration_figures(source).items()}
    figures |= added_penetration(source, result)
    tell("carrying contacts", 0)
    figures["contacts_kept"] = None
    try:
        carried = carried_contacts(source, result)
    except RetargetError as error:  # two bodies without a common layout of sensors: all else is still worth telling
        return figures, curves, problems, [*notes, f"contacts are not carried: {error}"]
    figures["contacts_kept"] = carried.kept
    notes += [carried.note] if carried.note else []
    return figures, curves, [*problems, *lost_contacts(carried, result)], notes


def _rests_on(result: Take, ground: Grounds, track: SurfaceTrack | None) -> Sequence[str]:
    """What carries the body, the longest first."""
    if track is None:
        return together(resting_names(ground.result.touching, result.fps))
    frames = track.resting.touching.sum(axis=0)
    least = min(RESTS * result.fps, len(result))
    order = sorted(np.flatnonzero(frames >= max(least, 1)), key=lambda part: -frames[part])
    return together(PARTS[part] for part in order)


def _known(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _listed(curve: Array) -> list:
    return curve.tolist() if curve.dtype == bool else np.round(curve, 4).tolist()
