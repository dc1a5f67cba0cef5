"""What `retarget train` does: learns one of the package's networks again, and writes it."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from retarget.errors import RetargetError, unknown_name

RECIPES: dict[str, tuple[str, dict[str, Any]]] = {
    "skeleton-regressor": ("skeleton_regressor", {}),
    "skinning-field": ("skinning_field", {}),
    "paper-skr": ("paper_regressor", {}),
    "paper-skr-bones": ("paper_regressor", {"bone_weight": 1.0}),
    "paper-smrm": ("paper_motion", {}),
    "paper-smrm-no-cycle": ("paper_motion", {"rotation_weight": 0.0}),
    **{f"paper-smrm-context-{frames}": ("paper_motion", {"context": frames}) for frames in (5, 10, 15, 30, 60)},
    "paper-skin": ("paper_skinning", {}),
    "interaction": ("interaction", {}),
    "paper-r2et": ("paper_residual", {}),
    "paper-meshret": ("paper_interaction", {}),
    **{f"paper-meshret-nearest-{count}": ("paper_interaction", {"nearest": count}) for count in (8, 6, 2, 0)},
    "paper-meshret-half-around": ("paper_interaction", {"around": 2}),
    "paper-meshret-half-along": ("paper_interaction", {"along": 2}),
    "paper-meshret-distances": ("paper_interaction", {"distances": True}),
}
"""Modules of `train` by the names of their networks, and what a variant (the ablations of Rekik 2023 and Ye 2024) does otherwise."""


def train_network(name: str, folder: Path, data: Path | None, steps: int | None, weights: Path | None) -> dict[str, Any]:
    """Learn, going on from what is in `folder`; write the weights to the folder `weights` (else `folder/weights`).

    Raises `RetargetError` for an unknown name, data that are not there, and where torch is not installed.
    """
    if name not in RECIPES:
        raise unknown_name("network", name, RECIPES, "what can be trained")
    if data is not None and not data.is_dir():
        raise RetargetError(f"--data {data} is no folder")
    try:
        from retarget.train import judge
        from retarget.train.loop import train

        file, otherwise = RECIPES[name]
        module = importlib.import_module(f"retarget.train.{file}")
    except ModuleNotFoundError as error:
        raise RetargetError(f"training needs {error.name}, which is not installed: pip install 'retarget[train]'") from None
    settings = module.SETTINGS if steps is None else replace(module.SETTINGS, steps=steps)
    into = weights or folder / "weights"
    if hasattr(module, "STAGES"):  # networks that are learnt one after the other, each from what those before it do
        learnt: list[Any] = []
        for stage, usual in enumerate(module.STAGES):
            own = replace(settings, steps=usual if steps is None else steps)
            recipe = module.recipe(data, folder / "cache", [state.mean.eval() for state in learnt], **otherwise)
            learnt.append(train(recipe, own, folder / f"stage_{stage + 1}"))
        networks, seconds = [state.mean for state in learnt], sum(state.seconds for state in learnt)
    else:
        learnt = [train(module.recipe(data, folder / "cache", **otherwise), settings, folder)]
        networks, seconds = learnt[0].mean, learnt[0].seconds
    told = {"network": name, "steps": str(learnt[-1].step), "seed": str(settings.seed), "seconds": f"{seconds:.0f}"}
    module.export(networks, into, told)
    report = {"network": name, "steps": learnt[-1].step, "processor seconds": round(seconds), "weights": str(into)}
    if name == "skeleton-regressor":
        report["test set"] = judge.judge_regressor(into, data, folder / "cache")
    elif name == "skinning-field":
        report["test set"] = judge.judge_field(into, folder / "cache")
    elif name == "interaction":
        report["validation set"] = judge.judge_interaction(into, data, folder / "cache")
    (folder / "report.json").write_text(json.dumps(report, indent=1))
    lines = [f"{name}: {value}" for name, value in report.items() if not isinstance(value, dict)]
    sets = [(name, figures) for name, figures in report.items() if isinstance(figures, dict)]
    return report | {"lines": lines + [f"{name} ({which}): {value}" for which, figures in sets for name, value in figures.items()]}
