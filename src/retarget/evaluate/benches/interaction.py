"""The interaction bench: what is kept, what sinks in, what it costs; what each term and the paper's own field are worth."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.contact.collide import prepare_collider
from retarget.evaluate import metrics
from retarget.evaluate.benches.collision import refined
from retarget.evaluate.benches.contact import by_split, foot_slide, jerk_ratio
from retarget.evaluate.contact_cases import (
    CAPTURED,
    QUICK_TARGETS,
    SPLITS,
    ContactCase,
    Performance,
    cases_of,
    embedded_actor,
    foreign_actors,
    performances,
)
from retarget.evaluate.environment import environment
from retarget.evaluate.fault import faultless_frames
from retarget.evaluate.keepable import keepable_tracks, search
from retarget.evaluate.touch import SourceTouch, observe, prepare_judge
from retarget.methods.base import Method, Retargeter
from retarget.methods.copy_rotations import CopyRotations
from retarget.methods.interaction.method import Interaction
from retarget.motion.filter import resample
from retarget.motion.library import embedded_motion
from retarget.motion.steady import END_JOINTS
from retarget.motion.touch.equations import Weights
from retarget.progress import Tell, untold

SEED = 1
FPS = 30.0
COPY, OURS, ONLINE = "copy-rotations", "ours", "ours, online"
MAIN: dict[str, Callable[[], Method]] = {
    COPY: CopyRotations,
    OURS: Interaction,
    ONLINE: lambda: Interaction(causal=True),
}
ABLATIONS: dict[str, Callable[[], Method]] = {
    "contacts alone": lambda: Interaction(weights=Weights(repulsion=0.0, near=0.0)),
    "repulsion alone": lambda: Interaction(weights=Weights(contact=0.0, across=0.0, near=0.0)),
    "contacts, repulsion": lambda: Interaction(weights=Weights(near=0.0)),
    "no tangent": lambda: Interaction(weights=Weights(across=0.0)),
}
FIELD_ROWS = {
    "DMI nearest": "nearest", "DMI farthest": "farthest", "DMI both": "both", "distance matrix": "distances",
}  # fmt: skip
ABLATION_MOTIONS, ABLATION_TARGETS = ("hands_on_hips", "arms_crossed", "hand_on_belly"), ("heavy", "child")
"""Seen cases on which every term, and the paper's field, are run: the field takes tens of milliseconds a frame."""
HEAVIER = ("heavy", "very_heavy", "muscular", "average")
"""As heavy as the performers, who are thin, or heavier."""
HEAVY_SOURCES = {"very_heavy": "u", "heavy": "s"}
SLIM_TARGETS = ("child", "average", "tall", "elderly")
HEAVY_MOTIONS = ("hands_on_hips", "hand_on_belly", "arms_crossed", "hand_to_shoulder")
"""Heavy performers (of the solver's own results: no other heavy performance is at hand) and who is slimmer."""
FOREIGN_MOTIONS = ("hands_on_hips", "arms_crossed", "hand_to_shoulder", "hands_behind_head")
QUICK_MOTIONS = ("hands_on_hips", "arms_crossed")
TOGETHER_EVERY = 15
"""Of so many frames one is looked at for how many contacts can be kept together."""
LEGS = tuple(f"{side}{part}" for side in ("left", "right") for part in ("UpperLeg", "LowerLeg", "Foot"))

KEYS: dict[str, str] = {
    "contacts_kept": "higher", "parts_kept": "higher", "contact_error": "lower", "two_sided_contact_error": "lower", "penetration_percent": "lower",
    "excess_penetration_percent": "lower", "new_penetration_percent": "lower", "depth_p95_mm": "lower",
    "parts_gained_percent": "lower", "foot_slide_cm": "lower", "jerk_ratio": "lower", "jerk_added_mm": "lower",
    "displacement_cm": "lower", "leg_change_deg": "lower", "no_fault_change_deg": "lower", "frames_per_second": "higher",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Copied:
    """What copy-rotations makes of a case: what all others are compared with."""

    motion: Any
    faultless: Any
    """Frames on which it has no fault."""


def run(quick: bool = False, tell: Tell = untold) -> dict[str, Any]:
    """Every row on every case, then the terms apart, heavy performers, foreign characters, and speed."""
    cases: list[dict[str, Any]] = []
    for performance, touch, case in open_set(quick, tell):
        countable = keepable_tracks(touch, performance.name, case.target_name)
        rows = MAIN if not quick else {name: MAIN[name] for name in (COPY, OURS)}
        cases += measured(case, touch, countable, rows, tell)
    ablations = [] if quick else list(_ablations(tell))
    slimmer = list(_slimmer(quick, tell))
    foreign = [] if quick else list(_foreign(tell))
    rows = [by_split(cases, method, split, KEYS) for method in dict.fromkeys(c["method"] for c in cases) for split in SPLITS]
    rows += [by_split(ablations, method, "ablation", KEYS) for method in dict.fromkeys(c["method"] for c in ablations)]
    rows += [by_split(slimmer, method, "slimmer", KEYS) for method in (COPY, OURS)]
    rows += [by_split(foreign, method, "foreign", KEYS) for method in (COPY, OURS) if foreign]
    characters = sorted({case["target"] for case in foreign})
    rows += [_of_character(foreign, method, name) for name in characters for method in (COPY, OURS)]
    summary = _summary(cases, slimmer, foreign, quick) | _speed(quick, tell)
    return {
        "bench": "interaction",
        "quick": quick,
        "environment": environment() | {"seeds": {}},
        "summary": summary,
        "rows": rows,
        "cases": [*cases, *ablations, *slimmer, *foreign],
        "lines": _table(rows, summary, cases),
    }


def open_set(quick: bool, tell: Tell) -> Iterator[tuple[Performance, SourceTouch, ContactCase]]:
    """Every case, with the performance's contacts."""
    for performance in performances(False):
        if quick and performance.name not in QUICK_MOTIONS:
            continue
        tell(f"contacts of {performance.name}")
        touch = observe(performance.source, performance.motion)
        for case in cases_of(performance, False):
            if not quick or case.target_name in QUICK_TARGETS:
                yield performance, touch, case


def _ablations(tell: Tell) -> Iterator[dict[str, Any]]:
    from retarget.evaluate.reference.dmi import FieldOnly

    rows = {COPY: CopyRotations, OURS: Interaction, **ABLATIONS}
    rows |= {name: (lambda kind=kind: FieldOnly(kind)) for name, kind in FIELD_ROWS.items()}
    source = embedded_actor("thin")
    for name in ABLATION_MOTIONS:
        performance = Performance(name, source, embedded_motion(name))
        touch = observe(source, performance.motion)
        for target in ABLATION_TARGETS:
            case = ContactCase(performance, target, embedded_actor(target), "ablation")
            yield from measured(case, touch, keepable_tracks(touch, name, target), rows, tell)


def _slimmer(quick: bool, tell: Tell) -> Iterator[dict[str, Any]]:
    """Heavy performers onto slimmer bodies."""
    thin = embedded_actor("thin")
    for body in list(HEAVY_SOURCES)[: 1 if quick else None]:
        heavy = embedded_actor(body)
        for name in HEAVY_MOTIONS[: 1 if quick else None]:
            motion = Interaction().prepare(thin, heavy)(embedded_motion(name)).motion
            performance = Performance(f"{name} by {body}", heavy, motion)
            touch = observe(heavy, motion)
            for target in SLIM_TARGETS[: 2 if quick else None]:
                case = ContactCase(performance, target, embedded_actor(target), "slimmer")
                yield from measured(case, touch, None, {COPY: CopyRotations, OURS: Interaction}, tell)


def _foreign(tell: Tell) -> Iterator[dict[str, Any]]:
    """Characters of other makers, judged through sensors."""
    source = embedded_actor("thin")
    for name in FOREIGN_MOTIONS:
        performance = Performance(name, source, embedded_motion(name))
        touch = observe(source, performance.motion)
        for target_name, target in foreign_actors():
            judge = prepare_judge(touch, target)
            copied = CopyRotations(limits=False).prepare(source, target)(performance.motion).motion
            countable = search(touch, target, judge.carried, copied, judge.threshold, SEED)
            case = ContactCase(performance, target_name, target, "foreign")
            together = judge.keepable_together(touch, copied, countable, TOGETHER_EVERY, SEED)
            for row in measured(case, touch, countable, {COPY: CopyRotations, OURS: Interaction}, tell):
                yield row | {"contacts_keepable": together}


def measured(
    case: ContactCase, touch: SourceTouch, countable, rows: dict[str, Callable[[], Method]], tell: Tell
) -> Iterator[dict[str, Any]]:
    """All rows of one case."""
    performance, target = case.performance, case.target
    judge = prepare_judge(touch, target)
    copied = CopyRotations().prepare(performance.source, target)(performance.motion).motion
    plain = Copied(copied, faultless_frames(touch, judge, copied, countable))
    for name, make in rows.items():
        tell(f"{name}: {performance.name} -> {case.target_name}", 1)
        result, seconds = _timed(make().prepare(performance.source, target), performance.motion)
        yield {
            "method": name, "motion": performance.name, "target": case.target_name, "split": case.split,
            "status": result.status, "frames": len(result.motion), "frames_per_second": len(result.motion) / seconds,
            **judge(touch, result.motion, countable),
            **judge.touching_parts(touch, result.motion, countable),
            "foot_slide_cm": foot_slide(performance.source, performance.motion, target, result.motion),
            "jerk_ratio": jerk_ratio(performance.source, performance.motion, target, result.motion),
            **_changes(target, result.motion, plain),
        }  # fmt: skip


def _timed(retargeter: Retargeter, motion) -> tuple[Any, float]:
    """A result and its seconds on one core, where the system can hold a process to one."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    try:
        if cores:
            os.sched_setaffinity(0, {min(cores)})
        start = time.perf_counter()
        return retargeter(motion), time.perf_counter() - start
    finally:
        if cores:
            os.sched_setaffinity(0, cores)


def _changes(target, result, plain: Copied) -> dict[str, float | None]:
    """What differs from copy-rotations: joints in cm at 1.7 m, legs, faultless frames, and jerk of the end joints."""
    (_, made), (_, copied) = world_pose(result), world_pose(plain.motion)
    joints = target.humanoid.joints
    apart = np.linalg.norm(made - copied, axis=-1)[:, list(joints.values())]
    turned = np.degrees(_angle(result.rotations, plain.motion.rotations))
    own = list(joints.values())
    still = turned[plain.faultless][:, own]
    ends = [joints[name] for name in END_JOINTS]
    third = np.diff(resampled(target, result, made)[:, ends] - resampled(target, plain.motion, copied)[:, ends], n=3, axis=0)
    scale = metrics.REFERENCE_HEIGHT / target.height
    return {
        "displacement_cm": 100 * scale * float(apart.mean()),
        "leg_change_deg": float(turned[:, [joints[name] for name in LEGS]].mean()),
        "no_fault_change_deg": float(still.max(axis=1).mean()) if len(still) else None,
        "jerk_added_mm": 1000 * scale * float(np.linalg.norm(third, axis=-1).max(initial=0.0)),
    }


def resampled(target, motion, positions):
    """Joint positions at 30 frames a second."""
    return positions if abs(motion.fps - FPS) < 1e-3 else world_pose(resample(motion, FPS))[1]


def _angle(a, b):
    dot = np.clip(np.abs((a * b).sum(axis=-1)), 0.0, 1.0)
    return 2 * np.arccos(dot)


def _summary(cases: list[dict], slimmer: list[dict], foreign: list[dict], quick: bool) -> dict[str, float | None]:
    """The worst split of every figure of ours, and the ratios to copy-rotations."""
    summary: dict[str, float | None] = {}
    authored = [case for case in cases if case["motion"] not in CAPTURED]
    for method, prefix in ((OURS, ""), (ONLINE, "online_"), (COPY, "copy_")):
        if not any(case["method"] == method for case in cases):
            continue
        rows = [by_split(cases, method, split, KEYS) for split in SPLITS]
        # Peaks are only meant where the source has none: the quick limbs of a captured dance have them by nature.
        peaks = [by_split(authored, method, split, KEYS)["jerk_added_mm"] for split in SPLITS]
        for row, peak in zip(rows, peaks):
            row["jerk_added_mm"] = peak
        for key, better in KEYS.items():
            known = [row[key] for row in rows if row[key] is not None]
            summary[prefix + key] = None if not known else max(known) if better == "lower" else min(known)
            if method == OURS:
                summary |= {f"{key}_{row['split']}": row[key] for row in rows}
    heavier = [case for case in cases if case["target"] in HEAVIER]
    captured = [case for case in cases if case["motion"] in CAPTURED]
    summary["contact_error_ratio"] = _ratio(heavier, "two_sided_contact_error")
    summary["contact_error_ratio_slimmer"] = _ratio(slimmer, "two_sided_contact_error")
    summary["one_sided_contact_error_ratio"] = _ratio(cases, "contact_error")
    summary["penetration_ratio_heavier"] = _ratio(heavier, "penetration_percent")
    summary["excess_penetration_ratio_heavier"] = _ratio(heavier, "excess_penetration_percent")
    summary["contacts_kept_slimmer"] = by_split(slimmer, OURS, "slimmer", KEYS)["contacts_kept"]
    for key, own, method in (
        ("jerk_ratio_captured", captured, OURS),
        ("jerk_ratio_online_captured", captured, ONLINE),
    ):
        found = [case["jerk_ratio"] for case in own if case["method"] == method and case["jerk_ratio"] is not None]
        summary[key] = float(np.mean(found)) if found else None
    if not quick:
        row = by_split(foreign, OURS, "foreign", KEYS) if foreign else {}
        summary |= {f"{key}_foreign": row.get(key) for key in ("contacts_kept", "parts_kept")}
        found = [case["contacts_keepable"] for case in foreign if case["method"] == OURS and case["contacts_keepable"] is not None]
        summary["contacts_keepable_foreign"] = float(np.mean(found)) if found else None
    return summary


def _of_character(foreign: list[dict], method: str, name: str) -> dict[str, Any]:
    """Means of a method over what one character performs."""
    row = by_split([case for case in foreign if case["target"] == name], method, "foreign", KEYS)
    return row | {"split": name}


def _ratio(cases: list[dict], key: str) -> float | None:
    """Mean of ours over mean of copy-rotations, on the same cases."""
    means = []
    for method in (OURS, COPY):
        found = [case[key] for case in cases if case["method"] == method and case[key] is not None]
        means.append(float(np.mean(found)) if found else None)
    return None if None in means or means[1] == 0 else means[0] / means[1]


def _speed(quick: bool, tell: Tell) -> dict[str, float | None]:
    """Frames a second on one core over a clip with contacts throughout, and seconds to prepare a pair."""
    thin, found = embedded_actor("thin"), {}
    motion = embedded_motion("hands_on_hips")
    for key, vertices in (("6k9", None), *((("20k", 20_000),) if not quick else ())):
        tell(f"speed at {key} vertices")
        heavy, source = embedded_actor("heavy"), thin
        if vertices:
            heavy, source = (cast(refined(actor.character, vertices)) for actor in (heavy, thin))
        prepare_collider.cache_clear()
        start = time.perf_counter()
        prepared = Interaction().prepare(source, heavy)
        found[f"prepare_seconds_{key}"] = time.perf_counter() - start
        best = min(_timed(prepared, motion)[1] for _ in range(3))
        found[f"frames_per_second_{key}"] = len(motion) / best
    return found


def _table(rows: list[dict], summary: dict[str, Any], cases: list[dict]) -> list[str]:
    shown = lambda value: "-" if value is None else f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"  # noqa: E731
    names = [key.replace("_percent", "").replace("contact", "c")[:13].rjust(13) for key in KEYS]
    lines = [f"{'method':20} {'split':9} {'cases':>5} " + " ".join(names)]
    for row in rows:
        figures = " ".join(shown(row[key]).rjust(13) for key in KEYS)
        lines.append(f"{row['method']:20} {row['split']:9} {row['cases']:5} {figures}")
    source = [case["source_penetration_percent"] for case in cases if case["method"] == COPY]
    lines += ["", f"the sources' own penetration: {np.mean(source):.3f} %", "", "fewest contacts kept by ours:"]
    worst = sorted(
        (case for case in cases if case["method"] == OURS and case["contacts_kept"] is not None),
        key=lambda case: case["contacts_kept"],
    )[:6]
    lines += [f"  {case['motion']} -> {case['target']}: {shown(case['contacts_kept'])}" for case in worst]
    keep = [key for key in summary if "_sc_" not in key and "_uc_" not in key]
    return [*lines, "", *(f"{key:36} {shown(summary[key])}" for key in keep)]
