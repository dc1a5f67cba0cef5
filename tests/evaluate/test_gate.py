"""The gate lets equal and better figures pass, and no worse ones."""

import json

import pytest

from retarget.errors import FileError
from retarget.evaluate.benches import BENCHES
from retarget.evaluate.gate import BASELINE, Bound, bounds_of, regressions

BOUNDS = {"slide": Bound(0.2, "lower", 0.05), "kept": Bound(0.8, "higher", 0.02)}


def test_equal_better_and_slightly_worse_pass():
    for slide, kept in ((0.2, 0.8), (0.0, 1.0), (0.249, 0.781)):
        assert regressions({"slide": slide, "kept": kept}, BOUNDS) == []


def test_what_is_worse_is_named_with_what_would_be_right():
    lines = regressions({"slide": 0.26, "kept": 0.7}, BOUNDS)
    assert lines[0] == "slide is 0.26; right is at most 0.25 (baseline 0.2)"
    assert lines[1] == "kept is 0.7; right is at least 0.78 (baseline 0.8)"


@pytest.mark.parametrize("summary", [{}, {"slide": None, "kept": 0.9}])
def test_what_was_not_measured_does_not_pass(summary):
    assert any("was not measured" in line for line in regressions(summary, BOUNDS))


def test_a_broken_baseline_is_one_line(tmp_path):
    path = tmp_path / "baseline.json"
    for text in ("{", '{"contact": {"quick": {"slide": {"value": 1}}}}', '{"contact": []}'):
        path.write_text(text)
        with pytest.raises(FileError, match="is no baseline"):
            bounds_of("contact", True, path)


def test_the_committed_baseline_bounds_known_benches_from_the_right_side():
    stored = json.loads(BASELINE.read_text())
    assert set(stored) <= set(BENCHES)
    for bench, runs in stored.items():
        for run in runs:
            bounds = bounds_of(bench, run == "quick")
            assert bounds and all(
                bound.better in ("lower", "higher") and bound.tolerance >= 0 for bound in bounds.values()
            )
