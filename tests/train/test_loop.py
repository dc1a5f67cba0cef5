"""The loop learns the same whether it was cut off or not, and says what it did."""

import csv
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from retarget.train.loop import Recipe, Settings, train  # noqa: E402

SETTINGS = Settings(steps=12, batch=8, rate=1e-2, warm=3, every=4, checks=6, smooth=0.9)


class Line(Recipe):
    """A straight line with a little noise, through a network with dropout."""

    name = "line"

    def network(self):
        return torch.nn.Sequential(torch.nn.Linear(2, 8), torch.nn.Dropout(0.2), torch.nn.Linear(8, 1))

    def batch(self, number, count):
        draw = np.random.default_rng(number)
        seen = draw.normal(size=(count, 2)).astype(np.float32)
        return seen, seen.sum(axis=1, keepdims=True) + draw.normal(size=(count, 1)).astype(np.float32) * 0.1

    def losses(self, network, batch):
        away = network(torch.from_numpy(batch[0])) - torch.from_numpy(batch[1]).float()
        return {"square": away.square().mean(), "largest_seen": away.abs().max()}

    def check(self, network):
        return {"checked": 1.0}


def weights(state):
    return np.concatenate([each.detach().numpy().ravel() for each in (*state.network.parameters(), *state.mean.parameters())])


def test_a_training_that_was_cut_off_ends_as_one_that_was_not(tmp_path):
    whole = train(Line(), SETTINGS, tmp_path / "whole")
    train(Line(), SETTINGS, tmp_path / "cut", stop=5)
    cut = train(Line(), SETTINGS, tmp_path / "cut")
    assert cut.step == whole.step == 12
    assert np.array_equal(weights(cut), weights(whole))
    other = train(Line(), replace(SETTINGS, seed=1), tmp_path / "other")
    assert not np.allclose(weights(other), weights(whole))


def test_the_log_has_means_of_losses_and_what_was_checked(tmp_path):
    train(Line(), SETTINGS, tmp_path)
    rows = list(csv.reader((tmp_path / "log.csv").open()))
    seen = {(int(step), name): float(value) for step, _, name, value in rows}
    assert {step for step, name in seen if name == "square"} == {4, 8, 12}
    assert {step for step, name in seen if name == "checked"} == {12}
    train(Line(), replace(SETTINGS, every=5), tmp_path / "uneven")
    uneven = {(int(row[0]), row[2]): float(row[3]) for row in csv.reader((tmp_path / "uneven" / "log.csv").open())}
    assert sum(uneven[step, "square"] * count for step, count in ((5, 5), (10, 5), (12, 2))) == pytest.approx(
        4 * sum(seen[step, "square"] for step in (4, 8, 12)), rel=1e-4
    )
    assert seen[12, "square"] < seen[4, "square"]


def test_the_last_steps_barely_move(tmp_path):
    """The rate falls to a hundredth along a cosine."""
    before = train(Line(), replace(SETTINGS, steps=40), tmp_path, stop=39)
    kept = weights(before)
    after = train(Line(), replace(SETTINGS, steps=40), tmp_path)
    network = len(kept) // 2
    assert np.abs(weights(after)[:network] - kept[:network]).max() < 0.02 * SETTINGS.rate


class TwoRates(Line):
    """The last layer learns faster, without decay."""

    def groups(self, network):
        first, _, last = network
        return [{"params": list(first.parameters())}, {"params": list(last.parameters()), "faster": 10.0, "weight_decay": 0.0}]


def test_groups_learn_at_their_own_rates(tmp_path):
    torch.manual_seed(SETTINGS.seed)
    before = Line().network()
    moved = []
    for recipe in (Line(), TwoRates()):
        after = train(recipe, replace(SETTINGS, steps=1, decay=0.0), tmp_path / type(recipe).__name__).network
        moved.append([float((after[place].weight - before[place].weight).detach().abs().mean()) for place in (0, 2)])
    assert moved[0][0] == pytest.approx(moved[1][0], rel=1e-3)
    assert moved[1][1] == pytest.approx(10.0 * moved[0][1], rel=1e-3)
