import numpy as np
import pytest

from sightline.errors import EstimationError, InputError
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.polynomial import fit_polynomial, polynomial


def curve(t):
    return np.stack([1e-4 * t - 3e-5 * t**3, 2e-5 * t**2, 5e-5 * t**5 - 1e-5 * t], axis=1)


def exact_differences(t, lag, sigma=1e-6):
    covariance = np.tile(sigma**2 * np.eye(3), (len(t), 1, 1))
    return AngleDifferences(t, lag, curve(t + lag) - curve(t), covariance)


def test_a_polynomial_motion_is_recovered_from_uneven_times_and_lags():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, 1.0, 60))
    motion = polynomial([exact_differences(t, rng.uniform(0.1, 0.3, 60))], np.linspace(0.0, 1.2, 50))
    truth = curve(motion.t)
    assert motion.angles - motion.angles.mean(axis=0) == pytest.approx(truth - truth.mean(axis=0), abs=1e-13)


def test_its_sigma_is_the_closed_form_of_figure_14():
    from sightline.motion.observability import polynomial_gain

    t, at = np.linspace(0.0, 1.0, 101), np.linspace(0.0, 1.2, 30)
    pair = exact_differences(t, np.full(101, 0.2))
    motion = polynomial([pair], at)
    expected = 1e-6 * polynomial_gain(at, t, 0.2)
    for axis in range(3):
        assert np.sqrt(motion.covariance[:, axis, axis]) == pytest.approx(expected, rel=1e-6)


def test_errors_are_within_sigma_when_axes_are_correlated_and_weights_differ():
    rng = np.random.default_rng(1)
    t, at = np.linspace(0.0, 1.0, 40), np.linspace(0.0, 1.2, 15)
    a = rng.standard_normal((40, 3, 3))
    covariance = 1e-12 * (a @ a.transpose(0, 2, 1) + 0.2 * np.eye(3))
    root = np.linalg.cholesky(covariance)
    truth = curve(at) - curve(at).mean(axis=0)
    distances = []
    for _ in range(200):
        noise = np.einsum("nij,nj->ni", root, rng.standard_normal((40, 3)))
        pair = AngleDifferences(t, 0.2, curve(t + 0.2) - curve(t) + noise, covariance)
        fit = fit_polynomial([pair])
        error = fit.angles(at) - fit.angles(at).mean(axis=0) - truth
        distances.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(fit.relative_covariance(at)), error))
    # Each epoch's squared distance has mean 3, sd sqrt(6); 200 draws: 3 +- 0.17; 15 epochs, so 4 sd.
    assert np.mean(distances, axis=0) == pytest.approx(3.0, abs=0.7)


def test_jitter_that_no_polynomial_explains_enters_the_sigma():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 1.0, 1e-3)
    tone = 3e-6 * np.sqrt(2.0)
    at = np.concatenate([t, t + 0.0105])
    jitter = tone * np.sin(2 * np.pi * 47.0 * at)[:, None] * np.ones(3)
    values = jitter[1000:] - jitter[:1000] + 1e-7 * rng.standard_normal((1000, 3))
    pair = AngleDifferences(t, 0.0105, values, np.tile(1e-14 * np.eye(3), (1000, 1, 1)))
    sigma = np.sqrt(polynomial([pair], t[10:]).covariance[:, 0, 0])
    # 47 Hz and 10.5 ms: almost opposite phases, so half of |G|^2 = 3.99 parts.
    assert np.median(sigma) == pytest.approx(3e-6 * np.sqrt(2.0), rel=0.05)


def test_too_few_differences_are_refused_with_the_number_needed():
    with pytest.raises(EstimationError, match="cannot be fitted to 3 differences; at least 5 are needed"):
        fit_polynomial([exact_differences(np.array([0.0, 0.1, 0.2]), 0.1)])


def test_a_single_pair_outside_a_list_is_refused_with_the_remedy():
    with pytest.raises(InputError, match="put the single one in a list"):
        fit_polynomial(exact_differences(np.linspace(0, 1, 20), 0.1))


def test_no_difference_at_all_is_refused():
    with pytest.raises(EstimationError, match="no angle differences at all"):
        polynomial([], np.linspace(0.0, 1.0, 5))
