"""The measures as a whole: each has its sentence, its way in and its docstring; what they stand on."""

import importlib
import inspect
import warnings

import numpy as np
import pytest

from retarget.body import rotations as rot
from retarget.errors import RetargetError
from retarget.evaluate import metrics
from retarget.evaluate.formulas import FORMULAS
from retarget.evaluate.metrics.basis import at_reference_height, mean, procrustes, require_alike

MODULES = ("skeletal", "surface", "interaction", "rig")


def public_functions():
    for name in MODULES:
        module = importlib.import_module(f"retarget.evaluate.metrics.{name}")
        for function in vars(module).values():
            if (
                inspect.isfunction(function)
                and function.__module__ == module.__name__
                and not function.__name__.startswith("_")
            ):
                yield function


@pytest.mark.parametrize("function", list(public_functions()), ids=lambda function: function.__name__)
def test_every_metric_has_its_sentence_and_can_be_imported(function):
    assert len(FORMULAS[function.__name__]) > 12
    assert getattr(metrics, function.__name__) is function
    assert function.__name__ in metrics.__all__
    assert len(inspect.getdoc(function)) > 40


def test_every_summary_key_has_its_formula_in_words():
    assert all(len(sentence) > 12 for sentence in FORMULAS.values())


def test_every_public_name_resolves():
    assert all(hasattr(metrics, name) for name in metrics.__all__)
    assert metrics.__all__ == sorted(metrics.__all__)


def test_lengths_are_quoted_at_the_reference_height():
    assert at_reference_height(0.85, 0.85) == pytest.approx(1.7)
    assert at_reference_height(0.1, 1.7) == pytest.approx(0.1)
    for height in (0.0, -1.7, float("nan"), float("inf")):
        with pytest.raises(RetargetError, match="height must be positive"):
            at_reference_height(0.1, height)


def test_arrays_that_would_broadcast_are_refused():
    with pytest.raises(RetargetError, match=r"result has shape \(1, 4, 3\), truth \(5, 4, 3\)"):
        require_alike(truth=np.zeros((5, 4, 3)), result=np.zeros((1, 4, 3)))


def test_a_mean_over_nothing_is_nan_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(mean(np.zeros(0)))


def test_alignment_undoes_a_rigid_movement_of_each_frame_and_nothing_else():
    random = np.random.default_rng(0)
    truth = random.normal(size=(4, 7, 3))
    turns = rot.normalise(random.normal(size=(4, 1, 4)))
    moved = rot.rotate(turns, truth) + random.normal(size=(4, 1, 3))
    np.testing.assert_allclose(procrustes(moved, truth), truth, atol=1e-12)
    centred = truth - truth.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(procrustes(2 * truth, truth), truth + centred, atol=1e-12, err_msg="scale stays")
    mirrored = procrustes(truth * [-1, 1, 1], truth)
    assert np.linalg.norm(mirrored - truth, axis=-1).mean() > 0.1, "a mirror image is not a movement"
    sides = np.linalg.norm(mirrored[:, 1:] - mirrored[:, :1], axis=-1)
    np.testing.assert_allclose(sides, np.linalg.norm(truth[:, 1:] - truth[:, :1], axis=-1), atol=1e-12)


def test_alignment_is_the_best_one():
    random = np.random.default_rng(1)
    truth, result = random.normal(size=(2, 1, 6, 3))
    aligned = procrustes(result, truth)
    least = ((aligned - truth) ** 2).sum()
    for _ in range(50):
        turn = rot.from_rotation_vector(0.05 * random.normal(size=(1, 1, 3)))
        other = rot.rotate(turn, aligned) + 0.05 * random.normal(size=3)
        assert ((other - truth) ** 2).sum() > least
