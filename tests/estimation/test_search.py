"""What rows of differences say of tones: gains of chance, and of what TDI averages away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.search import NoiseModel, Search, _mean_hidden, descend_within
from sightline.estimation.series import DifferenceSeries, Grid, series_equations

STEP, COUNT, TDI, SIGMA = 1e-3, 800, 8e-3, 0.02
SEEN = ((0.30, 47.0), (0.15, 83.0))


def search(series: list[DifferenceSeries], spectrum: Spectrum, **more: object) -> tuple[Search, NoiseModel]:
    """In units of the noise, the spectrum given."""
    scaled = [
        DifferenceSeries(s.t, s.lag, s.values / SIGMA, s.variance / SIGMA**2, tdi=s.tdi) for s in series
    ]
    known = spectrum.scaled(1.0 / SIGMA)
    equations = series_equations(scaled, Grid(0.0, STEP, COUNT), spectrum=known)
    return Search(equations, 1.0, False, STEP * COUNT, **more), NoiseModel.of(known)  # type: ignore[arg-type]


def test_the_gain_of_a_sinusoid_in_noise_alone_is_exponential_of_mean_one() -> None:
    # four differences .15 s apart: near odd multiples of 1 / .3 s cosine and sine are seen unlike each
    # other, and the mean square of |c'u|^2 over its expectation is up to 3
    spectrum = Spectrum((Matern(0.05, 1.0, "5/2"), Matern(0.02, 0.01, "3/2")))
    rng = np.random.default_rng(5)
    k = np.arange(100, 700, 150)
    root = np.linalg.cholesky(
        toeplitz(spectrum.autocovariance(STEP * np.arange(COUNT))) + 1e-12 * np.eye(COUNT)
    )
    frequency, gains, ratios = np.array([30.1, 63.5, 123.5]), [], []
    for _ in range(600):
        x = root @ rng.normal(size=COUNT)
        values = x[k + 8] - x[k] + SIGMA * rng.normal(size=len(k))
        series = DifferenceSeries(k * STEP, np.full(len(k), 8 * STEP), values, np.full(len(k), SIGMA**2))
        finder, model = search([series], spectrum)
        now = finder.posterior(model)
        gain, power, expected = finder._exact_gain(now, _pulled(now), frequency)
        gains.append(gain)
        ratios.append(power / expected)
    mean, square = np.mean(gains, axis=0), np.mean(np.square(gains), axis=0)
    # of 600 exponentials: mean 1 +- 1 / sqrt(600), mean square 2 +- sqrt(20 / 600); 4 sigma
    assert np.abs(mean - 1.0).max() < 4.0 / np.sqrt(600)
    assert np.abs(square - 2.0).max() < 4.0 * np.sqrt(20.0 / 600)
    assert np.mean(np.square(ratios), axis=0).max() > 2.0 + 4.0 * np.sqrt(20.0 / 600)


def _pulled(now):  # type: ignore[no-untyped-def]
    from sightline.estimation.banded import band_times

    return band_times(now.prior_band, now.mean)


def through_tdi(tones, seed: int, lags=(0.0055, 0.0172, 0.0225), known=SEEN):  # type: ignore[no-untyped-def]
    """A search, and a model of `known`, of rows of tones (size, Hz) through TDI of 8 ms."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(tones))

    def averaged(t: np.ndarray) -> np.ndarray:
        waves = [
            np.sqrt(2.0) * s * np.sinc(f * TDI) * np.cos(2.0 * np.pi * f * t + p)
            for (s, f), p in zip(tones, phase, strict=True)
        ]
        return np.asarray(sum(waves))

    series = []
    for lag in lags:
        t = np.arange(0.01, STEP * COUNT - 0.05, 0.0025)
        values = averaged(t + lag) - averaged(t) + SIGMA * rng.normal(size=len(t))
        series.append(
            DifferenceSeries(t, np.full(len(t), lag), values, np.full(len(t), SIGMA**2), tdi=(TDI, TDI))
        )
    parts = (Matern(0.1, 1.0, "5/2"), Matern(1e-3, 0.01, "3/2"))
    return search(series, Spectrum((*parts, *(Tone(s, f, 1.0) for s, f in known))), tdi=(TDI,))


def hidden(size: float, seed: int, frequency: float = 121.0) -> tuple[Tone, ...]:
    """What is expected, in the unit of the motion; of a tone of 121 Hz .033 is left."""
    finder, model = through_tdi((*SEEN, (size, frequency)), seed)
    return tuple(
        Tone(tone.sigma * SIGMA, tone.frequency, tone.bandwidth) for tone in finder.hidden_tones(model)[0]
    )


def test_a_mode_that_shines_through_is_not_put_at_its_alias() -> None:
    # lags of whole rows: 121 Hz and 400 - 121 Hz are one sinusoid, but a mode is rarer and smaller there;
    # of 121.3 Hz the alias is nearer to one of the places that are looked at, .625 Hz apart
    for seed in range(4):
        finder, model = through_tdi((*SEEN, (0.12, 121.3)), seed, (0.005, 0.0175, 0.0225))
        _, through = finder.hidden_tones(model)
        assert through == ((pytest.approx(121.3, abs=0.7), 1.0),)


@pytest.mark.parametrize(("mode", "of_157", "left"), [(0.2, 0.01, 2), (0.0, 0.2, 3)])
def test_of_a_hidden_mode_and_its_product_the_one_that_stands_out_stays(mode, of_157, left) -> None:  # type: ignore[no-untyped-def]
    # 157 = 121 + 83 - 47 Hz, of which .18 is left: with a mode of 121 Hz it is one of its products
    tones = (*SEEN, (mode, 121.0), (of_157, 157.0))
    finder, model = through_tdi(tones, 1, known=(*SEEN, (of_157, 157.0)))
    assert len(finder.without_products(model).tones) == left


@pytest.mark.parametrize("size", [0.05, 0.08, 0.16])
def test_a_mode_that_shines_through_tdi_is_expected_with_its_size(size: float) -> None:
    # .033 of .08 among some 300 rows of .02 and three pairs: its amplitude is seen to .2-.3 of itself
    found = [sum(t.sigma**2 for t in hidden(size, seed) if 107.0 < t.frequency < 143.0) for seed in range(8)]
    assert np.sqrt(np.mean(found)) == pytest.approx(size, rel=0.35)


def test_a_mode_that_would_stand_out_is_not_owned() -> None:
    # modes of 47 and 83 Hz in 107 Hz make another beyond as likely as not, of .3**2 (47 / 121)**3 = .07**2;
    # what the rows do not show can only be where they show less than .01 of it, which is seldom
    found = [sum(t.sigma**2 for t in hidden(0.0, seed) if 107.0 < t.frequency < 143.0) for seed in range(8)]
    assert np.sqrt(np.mean(found)) < 0.03


def test_a_mode_of_another_axis_is_expected_wherever_it_lies_between_places(monkeypatch) -> None:
    # as many places as long data have: 5 Hz apart, four times one over the length of these
    monkeypatch.setattr("sightline.estimation.search.MOST_HIDDEN", 100)
    finder, model = through_tdi(SEEN, 1)
    alone, _ = finder.hidden_tones(model)
    for place in 119.0 + np.arange(6.0):
        tones, _ = finder.hidden_tones(model, ((place, 30.0),))
        more, less = (sum(t.sigma**2 for t in one if 107.0 < t.frequency < 143.0) for one in (tones, alone))
        assert more > 1.3 * less


@pytest.mark.parametrize(("longest", "owned"), [(0.010, True), (0.005, False), (0.0, False)])
def test_what_long_lines_may_average_away_is_owned_where_it_is_not_seldom(
    longest: float, owned: bool
) -> None:
    # two modes up to 83 Hz make 2/3 (83 f)^2 of one beyond f: .72 above 80 Hz (odds that count: .464), .18
    # above 160. Its variance is that of 83 Hz times (83 / x)^3 for one at x, in the mean
    finder, model = through_tdi(SEEN, 1)
    series = finder._equations
    finder = Search(series, 1.0, False, STEP * COUNT, window=longest, tdi=(0.0,), window_most=longest)
    tones, through = finder.hidden_tones(model)
    assert all(chance < 0.5 for _, chance in through)
    size = np.sqrt(sum(t.sigma**2 for t in tones)) * SIGMA
    x = np.linspace(80.0, 800.0, 20000)
    density = 4.0 / 3.0 * 83.0**2 / x**3
    variance = np.trapezoid(density * 0.15**2 * (83.0 / x) ** 3, x) / (1.0 + np.trapezoid(density, x))
    # that rows show nothing of it below 100 Hz makes it less likely there: less than a half of its variance
    assert (0.6 * np.sqrt(variance) < size < 1.1 * np.sqrt(variance)) if owned else size == 0.0


def test_products_of_a_hidden_mode_are_as_large_as_the_third_moment_makes_them() -> None:
    # waves of .15 px at 83 and .08 px at 121 Hz within stages of 8 ms: of the cube of what each stage lies
    # beside their mean, what is found at 2 * 83 - 121 = 45 Hz over the share of 45 Hz that is left
    detail, whole = 6.0, TDI
    finder, _ = through_tdi(SEEN, 1)
    finder = Search(finder._equations, 1.0, False, STEP * COUNT, tdi=(whole,), detail=detail)
    made = finder._products_of([Tone(0.08, 121.0, 1.0)], [Tone(0.15, 83.0, 1.0)])
    t = np.arange(0.0, 1.0, 5e-4)
    stages = whole * ((np.arange(64) + 0.5) / 64 - 0.5)
    waves = [
        np.sqrt(2.0) * s * np.cos(2.0 * np.pi * f * (t[:, None] + stages))
        for s, f in ((0.15, 83.0), (0.08, 121.0))
    ]
    beside = sum(waves) - sum(waves).mean(axis=1, keepdims=True)
    shift = detail / 6.0 * (beside**3).mean(axis=1)
    at_45 = np.abs(np.mean(shift * np.exp(-2j * np.pi * 45.0 * t))) * np.sqrt(2.0) / np.sinc(45.0 * whole)
    (there,) = (tone.sigma for tone in made if abs(tone.frequency - 45.0) < 0.1)
    assert there == pytest.approx(at_45, rel=0.02)


def test_a_mode_of_which_others_may_undo_what_shows_is_owned_though_rows_show_nothing() -> None:
    # rows that would show 30 times their noise show none of it: no mode, unless another's work cancels it
    mean, count = np.full(9, 2.0), np.where(np.arange(9) == 4, 3.0, 1e-9)
    expected = []
    for doubt in (0.0, 0.7):
        variance, _ = _mean_hidden(mean, count, np.zeros(9), np.full(9, 15.0), np.full(9, doubt))
        expected.append(variance[4] / 2.0)
    # without doubt: the mean of v by exp(-v) / (1 + 30 v), beside a third for none
    v = (np.arange(200000) + 0.5) / 20000.0
    likelihood = np.exp(-v) / (1.0 + 30.0 * v)
    alone = (likelihood @ v) / (20000.0 / 3.0 + likelihood.sum())
    assert expected[0] == pytest.approx(alone, rel=0.05)
    assert 1.5 * expected[0] < expected[1] < 3.0 / 4.0  # never more than that one is there at all


def test_the_scale_of_the_noise_stays_within_its_bounds() -> None:
    # rows without any error want none
    t = np.arange(0.01, 0.7, 0.0025)
    series = DifferenceSeries(t, np.full(len(t), 0.0172), np.zeros(len(t)), np.full(len(t), SIGMA**2))
    spectrum = Spectrum((Matern(1e-3, 1.0, "5/2"), Matern(1e-4, 0.01, "3/2")))
    finder, model = search([series], spectrum)
    finder._fit_noise = True
    for begin in (0.2, 0.22):
        scale = finder._with_best_scale(replace(model, noise_scale=begin))[0].noise_scale
        assert scale == pytest.approx(0.2)


def test_nothing_is_hidden_where_an_image_has_no_stages() -> None:
    series = DifferenceSeries(
        np.arange(0.01, 0.7, 0.0025),
        np.full(276, 0.0172),
        np.zeros(276),
        np.full(276, SIGMA**2),
        tdi=(TDI, 0.0),
    )
    finder, model = search(
        [series], Spectrum((Matern(0.1, 1.0, "5/2"), Matern(1e-3, 0.01, "3/2"))), tdi=(0.0, TDI)
    )
    assert finder.hidden_tones(model) == ((), ())


class TestDescend:
    @staticmethod
    def valley(x):
        # Rosenbrock's, whose least value is at (1, 1)
        value = 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2
        slope = np.array(
            [-400.0 * x[0] * (x[1] - x[0] ** 2) - 2.0 * (1.0 - x[0]), 200.0 * (x[1] - x[0] ** 2)]
        )
        return value, slope

    def test_a_bent_valley_is_followed_to_its_lowest_place(self):
        bounds = np.array([[-5.0, 5.0], [-5.0, 5.0]])
        found = descend_within(self.valley, np.array([-1.2, 1.0]), bounds, np.eye(2), 200, 1e-14)
        np.testing.assert_allclose(found, [1.0, 1.0], atol=1e-5)

    def test_a_bound_is_kept_and_the_rest_is_lowered_along_it(self):
        bounds = np.array([[-5.0, 0.5], [-5.0, 5.0]])
        found = descend_within(self.valley, np.array([-1.2, 1.0]), bounds, np.eye(2), 200, 1e-14)
        np.testing.assert_allclose(found, [0.5, 0.25], atol=1e-5)

    def test_where_there_is_no_value_it_does_not_go(self):
        def wall(x):
            return (float("inf"), np.zeros(1)) if x[0] > 2.0 else ((x[0] - 3.0) ** 2, 2.0 * (x - 3.0))

        found = descend_within(wall, np.zeros(1), np.array([[-9.0, 9.0]]), np.eye(1), 200, 1e-12)
        assert 1.9 < found[0] <= 2.0
