"""The solver agrees with the dense one, and says what it cannot factor."""

import numpy as np
import pytest
from made_bodies import sphere
from scipy import sparse

from retarget.errors import RetargetError
from retarget.geometry.cholesky import factor
from retarget.geometry.spectral import laplacian


@pytest.fixture(scope="module")
def matrix():
    ball = sphere()
    stiffness, masses = laplacian(ball.vertices, ball.faces)
    return (stiffness + sparse.diags(masses)).tocsc()


@pytest.mark.parametrize("layout", ["csc", "csr", "coo"])
def test_agrees_with_a_dense_solution(matrix, layout):
    rhs = np.random.default_rng(0).normal(size=(matrix.shape[0], 7))
    expected = np.linalg.solve(matrix.toarray(), rhs)
    assert np.abs(factor(matrix.asformat(layout)).solve(rhs) - expected).max() < 1e-10 * np.abs(expected).max()


def test_columns_do_not_depend_on_each_other_or_on_how_they_lie_in_memory(matrix):
    prepared = factor(matrix)
    rhs = np.random.default_rng(0).normal(size=(matrix.shape[0], 300))
    kept = rhs.copy()
    whole = prepared.solve(rhs)
    assert np.array_equal(rhs, kept)
    assert np.allclose(prepared.solve(np.asfortranarray(rhs)), whole, rtol=0, atol=1e-12)
    assert np.allclose(prepared.solve(rhs[:, 5]), whole[:, 5], rtol=0, atol=1e-12)
    assert np.allclose(prepared.solve(rhs[:, ::7]), whole[:, ::7], rtol=0, atol=1e-12)
    assert np.array_equal(factor(matrix).solve(rhs), whole)
    rhs[3, 4] = np.nan
    assert np.isfinite(np.delete(prepared.solve(rhs), 4, axis=1)).all()


def test_entries_given_twice_add_up_and_no_rows_is_no_fault():
    twice = sparse.coo_matrix(([1.0, 1.0, 3.0], ([0, 0, 1], [0, 0, 1])), shape=(2, 2))
    assert factor(twice).solve(np.ones((2, 1)))[:, 0] == pytest.approx([1 / 2, 1 / 3])
    assert factor(sparse.csc_matrix((0, 0))).solve(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize(
    "entries, words",
    [
        (np.ones((2, 3)), "square matrix .* 2 x 3"),
        ([[1.0, np.nan], [np.nan, 1.0]], "2 of the matrix's 4 entries are not finite"),
        ([[2.0, 0.5], [0.0, 2.0]], "not symmetric"),
        ([[1.0, 0.0], [0.0, 0.0]], "diagonal is 0 in row 1"),
        ([[1.0, 2.0], [2.0, 1.0]], "2 x 2 matrix is not positive definite"),
    ],
)
def test_what_has_no_factor_is_refused(entries, words):
    with pytest.raises(RetargetError, match=words):
        factor(sparse.csc_matrix(entries))


def test_a_right_hand_side_of_other_length_is_refused(matrix):
    with pytest.raises(RetargetError, match="has 3 rows, the factored matrix"):
        factor(matrix).solve(np.zeros((3, 1)))
