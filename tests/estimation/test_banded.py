"""Banded and bordered factors against dense linear algebra."""

import numpy as np
import pytest

from sightline.errors import EstimationError, InputError
from sightline.estimation.banded import BandedFactor, BorderedFactor, band_times

CASES = [
    (50, 3, 5),
    (50, 3, 2),
    (200, 70, 70),
    (30, 29, 29),
    (7, 0, 3),
    (40, 1, 0),
    (300, 150, 12),
    (1, 0, 0),
]


def banded_matrix(n: int, b: int) -> np.ndarray:
    """A diagonally dominant symmetric matrix with b subdiagonals (well conditioned, so 1e-12 is tight)."""
    rng = np.random.default_rng(n + b)
    matrix = np.tril(np.triu(rng.uniform(-1.0, 1.0, (n, n)), -b), -1)
    return matrix + matrix.T + np.diag(2.0 * b + 1.0 + rng.random(n))


def band_of(matrix: np.ndarray, width: int) -> np.ndarray:
    """Lower band storage of a dense matrix."""
    n = len(matrix)
    band = np.zeros((width + 1, n))
    for d in range(min(width, n - 1) + 1):
        band[d, : n - d] = np.diag(matrix, -d)
    return band


@pytest.mark.parametrize(("n", "b", "width"), CASES)
def test_the_band_of_the_inverse_is_that_of_the_dense_inverse(n: int, b: int, width: int) -> None:
    matrix = banded_matrix(n, b)
    factor = BandedFactor(band_of(matrix, b))
    expected = band_of(np.linalg.inv(matrix), width)
    np.testing.assert_allclose(factor.inverse_band(width), expected, atol=1e-13)


@pytest.mark.parametrize(("n", "b", "width"), CASES)
def test_what_lies_in_the_unused_tails_of_the_storage_does_not_matter(n: int, b: int, width: int) -> None:
    band = band_of(banded_matrix(n, b), b)
    clean = BandedFactor(band)
    for d in range(1, b + 1):
        band[d, n - d :] = 123.0
    dirty = BandedFactor(band)
    np.testing.assert_array_equal(dirty.inverse_band(width), clean.inverse_band(width))
    assert dirty.logdet == clean.logdet


def test_solutions_and_determinant_are_those_of_the_dense_matrix() -> None:
    matrix = banded_matrix(60, 7)
    factor = BandedFactor(band_of(matrix, 7))
    rhs = np.random.default_rng(0).normal(size=(60, 3))
    np.testing.assert_allclose(factor.solve(rhs), np.linalg.solve(matrix, rhs), atol=1e-13)
    np.testing.assert_allclose(factor.solve(rhs[:, 0]), np.linalg.solve(matrix, rhs[:, 0]), atol=1e-13)
    assert factor.logdet == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-12)


@pytest.mark.parametrize(("n", "b", "width"), CASES)
@pytest.mark.parametrize("columns", [1, 2, 3, 13])
def test_products_and_solutions_of_any_number_of_columns_are_those_of_the_dense_matrix(
    n: int, b: int, width: int, columns: int
) -> None:
    matrix = banded_matrix(n, b)
    x = np.random.default_rng(columns).normal(size=(n, columns))
    band = band_of(matrix, b)
    # entries up to 2 b + 2, so products of about that size: rounding of 300 terms stays below 1e-14 of it
    np.testing.assert_allclose(band_times(band, x), matrix @ x, atol=1e-14 * (2 * b + 2) * 10)
    np.testing.assert_allclose(band_times(band, x[:, 0]), matrix @ x[:, 0], atol=1e-14 * (2 * b + 2) * 10)
    np.testing.assert_allclose(BandedFactor(band).solve(x), np.linalg.solve(matrix, x), atol=1e-13)


def bordered(q: int) -> tuple[np.ndarray, BorderedFactor]:
    """A full matrix and its bordered factor; border unknowns in very different units."""
    rng = np.random.default_rng(q)
    n = 80
    unit = 10.0 ** np.linspace(-6.0, 6.0, q) if q else np.zeros(0)
    a, b = banded_matrix(n, 9), rng.normal(size=(n, q)) * unit
    d = b.T @ np.linalg.solve(a, b) + np.diag(unit**2) if q else np.zeros((0, 0))
    return np.block([[a, b], [b.T, d]]), BorderedFactor(band_of(a, 9), b, d)


@pytest.mark.parametrize("at_once", [7, 1000])
@pytest.mark.parametrize("q", [0, 1, 4])
def test_a_bordered_system_is_solved_like_the_full_one(q: int, at_once: int, monkeypatch) -> None:
    monkeypatch.setattr("sightline.estimation.banded.ROWS_AT_ONCE", at_once)
    full, factor = bordered(q)
    inverse = np.linalg.inv(full)
    rng = np.random.default_rng(5)
    b, d = rng.normal(size=(80, 2)), np.zeros((q, 2))
    x, y = factor.solve(b, d)
    np.testing.assert_allclose(x, inverse[:80, :80] @ b, atol=1e-11)
    np.testing.assert_allclose(y, inverse[80:, :80] @ b, rtol=1e-6, atol=1e-9 * np.abs(y).max(initial=1e-300))
    top, bottom = factor.times(b)
    np.testing.assert_array_equal(top, x)
    np.testing.assert_array_equal(bottom, y)
    assert factor.logdet == pytest.approx(np.linalg.slogdet(full)[1], rel=1e-9)


@pytest.mark.parametrize("at_once", [7, 1000])
@pytest.mark.parametrize("q", [0, 1, 4])
def test_the_covariance_of_a_bordered_system_owns_the_border(q: int, at_once: int, monkeypatch) -> None:
    monkeypatch.setattr("sightline.estimation.banded.ROWS_AT_ONCE", at_once)
    full, factor = bordered(q)
    inverse = np.linalg.inv(full)
    np.testing.assert_allclose(factor.covariance_band(12), band_of(inverse[:80, :80], 12), atol=1e-11)
    scale = np.sqrt(np.diag(inverse)[80:])
    units = np.outer(scale, scale)
    np.testing.assert_allclose(factor.border_covariance / units, inverse[80:, 80:] / units, atol=1e-8)


def test_a_matrix_that_is_not_positive_definite_is_refused_with_advice() -> None:
    with pytest.raises(EstimationError, match="give every unknown a prior or a measurement"):
        BandedFactor(np.array([[1.0, 1.0], [2.0, 0.0]]))


def test_constants_that_nothing_determines_are_refused_with_advice() -> None:
    with pytest.raises(EstimationError, match="give each a finite prior sigma"):
        BorderedFactor(np.ones((1, 3)), np.ones((3, 1)), np.array([[1.0]]))


def test_wrong_shapes_and_values_are_named() -> None:
    with pytest.raises(InputError, match="shape"):
        BandedFactor(np.ones(3))
    with pytest.raises(InputError, match="not finite"):
        BandedFactor(np.array([[1.0, np.nan]]))
    with pytest.raises(InputError, match=r"n = 3"):
        BorderedFactor(np.ones((1, 3)), np.ones((2, 1)), np.ones((1, 1)))
    with pytest.raises(InputError, match="0 or more"):
        BandedFactor(np.ones((1, 3))).inverse_band(-1)
