"""The contact energy: which contacts a source has, what they weigh, and the derivative by hand."""

from functools import cache

import numpy as np
import pytest
from made_motions import actor

from retarget.body.skinning import rest_vertices, skin_motion
from retarget.contact.collide import part_collider, prepare_collider
from retarget.contact.parts import body_parts
from retarget.evaluate.reference.contact_terms import (
    FOLD,
    GROUND,
    attraction,
    repulsion,
    source_contacts,
)
from retarget.evaluate.reference.part_tree import part_tree
from retarget.motion.library import embedded_motion

BODY = actor("thin").character
FACES = BODY.mesh.faces
REST = rest_vertices(BODY)
PARTS = body_parts(BODY, actor("thin").humanoid)
THRESHOLD = 0.02


@cache
def collider():
    return prepare_collider(BODY, actor("thin").humanoid)


@cache
def on_hips():
    return skin_motion(BODY, embedded_motion("hands_on_hips"))[70].astype(float)


@cache
def contacts():
    return source_contacts(collider(), FACES, REST, on_hips(), THRESHOLD, 0.0)


def test_the_collider_of_a_bare_surface_is_the_character_s():
    height = float(np.ptp(REST[:, 1]))
    mine, theirs = part_collider(REST, FACES, PARTS, height), collider()
    np.testing.assert_array_equal(mine.excluded, theirs.excluded)
    squeezed = on_hips() * [0.7, 1.0, 1.0]
    np.testing.assert_array_equal(mine.depths(squeezed[None]), theirs.depths(squeezed[None]))
    assert mine.depths(squeezed[None]).max() > 0
    tight = part_collider(REST, FACES, PARTS, height, neighbourhood=0.0)
    assert tight.excluded.sum() < mine.excluded.sum()


def test_hands_on_hips_touch_the_hips_and_soles_the_ground():
    found = contacts()
    own, other = PARTS.vertex_parts[found.first], found.part
    touching = {frozenset((PARTS.names[a], PARTS.names[b])) for a, b in zip(own, other)}
    assert {frozenset(("leftHand", "pelvis")), frozenset(("rightHand", "pelvis"))} <= touching
    assert (own != other).all()
    away = np.linalg.norm(REST[found.first] - REST[found.second], axis=1)
    assert away.min() >= FOLD * THRESHOLD
    assert {PARTS.names[part] for part in PARTS.vertex_parts[found.ground]} == {"leftFoot", "rightFoot"}
    assert np.abs(on_hips()[found.ground, 1]).max() <= THRESHOLD
    assert len(found.held) == 0


def test_folds_of_skin_are_no_contacts():
    every = part_collider(REST, FACES, PARTS, float(np.ptp(REST[:, 1])), neighbourhood=0.0)
    found = source_contacts(every, FACES, REST, on_hips(), THRESHOLD, 0.0)
    assert len(every.pairs(on_hips(), THRESHOLD).vertex) > len(found.first) + 100 > len(contacts().first)
    assert np.linalg.norm(REST[found.first] - REST[found.second], axis=1).min() >= FOLD * THRESHOLD


def test_couples_are_vertices_and_the_nearest_of_the_other_part():
    found, posed = contacts(), on_hips()
    for row in range(0, len(found.first), 97):
        others = np.unique(PARTS.welded[FACES[PARTS.face_parts == found.part[row]]])
        gaps = np.linalg.norm(posed[others] - posed[found.first[row]], axis=1)
        assert gaps.min() == pytest.approx(np.linalg.norm(posed[found.first[row]] - posed[found.second[row]]))


def test_a_source_keeps_its_own_contacts_at_seams_too():
    """A hand at the seam of abdomen and pelvis is near a face of each; the nearest corner of that face counts, whoever owns it."""
    found, posed = contacts(), on_hips()
    assert (PARTS.vertex_parts[found.second] != found.part).any()
    assert np.linalg.norm(posed[found.first] - posed[found.second], axis=1).max() < 1.5 * THRESHOLD
    assert attraction(found, posed)[0] < 1e-3


def test_a_body_apart_from_itself_and_on_the_ground_has_no_energy():
    standing = source_contacts(collider(), FACES, REST, REST, THRESHOLD, 0.0)
    assert len(standing.first) == 0 and len(standing.ground) > 50
    assert repulsion(collider(), FACES, REST, 0.0)[0] == 0.0
    assert attraction(standing, REST)[0] == 0.0


def test_terms_are_the_sums_that_the_paper_writes():
    squeezed = on_hips() * [0.8, 1.0, 1.0] - [0.0, 0.01, 0.0]
    pairs = collider().pairs(squeezed)
    below = np.minimum(squeezed[:, 1], 0.0)
    energy, _ = repulsion(collider(), FACES, squeezed, 0.0)
    assert energy == pytest.approx((pairs.distance**2).sum() + GROUND * (below**2).sum())
    assert len(pairs.vertex) and (below < 0).any()
    lifted = on_hips() * [1.5, 1.0, 1.0] + [0.0, 0.1, 0.0]
    found = contacts()
    gap = np.maximum(np.linalg.norm(lifted[found.first] - lifted[found.second], axis=1) - THRESHOLD, 0.0)
    over = np.maximum(np.abs(lifted[found.ground, 1]) - THRESHOLD, 0.0)
    assert attraction(found, lifted)[0] == pytest.approx((gap**2).sum() + GROUND * (over**2).sum())
    assert (gap > 0).any() and (over > 0).all()


def test_the_gradient_over_turns_is_the_derivative():
    tree, rng = part_tree(FACES, PARTS), np.random.default_rng(3)
    pose = on_hips() * [0.85, 1.0, 1.0] - [0.0, 0.01, 0.0]
    found = contacts()

    def energy(turns):
        vertices = tree.turned(pose, turns)[0]
        return repulsion(collider(), FACES, vertices, 0.0)[0], attraction(found, vertices)[0]

    slopes = [
        tree.turn_gradient(pose, repulsion(collider(), FACES, pose, 0.0)[1]),
        tree.turn_gradient(pose, attraction(found, pose)[1]),
    ]
    for _ in range(5):
        direction = rng.normal(size=(len(tree.names), 3))
        there, here = energy(1e-6 * direction), energy(-1e-6 * direction)
        for term in range(2):
            wanted = float((slopes[term] * direction).sum())
            assert (there[term] - here[term]) / 2e-6 == pytest.approx(wanted, rel=1e-3, abs=1e-6)
            assert abs(wanted) > 1e-4


def test_ground_contacts_that_last_are_held_in_their_place():
    first = contacts()
    some, before = first.ground[::2], on_hips() + [0.05, 0.0, 0.0]
    held = source_contacts(collider(), FACES, REST, on_hips(), THRESHOLD, 0.0, (some, before))
    np.testing.assert_array_equal(held.ground[held.held], some)
    slid, _ = attraction(held, on_hips())
    stood, slope = attraction(first, on_hips())
    assert slid - stood == pytest.approx(GROUND * len(some) * (0.05 - THRESHOLD) ** 2)
    pull = attraction(held, on_hips())[1] - slope
    np.testing.assert_allclose(pull[some], np.tile([-2 * GROUND * 0.03, 0.0, 0.0], (len(some), 1)), atol=1e-12)
