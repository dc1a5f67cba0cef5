"""Four copies of a cloud: each is laid out for the search, and what is found in mirror images is mirrored."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from retarget.body import rotations as rot
from retarget.body.human import PRESETS, human
from retarget.body.kinematics import world_pose
from retarget.body.skinning import prepare_skinning
from retarget.character import Motion
from retarget.methods.scan.copies import SIGNS, fourfold, joined
from retarget.methods.scan.features import JOINTS, Bodies, Clouds, thinned, vectors_to
from retarget.methods.scan.regressor import load_regressor
from retarget.motion.library import embedded_motion
from retarget.train.poses import other_side


@pytest.fixture(scope="module")
def posed():
    body, motion = human(**PRESETS["woman"]), embedded_motion("wave")
    moved = Motion(body.skeleton, motion.rotations[60:61], motion.translations[60:61], motion.fps)
    turns, places = world_pose(moved)
    return prepare_skinning(body).vertices(turns, places)[0].astype(np.float64), places[0, :JOINTS], turns[0, :JOINTS]


def test_copies_are_searched_exactly(posed):
    copies = fourfold(thinned(posed[0]))
    queries = np.random.default_rng(0).uniform(-1, 1, size=(len(SIGNS), 300, 3)).astype(np.float32)
    vectors = vectors_to(copies, queries)
    for places, asked, found in zip(copies.places, queries, vectors):
        away, _ = cKDTree(places).query(asked)
        assert np.allclose(np.linalg.norm(found, axis=1), away, atol=1e-5)


def test_what_is_true_in_every_copy_is_true_when_joined(posed):
    _, places, turns = posed
    matrices = rot.to_matrix(turns)
    sides = other_side()[:JOINTS]
    copied_places, copied_turns = [], []
    for signs in SIGNS.astype(float):
        mirror = signs.prod() < 0
        inner = np.array([-1.0, 1.0, 1.0]) if mirror else np.ones(3)
        order = sides if mirror else np.arange(JOINTS)
        copied_places.append((places * signs)[order])
        copied_turns.append((signs[:, None] * matrices * inner)[order])
    bodies = Bodies(np.array(copied_places, dtype=np.float32), np.array(copied_turns, dtype=np.float32))
    found, doubts = joined(bodies, np.full((4, JOINTS), 0.01))
    assert np.allclose(found.places[0], places, atol=1e-5) and np.allclose(found.turns[0], matrices, atol=1e-5)
    assert np.ptp(doubts) < 1e-6
    wrong = bodies.places.copy()
    wrong[2, 9] += 0.5
    suspected = np.full((4, JOINTS), 0.01)
    suspected[2, 9] = 0.1
    found, doubts = joined(Bodies(wrong, bodies.turns), suspected)
    assert np.abs(found.places[0] - places).max() < 1e-4, "a copy that doubts counts for little"
    found, doubts = joined(Bodies(wrong, bodies.turns), np.full((4, JOINTS), 0.01))
    assert doubts[0].argmax() == 9 and doubts[0, 9] > 0.1, "copies that differ are a reason to doubt"


def test_a_mirrored_cloud_has_mirrored_joints(posed):
    copies, sides = fourfold(thinned(posed[0])), other_side()[:JOINTS]
    (found, doubts), (mirrored, others) = (
        load_regressor().find(Clouds(*(getattr(copies, name)[row : row + 1] for name in NAMES))) for row in (0, 1)
    )
    inner = np.array([-1.0, 1.0, 1.0])
    assert np.abs(mirrored.places[0][sides] * inner - found.places[0]).max() < 1e-4
    assert np.abs(mirrored.turns[0][sides] * inner[:, None] * inner - found.turns[0]).max() < 1e-3
    assert np.abs(others[0][sides] - doubts[0]).max() < 1e-4


NAMES = ("places", "firsts", "boxes", "blocks", "middles")
