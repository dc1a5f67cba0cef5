"""Functional maps: correspondences between two surfaces as small matrices between their eigenfunctions.

    >>> C_template_to_target = functional_map(template, target, target_to_template)
    >>> weights = transferred(C_template_to_target, template, target, template_weights)

`C_template_to_target` (target functions x template functions) takes coefficients of functions on the template to
coefficients on the target; the point map behind it runs the other way: `target_to_template` names for each vertex of the
target a vertex (or a place) of the template. Ovsjanikov and others 2012; Musoni 2021, equations 1 and 2. Plain arrays
throughout; either basis may have the more functions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from retarget.errors import RetargetError
from retarget.geometry.closest import Places
from retarget.geometry.geodesic import farthest_points
from retarget.geometry.spectral import SpectralBasis

Array = np.ndarray

SAMPLES = 1500
"""Points of each surface that `zoomout` works on before it ends on all of them."""
ENERGIES = 100
"""Scales of the wave kernel signature."""
WIDTH = 7.0
"""Its variance, in steps between energies, as Aubry, Schlickewei and Cremers 2011 choose it."""


def functional_map(
    template: SpectralBasis, target: SpectralBasis, target_to_template: Places | Int[Array, "target_vertices"]
) -> Float[Array, "target_functions template_functions"]:
    """The map of functions that a map of points gives: C = pinv(Phi_target) Pi Phi_template (Musoni 2021, equation 2), the
    pseudo-inverse in the sense of the masses. Raises `RetargetError` where the point map is not of these surfaces."""
    return target.coefficients(pulled_back(target_to_template, template.vectors, len(target.vectors)))


def pulled_back(
    target_to_template: Places | Int[Array, "target_vertices"],
    functions: Float[Array, "template_vertices *columns"],
    count: int,
) -> Float[Array, "target_vertices *columns"]:
    """Functions of the template at the `count` vertices of the target. Raises `RetargetError` where the point map is not of
    these surfaces."""
    placed = isinstance(target_to_template, Places)
    named = target_to_template.corners if placed else target_to_template
    lowest, highest = (int(named.min()), int(named.max())) if named.size else (0, 0)
    if len(named) != count or lowest < 0 or highest >= len(functions):
        raise RetargetError(
            f"the point map names vertices {lowest} to {highest} for {len(named)} vertices; the template has "
            f"{len(functions)}, the target {count}"
        )
    return target_to_template.of(functions) if placed else functions[named]


def transferred(
    C_template_to_target: Float[Array, "target_functions template_functions"],
    template: SpectralBasis,
    target: SpectralBasis,
    functions: Float[Array, "template_vertices *columns"],
) -> Float[Array, "target_vertices *columns"]:
    """Functions of the template on the target, without what is finer than the bases: Phi_target C pinv(Phi_template) f."""
    rows, columns = C_template_to_target.shape
    coefficients = np.tensordot(C_template_to_target, template.first(columns).coefficients(functions), axes=1)
    return np.tensordot(target.vectors[:, :rows], coefficients, axes=1)


def point_map(
    C_template_to_target: Float[Array, "target_functions template_functions"],
    template: Float[Array, "template_points columns_at_least"],
    target: Float[Array, "target_points rows_at_least"],
    adjoint: bool = False,
) -> Int[Array, "target_points"]:
    """`target_to_template`: for each row of the target's eigenfunctions the row of the template's that the map takes nearest.

    As ZoomOut (Melzi and others 2019) reads a map: delta functions of the template are pushed to the target and compared
    there, |C phi_template(q) - phi_target(p)|. With `adjoint` the target's are pulled to the template instead,
    |phi_template(q) - C' phi_target(p)|; for a map that is an isometry both are the same.
    """
    from scipy.spatial import cKDTree

    rows, columns = C_template_to_target.shape
    there, here = template[:, :columns], target[:, :rows]
    if adjoint:
        return cKDTree(there).query(here @ C_template_to_target)[1]
    return cKDTree(there @ C_template_to_target.T).query(here)[1]


def zoomout(
    template: SpectralBasis,
    target: SpectralBasis,
    C_template_to_target: Float[Array, "target_functions template_functions"],
    sizes: Sequence[int],
    samples: int | None = SAMPLES,
) -> tuple[Float[Array, "functions functions"], Int[Array, "target_vertices"]]:
    """A map refined from few functions to many (Melzi and others 2019): to points and back, a size at a time.

    On `samples` points of each surface, spread evenly by the distance of their first eigenfunctions (Euclidean places are
    not needed), the last size on all; None takes all throughout. Returns C of the last size and `target_to_template`.
    Raises `RetargetError` for sizes that do not grow or exceed the bases.
    """
    most = min(template.vectors.shape[1], target.vectors.shape[1])
    if not sizes or any(b <= a for a, b in zip(sizes, sizes[1:])) or sizes[0] < 1 or sizes[-1] > most:
        raise RetargetError(f"sizes of a map must grow, from 1 to {most} functions at most; received {list(sizes)}")
    here, there = (_spread(basis, samples) for basis in (target, template))
    C = C_template_to_target
    for size in sizes:
        found = there[point_map(C, template.vectors[there], target.vectors[here])]
        wanted = template.vectors[found, :size]
        if len(here) == len(target.vectors):
            C = target.first(size).coefficients(wanted)
        else:
            C = np.linalg.lstsq(target.vectors[here, :size], wanted, rcond=None)[0]
    whole = point_map(C, template.vectors, target.vectors)
    C = functional_map(template.first(sizes[-1]), target.first(sizes[-1]), whole)
    return C, point_map(C, template.vectors, target.vectors)


def _spread(basis: SpectralBasis, samples: int | None) -> Int[Array, "samples"]:
    if samples is None or samples >= len(basis.vectors):
        return np.arange(len(basis.vectors))
    few = basis.vectors[:, 1:8] / np.sqrt(np.maximum(basis.values[1:8], 1e-9))  # distances as diffusion sees them
    return farthest_points(few, samples, int(np.abs(few[:, 0]).argmax()))


def wave_kernel_signature(
    basis: SpectralBasis, energies: Float[Array, "energies"], width: float
) -> Float[Array, "vertices energies"]:
    """How much waves of each energy (natural logarithm of an eigenvalue) dwell at each vertex; Aubry, Schlickewei and
    Cremers 2011, equation 6. The constant function, whose eigenvalue is nought, has no part in it."""
    logarithms = np.log(np.maximum(basis.values[1:], 1e-9))
    weight = np.exp(-((energies[:, None] - logarithms) ** 2) / (2 * width**2))
    return basis.vectors[:, 1:] ** 2 @ (weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)).T


def shared_energies(one: SpectralBasis, other: SpectralBasis, count: int = ENERGIES) -> tuple[Float[Array, "_"], float]:
    """Energies at which two surfaces are compared, and the width of a wave: the same for both, else they compare nothing."""
    lowest = np.log(max(one.values[1], other.values[1], 1e-9))
    highest = np.log(max(min(one.values[-1], other.values[-1]), 2e-9))
    step = (highest - lowest) / max(count - 1 + 2 * WIDTH, 1.0)
    return np.linspace(lowest + WIDTH * step, highest - WIDTH * step, count), WIDTH * step


def map_from_descriptors(
    template: SpectralBasis,
    target: SpectralBasis,
    template_descriptors: Float[Array, "template_vertices descriptors"],
    target_descriptors: Float[Array, "target_vertices target_descriptors"],
    commutativity: float = 1e-3,
) -> Float[Array, "target_functions template_functions"]:
    """The map that takes descriptors to descriptors and commutes with the Laplacians: least |C A - B|^2 + commutativity
    |C L_template - L_target C|^2 (Ovsjanikov and others 2012), closed form a row at a time.

    Each descriptor is divided by its norm on the template, on both surfaces alike, and eigenvalues by the largest. Isometric
    symmetries, left for right, satisfy it as well as the true map does: this is the field's usual start, not a whole method.
    Raises `RetargetError` for a different number of descriptors.
    """
    if template_descriptors.shape[1] != target_descriptors.shape[1]:
        raise RetargetError(
            f"{template_descriptors.shape[1]} descriptors on the template, {target_descriptors.shape[1]} on the target"
        )
    here, there = template.coefficients(template_descriptors), target.coefficients(target_descriptors)
    norm = np.maximum(np.linalg.norm(here, axis=0), 1e-12)
    here, there = here / norm, there / norm
    largest = max(float(template.values[-1]), float(target.values[-1]), 1e-12)
    gaps = (target.values[:, None] - template.values[None]) / largest
    gram, found = here @ here.T, np.empty((len(there), len(here)))
    ridge = 1e-9 * np.trace(gram) / len(gram) * np.eye(len(gram))
    for row in range(len(there)):
        found[row] = np.linalg.solve(gram + commutativity * np.diag(gaps[row] ** 2) + ridge, here @ there[row])
    return found
