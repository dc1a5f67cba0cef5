"""A real character as a template of its own structure, with nothing known of humans."""

import numpy as np
import pytest

from retarget.body.kinematics import rest_pose
from retarget.body.skinning import rest_vertices
from retarget.character import Mesh
from retarget.io import load
from retarget.rig.free_templates import free_template
from retarget.rig.rigging import rig


def test_a_knight_rigs_a_barbarian_by_five_landmarks(data):
    files = [data / "characters" / "kaykit" / f"{name}.glb" for name in ("Knight", "Barbarian")]
    if not all(file.is_file() for file in files):
        pytest.skip("the characters are not at hand")
    knight, barbarian = (load(file).character for file in files)
    template, other = free_template(knight), free_template(barbarian)
    body, scale = rest_vertices(barbarian), other.height / float(np.ptp(other.model.points[:, 1]))
    places = {name: other.model.points[other.landmarks[name]] * scale for name in ("head", "hand.l", "hand.r", "toes.l", "toes.r")}
    found = rig(Mesh(body, barbarian.mesh.faces), template, places)
    wanted = rest_pose(barbarian.skeleton)[1][[barbarian.skeleton.index(name) for name in template.names]]
    apart = np.linalg.norm(found.joints - wanted, axis=1) / float(np.ptp(body[:, 1]))
    assert apart.mean() < 0.02 and apart.max() < 0.05
