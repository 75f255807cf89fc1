"""The spectrum of a motion from its differences alone: no frequency, size or noise level is given.

Drift (Matern 5/2), broadband jitter (Matern 3/2), tones and the noise's scale maximise the exact
marginal likelihood. Tones are found first, one by one, by a spectrum of what the present model does
not explain; it accounts for the lags, the windows, the gaps and the aliases, so that a tone above the
Nyquist frequency of the measurements is found where it is as long as the lags tell it apart.

Not here: the likelihood itself (``evidence.py``), the final estimate (``motion/estimators/smoother.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.evidence import Posterior, band_times, posterior
from sightline.estimation.prior import Matern, Spectrum, Tone, autoregressive
from sightline.estimation.series import DifferenceSeries, Grid, NormalEquations, normal_equations

Array = NDArray[np.float64]

#: Order of the autoregression while fitting; the spectra it tells apart are broad or poles.
ORDER = 40
#: Work allowed per evaluation, n b^2; about 40 ms. Longer strips are fitted on a coarser grid.
WORK = 1.0e8
#: Candidates whose significance is computed exactly in each scan for tones.
CANDIDATES = 32
#: An alias is believed the less the higher its frequency, as the f^-4 of jitter spectra: it must lower the
#: deviance by this times the logarithm of the frequencies' ratio.
ALIAS_PENALTY = 8.0
#: Half-width of the weak Gaussian belief about every log parameter: a factor of e^3 about its start.
BELIEF = 3.0
#: The same of a tone's bandwidth, about one over the length of the data: below that a bandwidth hardly
#: shows, and one that is too narrow costs more than one that is too wide.
BANDWIDTH_BELIEF = 1.2


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
        s; grid step of the fit. Nothing above about 0.3 / step was looked for.
    significance : tuple of float
        Of each tone of `spectrum.tones`: log-likelihood gained by a sinusoid there, when it was found.
    """

    spectrum: Spectrum
    noise_scale: float
    deviance: float
    step: float
    significance: tuple[float, ...] = ()


def fit_spectrum(
    series: Sequence[DifferenceSeries],
    *,
    step: float | None = None,
    start: Spectrum | None = None,
    max_tones: int = 8,
    false_alarm: float = 1e-3,
    fit_noise: bool = True,
    offset_sigma: float | None = None,
    independent: float = 0.0,
    iterations: int = 60,
) -> FittedSpectrum:
    """Spectrum and noise scale of a motion by marginal likelihood, tones found blind.

    Parameters
    ----------
    series : sequence of DifferenceSeries
        All pairs, in one unit.
    step : float, optional
        s; grid step. By default as `default_step`, coarser on long strips (see `WORK`).
    start : Spectrum, optional
        Where to start: its first two Matern components and its tones. By default from the data's size.
    max_tones : int
        At most this many tones, those of `start` included; 0 looks for none.
    false_alarm : float
        Probability of one false tone in pure noise.
    fit_noise : bool
        Whether the variances are scaled by a fitted factor.
    offset_sigma : float, optional
        Prior sigma of an unknown constant of every image; none by default.
    independent : float
        See `normal_equations`.
    iterations : int
        Of the last search.

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
    grid, inside = _fitting_grid(scaled, step)

    def summed(spectrum: Spectrum | None) -> NormalEquations:
        return normal_equations(
            inside, grid, offsets=offset_sigma is not None, independent=independent, spectrum=spectrum
        )

    offset = 1.0 if offset_sigma is None else offset_sigma / unit
    search = _Search(summed(None), offset, fit_noise, grid.step * grid.count)
    guesses = _guesses(inside, grid) if start is None else [_Model.of(start.scaled(1.0 / unit))]
    model = search.improve(min(guesses, key=search.deviance), iterations if max_tones == 0 else 12)
    for _ in range(max_tones - len(model.tones)):
        found = search.unexplained_tones(model, false_alarm)
        if not found:
            break
        model = search.improve(model.with_tone(*found[0]), 10)
    if model.tones:
        model = search.without_aliases(search.improve(model, 25), false_alarm)
    # Now that its spectrum is known, what the motion does between nodes need not pass for noise.
    search.use(summed(model.spectrum))
    model = search.improve(search.without_idle_tones(model), iterations)
    fitted = model.spectrum.scaled(unit)
    order = np.argsort([tone.frequency for tone in model.tones])
    return FittedSpectrum(
        fitted, model.noise_scale, search.deviance(model), grid.step, tuple(model.gains[k] for k in order)
    )


def default_step(series: Sequence[DifferenceSeries]) -> float:
    """Grid step (s) for a set of series: a seventh of the shortest lag, within 1/5 to 1 sampling step."""
    spacing, shortest = math.inf, math.inf
    for s in series:
        t = np.unique(s.t[s.used])
        if len(t) > 1:
            spacing = min(spacing, float(np.median(np.diff(t))))
        if len(t):
            shortest = min(shortest, float(np.median(np.abs(s.lag[s.used]))))
    if not math.isfinite(spacing):
        raise InputError("the series hold fewer than two measurement times; give `grid_step`")
    return float(np.clip(shortest / 7.0, spacing / 5.0, spacing))


def span(series: Sequence[DifferenceSeries]) -> tuple[float, float]:
    """First and last instant that the series touch (s), windows included."""
    edges = []
    for s in series:
        t = np.concatenate([s.t[s.used], (s.t + s.lag)[s.used]])
        if len(t):
            edges += [t.min() - 0.5 * s.window, t.max() + 0.5 * s.window]
    return float(min(edges)), float(max(edges))


def _fitting_grid(
    series: Sequence[DifferenceSeries], step: float | None
) -> tuple[Grid, list[DifferenceSeries]]:
    """Grid for the fit, coarse or short enough for `WORK`, and the measurements on it."""
    first, last = span(series)
    lag = max(float(np.max(np.abs(s.lag[s.used]))) for s in series)
    if step is None:
        finest = default_step(series)
        step = float(np.clip(((last - first) * lag**2 / WORK) ** (1 / 3), finest, 3.0 * finest))
    length = max(WORK * step**3 / lag**2, 4.0 * lag)
    if length < 0.9 * (last - first):
        middle = 0.5 * (first + last)
        first, last = middle - 0.5 * length, middle + 0.5 * length
        series = [_within(s, first, last) for s in series]
        series = [s for s in series if s.used.any()]
        first, last = span(series)
    return Grid.covering(first, last, step), list(series)


def _within(s: DifferenceSeries, first: float, last: float) -> DifferenceSeries:
    """The measurements of a series whose both instants lie in an interval."""
    low = np.minimum(s.t, s.t + s.lag) - 0.5 * s.window
    high = np.maximum(s.t, s.t + s.lag) + 0.5 * s.window
    keep = (low >= first) & (high <= last)
    patch = None if s.patch is None else s.patch[keep]
    return DifferenceSeries(
        s.t[keep], s.lag[keep], s.values[keep], s.variance[keep], s.images, s.window, patch
    )


@dataclass(frozen=True)
class _Model:
    """Present values of all hyper-parameters, in units of the noise."""

    drift: Matern
    broadband: Matern
    tones: tuple[Tone, ...] = ()
    noise_scale: float = 1.0
    gains: tuple[float, ...] = ()

    @classmethod
    def of(cls, spectrum: Spectrum) -> _Model:
        broad = [c for c in spectrum.components if isinstance(c, Matern)]
        if len(broad) < 2:
            raise InputError(f"`start` needs two Matern components, drift and broadband, got {len(broad)}")
        broad.sort(key=lambda c: -c.timescale)
        return cls(broad[0], broad[1], spectrum.tones, gains=(math.nan,) * len(spectrum.tones))

    @property
    def spectrum(self) -> Spectrum:
        return Spectrum((self.drift, self.broadband, *sorted(self.tones, key=lambda tone: tone.frequency)))

    def with_tone(self, tone: Tone, gain: float) -> _Model:
        return replace(self, tones=(*self.tones, tone), gains=(*self.gains, gain))

    def without_tone(self, k: int) -> _Model:
        return replace(
            self, tones=self.tones[:k] + self.tones[k + 1 :], gains=self.gains[:k] + self.gains[k + 1 :]
        )


def _guesses(series: Sequence[DifferenceSeries], grid: Grid) -> list[_Model]:
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
    return [_Model(drift, Matern(float(s), float(t), "3/2")) for s in sizes for t in np.unique(times)]


class _Search:
    """Maximises the evidence of one set of normal equations over the models."""

    def __init__(
        self, equations: NormalEquations, offset_sigma: float, fit_noise: bool, length: float
    ) -> None:
        self._equations = equations
        self._offset_sigma = offset_sigma
        self._fit_noise = fit_noise
        self._length = length
        self._order = min(ORDER, equations.grid.count - 1)
        self._lags = equations.grid.step * np.arange(self._order + 1, dtype=np.float64)

    def use(self, equations: NormalEquations) -> None:
        """Go on with other equations on the same grid."""
        self._equations = equations

    def posterior(self, model: _Model) -> Posterior:
        """Posterior under a model."""
        prior = autoregressive(
            model.spectrum.autocovariance(self._lags), self._order, self._equations.grid.count
        )
        return posterior(
            self._equations, prior, noise_scale=model.noise_scale, offset_sigma=self._offset_sigma
        )

    def deviance(self, model: _Model) -> float:
        """-2 log evidence of a model."""
        return self.posterior(model).deviance

    # -- parameters as one vector: logarithms, and frequencies in units of 3 / length ---------------

    def _vector(self, model: _Model) -> Array:
        x = [math.log(v) for c in (model.drift, model.broadband) for v in (c.sigma, c.timescale)]
        for tone in model.tones:
            x += [math.log(tone.sigma), 0.0, math.log(tone.bandwidth)]
        return np.array([*x, math.log(model.noise_scale)])

    def _model(self, x: Array, origin: _Model) -> _Model:
        tones = []
        for k, tone in enumerate(origin.tones):
            log_sigma, shift, log_width = x[4 + 3 * k : 7 + 3 * k]
            frequency = tone.frequency + 3.0 * shift / self._length
            tones.append(Tone(math.exp(log_sigma), frequency, math.exp(log_width)))
        return replace(
            origin,
            drift=Matern(math.exp(x[0]), math.exp(x[1]), "5/2"),
            broadband=Matern(math.exp(x[2]), math.exp(x[3]), "3/2"),
            tones=tuple(tones),
            noise_scale=math.exp(x[-1]),
        )

    def _bounds(self, model: _Model) -> list[tuple[float, float]]:
        step, length = self._equations.grid.step, self._length
        drift = max(model.drift.sigma, 1.0)
        bounds = [
            (math.log(1e-3), math.log(30.0 * drift)),
            (math.log(20.0 * step), math.log(20.0 * length)),
            (math.log(1e-3), math.log(30.0 * drift)),
            (math.log(0.2 * step), math.log(0.2 * length)),
        ]
        for tone in model.tones:
            farthest = min(1.0, 0.2 * tone.frequency * length)
            widest = max(10.0 / length, 0.1 * tone.frequency)
            bounds += [
                (math.log(1e-3), math.log(30.0 * drift)),
                (-farthest, farthest),
                (math.log(0.02 / length), math.log(widest)),
            ]
        bounds.append((math.log(0.2), math.log(5.0)) if self._fit_noise else (0.0, 0.0))
        return bounds

    def improve(self, model: _Model, iterations: int) -> _Model:
        """The best model within some iterations of L-BFGS from `model`; never worse than it."""
        from scipy.optimize import minimize

        origin = model
        x0 = self._vector(model)
        bounds = self._bounds(model)
        x0 = np.clip(x0, [b[0] for b in bounds], [b[1] for b in bounds])
        pull = np.full(len(x0), BELIEF**-2)
        centre = x0.copy()
        pull[5:-1:3] = 0.0  # frequencies: bounded, not believed
        pull[6:-1:3], centre[6:-1:3] = BANDWIDTH_BELIEF**-2, -math.log(self._length)
        best: list[tuple[float, Array]] = [(math.inf, x0)]

        def objective(x: Array) -> tuple[float, Array]:
            try:
                value, slope = self._value_and_slope(self._model(x, origin))
            except (EstimationError, InputError):
                return 1e30, np.zeros_like(x)
            value += float(pull @ (x - centre) ** 2)
            if value < best[0][0]:
                best[0] = (value, x.copy())
            return value, slope + 2.0 * pull * (x - centre)

        scale = max(1.0, abs(objective(x0)[0]))
        minimize(
            objective, x0, jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": iterations, "ftol": 0.05 / scale, "gtol": 0.1, "maxcor": 20},
        )  # fmt: skip
        return self._model(best[0][1], origin)

    def _value_and_slope(self, model: _Model) -> tuple[float, Array]:
        """Deviance and its derivatives: through the moments of the posterior, at the cost of one."""
        now = self.posterior(model)
        moments = now.moments
        total = model.spectrum.autocovariance(self._lags)
        x = self._vector(model)
        slope = np.zeros(len(x))
        step = 1e-3
        for k in range(len(x) - 1):
            sides = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[k] += sign * step
                changed = self._model(moved, model)
                old, new = _component(model, k), _component(changed, k)
                r = total + new.autocovariance(self._lags) - old.autocovariance(self._lags)
                sides.append(moments.expected_deviance(autoregressive(r, self._order, now.prior.n)))
            slope[k] = (sides[0] - sides[1]) / (2.0 * step)
        if self._fit_noise:
            slope[-1] = now.deviance_by_noise_scale
        return now.deviance, slope

    # -- tones ------------------------------------------------------------------------------------

    def unexplained_tones(self, model: _Model, false_alarm: float) -> list[tuple[Tone, float]]:
        """Sinusoids that the model does not explain, each with its gain, the most significant first.

        Notes
        -----
        Score test. With u = Q m (prior precision times posterior mean) and c = exp(2 pi i f t),
        |c'u|^2 has the expectation c'Fc, F = Q Z N (Z the posterior covariance, N the data's
        information), and their ratio is the log-likelihood that a sinusoid at f would gain. It is
        computed for all f with F of a stationary problem, then exactly for the highest peaks.
        """
        now = self.posterior(model)
        u = band_times(now.prior_band, now.mean)
        frequency, ratio = self._approximate_gain(now, u)
        lowest, highest = 2.0 / self._length, 0.3 / self._equations.grid.step
        known = [tone.frequency for tone in model.tones]
        usable = (frequency > lowest) & (frequency < highest)
        for f in known:
            usable &= np.abs(frequency - f) > 1.5 / self._length
        peak = np.zeros(len(ratio), dtype=bool)
        peak[1:-1] = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] > ratio[2:])
        where = np.flatnonzero(peak & usable)
        where = where[np.argsort(-ratio[where])[:CANDIDATES]]
        power, expected = self._exact_gain(now, u, frequency[where])
        gain = power / expected
        threshold = math.log(highest * self._length / false_alarm)
        tones = []
        for k in np.argsort(-gain):
            if gain[k] > threshold:
                # Amplitude^2 = 4 power / expected^2; half of it is the variance.
                sigma = math.sqrt(2.0 * float(power[k])) / float(expected[k])
                tones.append((Tone(sigma, float(frequency[where[k]]), 1.0 / self._length), float(gain[k])))
        return tones

    def without_aliases(self, model: _Model, false_alarm: float) -> _Model:
        """The model with every tone moved to another frequency where that explains the data better.

        Differences sampled coarsely see a tone at several frequencies almost alike. Which of them it
        is shows only once the other tones are known.
        """
        for k, tone in enumerate(model.tones):
            others = model.without_tone(k)
            rivals = self.unexplained_tones(others, false_alarm)
            # A gain is a log-likelihood: what lies 20 below the best is no rival.
            rivals = [r for r in rivals if r[1] > rivals[0][1] - 20.0]
            for rival, gain in rivals:
                if abs(rival.frequency - tone.frequency) < 3.0 / self._length:
                    continue
                place = Tone(rival.sigma, rival.frequency, min(tone.bandwidth, 0.1 * rival.frequency))
                moved = self.improve(others.with_tone(place, gain), 25)
                if self._alias_score(moved, -1) < self._alias_score(model, k):
                    # Keep the place of the tone in the list, over which the loop runs.
                    tones, gains = list(moved.tones), list(moved.gains)
                    tones.insert(k, tones.pop())
                    gains.insert(k, gains.pop())
                    model = replace(moved, tones=tuple(tones), gains=tuple(gains))
        return model

    def _alias_score(self, model: _Model, k: int) -> float:
        """Deviance plus what is held against a tone for the height of its frequency."""
        return self.deviance(model) + ALIAS_PENALTY * math.log(model.tones[k].frequency)

    def _approximate_gain(self, now: Posterior, u: Array) -> tuple[Array, Array]:
        """Frequencies (Hz) and score with the expectation of a stationary problem."""
        from scipy.fft import next_fast_len, rfft, rfftfreq

        grid = now.equations.grid
        size = next_fast_len(8 * grid.count)
        power = np.abs(np.asarray(rfft(u, size))) ** 2
        symbols = []
        for band in (now.prior_band, now.equations.band / now.noise_scale):
            diagonals = band.sum(axis=1)
            symbols.append(np.maximum(2.0 * np.asarray(rfft(diagonals, size)).real - diagonals[0], 0.0))
        expected = symbols[0] * symbols[1] / (symbols[0] + symbols[1])
        expected = np.maximum(expected, 1e-6 * expected.max())
        return np.asarray(rfftfreq(size, grid.step)), power / expected

    def _exact_gain(self, now: Posterior, u: Array, frequency: Array) -> tuple[Array, Array]:
        """|c'u|^2 and its expectation at some frequencies."""
        e = now.equations
        phase = 2.0 * math.pi * np.outer(e.grid.step * np.arange(e.grid.count), frequency)
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        data = band_times(e.band, waves) / now.noise_scale
        explained, _ = now.factor.solve(data, e.border.T @ waves / now.noise_scale)
        expected = np.sum(band_times(now.prior_band, waves) * explained, axis=0)
        half = len(frequency)
        power = (u @ waves) ** 2
        expected = np.maximum(expected, 1e-12 * float(np.max(expected, initial=1.0)))
        return power[:half] + power[half:], expected[:half] + expected[half:]

    def without_idle_tones(self, model: _Model) -> _Model:
        """The model less every tone that three parameters do not pay for (Akaike)."""
        for k in reversed(range(len(model.tones))):
            fewer = model.without_tone(k)
            present = self.deviance(model)
            if self.deviance(fewer) > present + 30.0:
                continue
            fewer = self.improve(fewer, 10)
            if self.deviance(fewer) < present + 6.0:
                model = fewer
        return model


def _component(model: _Model, parameter: int) -> Matern | Tone:
    """The part of the spectrum to which a parameter of the vector belongs."""
    if parameter < 4:
        return (model.drift, model.broadband)[parameter // 2]
    return model.tones[(parameter - 4) // 3]
