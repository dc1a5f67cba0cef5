"""The template's surface laid onto a mesh to the millimetre.

What the fit of shape and pose leaves is a smooth displacement: nearest places on the mesh pull, bending resists, and from
round to round it resists less. Amberg, Romdhani and Vetter 2007 ("Optimal Step Nonrigid ICP") for the idea; ours penalises
the displacement's bi-Laplacian, so that one sparse factor serves all three coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.body import rotations as rot
from retarget.geometry.closest import SurfaceIndex
from retarget.geometry.spectral import laplacian
from retarget.geometry.topology import vertex_normals
from retarget.rig.fit import LEAST_AGREEMENT, LIKE_NORMALS, lifted

Array = np.ndarray

WAVES = (0.5, 0.35, 0.25, 0.18, 0.13, 0.1, 0.08)
"""Metres: displacements that change over less than this are resisted, a round each."""
REACH = (0.03, 0.03, 0.03, 0.03, 0.02, 0.02, 0.02)
"""Metres beyond which a nearest place pulls little."""
WIDEST = 0.08
"""Metres that it reaches for bodies that lie further off, at most."""
ACROSS = 0.2
"""Share of the way across the normal that is gone: a like normal tells where a vertex lies on the surface, but less surely."""


@dataclass(frozen=True, eq=False)
class Registered:
    """The template's surface where the mesh is."""

    vertices: Float[Array, "vertices 3"]
    """In the space of the mesh that was handed over."""
    normals: Float[Array, "vertices 3"]
    found: Bool[Array, "vertices"]
    """Whether the mesh has a counterpart of the vertex nearby; the others follow their neighbours."""


def register(
    posed: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], skin: SurfaceIndex, alien: float = 1.0
) -> Registered:
    """Lay a fitted template onto a mesh of the same scale (`fit.prepare_skin`; metres of a body about 1.7 m tall).

    `alien` is how many times as far as usual the fit left it from the mesh: it then reaches as many times as far, and goes
    where normals are alike more fully.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    stiffness, masses = laplacian(posed, faces)
    masses = np.maximum(masses, 1e-6 * masses.mean())
    bending = (stiffness @ diags(1.0 / masses) @ stiffness).tocsc()
    vertices = posed
    for wave, reach in zip(WAVES, REACH):
        away, weight = _pulls(vertices, faces, skin, min(WIDEST, reach * alien), min(1.0, ACROSS * alien))
        pull = masses * weight
        matrix = (diags(pull) + (wave / (2 * np.pi)) ** 4 * bending + diags(1e-6 * masses)).tocsc()
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        wanted = pull[:, None] * (vertices + away - posed)
        vertices = posed + factor.solve(wanted)
    _, weight = _pulls(vertices, faces, skin, REACH[-1], ACROSS)
    return Registered(vertices, vertex_normals(vertices, faces), weight > 0.25)


def _pulls(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], skin: SurfaceIndex, reach: float, across: float
) -> tuple[Float[Array, "vertices 3"], Float[Array, "vertices"]]:
    """Ways to the nearest place of a like normal, shortened across its normal, and how much each counts."""
    own = vertex_normals(vertices, faces)
    there = skin.closest(lifted(vertices, own)).of(skin.vertices)
    normals = rot.unit(there[:, 3:])
    away = there[:, :3] - vertices
    weight = 1.0 / (1.0 + (np.linalg.norm(away, axis=1) / reach) ** 2) ** 2
    agreement = (there[:, 3:] / LIKE_NORMALS * own).sum(axis=1)
    along = (away * normals).sum(axis=1)[:, None] * normals
    return along + across * (away - along), np.where(agreement > LEAST_AGREEMENT, weight, 0.0)
