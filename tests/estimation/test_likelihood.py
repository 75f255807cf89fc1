"""Spectra found blind: tones in their place, sizes and noise near the truth, nothing where nothing is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.errors import InputError
from sightline.estimation.evidence import posterior
from sightline.estimation.likelihood import SPREAD_PLACES, WORK, default_step, fit_spectrum, spread_of
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.search import gain_of_chance, mean_variance_about, mean_variance_unseen
from sightline.estimation.series import DifferenceSeries, Grid, series_equations

STEP, N = 1e-3, 1000
LAGS = (86, 22, 7, 15)
TRUE = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.1, 0.005), Tone(0.3, 47.0, 0.8)))


def measured(
    x: np.ndarray, sigma: float, every: int = 5, claimed: float | None = None
) -> list[DifferenceSeries]:
    """Four pairs of a motion on the 1 ms grid, noise `sigma`, said to be `claimed`."""
    rng = np.random.default_rng(11)
    said = sigma if claimed is None else claimed
    out = []
    for lag in LAGS:
        k = np.arange(0, N - lag, every)
        values = x[k + lag] - x[k] + sigma * rng.normal(size=len(k))
        out.append(DifferenceSeries(k * STEP, np.full(len(k), lag * STEP), values, np.full(len(k), said**2)))
    return out


@pytest.fixture(scope="module")
def motion(dense) -> np.ndarray:  # type: ignore[no-untyped-def]
    return dense.draw(np.random.default_rng(4), N)


@pytest.fixture(scope="module")
def series(motion: np.ndarray) -> list[DifferenceSeries]:
    return measured(motion, 0.03)


@pytest.fixture(scope="module")
def fitted(series: list[DifferenceSeries]):  # type: ignore[no-untyped-def]
    return fit_spectrum(series)


def test_a_tone_is_found_blind_at_its_frequency(fitted) -> None:  # type: ignore[no-untyped-def]
    # One period per strip is 1 Hz; the tone wanders by its own 0.8 Hz.
    assert len(fitted.spectrum.tones) == 1
    tone = fitted.spectrum.tones[0]
    assert tone.frequency == pytest.approx(47.0, abs=1.0)
    assert 0.1 < tone.sigma < 0.9  # one or two coherence times only: the sample's size, not the process's
    assert fitted.significance[0] > 20.0


def test_the_noise_is_separated_from_the_motion(fitted) -> None:  # type: ignore[no-untyped-def]
    # ~770 measurements: the variance's own sigma is sqrt(2 / 770) = 5 %; half are spent on the motion.
    assert fitted.noise_scale == pytest.approx(1.0, abs=0.25)


def test_wrong_claimed_variances_are_corrected(motion: np.ndarray) -> None:
    found = fit_spectrum(measured(motion, 0.03, claimed=0.02), max_tones=2)
    assert found.noise_scale == pytest.approx(2.25, rel=0.25)
    assert fit_spectrum(measured(motion, 0.03), max_tones=0, fit_noise=False).noise_scale == 1.0


def test_the_smoother_is_as_good_with_what_was_found_as_with_the_truth(
    motion: np.ndarray,
    series: list[DifferenceSeries],
    fitted,  # type: ignore[no-untyped-def]
) -> None:
    equations = series_equations(series, Grid(0.0, STEP, N))

    def rms(spectrum: Spectrum, noise: float) -> float:
        error = posterior(equations, spectrum.autoregressive(STEP, 60, N), noise_scale=noise).mean - motion
        return float(np.std(error))

    # The target over many series is 1.03; one series of 1 s may scatter by twice that.
    assert rms(fitted.spectrum, fitted.noise_scale) < 1.06 * rms(TRUE, 1.0)


def test_a_motion_that_ends_at_a_frequency_is_not_given_a_tail() -> None:
    # Evenly between 10 and 60 Hz, 0.2 rms, nothing beyond: by Matern 3/2 a fifth of its power would lie above
    # 100 Hz, and its sigma would own jitter that is not there.
    t = np.arange(N) * STEP
    rng = np.random.default_rng(8)
    waves = [np.sin(2.0 * np.pi * (f * t + rng.uniform())) for f in rng.uniform(10.0, 60.0, 400)]
    x = 0.2 * np.sqrt(2.0 / 400) * np.sum(waves, axis=0) + np.sin(2.0 * t)
    found = fit_spectrum(measured(x, 0.01, every=2), max_tones=0).spectrum
    beyond = np.linspace(100.0, 500.0, 401)
    assert found.components[1].order in ("9/2", "17/2")  # type: ignore[union-attr]
    assert np.trapezoid(found.psd(beyond), beyond) < 0.02 * 0.2**2


def test_jitter_with_a_tail_keeps_it(fitted) -> None:  # type: ignore[no-untyped-def]
    assert fitted.spectrum.components[1].order == "3/2"


def test_a_tone_above_the_sampling_nyquist_is_found_where_it_is() -> None:
    # Sampled every 5 ms a tone at 121 Hz folds onto 79 Hz; lags that are no multiples of the sampling
    # step tell them apart.
    t = np.arange(N) * STEP
    rng = np.random.default_rng(6)
    x = 0.5 * np.sin(3.0 * t) + 0.12 * np.sin(2.0 * np.pi * 121.0 * t + 1.0) + 0.01 * rng.normal(size=N)
    found = fit_spectrum(measured(x, 0.02))
    assert [round(tone.frequency) for tone in found.spectrum.tones] == [121]


@pytest.mark.parametrize("seed", [1, 4, 10])
def test_tones_of_a_short_strip_are_not_taken_for_fewer_between_them(seed: int) -> None:
    """Of eight periods and more each, six resolutions and more apart, and ten times the noise and more."""
    rng, step, count = np.random.default_rng(seed), 2.08e-4, 799
    t = step * np.arange(count)
    drift = Matern(2.0, 0.08, "5/2").autocovariance(t)
    x = np.linalg.cholesky(toeplitz(drift) + 1e-9 * np.eye(count)) @ rng.standard_normal(count)
    places = (47.0, 83.0, 121.0)
    for f, size in zip(places, (0.44, 0.24, 0.13), strict=True):
        x += size * np.sin(2.0 * np.pi * (f * t + rng.random()))
    series = []
    for lag in (65, 69, 143, 4, 78, 74):
        k = np.arange(4, count - lag - 4, 4)
        values = x[k + lag] - x[k] + 0.02 * rng.standard_normal(len(k))
        series.append(DifferenceSeries(t[k], np.full(len(k), lag * step), values, np.full(len(k), 4e-4)))
    found = [tone.frequency for tone in fit_spectrum(series, offset_sigma=3.0).spectrum.tones]
    # within half the resolution of where a sinusoid explains most, which is within another half of the place
    assert len(found) == 3
    np.testing.assert_allclose(found, places, atol=1.0 / (step * count))


def test_a_known_tone_is_in_the_spectrum_however_small() -> None:
    # 0.002 in a noise of 0.03, of which some 200 measurements tell amplitudes to 0.03 * 2 / sqrt(200) = 0.004
    t = STEP * np.arange(N)
    series = measured(0.002 * np.sin(2 * np.pi * 61.0 * t), 0.03)[1:2]
    (tone,) = fit_spectrum(series, known_tones=[61.0], max_tones=1, iterations=10).spectrum.tones
    assert tone.frequency == pytest.approx(61.0, abs=1e-9)
    # within ten times what the noise hides
    assert tone.sigma < 0.04


def test_pure_noise_has_no_tone_and_little_motion() -> None:
    found = fit_spectrum(measured(np.zeros(N), 0.03))
    assert found.spectrum.tones == ()
    assert found.noise_scale == pytest.approx(1.0, abs=0.2)


def test_the_unit_does_not_matter(series: list[DifferenceSeries], fitted) -> None:  # type: ignore[no-untyped-def]
    small = [DifferenceSeries(s.t, s.lag, 5e-6 * s.values, 25e-12 * s.variance) for s in series]
    found = fit_spectrum(small)
    assert found.spectrum.sigma == pytest.approx(5e-6 * fitted.spectrum.sigma, rel=1e-3)
    assert found.spectrum.tones[0].frequency == pytest.approx(fitted.spectrum.tones[0].frequency, abs=1e-3)


def test_the_search_never_ends_worse_than_it_started(series: list[DifferenceSeries], fitted) -> None:  # type: ignore[no-untyped-def]
    again = fit_spectrum(series, start=fitted.spectrum, max_tones=0, iterations=3)
    assert again.deviance <= fitted.deviance + 0.5


def test_a_search_near_its_end_stays_there_and_finds_what_is_new(
    series: list[DifferenceSeries], motion: np.ndarray, fitted
) -> None:  # type: ignore[no-untyped-def]
    near = fit_spectrum(series, start=fitted.spectrum, near=True)
    # ends within what the last step of a search gains at most, and what rounding of idle parts leaves
    assert abs(near.deviance - fitted.deviance) < 0.5
    assert [round(tone.frequency) for tone in near.spectrum.tones] == [
        round(tone.frequency) for tone in fitted.spectrum.tones
    ]
    new = motion + 0.3 * np.sin(2 * np.pi * 83.0 * STEP * np.arange(N))
    found = fit_spectrum(measured(new, 0.03), start=fitted.spectrum, near=True).spectrum.tones
    assert any(abs(tone.frequency - 83.0) < 1.0 for tone in found)


def test_a_drift_of_a_few_bends_is_not_taken_for_none(dense_drift) -> None:  # type: ignore[no-untyped-def]
    """NEES of what the fitted spectrum leaves of short drifts, of which the noise shows some four bends.

    A mean over 4 x 40 squares has a standard deviation of (2 / 160)^.5 = .11, three of which are allowed; the
    drift of largest likelihood is now and then none (NEES 1.7 in the mean).
    """
    step, count, noise = 0.02, 80, 0.3
    t = step * np.arange(count)
    grid = Grid.covering(0.0, t[-1], step)
    at = np.rint((t - grid.nodes[0]) / step).astype(int)
    line = np.stack([np.ones(count), t], axis=1)
    left = np.eye(count) - line @ np.linalg.pinv(line)
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x = dense_drift @ rng.standard_normal(count)
        series = []
        for n in (3, 5):
            k = np.arange(count - n)
            values = x[k + n] - x[k] + noise * rng.standard_normal(len(k))
            series.append(
                DifferenceSeries(
                    t[k], np.full(len(k), n * step), values, np.full(len(k), noise**2), (0, n), 0.0
                )
            )
        fit = fit_spectrum(series, step=step, max_tones=0)
        prior = fit.spectrum.autoregressive(step, 40, grid.count)
        now = posterior(series_equations(series, grid), prior, noise_scale=fit.noise_scale)
        error = left @ (now.mean[at] - x)
        covariance = left @ now.covariance_times(np.eye(grid.count)[:, at])[at] @ left
        found.append(float(error @ error / np.trace(covariance)))
    assert 0.67 < np.mean(found) < 1.33


@pytest.fixture(scope="module")
def dense_drift() -> np.ndarray:
    """Root of the covariance of a drift of .5 over 1 s at 80 places, from its formula."""
    a = np.sqrt(5.0) * 0.02 * np.abs(np.subtract.outer(np.arange(80), np.arange(80)))
    return np.linalg.cholesky(0.25 * (1.0 + a + a * a / 3.0) * np.exp(-a) + 1e-10 * np.eye(80))


def test_a_start_whose_parts_have_changed_places_is_not_kept() -> None:
    # three bands of a short crop, .5 and 1 s apart: of a drift that bends, and jitter of 40 ms
    t, lags, sigmas = np.arange(0.0, 0.53, 0.006), (-0.527, -1.005), (0.08, 0.03)
    instants, rng = np.concatenate([t, *(t + lag for lag in lags)]), np.random.default_rng(0)
    apart = np.abs(np.subtract.outer(instants, instants))
    parts = Matern(1.0, 0.5, "5/2"), Matern(0.1, 0.04, "3/2")
    covariance = sum(part.autocovariance(apart.ravel()).reshape(apart.shape) for part in parts)
    x = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(instants))) @ rng.normal(size=len(instants))
    hub, *partners = np.split(x, 3)
    series = [
        DifferenceSeries(
            t, np.full(len(t), lag), other - hub + s * rng.normal(size=len(t)), np.full(len(t), s**2)
        )
        for lag, s, other in zip(lags, sigmas, partners, strict=True)
    ]
    swapped = Spectrum((Matern(0.066, 1.47, "5/2"), Matern(0.6, 0.27, "3/2")))
    begun, anew = (
        fit_spectrum(series, start=start, max_tones=1, offset_sigma=1.0, iterations=20)
        for start in (swapped, None)
    )
    # searches stop within about half a unit of deviance of their optimum; the other one lies 5 above
    assert begun.deviance < anew.deviance + 1.0


def test_a_long_strip_is_fitted_on_a_coarser_grid() -> None:
    t = np.arange(0.0, 15.0, 2e-3)
    y = np.random.default_rng(0).normal(size=len(t))
    long = DifferenceSeries(t, np.full(len(t), 0.05), y, np.ones(len(t)))
    assert default_step([long]) == pytest.approx(2e-3)
    # a quarter of the work allowed: as of a minute
    found = fit_spectrum([long], max_tones=0, iterations=1, work=0.25 * WORK)
    # a shorter one: two nodes to a row; here the root of (15.05 s x (0.05 s)^2 / work), the third
    assert found.step == pytest.approx(1.36e-3, rel=0.01)


def test_the_default_step_follows_the_shortest_lag_within_the_sampling() -> None:
    t = np.arange(0.0, 1.0, 5e-3)

    def pair(lag: float) -> DifferenceSeries:
        return DifferenceSeries(t, np.full(len(t), lag), t, np.ones(len(t)))

    assert default_step([pair(0.172), pair(0.007)]) == pytest.approx(1e-3)
    assert default_step([pair(0.172)]) == pytest.approx(5e-3)
    assert default_step([pair(0.0035)]) == pytest.approx(1e-3)


def test_bad_input_is_named() -> None:
    t = np.arange(3.0)
    with pytest.raises(InputError, match="no series holds a finite measurement"):
        fit_spectrum([DifferenceSeries(t, t + 1.0, t * np.nan, t + 1.0)])
    one = DifferenceSeries(t[:1], np.ones(1), np.ones(1), np.ones(1))
    with pytest.raises(InputError, match="fewer than two measurement times"):
        default_step([one])
    good = DifferenceSeries(t, t + 1.0, t, t + 1.0)
    with pytest.raises(InputError, match="`start` needs a Matern component"):
        fit_spectrum([good], start=Spectrum((Tone(1.0, 1.0, 1.0),)))


def test_the_mean_variance_of_an_unseen_tone_is_that_of_tones_drawn_so() -> None:
    """Amplitudes even up to the largest, gains exponential of mean 1 + variance: means by gain."""
    rng = np.random.default_rng(3)
    for largest in (0.02, 12.0):
        variance = largest * rng.uniform(0.0, 1.0, 400_000) ** 2
        gain = (1.0 + variance) * rng.exponential(size=len(variance))
        for low in (0.0, 2.0, 5.0):
            near = np.abs(gain - low - 0.1) < 0.1
            # some 2000 or more in a slice of variances that scatter as much as their mean: 2 %, times three
            assert mean_variance_unseen(low + 0.1, largest) == pytest.approx(variance[near].mean(), rel=0.07)
    # where nothing is seen, the third of the largest; never more than it
    assert mean_variance_unseen(0.7, 1e-6) == pytest.approx(1e-6 / 3.0, rel=1e-3)
    assert mean_variance_unseen(50.0, 12.0) < 12.0


def test_jitter_below_the_noise_has_the_corner_that_another_axis_shows(motion: np.ndarray) -> None:
    """Noise of five times the jitter hides where it bends: it may pass for noise, or noise for it."""
    noisy = measured(motion, 0.5)
    believed = 50.0
    with_motion, alone = (
        fit_spectrum(noisy, max_tones=0, corner=corner).spectrum.components[1].corner
        for corner in (believed, None)
    )
    # a belief of 0.7 in the logarithm, twice that at the most where the data say little
    assert abs(np.log(with_motion / believed)) < 1.4
    assert abs(np.log(with_motion / believed)) < abs(np.log(alone / believed))
    # where the data show it (noise of a third of the jitter), what is believed a decade off hardly matters
    seen = fit_spectrum(measured(motion, 0.03), max_tones=1).spectrum.components[1].corner
    misled = (
        fit_spectrum(measured(motion, 0.03), max_tones=1, corner=10.0 * seen).spectrum.components[1].corner
    )
    assert abs(np.log(misled / seen)) < 0.7


def test_a_tone_that_other_axes_have_is_as_large_as_goes_unseen(series) -> None:  # type: ignore[no-untyped-def]
    """60 Hz is seen well by all lags: little goes unseen there, and what is found elsewhere stays."""
    known = fit_spectrum(series, possible=(Tone(9.0, 60.0, 1.0),)).spectrum.tones
    (tone,) = [t for t in known if abs(t.frequency - 60.0) < 1e-9]
    # 770 differences of sigma 0.03 and gain 2 tell a sinusoid to 0.03 / sqrt(770) / 2 = 0.0005 at best; the
    # threshold of ln(300 / 1e-3) = 12.6 asks for 5 of them, the broadband of 0.1 beside it for ten times that
    assert 0.0015 < tone.sigma < 0.05
    assert any(abs(t.frequency - 47.0) < 1.0 for t in known)


def test_the_mean_variance_about_a_usual_size_is_that_of_sizes_drawn_so() -> None:
    # sizes are half a Student t of four degrees of root mean square 1; data of 20 numbers of variance
    # 1 + size^2 say the rest. Weighing 4e5 draws by their likelihood leaves some hundreds to count: 10 %.
    rng = np.random.default_rng(5)
    sizes = np.abs(rng.standard_t(4.0, 400_000)) / np.sqrt(2.0)
    logs = np.linspace(np.log(0.02), np.log(30.0), 15)
    for squares in (15.0, 60.0):

        def deviance(size, squares=squares):
            return 20.0 * np.log1p(size**2) + squares / (1.0 + size**2)

        weight = np.exp(-0.5 * (deviance(sizes) - deviance(np.exp(logs)).min()))
        drawn = float(sizes**2 @ weight / weight.sum())
        assert mean_variance_about(1.0, logs, deviance(np.exp(logs))) == pytest.approx(drawn, rel=0.1)


def drawn(spectrum: Spectrum, seed: int) -> np.ndarray:
    covariance = toeplitz(spectrum.autocovariance(np.arange(N) * STEP))
    covariance += 1e-10 * covariance[0, 0] * np.eye(N)
    return np.linalg.cholesky(covariance) @ np.random.default_rng(seed).normal(size=N)


def test_what_an_axis_does_not_show_is_about_as_large_as_on_the_others(motion: np.ndarray) -> None:
    # noise of 1 hides jitter of 0.1 and shows the drift of 2
    noisy = measured(drawn(Spectrum(TRUE.components[:2]), 2), 1.0)
    by_itself = fit_spectrum(noisy, max_tones=0)
    for size in (0.1, 0.01):
        usual = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(size, 0.005), Tone(0.3, 47.0, 0.8)))
        found = fit_spectrum(noisy, max_tones=0, start=by_itself.spectrum, usual=usual)
        # the data do not tell 0.1 from nothing; a share of the belief goes beyond its own size
        assert 0.5 * size < found.spectrum.components[1].sigma < 3.0 * size
    # what is shown stays: jitter of 0.1 under noise of 0.01, said to be 30 times smaller elsewhere
    shown = measured(motion, 0.01)
    usual = Spectrum((Matern(2.0, 1.0, "5/2"), Matern(0.003, 0.005), Tone(0.01, 47.0, 0.8)))
    without, beside = (fit_spectrum(shown, max_tones=1, usual=one) for one in (None, usual))
    assert beside.spectrum == without.spectrum


def test_a_tone_as_found_is_as_large_as_in_the_motion() -> None:
    # a steady tone of 0.3 rms; noise of 0.03 in 400 rows leaves its amplitude 1 %, the drift some more
    tone = 0.3 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 47.0 * np.arange(N) * STEP)
    found = fit_spectrum(measured(drawn(Spectrum(TRUE.components[:2]), 2) + tone, 0.03), max_tones=1)
    assert found.as_found.tones[0].sigma == pytest.approx(0.3, rel=0.05)
    assert found.as_found.components[:2] == found.spectrum.components[:2]


@pytest.mark.parametrize("width", [0.0, 0.1, 0.5])
def test_tones_that_die_and_do_not_are_as_large_as_they_are(width: float) -> None:
    """Oscillators of `width` / T, or sinusoids: the variance fitted is that in the strip, on average."""
    variance = []
    for seed in range(8):
        rng, t = np.random.default_rng([seed, 7]), STEP * np.arange(N)
        if width:
            tone = drawn(Spectrum((Tone(0.3, 83.0, width),)), seed)
        else:
            tone = 0.3 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 83.0 * t + rng.uniform(0.0, 6.28))
        found = fit_spectrum(measured(drawn(Spectrum(TRUE.components[:2]), 90 + seed) + tone, 0.02))
        (one,) = [tone for tone in found.spectrum.tones if abs(tone.frequency - 83.0) < 2.0]
        variance.append((one.sigma**2, np.mean(tone**2)))
    # one strip's scatters by a third, eight by a tenth; an order of all nodes finds .72, .98, 1.16, one of a
    # sixth of them .75, 1.48 and 1.11; under a belief in widths of 1 / T the first two are .37 and .49
    assert 0.6 < np.sum(variance, axis=0)[0] / np.sum(variance, axis=0)[1] < 1.6


def test_a_tone_beside_a_blind_frequency_is_no_narrower_than_the_places_where_it_was_looked_for() -> None:
    """0.03 Hz beside 1 / 22 ms, where its size changes much between places a fiftieth of 1 / T apart."""
    blind, t, rng = 1.0 / 0.022, STEP * np.arange(N), np.random.default_rng([20, 77])
    tone = 20.0 * np.sqrt(2.0) * np.sin(2.0 * np.pi * (blind + 0.03) * t + rng.uniform(0.0, 6.28))
    x, k = drawn(Spectrum(TRUE.components[:2]), 20) + tone, np.arange(0, N - 44, 5)
    pairs = [
        DifferenceSeries(
            k * STEP, np.full(len(k), lag * STEP), x[k + lag] - x[k] + rng.normal(0.0, 0.005, len(k)),
            np.full(len(k), 0.005**2),
        )
        for lag in (22, 44)
    ]  # fmt: skip
    (found,) = [one for one in fit_spectrum(pairs).spectrum.tones if abs(one.frequency - blind) < 1.0]
    # the data and the grid reach no farther than a tenth beyond T
    assert found.bandwidth > 0.02 / 1.1 / (N * STEP)


def test_at_a_blind_frequency_a_known_tone_may_be_as_large_as_the_drift(motion) -> None:  # type: ignore[no-untyped-def]
    (only,) = [s for s in measured(motion, 0.03) if abs(s.lag[0] - 0.022) < 1e-9]
    seen, blind = (
        next(
            t.sigma
            for t in fit_spectrum([only], possible=(Tone(9.0, f, 1.0),)).spectrum.tones
            if abs(t.frequency - f) < 1.5  # beside a blind one it may lie at it
        )
        for f in (1.5 / 0.022, 2.0 / 0.022)
    )
    # |G| is 2 at the one and 0 at the other
    assert blind > 5.0 * seen


def test_at_the_rate_of_the_rows_offsets_take_the_place_of_a_tone(motion: np.ndarray) -> None:
    # differences every 8 ms: at 125 Hz, and at 250, a tone is the same in all of them
    given = [replace(one, images=(0, k + 1)) for k, one in enumerate(measured(motion, 0.03, every=8))]
    asked = [80.0, 125.0, 126.0, 250.0]

    def near(offset_sigma: float | None) -> list[float]:
        possible = [Tone(9.0, f, 1.0) for f in asked]
        tones = fit_spectrum(given, offset_sigma=offset_sigma, possible=possible).spectrum.tones
        return [f for f in asked if any(abs(tone.frequency - f) < 0.1 for tone in tones)]

    assert near(None) == asked
    # 4 periods over the 1 s of the data against the rate are needed
    assert near(1.0) == [80.0]


def test_a_motion_that_would_stop_the_scan_does_not_take_the_place_of_tones() -> None:
    # Lines of 2 ms scan 500 px/s; the motion (px) sets when a partner's line sees the same ground, so that a
    # rate of -500 px/s explains every difference without any tone.
    rng, line = np.random.default_rng(8), 2e-3
    lines = line * np.arange(-20.0, 800.0)
    tones = ((0.28, 47.0, 0.3), (0.14, 83.0, 1.1), (0.07, 121.0, 2.0))

    def motion(t: np.ndarray) -> np.ndarray:
        drift = 0.5 * np.sin(2.0 * np.pi * t / 1.4)
        return drift + sum(a * np.sin(2.0 * np.pi * f * t + phase) for a, f, phase in tones)

    series = []
    for k, lag in enumerate((4.4e-3, 20.3e-3)):
        t = np.arange(20, 780, 2) * line
        seen = t + lag
        for _ in range(30):
            seen = t + lag + line * (motion(t) - motion(seen))
        noise = 0.02 * rng.standard_normal(len(t))
        values = motion(seen) - motion(t) + noise
        series.append(DifferenceSeries(t, seen - t, values, np.full(len(t), 4e-4), images=(0, k + 1)))
    found = fit_spectrum(series, offset_sigma=1.0, motion=(lines, motion(lines)))
    # a tone that never changes says little of how large such a tone is: a factor of four each way
    sizes = {round(tone.frequency): tone.sigma for tone in found.spectrum.tones}
    for amplitude, frequency, _ in tones:
        assert 0.25 < sizes[round(frequency)] / (amplitude / np.sqrt(2.0)) < 4.0
    # chi-square of 760 differences is known to 5 %
    assert found.noise_scale == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("chance", [0.3, 0.05, 0.01])
def test_noise_gains_by_a_sinusoid_as_often_as_is_said(chance):
    rng, n, trials = np.random.default_rng(5), 256, 4000
    noise = rng.standard_normal((trials, n))
    # 128 periods of the highest frequency; 8 frequencies per period, less the first, which is hardly periodic
    gains = np.abs(np.fft.rfft(noise, 8 * n, axis=1)[:, 16:-16]) ** 2 / n
    share = (gains.max(axis=1) > gain_of_chance(0.5 * n, chance)).mean()
    # three sigmas of a binomial share, and 5 % for what lies between 8 frequencies per period
    assert abs(share - chance) < 3.0 * np.sqrt(chance / trials) + 0.05 * chance


def test_long_lags_leave_fewer_frequencies_to_chance() -> None:
    # 500 ms of images, lags of 100 ms and of 1 ms: what is midway lies within 400 and 499 ms
    def pair(lag: int, sigma: float = 1.0) -> DifferenceSeries:
        k = np.arange(500 - lag)
        noise = np.full(len(k), sigma**2)
        return DifferenceSeries(1e-3 * k, np.full(len(k), 1e-3 * lag), np.zeros(len(k)), noise)

    assert spread_of([pair(100)], 150.0) == pytest.approx(0.4, rel=1e-4)
    assert spread_of([pair(1)], 150.0) == pytest.approx(0.499, rel=1e-4)
    # what weighs nothing says nothing
    assert spread_of([pair(1, 1e6), pair(100)], 150.0) == pytest.approx(0.4, rel=1e-4)


def test_unlike_lags_tell_frequencies_apart_by_what_each_pair_sees() -> None:
    # the metric of the waves' directions, from all differences as complex numbers
    lags, step, count = (0.15, 0.25), 1e-3, 500
    series = []
    for lag in lags:
        t = step * np.arange(count - round(lag / step))
        ones = np.ones(len(t))
        series.append(DifferenceSeries(t, lag * ones, 0.0 * ones, ones))
    middle = np.concatenate([one.t + 0.5 * one.lag for one in series])
    lag = np.concatenate([one.lag for one in series])

    def direction(f: float) -> np.ndarray:
        wave = np.sin(np.pi * f * lag) * np.exp(2j * np.pi * f * middle)
        return np.asarray(wave / np.linalg.norm(wave))

    df, found = 1e-3, []
    for f in (np.arange(SPREAD_PLACES) + 0.5) / SPREAD_PLACES * 150.0:
        # of directions so little apart 1 - |<a, b>|^2 is the metric times the angle squared
        alike = abs(np.vdot(direction(f - 0.5 * df), direction(f + 0.5 * df))) ** 2
        found.append(np.sqrt(12.0 * (1.0 - alike)) / (2.0 * np.pi * df))
    assert spread_of(series, 150.0) == pytest.approx(np.mean(found), rel=2e-3)
    # far more than instants midway tell
    assert spread_of(series, 150.0) > 1.2 * np.sqrt(12.0 * middle.var())


def test_a_sinusoid_beside_a_blind_frequency_is_owned_by_sigma() -> None:
    # 47 Hz beside 7 / 0.15 s = 46.67: a pair sees 0.31 of it, and would see 0.46 at 47.16, which 0.6 s of
    # differences hardly tell apart
    lag, count, draws, rng = 150, 750, 8, np.random.default_rng(3)
    t = STEP * np.arange(count)
    broad = Spectrum((Matern(1.0, 0.5, "5/2"), Matern(0.1, 0.011)))
    factor = np.linalg.cholesky(toeplitz(broad.autocovariance(t)) + 1e-10 * np.eye(count))
    waves = np.stack([np.cos(2.0 * np.pi * 46.8 * t), np.sin(2.0 * np.pi * 46.8 * t)], axis=1)
    k = np.arange(0, count - lag, 2)
    squares = []
    for phase in rng.uniform(0.0, 2.0 * np.pi, draws):
        x = factor @ rng.standard_normal(count) + 0.3 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 47.0 * t + phase)
        values = x[k + lag] - x[k] + 0.05 * rng.standard_normal(len(k))
        series = [DifferenceSeries(k * STEP, np.full(len(k), lag * STEP), values, np.full(len(k), 0.05**2))]
        spectrum = fit_spectrum(series, max_tones=3).spectrum
        now = posterior(
            series_equations(series, Grid(0.0, STEP, count)), spectrum.autoregressive(STEP, 80, count)
        )
        error = waves.T @ (now.mean - x)
        squares.append(error @ np.linalg.solve(waves.T @ now.covariance_times(waves), error) / 2.0)
    # sixteen squares: their mean is beyond 2 in one of 200 cases where sigma is true
    assert np.mean(squares) < 2.0, squares
