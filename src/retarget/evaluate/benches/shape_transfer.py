"""The bench of shape transfer: poses of self-contact given to bodies of other shape, ours beside copied rotations, deformation
transfer (Sumner and Popović 2004) and the paper's own descent (Basset 2019)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from retarget.evaluate.environment import environment
from retarget.evaluate.shape_cases import (
    APART,
    FOREIGN,
    HELD_OUT,
    PAIRS,
    POSES,
    QUICK_PAIRS,
    QUICK_POSES,
    SEED,
    SEQUENCES,
    body,
    shape_case,
    shape_cases,
)
from retarget.evaluate.shape_rows import (
    COPY,
    DEFORMATION,
    OURS,
    REFERENCE,
    ablations,
    costs,
    curves,
    foreign_row,
    resolution_row,
    rows_of,
    sequence_row,
)
from retarget.evaluate.sheet_row import SheetRow, Show
from retarget.progress import Tell, untold

FIGURES = (
    "contacts_kept", "penetration_percent", "excess_penetration_percent", "depth_p95_mm", "part_volume_error_percent",
    "limb_length_error_percent", "shape_mdel_mm", "new_morphology_contacts", "energy_total",
)  # fmt: skip
HEADS = ("kept", "pen %", "excess", "p95 mm", "vol %", "limb %", "edge mm", "new", "energy")


def run(quick: bool = False, tell: Tell = untold, show: Show | None = None) -> dict[str, Any]:
    """All poses, then cost, clips, other triangles and other resolution. `show` gets every pose by every method."""
    cases: list[dict[str, Any]] = []
    seen: dict[tuple[str, str], list[tuple[str, list]]] = {}
    for split, mesh, case in shape_cases(quick):
        tell(f"{case.names[0]} to {case.names[1]}, {case.pose}, {mesh}", 1)
        about = {"split": split, "mesh": mesh, "pose": case.pose, "source": case.names[0], "target": case.names[1]}
        made = list(rows_of(case))
        cases += [about | row for row, _ in made]
        if mesh == "6k9":
            seen.setdefault(case.names, []).append((case, [(row["method"], surface) for row, surface in made]))
    if show is not None:
        for names, poses in seen.items():
            _pictures(names, poses, show)
    pairs, poses = (QUICK_PAIRS, QUICK_POSES) if quick else (PAIRS, POSES)
    tell("cost", 1)
    cost = [costs(shape_case(pose, pair)) | {"pose": pose, "pair": pair} for pair in pairs[:3] for pose in poses]
    if not quick:
        cost += [costs(shape_case(pose, pair)) | {"pose": pose, "pair": pair} for pair in pairs[:1] for pose in APART]
    tell("clips", 1)
    sequences = [
        sequence_row(motion, source, body(target)) | {"target": target}
        for motion, source, target in SEQUENCES[: 1 if quick else None]
    ]
    tell("other triangles", 1)
    foreign = [
        foreign_row(pose, source, body(target)) for source, target in FOREIGN[: 1 if quick else None] for pose in poses
    ]
    gaps, without, energies = [], [], {}
    if not quick:
        tell("ablations", 1)
        gaps = [resolution_row(pose, PAIRS[0]) for pose in POSES]
        without = [row | {"pose": pose} for pose in POSES for row in ablations(shape_case(pose, PAIRS[0]))]
        energies = curves(shape_case(POSES[0], PAIRS[0]))
    summary = _summary(cases, cost, sequences, foreign, gaps)
    rows = list(_rows(cases, without))
    return {
        "bench": "shape-transfer",
        "quick": quick,
        "environment": environment() | {"seeds": {"remeshed": SEED}, "seen": PAIRS, "unseen": HELD_OUT},
        "summary": summary,
        "rows": rows,
        "cases": cases,
        "cost": cost,
        "sequences": sequences,
        "foreign": foreign,
        "resolution": gaps,
        "ablations": without,
        "energies": energies,
        "lines": list(_lines(rows, summary, cost, sequences)),
    }


def _pictures(names: tuple[str, str], poses: list, show: Show) -> None:
    case = poses[0][0]
    captions = tuple(each.pose for each, _ in poses)
    source = np.stack([each.posed for each, _ in poses])
    show(SheetRow(f"{names[0]}, as performed", case.source.character.mesh, source, captions))
    for number, (method, _) in enumerate(poses[0][1]):
        surfaces = np.stack([made[number][1] for _, made in poses])
        show(SheetRow(f"{names[1]}: {method}", case.target.character.mesh, surfaces, captions))


def _of(cases: list[dict], **wanted: Any) -> list[dict]:
    return [case for case in cases if all(case.get(key) == value for key, value in wanted.items())]


def _values(cases: list[dict], key: str) -> list[float]:
    return [float(case[key]) for case in cases if case.get(key) is not None]


def _mean(cases: list[dict], key: str) -> float | None:
    values = _values(cases, key)
    return float(np.mean(values)) if values else None


def _most(cases: list[dict], key: str) -> float | None:
    return max(_values(cases, key), default=None)


def _summary(
    cases: list[dict], cost: list[dict], sequences: list[dict], foreign: list[dict], gaps: list[dict]
) -> dict[str, float | None]:
    ours = _of(cases, method=OURS)
    ratios, placed = (
        [
            own[key] / max(other[key], 1e-12)
            for own, other in zip(ours, _of(cases, method=REFERENCE))
            if other["status"] != "diverged"
        ]
        for key in ("energy_total", "energy_placed")
    )
    summary: dict[str, float | None] = {
        "warm_ms_6k9": float(np.median(_values(cost, "warm_ms"))),
        "cold_ms_6k9": float(np.median(_values(cost, "cold_ms"))),
        "speed_ratio_cold": float(np.median(_values(cost, "speed_ratio_cold"))),
        "speed_ratio_warm": float(np.median(_values(cost, "speed_ratio_warm"))),
        "energy_ratio": float(np.mean(ratios)) if ratios else None,
        "energy_ratio_worst": max(ratios, default=None),
        "energy_ratio_median": float(np.median(ratios)) if ratios else None,
        "energy_ratio_placed": float(np.mean(placed)) if placed else None,
        "energy_ratio_placed_worst": max(placed, default=None),
        "reference_diverged": float(len(_of(cases, method=REFERENCE, status="diverged"))),
        "contacts_kept": _mean(ours, "contacts_kept"),
        "contacts_kept_worst": min(_values(ours, "contacts_kept"), default=None),
        "contacts_kept_copy": _mean(_of(cases, method=COPY), "contacts_kept"),
        "contacts_kept_reference": _mean(_of(cases, method=REFERENCE), "contacts_kept"),
        "new_morphology_contacts": _mean(ours, "new_morphology_contacts"),
        "excess_penetration_percent": _mean(ours, "excess_penetration_percent"),
        "excess_penetration_percent_worst": _most(ours, "excess_penetration_percent"),
        "excess_penetration_percent_copy": _mean(_of(cases, method=COPY), "excess_penetration_percent"),
        "excess_penetration_percent_reference": _mean(_of(cases, method=REFERENCE), "excess_penetration_percent"),
        "depth_p95_mm": _mean(ours, "depth_p95_mm"),
        "part_volume_error_percent": _mean(ours, "part_volume_error_percent"),
        "part_volume_error_percent_worst": _most(ours, "part_volume_error_percent_worst"),
        "limb_length_error_percent": _mean(ours, "limb_length_error_percent"),
        "limb_length_error_percent_worst": _most(ours, "limb_length_error_percent_worst"),
        "shape_mdel_mm": _mean(ours, "shape_mdel_mm"),
        "jerk_ratio": _mean(sequences, "jerk_ratio"),
        "jerk_ratio_worst": _most(sequences, "jerk_ratio"),
        "foot_slide_cm": _mean(sequences, "foot_slide_cm"),
        "contacts_kept_sequences": _mean(sequences, "contacts_kept"),
        "foreign_contacts_kept": _mean(foreign, "contacts_kept"),
    }
    if gaps:
        summary["resolution_gap_mm"] = _mean(gaps, "gap_mm")
        unseen = _of(ours, split="unseen")
        for key in ("contacts_kept", "excess_penetration_percent", "part_volume_error_percent"):
            summary[f"{key}_unseen"] = _mean(unseen, key)
    return summary


def _rows(cases: list[dict], without: list[dict]) -> Iterator[dict[str, Any]]:
    for split, mesh in (("seen", "6k9"), ("seen", "13k"), ("unseen", "6k9")):
        for method in (COPY, DEFORMATION, REFERENCE, OURS):
            own = _of(cases, method=method, split=split, mesh=mesh)
            if own:
                yield {"method": method, "split": f"{split}, {mesh}", "cases": len(own)} | {
                    key: _mean(own, key) for key in FIGURES
                }
    for method in dict.fromkeys(row["method"] for row in without):
        own = _of(without, method=method)
        yield {"method": method, "split": "thin to heavy", "cases": len(own)} | {
            key: _mean(own, key) for key in FIGURES
        }


def _lines(rows: list[dict], summary: dict, cost: list[dict], sequences: list[dict]) -> Iterator[str]:
    yield f"{'':30}{'':16}{'cases':>6}" + "".join(f"{head:>10}" for head in HEADS)
    for row in rows:
        cells = "".join(f"{'-' if row.get(key) is None else f'{row[key]:.4g}':>10}" for key in FIGURES)
        yield f"{row['method']:30}{row['split']:16}{row['cases']:>6}{cells}"
    yield ""
    for kind in ("none", "collisions", "contacts", "both"):
        own = _of(cost, kind=kind)
        if own:
            yield (
                f"{kind:12}{len(own):>3} cases: cold {_mean(own, 'cold_ms'):.0f} ms, warm {_mean(own, 'warm_ms'):.0f} ms, "
                f"100 iterations of Basset 2019 {_mean(own, 'reference_100_cpu_ms'):.0f} ms of one core"
            )
    yield ""
    for row in sequences:
        yield (
            f"{row['motion']} onto {row['target']}, {row['frames']} frames: contacts kept {_text(row['contacts_kept'])}, "
            f"jerk x {row['jerk_ratio']:.2f}, slide {row['foot_slide_cm']:.2f} cm (source {row['source_foot_slide_cm']:.2f})"
        )
    yield ""
    yield from (f"{key:40}{_text(value)}" for key, value in summary.items())


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
