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
    **{f"paper-smrm-context-{frames}": ("paper_motion", {"context": frames}) for frames in (5, 10, 15, 60)},
    "paper-skin": ("paper_skinning", {}),
}
"""Modules of `train` by the names of their networks, and what a variant (the ablations of Rekik 2023) does otherwise."""


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
    recipe = module.recipe(data, folder / "cache", **otherwise)
    settings = module.SETTINGS if steps is None else replace(module.SETTINGS, steps=steps)
    state = train(recipe, settings, folder)
    into = weights or folder / "weights"
    told = {"network": name, "steps": str(state.step), "seed": str(settings.seed), "seconds": f"{state.seconds:.0f}"}
    module.export(state.mean, into, told)
    report = {"network": name, "steps": state.step, "processor seconds": round(state.seconds), "weights": str(into)}
    if name == "skeleton-regressor":
        report["test set"] = judge.judge_regressor(into, data, folder / "cache")
    elif name == "skinning-field":
        report["test set"] = judge.judge_field(into, folder / "cache")
    (folder / "report.json").write_text(json.dumps(report, indent=1))
    lines = [f"{name}: {value}" for name, value in report.items() if name != "test set"]
    return report | {"lines": lines + [f"{name} (test set): {value}" for name, value in report.get("test set", {}).items()]}
