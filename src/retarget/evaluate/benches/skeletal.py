"""Skeletal retargeting: are limbs, palms and feet where the source's are, do feet stand, is it smooth, is it fast?"""

from __future__ import annotations

import logging
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from retarget.body.human import PRESETS, human
from retarget.body.kinematics import world_pose
from retarget.casting import cast
from retarget.character import Character, Motion
from retarget.contact.ground import WIDE_RULE
from retarget.contact.support import leg_length, support_limbs, support_points
from retarget.correspond.joints import REQUIRED_JOINTS
from retarget.errors import RetargetError
from retarget.evaluate import metrics
from retarget.evaluate.benches.matching import match_rates
from retarget.evaluate.cases import (
    SEEN_BODIES,
    SEEN_CHARACTERS,
    SEEN_CLIPS,
    arms_turned,
    data_folder,
    in_other_rest_pose,
    limb_directions,
    marker_directions,
    orientation_markers,
    real_files,
    split_of,
    with_other_joint_axes,
)
from retarget.evaluate.environment import environment
from retarget.io import load, save
from retarget.methods import Result
from retarget.motion.align import Actor
from retarget.motion.filter import resample
from retarget.motion.library import PERFORMER, embedded_motion, motion_names
from retarget.motion.standing import standing_contacts
from retarget.progress import Tell, untold
from retarget.retargeting import prepare

log = logging.getLogger("retarget")

FPS = 30.0
LONGEST = 20.0
"""Seconds of a real clip that are measured; a walk does not get truer by the minute."""
FOOT_POINTS = slice(0, 4)
AXES_SEED = 1
UPPER, LOWER = ("head", "leftHand", "rightHand"), ("hips", "leftFoot", "rightFoot")


@dataclass(frozen=True, eq=False)
class Case:
    """One clip on one character."""

    source_name: str
    target_name: str
    split: str
    source: Actor
    target: Actor
    motion: Motion
    """In the source actor's space."""


def run(quick: bool = False, tell: Tell = untold) -> dict[str, Any]:
    """Every case once with and once without foot lock; then the tables."""
    rows = []
    for case in cases(quick):
        tell(f"{case.source_name} -> {case.target_name}")
        rows.append(measure(case))
        tell("", 1)
    tell("joint matching, round trips, timings")
    summary: dict[str, float | None] = match_rates()
    for key in (
        "direction_error_deg",
        "orientation_error_deg",
        "foot_slide_cm",
        "floor_error_cm",
        "jerk_ratio",
        "foot_slide_wide_cm",
        "source_slide_wide_cm",
        "lower_jerk_ratio",
        "upper_jerk_ratio",
    ):
        summary[key] = _mean(row[key] for row in rows)
        summary[f"{key}_worst"] = max((row[key] for row in rows if row[key] is not None), default=None)
    summary["round_trip_mm"] = round_trip_mm(quick)
    summary["two_skeletons_cm"] = two_skeletons_cm()
    summary |= timings(quick)
    return {
        "bench": "skeletal",
        "quick": quick,
        "environment": environment() | {"seeds": {"joint axes": AXES_SEED, "scrambled names": "number of the file"}},
        "summary": summary,
        "rows": rows,
        "lines": _table(rows, summary),
    }


def cases(quick: bool) -> Iterator[Case]:
    yield from _embedded_cases(quick)
    yield from _real_cases(quick)


def _embedded_cases(quick: bool) -> Iterator[Case]:
    source = cast(human(**PRESETS[PERFORMER]))
    bodies = [name for name in PRESETS if name != PERFORMER]
    clips = motion_names()
    if quick:
        bodies, clips = bodies[:3], clips[::3]
    variants = {
        "": lambda body: body,
        " (T rest)": lambda body: in_other_rest_pose(body, arms_turned(-35)),
        " (arms-down rest)": lambda body: in_other_rest_pose(body, arms_turned(40)),
        " (other axes)": lambda body: with_other_joint_axes(body, seed=AXES_SEED),
    }
    for number, name in enumerate(bodies):
        label, change = list(variants.items())[number % len(variants)]
        target = cast(change(human(**PRESETS[name])))
        for clip in clips:
            yield Case(clip, name + label, split_of(name, SEEN_BODIES), source, target, embedded_motion(clip))


def _real_cases(quick: bool) -> Iterator[Case]:
    folder = data_folder()
    if folder is None:
        return
    targets = [(path.stem, _try_cast(path)) for path in real_files(".glb", ".gltf") if "characters" in path.parts]
    targets = [(name, actor) for name, actor in targets if actor is not None and actor.character.skin is not None]
    targets.append(("heavy", cast(human(**PRESETS["heavy"]))))
    sources = [path for path in real_files(".bvh") if "motions" in path.parts]
    for number, path in enumerate(sources[::6] if quick else sources):
        try:
            asset = load(path)
            motion = asset.motion()
            source = cast(asset, motion=motion)
        except RetargetError as error:
            log.warning("left out: %s", error)
            continue
        motion = source.house_from_file.motion(resample(_first(motion, LONGEST), min(FPS, motion.fps)))
        for name, target in [targets[(number + shift) % len(targets)] for shift in ((0,) if quick else (0, 2))]:
            seen = split_of(path.stem, SEEN_CLIPS) == split_of(name, (*SEEN_CHARACTERS, *SEEN_BODIES)) == "seen"
            yield Case(path.stem, name, "seen" if seen else "unseen", source, target, motion)


def _try_cast(path: Path) -> Actor | None:
    try:
        return cast(load(path))
    except RetargetError as error:
        log.warning("left out: %s", error)
        return None


def _first(motion: Motion, seconds: float) -> Motion:
    frames = int(seconds * motion.fps)
    return replace(motion, rotations=motion.rotations[:frames], translations=motion.translations[:frames])


def measure(case: Case) -> dict[str, Any]:
    """All figures of one case."""
    row: dict[str, Any] = {
        "source": case.source_name,
        "target": case.target_name,
        "split": case.split,
        "frames": len(case.motion),
    }
    held = prepare(case.source, case.target).retargeter(case.motion)
    free = prepare(case.source, case.target, foot_lock=False).retargeter(case.motion)
    row["status"] = held.status
    row |= _direction_figures(case, free) | _contact_figures(case, held) | _smoothness(case, held)
    return row


def _direction_figures(case: Case, free: Result) -> dict[str, float | None]:
    source_rotations, source_positions = world_pose(case.motion)
    rotations, positions = world_pose(free.motion)
    limbs = metrics.angle_error_degrees(
        limb_directions(case.source, source_positions), limb_directions(case.target, positions)
    )
    mine, theirs = orientation_markers(case.source), orientation_markers(case.target)
    shared = sorted(set(mine) & set(theirs))
    figures: dict[str, float | None] = {"direction_error_deg": float(limbs.mean()), "orientation_error_deg": None}
    if shared:
        errors = metrics.angle_error_degrees(
            marker_directions(mine, shared, source_rotations), marker_directions(theirs, shared, rotations)
        )
        figures["orientation_error_deg"] = float(errors.mean())
        figures |= {f"{name}_deg": float(error) for name, error in zip(shared, errors.mean(axis=0))}
    return figures


def _contact_figures(case: Case, held: Result) -> dict[str, float | None]:
    limbs = {actor: support_limbs(actor.character, actor.humanoid) for actor in (case.source, case.target)}
    pose = world_pose(case.motion)
    source_points = np.concatenate(support_points(limbs[case.source], *pose), axis=1)
    contacts = standing_contacts(case.source, limbs[case.source], *pose, case.motion.fps)
    points = np.concatenate(support_points(limbs[case.target], *world_pose(held.motion)), axis=1)
    touching = contacts.touching
    scale = held.stats["scale"]
    floor = held.stats["target_floor_m"]
    support = (contacts.support - contacts.floor) * scale + floor
    wide = standing_contacts(case.source, limbs[case.source], *pose, case.motion.fps, WIDE_RULE).touching
    wide_slides = metrics.foot_slide_cm(points[:, FOOT_POINTS], wide[:, FOOT_POINTS], case.target.height)
    slides = metrics.foot_slide_cm(points[:, FOOT_POINTS], touching[:, FOOT_POINTS], case.target.height)
    errors = metrics.floor_error_cm(
        points[:, FOOT_POINTS], touching[:, FOOT_POINTS], support[:, FOOT_POINTS], case.target.height
    )
    source_slides = metrics.foot_slide_cm(source_points[:, FOOT_POINTS], touching[:, FOOT_POINTS], case.source.height)
    mean = lambda values: float(values.mean()) if len(values) else None  # noqa: E731
    return {
        "foot_slide_cm": mean(slides),
        "foot_slide_wide_cm": mean(wide_slides),
        "source_slide_cm": mean(source_slides),
        "source_slide_wide_cm": mean(
            metrics.foot_slide_cm(source_points[:, FOOT_POINTS], wide[:, FOOT_POINTS], case.source.height)
        ),
        "floor_error_cm": mean(errors),
        "contacts": len(slides),
    }


def _smoothness(case: Case, held: Result) -> dict[str, float | None]:
    def ratio(names: tuple[str, ...], length: Callable[[Actor], float]) -> float | None:
        jerks = []
        for actor, motion in ((case.source, case.motion), (case.target, held.motion)):
            _, positions = world_pose(resample(motion, FPS))
            chosen = positions[:, [actor.humanoid.joints[name] for name in names]]
            jerks.append(metrics.jerk(chosen, FPS, length(actor)))
        return jerks[1] / jerks[0] if jerks[0] > 1e-3 else None

    def leg(actor: Actor) -> float:
        return leg_length(actor.skeleton, actor.humanoid)

    return {
        "jerk_ratio": ratio(UPPER + LOWER, leg),
        "lower_jerk_ratio": ratio(LOWER, leg),
        "upper_jerk_ratio": ratio(UPPER, lambda actor: actor.height),
    }


def round_trip_mm(quick: bool) -> float:
    """Largest joint displacement after writing a clip and reading it back, as BVH, as a new GLB and appended to one."""
    body = human(**PRESETS["heavy"])
    written: list[tuple[Character, Motion]] = []
    source, target = cast(human(**PRESETS[PERFORMER])), cast(body)
    production = prepare(source, target)
    for name in motion_names()[:2] if quick else motion_names():
        written.append((body, production.retargeter(embedded_motion(name)).motion))
    for path in real_files(".glb", ".gltf"):
        try:
            asset = load(path)
        except RetargetError as error:
            log.warning("left out: %s", error)
            continue
        if asset.clips and asset.character is not None:
            written.append((asset.character, asset.motion(0)))
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for character, motion in written:
            _, expected = world_pose(motion)
            for suffix in (".bvh", ".glb"):
                path = Path(folder) / f"clip{suffix}"
                save(path, character, [motion])
                again = load(path)
                back = again.motion(len(again.clips) - 1)
                _, positions = world_pose(back)
                order = [back.skeleton.index(name) for name in motion.skeleton.names]
                worst = max(worst, float(np.abs(positions[:, order] - expected).max()) * 1000)
    return worst


def two_skeletons_cm() -> float | None:
    """One performance on two skeletons, both put onto one character."""
    folder = data_folder()
    pair = [folder / "motions" / kind / "01_01.bvh" for kind in ("cmu_daz", "cmu_cgspeed")] if folder else []
    if not pair or not all(path.exists() for path in pair):
        return None
    target, results = cast(human(**PRESETS[PERFORMER])), []
    for path in pair:
        asset = load(path)
        motion = asset.motion()
        source = cast(asset, motion=motion)
        result = prepare(source, target).retargeter(source.house_from_file.motion(resample(motion, FPS)))
        _, positions = world_pose(result.motion)
        hips = target.humanoid.joints["hips"]
        results.append(positions - positions[:1, hips : hips + 1] * [1, 0, 1])
    frames = min(map(len, results))
    chosen = [target.humanoid.joints[name] for name in REQUIRED_JOINTS]
    return metrics.position_error_cm(results[0][:frames, chosen], results[1][:frames, chosen], target.height)


def timings(quick: bool) -> dict[str, float | None]:
    """How long the command line takes, and how fast the prepared retargeter is."""
    runs = 3 if quick else 5
    figures: dict[str, float | None] = {
        "help_seconds": _median_seconds([sys.executable, "-m", "retarget", "--help"], runs),
        "import_seconds": _median_seconds([sys.executable, "-c", "import retarget"], runs),
        "command_seconds": None,
    }
    folder = data_folder()
    clip = folder / "motions" / "cmu_daz" / "01_01.bvh" if folder else None
    knight = folder / "characters" / "kaykit" / "Knight.glb" if folder else None
    if clip is not None and clip.exists() and knight.exists():
        with tempfile.TemporaryDirectory() as out:
            command = [sys.executable, "-m", "retarget", "run", str(clip), str(knight), "-o", f"{out}/result.glb", "--method", "copy-rotations"]
            figures["command_seconds"] = _median_seconds(command, runs - 2)
        asset = load(clip)
        motion = asset.motion()
        source, target = cast(asset, motion=motion), cast(load(knight))
        motion = source.house_from_file.motion(motion)
    else:
        source, target = cast(human(**PRESETS[PERFORMER])), cast(human(**PRESETS["heavy"]))
        motion = embedded_motion(motion_names()[0])
        motion = replace(
            motion,
            rotations=np.tile(motion.rotations, (20, 1, 1)),
            translations=np.tile(motion.translations, (20, 1, 1)),
        )
    retargeter = prepare(source, target).retargeter
    best = min(_seconds(lambda: retargeter(motion)) for _ in range(3))
    return figures | {"solve_frames_per_second": len(motion) / best}


def _seconds(work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _median_seconds(command: list[str], runs: int) -> float:
    return statistics.median(
        _seconds(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(runs)
    )


def _mean(values) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _table(rows: list[dict[str, Any]], summary: dict[str, Any]) -> list[str]:
    keys = (
        "direction_error_deg",
        "orientation_error_deg",
        "foot_slide_cm",
        "source_slide_cm",
        "floor_error_cm",
        "jerk_ratio",
        "upper_jerk_ratio",
    )
    shown = lambda value: "      -" if value is None else f"{value:7.3f}"  # noqa: E731
    lines = [f"{'copy-rotations':44} " + " ".join(key.replace("_error", "")[:12].rjust(12) for key in keys)]
    for row in rows:
        label = f"{row['source'][:22]} -> {row['target'][:18]}"
        lines.append(f"{label:44} " + " ".join(shown(row[key]).rjust(12) for key in keys))
    for split in ("seen", "unseen"):
        means = [_mean(row[key] for row in rows if row["split"] == split) for key in keys]
        lines.append(f"{'mean, ' + split:44} " + " ".join(shown(value).rjust(12) for value in means))
    return [*lines, "", *(f"{key:28} {shown(value)}" for key, value in summary.items())]
