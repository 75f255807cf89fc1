"""Search for the spectrum that explains a set of differences best: drift, broadband part and tones.

Gradient search over all parameters at once, and a scan for tones that the present model leaves.

Not here: the steps in their order (``likelihood.py``), the evidence of one model (``evidence.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.evidence import EvenRate, Posterior, posterior
from sightline.estimation.prior import ORDERS, Matern, Spectrum, Tone, autoregressive
from sightline.estimation.series import SeriesEquations

Array = NDArray[np.float64]

#: Order of the autoregressive priors. One that looks back less than a period of tones or of their difference,
#: or less than drift and jitter take to part, makes the motion over longer lags up to twice as large as the
#: spectrum says, and the fit then makes the jitter too small: by up to ten times at 80 steps of .2 ms, with
#: sigmas half of what they should be. The band of the data's rows is about as wide anyway.
ORDER = 160
#: Candidates whose significance is computed exactly in each scan for tones.
CANDIDATES = 32
#: An alias is believed the less the higher its frequency, as the f^-4 of jitter spectra: it must lower the
#: deviance by this times the logarithm of the frequencies' ratio.
ALIAS_PENALTY = 8.0
#: Half-width of the weak Gaussian belief about every log parameter: a factor of e^3 about its start.
BELIEF = 3.0
#: Bandwidth that a tone is believed to have, as weakly as all other parameters, and the least, in units of
#: one over the length of the data: an oscillator of the first loses a quarter of itself in it. Where noise is
#: small, a belief in wider tones, or a larger least width, makes a tone that does not die smaller than it is,
#: and gives it jitter of frequencies beside it that the broadband part then lacks.
USUAL_WIDTH, LEAST_WIDTH = 0.1, 2e-4
#: In short data no tone is believed to be wider than this share of its frequency, twice the damping of a
#: structure: as wide as the data are short, every tone would bring jitter of many frequencies.
WIDEST = 0.03
#: The same of the corner of the broadband part where another axis of the same body shows it: a factor of 2.
CORNER_BELIEF = 0.7
#: Least bandwidth of a tone that another axis shows, in units of one over the length of the data: its
#: frequency is not known better.
NARROWEST = 0.1
#: A smoother broadband part is believed when it lowers the deviance by this much (Akaike's price of a
#: parameter, thrice: there are three steps to take), and by what noise gains whose spectrum is even only to
#: such a share, the square of it for each measurement: rows that share a few pixels have less of it at high
#: frequencies, and a smoother part would stand for that.
SMOOTHER, EVEN = 6.0, 0.1
#: Steps after which that must show.
SMOOTHER_STEPS = 6
#: Lowest frequency of a tone, in units of one over the length of the data.
SLOWEST = 2.0
#: Tones nearer to the rate of the differences than this, in units of one over the length of the data, turn by
#: so few periods against it that offsets of the images, and drifts, take their place.
NEAR_RATE = 4.0
#: Tones nearer than this, in units of one over the length of the data, are one mode, of one axis or of two.
SAME_TONE = 1.5
#: Highest frequency of a tone that is looked for, in units of one over the step of the grid.
HIGHEST = 0.3
#: Highest frequency of a tone that is looked for, in units of one over the time that a measurement averages
#: over: a quarter of such a tone is left in it.
SEEN_THROUGH = 0.8
#: Least share of a tone that TDI leaves where tones are looked for: what images show of the motion is its
#: mean over the stages but for some thousandths of a pixel, which would pass for a tone many times as large
#: (see `Search.hidden_tones`).
LEFT_BY_TDI = 0.15
#: Share from which on a tone is sure not to be what a hidden one displaces matches by.
SEEN_PLAINLY = 0.25
#: Places whose gain is looked at more closely.
CREST = 8
#: What TDI may hide is looked at up to this over the shortest time that it averages over, at no more places;
#: least share that the rows are taken to have of it.
HIDDEN_TO, MOST_HIDDEN, LEAST_LEFT = 4.0, 600, 5e-3
#: Stages by which the mean over all is taken.
STAGES = 32
#: A complex Gaussian of unit variance, in equally likely parts.
_DRAWS = np.outer(
    np.sqrt(-np.log1p(-(np.arange(4) + 0.5) / 4.0)), np.exp(2j * math.pi * (np.arange(6) + 0.5) / 6.0)
).ravel()
#: A sigma holds in .683 of all cases: modes that are there more seldom than in the others are not owned, nor
#: do they count for other axes.
SELDOM = 0.317
#: Modes of less than this share of the usual strength do not count.
COUNTS = 0.2
#: The strongest place there is a mode, of which products are made, at this probability of chance.
HARDLY_CHANCE = 1e-3
#: Least time scale of the broadband part, as a share of that time: quicker jitter is averaged away, and what
#: the rows hold of it is like the noise of the measurements.
QUICKEST = 0.3
#: Deviance that the last step of a search gains at most, and one after which the search goes on otherwise:
#: what tells models apart is 6 and more.
SETTLED, ROUGHLY = 0.1, 1.0
#: The same of a search whose end must not depend on the way that led to it, nor on rounding: parameters that
#: hardly matter still move the motion by some thousandths of its sigma.
CLOSELY = 1e-5
#: A search may move a tone so far from where a sinusoid explained most, farther where it is wider; one that
#: explains more so far from a tone is a rival of it. In units of one over the length of the data.
STRAYS = NEAREST_RIVAL = 0.5
#: The widest tone moves no farther than so, in the same units.
STRAYS_MOST = 3.0
#: A step of the search goes no farther in any parameter (logarithms), and is shortened so many times at most.
FARTHEST_STEP, HALVINGS = 1.5, 6
#: Second derivatives of the deviance by the logarithms of a tone's size and width, about.
TONE_SIZE, TONE_WIDTH = 40.0, 8.0
#: What steps of the drift's size and time scale are held back by.
DRIFT_RIDGE = 10.0
#: The likelihood is multiplied by so many powers of the drift's standard deviation: by its variance (see
#: `drift_adjustment`).
ADJUSTED = 2.0
#: A part of a motion is shown where a size half as large again, and one as much smaller, raise the deviance
#: by this much (Akaike's price of a parameter, twice); sizes are looked at so many to a factor of e.
SHOWN_BY, SIZES = 4.0, 2.0
#: The broadband part, among numbers of tones.
BROADBAND = -1
#: How far a tone may be from where it was found, in units of one over the length of the data, and at how many
#: places; its frequency tells its size where it is seen alike, to this share, wherever it may be.
DOUBT, DOUBT_PLACES, CLEAR = 1.0, 101, 0.05
#: Values of waves that are held at a time.
_WAVES = 300_000
#: Steps of the logarithm of the noise's scale by which its best one is found beside a size.
SCALE_STEP = 0.1
#: Least and largest scale of the noise.
NOISE_SCALES = (0.2, 5.0)
#: Windows overlap where they are longer than so many times what lies between two rows.
OVERLAPPING = 1.2
#: Longest time scale of a drift, in lengths of the data: longer ones look alike in them, but claim ever more
#: where measurements leave the drift to the prior.
LONGEST_DRIFT = 1.0


@dataclass(frozen=True)
class NoiseModel:
    """Present values of all hyper-parameters, in units of the noise.

    Attributes
    ----------
    drift, broadband : Matern
        The drift of order 5/2, the broadband part of any.
    tones : tuple of Tone
        In the order they were found; `gains` are their significances, infinite for those known beforehand,
        `places` the frequencies (Hz) at which a sinusoid explained most when they were found.
    noise_scale : float
        Factor on the measurement variances.
    """

    drift: Matern
    broadband: Matern
    tones: tuple[Tone, ...] = ()
    noise_scale: float = 1.0
    gains: tuple[float, ...] = ()
    places: tuple[float, ...] = ()

    @classmethod
    def of(cls, spectrum: Spectrum) -> NoiseModel:
        """The model that a spectrum describes; further Matern parts are left out."""
        parts = [c for c in spectrum.components if isinstance(c, Matern)]
        drift = next((c for c in parts if c.order == "5/2"), None)
        broadband = next((c for c in parts if c is not drift), None)
        if drift is None or broadband is None:
            raise InputError('`start` needs a Matern component of order "5/2" and another for the broadband')
        places = tuple(tone.frequency for tone in spectrum.tones)
        return cls(drift, broadband, spectrum.tones, gains=(math.nan,) * len(places), places=places)

    @property
    def spectrum(self) -> Spectrum:
        """All parts, tones by rising frequency."""
        return Spectrum((self.drift, self.broadband, *sorted(self.tones, key=lambda tone: tone.frequency)))

    def with_tone(self, tone: Tone, gain: float) -> NoiseModel:
        """The model and one more tone, at the end of the list."""
        return replace(
            self,
            tones=(*self.tones, tone),
            gains=(*self.gains, gain),
            places=(*self.places, tone.frequency),
        )

    def without_tone(self, k: int) -> NoiseModel:
        """The model less its tone number `k`."""
        return self._each(lambda listed: (*listed[:k], *listed[k + 1 :]))

    def with_last_tone_at(self, k: int) -> NoiseModel:
        """The model with the last of its tones as number `k` of the list."""
        return self._each(lambda listed: (*listed[:k], listed[-1], *listed[k:-1]))

    def _each(self, change: Callable[[tuple[Any, ...]], tuple[Any, ...]]) -> NoiseModel:
        """The model with a change of the list of its tones."""
        return replace(self, tones=change(self.tones), gains=change(self.gains), places=change(self.places))


class Search:
    """Maximises the evidence of one set of normal equations over the models.

    Parameters
    ----------
    equations : NormalEquations
        The data, in units of the noise.
    offset_sigma : float
        Of the images' constants, in the same unit.
    fit_noise : bool
        Whether the noise scale is a parameter.
    length : float
        s; of the data: its inverse is the resolution in frequency.
    corner : float, optional
        Hz; where the broadband part is believed to bend, within CORNER_BELIEF.
    rates : sequence of float
        Hz; at which differences are sampled: a tone there, or at a multiple, is a constant of every image,
        and none is looked for.
    window : float
        s; over which measurements average.
    tdi : sequence of float
        s; over which TDI averages in the images: no tone is looked for where all leave less than LEFT_BY_TDI.
    detail : float
        Mean square of the (angular) frequencies that matches weigh, per unit squared of the differences.
    rate : EvenRate, optional
        Of the motion, per s; see `posterior`.
    window_most : float
        s; over which windows of coarse lines may average, 0 where `window` is what they do.
    spread : float, optional
        s; length of data of even weights that tell frequencies apart as these do: less than `length` where
        lags are long. What chance gains counts by it.
    """

    def __init__(
        self,
        equations: SeriesEquations,
        offset_sigma: float,
        fit_noise: bool,
        length: float,
        corner: float | None = None,
        rates: Sequence[float] = (),
        window: float = 0.0,
        tdi: Sequence[float] = (),
        detail: float = 0.0,
        rate: EvenRate | None = None,
        window_most: float = 0.0,
        spread: float | None = None,
    ) -> None:
        self._rate = rate
        self._spread = length if spread is None else spread
        self._tdi = tuple(tdi)
        self._detail = detail
        self._corner = corner
        self._window, self._coarse = window, window_most
        self._highest = min(HIGHEST / equations.grid.step, SEEN_THROUGH / max(window, window_most, 1e-12))
        # windows that overlap: rows follow each other faster than what they can show
        overlap = window * max(rates, default=0.0) > OVERLAPPING
        self._quickest = QUICKEST * window if overlap else 0.0
        self._rates = tuple(rates)
        self._equations = equations
        self._offset_sigma = offset_sigma
        self._fit_noise = fit_noise
        self._length = length
        self._order = min(ORDER, equations.grid.count - 1)
        self._lags = equations.grid.step * np.arange(self._order + 1, dtype=np.float64)

    def gain_of_chance(self, false_alarm: float) -> float:
        """Log-likelihood that noise alone gains somewhere with that probability; see the function."""
        return gain_of_chance((self._highest - SLOWEST / self._length) * self._spread, false_alarm)

    def use(self, equations: SeriesEquations) -> None:
        """Go on with other equations on the same grid."""
        self._equations = equations

    def posterior(self, model: NoiseModel) -> Posterior:
        """Posterior under a model."""
        prior = autoregressive(
            model.spectrum.autocovariance(self._lags), self._order, self._equations.grid.count
        )
        return posterior(
            self._equations,
            prior,
            noise_scale=model.noise_scale,
            offset_sigma=self._offset_sigma,
            rate=self._rate,
        )

    def deviance(self, model: NoiseModel) -> float:
        """-2 log evidence of a model."""
        return self.posterior(model).deviance

    # -- parameters as one vector: logarithms, and frequencies in units of 3 / length ---------------

    def _vector(self, model: NoiseModel) -> Array:
        x = [math.log(v) for c in (model.drift, model.broadband) for v in (c.sigma, c.timescale)]
        for tone in model.tones:
            x += [math.log(tone.sigma), 0.0, math.log(tone.bandwidth)]
        return np.array([*x, math.log(model.noise_scale)])

    def _model(self, x: Array, origin: NoiseModel) -> NoiseModel:
        tones = []
        for k, tone in enumerate(origin.tones):
            log_sigma, shift, log_width = x[4 + 3 * k : 7 + 3 * k]
            frequency = tone.frequency + STRAYS_MOST * shift / self._length
            tones.append(Tone(math.exp(log_sigma), frequency, math.exp(log_width)))
        return replace(
            origin,
            drift=Matern(math.exp(x[0]), math.exp(x[1]), "5/2"),
            broadband=Matern(math.exp(x[2]), math.exp(x[3]), origin.broadband.order),
            tones=tuple(tones),
            noise_scale=math.exp(x[-1]),
        )

    def _bounds(self, model: NoiseModel) -> list[tuple[float, float]]:
        step, length = self._equations.grid.step, self._length
        drift = max(model.drift.sigma, 1.0)
        bounds = [
            (math.log(1e-3), math.log(30.0 * drift)),
            (math.log(20.0 * step), math.log(LONGEST_DRIFT * length)),
            (math.log(1e-3), math.log(30.0 * drift)),
            (math.log(max(0.2 * step, self._quickest)), math.log(0.2 * length)),
        ]
        for tone, gain, place in zip(model.tones, model.gains, model.places, strict=True):
            # the place of a sinusoid is known better than the resolution, that of a line to half its width; a
            # tone that could go farther would stand between two, for both
            farthest = float(np.clip(0.5 * tone.bandwidth * length, STRAYS, STRAYS_MOST))
            farthest = 0.0 if gain == math.inf else min(farthest, 0.6 * tone.frequency * length)
            strayed = min(max((tone.frequency - place) * length, -farthest), farthest)
            _, least, most = tone_widths(tone.frequency, length)
            bounds += [
                (math.log(1e-3), math.log(30.0 * drift)),
                ((-farthest - strayed) / STRAYS_MOST, (farthest - strayed) / STRAYS_MOST),
                (math.log(least), math.log(most)),
            ]
        least, most = NOISE_SCALES
        bounds.append((math.log(least), math.log(most)) if self._fit_noise else (0.0, 0.0))
        return bounds

    def improve(
        self, model: NoiseModel, iterations: int, gain: float = SETTLED, *, adjusted: bool = False
    ) -> NoiseModel:
        """The best model within some iterations from `model`; never worse than it.

        Quasi-Newton steps that begin with the expected curvature (`_curvature`). The search ends with the
        first step that lowers the deviance by less than `gain`. `adjusted`: no drift is smaller than it may
        be (`drift_adjustment`); for the end of a search: on its way drift and broadband part could change
        places.
        """
        origin = model
        bounds = np.array(self._bounds(model))
        x = np.clip(self._vector(model), bounds[:, 0], bounds[:, 1])
        pull = np.full(len(x), BELIEF**-2)
        centre = x.copy()
        pull[5:-1:3] = 0.0  # frequencies: bounded, not believed
        centre[6:-1:3] = [math.log(tone_widths(tone.frequency, self._length)[0]) for tone in model.tones]
        if self._corner is not None:
            pull[3] = CORNER_BELIEF**-2
            centre[3] = math.log(model.broadband.timescale * model.broadband.corner / self._corner)

        def objective(x: Array) -> tuple[float, Array]:
            try:
                value, slope = self._value_and_slope(self._model(x, origin))
            except (EstimationError, InputError):
                return math.inf, np.zeros_like(x)
            away = x - centre
            value, slope = value + float(pull @ away**2), slope + 2.0 * pull * away
            if adjusted:
                more, turned = self._adjusted(x)
                value, slope = value + more, slope + turned
            return value, slope

        begin = self._model(x, origin)
        curvature = self._curvature(begin) + 2.0 * np.diag(pull + 1e-3)
        return self._model(descend_within(objective, x, bounds, curvature, iterations, gain), origin)

    def _adjusted(self, x: Array) -> tuple[float, Array]:
        """`drift_adjustment` of the drift, and its derivatives by all parameters."""
        slope = np.zeros(len(x))
        value, slope[:2] = drift_adjustment(float(x[0]), float(x[1]), self._length)
        return value, slope

    def _curvature(self, model: NoiseModel) -> Array:
        """About the second derivatives of the deviance by the parameters.

        Those expected of a stationary problem: with S the broad parts of the motion's spectrum, N the data's
        information at a frequency, and ``w = S N / (1 + S N)``, the sum over frequencies of ``w^2`` times the
        products of the derivatives of ln S; likewise of the noise with 1 - w. A tone that is narrower than
        the data resolve has as many as few periods tell of.
        """
        grid, count = self._equations.grid, self._equations.grid.count
        # constants and even rates, the first frequency, are no part of the spectrum
        f = np.arange(2, count // 2 + 1) / (count * grid.step)
        lags = grid.step * np.arange(len(self._equations.band))
        diagonals = self._equations.band.sum(axis=1) / (model.noise_scale * count)
        information = 2.0 * np.cos(2.0 * math.pi * np.outer(f, lags)) @ diagonals - diagonals[0]
        parts = (model.drift, model.broadband)
        whole = sum(part.psd(f) for part in parts)
        w = whole * np.maximum(information, 0.0) / (2.0 * grid.step)
        w = w / (1.0 + w)
        rows = [w * 2.0 * part.psd(f) / whole for part in parts]
        slower = [replace(part, timescale=part.timescale * math.exp(1e-3)) for part in parts]
        more = [w * (s.psd(f) - part.psd(f)) / (1e-3 * whole) for s, part in zip(slower, parts, strict=True)]
        broad = np.stack([rows[0], more[0], rows[1], more[1], 1.0 - w])
        broad = 2.0 * broad @ broad.T
        broad[-1, -1] += max(self._equations.measurements - count, 0)
        # along the ridge of drifts that bend alike it is hardly curved, but the ridge is
        broad[[0, 1], [0, 1]] += DRIFT_RIDGE
        out = np.zeros((5 + 3 * len(model.tones),) * 2)
        own = np.array([0, 1, 2, 3, len(out) - 1])
        out[np.ix_(own, own)] = broad
        for k, tone in enumerate(model.tones):
            # a line beside the tone's place has its energy where the tone has so much less
            narrow = min(tone.bandwidth * self._length, 1.0)
            out[4 + 3 * k, 4 + 3 * k] = TONE_SIZE
            out[5 + 3 * k, 5 + 3 * k] = 4.0 * math.pi * STRAYS_MOST**2 / narrow
            out[6 + 3 * k, 6 + 3 * k] = TONE_WIDTH
        return out

    def _value_and_slope(self, model: NoiseModel) -> tuple[float, Array]:
        """Deviance and its derivatives: through the moments of the posterior, at the cost of one."""
        now = self.posterior(model)
        x = self._vector(model)
        slope = np.zeros(len(x))
        total = model.spectrum.autocovariance(self._lags)
        by_lag = now.moments.deviance_slope(now.prior, total)  # type: ignore[arg-type]
        step = 1e-3
        for k in range(len(x) - 1):
            sides = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[k] += sign * step
                changed = _component(self._model(moved, model), k)
                sides.append(changed.autocovariance(self._lags))
            slope[k] = by_lag @ (sides[0] - sides[1])[: len(by_lag)] / (2.0 * step)
        if self._fit_noise:
            slope[-1] = now.deviance_by_noise_scale
        return now.deviance, slope

    def with_given_tones(self, model: NoiseModel, frequencies: Sequence[float]) -> NoiseModel:
        """The model with a tone at each of these frequencies (Hz), as large as the noise to begin with.

        Tones of the model within the resolution of one of them give way to it.
        """
        for f in frequencies:
            if not 0.0 < f < 0.5 / self._equations.grid.step:
                continue
            apart = SAME_TONE / self._length
            near = [k for k, tone in enumerate(model.tones) if abs(tone.frequency - f) < apart]
            size = max((model.tones[k].sigma for k in near), default=0.1)
            for k in reversed(near):
                model = model.without_tone(k)
            model = model.with_tone(Tone(size, f, self.narrow(f)), math.inf)
        return model

    # -- tones ------------------------------------------------------------------------------------

    def unexplained_tones(self, model: NoiseModel, false_alarm: float) -> list[tuple[Tone, float]]:
        """Sinusoids that the model does not explain, each with its gain, the most significant first.

        Notes
        -----
        Score test. With u = Q m (prior precision times posterior mean) and c = exp(2 pi i f t),
        |c'u|^2 has the expectation c'Fc, F = Q Z N (Z the posterior covariance, N the data's
        information), and their ratio is the log-likelihood that a sinusoid at f would gain. It is
        computed for all f with F of a stationary problem, then exactly for the highest peaks: cosine and
        sine of a short series, or of one near a blind frequency, are neither equally well seen nor
        independent. What chance gains somewhere says `gain_of_chance`.
        """
        now = self.posterior(model)
        u = now.score
        frequency, ratio = self._approximate_gain(now, u)
        lowest, highest = SLOWEST / self._length, self._highest
        known = [tone.frequency for tone in model.tones]
        usable = (frequency > lowest) & (frequency < highest)
        for f in known:
            usable &= np.abs(frequency - f) > SAME_TONE / self._length
        usable &= ~self._constant(frequency) & ~self._alias(frequency, known)
        usable &= left_by_tdi(frequency, self._tdi) >= LEFT_BY_TDI
        peak = np.zeros(len(ratio), dtype=bool)
        peak[1:-1] = (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] > ratio[2:])
        where = np.flatnonzero(peak & usable)
        where = where[np.argsort(-ratio[where])[:CANDIDATES]]
        gain, power, expected = self._exact_gain(now, u, frequency[where])
        threshold = self.gain_of_chance(false_alarm)
        tones = []
        for k in np.argsort(-gain):
            if gain[k] > threshold:
                # Amplitude^2 = 4 power / expected^2; half of it is the variance.
                sigma = math.sqrt(2.0 * float(power[k])) / float(expected[k])
                tones.append((Tone(sigma, float(frequency[where[k]]), 1.0 / self._length), float(gain[k])))
        return tones

    def _constant(self, frequency: Array) -> NDArray[np.bool_]:
        """Whether tones of these frequencies (Hz) are hardly more than constants of the differences."""
        out = np.zeros(len(frequency), dtype=bool)
        for rate in self._rates:
            nearest = np.maximum(np.rint(frequency / rate), 1.0) * rate
            out |= np.abs(frequency - nearest) < NEAR_RATE / self._length
        return out

    def _alias(self, frequency: Array, known: Sequence[float]) -> NDArray[np.bool_]:
        """Whether frequencies (Hz) above half a rate look like a tone that is known already.

        What a tone leaves, because it is not quite a tone, shows there again.
        """
        out = np.zeros(len(frequency), dtype=bool)
        for rate in self._rates:
            folded = np.abs(frequency - rate * np.rint(frequency / rate))
            for f in known:
                same = np.abs(folded - abs(f - rate * round(f / rate))) < NEAR_RATE / self._length
                out |= same & (frequency > 0.5 * rate)
        return out

    def without_aliases(self, model: NoiseModel, false_alarm: float) -> NoiseModel:
        """The model with every tone moved to another frequency where that explains the data better.

        Differences sampled coarsely see a tone at several frequencies almost alike. Which of them it
        is shows only once the other tones are known.
        """
        for k, tone in enumerate(model.tones):
            if model.gains[k] == math.inf:
                continue
            others = model.without_tone(k)
            rivals = self.unexplained_tones(others, false_alarm)
            # A gain is a log-likelihood: what lies 20 below the best is no rival.
            rivals = [r for r in rivals if r[1] > rivals[0][1] - 20.0]
            for rival, gain in rivals:
                if abs(rival.frequency - tone.frequency) < NEAREST_RIVAL / self._length:
                    continue
                place = Tone(rival.sigma, rival.frequency, min(tone.bandwidth, 0.1 * rival.frequency))
                moved = self.improve(others.with_tone(place, gain), 25, ROUGHLY)
                if self._alias_score(moved, -1) < self._alias_score(model, k):
                    # over the list the loop runs
                    model = moved.with_last_tone_at(k)
        return model

    def _alias_score(self, model: NoiseModel, k: int) -> float:
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

    def _exact_gain(self, now: Posterior, u: Array, frequency: Array) -> tuple[Array, Array, Array]:
        """Log-likelihood that a sinusoid at some frequencies would gain, |c'u|^2, and its expectation.

        Half the squared cosine and sine of u in units of their covariance F: exponential of mean 1 without
        a tone.
        """
        c, s, score, seen = self._score_of_waves(now, u, frequency)
        seen = np.maximum(seen, 1e-12 * float(np.max(seen.sum(axis=1), initial=1.0)))  # blind: tells nothing
        # what rounding leaves of a wave that is not seen
        seen[:, 1] = np.maximum(seen[:, 1], 1e-3 * seen[:, 0])
        return 0.5 * (score**2 / seen).sum(axis=1), c**2 + s**2, seen.sum(axis=1)

    def _score_of_waves(
        self, now: Posterior, u: Array, frequency: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Scores (N,) of cosine and of sine, those of two phases that err independently (N, 2), F of these.

        The better seen of the two phases is the first. Of long series some frequencies are looked at a time.
        """
        groups = min(len(frequency) * now.equations.grid.count // _WAVES + 1, max(len(frequency), 1))
        parts = [self._score_of_few(now, u, few) for few in np.array_split(frequency, groups)]
        c, s, score, seen = (np.concatenate(part) for part in zip(*parts, strict=True))
        return c, s, score, seen

    def _score_of_few(self, now: Posterior, u: Array, frequency: Array) -> tuple[Array, Array, Array, Array]:
        """The same of frequencies whose waves are held together."""
        e = now.equations
        phase = 2.0 * math.pi * np.outer(e.grid.step * np.arange(e.grid.count), frequency)
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        half = len(frequency)
        seen = now.seen_of(waves)
        cc, ss = np.diag(seen).reshape(2, half)
        cs = np.diag(seen[:half, half:])
        middle, spread = 0.5 * (cc + ss), np.hypot(0.5 * (cc - ss), cs)
        turn = 0.5 * np.arctan2(cs, 0.5 * (cc - ss))
        c, s = (u @ waves).reshape(2, half)
        along, beside = c * np.cos(turn) + s * np.sin(turn), s * np.cos(turn) - c * np.sin(turn)
        return c, s, np.stack([along, beside], axis=1), np.stack([middle + spread, middle - spread], axis=1)

    def with_smoothness(self, model: NoiseModel) -> NoiseModel:
        """The model with its broadband part as smooth as the data ask for, from its present order up.

        Notes
        -----
        A spectrum that falls too slowly above its corner holds jitter that is not there: the posterior sigma
        is too large, and noise is taken for motion. An order must earn `SMOOTHER` and what `EVEN` allows, so
        that noise alone does not choose: a spectrum that falls too fast is certain of what it does not know.
        """
        price = SMOOTHER + EVEN**2 * self._equations.measurements
        for order in ORDERS[ORDERS.index(model.broadband.order) + 1 :]:
            part = model.broadband
            smoother = replace(model, broadband=Matern(part.sigma, part.timescale, order))
            smoother = self.improve(smoother, SMOOTHER_STEPS, ROUGHLY)
            if self.deviance(smoother) > self.deviance(model) - price:
                break
            model = self.improve(smoother, 25, ROUGHLY)
        return model

    def with_possible_tones(
        self, model: NoiseModel, possible: Sequence[Tone], false_alarm: float, *, known: bool = False
    ) -> NoiseModel:
        """The model and every `possible` tone it has none like, of its width and as large as it may be.

        A size fitted to data that do not show the tone is an accident: nothing at a blind frequency. It has
        the mean variance that the data leave to it, see `mean_variance_unseen`, beforehand that of the tone
        given. A width of one over the
        length of the data, where another axis shows a narrower one, would bring as much jitter at all
        frequencies into a short strip as the tone itself. Beside a blind frequency a tone whose own is not
        `known` may lie at it: there stands the mean of all that may be (`with_doubtful_tones`).
        """
        apart = SAME_TONE / self._length
        new = [one for one in possible if all(abs(t.frequency - one.frequency) > apart for t in model.tones)]
        constant = self._constant(np.array([one.frequency for one in new]))
        new = [one for one, never in zip(new, constant, strict=True) if not never]
        if not new:
            return model
        now = self.posterior(model)
        u = now.score
        gains, _, expected = self._exact_gain(now, u, np.array([one.frequency for one in new]))
        threshold = self.gain_of_chance(false_alarm)
        others = model
        for one, gained, information in zip(new, gains, expected, strict=True):
            mean = None if known else self._mean_tone(others, one, min(one.sigma, others.drift.sigma))
            if mean is not None:
                model = model.with_tone(mean, math.nan)
                continue
            # a tone of this variance would gain 1 + information variance / 2 on average
            per_variance = 0.5 * float(information)
            largest = min(threshold, per_variance * model.drift.sigma**2)
            usual = per_variance * one.sigma**2
            variance = mean_variance_unseen(float(gained), largest, usual) / per_variance
            width = min(max(one.bandwidth, NARROWEST / self._length), self.narrow(one.frequency))
            model = model.with_tone(Tone(math.sqrt(variance), one.frequency, width), math.nan)
        return model

    def with_usual_sizes(self, model: NoiseModel, usual: Spectrum) -> NoiseModel:
        """The model with parts that the data do not show as large as they leave them on average.

        Beforehand its broadband part, and every tone that `usual` has too, is about as large as there
        (`mean_variance_about`). The most likely size of what lies below the noise is an accident: nothing, or
        some of the noise.
        """
        there = NoiseModel.of(usual)
        size = self._mean_size(model, BROADBAND, model.broadband.sigma, there.broadband.sigma)
        if size is not None:
            model = self._with_best_scale(_with_size(model, BROADBAND, size))[0]
        for k, tone in enumerate(model.tones):
            near = usual_size(there.tones, tone.frequency, self._length)
            if near is not None and model.gains[k] != math.inf:
                size = self._mean_size(model, k, tone.sigma, near)
                model = model if size is None else _with_size(model, k, size)
        return model

    def with_doubtful_tones(self, model: NoiseModel) -> NoiseModel:
        """The model with tones beside a blind frequency as large and wide as the data leave them on average.

        Notes
        -----
        There a tone is seen by a share that changes much within what the data tell of its frequency, and what
        they tell of its size with it: the most likely tone, wider than a sinusoid, lies on the side where it
        is seen better and so is too small, and an estimate under it is certain of what may as well be twice
        as large. In its place stands one as large and as wide as the mean spectrum of all sinusoids about
        there: each weighs by its likelihood, and amplitudes are beforehand about as large as the largest of
        the tones (`mean_variance_about`).
        """
        if not model.tones:
            return model
        now = self.posterior(model)
        usual = math.sqrt(max(variance_at(now, tone.frequency) for tone in model.tones))
        for k, tone in enumerate(model.tones):
            if model.gains[k] == math.inf:
                continue
            mean = self._mean_tone(model.without_tone(k), tone, max(usual, tone.sigma))
            if mean is not None:
                # of a sinusoid, or of a mode that is damped
                wider = replace(mean, bandwidth=mean.bandwidth + tone.bandwidth)
                either = [_with_tone_at(model, k, one) for one in (mean, wider)]
                model = min(either, key=self.deviance)
        return model

    def _mean_tone(self, others: NoiseModel, tone: Tone, usual: float) -> Tone | None:
        """The mean of all that a tone may be beside `others`; None where its frequency tells its size."""
        f = tone.frequency + np.linspace(-DOUBT, DOUBT, DOUBT_PLACES) / self._length
        for other in others.tones:
            f = f[np.abs(f - other.frequency) > SAME_TONE / self._length]
        f = f[(f > SLOWEST / self._length) & (f < 0.5 / self._equations.grid.step)]
        if len(f) < 3:
            return None
        now = self.posterior(others)
        _, _, score, seen = self._score_of_waves(now, now.score, f)
        seen = np.maximum(seen, 1e-12 * float(seen.max()))
        logs = np.linspace(-3.0, 3.0, 25)
        variance = usual**2 * np.exp(2.0 * logs)
        shown = variance[:, None, None] * seen
        log_weight = 0.5 * (score**2 / seen * shown / (1.0 + shown) - np.log1p(shown)).sum(axis=2)
        log_weight += (logs - 2.5 * np.log1p(0.5 * np.exp(2.0 * logs)))[:, None]
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        place = weight.sum(axis=0)
        size = 0.5 * np.log(seen.sum(axis=1))
        if place @ (size - place @ size) ** 2 < CLEAR**2:
            return None
        power = variance @ weight
        middle = float(power @ f / power.sum())
        # between two of the places it may lie as well
        apart = 2.0 * DOUBT / (DOUBT_PLACES - 1) / self._length
        width = max(2.0 * math.sqrt(float(power @ (f - middle) ** 2 / power.sum())), apart)
        return Tone(math.sqrt(float(power.sum())), middle, width)

    def _mean_size(self, model: NoiseModel, part: int, fitted: float, usual: float) -> float | None:
        """Root mean square size of a part, beforehand about as large as `usual`; None where it is shown."""

        def deviance(size: float) -> float:
            changed = _with_size(model, part, size)
            return self._with_best_scale(changed)[1] if part == BROADBAND else self.deviance(changed)

        least = self.deviance(model)
        if all(deviance(fitted * more) > least + SHOWN_BY for more in (1.5, 1.0 / 1.5)):
            return None
        low, high = math.log(min(0.1 * usual, 0.3 * fitted)), math.log(max(10.0 * usual, 3.0 * fitted))
        logs = np.linspace(low, high, math.ceil(SIZES * (high - low)) + 1)
        return math.sqrt(mean_variance_about(usual, logs, np.array([deviance(math.exp(x)) for x in logs])))

    def _with_best_scale(self, model: NoiseModel) -> tuple[NoiseModel, float]:
        """The model with the best scale of the noise near its own, and the deviance of it."""
        if not self._fit_noise:
            return model, self.deviance(model)
        steps = SCALE_STEP * np.array([-1.0, 0.0, 1.0])
        at = [replace(model, noise_scale=model.noise_scale * math.exp(step)) for step in steps]
        low, middle, high = (self.deviance(one) for one in at)
        bend = low - 2.0 * middle + high
        slope = 0.5 * (high - low)
        allowed = np.clip(np.log(np.divide(NOISE_SCALES, model.noise_scale)) / SCALE_STEP, -3.0, 3.0)
        best = float(np.clip(-slope / bend, *allowed)) if bend > 0.0 else 0.0
        scale = model.noise_scale * math.exp(SCALE_STEP * best)
        return replace(model, noise_scale=scale), middle + slope * best + 0.5 * bend * best**2

    def narrow(self, frequency: float) -> float:
        """Bandwidth (Hz) that a tone is taken to have as long as nothing shows it."""
        return min(1.0 / self._length, WIDEST * frequency)

    def hidden_tones(
        self, model: NoiseModel, elsewhere: Sequence[tuple[float, float]] = ()
    ) -> tuple[tuple[Tone, ...], tuple[tuple[float, float], ...]]:
        """What the motion is to be expected to hold where TDI, or coarse lines, average it away: wide tones.

        One for each stretch of frequencies.

        With the frequency (Hz) of the mode that most likely shines through, if any may, and its probability,
        1 where no chance would show as much; `elsewhere` are those of other axes, each with the odds that
        this one has it too.

        Notes
        -----
        Modes are as dense in frequency where TDI hides them as where it does not, up to an end that is not
        known: n of them up to f tell of a density of ``n^2 / (n + 1) f^n / x^(n + 1)`` beyond (even up to an
        end whose scale is as unknown). Their variance falls as f^-3, that of a lightly damped oscillator of a
        given damping ratio under white noise, and that of one is exponential beforehand. What the images show
        of it, however little, weighs it as in `mean_variance_unseen`: a mode that would stand out is not
        there, one that shines through is. How little is not known well enough to tell its size: `_shown` of
        it is as much the work of other modes. Nothing is read at sums and differences of two or three modes,
        where their own products are. Windows of coarse lines, whose filter mixes lines by an amount that is
        not known so well, show the less of what is possible. Where modes are there so SELDOM that a sigma
        need not hold for them, they do not widen it.
        """
        shortest = max(min(self._tdi, default=0.0), self._coarse)
        if not shortest > 0.0:  # some image has no stages, and lines that are fine enough: it shows all
            return (), ()
        cell = 0.5 / self._length
        top = HIDDEN_TO / shortest
        stride = max(math.ceil(top / cell / MOST_HIDDEN), 1)
        f = np.arange(1.0, top, cell * stride)
        left = left_by_tdi(f, self._tdi)
        beyond = f * self._coarse > SEEN_THROUGH
        hidden = (left < LEFT_BY_TDI) | beyond
        modes = self._seen_modes(model)
        if not hidden.any() or not len(modes):
            return (), ()
        now = self.posterior(model)
        sizes = np.array([variance_at(now, m) for m in modes])
        if not sizes.sum() > 0.0:
            return (), ()
        strength, count, strong = seen_modes(modes, sizes)
        density = mode_density(f, count, strong)
        gain, information, exact = np.zeros(len(f)), np.zeros(len(f)), f.copy()
        within = hidden & (f < 0.45 / self._equations.grid.step) & ~self._alias(f, modes.tolist())
        within &= f * self._coarse < 1.0
        for part in np.array_split(np.flatnonzero(within), max(int(within.sum()) // CANDIDATES, 1)):
            gain[part], _, information[part] = self._exact_gain(now, now.score, f[part])
        # a sinusoid half a step beside is seen by a fifth less: too much to tell it from an alias
        crest = np.argsort(-gain)[:CREST]
        for k in crest[within[crest]]:
            near = f[k] + cell * stride * np.linspace(-0.5, 0.5, 9)
            gains, _, informations = self._exact_gain(now, now.score, near)
            best = int(np.argmax(gains))
            gain[k], information[k], exact[k] = gains[best], informations[best], near[best]
        shown, doubt = self._shown(exact, modes, sizes)
        information *= (np.hypot(shown, doubt) * self._least_shown(exact)) ** 2
        doubt = doubt / np.maximum(np.hypot(shown, doubt), 1e-12)
        number = density * cell * stride
        # what shows at one frequency shows at its aliases, though a mode there would be smaller and rarer
        plain = strong[left_by_tdi(strong, self._tdi) >= SEEN_PLAINLY]
        mixed = _combined(plain, exact, 1.0 / self._length)
        _, likely = _mean_hidden(strength / f**3, number, gain, 0.5 * information, doubt)
        strongest = int(np.argmax(np.where(mixed | ~within, -math.inf, likely)))
        certain = gain[strongest] > gain_of_chance(top * self._spread, HARDLY_CHANCE)
        through: tuple[tuple[float, float], ...] = ()
        if within[strongest] and not mixed[strongest]:
            chance = 1.0 if certain else float(np.exp(-np.logaddexp(0.0, -likely[strongest])))
            if chance > SELDOM:
                through = ((float(exact[strongest]), chance),)
        sure = [f for f, chance in through if chance == 1.0]
        mixed |= _combined(np.append(plain if sure else strong, sure), exact, 1.0 / self._length)
        gain[mixed] = information[mixed] = 0.0
        for place, odds in elsewhere:
            # places of long data lie farther apart than modes that are the same
            apart = np.abs(exact - place)
            near = apart <= max(SAME_TONE / self._length, float(apart.min()))
            number[near] = np.maximum(number[near], odds / near.sum())
        expected, likely = _mean_hidden(strength / f**3, number, gain, 0.5 * information, doubt)
        odds = max(number[hidden].sum(), np.exp(likely[hidden]).sum())
        if odds < SELDOM / (1.0 - SELDOM):
            return (), through
        return _wide_tones(f, hidden, expected, 1.0 / self._length), through

    def without_products(self, model: NoiseModel) -> NoiseModel:
        """The model less tones that are products of a mode that TDI hides and others that it does not.

        Beside other modes a hidden one displaces matches at sums and differences of all. What is taken off of
        that (`motion.measure.uneven_blur`) holds only the motion that is known; where TDI leaves little, the
        rest would pass for a tone many times as large. Of the two, that is the mode whose gain is larger.
        """
        _, shown = self.hidden_tones(model)
        through = [f for f, chance in shown if chance == 1.0]
        if not through:
            return model
        modes = np.array([tone.frequency for tone in model.tones])
        left = left_by_tdi(modes, self._tdi)
        plain = np.append(modes[left >= SEEN_PLAINLY], through)
        for k in np.flatnonzero((left < SEEN_PLAINLY) & _combined(plain, modes, 1.0 / self._length))[::-1]:
            if model.gains[k] == math.inf:
                continue
            fewer = model.without_tone(int(k))
            now = self.posterior(fewer)
            gain, _, _ = self._exact_gain(now, now.score, np.array([modes[k], *through]))
            if gain[0] < gain[1]:
                model = fewer
        return model

    def _shown(self, f: Array, modes: Array, sizes: Array) -> tuple[Array, Array]:
        """How much of a tone at `f` (Hz) matches show beside modes of a variance of `sizes`, over its mean.

        And how much of that, in any phase, modes of the other axes may add.

        Notes
        -----
        Blurred detail counts less, so that of the stages those near the mean place count more: of stage s, a
        share of ``detail / 2`` times the square of how far the modes have it from their mean, on average
        ``size (1 + c**2 - 2 c cos(w s))`` where c is what the stages leave of a mode, counts less than of
        the mean stage. (A third of the third moment's slope, which `motion.measure.uneven_blur` takes off.)
        """
        seen, sight, beyond = np.zeros(len(f)), np.zeros(len(f)), np.zeros(len(f))
        for whole in self._tdi:
            left = np.sinc(f * whole)
            extra = np.zeros(len(f))
            for mode, size in zip(modes, sizes, strict=True):
                c = float(np.sinc(mode * whole))
                beside = np.sinc((f + mode) * whole) + np.sinc((f - mode) * whole)
                extra -= 0.5 * self._detail * size * c * (2.0 * c * left - beside)
            # what rows of other stages show the other way round is taken for less of it
            taken = np.where(np.abs(left) < LEAST_LEFT, np.copysign(LEAST_LEFT, left), left)
            seen += taken * (left + extra)
            sight += taken * taken
            beyond += (taken * extra) ** 2
        return np.abs(seen) / sight, np.sqrt(beyond) / sight

    def _seen_modes(self, model: NoiseModel) -> Array:
        """Hz; tones of the model of which the stages leave enough."""
        modes = np.array([tone.frequency for tone in model.tones])
        return np.asarray(modes[left_by_tdi(modes, self._tdi) >= LEFT_BY_TDI])

    def products(self, model: NoiseModel, hidden: Sequence[Tone]) -> tuple[Tone, ...]:
        """What hidden modes make of those that are seen, in the motion that is found but not in the body's.

        Tones at sums and differences of three (intermodulation).
        """
        if not hidden:
            return ()
        now = self.posterior(model)
        modes = [Tone(math.sqrt(variance_at(now, f)), f, 1.0) for f in self._seen_modes(model).tolist()]
        return tuple(self._products_of(hidden, modes))

    def _products_of(self, hidden: Sequence[Tone], modes: Sequence[Tone]) -> list[Tone]:
        """The same of hidden modes and others.

        Notes
        -----
        Fine detail shows ``detail / 6`` of the third moment of how far stages lie beside their mean; the
        motion holds that over what is left of a tone where it comes to lie.
        """
        out = []
        for one in hidden:
            for (a, first), (b, second) in combinations_with_replacement(enumerate(modes), 2):
                # cosines of amplitudes 2^(1/2) sigma; with two alike there are half as many terms
                size = (1.0 if a != b else 0.5) * 0.5 * self._detail * first.sigma * second.sigma * one.sigma
                for signs in product((1.0, -1.0), (1.0, -1.0)):
                    f = (one.frequency, signs[0] * first.frequency, signs[1] * second.frequency)
                    place = abs(sum(f))
                    left = left_by_tdi(np.array([place]), self._tdi)[0]
                    apart = min(abs(place - mode.frequency) for mode in modes)
                    # of two alike the other signs change the size of the hidden one alone
                    alike = a == b and signs[0] != signs[1]
                    # of what hardly shows, and is like no mode, the motion that is found has nothing
                    faint = left < (LEFT_BY_TDI if apart < NEAR_RATE / self._length else SEEN_PLAINLY)
                    if alike or faint or place * self._length < SLOWEST:
                        continue
                    # the stages that leave most of it say what is found there
                    whole = max(self._tdi, key=lambda each, at=place: abs(np.sinc(at * each)))  # type: ignore[misc]
                    made = size * _third_moment(f, whole) / abs(np.sinc(place * whole))
                    if made > 0.0:
                        out.append(Tone(made, place, min(one.bandwidth, 0.5 * place)))
        return out

    def _least_shown(self, f: Array) -> Array:
        """Least share of tones at `f` (Hz) that windows of coarse lines may show, over what is modelled."""
        if not self._coarse > 0.0:
            return np.ones(len(f))
        shown = np.abs(np.sinc(f * self._window))
        return np.sinc(np.minimum(f * self._coarse, 1.0)) / np.maximum(shown, LEAST_LEFT)

    def without_idle_tones(self, model: NoiseModel) -> NoiseModel:
        """The model less every tone that three parameters do not pay for (Akaike)."""
        for k in reversed(range(len(model.tones))):
            fewer = model.without_tone(k)
            present = self.deviance(model)
            if self.deviance(fewer) > present + 30.0:
                continue
            fewer = self.improve(fewer, 10, ROUGHLY)
            if self.deviance(fewer) < present + 6.0:
                model = fewer
        return model


def descend_within(
    objective: Callable[[Array], tuple[float, Array]],
    x: Array,
    bounds: Array,
    curvature: Array,
    iterations: int,
    gain: float,
) -> Array:
    """Lower a function within bounds by quasi-Newton steps.

    Parameters
    ----------
    objective : callable
        Gives the value, infinite where there is none, and its slope (n,).
    x : (n,)
        Where to begin.
    bounds : (n, 2)
        Least and largest.
    curvature : (n, n)
        Positive definite: second derivatives to begin with; steps correct them (BFGS).
    iterations : int
        Steps at most.
    gain : float
        A whole step, or two in a row, that lower the value by less end the search.

    Returns
    -------
    (n,) the best place that was looked at
    """
    value, slope = objective(x)
    hardly = 0
    for _ in range(iterations):
        # what stands at a bound and would go beyond stays
        free = ~(((x <= bounds[:, 0]) & (slope > 0.0)) | ((x >= bounds[:, 1]) & (slope < 0.0)))
        free &= bounds[:, 0] < bounds[:, 1]
        if not free.any():
            break
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], slope[free])
        step /= max(1.0, float(np.abs(step).max()) / FARTHEST_STEP)
        size, lowered = 1.0, False
        for _ in range(HALVINGS):
            there = np.clip(x + size * step, bounds[:, 0], bounds[:, 1])
            new, new_slope = objective(there)
            expected = float(slope @ (there - x))
            lowered = new <= value + 1e-4 * min(expected, 0.0) and new < math.inf
            if lowered:
                break
            # the lowest place of the parabola through what is known, no nearer than a tenth
            bend = new - value - expected
            size *= min(max(-0.5 * expected / bend, 0.1), 0.5) if 0.0 < bend < math.inf else 0.1
        if not lowered:
            break
        moved, turned, gained = there - x, new_slope - slope, value - new
        x, value, slope = there, new, new_slope
        # a step that had to be shortened says little of what is left to gain
        hardly = 0 if gained >= gain else hardly + (2 if size == 1.0 else 1)
        if hardly >= 2:
            break
        curvature = _corrected(curvature, moved, turned)
    return x


def _corrected(curvature: Array, moved: Array, turned: Array) -> Array:
    """The curvature once a move was seen to turn the slope (BFGS), damped: it stays positive definite."""
    pushed = curvature @ moved
    expected, along = float(moved @ pushed), float(moved @ turned)
    if along < 0.2 * expected:
        share = 0.8 * expected / (expected - along)
        turned = share * turned + (1.0 - share) * pushed
        along = float(moved @ turned)
    return np.asarray(curvature - np.outer(pushed, pushed) / expected + np.outer(turned, turned) / along)


def left_by_tdi(frequency: Array, tdi: Sequence[float]) -> Array:
    """Largest share of tones at frequencies (Hz) that averages over any of `tdi` (s) leave; 1 without any."""
    shares = [np.abs(np.sinc(frequency * each)) for each in tdi]
    return np.asarray(np.max(shares, axis=0)) if shares else np.ones(len(frequency))


def seen_modes(frequency: Array, variance: Array) -> tuple[float, float, Array]:
    """Strength (variance times Hz^3) of modes that are seen, how many they count for, and the strong ones.

    Small ones, some of them no modes, count for little.
    """
    strengths = variance * frequency**3
    strength = float((strengths**2).sum() / strengths.sum())
    return strength, float(strengths.sum()) / strength, frequency[strengths > COUNTS * strength]


def mode_density(frequency: Array, count: float, strong: Array) -> Array:
    """Modes per Hz at frequencies (Hz) beyond those that are seen, of their `count` up to the last strong.

    Even up to an end whose scale is not known (`Search.hidden_tones`).
    """
    last = strong.max()
    return np.asarray(count**2 / (count + 1.0) * last**count / np.maximum(frequency, last) ** (count + 1.0))


def _third_moment(frequencies: Sequence[float], whole: float) -> float:
    """Size of the mean, over stages of `whole` (s), of the product of three waves each less its own mean."""
    at = whole * ((np.arange(STAGES) + 0.5) / STAGES - 0.5)
    waves = np.exp(2j * math.pi * np.outer(frequencies, at))
    return float(abs((waves - waves.mean(axis=1, keepdims=True)).prod(axis=0).mean()))


def gain_of_chance(count: float, false_alarm: float) -> float:
    """Log-likelihood that noise alone gains somewhere by a sinusoid with the probability `false_alarm`.

    Parameters
    ----------
    count : float
        Width of the band that is looked through, times the length of the data.
    false_alarm : float
        Between 0 and 1.

    Notes
    -----
    Gains of frequencies one over the length of the data apart are independent exponentials; between them the
    highest of a crest is found. The number of crests above g is ``count sqrt(pi g / 3) exp(-g)`` on average
    (Baluev 2008, MNRAS 385, 1279, for a periodogram of even weights), and the probability of none its
    exponential. As many independent frequencies as periods would be passed three times too often.
    """
    expected, count = -math.log1p(-false_alarm), max(count, 1.0)
    gain = 1.0
    for _ in range(50):
        gain = max(math.log(_crests(count, gain) / expected), 1.0)
    return gain


def chance_of_gain(gain: float, count: float) -> float:
    """Probability, at most, that noise alone gains so much by a sinusoid of a frequency that is looked at.

    `count` as of `gain_of_chance`: what lies about that frequency and may have been taken for it.
    """
    return min(1.0, (1.0 + _crests(count, gain)) * math.exp(-gain))


def _crests(count: float, gain: float) -> float:
    """Mean number of crests above a gain, in units of the probability that one frequency gains as much."""
    return count * math.sqrt(math.pi * gain / 3.0)


def mean_variance_unseen(gain: float, largest: float, usual: float = math.inf) -> float:
    """Mean variance of a tone that was not found, in units in which the noise has that of 1.

    The gain of a tone of variance v is exponential of mean 1 + v; amplitudes are even up to where the tone
    would have been found, or would be larger than all motion, or half a Gaussian of the `usual` variance.

    Parameters
    ----------
    gain : float
        Log-likelihood that a sinusoid at its frequency would gain.
    largest, usual : float
        Of the variance.
    """
    amplitude = (np.arange(400) + 0.5) / 400.0
    largest = min(largest, 25.0 * usual)  # five sigma of that Gaussian
    variance = largest * amplitude**2
    weight = np.exp(-gain / (1.0 + variance) - 0.5 * variance / usual) / (1.0 + variance)
    return float(variance @ weight / weight.sum())


def drift_adjustment(
    log_sigma: float, log_timescale: float, length: float
) -> tuple[float, tuple[float, float]]:
    """What keeps a drift that few bends tell of from being none: -2 log, and its derivatives by both.

    Parameters
    ----------
    log_sigma, log_timescale : float
        Logarithms of the standard deviation and of the time scale (s) of a drift.
    length : float
        s; of the data.

    Notes
    -----
    Of a drift a short strip shows a handful of bends. A variance that maximises the likelihood of so few
    is as often far too small as too large, even none at all, and an estimate under a drift of no size is
    certain of what it did not see; one under a drift that is too large only loses what the prior would
    have told. So the likelihood is multiplied by the variance of the bend, which keeps what the prior is
    believed unbiased to first order (Morris and Tang 2011, Statistical Science 26: adjustment for density
    maximisation): among n bends that are clearly seen the variance is their sum of squares over n - 2.
    """

    def of(log_timescale: float) -> float:
        return -2.0 * ADJUSTED * math.log(Matern(1.0, math.exp(log_timescale), "5/2").bend(length))

    step = 1e-3
    by_sigma = -2.0 * ADJUSTED
    by_timescale = (of(log_timescale + step) - of(log_timescale - step)) / (2.0 * step)
    return of(log_timescale) + by_sigma * log_sigma, (by_sigma, by_timescale)


def tone_widths(frequency: float, length: float) -> tuple[float, float, float]:
    """Bandwidth (Hz) that a tone is believed to have in data of `length` (s), the least, and the most."""
    usual = min(USUAL_WIDTH / length, WIDEST * frequency)
    return usual, LEAST_WIDTH / length, max(10.0 / length, 0.1 * frequency)


def usual_size(usual: Sequence[Tone], frequency: float, length: float) -> float | None:
    """Standard deviation of that of the `usual` tones that lies at `frequency` (Hz); over `length` s."""
    return max((t.sigma for t in usual if abs(t.frequency - frequency) < SAME_TONE / length), default=None)


def mean_variance_about(usual: float, logs: Array, deviance: Array) -> float:
    """Mean variance of a part of a motion, by the `deviance` (N,) of the sizes exp(`logs`).

    Beforehand sizes are half of a Student t of four degrees, whose mean variance is that of `usual`: about as
    large, or, seldom, many times.

    Parameters
    ----------
    usual : float
        Standard deviation.
    logs : (N,)
        Logarithms of standard deviations, evenly spaced, over all that may be.
    deviance : (N,)
        -2 log likelihood.
    """
    from scipy.interpolate import CubicSpline

    fine = np.linspace(logs[0], logs[-1], 16 * len(logs))
    size = np.exp(fine)
    density = (1.0 + 0.5 * (size / usual) ** 2) ** -2.5 * size
    weight = density * np.exp(-0.5 * (CubicSpline(logs, deviance)(fine) - deviance.min()))
    return float(size**2 @ weight / weight.sum())


def _with_size(model: NoiseModel, part: int, sigma: float) -> NoiseModel:
    """A model whose broadband part, or tone number `part`, has another standard deviation."""
    if part == BROADBAND:
        return replace(model, broadband=replace(model.broadband, sigma=sigma))
    return _with_tone_at(model, part, replace(model.tones[part], sigma=sigma))


def _with_tone_at(model: NoiseModel, k: int, tone: Tone) -> NoiseModel:
    """A model with another tone in the place of its tone number `k`."""
    return replace(model, tones=(*model.tones[:k], tone, *model.tones[k + 1 :]))


def _combined(modes: Array, f: Array, apart: float) -> NDArray[np.bool_]:
    """Whether frequencies are sums or differences of two or three of the `modes`, but no mode."""
    signed = np.concatenate([modes, -modes])
    two = (signed[:, None] + signed).ravel()
    three = (two[:, None] + signed).ravel()
    products = np.unique(np.abs(np.concatenate([two, three])))
    products = products[np.abs(products[:, None] - modes).min(axis=1, initial=math.inf) > 2.0 * apart]
    if not len(products):
        return np.zeros(len(f), dtype=bool)
    return np.asarray(np.abs(f[:, None] - products).min(axis=1) < apart)


def _mean_hidden(
    mean: Array, count: Array, gain: Array, per_variance: Array, doubt: Array
) -> tuple[Array, Array]:
    """Mean variance at frequencies half the resolution apart, of tones of which `count` lie at each.

    And the logarithm of how likely one lies there, beside none. Beforehand the variance v of a tone is
    exponential of a `mean`; a gain is exponential of mean 1 + v times `per_variance`: that of a tone whose
    phase is drawn. A part `doubt` of what is seen is the work of others, of any phase. What one tone shows at
    its neighbours is not another.
    """
    share = (np.arange(200) + 0.5) / 20.0  # of the mean
    variance = mean[:, None] * share
    log_weight = np.full(variance.shape, -math.inf)
    for draw in _DRAWS:
        power = np.abs(np.sqrt(np.maximum(1.0 - doubt**2, 0.0)) + doubt * draw) ** 2
        seen = 1.0 + (power * per_variance)[:, None] * variance
        one = gain[:, None] * (1.0 - 1.0 / seen) - np.log(seen)
        log_weight = np.logaddexp(log_weight, one - math.log(len(_DRAWS)))
    log_weight -= share
    with np.errstate(divide="ignore"):
        log_weight += np.log(count / 20.0)[:, None]
    top = max(float(log_weight.max(initial=0.0)), 0.0)
    weight = np.exp(log_weight - top)
    around = np.convolve(weight.sum(axis=1), np.ones(5), "same")
    most = log_weight.max(axis=1)
    likely = most + np.log(np.exp(log_weight - most[:, None]).sum(axis=1))
    return np.asarray((weight * variance).sum(axis=1) / (math.exp(-top) + around)), likely


def _wide_tones(f: Array, hidden: NDArray[np.bool_], variance: Array, narrow: float) -> tuple[Tone, ...]:
    """A tone for each stretch of frequencies that is hidden, as wide as its variance, at least `narrow`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    out = []
    for begin, end in edges.reshape(-1, 2):
        each, places = variance[begin:end], f[begin:end]
        if each.sum() > 0.0:
            middle = float(places @ each / each.sum())
            spread = math.sqrt(float((places - middle) ** 2 @ each / each.sum()))
            out.append(Tone(math.sqrt(float(each.sum())), middle, min(max(spread, narrow), 0.1 * middle)))
    return tuple(out)


def variance_at(now: Posterior, frequency: float) -> float:
    """Variance of the estimated motion at a frequency (Hz)."""
    grid = now.equations.grid
    x = np.diff(now.mean, 2)  # less its drift, which leaks
    phase = 2.0 * math.pi * frequency * grid.step * np.arange(grid.count)
    window = np.hanning(len(x))
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)[1:-1] * window[:, None]
    gain = (2.0 * math.sin(math.pi * frequency * grid.step)) ** 2
    amplitude = 2.0 * (x @ waves) / window.sum() / gain
    return float(0.5 * (amplitude**2).sum())


def _component(model: NoiseModel, parameter: int) -> Matern | Tone:
    """The part of the spectrum to which a parameter of the vector belongs."""
    if parameter < 4:
        return (model.drift, model.broadband)[parameter // 2]
    return model.tones[(parameter - 4) // 3]
