"""How long a unit of a mesh is, told by the height of the body in it, and by its age where its head shows that it is small.

A mesh without a unit is in metres, centimetres or millimetres, more seldom in inches or decimetres. Ours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.rig.template import Template

Array = np.ndarray

UNITS = {"m": (1.0, 0.0), "cm": (0.01, 0.0), "mm": (0.001, 0.0), "dm": (0.1, 0.6), "inch": (0.0254, 0.6)}
"""Metres, and how much better the height must fit (in its logarithm) for the rarer ones."""
PLAUSIBLE, USUAL = (0.4, 3.0), 1.7
"""Heights of bodies in metres by which a unit is told, and the likeliest."""
RARELY = 2.0
"""How many times the likeliest height a body may be smaller or larger by which a rarer unit is told."""
SMALL_CHILD = ((0.115, 1.0), (0.155, 0.6))
"""Head above its joint as a share of the height, and metres of the height, of embedded bodies of about two years and none."""
TOY = 0.18
"""Share from which a head is a toy's and says nothing of the height."""


def usual_height(template: Template, shape: Float[Array, "shapes"]) -> float:
    """The height in metres that a body of this shape is likely to have: the template's, unless a human's head says more."""
    if not template.human:
        return template.height
    points, joints = template.model.points_of(shape), template.model.joints_of(shape)
    head = float(points[template.landmarks["head"], 1] - joints[template.names.index("head"), 1])
    share = head / float(np.ptp(points[:, 1]))
    (least, tall), (most, small) = SMALL_CHILD
    return float(np.interp(share, (least, most), (tall, small))) if least < share < TOY else USUAL


def likely_unit(height: float, usual: float = USUAL, kind: float = USUAL) -> tuple[float, str]:
    """Metres in a unit by which a body so many units tall is likely, and why. `usual` is how tall such a body would be, `kind`
    what is usual of all bodies of its template, in metres."""
    likely = []
    for name, (unit, rare) in UNITS.items():
        away = abs(float(np.log(height * unit / usual)))
        if PLAUSIBLE[0] <= height * unit * USUAL / kind <= PLAUSIBLE[1] and (not rare or away <= np.log(RARELY)):
            likely.append((away + rare, name, unit))
    if likely:
        _, name, unit = min(likely)
        return unit, f"unit {name}: the body is {height * unit:.2f} m tall"
    return usual / height, f"no unit makes a height of {height:.4g} plausible: scaled to {usual:.2f} m"
