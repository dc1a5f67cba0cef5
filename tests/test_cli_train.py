"""`retarget train`: each recipe from nothing to a file that is used, on few bodies and steps; and what it refuses."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from retarget.commands_train import RECIPES
from retarget.evaluate import scan_split


@pytest.fixture
def few(monkeypatch, tmp_path_factory):
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    import importlib

    from retarget.train import judge

    for which, first in ((scan_split.TRAINING, 0), (scan_split.VALIDATION, 8000), (scan_split.TEST, 9000)):
        monkeypatch.setitem(scan_split.BODY_SEEDS, which, (first, first + 1))
    monkeypatch.setattr(judge, "CLOUDS", 6)
    few_takes(monkeypatch, tmp_path_factory.getbasetemp() / "takes")
    for name, _ in RECIPES.values():
        module = importlib.import_module(f"retarget.train.{name}")
        monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, batch=4, checks=1000))


def few_takes(monkeypatch, kept):
    """One take of one clip for one body, made once for all recipes."""
    from retarget.train import interaction, interaction_takes, judge, paper_interaction, paper_residual

    for name in ("CLIPS", "TARGETS"):
        monkeypatch.setattr(interaction_takes, name, 1)
    own = interaction_takes.keep_takes
    for module in (interaction, judge, paper_interaction, paper_residual):
        monkeypatch.setattr(module, "keep_takes", lambda which, count, data, cache, workers: own(which, 1, data, kept, 1))


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_learns_and_writes(name, few, command, tmp_path):
    code, out, err = command("train", name, "-o", tmp_path, "--steps", 3, "--json")
    assert code == 0, err
    report = json.loads(out)
    assert report["steps"] == 3
    for log in tmp_path.glob("stage_*/log.csv") if name == "interaction" else [tmp_path / "log.csv"]:
        assert {line.split(",")[0] for line in log.read_text().splitlines()} == {"3"}
    assert list((tmp_path / "weights").iterdir())
    assert not name.startswith("paper") or (tmp_path / "weights" / f"{name}.pt").is_file()
    if not name.startswith("paper"):
        which = "validation set" if name == "interaction" else "test set"
        assert all(np.isfinite(value) for value in report[which].values())
        assert json.loads((tmp_path / "report.json").read_text())[which] == report[which]
    code, out, err = command("train", name, "-o", tmp_path, "--steps", 3)  # nothing is left to learn
    assert code == 0 and "steps: 3" in out.splitlines(), err


def test_what_was_exported_is_what_was_learnt(few, tmp_path):
    """ONNX in half precision against the network itself."""
    import torch

    from retarget.methods.scan.features import closer_look, first_look
    from retarget.methods.scan.regressor import load_regressor
    from retarget.train import skeleton_regressor as recipe

    torch.manual_seed(0)
    network = recipe.SkeletonRegressor().eval()
    recipe.export(network, tmp_path, {"steps": "0"})
    regressor = load_regressor(tmp_path)
    clouds, truth = recipe.recipe(None, tmp_path).maker.batch(0, 4)
    seen = [first_look(clouds), closer_look(clouds, truth, True), closer_look(clouds, truth, False)]
    for features, look, session in zip(seen, network.looks, regressor.looks):
        (out,) = session.run(None, {"features": features})
        true = look(torch.from_numpy(features)).detach().numpy()
        assert np.abs(out - true).max() < 0.02 * true.std()
    found, doubts = regressor.find_once(clouds)
    with torch.no_grad():
        places, turns, expected = network(clouds)[-1]
    assert np.abs(found.places - places.numpy()).max() < 0.03
    assert np.abs(found.turns - turns.numpy()).max() < 0.03
    assert np.abs(doubts - expected.numpy()).max() < 0.01


def test_without_torch_one_line_names_the_extra(command, monkeypatch, tmp_path):
    for name in [name for name in sys.modules if name.startswith("retarget.train")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    code, out, err = command("train", "skinning-field", "-o", tmp_path)
    assert code == 2 and not out
    assert err == "retarget: training needs torch, which is not installed: pip install 'retarget[train]'\n"


def test_unknown_networks_and_missing_data_are_refused(command, tmp_path):
    code, _, err = command("train", "skining-field", "-o", tmp_path)
    assert code == 2 and "nearest: 'skinning-field'" in err
    code, _, err = command("train", "skinning-field", "-o", tmp_path, "--data", tmp_path / "nowhere")
    assert code == 2 and "nowhere is no folder" in err
