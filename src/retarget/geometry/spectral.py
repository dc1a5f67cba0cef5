"""The eigenfunctions of a surface's Laplacian: its Fourier basis, the same up to sign in every pose of one body.

The Laplacian is that of the intrinsic Delaunay triangulation of the tufted cover (Sharp and Crane 2020, "A Laplacian for
Nonmanifold Triangle Meshes"), so meshes with borders, fins and faces of no area serve, and point clouds. Mass is lumped,
and area is normed to one, so eigenvalues of bodies of different size compare.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray

SHIFT = -1.0
"""Eigenvalues are sought from here: below the first one, which is nought, so that the shifted matrix is positive definite."""


@dataclass(frozen=True, eq=False)
class SpectralBasis:
    """The first eigenfunctions, the smoothest first."""

    values: Float[Array, "functions"]
    """Eigenvalues, ascending; the first is nought."""
    vectors: Float[Array, "vertices functions"]
    """Orthonormal under the masses."""
    masses: Float[Array, "vertices"]
    """Area that belongs to each vertex; their sum is one."""

    def coefficients(self, functions: Float[Array, "vertices *columns"]) -> Float[Array, "functions *columns"]:
        """Coefficients of the nearest combination of the basis, in the sense of the masses."""
        weighted = functions * self.masses.reshape((-1,) + (1,) * (functions.ndim - 1))
        return np.tensordot(self.vectors.T, weighted, axes=1)

    def smooth(self, functions: Float[Array, "vertices *columns"], count: int | None = None) -> Array:
        """That combination itself: the functions without what is finer than the first `count` of the basis."""
        part = self.first(count) if count is not None else self
        return np.tensordot(part.vectors, part.coefficients(functions), axes=1)

    def first(self, count: int) -> SpectralBasis:
        """The basis cut to its first `count` functions."""
        return SpectralBasis(self.values[:count], self.vectors[:, :count], self.masses)


def laplacian(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"] | None = None
) -> tuple[Any, Float[Array, "vertices"]]:
    """The sparse stiffness matrix (symmetric, rows sum to nought, not negative) and the lumped masses (m²) of a surface, or
    of a cloud of points where there are no faces. Every vertex must belong to a face."""
    import robust_laplacian

    if faces is None:
        stiffness, mass = robust_laplacian.point_cloud_laplacian(np.ascontiguousarray(vertices, dtype=np.float64))
    else:
        stiffness, mass = robust_laplacian.mesh_laplacian(
            np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
        )
    return stiffness.tocsc(), np.asarray(mass.diagonal())


def spectral_basis(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"] | None = None, count: int = 120
) -> SpectralBasis:
    """The first `count` eigenfunctions (at most a third of the vertices).

    Shift and invert in the standard form with lumped masses; signs are fixed by the largest entry, so that the same surface
    gives the same basis.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import LinearOperator, eigsh, splu

    stiffness, masses = laplacian(vertices, faces)
    masses = np.maximum(masses, 1e-8 * masses.mean())
    masses = masses / masses.sum()
    root = 1.0 / np.sqrt(masses)
    standard = (diags(root) @ stiffness @ diags(root)).tocsc()
    size = len(vertices)
    count = max(1, min(count, size // 3))
    shifted = (standard - SHIFT * diags(np.ones(size))).tocsc()
    solve = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
    start = np.cos(np.arange(size) * 1.7) + 0.1  # any vector that is no eigenvector; fixed, so results repeat
    values, vectors = eigsh(
        standard, k=count, sigma=SHIFT, which="LM", v0=start, OPinv=LinearOperator((size, size), matvec=solve)
    )
    order = np.argsort(values)
    vectors = vectors[:, order] * root[:, None]
    sign = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(count)])
    return SpectralBasis(np.maximum(values[order], 0.0), vectors * sign, masses)
