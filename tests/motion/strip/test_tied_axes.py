"""One likelihood of three axes: against a dense Gaussian, its slope, and jitter that no axis shows alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz

from sightline.estimation.banded_blocks import StoredBand
from sightline.estimation.evidence import EvenRate
from sightline.estimation.prior import NUGGET, Matern, Spectrum, Tone
from sightline.motion.strip.joint import JointPrior
from sightline.motion.strip.normal_equations import NormalEquations, TimeGrid
from sightline.motion.strip.tied_axes import TiedEvidence, _within, fit_tied

STEP = 0.004
SPECTRA = (
    Spectrum((Matern(2.0, 0.1, "5/2"), Matern(0.1, 0.01, "3/2"))),
    Spectrum((Matern(1.0, 0.2, "5/2"), Matern(0.2, 0.02, "3/2"), Tone(0.3, 30.0, 2.0))),
    Spectrum((Matern(3.0, 0.1, "5/2"), Matern(0.1, 0.02, "3/2"))),
)
FREE = (EvenRate(0.0, False, 1e6),) * 3


def equations(rows, beside, y):
    """Normal equations of rows (R, 3n) of the motion and (R, Q) of static parameters, of unit noise."""
    n = rows.shape[1]
    whole = rows.T @ rows
    width = max(k for k in range(n) if np.diag(whole, k).any())
    ab = StoredBand(width, n)
    ab.add(0, np.stack([np.append(np.diag(whole, k), np.zeros(k)) for k in range(width + 1)]))
    return NormalEquations(
        TimeGrid(0.0, STEP, n // 3), 3, ab, rows.T @ beside, beside.T @ beside, rows.T @ y, beside.T @ y,
        float(y @ y), len(y),
    )  # fmt: skip


def evidence_of(data, order, rates=FREE, statics=(), loose=None):
    process = SPECTRA[0].autoregressive(STEP, order, data.grid.count)
    prior = JointPrior((process,) * 3, np.array(statics), innovation_weights=loose)
    return TiedEvidence(data, prior, order, rates)


def some_rows(count, lag, lever, rng):
    """Differences over `lag` nodes of roll and yaw on a lever, of pitch, and of yaw, badly."""
    rows = np.zeros((3 * (count - lag), 3 * count))
    for k in range(count - lag):
        for node, sign in ((k, -1.0), (k + lag, 1.0)):
            here = rows[3 * k : 3 * k + 3, 3 * node : 3 * node + 3]
            here += sign * np.array([[1.0, 0.0, lever], [0.0, 1.0, 0.0], [0.0, 0.0, 0.05]])
    return rows, rng.standard_normal((len(rows), 2))


def test_it_is_the_likelihood_of_the_measurements_given_the_rates():
    rng, count, sigma = np.random.default_rng(0), 24, (2.0, 3.0)
    rows, beside = some_rows(count, 5, 0.6, rng)
    y = rng.standard_normal(len(rows))
    rates = (EvenRate(0.5, False, 2.0), EvenRate(1.0, True, 0.5), EvenRate(-3.0, False, 40.0))
    # a node for every lag: the autoregression is the process itself
    found = evidence_of(equations(rows, beside, y), count - 1, rates, sigma)

    t = STEP * np.arange(count)
    weights = (t - t.mean()) / np.sum((t - t.mean()) ** 2)

    def dense(spectra):
        """-2 log density of matches and rates, less that of the rates that were not seen."""
        motion = np.zeros((3 * count, 3 * count))
        ends = np.zeros((3, 3 * count))
        for axis, one in enumerate(spectra):
            k = one.autocovariance(t)
            motion[axis::3, axis::3] = toeplitz(np.append(k[0] * (1.0 + NUGGET), k[1:]))
            ends[axis, axis::3] = weights
        seen = np.concatenate([rows, ends])
        variance = seen @ motion @ seen.T
        variance[: len(rows), : len(rows)] += np.eye(len(rows)) + (beside * np.square(sigma)) @ beside.T
        of_rates = np.array([rate.sigma**2 for rate in rates])
        variance[len(rows) :, len(rows) :] += np.diag(of_rates)
        value = np.concatenate([y, [rate.value for rate in rates]])
        out = value @ np.linalg.solve(variance, value) + np.linalg.slogdet(variance)[1]
        for k, rate in enumerate(rates):
            own = variance[len(rows) + k, len(rows) + k]
            out -= 0.0 if rate.seen else rate.value**2 / own + np.log(own)
        return out

    other = tuple(one.scaled(size) for one, size in zip(SPECTRA, (0.3, 2.0, 0.5), strict=True))
    # of precisions of condition 1e8
    assert found.deviance(other) - found.deviance(SPECTRA) == pytest.approx(
        dense(other) - dense(SPECTRA), abs=1e-4
    )


@pytest.mark.parametrize("jumps", [False, True])
def test_its_slope_is_that_of_its_value(jumps):
    rng, count = np.random.default_rng(1), 60
    rows, beside = some_rows(count, 7, 0.6, rng)
    loose = None
    if jumps:
        loose = np.ones((count, 3))
        loose[[30, 41], [0, 2]] = 0.05
    data = equations(rows, beside, 3.0 * rng.standard_normal(len(rows)))
    rates = (EvenRate(2.0, False, 2.0), EvenRate(1.0, True, 0.5), EvenRate(-3.0, False, 40.0))
    found = evidence_of(data, 12, rates, (2.0, 3.0), loose)
    value, slopes = found.value_and_slope(SPECTRA, (0, 1, 2))
    assert value == pytest.approx(found.deviance(SPECTRA))
    lags = STEP * np.arange(13.0)
    for axis, by_lag in slopes.items():

        def moved(factor, axis=axis):
            spectra = list(SPECTRA)
            spectra[axis] = spectra[axis].scaled(factor)
            return spectra

        more, less = (found.deviance(moved(np.exp(step))) for step in (1e-4, -1e-4))
        # all autocovariances go with the square of the size
        assert 2.0 * by_lag @ SPECTRA[axis].autocovariance(lags) == pytest.approx(
            (more - less) / 2e-4, rel=1e-4
        )


#: Spectra of the motion of `jitter_in_noise`, and with a broadband part of another size (px) and time (s).
JITTER = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 0.0092, "3/2")))


def broadband(sigma, timescale=0.0092):
    return Spectrum((JITTER.components[0], Matern(sigma, timescale, "3/2")))


def jitter_in_noise(tone=0.0):
    """Of rows that tell roll and yaw together to .016 px, apart to .24 and .43; they shake by .1 px.

    And roll by a tone (px) of 30 Hz.
    """
    rng, count, lag = np.random.default_rng(2), 300, 35
    t = STEP * np.arange(count)
    apart = np.abs(np.subtract.outer(t, t))
    jitter, drift = np.sqrt(3.0) * apart / 0.0092, np.sqrt(5.0) * apart
    covariance = 0.1**2 * (1.0 + jitter) * np.exp(-jitter)
    covariance += 2.0**2 * (1.0 + drift + drift**2 / 3.0) * np.exp(-drift)
    motion = np.linalg.cholesky(covariance + 1e-8 * np.eye(count)) @ rng.standard_normal((count, 3))
    motion[:, 0] += np.sqrt(2.0) * tone * np.sin(2.0 * np.pi * 30.0 * t)
    lever = np.array([0.24, 0.0, -0.43])
    variance = np.outer(lever, lever) + 0.016**2 * np.eye(3)
    whiten = np.linalg.inv(np.linalg.cholesky(variance))
    change = np.zeros((count - lag, count))
    change[np.arange(count - lag), np.arange(count - lag)] = -1.0
    change[np.arange(count - lag), np.arange(count - lag) + lag] = 1.0
    rows = np.einsum("rn,ab->ranb", change, whiten).reshape(3 * (count - lag), 3 * count)
    y = (rows @ motion.ravel()) + rng.standard_normal(len(rows))
    return evidence_of(equations(rows, np.zeros((len(y), 0)), y), 40)


def test_jitter_that_rows_tell_of_two_axes_together_is_shared_by_both():
    none = broadband(0.006)
    spectra = fit_tied(jitter_in_noise(), [(none, JITTER, none)], (0, 2), (JITTER,) * 3)
    assert spectra[1] is JITTER
    roll, yaw = spectra[0].components[1].sigma, spectra[2].components[1].sigma
    # the sum is known to a sixth of its jitter in each of 265 rows, of which some fifty are independent: to a
    # tenth, three of these; how it is shared is left to what is usual
    assert np.hypot(roll * 0.43, yaw * 0.24) == pytest.approx(0.1 * np.hypot(0.43, 0.24), rel=0.3)
    assert 0.03 < roll < 0.2 and 0.03 < yaw < 0.2


def test_noise_that_an_axis_alone_took_for_jitter_is_none_to_both_and_none_gets_louder():
    found = jitter_in_noise()
    # as loud as the noise of a row, up to all frequencies
    white = broadband(0.4, 0.0008)
    for louder in (True, False):
        spectra = fit_tied(found, [(white, JITTER, white)], (0, 2), (JITTER,) * 3, louder=louder)
        roll, yaw = (one.components[1].sigma for one in (spectra[0], spectra[2]))
        # as well known as in the test before
        assert np.hypot(roll * 0.43, yaw * 0.24) == pytest.approx(0.1 * np.hypot(0.43, 0.24), rel=0.3)
        # at half the rate of the rows it began with 370 times the truth
        for one in (spectra[0], spectra[2]):
            assert one.psd(np.array([125.0])) < 0.1 * white.psd(np.array([125.0]))
    none = broadband(0.006)
    spectra = fit_tied(found, [(none, JITTER, none)], (0, 2), (JITTER,) * 3, louder=False)
    for one in (spectra[0], spectra[2]):
        assert one.components[1].sigma <= 0.006 * (1.0 + 1e-9)
        assert one.components[1].timescale >= 0.0092 * (1.0 - 1e-9)


def test_a_tone_comes_to_where_both_axes_together_show_it():
    off = Spectrum((*JITTER.components, Tone(0.2, 30.3, 0.1)))
    found = fit_tied(jitter_in_noise(0.2), [(off, JITTER, JITTER)], (0, 2), (JITTER,) * 3)
    # over 1.2 s, sqrt(6) / (pi T) times jitter over amplitude, over the root of some fifty independent rows:
    # .03 Hz, three of these
    assert found[0].tones[0].frequency == pytest.approx(30.0, abs=0.1)
    # it is told from the edge of how far a tone may stray
    assert off.tones[0].frequency - 0.5 / 1.2 < 29.9


def test_the_search_begins_with_the_best_of_some():
    rng, count = np.random.default_rng(3), 60
    rows, beside = some_rows(count, 7, 0.6, rng)
    found = evidence_of(equations(rows, beside[:, :0], 0.1 * rng.standard_normal(len(rows))), 12)
    far = tuple(one.scaled(100.0) for one in SPECTRA)
    assert found.deviance(SPECTRA) < found.deviance(far)
    both, alone = (fit_tied(found, begins, (0, 2), SPECTRA) for begins in ((far, SPECTRA), (SPECTRA,)))
    assert both == alone


def test_rows_beyond_the_memory_do_not_matter_for_weights_of_jumps():
    loose = np.ones((60, 3))
    rng = np.random.default_rng(4)
    rows, beside = some_rows(60, 7, 0.6, rng)
    plain = evidence_of(equations(rows, beside, rng.standard_normal(len(rows))), 12, statics=(1.0, 1.0))
    same = replace(plain, prior=replace(plain.prior, innovation_weights=loose))
    assert_allclose(same.value_and_slope(SPECTRA, (0,))[1][0], plain.value_and_slope(SPECTRA, (0,))[1][0])


def test_matches_are_within_a_grid_that_holds_the_exposures_at_both_their_instants():
    """Nodes from 2.0 to 2.6 s, exposures of 0.04 s: instants from 2.02 to 2.58 s."""
    t_hub = np.array([2.03, 2.01, 2.3, 2.57, 2.59, 2.3])
    t = np.stack([t_hub + 0.005, t_hub - 0.015, [2.31, 2.29, 2.585, 2.4, 2.5, np.nan]], axis=1)
    star = SimpleNamespace(
        longest=0.04, t_hub=t_hub, t=t, weight=np.full(t.shape, 0.7), with_weight=np.asarray
    )
    both = np.stack([np.broadcast_to(t_hub[:, None], t.shape), np.where(np.isnan(t), t_hub[:, None], t)])
    wanted = ((both >= 2.02) & (both <= 2.58)).all(axis=0)
    assert 0 < wanted.sum() < wanted.size and not wanted[:, :2].all() and not wanted[:, 2].all()
    assert_allclose(_within(star, TimeGrid(2.0, 0.01, 61)), np.where(wanted, 0.7, 0.0))
