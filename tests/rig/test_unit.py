"""The unit of a mesh is told by how tall the body in it would be."""

import numpy as np
import pytest

from retarget.body.human import PRESETS, human
from retarget.character import Mesh
from retarget.rig.rigging import rig
from retarget.rig.templates import human_template
from retarget.rig.unit import likely_unit, usual_height


@pytest.mark.parametrize(
    "height, unit", [(1.7, 1.0), (170.0, 0.01), (1700.0, 0.001), (66.9, 0.0254), (17.0, 0.1), (12.0, 0.1), (0.8, 1.0)]
)
def test_the_unit_is_told_by_the_height(height, unit):
    assert likely_unit(height)[0] == pytest.approx(unit)


@pytest.mark.parametrize(
    "height, unit", [(0.82, 1.0), (82.0, 0.01), (77.0, 0.01), (820.0, 0.001), (32.3, 0.0254), (8.2, 0.1)]
)
def test_a_toddler_is_small(height, unit):
    assert likely_unit(height, 0.85)[0] == pytest.approx(unit)


def test_a_height_that_could_be_either_is_told_by_the_age():
    assert likely_unit(75.0)[0] == 0.0254 and likely_unit(75.0, 0.8)[0] == 0.01


@pytest.mark.parametrize("height, usual", [(3.9e6, 1.7), (0.17, 1.7), (0.074, 0.8), (4.8, 1.7)])
def test_an_unlikely_height_is_scaled(height, usual):
    """Half a metre in the rarer decimetres is no grown body's height."""
    unit, note = likely_unit(height, usual)
    assert unit * height == pytest.approx(usual) and f"scaled to {usual:.2f} m" in note


def test_a_toddler_in_centimetres_is_no_man_in_inches():
    body = human(height=0.74, **{key: value for key, value in PRESETS["toddler"].items() if key != "height"}).mesh
    found = rig(Mesh(body.vertices * 100.0, body.faces))
    assert found.unit == pytest.approx(0.01)
    assert np.ptp(found.character.mesh.vertices[:, 1]) < 1.0


def test_the_head_of_a_toy_tells_nothing():
    template = human_template()
    stylised = next(start.shape for start in template.starts if start.name == "stylised")
    assert usual_height(template, stylised) == 1.7
