"""Frames of the interaction network's recipe."""

import numpy as np
import pytest

pytest.importorskip("torch")

from retarget.train import interaction  # noqa: E402
from retarget.train.interaction import Frames, end_to_end  # noqa: E402


def part(frames, first, looks=2):
    """Frames whose numbers say whose they are: `first` and on; looks of the second round say so by a thousand."""
    own = np.arange(first, first + frames)
    seen = np.concatenate([own + 1000 * look for look in range(looks)])
    return Frames(np.tile(seen[:, None], (1, 3)), seen[:, None] + 0.5, own[:, None], own[:, None] + 0.25)


def test_files_end_to_end_are_as_one_file():
    made, whole = end_to_end([part(2, 0), part(5, 2), part(1, 7)]), part(8, 0)
    for name in ("features", "turned", "wanted", "matters"):
        assert np.array_equal(getattr(made, name), getattr(whole, name)), name


def test_files_without_a_usable_clip_are_left_out(monkeypatch, tmp_path):
    monkeypatch.setattr(interaction, "keep_takes", lambda which, count, data, cache, workers: ["empty", "full", "fuller"])
    monkeypatch.setattr(interaction, "load_takes", lambda paths, data: [] if paths == ["empty"] else paths)
    monkeypatch.setattr(interaction, "first_frames", lambda clips: {"full": part(2, 0, 1), "fuller": part(3, 2, 1)}[clips[0]])
    made = interaction.recipe(None, tmp_path)
    assert np.array_equal(made.learnt.wanted, part(5, 0, 1).wanted) and len(made.judged.wanted) == 5
