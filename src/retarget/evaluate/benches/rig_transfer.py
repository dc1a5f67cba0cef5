"""The bench of rig transfer: a bare mesh gets a rig, whose true one is known or whose look is judged by a stated rule.

Ours fully automatic, ours given the true map, the ways of Musoni 2021 and MMMC21 given the same map, pyFM's automatic
pipeline; then real bodies, seconds and memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from retarget.errors import RetargetError
from retarget.evaluate.environment import environment
from retarget.evaluate.reference import pyfm_pipeline
from retarget.evaluate.rig_cases import QUICK, SEEN, SORTS, UNSEEN, RigCase, rig_case
from retarget.evaluate.rig_judge import judge_rig, truth_of
from retarget.evaluate.rig_pictures import RigPicture, picture_of
from retarget.evaluate.rig_real import ALIKE, RealBody, judge_real, real_bodies, unlike
from retarget.evaluate.rig_rows import OURS_MAPPED, PYFM, found_by_pyfm, given_the_true_map
from retarget.evaluate.rig_speed import rigging_cost
from retarget.progress import Tell, untold
from retarget.rig.rigging import Rigged, rig
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

OURS = "ours"
SIZES = {"10k": 10_000, "100k": 100_000}
FIGURES = (
    "weight_mse_x100", "weight_mse_x100_52", "joint_error_cm", "finger_error_cm", "rest_vertex_error_cm",
    "registration_mm", "registration_surface_mm", "animated_mpvd_cm", "torn_percent", "map_error_percent",
    "flipped_percent",
)  # fmt: skip
KEYS = {
    "function": "weight_mse_x100_function", "p2p": "weight_mse_x100_p2p", "p2p, adjoint": "weight_mse_x100_p2p_adjoint",
    "eq. 10": "weight_mse_x100_eq10", "low-pass": "weight_mse_x100_low_pass",
}  # fmt: skip
"""Rows of the paper's ways that the summary names."""
Show = Callable[[RigPicture], None]


def run(quick: bool = False, tell: Tell = untold, show: Show | None = None) -> dict[str, Any]:
    """All cases, then real bodies, then cost. `show` gets a picture of every rig."""
    cases: list[dict[str, Any]] = []
    for seed in QUICK if quick else SEEN + UNSEEN:
        tell(f"case {seed}", 1)
        cases += _case(rig_case(seed), tell, show)
    real = _real(quick, tell, show)
    cost = {}
    for name, vertices in list(SIZES.items())[: 1 if quick else None]:
        tell(f"cost of {name} vertices", 1)
        cost[name] = rigging_cost(vertices)
    summary = _summary(cases, real, cost)
    rows = list(_rows(cases))
    return {
        "bench": "rig-transfer",
        "quick": quick,
        "environment": environment() | {"seeds": {"seen": list(SEEN), "unseen": list(UNSEEN)}},
        "summary": summary,
        "rows": rows,
        "cases": cases,
        "real": real,
        "cost": cost,
        "lines": list(_lines(rows, summary, cases, real)),
    }


def _case(case: RigCase, tell: Tell, show: Show | None) -> Iterator[dict[str, Any]]:
    """Every row of a case: ours, then what is given the true map, then pyFM."""
    about = {"seed": case.seed, "name": case.name, "sort": case.sort, "half": "seen" if case.seed in SEEN else "unseen"}
    truth = truth_of(case)
    found = _rigged(lambda: rig(case.mesh))
    figures = {"success": False} if isinstance(found, str) else judge_rig(case, truth, found)
    row = about | {"method": OURS, "refused": found if isinstance(found, str) else None, **figures}
    yield row
    if show is not None:
        show(picture_of(case.name, case.mesh, None if isinstance(found, str) else found, _verdict(row)))
    tell(f"case {case.seed}, given its map", 0)
    yield from (about | each for each in given_the_true_map(case, truth))
    if pyfm_pipeline.installed():
        yield about | found_by_pyfm(case)


def _rigged(make: Callable[[], Rigged]) -> Rigged | str:
    """The rig, or why there is none."""
    try:
        return make()
    except RetargetError as error:
        return str(error)


def _verdict(row: dict[str, Any]) -> str:
    if row["refused"]:
        return "REFUSED"
    error = row.get("map_error_percent", row.get("joint_error_percent", row.get("mesh_to_template_percent")))
    return f"{'ok' if row['success'] else 'WRONG'} {error:.2f} %, confidence {row['confidence']:.2f}"


def _real(quick: bool, tell: Tell, show: Show | None) -> list[dict[str, Any]]:
    """Real bodies, those of one mesh in several poses compared at the end."""
    template, rows, families = human_template(), [], {}
    for body in real_bodies(quick):
        tell(body.name, 1)
        found = _rigged(lambda body=body: rig(body.mesh))
        row = {"name": body.name, "truth": body.joints is not None, "refused": None, "success": False}
        if isinstance(found, str):
            row["refused"] = found
        else:
            row |= judge_real(body, found)
            if body.joints is None:
                family = families.setdefault((len(body.mesh.vertices), body.mesh.faces.tobytes()), [])
                family.append((row, found.places.of(template.model.points)))
        rows.append(row)
        if show is not None:
            show(_real_picture(body, found, row))
    for family in (each for each in families.values() if len(each) >= 3):
        for (row, _), away in zip(family, unlike([places for _, places in family])):
            row["unlike_percent"] = away
            row["success"] = bool(row["success"] and away <= ALIKE)
    return rows


def _real_picture(body: RealBody, found: Rigged | str, row: dict[str, Any]) -> RigPicture:
    return picture_of(body.name, body.mesh, None if isinstance(found, str) else found, _verdict(row))


def _summary(cases: list[dict], real: list[dict], cost: dict[str, dict]) -> dict[str, float | None]:
    ours = [case for case in cases if case["method"] == OURS]
    given = [case for case in cases if case["method"] == OURS_MAPPED]
    delivered = [case for case in ours if not case["refused"]]
    summary: dict[str, float | None] = {"weight_mse_x100": _mean(given, "weight_mse_x100")}
    summary |= {
        key: _mean([c for c in cases if c["method"] == method], "weight_mse_x100") for method, key in KEYS.items()
    }
    errors = [case["weight_mse_x100"] for case in delivered]
    summary["weight_mse_x100_auto"] = _mean(ours, "weight_mse_x100")
    summary["weight_mse_x100_auto_median"] = float(np.median(errors)) if errors else None
    for sort, suffix in zip(SORTS, ("", "_noisy", "_multi")):
        own = [case for case in ours if case["half"] == "unseen" and case["sort"] == sort]
        summary[f"success_rate{suffix}"] = _share(own, lambda case: case["success"])
    summary |= {
        "success_rate_seen": _share([c for c in ours if c["half"] == "seen"], lambda case: case["success"]),
        "refused_rate": _share(ours, lambda case: bool(case["refused"])),
        "silent_failure_rate": _share(ours, lambda case: not case["refused"] and not case["success"]),
        "success_rate_pyfm": _share([c for c in cases if c["method"] == PYFM], lambda case: case["success"]),
        "real_success_rate": _share(real, lambda row: row["success"]),
        "real_success_rate_limbs": _share(real, lambda row: row.get("success_limbs", row["success"])),
        "real_refused_rate": _share(real, lambda row: bool(row["refused"])),
        "joint_error_cm": _mean(ours, "joint_error_cm"),
        "joint_error_cm_worst_joint": max(_by_joint(ours).values(), default=None),
        "rest_vertex_error_cm": _mean(ours, "rest_vertex_error_cm"),
        "rest_vertex_error_cm_true_map": _mean(given, "rest_vertex_error_cm"),
        "registration_mm": _mean(ours, "registration_mm"),
        "registration_mm_true_map": _mean(given, "registration_mm"),
        "registration_surface_mm": _mean(ours, "registration_surface_mm"),
        "animated_mpvd_cm": _mean(ours, "animated_mpvd_cm"),
        "torn_percent": _mean(ours, "torn_percent"),
        "torn_percent_real": _mean(real, "torn_percent"),
        "wrong_unit_rate": _share(delivered, lambda case: not 0.5 < case["unit_factor"] < 2.0),
    }
    for name in SIZES:
        summary[f"seconds_{name}"] = cost[name]["seconds"] if name in cost else None
    known = [each["peak_mb"] for each in cost.values() if each["peak_mb"] is not None]
    summary["peak_mb"] = max(known, default=None)
    summary["template_seconds"] = max((each["template_seconds"] for each in cost.values()), default=None)
    return summary


def _mean(rows: list[dict], key: str) -> float | None:
    found = [row[key] for row in rows if key in row]
    return float(np.mean(found)) if found else None


def _share(rows: list[dict], holds: Callable[[dict], bool]) -> float | None:
    return float(np.mean([holds(row) for row in rows])) if rows else None


def _by_joint(ours: list[dict]) -> dict[str, float]:
    found = [case["joint_errors_cm"] for case in ours if "joint_errors_cm" in case]
    return {name: float(np.mean([each[name] for each in found])) for name in MAIN} if found else {}


def _rows(cases: list[dict]) -> Iterator[dict[str, Any]]:
    """Means of each method over all cases; of ours and pyFM by half and sort too."""
    for method in dict.fromkeys(case["method"] for case in cases):
        own = [case for case in cases if case["method"] == method]
        yield _row(method, "all", own)
        if method in (OURS, PYFM):
            for half in ("seen", "unseen"):
                for sort in SORTS:
                    some = [case for case in own if (case["half"], case["sort"]) == (half, sort)]
                    if some:
                        yield _row(method, f"{half} {sort}", some)


def _row(method: str, split: str, cases: list[dict]) -> dict[str, Any]:
    row: dict[str, Any] = {"method": method, "split": split, "cases": len(cases)}
    row |= {key: value for key in FIGURES if (value := _mean(cases, key)) is not None}
    if any("success" in case for case in cases):
        row["success_rate"] = _share(cases, lambda case: case["success"])
    return row


def _lines(rows: list[dict], summary: dict, cases: list[dict], real: list[dict]) -> Iterator[str]:
    heads = (
        "MSE",
        "MSE 52",
        "joint cm",
        "finger",
        "rest cm",
        "reg mm",
        "skin mm",
        "anim cm",
        "torn %",
        "map %",
        "flip %",
        "success",
    )
    yield f"{'':44}{'':16}{'cases':>6}" + "".join(f"{head:>9}" for head in heads)
    for row in rows:
        values = (row.get(key) for key in (*FIGURES, "success_rate"))
        cells = "".join(f"{'-' if value is None else f'{value:.3f}':>9}" for value in values)
        yield f"{row['method']:44}{row['split']:16}{row['cases']:>6}{cells}"
    if not any(row["method"] == PYFM for row in rows):
        yield f"{PYFM:44}not installed (pip install 'retarget[bench]')"
    joints = _by_joint([case for case in cases if case["method"] == OURS])
    yield ""
    yield "joints, cm: " + ", ".join(
        f"{name} {value:.2f}" for name, value in sorted(joints.items(), key=lambda e: -e[1])[:8]
    )
    yield ""
    for case in cases:
        if case["method"] == OURS and not case["success"]:
            yield f"failed: {case['name']}: {case['refused'] or _verdict(case)}"
    yield ""
    for row in real:
        yield f"{row['name']:34}{_real_line(row)}"
    yield ""
    yield from (f"{key:34}{'-' if value is None else f'{value:.4g}'}" for key, value in summary.items())


def _real_line(row: dict[str, Any]) -> str:
    if row["refused"]:
        return f"refused: {row['refused']}"
    known = ("joint_error_percent", "limb_error_percent", "worst_joint", "template_to_mesh_percent",
             "mesh_to_template_percent", "torn_percent", "knees_forward", "unlike_percent")  # fmt: skip
    told = ", ".join(
        f"{key.removesuffix('_percent')} {row[key] if isinstance(row[key], str) else f'{row[key]:.2f}'}"
        for key in known if key in row
    )  # fmt: skip
    return f"{'ok   ' if row['success'] else 'WRONG'} {told}, confidence {row['confidence']:.2f}"
