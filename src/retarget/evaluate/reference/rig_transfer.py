"""Musoni 2021's ways of carrying skinning weights over a functional map, and joints by MMMC21's regressor.

Kept to measure against. Both papers leave the number of eigenfunctions, masks and details open; what is ours is marked.
Nothing here knows poses: a template's coordinates travel as three functions like any others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from retarget.correspond.functional_map import functional_map, point_map, transferred
from retarget.geometry.closest import Places, SurfaceIndex
from retarget.geometry.spectral import SpectralBasis

Array = np.ndarray

FUNCTIONS = 100
"""Eigenfunctions on both sides ("around one hundred", section 4.1)."""
SHARED = 0.1
"""Skinning weight for a joint and its parent from which a vertex counts for the joint's place (MMMC21's code)."""
ONES = 10.0
"""Weight of "a regressor's row sums to one" beside the joint's place in square metres (MMMC21's code)."""


@dataclass(frozen=True, eq=False)
class MappedTemplate:
    """A template, a target and the functional map between them: what the paper takes as given."""

    vertices: Float[Array, "template_vertices 3"]
    """Of the template, metres."""
    faces: Int[Array, "template_faces 3"]
    template: SpectralBasis
    target: SpectralBasis
    C_template_to_target: Float[Array, "target_functions template_functions"]

    @staticmethod
    def of(
        vertices: Float[Array, "template_vertices 3"],
        faces: Int[Array, "template_faces 3"],
        template: SpectralBasis,
        target: SpectralBasis,
        target_to_template: Places | Int[Array, "target_vertices"],
    ) -> MappedTemplate:
        """The map that a point map gives (equation 2)."""
        C = functional_map(template, target, target_to_template)
        return MappedTemplate(vertices, faces, template, target, C)

    def by_function(self, weights: Float[Array, "template_vertices joints"]) -> Float[Array, "target_vertices joints"]:
        """Each joint's weight as a function: the paper's `function`. Neither kept from nought to one nor summing to one."""
        return transferred(self.C_template_to_target, self.template, self.target, weights)

    def by_points(
        self, weights: Float[Array, "template_vertices joints"], adjoint: bool = False
    ) -> Float[Array, "target_vertices joints"]:
        """The weights of the vertex that the map's point map names: the paper's `p2p`."""
        return weights[point_map(self.C_template_to_target, self.template.vectors, self.target.vectors, adjoint)]

    def coordinates(self) -> Float[Array, "target_vertices 3"]:
        """The template's coordinates on the target, low-passed (equations 7 to 9)."""
        return transferred(self.C_template_to_target, self.template, self.target, self.vertices)

    def by_coordinates(
        self, weights: Float[Array, "template_vertices joints"]
    ) -> Float[Array, "target_vertices joints"]:
        """The weights of the template's vertex nearest to those coordinates: the paper's own way (equation 10)."""
        from scipy.spatial import cKDTree

        return weights[cKDTree(self.vertices).query(self.coordinates())[1]]

    def low_pass_places(self) -> Places:
        """Ours: nearest places on the template low-passed like what is compared with it. Equation 10 compares low-passed
        coordinates with full ones, so thin ends shrink away from their counterparts."""
        return SurfaceIndex(self.template.smooth(self.vertices), self.faces).closest(self.coordinates())


def joint_regressor(
    vertices: Float[Array, "template_vertices 3"],
    joints: Float[Array, "joints 3"],
    weights: Float[Array, "template_vertices joints"],
    parents: Int[Array, "joints"],
) -> Float[Array, "joints template_vertices"]:
    """Each joint as a combination of the vertices that move with it and its parent (MMMC21, `A functional skeleton transfer`).

    Their loss, |R X - J|^2 + 10 |R 1 - 1|^2 within the mask of weights above `SHARED` (what lies outside is driven to nought),
    is minimised from R = 0 by a thousand steps of Adam. Ours is the same loss' least-norm minimum, closed form, to which plain
    descent from nought leads; a joint whose mask is empty (the root has no parent) takes the vertices of its own weight.
    """
    found = np.zeros((len(joints), len(vertices)))
    for joint, parent in enumerate(parents):
        chosen = _mask(weights, joint, int(parent))
        rows = np.concatenate([vertices[chosen].T, np.full((1, len(chosen)), np.sqrt(ONES))])
        found[joint, chosen] = np.linalg.lstsq(rows, np.append(joints[joint], np.sqrt(ONES)), rcond=None)[0]
    return found


def _mask(weights: Float[Array, "vertices joints"], joint: int, parent: int) -> Int[Array, "chosen"]:
    own: Bool[Array, "vertices"] = weights[:, joint] > SHARED
    shared = np.flatnonzero(own & (weights[:, parent] > SHARED)) if parent >= 0 else np.zeros(0, dtype=np.int64)
    if len(shared) >= 4:
        return shared
    return np.flatnonzero(own) if own.sum() >= 4 else np.argsort(-weights[:, joint], kind="stable")[:4]


def joints_by_points(
    regressor: Float[Array, "joints template_vertices"],
    target_vertices: Float[Array, "target_vertices 3"],
    template_to_target: Int[Array, "template_vertices"],
) -> Float[Array, "joints 3"]:
    """MMMC21's spatial way, which their code calls the best: J = R X_target[template_to_target]."""
    return regressor @ target_vertices[template_to_target]


def joints_by_functions(
    regressor: Float[Array, "joints template_vertices"],
    template: SpectralBasis,
    target: SpectralBasis,
    C_target_to_template: Float[Array, "template_functions target_functions"],
    target_vertices: Float[Array, "target_vertices 3"],
) -> Float[Array, "joints 3"]:
    """MMMC21's spectral way: J = (R Phi_template) C (pinv(Phi_target) X_target), the map running from target to template."""
    rows, columns = C_target_to_template.shape
    places = C_target_to_template @ target.first(columns).coefficients(target_vertices)
    return (regressor @ template.vectors[:, :rows]) @ places
