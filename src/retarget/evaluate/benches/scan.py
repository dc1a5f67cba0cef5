"""The bench of scan retargeting: captures of unseen bodies drive other bodies, ours beside what true joints and a true
correspondence would give, and the networks of Rekik 2023 where they have been trained."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from retarget.evaluate.environment import environment
from retarget.evaluate.scan_cases import CLOTHED, NAKED, SCANNED, scan_case, scan_cases
from retarget.evaluate.scan_frames import FEW_POINTS, HALF_VIEW, WHOLE, fitted_errors, regressor_errors, skinning_errors
from retarget.evaluate.scan_rows import (
    BARE,
    CONTACTS,
    COPY,
    DEFORMATION,
    ONLINE,
    OURS,
    REGRESSED,
    online_cost,
    rows_of,
)
from retarget.evaluate.scan_split import BENCH_BODIES, BENCH_TARGETS
from retarget.evaluate.sheet_row import SheetRow, Show
from retarget.progress import Tell, untold

KINDS = (NAKED, CLOTHED, SCANNED)
FIGURES = ("mpjpe", "pa_mpjpe", "acc", "pa_acc", "mpvd", "pa_mpvd", "mdel")
PAPER = {
    NAKED: (0.178, 0.056, 0.016, 0.008, 0.145, 0.058, 0.001),
    CLOTHED: (0.149, 0.058, 0.019, 0.009, 0.093, 0.060, 0.002),
}
"""What Rekik 2023 reports on its own data (table 4), metres."""
METHODS = (COPY, DEFORMATION, REGRESSED, ONLINE, OURS, CONTACTS, BARE)
FRAMES, QUICK_FRAMES = 10_000, 300
"""Of the online run whose memory and speed are watched."""
SAMPLES, QUICK_SAMPLES = 200, 24
"""Clouds on which the regressor is judged alone."""


def run(quick: bool = False, tell: Tell = untold, show: Show | None = None) -> dict[str, Any]:
    """All captures by all rows, then single clouds, then cost online. `show` gets some moments of every case."""
    cases: list[dict[str, Any]] = []
    for kind in KINDS:
        for number, case in enumerate(scan_cases(kind, quick)):
            tell(case.name, 1)
            few = not quick and number % 4 == 0
            made = list(rows_of(case, bare=few, contexts=few and kind == NAKED))
            cases += [{"kind": kind, "name": case.name} | row for row, _ in made]
            if show is not None:
                _pictures(case, made, show)
    tell("single clouds", 1)
    samples = QUICK_SAMPLES if quick else SAMPLES
    single = {}
    for suffix, kind in (("", WHOLE), ("_half_view", HALF_VIEW), ("_500", FEW_POINTS)):
        single[f"regressor_mpjpe{suffix}"] = regressor_errors(kind, samples)
        single[f"fitted_mpjpe{suffix}"] = fitted_errors(kind, samples)
    skinning = skinning_errors(quick)
    tell("online", 1)
    cost = online_cost(scan_case(NAKED, False, 0, 0), QUICK_FRAMES if quick else FRAMES)
    summary = _summary(cases, single, skinning, cost)
    rows = list(_rows(cases))
    return {
        "bench": "scan",
        "quick": quick,
        "environment": environment() | {"seeds": {"bodies": list(BENCH_BODIES), "targets": list(BENCH_TARGETS)}},
        "summary": summary,
        "rows": rows,
        "cases": cases,
        "skinning": skinning,
        "cost": cost,
        "lines": list(_lines(rows, cases, summary)),
    }


def _pictures(case: Any, made: list, show: Show) -> None:
    frames = np.unique(np.linspace(0, len(case.capture) - 1, 6).round().astype(int))
    captions = tuple(f"frame {frame}" for frame in frames)
    for row, shown in made:
        if row["method"] in (COPY, OURS, CONTACTS):
            show(SheetRow(f"{case.kind}, {case.name}: {row['method']}", case.target.mesh, shown.vertices[frames], captions))


def _values(cases: list[dict], key: str, **wanted: Any) -> list[float]:
    chosen = [case for case in cases if all(case.get(name) == value for name, value in wanted.items())]
    return [float(case[key]) for case in chosen if case.get(key) is not None]


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _summary(cases: list[dict], single: dict[str, list[float]], skinning: dict, cost: dict) -> dict[str, float | None]:
    summary: dict[str, float | None] = {}
    for kind in KINDS:
        for key in FIGURES:
            summary[f"{kind}_{key}"] = _mean(_values(cases, key, kind=kind, method=OURS))
        summary[f"{kind}_mpjpe_worst"] = max(_values(cases, "mpjpe", kind=kind, method=OURS))
        summary[f"{kind}_mpjpe_online"] = _mean(_values(cases, "mpjpe", kind=kind, method=ONLINE))
        summary[f"{kind}_acc_online"] = _mean(_values(cases, "acc", kind=kind, method=ONLINE))
        summary[f"{kind}_mpjpe_contacts"] = _mean(_values(cases, "mpjpe", kind=kind, method=CONTACTS))
    flips = _values(cases, "flips_percent")
    summary["flips_percent"] = _mean(flips)
    summary["refused_percent"] = 100 * float(np.mean([bool(case.get("refused")) for case in cases if case["method"] == OURS]))
    for key, values in single.items():
        summary[key] = _mean(values)
    for key in ("fps", "latency_ms_p50", "latency_ms_p99", "first_frame_ms", "later_over_earlier", "memory_growth_mb"):
        summary[key] = cost[key]
    return summary | {key: value for key, value in skinning.items()}


def _methods(cases: list[dict[str, Any]]) -> list[str]:
    """The rows there are: the usual ones, after each of them those that begin with its name; then the others."""
    there = list(dict.fromkeys(case["method"] for case in cases))
    usual = [each for method in METHODS for each in there if each == method or (each not in METHODS and each.startswith(method + ","))]
    return list(dict.fromkeys(usual + there))


def _rows(cases: list[dict]) -> Iterator[dict[str, Any]]:
    for kind in KINDS:
        for method in _methods(cases):
            own = [case for case in cases if case["kind"] == kind and case["method"] == method]
            if own:
                row = {"method": method, "kind": kind, "cases": len(own)}
                yield row | {key: _mean(_values(own, key)) for key in FIGURES}
        if kind in PAPER:
            yield {"method": "Rekik 2023, its own data", "kind": kind, "cases": None} | dict(zip(FIGURES, PAPER[kind]))


def _lines(rows: list[dict], cases: list[dict], summary: dict[str, float | None]) -> Iterator[str]:
    yield f"{'':32}{'':9}{'cases':>6}" + "".join(f"{head:>10}" for head in FIGURES)
    for row in rows:
        cells = "".join(f"{'-' if row[key] is None else f'{row[key]:.4f}':>10}" for key in FIGURES)
        yield f"{row['method']:32}{row['kind']:9}{'' if row['cases'] is None else row['cases']:>6}{cells}"
    yield ""
    yield from (f"refused: {row['kind']}, {row['name']}: {row['refused']}" for row in cases if row.get("refused"))
    yield from (f"{key:32}{'-' if value is None else f'{value:.4g}'}" for key, value in summary.items())
