"""Basset 2019 as published: the target's shape comes, what is left out stays away, and trouble is told."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_motions import actor

from retarget.body.skinning import rest_vertices, skin_motion
from retarget.contact.parts import body_parts
from retarget.errors import RetargetError
from retarget.evaluate.reference.shape_terms import part_volumes
from retarget.evaluate.reference.shape_transfer import TERMS, ReferenceSettings, prepare_reference
from retarget.motion.library import embedded_motion

BODY = actor("thin").character
FACES = BODY.mesh.faces
REST, HEAVY = (rest_vertices(actor(name).character) for name in ("thin", "heavy"))
PARTS = body_parts(BODY, actor("thin").humanoid)
POSED = skin_motion(BODY, embedded_motion("hands_on_hips"))[70].astype(float)


@cache
def to_heavy():
    return prepare_reference(REST, HEAVY, FACES, PARTS)


@cache
def ran(iterations=30, **settings):
    return replace(to_heavy(), settings=ReferenceSettings(**settings)).run(POSED, iterations)


def volume_error(vertices):
    return np.abs(part_volumes(to_heavy().solids, vertices) / to_heavy().volumes - 1)


def test_shape_and_volume_come_within_the_first_iterations():
    energies = ran().energies
    assert (np.diff(energies["shape"]) < 0)[:8].all() and energies["shape"][-1] < 0.1 * energies["shape"][0]
    assert energies["volume"][-1] < 0.1 * energies["volume"][0]
    assert (np.diff(energies["total"][:4]) < 0).all()
    assert np.median(volume_error(ran().vertices)) < 0.5 * np.median(volume_error(POSED))
    np.testing.assert_allclose(sum(energies[term] for term in TERMS), energies["total"])
    assert ran().iterations == 30 and len(energies["total"]) == 31


def test_the_last_energies_are_those_of_the_result():
    """Shape and volume exactly; contacts are from before the last turn, which is small."""
    last, now = ran(60).energies, to_heavy().energy(ran(60).vertices, ran(60).contacts)
    for term in ("shape", "volume"):
        assert now[term] == pytest.approx(last[term][-1])
    for term in ("repulsion", "attraction"):
        assert now[term] == pytest.approx(last[term][-1], rel=0.1)
    assert now["total"] == pytest.approx(sum(now[term] for term in TERMS))


def test_a_body_that_has_its_shape_already_stays():
    own = prepare_reference(REST, REST, FACES, PARTS)
    at_rest = own.run(REST)
    assert at_rest.status == "converged" and at_rest.iterations == 1
    np.testing.assert_allclose(at_rest.vertices, REST, atol=1e-12)
    still = replace(own, settings=ReferenceSettings(repulsion=False, attraction=False)).run(POSED, 30)
    assert np.abs(still.vertices - POSED).max() < 0.03 and np.abs(still.vertices - POSED).mean() < 0.002
    np.testing.assert_array_equal(still.turns, np.tile(np.eye(3), (len(own.tree.names), 1, 1)))


def test_it_stops_when_the_energies_do():
    rule = ran(None)
    totals = rule.energies["total"]
    assert rule.status == "converged" and rule.iterations < 1000
    changes = np.abs(np.diff(totals)) / totals[:-1]
    assert changes[-1] <= 1e-3 and (changes[:-1] > 1e-3).all()
    patient = ran(None, still_for=5)
    assert patient.iterations >= rule.iterations + 4
    assert ran(None, most_iterations=3).status == "unconverged"


def test_without_repulsion_arms_sink_in():
    full, without = (to_heavy().energy(ran(60, repulsion=on).vertices, ran(60).contacts) for on in (True, False))
    assert without["repulsion"] > 1.5 * full["repulsion"]
    assert not ran(60, repulsion=False).energies["repulsion"].any()


def test_without_attraction_hands_come_off():
    full, without = (to_heavy().energy(ran(60, attraction=on).vertices, ran(60).contacts) for on in (True, False))
    assert without["attraction"] > 3 * full["attraction"]
    assert not ran(60, attraction=False).energies["attraction"].any()


def test_without_part_volumes_parts_have_other_volumes():
    """Figure 5's reason: one volume for the whole body is met by the whole alone."""
    by_part, as_one, none = (ran(60, volume=which).vertices for which in ("parts", "body", "none"))
    assert np.median(volume_error(as_one)) > 3 * np.median(volume_error(by_part))
    assert np.median(volume_error(none)) > 3 * np.median(volume_error(by_part))
    whole = [part_volumes(to_heavy().body, vertices)[0] / to_heavy().body_volume[0] for vertices in (as_one, none)]
    assert abs(whole[0] - 1) < 0.05 < abs(whole[1] - 1)


def test_near_joints_are_tested_where_asked():
    wide = prepare_reference(REST, HEAVY, FACES, PARTS, ReferenceSettings(near_joints=True))
    assert wide.run_collider.excluded.sum() < wide.collider.excluded.sum()
    assert wide.run(POSED, 10).energies["repulsion"][-1] > ran(10).energies["repulsion"][-1]


def test_feet_that_stay_on_the_ground_are_held_where_they_were():
    first = ran()
    again = to_heavy().run(POSED + [0.06, 0.0, 0.0], 30, before=first)
    loose = to_heavy().run(POSED + [0.06, 0.0, 0.0], 30)
    feet = again.contacts.ground[again.contacts.held]
    assert len(feet) > 100 and len(loose.contacts.held) == 0
    slid = [np.linalg.norm((each.vertices - first.vertices)[feet], axis=1).mean() for each in (again, loose)]
    assert slid[0] < slid[1]


def test_a_descent_that_runs_away_says_so_and_stays_finite():
    wild = ran(100, turn_step=0.02)
    assert wild.status == "diverged" and 5 < wild.iterations < 100
    assert np.isfinite(wild.vertices).all() and all(np.isfinite(each).all() for each in wild.energies.values())
    start, worst = wild.energies["total"][0], wild.energies["total"].max()
    assert to_heavy().energy(wild.vertices, wild.contacts)["total"] < start < 0.5 * worst
    for terms in ({"offset": 3.0, "turn_step": 0.0}, {"offset": 20.0, "repulsion": False, "attraction": False}):
        exploding = ran(2000, **terms)
        assert exploding.status == "diverged" and np.isfinite(exploding.vertices).all()
        assert all(np.isfinite(each).all() for each in exploding.energies.values())


def test_turns_are_what_each_part_was_turned_by():
    """Without the vertices' own steps every part moves rigidly."""
    rigid = ran(40, offset=0.0)
    for part in range(len(to_heavy().tree.names)):
        own = to_heavy().tree.vertex_parts == part
        wanted = (POSED[own] - POSED[own].mean(axis=0)) @ rigid.turns[part].T
        np.testing.assert_allclose(rigid.vertices[own] - rigid.vertices[own].mean(axis=0), wanted, atol=1e-9)
    assert np.abs(rigid.turns - np.eye(3)).max() > 0.002


def test_bad_input_is_refused():
    hole = POSED.copy()
    hole[7, 1] = np.nan
    far = POSED.copy()
    far[7, 1] = np.inf
    for bad in (hole, far):
        with pytest.raises(RetargetError, match="vertex 7"):
            to_heavy().run(bad)
        with pytest.raises(RetargetError, match="vertex 7"):
            to_heavy().energy(bad, ran().contacts)
        with pytest.raises(RetargetError, match="target at rest"):
            prepare_reference(REST, bad, FACES, PARTS)
    with pytest.raises(RetargetError, match="beyond all measure"):
        to_heavy().run(POSED * 1e50)
    for count in (0, len(POSED) - 1):
        with pytest.raises(RetargetError, match=f"{len(POSED)} vertices"):
            to_heavy().run(POSED[:count])
        with pytest.raises(RetargetError, match=f"{len(POSED)} vertices"):
            prepare_reference(REST, HEAVY[:count], FACES, PARTS)
    with pytest.raises(RetargetError, match="faces"):
        prepare_reference(REST, HEAVY, FACES[:-1], PARTS)
    with pytest.raises(RetargetError, match="look inwards"):
        prepare_reference(REST, HEAVY * [-1.0, 1.0, 1.0], FACES, PARTS)
    with pytest.raises(RetargetError, match="floor"):
        to_heavy().run(POSED, floor=np.nan)
    with pytest.raises(RetargetError, match="iterations"):
        to_heavy().run(POSED, -1)


@pytest.mark.parametrize(
    "wrong", [{"volume": "some"}, {"offset": -1.0}, {"turn_step": np.nan}, {"still_for": 0}, {"most_iterations": 0}]
)
def test_settings_that_mean_nothing_are_refused(wrong):
    with pytest.raises(RetargetError, match=next(iter(wrong))):
        ReferenceSettings(**wrong)
