"""The spectrum of a motion from its differences alone: no frequency, size or noise level is given.

Drift (Matern 5/2), broadband jitter (Matern of a smoothness that the data choose), tones and the noise's
scale maximise the exact marginal likelihood. Tones are found first, one by one, by a spectrum of what the
present model does not explain; it accounts for the lags, the windows, the gaps and the aliases, so that a
tone above the Nyquist frequency of the measurements is found where it is as long as the lags separate it.

Not here: the search itself (``search.py``), the likelihood (``evidence.py``), the final estimate
(``motion/estimators/smoother.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.estimation.evidence import EvenRate, rate_weights
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.search import HIGHEST, ROUGHLY, SETTLED, NoiseModel, Search, variance_at
from sightline.estimation.series import DifferenceSeries, Grid, SeriesEquations, series_equations

Array = NDArray[np.float64]

#: Work allowed per evaluation, n b^2; about 20 ms. Longer strips are fitted on a coarser grid.
WORK = 6.0e7
#: Nodes of the grid of a fit from row to row of the measurements, where `WORK` allows it.
NODES_IN_ROW = 2.0
#: Steps of a search from each place to start, before tones are looked for.
FIRST_ITERATIONS = 6
#: Frequencies at which differences are asked how well they tell them apart.
SPREAD_PLACES = 256


@dataclass(frozen=True, eq=False)
class FittedSpectrum:
    """Hyper-parameters of one axis as the data ask for them.

    Attributes
    ----------
    spectrum : Spectrum
        In the unit of the series; `spectrum.tones` are those found.
    noise_scale : float
        Factor on the measurement variances (1: they were right).
    deviance : float
        -2 log marginal likelihood at the optimum, on the grid of the fit.
    step : float
        s; grid step of the fit. Nothing above about 0.3 / step was looked for, nor what windows average
        away.
    significance : tuple of float
        Of each tone of `spectrum.tones`: log-likelihood gained by a sinusoid there, when it was found.
    sizes : tuple of float
        Of each tone, in the unit of the series: the standard deviation of the motion found there. The prior's
        own is smaller as a rule: its width is believed to be about one over the length of the data, and what
        keeps its phase longer needs less of such a process.
    hidden : tuple of Tone
        Wide ones, in the unit of the series: what is to be expected where TDI averages motion away. No
        estimate finds it.
    products : tuple of Tone
        Sums and differences of such modes and of those found (intermodulation), in the unit of the series:
        averaging puts them into the motion that is found; the body does not move so.
    through : tuple of (float, float)
        Hz; a mode there that most likely shines through, and its probability.
    """

    spectrum: Spectrum
    noise_scale: float
    deviance: float
    step: float
    significance: tuple[float, ...] = ()
    sizes: tuple[float, ...] = ()
    hidden: tuple[Tone, ...] = ()
    products: tuple[Tone, ...] = ()
    through: tuple[tuple[float, float], ...] = ()

    @property
    def as_found(self) -> Spectrum:
        """The spectrum with every tone no smaller than the motion found there."""
        sizes = iter(self.sizes)
        return Spectrum(
            tuple(
                replace(c, sigma=max(c.sigma, next(sizes, 0.0))) if isinstance(c, Tone) else c
                for c in self.spectrum.components
            )
        )


def fit_spectrum(
    series: Sequence[DifferenceSeries],
    *,
    step: float | None = None,
    start: Spectrum | None = None,
    known_tones: Sequence[float] = (),
    max_tones: int = 8,
    false_alarm: float = 1e-3,
    fit_noise: bool = True,
    offset_sigma: float | None = None,
    independent: float = 0.0,
    iterations: int = 60,
    work: float = WORK,
    possible: Sequence[Tone] = (),
    corner: float | None = None,
    detail: float = 0.0,
    elsewhere: Sequence[tuple[float, float]] = (),
    motion: tuple[Array, Array] | None = None,
    rate_seen: bool = False,
    settled: float = SETTLED,
    near: bool = False,
    smoothness: bool = True,
    usual: Spectrum | None = None,
) -> FittedSpectrum:
    """Spectrum and noise scale of a motion by marginal likelihood, tones found blind.

    Parameters
    ----------
    series : sequence of DifferenceSeries
        All pairs, in one unit.
    step : float, optional
        s; grid step. By default as `default_step`, coarser on long strips (see `WORK`).
    start : Spectrum, optional
        A further place to start: its first Matern 5/2, its other Matern part and its tones. Where it explains
        the data better than a guess by their size, the search starts there, and, if tones are looked for,
        from its tones beside the guess's broad parts.
    known_tones : sequence of float
        Hz; tones that are there whether the data show them or not, such as of wheels and coolers. Their
        frequency is taken as it is, size and width are fitted; one that the data do not show is as large as
        goes unseen.
    max_tones : int
        At most this many tones, those of `start` included; 0 looks for none.
    false_alarm : float
        Probability of one false tone in pure noise.
    fit_noise : bool
        Whether the variances are scaled by a fitted factor.
    offset_sigma : float, optional
        Prior sigma of an unknown constant of every image; none by default. With it no tone is looked for at
        the rate of the measurements, or its multiples: it would be such a constant.
    independent : float
        See `series_equations`.
    iterations : int
        Of the last search.
    work : float
        Allowed per evaluation, see `WORK`.
    possible : sequence of Tone
        There a tone stands as wide as these, of the size that one not found has on average if beforehand it
        is that of these; beside a frequency that all lags are blind to it is as wide as these leave it.
    corner : float, optional
        Hz; where the broadband part is believed to bend, within a factor of 2.
    detail : float
        Mean square of the (angular) frequencies that matches weigh, per unit squared of the series; for
        what TDI hides.
    elsewhere : sequence of (float, float)
        Hz, and odds that this axis has it: modes of other axes that shine through what TDI hides.
    motion : ((M,), (M,)), optional
        Instants (s) and the motion there as it was estimated before: its even rate over the data is known.
        Needed where lags follow the motion. The ground that a line scans moves by the rate of the scan less
        that of the motion, so that a motion which stops the scan explains every difference: with an even rate
        to choose, the spectrum would be one without tones or jitter.
    rate_seen : bool
        Whether that rate was seen, and is not where something hidden was put.
    settled : float
        Deviance that the last step of the last search gains at most.
    near : bool
        Whether `start` is a fit of nearly these differences: the search goes on from it, and asks about the
        aliases of its tones only where a further tone is found.
    smoothness : bool
        Whether the broadband part may be smoother than it was to begin with.
    usual : Spectrum, optional
        Another axis of the same body. What the data do not show of the broadband part, and of tones that both
        have, is as large as they leave it on average, beforehand about as large as there.

    Raises
    ------
    InputError
        If no measurement is usable.
    """
    used = [s for s in series if s.used.any()]
    if not used:
        raise InputError("no series holds a finite measurement; check the matches of every pair")
    unit = math.sqrt(float(np.median(np.concatenate([s.variance[s.used] for s in used]))))
    scaled = [replace(s, values=s.values / unit, variance=s.variance / unit**2) for s in used]
    grid, inside = _fitting_grid(scaled, step, work)
    rate = None
    if motion is not None:
        rate = EvenRate(float(rate_weights(grid.nodes) @ np.interp(grid.nodes, *motion)) / unit, rate_seen)

    def summed(spectrum: Spectrum | None) -> SeriesEquations:
        return series_equations(
            inside, grid, offsets=offset_sigma is not None, independent=independent, spectrum=spectrum
        )

    offset = 1.0 if offset_sigma is None else offset_sigma / unit
    window = min(s.window for s in scaled)
    rates = () if offset_sigma is None else _rates(scaled)
    search = Search(
        summed(None),
        offset,
        fit_noise,
        grid.step * grid.count,
        corner,
        rates,
        window,
        _tdi(scaled),
        detail * unit**2,
        rate,
        min(s.window_most for s in scaled),
        spread_of(scaled, HIGHEST / grid.step),
    )
    given = None if start is None else NoiseModel.of(start.scaled(1.0 / unit))
    if given is not None and near:
        begins = [given]
    else:
        begins = _begins(search, _guesses(inside, grid), given, anew=max_tones > 0)
    first = FIRST_ITERATIONS if max_tones > 0 or near else iterations
    begun = [search.improve(search.with_given_tones(one, known_tones), first, ROUGHLY) for one in begins]
    model = min(begun, key=search.deviance) if len(begun) > 1 else begun[0]
    begun_with = len(model.tones)
    for _ in range(max_tones - begun_with):
        found = search.unexplained_tones(model, false_alarm)
        if not found:
            break
        model = search.improve(model.with_tone(*found[0]), 10, ROUGHLY)
    if model.tones and not (near and len(model.tones) == begun_with):
        model = search.without_aliases(search.improve(model, 25, ROUGHLY), false_alarm)
    if smoothness:
        model = search.with_smoothness(model)
    # Now that its spectrum is known, what the motion does between nodes need not pass for noise.
    search.use(summed(model.spectrum))
    model = search.without_products(search.without_idle_tones(model))
    model = search.with_doubtful_tones(search.improve(model, iterations, settled, adjusted=True))
    known = [Tone(model.drift.sigma, f, search.narrow(f)) for f in known_tones]
    model = search.with_possible_tones(model, known, false_alarm, known=True)
    scaled_tones = [replace(one, sigma=one.sigma / unit) for one in possible]
    model = search.with_possible_tones(model, scaled_tones, false_alarm)
    if usual is not None:
        model = search.with_usual_sizes(model, usual.scaled(1.0 / unit))
    hidden, through = search.hidden_tones(model, elsewhere)
    products = search.products(model, hidden)
    now = search.posterior(model)
    sizes = [math.sqrt(variance_at(now, tone.frequency)) for tone in model.tones]
    fitted = model.spectrum.scaled(unit)
    order = np.argsort([tone.frequency for tone in model.tones])
    return FittedSpectrum(
        fitted,
        model.noise_scale,
        now.deviance,
        grid.step,
        tuple(model.gains[k] for k in order),
        tuple(sizes[k] * unit for k in order),
        tuple(replace(tone, sigma=tone.sigma * unit) for tone in hidden),
        tuple(replace(tone, sigma=tone.sigma * unit) for tone in products),
        through,
    )


def _begins(
    search: Search, guesses: Sequence[NoiseModel], given: NoiseModel | None, *, anew: bool
) -> list[NoiseModel]:
    """Where the search begins: at the best of all; at the given one also `anew`, with guessed broad parts.

    Drift and broadband part can stand for each other, the one rougher than the other: a search that begins
    where they have changed places does not find back.
    """
    guess = min(guesses, key=search.deviance)
    if given is None or search.deviance(given) >= search.deviance(guess):
        return [guess]
    return [given, replace(given, drift=guess.drift, broadband=guess.broadband)] if anew else [given]


def default_step(series: Sequence[DifferenceSeries]) -> float:
    """Grid step (s) for a set of series: a seventh of the shortest lag, within 1/5 to 1 sampling step."""
    shortest = math.inf
    for s in series:
        if s.used.any():
            shortest = min(shortest, float(np.median(np.abs(s.lag[s.used]))))
    spacing = _spacing(series)
    return float(np.clip(shortest / 7.0, spacing / 5.0, spacing))


def fitting_step(series: Sequence[DifferenceSeries], work: float = WORK) -> float:
    """Grid step (s) on which `fit_spectrum` fits a set of series as a whole, or most of it, by default."""
    first, last = span(series)
    usual = default_step(series)
    # at a node to a row, a tone of more than a third of their rate bends between nodes: what rows hold of
    # it would pass for noise, and the noise of rows for jitter
    finest = min(usual, _spacing(series) / NODES_IN_ROW)
    whole = ((last - first) * _longest_lag(series) ** 2 / work) ** (1 / 3)
    return float(np.clip(whole, finest, 3.0 * usual))


def _longest_lag(series: Sequence[DifferenceSeries]) -> float:
    """s; of all measurements of all series."""
    return max(float(np.max(np.abs(s.lag[s.used]))) for s in series if s.used.any())


def _spacing(series: Sequence[DifferenceSeries]) -> float:
    """Sampling step (s) of the most densely sampled series."""
    steps = [np.diff(np.unique(s.t[s.used])) for s in series]
    if not any(len(one) for one in steps):
        raise InputError("the series hold fewer than two measurement times; give `grid_step`")
    return min(float(np.median(one)) for one in steps if len(one))


def _rates(series: Sequence[DifferenceSeries]) -> tuple[float, ...]:
    """Rates (Hz) at which the series are sampled evenly."""
    rates = set()
    for s in series:
        steps = np.diff(np.unique(s.t[s.used]))
        if len(steps):
            rates.add(float(f"{1.0 / float(np.median(steps)):.6g}"))
    return tuple(sorted(rates))


def spread_of(series: Sequence[DifferenceSeries], highest: float) -> float:
    """Length (s) of data of even weights that tell frequencies up to `highest` (Hz) apart as these do.

    Notes
    -----
    By how much a wave's share in all differences, of one size, changes with its frequency: with the instants
    midway between the two of each difference, and, where lags differ, with what each pair sees of it.
    """
    weight = [1.0 / one.variance[one.used] for one in series]
    middle = [(one.t + 0.5 * one.lag)[one.used] for one in series]
    about = float(np.average(np.concatenate(middle), weights=np.concatenate(weight)))
    lag = np.array([np.average(one.lag[one.used], weights=w) for one, w in zip(series, weight, strict=True)])
    n, first, second = (
        np.array([w @ (m - about) ** power for w, m in zip(weight, middle, strict=True)])[:, None]
        for power in range(3)
    )
    phase = math.pi * np.outer(lag, (np.arange(SPREAD_PLACES) + 0.5) / SPREAD_PLACES * highest)
    seen, change = np.sin(phase), 0.5 * lag[:, None] * np.cos(phase)
    whole = np.maximum((n * seen**2).sum(axis=0), 1e-300)
    moved = (n * change**2 + second * seen**2).sum(axis=0) / whole
    alike = ((n * seen * change).sum(axis=0) ** 2 + (first * seen**2).sum(axis=0) ** 2) / whole**2
    return float(np.sqrt(12.0 * np.maximum(moved - alike, 0.0)).mean())


def _tdi(series: Sequence[DifferenceSeries]) -> tuple[float, ...]:
    """Times (s) that TDI averages over in the images."""
    return tuple(sorted({each for s in series for each in s.tdi}))


def span(series: Sequence[DifferenceSeries]) -> tuple[float, float]:
    """First and last instant that the series touch (s), windows included."""
    edges = []
    for s in series:
        t = np.concatenate([s.t[s.used], (s.t + s.lag)[s.used]])
        if len(t):
            edges += [t.min() - 0.5 * s.whole, t.max() + 0.5 * s.whole]
    return float(min(edges)), float(max(edges))


def _fitting_grid(
    series: Sequence[DifferenceSeries], step: float | None, work: float
) -> tuple[Grid, list[DifferenceSeries]]:
    """Grid for the fit, coarse or short enough for `work`, and the measurements on it."""
    first, last = span(series)
    lag = _longest_lag(series)
    step = fitting_step(series, work) if step is None else step
    length = max(work * step**3 / lag**2, 4.0 * lag)
    if length < 0.9 * (last - first):
        middle = 0.5 * (first + last)
        first, last = middle - 0.5 * length, middle + 0.5 * length
        series = [_within(s, first, last) for s in series]
        series = [s for s in series if s.used.any()]
        first, last = span(series)
    return Grid.covering(first, last, step), list(series)


def _within(s: DifferenceSeries, first: float, last: float) -> DifferenceSeries:
    """The measurements of a series whose both instants lie in an interval."""
    low = np.minimum(s.t, s.t + s.lag) - 0.5 * s.whole
    high = np.maximum(s.t, s.t + s.lag) + 0.5 * s.whole
    keep = (low >= first) & (high <= last)
    patch = None if s.patch is None else s.patch[keep]
    return replace(
        s, t=s.t[keep], lag=s.lag[keep], values=s.values[keep], variance=s.variance[keep], patch=patch
    )


def _guesses(series: Sequence[DifferenceSeries], grid: Grid) -> list[NoiseModel]:
    """Drifts and broadband parts of about the data's size, from how the differences grow with the lag."""
    length = grid.step * grid.count
    lags, excess = [], []
    for s in series:
        noise = float(np.mean(s.variance[s.used]))
        lags.append(float(np.median(np.abs(s.lag[s.used]))))
        excess.append(max(float(np.mean(s.values[s.used] ** 2)) - noise, 0.01 * noise))
    shortest, longest = int(np.argmin(lags)), int(np.argmax(lags))
    timescale = max(0.5 * length, 2.0 * lags[longest])
    # Matern 5/2 at short lag: E[difference^2] = (5/3) sigma^2 lag^2 / timescale^2.
    drift = Matern(math.sqrt(0.6 * excess[longest]) * timescale / lags[longest], timescale, "5/2")
    sizes = math.sqrt(0.5 * excess[shortest]) * np.array([1.0, 0.3, 0.1, 0.03])
    times = np.clip(np.array([2e-3, 8e-3, 32e-3]), 2.0 * grid.step, max(0.1 * length, 2.0 * grid.step))
    return [NoiseModel(drift, Matern(float(s), float(t), "3/2")) for s in sizes for t in np.unique(times)]
