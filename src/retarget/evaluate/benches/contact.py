"""The contact bench: every method over the open benchmark set, judged by contacts kept and penetration; the collision test
itself by speed and truth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from retarget.body.kinematics import world_pose
from retarget.contact.support import leg_length, support_limbs, support_points
from retarget.evaluate import metrics
from retarget.evaluate.benches import collision
from retarget.evaluate.contact_cases import SPLITS, ContactCase, cases_of, foreign_actors, performances
from retarget.evaluate.environment import environment
from retarget.evaluate.keepable import keepable_tracks
from retarget.evaluate.touch import SourceTouch, observe, prepare_judge
from retarget.methods import METHODS
from retarget.motion.align import Actor
from retarget.motion.filter import resample
from retarget.motion.standing import standing_contacts
from retarget.motion.steady import END_JOINTS
from retarget.progress import Tell, untold
from retarget.retargeting import prepare

SEED = 1
FPS = 30.0
FOOT_POINTS = slice(0, 4)

FOREIGN_SPLIT = "foreign"
"""Characters of other makers, judged through sensors; in no split of the summary."""
SKELETAL = tuple(name for name in METHODS if name not in ("shape-transfer", "deformation-transfer"))
"""Methods whose result is all in its joints; surfaces are judged by the bench of shape transfer."""
FOREIGN_MOTIONS = ("hands_on_hips", "arms_crossed", "hand_to_shoulder", "hands_behind_head")
SENSOR_CHECKED = ("heavy", "elderly", "toddler")
"""Bodies on which contacts are carried both ways, by the true correspondence and by sensors; quick runs take the last."""

KEYS: dict[str, str] = {
    "contact_error": "lower", "contacts_kept": "higher", "penetration_percent": "lower",
    "excess_penetration_percent": "lower", "new_penetration_percent": "lower", "depth_mean_mm": "lower",
    "depth_p95_mm": "lower", "foot_slide_cm": "lower", "jerk_ratio": "lower", "frames_per_second": "higher",
}  # fmt: skip
"""What every method is measured by, and which way is better."""
BASE = "copy-rotations"
"""The zero line: its figures stand in the summary without a prefix."""


def run(quick: bool = False, tell: Tell = untold) -> dict[str, Any]:
    """Every method on every case; then the table by method and split, and the collision test."""
    cases, unkeepable = [], []
    foreign = [] if quick else list(foreign_actors())
    by_sensors: list[tuple[float, float]] = []
    for performance in performances(quick):
        tell(f"contacts of {performance.name}")
        touch = observe(performance.source, performance.motion)
        for case in cases_of(performance, quick):
            countable = keepable_tracks(touch, performance.name, case.target_name)
            if not countable.all():
                unkeepable.append(_lost(case, touch, countable))
            judge = prepare_judge(touch, case.target)
            for method in SKELETAL:
                tell(f"{method}: {performance.name} -> {case.target_name}", 1)
                cases.append(measure(case, touch, judge, countable, method))
            if case.target_name in (SENSOR_CHECKED[-1:] if quick else SENSOR_CHECKED):
                by_sensors += _kept_both_ways(case, touch, judge)
        for name, target in foreign if performance.name in FOREIGN_MOTIONS else ():
            case = ContactCase(performance, name, target, FOREIGN_SPLIT)
            judge = prepare_judge(touch, target)
            for method in SKELETAL:
                tell(f"{method}: {performance.name} -> {name}", 1)
                cases.append(measure(case, touch, judge, None, method))
    splits = (*SPLITS, FOREIGN_SPLIT) if foreign else SPLITS
    rows = [by_split(cases, method, split) for method in SKELETAL for split in splits]
    summary: dict[str, Any] = collision.figures(quick, SEED, tell)
    for method in SKELETAL:
        prefix = "" if method == BASE else f"{method.replace('-', '_')}_"
        for key, better in KEYS.items():
            own = [row[key] for row in rows if row["method"] == method and row["split"] in SPLITS]
            summary[f"{prefix}{key}"] = _worst(own, better)
            for row in rows:
                if row["method"] == method:
                    summary[f"{prefix}{key}_{row['split']}"] = row[key]
    summary |= _sensor_error(by_sensors)
    return {
        "bench": "contact",
        "quick": quick,
        "environment": environment() | {"seeds": {"random poses": SEED}},
        "summary": summary,
        "rows": rows,
        "cases": cases,
        "unkeepable": unkeepable,
        "lines": _table(rows, cases, unkeepable, summary),
    }


def measure(case: ContactCase, touch: SourceTouch, judge, countable, method: str) -> dict[str, Any]:
    """All figures of one case."""
    performance = case.performance
    retargeter = prepare(performance.source, case.target, method).retargeter
    start = time.perf_counter()
    result = retargeter(performance.motion)
    seconds = time.perf_counter() - start
    return {
        "method": method,
        "motion": performance.name,
        "target": case.target_name,
        "split": case.split,
        "status": result.status,
        "frames": len(result.motion),
        "frames_per_second": len(result.motion) / seconds,
        **judge(touch, result.motion, countable),
        "foot_slide_cm": foot_slide(performance.source, performance.motion, case.target, result.motion),
        "jerk_ratio": jerk_ratio(performance.source, performance.motion, case.target, result.motion),
    }


def foot_slide(source: Actor, motion, target: Actor, result) -> float | None:
    """Slide of heels and balls over the source's contacts, cm at 1.7 m."""
    limbs = [support_limbs(actor.character, actor.humanoid) for actor in (source, target)]
    touching = standing_contacts(source, limbs[0], *world_pose(motion), motion.fps).touching[:, FOOT_POINTS]
    points = np.concatenate(support_points(limbs[1], *world_pose(result)), axis=1)[:, FOOT_POINTS]
    slides = metrics.foot_slide_cm(points, touching, target.height)
    return float(slides.mean()) if len(slides) else None


def jerk_ratio(source: Actor, motion, target: Actor, result) -> float | None:
    """Jerk of hips, head, hands and feet over leg length, result over source."""
    jerks = []
    for actor, moving in ((source, motion), (target, result)):
        _, positions = world_pose(resample(moving, FPS))
        ends = positions[:, [actor.humanoid.joints[name] for name in END_JOINTS]]
        jerks.append(metrics.jerk(ends, FPS, leg_length(actor.skeleton, actor.humanoid)))
    return jerks[1] / jerks[0] if jerks[0] > 1e-3 else None


def _kept_both_ways(case: ContactCase, touch: SourceTouch, judge) -> list[tuple[float, float]]:
    """Share of contacts kept by the zero line, by the true correspondence and by sensors."""
    motion = prepare(case.performance.source, case.target, BASE).retargeter(case.performance.motion).motion
    truth = judge(touch, motion)["contacts_kept"]
    carried = prepare_judge(touch, case.target, by_sensors=True)(touch, motion)["contacts_kept"]
    return [] if truth is None or carried is None else [(truth, carried)]


def _sensor_error(kept: list[tuple[float, float]]) -> dict[str, float | None]:
    """What carrying by sensors changes in the share of contacts kept: mean, and mean of the absolute differences."""
    if not kept:
        return {"sensors_kept_bias": None, "sensors_kept_error": None}
    apart = np.array([carried - truth for truth, carried in kept])
    return {"sensors_kept_bias": float(apart.mean()), "sensors_kept_error": float(np.abs(apart).mean())}


def by_split(
    cases: list[dict[str, Any]], method: str, split: str, keys: Mapping[str, str] = KEYS
) -> dict[str, Any]:
    """Means of a method over a split. Contacts count alike wherever they are: a clip that hardly touches weighs little."""
    own = [case for case in cases if case["method"] == method and case["split"] == split]
    row: dict[str, Any] = {"method": method, "split": split, "cases": len(own)}
    for key in (*keys, "source_penetration_percent"):
        known = [case for case in own if case[key] is not None]
        weights = [case["contacts_counted"] if key == "contacts_kept" else 1 for case in known]
        row[key] = float(np.average([case[key] for case in known], weights=weights)) if sum(weights) else None
    return row


def _worst(values: list[float | None], better: str) -> float | None:
    known = [value for value in values if value is not None]
    return None if not known else max(known) if better == "lower" else min(known)


def _lost(case: ContactCase, touch: SourceTouch, countable) -> dict[str, Any]:
    """A line on contacts that no pose of the target can keep."""
    names, tracks = touch.parts.names, touch.contacts.tracks
    gone = np.flatnonzero(~countable)
    pairs = sorted({f"{names[tracks.own_part[n]]}-{names[tracks.part[n]]}" for n in gone})
    return {
        "motion": case.performance.name, "target": case.target_name,
        "contacts": len(gone), "of": len(countable), "parts": pairs,
    }  # fmt: skip


def _table(rows: list[dict], cases: list[dict], unkeepable: list[dict], summary: dict[str, Any]) -> list[str]:
    shown = lambda value: "-" if value is None else f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"  # noqa: E731
    header = f"{'method':20} {'split':6} {'cases':>5} " + " ".join(
        key.replace("_percent", "")[:13].rjust(13) for key in KEYS
    )
    lines = [header]
    for row in rows:
        figures = " ".join(shown(row[key]).rjust(13) for key in KEYS)
        lines.append(f"{row['method']:20} {row['split']:6} {row['cases']:5} {figures}")
    worst = sorted(
        (case for case in cases if case["contacts_kept"] is not None), key=lambda case: case["contacts_kept"]
    )[:5]
    lines += ["", "fewest contacts kept:"]
    lines += [
        f"  {case['method']}: {case['motion']} -> {case['target']}: {shown(case['contacts_kept'])}" for case in worst
    ]
    if unkeepable:
        lines += ["", "contacts that no pose keeps (not counted):"]
        lines += [
            f"  {each['motion']} -> {each['target']}: {each['contacts']} of {each['of']} ({', '.join(each['parts'])})"
            for each in unkeepable
        ]
    return [
        *lines,
        "",
        *(f"{key:36} {shown(value)}" for key, value in summary.items() if "_sc_" not in key and "_uc_" not in key),
    ]
