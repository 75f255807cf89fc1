"""Spectra and autoregressive priors against closed forms and dense covariances."""

import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import NUGGET, Matern, Spectrum, TabulatedPsd, Tone, autoregressive
from sightline.estimation.search import ORDER

STEP = 1e-3
SPECTRUM = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 0.005, "3/2"), Tone(0.3, 47.0, 0.8)))


def dense(band: np.ndarray) -> np.ndarray:
    """The symmetric matrix of a lower band."""
    n = band.shape[1]
    lower = sum(np.diag(band[d, : n - d], -d) for d in range(min(len(band), n)))
    return lower + np.tril(lower, -1).T


@pytest.mark.parametrize(
    "component",
    [
        Matern(2.0, 0.05, "5/2"),
        Matern(0.7, 0.01, "3/2"),
        Matern(0.7, 0.03, "9/2"),
        Matern(0.7, 0.05, "17/2"),
        Tone(0.3, 12.0, 2.0),
    ],
    ids=repr,
)
def test_the_one_sided_psd_is_the_cosine_transform_of_the_autocovariance(component: Matern | Tone) -> None:
    # Lags to 4 s (all parts have decayed below 1e-11) in steps of 20 us: the trapezium of the kink at
    # lag 0 errs by step^2 / 6 times the slope, below 1e-8 of the variance per Hz.
    lags = np.linspace(0.0, 4.0, 200_001)
    covariance = component.autocovariance(lags)
    for f in (0.0, 3.0, 12.0, 40.0):
        expected = 4.0 * np.trapezoid(covariance * np.cos(2.0 * np.pi * f * lags), lags)
        assert float(component.psd(np.array([f]))[0]) == pytest.approx(expected, abs=2e-8)


def test_the_corner_of_a_matern_is_where_its_spectrum_turns() -> None:
    part = Matern(1.0, 0.01, "3/2")
    # (1 + (f / corner)^2)^-2 is a quarter at the corner.
    ratio = part.psd(np.array([part.corner])) / part.psd(np.array([0.0]))
    assert float(ratio[0]) == pytest.approx(0.25)


def test_a_spectrum_is_the_sum_of_its_parts_and_scales_with_the_unit() -> None:
    assert SPECTRUM.sigma == pytest.approx(np.sqrt(4.0 + 0.01 + 0.09))
    twice = SPECTRUM.scaled(2.0)
    lags = np.array([0.0, 0.01, 0.3])
    np.testing.assert_allclose(twice.autocovariance(lags), 4.0 * SPECTRUM.autocovariance(lags))
    assert [tone.frequency for tone in twice.tones] == [47.0]


@pytest.mark.parametrize("order", [0, 1, 7, 59])
def test_the_precision_keeps_the_covariance_of_neighbours_from_the_first_epoch_on(order: int) -> None:
    # AR(p) keeps lags 0..p. The first p + 1 epochs are exact by the start-up rows; the inverse of a matrix
    # of condition ~1e6 is good to 1e-9 of the variance 4.
    n = 60
    precision = dense(SPECTRUM.autoregressive(STEP, order, n).precision_band())
    covariance = toeplitz(SPECTRUM.autocovariance(STEP * np.arange(n)))
    head = slice(0, order + 1)
    np.testing.assert_allclose(np.linalg.inv(precision)[head, head], covariance[head, head], atol=1e-8)


def test_at_full_order_determinant_and_density_are_those_of_the_dense_process() -> None:
    n = 60
    process = SPECTRUM.autoregressive(STEP, n - 1, n)
    covariance = toeplitz(SPECTRUM.autocovariance(STEP * np.arange(n))) + NUGGET * SPECTRUM.sigma**2 * np.eye(
        n
    )
    assert process.logdet == pytest.approx(-np.linalg.slogdet(covariance)[1], abs=1e-5)
    x = np.linalg.cholesky(covariance) @ np.random.default_rng(0).normal(size=n)
    assert np.sum(process.innovations(x) ** 2) == pytest.approx(x @ np.linalg.solve(covariance, x), rel=1e-6)


def test_a_short_process_and_a_long_one_share_their_inner_columns() -> None:
    process = SPECTRUM.autoregressive(STEP, 5, 200)
    fast = process.precision_band()
    np.testing.assert_allclose(fast, process.precision_band(np.ones(200)), rtol=1e-12, atol=1e-9 * fast.max())


def test_a_row_weight_near_zero_lets_the_motion_jump_there() -> None:
    process = SPECTRUM.autoregressive(STEP, 5, 40)
    weights = np.ones(40)
    weights[20] = 1e-6
    free = dense(process.precision_band(weights))
    row = np.linalg.inv(free)
    plain = np.linalg.inv(dense(process.precision_band()))
    step, usual = np.zeros(40), np.zeros(40)
    step[[19, 20]] = usual[[9, 10]] = -1.0, 1.0
    # The innovation at epoch 20 has 1e6 times its variance; elsewhere nothing changes.
    assert step @ row @ step == pytest.approx(1e6 * process.variance, rel=0.05)
    assert usual @ row @ usual == pytest.approx(usual @ plain @ usual, rel=1e-5)


def test_innovations_of_the_process_are_white() -> None:
    n = 4000
    process = SPECTRUM.autoregressive(STEP, 30, n)
    rng = np.random.default_rng(1)
    e = rng.normal(size=n) * np.sqrt(process.variances)
    x = np.zeros(n)
    for t in range(n):
        past = x[max(0, t - process.order) : t][::-1]
        row = process.startup[t, :t] if t < process.order else process.coefficients
        x[t] = row[: len(past)] @ past + e[t]
    np.testing.assert_allclose(process.innovations(x), e / np.sqrt(process.variances), atol=1e-9)


def test_a_drift_so_smooth_that_floats_cannot_tell_still_has_a_precision() -> None:
    drift = Spectrum((Matern(2.0, 100.0, "5/2"),))
    process = drift.autoregressive(1e-4, 40, 500)
    assert np.isfinite(process.precision_band()).all()
    assert process.variance >= 0.9 * NUGGET * 4.0


def test_the_order_is_cut_to_the_length() -> None:
    assert SPECTRUM.autoregressive(STEP, 40, 10).order == 9
    assert autoregressive([1.0], 0, 1).precision_band().shape == (1, 1)


@pytest.mark.parametrize("lag", [0.012, 0.02, 0.04, 0.06])
def test_an_autoregression_looks_back_far_enough_for_lags_of_fast_lines(lag: float) -> None:
    # by closed forms: of a second difference over 60 ms one that looks back 16 ms made 1.96 times
    # the variance. A quarter is an eighth in sigma, as much as a strip's own sigma is known to.
    step, count = 2e-4, 800
    tones = (Tone(0.3, 47.0, 1e-3), Tone(0.15, 83.0, 1e-3), Tone(0.08, 121.0, 1e-3))
    spectrum = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 0.0092, "3/2"), *tones))
    nodes = round(lag / step)
    weights = np.zeros(count)
    weights[[0, nodes, 2 * nodes]] = 1.0, -2.0, 1.0
    zero, one, two = spectrum.autocovariance(step * np.array([0.0, nodes, 2.0 * nodes]))
    variance = spectrum.autoregressive(step, ORDER, count).variance_of(weights)
    assert variance == pytest.approx(6.0 * zero - 8.0 * one + 2.0 * two, rel=0.25)


def test_wrong_values_are_named() -> None:
    with pytest.raises(InputError, match="`sigma` must be a positive number"):
        Matern(0.0, 1.0)
    with pytest.raises(InputError, match="one of 3/2, 5/2"):
        Matern(1.0, 1.0, "1/2")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="`bandwidth`"):
        Tone(1.0, 2.0, float("nan"))
    with pytest.raises(InputError, match="at least one component"):
        Spectrum(())
    with pytest.raises(EstimationError, match="no stationary process"):
        autoregressive([1.0, 2.0], 1, 5)
    with pytest.raises(InputError, match="must hold 4 finite lags"):
        autoregressive([1.0, 0.5], 3, 5)
    with pytest.raises(InputError, match="positive finite numbers"):
        SPECTRUM.autoregressive(STEP, 3, 9).precision_band(np.zeros(9))


class TestTabulatedPsd:
    def test_its_autocovariance_is_the_cosine_transform_of_its_straight_pieces(self):
        part = TabulatedPsd((0.0, 3.0, 10.0, 40.0), (2.0, 0.5, 1.0, 0.0))
        f = np.linspace(0.0, 40.0, 400_001)
        for lag in (0.0, 1e-4, 0.003, 0.1, 2.0):
            expected = np.trapezoid(part.psd(f) * np.cos(2 * np.pi * f * lag), f)
            # the trapezoidal rule with 0.1 mHz steps: relative (2 pi lag df)^2 / 12 of the variance of 27
            assert float(part.autocovariance(np.array([lag]))[0]) == pytest.approx(expected, abs=1e-5)

    def test_nothing_is_outside_the_table(self):
        part = TabulatedPsd((5.0, 10.0), (1.0, 1.0))
        assert part.psd(np.array([0.0, 4.9, 7.0, 10.1])).tolist() == [0.0, 0.0, 1.0, 0.0]
        assert part.sigma == pytest.approx(5.0**0.5)

    def test_a_change_of_unit_scales_the_density_by_its_square(self):
        spectrum = Spectrum((TabulatedPsd((0.0, 10.0), (0.4, 0.4)),))
        assert spectrum.scaled(3.0).sigma == pytest.approx(6.0)

    def test_a_prior_of_a_band_lets_no_other_frequency_pass(self):
        # flat to 40 Hz on a grid of 500 Hz: a motion of 20 Hz is likely, one of 100 Hz is not
        prior = Spectrum((TabulatedPsd((0.0, 40.0), (1.0, 1.0)),)).autoregressive(2e-3, 60, 500)
        t = 2e-3 * np.arange(500)
        inside, outside = (prior.innovations(np.sin(2 * np.pi * f * t)) for f in (20.0, 100.0))
        assert np.mean(outside[60:] ** 2) > 1e4 * np.mean(inside[60:] ** 2)

    @pytest.mark.parametrize(
        ("frequency", "density", "words"),
        [
            ((0.0,), (1.0,), "two or more"),
            ((0.0, 1.0), (1.0,), "two or more"),
            ((1.0, 1.0), (1.0, 1.0), "must increase"),
            ((-1.0, 1.0), (1.0, 1.0), "must increase"),
            ((0.0, 1.0), (1.0, -1.0), "0 or more"),
            ((0.0, 1.0), (0.0, 0.0), "positive somewhere"),
        ],
    )
    def test_what_is_no_spectrum_is_refused(self, frequency, density, words):
        with pytest.raises(InputError, match=words):
            TabulatedPsd(frequency, density)
