"""The body's ends are found in any pose and told apart by the surface alone."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "rig"))
from rig_bodies import case  # noqa: E402

from retarget.body.human import human_model  # noqa: E402
from retarget.correspond.landmarks import find_tips, labellings  # noqa: E402
from retarget.geometry.resample import Surface  # noqa: E402
from retarget.rig.template import intrinsic_body  # noqa: E402
from retarget.rig.templates import ENDS, human_template  # noqa: E402
from retarget.rig.working_surface import working_surfaces  # noqa: E402

SEEDS = (0, 2, 6, 11, 22, 28)
"""At rest; sitting, shod; arms crossed; a toddler with a hat; a child reaching; legs crossed."""


def body_of(seed):
    mesh = case(seed).mesh
    return intrinsic_body(next(working_surfaces(Surface(mesh.vertices, mesh.faces))).surface)


def true_ends(seed, surface):
    """The number in `TIPS` of the true end nearest to each vertex of a working surface."""
    truth, model = case(seed), human_model()
    ends = truth.posed[[model.landmark(name) for name in ENDS.values()]]
    return lambda vertices: np.linalg.norm(surface.vertices[vertices][:, None] - ends, axis=2).argmin(axis=1).tolist()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_five_ends_are_found_and_one_of_two_namings_is_right(seed):
    body = body_of(seed)
    name = true_ends(seed, body.surface)
    tips = find_tips(body)
    assert sorted(name(tips)) == [0, 1, 2, 3, 4]
    found = list(labellings(body, human_template().starts[0].labelled, tips, choices=1))
    assert len(found) == 2
    assert [0, 1, 2, 3, 4] in [name(each.tips) for each in found]
    assert [0, 2, 1, 4, 3] in [name(each.tips) for each in found]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_front_is_in_front(seed):
    """On the right naming the front's function agrees with the template's at the same places; on the other it is its negative."""
    body, truth, model = body_of(seed), case(seed), human_model()
    name = true_ends(seed, body.surface)
    found = {tuple(name(each.tips)): each for each in labellings(body, human_template().starts[0].labelled, find_tips(body))}
    right, wrong = found[(0, 1, 2, 3, 4)], found[(0, 2, 1, 4, 3)]
    places = [model.landmark(each) for each in ("navel", "lowerBack", "chest", "upperBack")]
    near = np.linalg.norm(body.surface.vertices[:, None] - truth.posed[places], axis=2).argmin(axis=0)
    assert (np.sign(right.front[near]) == [1, -1, 1, -1]).all()
    assert np.array_equal(wrong.front, -right.front)
    assert right.twist > 0.2


def test_the_template_has_no_misfit_with_itself():
    start = human_template().starts[0]
    found = list(labellings(start.body, start.labelled, find_tips(start.body)))
    assert found[0].misfit < 0.02 < found[2].misfit
