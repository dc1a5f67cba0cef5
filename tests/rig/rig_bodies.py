"""Bodies and things for the tests of rigging, made once."""

from functools import cache

import numpy as np

from retarget.body import rotations as rot
from retarget.character import Mesh
from retarget.evaluate.rig_cases import rig_case
from retarget.geometry.shell import shell
from retarget.rig.rigging import rig


@cache
def case(seed):
    return rig_case(seed)


@cache
def rigged(seed):
    return rig(case(seed).mesh)


@cache
def mapped(seed):
    """Given the true map."""
    return rig(case(seed).mesh, surface_map=case(seed).places)


def capsules(*bones):
    """A closed mesh around segments: (start, end, radius) each."""
    draw = np.random.default_rng(0)
    points = []
    for start, end, radius in bones:
        along, around = draw.random((6000, 1)), rot.unit(draw.normal(size=(6000, 3)))
        points.append(np.array(start) + along * (np.array(end) - start) + radius * around)
    found = shell(np.concatenate(points), 1, 120)
    return Mesh(found.vertices, found.faces)


def quadruped():
    legs = [((x, 0.5, z), (x, 0.02, z), 0.045) for x in (-0.1, 0.1) for z in (-0.3, 0.3)]
    return capsules(
        ((0, 0.5, -0.3), (0, 0.55, 0.3), 0.14), ((0, 0.6, 0.3), (0, 0.8, 0.45), 0.09),
        ((0, 0.8, 0.45), (0, 0.75, 0.65), 0.08), ((0, 0.6, -0.4), (0, 0.9, -0.6), 0.03), *legs,
    )  # fmt: skip


def figurine():
    """A figure of capsules, with feet."""
    limbs = []
    for side in (-1, 1):
        limbs += [((0.15 * side, 1.38, 0), (0.7 * side, 1.38, 0), 0.05), ((0.1 * side, 0.9, 0), (0.12 * side, 0.06, 0), 0.07),
                  ((0.12 * side, 0.05, 0), (0.12 * side, 0.05, 0.17), 0.05)]  # fmt: skip
    return capsules(((0, 0.9, 0), (0, 1.4, 0), 0.1), ((0, 1.5, 0), (0, 1.65, 0), 0.11), *limbs)
