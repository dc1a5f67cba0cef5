"""What is no body, or more than one, is told in one line; what merely lies about does not keep a body from being found."""

import time

import numpy as np
import pytest
from made_bodies import sphere
from rig_bodies import capsules, case

from retarget.body.human import human, human_model
from retarget.character import Mesh, PointCloud
from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface, largest_pieces
from retarget.geometry.shell import CELLS, covering_points, shell
from retarget.rig.fit import Misfit
from retarget.rig.fit_model import BodyState
from retarget.rig.reading import LEAST_CONFIDENCE
from retarget.rig.rigging import rig
from retarget.rig.search import Candidate, confidence_of
from retarget.rig.shares import bare_parts
from retarget.rig.template import MAIN
from retarget.rig.templates import human_template

CLEAN = 6


def errors(found, truth):
    """Joint errors in per cent of the height."""
    order = [human_model().joint_names.index(name) for name in MAIN]
    return 100 * np.linalg.norm(found.joints[: len(MAIN)] - truth.joints[order], axis=1) / truth.height


def beside(*shifts):
    body = human().mesh
    vertices = np.concatenate([body.vertices + np.array([shift, 0, 0]) for shift in shifts])
    faces = np.concatenate([body.faces + number * len(body.vertices) for number in range(len(shifts))])
    return Mesh(vertices, faces)


def closed(mesh, cells=CELLS):
    step = float(np.ptp(mesh.vertices, axis=0).max()) / cells
    found = largest_pieces(shell(covering_points(Surface(mesh.vertices, mesh.faces), 0.7 * step), 1, cells))[0]
    return Mesh(found.vertices, found.faces)


def cut(keep):
    body = human().mesh
    faces = body.faces[keep(body.vertices)[body.faces].all(axis=1)]
    used, packed = np.unique(faces, return_inverse=True)
    return closed(Mesh(body.vertices[used], packed.reshape(-1, 3)))


def ball_on_a_stick():
    return capsules(((0, 0, 0), (0, 1.2, 0), 0.06), ((0, 1.5, 0), (0, 1.55, 0), 0.3))


def upper_half():
    """Open at the waist."""
    body = human().mesh
    return Mesh(body.vertices, body.faces[(body.vertices[body.faces][:, :, 1] > 0.85).all(axis=1)])


@pytest.mark.parametrize(
    "make, reason",
    [
        pytest.param(lambda: beside(0, 1.4), r"50 % of the surface stands apart", id="two people apart"),
        pytest.param(lambda: beside(0, 1, 2), r"much of it is nothing of the template's", id="three hand in hand"),
        pytest.param(
            lambda: cut(lambda at: (at[:, 0] < 0.25) & (at[:, 1] < 1.4)),
            r"nothing of it is left for .*leftLowerArm, head",
            id="neither head nor left arm",
        ),
        pytest.param(lambda: Mesh(sphere(3).vertices, sphere(3).faces), "no reading of it fits", id="a ball"),
        pytest.param(ball_on_a_stick, "no reading of it fits", id="a ball on a stick"),
        pytest.param(upper_half, "no reading of it fits", id="half a person"),
    ],
)
def test_what_would_be_rigged_wrongly_is_refused(make, reason):
    with pytest.raises(
        RetargetError, match=rf"no body was found with certainty in .*: {reason}.* \(confidence 0\.\d\d; 0\.34 is needed\)"
    ):
        rig(make())


def test_a_soup_of_large_triangles_is_refused_at_once():
    draw = np.random.default_rng(5)
    with pytest.raises(RetargetError, match="triangles criss-cross"):
        rig(Mesh(draw.normal(size=(3000, 3)), draw.integers(0, 3000, (5000, 3))))


@pytest.mark.parametrize(
    "vertices, reason",
    [
        (np.outer(np.arange(30.0), [1, 2, 3]), "the mesh has 0 triangles with an area"),
        (np.random.default_rng(0).normal(size=(30, 3)) * 1e200, r"units large, .* from the origin: no lengths"),
        (np.random.default_rng(0).normal(size=(30, 3)) * 1e-200, r"units large, .* from the origin: no lengths"),
    ],
)
def test_places_without_measure(vertices, reason):
    faces = np.arange(28)[:, None] + np.arange(3)
    with pytest.raises(RetargetError, match=reason):
        rig(Mesh(vertices, faces))


@pytest.mark.parametrize(
    "points, reason",
    [
        (np.outer(np.linspace(0, 1, 1000), [1.0, 2, 3]), "no closed surface can be laid around it"),
        (np.ones((1000, 3)), "all vertices lie in one place"),
        (np.concatenate([np.zeros((500, 3)), np.ones((500, 3))]), "no closed surface can be laid around it"),
        (beside(0, 1.4).vertices, r"\d+ % of the surface around the points stands apart"),
    ],
)
def test_clouds_that_are_no_body(points, reason):
    with pytest.raises(RetargetError, match=reason):
        rig(PointCloud(points))


def test_a_cloud_gets_a_surface_and_stray_points_far_away_do_not_matter():
    points = case(CLEAN).mesh.vertices
    strays = np.random.default_rng(0).uniform(-2, 3, (60, 3)) * np.ptp(points, axis=0) + points.min(axis=0)
    found = rig(PointCloud(np.concatenate([points, strays, points[:1] * 500])))
    assert len(found.character.mesh.faces) > 1000
    assert errors(found, case(CLEAN)).mean() < 2.5 / 1.7


def candidate(template, surface, place, feet=0.03):
    joints = np.full((3, 3), float(place))
    state = BodyState(np.zeros(1), np.tile(np.eye(3), (3, 1, 1)), np.zeros(3))
    return Candidate("made", np.zeros(1), state, Misfit(template, surface, feet), joints, np.zeros(0))


def test_a_surface_that_the_template_does_not_explain_lowers_the_confidence():
    other = candidate(0.05, 0.09, 1.0, 0.2)
    whole, clothed, lost = (confidence_of([candidate(0.015, each, 0.0), other])[0] for each in (0.02, 0.06, 0.082))
    assert whole == clothed == 1.0 and lost < LEAST_CONFIDENCE
    assert confidence_of([candidate(0.015, 0.082, 0.0), other])[1] == "much of it is nothing of the template's"


def test_parts_that_have_nothing_of_the_mesh_are_named():
    template = human_template()
    posed, faces, count = template.model.points, template.faces, len(template.model.points)
    own = Places(np.repeat(np.arange(count)[:, None], 3, axis=1), np.tile([1.0, 0, 0], (count, 1)))
    assert bare_parts(template, posed, Surface(posed, faces), own) == {}
    head = template.body.weights[:, template.names.index("head")] > 0.05
    kept = faces[~head[faces].any(axis=1)]
    assert list(bare_parts(template, posed, Surface(posed, kept), own)) == ["head"]


def test_a_soup_of_pieces_is_taken_apart_in_time():
    count = 60_000
    soup = Surface(np.random.default_rng(0).random((3 * count, 3)), np.arange(3 * count).reshape(-1, 3))
    begun = time.process_time()
    found = largest_pieces(soup)
    assert time.process_time() - begun < 5.0
    assert len(found) == count and all(len(each) == 3 for each in found[:10])
    first = found[0].vertices[found[0].faces[0]]
    assert np.linalg.norm(np.cross(first[1] - first[0], first[2] - first[0])) == pytest.approx(
        np.linalg.norm(np.cross(*(soup.vertices[k::3] - soup.vertices[0::3] for k in (1, 2))), axis=1).max()
    )
