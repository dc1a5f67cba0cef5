"""Figures of exported networks on the test set, through the code that uses them: what model cards say."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from retarget.body import rotations as rot
from retarget.evaluate.scan_split import BODY_SEEDS, TEST, VALIDATION
from retarget.methods.interaction.network import load_network
from retarget.methods.scan.regressor import load_regressor
from retarget.methods.scan.skinning_field import load_field
from retarget.train.data import SAMPLES, SORTS, bake_bodies, prepare_clouds
from retarget.train.interaction import VALIDATION_TAKES, load_takes, whole_matters
from retarget.train.interaction_takes import keep_takes
from retarget.train.poses import still_poses
from retarget.train.skinning_field import STANCES, resting

CLOUDS = 1024
"""Of every sort."""


def judge_regressor(weights: Path, data: Path | None, cache: Path) -> dict[str, float]:
    """On unseen bodies in frames of unseen motions, for every sort of `data.SORTS`: mean distance of joints (mm), the same without
    the mean offset, its 95th percentile over clouds, mean error of turns (degrees), clouds whose hips are turned the wrong
    way round (percent), and the correlation of expected with true errors. Last, clean clouds of poses that are made up."""
    regressor, maker = load_regressor(weights), prepare_clouds(TEST, data, cache, seed=2)
    figures: dict[str, float] = {}
    for name, sort, made_up in [(sort, sort, False) for sort in SORTS] + [("made_up", "clean", True)]:
        clouds, truth = replace(maker, made_up=made_up).batch(0, CLOUDS, sort)
        found, doubts = regressor.find(clouds)
        off = found.places - truth.places
        away = np.linalg.norm(off, axis=-1)
        still = np.linalg.norm(off - off.mean(axis=1, keepdims=True), axis=-1)
        cosine = 0.5 * (np.einsum("cjab,cjab->cj", found.turns, truth.turns) - 1.0)
        angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        figures |= {
            f"{name}_mm": 1000.0 * away.mean(), f"{name}_shape_mm": 1000.0 * still.mean(),
            f"{name}_mm_95": 1000.0 * np.quantile(away.mean(axis=1), 0.95), f"{name}_deg": angles.mean(),
            f"{name}_flips_percent": 100.0 * (angles[:, 0] > 90.0).mean(),
            f"{name}_doubts": np.corrcoef(doubts.ravel(), away.ravel())[0, 1],
        }  # fmt: skip
    return {name: round(float(value), 3) for name, value in figures.items()}


def judge_field(weights: Path, cache: Path) -> dict[str, float]:
    """On unseen bodies in each stance: mean squared error of weights, given true joints and given the regressor's."""
    field, regressor = load_field(weights), load_regressor()
    bodies = bake_bodies(BODY_SEEDS[TEST], cache)
    figures: dict[str, list[float]] = {}
    for stance, lifts in STANCES.items():
        for body in range(len(bodies.joints)):
            draw = np.random.default_rng([body, 23])
            samples = draw.choice(SAMPLES, size=4000, replace=False)
            points, weights_, joints, matrices = resting(bodies, body, still_poses(1, draw, lifts)[0], samples, 0.0)
            found = field(points, joints, rot.from_matrix(matrices), points)
            figures.setdefault(f"{stance} mse", []).append(((found - weights_) ** 2).mean())
            seen = regressor(points)
            guessed = field(points, seen.places, seen.turns, points)
            figures.setdefault(f"{stance} mse, joints of the regressor", []).append(((guessed - weights_) ** 2).mean())
    return {name: round(float(np.mean(values)), 6) for name, values in figures.items()}


def judge_interaction(weights: Path, data: Path | None, cache: Path) -> dict[str, float]:
    """On takes of validation: how much of the copied poses' miss is left after all looks, by the solver's measure; of the measure and
    of its root, which few bad frames do not decide. What results are worth is the bench's to say."""
    network = load_network(weights)
    left, before = [], []
    for take in load_takes(keep_takes(VALIDATION, VALIDATION_TAKES, data, cache, os.cpu_count() or 1), data):
        matters = whole_matters(take.matters)
        for found, miss in ((left, network.said(take.looker, take.source, take.copied) - take.wanted), (before, take.wanted)):
            found.append(np.einsum("fn,fnm,fm->f", miss, matters, miss))
    kept, copied = (np.maximum(np.concatenate(each), 0.0) for each in (left, before))
    return {
        "energy left": round(float(kept.sum() / copied.sum()), 4),
        "root left": round(float(np.sqrt(kept).sum() / np.sqrt(copied).sum()), 4),
    }
