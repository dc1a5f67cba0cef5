"""One body's shape in another's pose: what must come out exactly, and how far edges may stretch."""

from functools import cache

import numpy as np
import pytest
from made_bodies import joined, posed, sphere, tube
from made_motions import body
from scipy.spatial.transform import Rotation

from retarget.body.skinning import rest_vertices
from retarget.errors import RetargetError
from retarget.geometry.isometric import prepare_isometric
from retarget.geometry.topology import pieces, weld

BENT = {"leftLowerArm": [0.0, -1.2, 0.0], "rightUpperLeg": [-0.8, 0, 0], "rightLowerLeg": [1.0, 0, 0]}


@cache
def rest(preset):
    return rest_vertices(body(preset)).astype(np.float64)


@cache
def carrier(target, size=1.0):
    faces = body().mesh.faces
    return prepare_isometric(rest("thin"), size * rest(target), faces, weld(rest(target)))


@cache
def source():
    return posed(body(), BENT)


def centred(vertices):
    return vertices - vertices.mean(axis=0)


def lengths(vertices):
    faces = body().mesh.faces
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


def test_the_same_body_takes_the_same_pose():
    assert np.abs(centred(carrier("thin").posed(source())) - centred(source())).max() < 1e-4


@pytest.mark.parametrize("preset", ["heavy", "child"])
def test_rest_gives_rest(preset):
    found = carrier(preset).posed(rest("thin"))
    assert np.abs(found - centred(rest(preset))).max() < 1e-4


def test_turning_the_source_turns_the_result():
    turn = Rotation.from_rotvec([0.4, -1.9, 0.7])
    plain = carrier("heavy").posed(source())
    assert np.abs(carrier("heavy").posed(turn.apply(source()) + [3.0, -1, 2]) - turn.apply(plain)).max() < 1e-6


def test_a_larger_source_is_the_same_body_larger():
    found = carrier("thin", size=2.5).posed(source())
    assert np.abs(found - 2.5 * centred(source())).max() < 5e-4


@pytest.mark.parametrize("preset", ["heavy", "child", "very_heavy"])
def test_edges_keep_the_targets_lengths(preset):
    """To a hundredth; where the source's own skin stretches at its joints, the target's does."""
    stretched = np.abs(lengths(carrier(preset).posed(source())) / lengths(rest(preset)) - 1)
    own = np.abs(lengths(source()) / lengths(rest("thin")) - 1)
    still = own < 0.002
    assert still.mean() > 0.7 and own.max() > 0.3
    assert np.percentile(stretched[still], 97) < 0.01
    assert (stretched < own + 0.1).mean() > 0.98


def test_limbs_bend_as_the_sources():
    """The elbow's bend, from the shape alone: the lower arm's skin has turned as the source's."""
    columns = body().skin.joints[body().skin.columns]
    arm = body().skeleton.index("leftLowerArm")
    own = ((columns == arm) * body().skin.weights).sum(axis=1) > 0.95
    turned = []
    for before, after in ((rest("thin"), source()), (rest("heavy"), carrier("heavy").posed(source()))):
        before, after = centred(before[own]), centred(after[own])
        turned.append(Rotation.align_vectors(after, before)[0])
    assert np.degrees(turned[0].magnitude()) > 50
    assert np.degrees((turned[0].inv() * turned[1]).magnitude()) < 2


def test_separate_pieces_stay_where_they_sit():
    """A ring on a bar: it has no edge in common with what it sits on."""
    bar, ring = tube([0, 0, 0], [0, 1, 0], 0.1, rows=20), tube([0, 0.7, 0], [0, 0.8, 0], 0.12, rows=3)
    vertices, faces = joined(bar, ring)
    assert pieces(faces, len(vertices)).max() == 1
    thick = vertices * [1.5, 1, 1.5]
    angle, radius = 0.8 * vertices[:, 1], 1 / 0.8 + vertices[:, 0]
    bent = np.stack([radius * np.cos(angle), radius * np.sin(angle), vertices[:, 2]], axis=1)
    found = prepare_isometric(vertices, thick, faces, np.arange(len(vertices))).posed(bent)
    ring_centre = found[len(bar[0]) :].mean(axis=0)
    beneath = found[: len(bar[0])][(np.abs(bar[0][:, 1] - 0.75) < 0.06)].mean(axis=0)
    assert np.linalg.norm(ring_centre - beneath) < 0.03, "around the bar, where it was"
    assert np.abs(lengths_of(found, ring[1] + len(bar[0])) / lengths_of(thick, ring[1] + len(bar[0])) - 1).max() < 0.15


def lengths_of(vertices, faces):
    return np.linalg.norm(vertices[faces] - np.roll(vertices[faces], 1, axis=1), axis=2)


def test_vertices_that_the_source_lacks_follow_their_neighbours():
    ball = sphere(3)
    known = ball.vertices[:, 1] < 0.8
    turn = Rotation.from_rotvec([0.5, 0.2, -1.0])
    anywhere = np.random.default_rng(0).normal(size=(2, len(known), 3))  # no word of theirs can be believed
    told = np.where(known[:, None], turn.apply(ball.vertices), anywhere[0])
    target = ball.vertices * [1.0, 2.0, 1.0]
    rest = np.where(known[:, None], ball.vertices, anywhere[1])
    found = prepare_isometric(rest, target, ball.faces, np.arange(len(target)), known).posed(told)
    assert (~known).sum() > 10
    assert np.abs(found - centred(turn.apply(target)))[~known].max() < 0.08
    without = prepare_isometric(rest, target, ball.faces, np.arange(len(target))).posed(told)
    assert np.abs(without - centred(turn.apply(target)))[~known].max() > 0.25, "taken at their word they would cave in"


def test_a_vertex_that_no_face_names_goes_along():
    ball = sphere(2)
    vertices = np.concatenate([ball.vertices, [[0.0, 3.0, 0.0]]])
    turn = Rotation.from_rotvec([0.0, 0.0, 1.2])
    found = prepare_isometric(vertices, 2 * vertices, ball.faces, np.arange(len(vertices))).posed(turn.apply(vertices))
    assert np.abs(found - centred(2 * turn.apply(vertices))).max() < 1e-3


def test_doubled_vertices_stay_together():
    ball = sphere(2)
    vertices = np.concatenate([ball.vertices, ball.vertices[:5]])
    faces = ball.faces.copy()
    faces[:20][faces[:20] < 5] += len(ball.vertices)
    found = prepare_isometric(vertices, 2 * vertices, faces, weld(vertices)).posed(vertices * [1, 1.1, 1])
    assert np.array_equal(found[:5], found[-5:])


def refused(match, **changes):
    ball = sphere(1)
    given = {
        "source": ball.vertices, "target": ball.vertices, "faces": ball.faces, "welded": np.arange(len(ball.vertices)),
        "known": None,
    } | changes  # fmt: skip
    with pytest.raises(RetargetError, match=match):
        prepare_isometric(*given.values())


def test_shapes_that_cannot_be_carried_are_refused():
    ball = sphere(1)
    hole = ball.vertices.copy()
    hole[3] = np.nan
    refused("not finite", source=hole)
    refused("not finite", target=hole)
    refused("no faces", faces=np.zeros((0, 3), dtype=int))
    refused("no vertex of the target", known=np.zeros(len(ball.vertices), dtype=bool))
