"""The interaction bench with networks: ours alone, as the solver's start, and those of the papers where their weights are at hand."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from retarget.body.kinematics import world_pose
from retarget.contact.field_losses import field_losses
from retarget.contact.interaction_field import prepare_field
from retarget.contact.sensors import place_sensors, prepare_sensor_skinning
from retarget.errors import FileError
from retarget.evaluate.benches.contact import by_split
from retarget.evaluate.benches.interaction import COPY, HEAVIER, KEYS, OURS, measured, open_set
from retarget.evaluate.contact_cases import CAPTURED, SPLITS, ContactCase
from retarget.evaluate.environment import environment
from retarget.evaluate.keepable import keepable_tracks
from retarget.evaluate.start_gain import problem, rounds
from retarget.methods.base import Method
from retarget.methods.copy_rotations import CopyRotations
from retarget.methods.interaction.learned import LearnedInteraction
from retarget.methods.interaction.looker import prepare_looker
from retarget.methods.interaction.method import Interaction
from retarget.methods.interaction.network import load_network
from retarget.motion.touch.solve import STAYED
from retarget.progress import Tell, untold

WEIGHTS = "RETARGET_REFERENCE_WEIGHTS"
"""The environment variable that names the folder of the papers' networks."""
NET, STARTED = "ours, network alone", "ours, network + solver"
REFERENCES = {"paper-smrm": "NKN-type (recurrent)", "paper-r2et": "R2ET-type (residual)", "paper-meshret": "Ye 2024's network"}
STARTED_TARGETS = ("heavy", "very_heavy")
"""Who the solver's rounds are followed on, in authored clips: a case takes twenty seconds."""
EQUAL = 0.001
"""Share of what the solver wins over the copied pose within which two energies are equal."""


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    make: Callable[[], Method]
    seconds: float | None = None
    """Processor time that its network was trained for, where that is known."""


def run(quick: bool = False, tell: Tell = untold) -> dict[str, Any]:
    """Every row on every case of the open set, starts, and the field's agreement."""
    rows, cases, starts, fields = _rows(), [], [], []
    if quick:
        rows = {name: rows[name] for name in (COPY, NET)}
    for performance, touch, case in open_set(quick, tell):
        countable = keepable_tracks(touch, performance.name, case.target_name)
        cases += measured(case, touch, countable, {name: row.make for name, row in rows.items()}, tell)
        if not quick:
            if case.target_name in STARTED_TARGETS and performance.name not in CAPTURED:
                starts += [{"motion": performance.name, "target": case.target_name, **each} for each in _starts(case)]
            fields += [{"motion": performance.name, "target": case.target_name, "split": case.split, **_agreement(case)}]
    table = [by_split(cases, method, split, KEYS) | {"trained_seconds": rows[method].seconds} for method in rows for split in SPLITS]
    summary = _summary(cases) | ({} if quick else _start_figures(starts, cases) | _field_figures(fields))
    return {
        "bench": "interaction --learned", "quick": quick, "environment": environment() | {"seeds": {}},
        "summary": summary, "rows": table, "cases": cases, "starts": starts, "fields": fields,
        "lines": _lines(table, summary),
    }  # fmt: skip


def _rows() -> dict[str, Row]:
    rows = {COPY: Row(CopyRotations)}
    folder = os.environ.get(WEIGHTS)
    if folder:
        from retarget.evaluate.reference.interaction_methods import ReferenceNetwork, trained_seconds

        if not Path(folder).is_dir():
            raise FileError(Path(folder), f"{WEIGHTS} names no folder")
        for path in sorted(Path(folder).glob("paper-*.pt")):
            kind = "-".join(path.stem.split("-")[:2])
            if kind in REFERENCES and (kind != "paper-smrm" or path.stem == kind):
                variant = path.stem[len(kind) + 1 :].replace("-", " ")
                name = REFERENCES[kind] + (f", {variant}" if variant else "")
                rows[name] = Row(lambda path=path: ReferenceNetwork(path), trained_seconds(path))
    return rows | {
        NET: Row(LearnedInteraction), OURS: Row(Interaction), STARTED: Row(lambda: Interaction(learned_start=True)),
    }  # fmt: skip


def _starts(case: ContactCase) -> list[dict[str, Any]]:
    """The solver's rounds from both starts on a case."""
    source = case.performance.source
    asked = problem(source, case.target, case.performance.motion)
    return list(rounds(asked, prepare_looker(source, case.target), load_network())) if asked.need.any() else []


def _agreement(case: ContactCase) -> dict[str, float]:
    """Mean cosine of the field's entries on the source and on results."""
    source, target = case.performance.source, case.target
    sensors = [place_sensors(actor.character, actor.humanoid) for actor in (source, target)]
    plan, skinners = prepare_field(*sensors), [prepare_sensor_skinning(each) for each in sensors]
    here, found = skinners[0].pose(*world_pose(case.performance.motion)), {}
    for name, method in (("copy", CopyRotations()), ("net", LearnedInteraction())):
        made = method.prepare(source, target)(case.performance.motion).motion
        losses = field_losses(plan, here, skinners[1].pose(*world_pose(made)))
        found[name] = -losses["cosine"] / max(losses["pairs"], 1.0)
    return found


def _summary(cases: list[dict]) -> dict[str, float | None]:
    """The network alone: its worst split, against copied rotations there."""
    summary: dict[str, float | None] = {}
    for split in SPLITS:
        net, copy = (by_split(cases, method, split, KEYS) for method in (NET, COPY))
        heavier = [case for case in cases if case["target"] in HEAVIER and case["split"] == split]
        for key, name in (("two_sided_contact_error", "contact_error"), ("penetration_percent", "penetration")):
            means = [
                [case[key] for case in heavier if case["method"] == method and case[key] is not None] for method in (NET, COPY)
            ]
            both = [float(np.mean(each)) if each else None for each in means]
            summary[f"net_{name}_ratio_{split}"] = both[0] / both[1] if None not in both and both[1] > 0 else None
        summary[f"net_contacts_kept_{split}"], summary[f"copy_contacts_kept_{split}"] = net["contacts_kept"], copy["contacts_kept"]
        if None not in (net["contacts_kept"], copy["contacts_kept"]):
            summary[f"net_contacts_gain_{split}"] = net["contacts_kept"] - copy["contacts_kept"]
        summary[f"net_jerk_ratio_{split}"], summary[f"net_foot_slide_cm_{split}"] = net["jerk_ratio"], net["foot_slide_cm"]
        summary[f"net_frames_per_second_{split}"] = net["frames_per_second"]
    for key, worst in (
        ("net_contact_error_ratio", max), ("net_penetration_ratio", max), ("net_contacts_kept", min), ("copy_contacts_kept", min),
        ("net_contacts_gain", min), ("net_jerk_ratio", max), ("net_foot_slide_cm", max), ("net_frames_per_second", min),
    ):  # fmt: skip
        known = [summary[name] for split in SPLITS if summary.get(name := f"{key}_{split}") is not None]
        summary[key] = worst(known) if known else None
    return summary


def _start_figures(starts: list[dict], cases: list[dict]) -> dict[str, float | None]:
    """How many set-ups of equations a start saves until energies are equal, in all, where both look again at frames that have hardly
    moved, or do not, whichever comes cheaper; and what it adds to the contacts kept."""
    usual, default, learned = 0.0, 0.0, 0.0
    for motion, target in dict.fromkeys((each["motion"], each["target"]) for each in starts):
        own = [each for each in starts if (each["motion"], each["target"]) == (motion, target)]
        goal = [each for each in own if each["start"] == "keys" and each["stayed"] == STAYED][-1]
        enough = goal["energy"] + EQUAL * abs(goal["energy"])
        fewest = {}
        for start in ("keys", "network"):
            found = [each for each in own if each["start"] == start]
            reached = [each["set_ups"] for each in found if each["energy"] <= enough]
            fewest[start] = min(reached, default=max(goal["set_ups"], *(each["set_ups"] for each in found)))
        usual, default, learned = usual + fewest["keys"], default + goal["set_ups"], learned + fewest["network"]
    gains = []
    for split in SPLITS:
        means = [by_split(cases, method, split, KEYS)["contacts_kept"] for method in (STARTED, OURS)]
        gains += [means[0] - means[1]] if None not in means else []
    return {
        "start_iterations_saved": 1.0 - learned / usual if usual else None,
        "start_iterations_saved_of_default": 1.0 - learned / default if default else None,
        "start_contacts_gain": min(gains, default=None),
    }


def _field_figures(fields: list[dict]) -> dict[str, float | None]:
    unseen = [each for each in fields if each["split"] == "uc_um"]
    return {
        "dmi_cosine_unseen": float(np.mean([each["net"] for each in unseen])) if unseen else None,
        "dmi_cosine_unseen_copy": float(np.mean([each["copy"] for each in unseen])) if unseen else None,
    }


def _lines(table: list[dict], summary: dict[str, Any]) -> list[str]:
    shown = lambda value: "-" if value is None else f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"  # noqa: E731
    keys = ("contacts_kept", "two_sided_contact_error", "penetration_percent", "foot_slide_cm", "jerk_ratio", "frames_per_second")
    lines = [f"{'method':34} {'split':6} " + " ".join(key[:14].rjust(14) for key in keys) + "   trained (hours)"]
    for row in table:
        hours = "" if row["trained_seconds"] is None else f"{row['trained_seconds'] / 3600:14.2f}"
        lines.append(f"{row['method']:34} {row['split']:6} " + " ".join(shown(row[key]).rjust(14) for key in keys) + hours)
    return [*lines, "", *(f"{key:36} {shown(value)}" for key, value in summary.items())]
