"""Which parts of the fitted body have nothing of the mesh: where a limb was laid into the trunk, into a wing or into thin air,
no skin is left for it, however near its points lie to some surface. Ours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from retarget.geometry.closest import Places
from retarget.geometry.resample import Surface
from retarget.geometry.topology import areas
from retarget.rig.template import Template

Array = np.ndarray

LIMBS = ("head", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
"""Parts that every body has skin for, by the ends of their joints' names."""
BARE = 0.15
"""Share of its own skin, over the middle one of all parts', below which a part has none to speak of."""


def bare_parts(
    template: Template, posed: Float[Array, "template 3"], mesh: Surface, places: Places
) -> dict[str, float]:
    """Parts that have less than `BARE` of the area that they have on the fitted body, next to what the others have, and what
    that is, the least first.

    `posed` is the fitted body in the mesh's space, `places` are those of the mesh's vertices on the template.
    """
    weights = template.body.weights
    wanted, found = (
        _areas_by_part(*each) for each in ((Surface(posed, template.faces), weights), (mesh, places.of(weights)))
    )
    shares = {
        name: float(found[part] / wanted[part])
        for part, name in enumerate(template.names[: weights.shape[1]])
        if name.endswith(LIMBS) and wanted[part] > 0
    }
    usual = max(float(np.median(list(shares.values()))), 1e-12)
    order = sorted(shares, key=lambda name: shares[name])
    return {name: shares[name] / usual for name in order if shares[name] < BARE * usual}


def _areas_by_part(surface: Surface, weights: Float[Array, "vertices parts"]) -> Float[Array, "parts"]:
    """The area of each part: of a vertex, a third of its faces', divided by its weights."""
    corners = np.bincount(surface.faces.ravel(), np.repeat(areas(surface.vertices, surface.faces) / 3, 3), len(surface))
    return corners @ weights
