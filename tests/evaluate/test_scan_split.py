"""What networks never see stays what it is, and apart from what they learn from."""

import numpy as np
import pytest

from retarget.body.human import human_vertices
from retarget.errors import RetargetError
from retarget.evaluate import scan_split as split
from retarget.motion.library import motion_names


@pytest.mark.parametrize("table", [split.BODY_SEEDS, split.EMBEDDED, split.CMU_SUBJECTS, split.OTHER_FOLDERS])
def test_the_sets_share_nothing(table):
    everything = [each for kept in table.values() for each in kept]
    assert len(everything) == len(set(everything))


def test_every_embedded_motion_is_in_a_set():
    assert sorted(name for names in split.EMBEDDED.values() for name in names) == sorted(motion_names())


def test_what_the_bench_shows_was_never_learnt_from():
    assert set(split.BENCH_BODIES + split.BENCH_TARGETS) <= set(split.BODY_SEEDS[split.TEST])
    assert {split.set_of_clip("embedded", name) for name in split.BENCH_NAKED + split.BENCH_CLOTHED} == {split.TEST}
    assert {split.set_of_clip("cmu_daz", name) for name in split.BENCH_CAPTURED} == {split.TEST}


def test_a_clip_of_no_set_is_refused():
    with pytest.raises(RetargetError, match="'99_01' of 'cmu_daz' is in none of the sets"):
        split.set_of_clip("cmu_daz", "99_01")


def test_shapes_of_seeds_stay_what_they_are():
    shape = split.drawn_shape(9000)
    assert shape == split.drawn_shape(9000)
    fixed = [shape[name] for name in ("gender", "age", "weight", "height")]
    assert np.allclose(fixed, FIXED, atol=1e-9)
    assert np.isfinite(human_vertices(**shape)).all()


def test_bodies_reach_from_toddlers_to_the_very_heavy():
    shapes = [split.drawn_shape(seed) for seed in split.BODY_SEEDS[split.TRAINING]]
    heights, weights = (np.array([shape[name] for shape in shapes]) for name in ("height", "weight"))
    assert heights.min() < 0.85 and heights.max() > 2.0 and weights.min() < 0.05 and weights.max() > 1.9


FIXED = [0.845773911, 0.459348702, 0.058885569, 1.803443454]
