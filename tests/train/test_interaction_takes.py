"""Takes: the same for the same number, of the training half alone, with clean performances."""

from pathlib import Path

import numpy as np
import pytest

from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.evaluate.contact_cases import CAPTURED, SEEN_MOTIONS, UNSEEN_MOTIONS
from retarget.evaluate.scan_split import TRAINING
from retarget.evaluate.touch import judged_body
from retarget.methods.interaction.unknowns import SIZE
from retarget.train import interaction_takes as takes_of
from retarget.train import performances


@pytest.fixture(scope="module")
def takes():
    return made()


def made():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(takes_of, "CLIPS", 2)
        patch.setattr(takes_of, "TARGETS", 1)
        return takes_of.make_takes(TRAINING, 5, None)


def test_a_take_is_a_function_of_its_number(takes):
    for one, other in zip(takes, made(), strict=True):
        assert np.array_equal(one.turned, other.turned) and np.array_equal(one.matters, other.matters)
        assert one.target == other.target


def test_what_is_kept_fits_together(takes):
    for take in takes:
        frames = len(take.performed)
        assert len(take.copied) == len(take.turned) == len(take.matters) == frames > 0
        assert take.turned.shape[1] == SIZE and take.matters.shape[1] == SIZE * (SIZE + 1) // 2
        assert np.isfinite(take.turned).all() and np.isfinite(take.matters).all()


def test_the_measure_of_misses_has_no_way_that_wins(takes):
    """Matrices are positive semidefinite, as half precision has them."""
    rows, columns = np.tril_indices(SIZE)
    for take in takes:
        whole = np.zeros((SIZE, SIZE))
        whole[rows, columns] = whole[columns, rows] = take.matters[0].astype(float)
        assert np.linalg.eigvalsh(whole).min() > -1e-3 * np.abs(whole).max()


def test_performers_are_hardly_inside_themselves(takes):
    """As drawn, arms of these clips are .035 and .04 of the height deep in half of the frames."""
    for take in takes:
        performer = takes_of.body_of(take.source, None)
        posed = prepare_skinning(performer.character).vertices(*world_pose(take.performed))
        depth = judged_body(performer).collider.depths(posed)
        assert np.median(depth.max(axis=1)) < 0.02 * performer.height


def test_nothing_unseen_is_learnt_from():
    data = Path("/nonexistent")
    names = {clip.name.split("/")[-1] for clip in performances.clips_of(TRAINING, None)}
    assert names == set(SEEN_MOTIONS) and not names & set(UNSEEN_MOTIONS)
    assert performances.clips_of(TRAINING, data) and {name for name, half in CAPTURED.items() if half == "u"}
