"""Spectra of axes that rows of windows tell together only, by one likelihood of all three.

The windows of a narrow field say where a row went across to a hundredth of a pixel, and hardly how much of
that was roll and how much yaw. Of rows that leave the other angle free either spectrum shows little of its
jitter, and its drift only; the two together show their sum as well. So they are fitted at once, to what
the images say of roll, pitch and yaw (``normal_equations.py``), from what each axis showed by itself.

Not here: that first fit, and tones (``hyper.py``, ``estimation/likelihood.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.evidence import EvenRate, moments_of, rate_weights
from sightline.estimation.prior import Autoregressive, Matern, Spectrum, Tone, autoregressive
from sightline.estimation.search import (
    BELIEF,
    LONGEST_DRIFT,
    SETTLED,
    STRAYS,
    NoiseModel,
    descend_within,
    drift_adjustment,
    tone_widths,
    usual_size,
)
from sightline.motion.measure.observations import Star
from sightline.motion.strip.joint import Factor, JointEstimate, JointPrior, joint_factor
from sightline.motion.strip.normal_equations import (
    GroundOrder,
    NormalEquations,
    TimeGrid,
    bandwidth_of,
    modelled,
    normal_equations,
)

Array = NDArray[np.float64]

#: Work allowed per evaluation, unknowns times the square of the bandwidth: about .3 s. Of longer strips the
#: middle is looked at.
WORK = 2.0e8
#: Least length of that middle, in lags.
LEAST_LAGS = 4.0
#: Steps of the search at most.
ITERATIONS = 40
#: Second derivatives of the deviance by the logarithms of sizes and times: of broad parts, of tones.
CURVATURE, TONE_CURVATURE = 20.0, 8.0
#: Parameters of the broad parts, before three of each tone.
BROAD_PARAMETERS, TONE_PARAMETERS = 4, 3
#: How far logarithms of sizes may fall and rise.
SIZES = (-7.0, 4.0)


@dataclass(frozen=True, eq=False)
class TiedEvidence:
    """How well three spectra explain what the images say of roll, pitch and yaw at once.

    Attributes
    ----------
    data : NormalEquations
        Of the images.
    prior : JointPrior
        Whose `angles` are put in the place of by those of the spectra; static parameters are as free as here.
    order : int
        Of the autoregressions.
    rates : three EvenRate
        Of roll, pitch, yaw: the likelihood is that of motions of which these are known.
    """

    data: NormalEquations
    prior: JointPrior
    order: int
    rates: tuple[EvenRate, EvenRate, EvenRate]

    @classmethod
    def of(
        cls, stars: Sequence[Star], post_px: Sequence[Array], estimate: JointEstimate, order: int
    ) -> TiedEvidence:
        """That of matches, of which `estimate` leaves `post_px` (px): of all, or those in the middle of it.

        Even rates are as the estimate has them, and known as closely as it holds drifts: where none is given
        that of yaw may be any that its motion lets expect, and the parabola of roll that belongs to it is no
        part of roll. Those of hidden drifts that nothing ties do not tell of spectra.
        """
        grid = estimate.grid
        measured = [
            post + modelled(star, grid, estimate.nodes, estimate.statics)
            for star, post in zip(stars, post_px, strict=True)
        ]
        first, last = _middle(stars, grid, order)
        part = TimeGrid(grid.start + grid.step * first, grid.step, last - first)
        if part.count < grid.count:
            stars = [_within(star, part) for star in stars]
        data = normal_equations(stars, measured, part, orders=[GroundOrder()] * len(stars))
        order = min(order, part.count - 1)
        loose = estimate.prior.innovation_weights
        if loose is not None:
            loose = loose[first:last].copy()
            loose[:order] = 1.0
        prior = replace(
            estimate.prior,
            relief=None,
            innovation_weights=loose,
            apart=None,
            own_precision=None,
            slow_precision=None,
            ample=None,
            curve_sigma=(0.0, 0.0, 0.0),
        )
        hidden = estimate.untied_drifts()
        found = rate_weights(part.nodes) @ estimate.nodes[first:last]
        half = 0.5 * grid.step * (grid.count - 1)
        roll, pitch, yaw = (
            EvenRate(float(rate), axis not in hidden, sigma / half)
            for axis, (rate, sigma) in enumerate(zip(found, prior.drift_sigma, strict=True))
        )
        return cls(data, prior, order, (roll, pitch, yaw))

    @property
    def length(self) -> float:
        """s; of the motion."""
        return self.data.grid.step * self.data.grid.count

    def deviance(self, spectra: Sequence[Spectrum]) -> float:
        """-2 log likelihood of three spectra (rad), but for a constant."""
        return self._posterior(spectra)[0]

    def value_and_slope(
        self, spectra: Sequence[Spectrum], axes: Sequence[int]
    ) -> tuple[float, dict[int, Array]]:
        """`deviance`, and its derivatives by the autocovariance of some axes at lags of 0, 1 .. nodes.

        Notes
        -----
        Those of the expectation of -2 log density of the motion (Fisher's identity), as for one axis.
        """
        value, processes, factor, motion, pulled = self._posterior(spectra)
        block, count, p = self.data.block, self.data.grid.count, self.order
        band = factor.covariance_band(block * p)
        motion, pulled = motion.reshape(count, block), pulled.reshape(count, block, -1)
        weights, loose = rate_weights(self.data.grid.nodes), self.prior.innovation_weights
        out = {}
        for axis in axes:
            near = np.zeros((p + 1, count))
            for k in range(p + 1):
                held = np.einsum("nr,nr->n", pulled[k:, axis], pulled[: count - k, axis])
                near[k, : count - k] = band[block * k, axis::block][: count - k] - held
            moments = moments_of(
                np.ascontiguousarray(motion[:, axis]),
                near,
                p,
                self.rates[axis],
                weights,
                None if loose is None else loose[:, axis],
            )
            out[axis] = moments.deviance_slope(processes[axis], self._autocovariance(spectra[axis]))
        return value, out

    def _posterior(
        self, spectra: Sequence[Spectrum]
    ) -> tuple[float, list[Autoregressive], Factor, Array, Array]:
        """Deviance, processes, factor, motion, and what holding rates takes from its covariance (n, 3)."""
        data, count = self.data, self.data.grid.count
        processes = [autoregressive(self._autocovariance(s), self.order, count) for s in spectra]
        roll, pitch, yaw = processes
        factor = joint_factor(data, replace(self.prior, angles=(roll, pitch, yaw)))
        x, y = factor.solve(data.rhs, data.rhs_static)
        value = data.chi2 - float(x @ data.rhs) - float(y @ data.rhs_static) + factor.logdet
        value -= sum(process.logdet for process in processes)
        weights = rate_weights(data.grid.nodes)
        each = np.zeros((count, data.block, 3))
        for axis, rate in enumerate(self.rates):
            each[:, axis, axis] = weights
            value -= rate.told(processes[axis].variance_of(weights))
        flat = each.reshape(-1, 3)
        moved, _ = factor.times(flat)
        variance = flat.T @ moved + np.diag([rate.sigma**2 for rate in self.rates])
        beside = flat.T @ x - [rate.value for rate in self.rates]
        pull = np.linalg.solve(variance, beside)
        half = np.linalg.cholesky(variance)
        value += float(beside @ pull) + 2.0 * float(np.log(np.diag(half)).sum())
        return value, processes, factor, x - moved @ pull, np.linalg.solve(half, moved.T).T

    def _autocovariance(self, spectrum: Spectrum) -> Array:
        return spectrum.autocovariance(self.data.grid.step * np.arange(self.order + 1.0))


def fit_tied(
    evidence: TiedEvidence,
    begins: Sequence[Sequence[Spectrum]],
    axes: Sequence[int],
    usual: Sequence[Spectrum],
    settled: float = SETTLED,
    *,
    louder: bool = True,
) -> list[Spectrum]:
    """Spectra of roll, pitch and yaw (rad) of which those of some axes explain the images best together.

    Parameters
    ----------
    evidence : TiedEvidence
    begins : sequence of three Spectrum
        Each with a drift, a broadband part and tones, of which sizes, times, widths and frequencies are
        fitted: the search begins with the best of these, and of the first with sizes no smaller than the
        usual ones.
    axes : sequence of int
        Those that are fitted.
    usual : three Spectrum
        Of the size, about, that broadband parts and tones have beforehand.
    settled : float
        Deviance that the last step of the search gains at most.
    louder : bool
        Whether broadband parts may come out larger or quicker than they begin.

    Notes
    -----
    As for one axis drifts are kept from being none (`drift_adjustment`). Sizes are beforehand half
    of a Student t of four degrees about the `usual` one. The maximum is taken over their logarithms: of a
    variance whose likelihood is that of a sum of squares it is then the mean.
    """
    # from a part of no size nothing leads to one that it shares with another axis
    larger = _Parameters(evidence, tuple(begins[0]), tuple(axes), tuple(usual)).at_least_usual()
    starts = [*begins, larger] if louder else begins

    def deviance(spectra: Sequence[Spectrum]) -> float:
        try:
            return evidence.deviance(spectra)
        except (EstimationError, InputError):  # sizes so unlike that the equations have no factor
            return math.inf

    begin = min(starts, key=deviance)
    tied = _Parameters(evidence, tuple(begin), tuple(axes), tuple(usual), louder)
    return tied.spectra(tied.search(settled))


@dataclass(frozen=True, eq=False)
class _Parameters:
    """Spectra of some axes as one vector: logarithms of sizes, of times, of widths of tones; their shifts.

    A shift of 1 moves a tone as far as it may stray.
    """

    evidence: TiedEvidence
    begin: tuple[Spectrum, ...]
    axes: tuple[int, ...]
    usual: tuple[Spectrum, ...]
    louder: bool = True

    def places(self) -> list[tuple[int, slice]]:
        """Each axis, with where its parameters stand."""
        out, end = [], 0
        for axis in self.axes:
            size = BROAD_PARAMETERS + TONE_PARAMETERS * len(self.begin[axis].tones)
            out.append((axis, slice(end, end + size)))
            end += size
        return out

    def spectra(self, x: Array) -> list[Spectrum]:
        """The spectra of a vector."""
        out = list(self.begin)
        for axis, here in self.places():
            out[axis] = Spectrum(tuple(self._parts(x[here], axis)))
        return out

    def _parts(self, x: Array, axis: int) -> list[Matern | Tone]:
        begin, size = NoiseModel.of(self.begin[axis]), np.exp(x[:BROAD_PARAMETERS])
        out: list[Matern | Tone] = [
            replace(begin.drift, sigma=size[0], timescale=size[1]),
            replace(begin.broadband, sigma=size[2], timescale=size[3]),
        ]
        tones = x[BROAD_PARAMETERS:].reshape(-1, TONE_PARAMETERS)
        for tone, (sigma, shift, width) in zip(begin.tones, tones, strict=True):
            frequency = tone.frequency + STRAYS * shift / self.evidence.length
            out.append(Tone(math.exp(sigma), frequency, math.exp(width)))
        return out

    def at_least_usual(self) -> list[Spectrum]:
        """The spectra they begin with, sizes of broadband parts and tones no smaller than the usual ones."""
        out = list(self.begin)
        for axis in self.axes:
            x = self._about(axis)[0]
            for k, usual in self._usual_sizes(axis):
                x[k] = max(float(x[k]), math.log(usual))
            out[axis] = Spectrum(tuple(self._parts(x, axis)))
        return out

    def search(self, settled: float) -> Array:
        """The best vector."""
        x, bounds, centre, pull, curvature = (
            np.concatenate(each) for each in zip(*(self._about(axis) for axis in self.axes), strict=True)
        )

        def objective(x: Array) -> tuple[float, Array]:
            try:
                value, by_lag = self.evidence.value_and_slope(self.spectra(x), self.axes)
            except (EstimationError, InputError):
                return math.inf, np.zeros_like(x)
            slope = np.concatenate(
                [self._by_parameters(x[here], axis, by_lag[axis]) for axis, here in places]
            )
            more, turned = self._believed(x)
            away = x - centre
            return value + more + float(pull @ away**2), slope + turned + 2.0 * pull * away

        places = self.places()
        start = np.clip(x, bounds[:, 0], bounds[:, 1])
        return descend_within(objective, start, bounds, np.diag(curvature + 2.0 * pull), ITERATIONS, settled)

    def _about(self, axis: int) -> tuple[Array, Array, Array, Array, Array]:
        """Of one axis: where the search begins, bounds, what is believed and how much, curvature."""
        step, length = self.evidence.data.grid.step, self.evidence.length
        begin = NoiseModel.of(self.begin[axis])
        x = [math.log(v) for part in (begin.drift, begin.broadband) for v in (part.sigma, part.timescale)]
        sizes = [(v + SIZES[0], v + SIZES[1]) for v in x]
        bounds = [
            sizes[0],
            (math.log(20.0 * step), math.log(LONGEST_DRIFT * length)),
            sizes[2],
            (math.log(0.2 * step), math.log(0.2 * length)),
        ]
        if not self.louder:
            bounds[2] = (sizes[2][0], x[2])
            bounds[3] = (min(max(bounds[3][0], x[3]), bounds[3][1]), bounds[3][1])
        centre, pull = list(x), [BELIEF**-2] * BROAD_PARAMETERS
        curvature = [CURVATURE] * BROAD_PARAMETERS
        for tone in begin.tones:
            size, widths = math.log(tone.sigma), tone_widths(tone.frequency, length)
            usual, least, most = (math.log(width) for width in widths)
            x += [size, 0.0, math.log(tone.bandwidth)]
            bounds += [(size + SIZES[0], size + SIZES[1]), (-1.0, 1.0), (least, most)]
            centre += [size, 0.0, usual]
            pull += [BELIEF**-2, 0.0, BELIEF**-2]  # frequencies: bounded, not believed
            # as for one axis
            turned = 4.0 * math.pi * STRAYS**2 / min(tone.bandwidth * length, 1.0)
            curvature += [TONE_CURVATURE, turned, TONE_CURVATURE]
        return np.array(x), np.array(bounds), np.array(centre), np.array(pull), np.array(curvature)

    def _by_parameters(self, x: Array, axis: int, by_lag: Array) -> Array:
        """Derivatives of the deviance by the parameters of one axis, from those by its autocovariance."""
        lags = self.evidence.data.grid.step * np.arange(float(len(by_lag)))
        step, out = 1e-3, np.zeros(len(x))
        for k in range(len(x)):
            part = k // 2 if k < BROAD_PARAMETERS else 2 + (k - BROAD_PARAMETERS) // TONE_PARAMETERS
            sides = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[k] += sign * step
                sides.append(self._parts(moved, axis)[part].autocovariance(lags))
            out[k] = by_lag @ (sides[0] - sides[1]) / (2.0 * step)
        return out

    def _believed(self, x: Array) -> tuple[float, Array]:
        """-2 log of what is believed of drifts, and of sizes beforehand, and its derivatives."""
        value, slope = 0.0, np.zeros(len(x))
        for axis, here in self.places():
            own, by = x[here], slope[here]
            more, by[:2] = drift_adjustment(float(own[0]), float(own[1]), self.evidence.length)
            value += more
            for k, usual in self._usual_sizes(axis):
                square = 0.5 * (math.exp(own[k]) / usual) ** 2
                value += 5.0 * math.log1p(square) - 2.0 * float(own[k])
                by[k] += 10.0 * square / (1.0 + square) - 2.0
        return value, slope

    def _usual_sizes(self, axis: int) -> list[tuple[int, float]]:
        """Parameters that are sizes of the broadband part and of tones, with the usual one."""
        usual = NoiseModel.of(self.usual[axis])
        out = [(2, usual.broadband.sigma)]
        for k, tone in enumerate(self.begin[axis].tones):
            size = usual_size(usual.tones, tone.frequency, self.evidence.length)
            if size is not None:
                out.append((BROAD_PARAMETERS + TONE_PARAMETERS * k, size))
        return out


def _middle(stars: Sequence[Star], grid: TimeGrid, order: int) -> tuple[int, int]:
    """First node, and that after the last, of what is looked at."""
    width = max(3 * order, bandwidth_of(stars, grid, 3, [GroundOrder()] * len(stars), relief=False))
    count = max(int(WORK / (3.0 * width**2)), math.ceil(LEAST_LAGS * width / 3.0))
    if count >= grid.count:
        return 0, grid.count
    first = (grid.count - count) // 2
    return first, first + count


def _within(star: Star, grid: TimeGrid) -> Star:
    """The matches of a star both instants of which lie on a grid."""
    half = 0.5 * star.longest
    begin, end = grid.start + half, grid.start + grid.step * (grid.count - 1) - half
    early, late = np.fmin(star.t, star.t_hub[:, None]), np.fmax(star.t, star.t_hub[:, None])
    return star.with_weight(np.where((early >= begin) & (late <= end), star.weight, 0.0))


__all__: Sequence[str] = ("TiedEvidence", "fit_tied")
