"""The Laplacian's laws, and eigenfunctions that are known."""

import numpy as np
import pytest
from made_bodies import sphere

from retarget.body.human import human
from retarget.geometry.resample import Surface, decimate
from retarget.geometry.spectral import laplacian, spectral_basis


@pytest.fixture(scope="module")
def body():
    mesh = human().mesh
    return decimate(Surface(mesh.vertices, mesh.faces), 2500)


@pytest.mark.parametrize("cloud", [False, True])
def test_symmetric_with_rows_of_nought_and_not_negative(body, cloud):
    stiffness, masses = laplacian(body.vertices, None if cloud else body.faces)
    assert abs(stiffness - stiffness.T).max() < 1e-9
    assert np.abs(stiffness.sum(axis=1)).max() < 1e-8
    function = np.random.default_rng(0).normal(size=len(body))
    assert function @ (stiffness @ function) >= 0
    assert masses.min() >= 0


def test_the_ball_has_its_known_eigenvalues():
    ball = sphere()
    found = spectral_basis(ball.vertices, ball.faces, 16).values / (4 * np.pi)  # area is normed to one
    assert found[0] == pytest.approx(0, abs=1e-6)
    assert found[1:4] == pytest.approx(2, rel=0.02)
    assert found[4:9] == pytest.approx(6, rel=0.02)
    assert found[9:16] == pytest.approx(12, rel=0.03)


def test_orthonormal_under_the_masses_and_the_same_twice(body):
    one, two = (spectral_basis(body.vertices, body.faces, 40) for _ in range(2))
    assert np.allclose(one.coefficients(one.vectors), np.eye(40), atol=1e-8)
    assert np.array_equal(one.vectors, two.vectors)
    assert one.masses.sum() == pytest.approx(1)


def test_size_and_place_do_not_matter(body):
    one = spectral_basis(body.vertices, body.faces, 10).values
    other = spectral_basis(body.vertices * 1000 + 7, body.faces, 10).values
    assert np.allclose(one, other, rtol=1e-6, atol=1e-6)


def test_smoothing_keeps_the_smooth_and_loses_the_rough(body):
    basis = spectral_basis(body.vertices, body.faces, 60)
    assert np.allclose(basis.smooth(basis.vectors[:, 5]), basis.vectors[:, 5], atol=1e-8)
    noise = np.random.default_rng(1).normal(size=len(body))
    assert np.linalg.norm(basis.smooth(noise)) < 0.3 * np.linalg.norm(noise)
    assert np.allclose(basis.smooth(basis.vectors[:, 30], 20), 0, atol=1e-8)


def test_fins_and_rims_serve():
    ball = sphere(3)
    fin = np.array([[0, 6, len(ball)]])
    vertices = np.concatenate([ball.vertices, [[2.0, 2.0, 0.0]]])
    found = spectral_basis(vertices, np.concatenate([ball.faces[40:], fin]), 12)
    assert np.isfinite(found.vectors).all() and (np.diff(found.values) >= -1e-9).all()
