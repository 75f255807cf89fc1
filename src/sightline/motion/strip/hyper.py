"""Priors of the three axes, learned from the rows of the joint problem.

Each row of windows is collapsed to one angle difference per pair, with what the present estimate
already explains added back; the spectrum of each axis then follows by marginal likelihood
(``estimation/likelihood.py``). The same rows serve S1's named estimators.

Not here: the joint solution itself (``joint.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz

from sightline.errors import EstimationError
from sightline.estimation.likelihood import WORK, FittedSpectrum, fit_spectrum
from sightline.estimation.prior import Autoregressive, Matern, Spectrum, TabulatedPsd, Tone
from sightline.estimation.search import ORDER, SAME_TONE, SETTLED, seen_modes
from sightline.estimation.series import DifferenceSeries
from sightline.estimation.split import SplitPrior, coarse_ratio, split
from sightline.execution import Step, in_threads, no_step
from sightline.motion.estimators.differences import PITCH, ROLL, YAW, AngleDifferences
from sightline.motion.measure.match_noise import overlapping
from sightline.motion.measure.observations import Star
from sightline.motion.observability import blind_together
from sightline.motion.strip.joint import JointEstimate
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.tied_axes import TiedEvidence, fit_tied
from sightline.writing import let_go

Array = NDArray[np.float64]

#: Information (rad^-2, sigma 0.1 rad) that keeps the angles finite of a row that cannot see them all.
WEAK = 1e2
#: Tones that are looked for per axis.
MOST_TONES = 8
#: Where less than this share of the variance of a row's angle is its own, and the rest another angle's on a
#: lever of the field, rows say nothing of its noise: what is not known of the other passes for it.
OWN = 0.5
#: Nodes to a line on which weights of uneven lines are laid.
FINER = 4
#: Hidden drifts are completed under motions about each axis of at least this share of that which drifts most.
STILLEST = 1.0 / 3.0
#: Broadband jitter of an axis is shown where it is so many times the noise of a row of windows.
SHOWN = 3.0
#: Deviance that the last step of that search gains at most: each is dear.
TIED_SETTLED = 1e-3
#: Longest time scale of a drift beside unknown relief, in lengths of the strip.
ROUGH = 0.5
#: Where more than this share of a pair's differences crosses a jump, jumps are the motion's nature.
MOST_ACROSS = 0.5
#: Mean square (rad^2/px^2) of the frequencies that a match weighs by how far the motion goes there, for roll,
#: pitch, yaw of axes that shake alike. With these `Search` has the share that `uneven_blur.displacement`
#: gains by a tone of 121 Hz beside 47 and 83 Hz of .3 and .15 px on all axes (16 stages of .5 ms, SNR 120):
#: .13, .09 and .18, the mean square of three sets of phases. To third order they would be 4.1, 4.8, 5.5: half
#: a pixel is beyond that, and an axis shows of the modes of others (yaw those of pitch, most).
DETAIL = (7.6, 4.7, 12.5)
#: rad and rad/s; how far constant angles and even rates may be from the reference attitude where nothing is
#: given.
ATTITUDE_SIGMA, RATE_SIGMA = 1e-2, 1e-3
#: Modes are not unlikely up to so many times the highest frequency of those that are seen.
NOT_FAR = 1.5
#: Where all pairs are blind, in units of one over the length of the data: from where on a tone beside is no
#: longer seen in a Hann window, where it is compared with what lies beside it, and width of a tone there.
FLANKS, BESIDE, BLIND_WIDTH = 4.0, (6.0, 7.0, 8.0), 0.25
#: Probability that chance shows one there.
CHANCE = 1e-3
#: Fewest rows of windows that tell of a pair's differences.
FEWEST_ROWS = 8


@dataclass(frozen=True)
class PriorModel:
    """Spectra of roll, pitch and yaw (rad), and how far the rows' errors exceed what their scatter shows.

    `noise_scale` holds one factor on the variance per axis: errors that a whole row shares do not scatter
    within it; the marginal likelihood sees them. `unseen` are wide tones, as strong as what TDI may hide at
    their frequencies: no estimate finds them, its sigma owns them. `products` are sums and differences of
    those and of seen modes (intermodulation): every estimate holds them, no body moves so, and the sigma owns
    them likewise. `blur_shows`: rows say how blur within stages shows what TDI hides, which is estimated with
    the rest then (``hidden.py``), and of which no products are left. `blind` are tones that may be of any
    axis where no pair tells (`_blind_modes`).
    """

    spectra: tuple[Spectrum, Spectrum, Spectrum]
    noise_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    unseen: tuple[tuple[Tone, ...], ...] = ((), (), ())
    products: tuple[tuple[Tone | TabulatedPsd, ...], ...] = ((), (), ())
    blur_shows: bool = False
    blind: tuple[tuple[Tone, ...], ...] = ((), (), ())

    def estimated(self) -> PriorModel:
        """The model whose spectra hold all that is estimated."""
        none: tuple[tuple[Tone, ...], ...] = ((), (), ())
        if self.blur_shows:
            return replace(self, spectra=self.whole(), unseen=none, blind=none)
        if any(self.blind):
            return replace(self, spectra=replace(self, unseen=none).whole(), blind=none)
        return self

    def whole(self) -> tuple[Spectrum, Spectrum, Spectrum]:
        """The spectra with what TDI averages away, and with what may be where all pairs are blind."""
        roll, pitch, yaw = (
            Spectrum((*s.components, *hidden, *blind)) if hidden or blind else s
            for s, hidden, blind in zip(self.spectra, self.unseen, self.blind, strict=True)
        )
        return roll, pitch, yaw

    @property
    def unestimated(self) -> tuple[tuple[Tone | TabulatedPsd, ...], ...]:
        """Errors of every estimate, per axis: what TDI averages away, and its products."""
        unseen = ((), (), ()) if self.blur_shows else self.unseen
        return tuple((*hidden, *made) for hidden, made in zip(unseen, self.products, strict=True))

    @property
    def unseen_variance(self) -> Array:
        """(3,) rad^2 of what TDI averages away, and of its products."""
        return np.array([sum(tone.sigma**2 for tone in tones) for tones in self.unestimated])

    def unseen_functionals(self, t: Array, weights: Array) -> Array:
        """Covariance (K, K) rad^2 of weighted sums, (N, 3, K), of it at the rising instants `t` (s)."""
        out = np.zeros((weights.shape[2],) * 2)
        if any(self.unestimated):
            t, weights = _evenly_weighted(t, weights)
        for axis, tones in enumerate(self.unestimated):
            if tones:
                lags = Spectrum(tones).autocovariance(t - t[0])
                out += weights[:, axis].T @ matmul_toeplitz(lags, weights[:, axis])
        return out

    def with_errors(self, more: Sequence[TabulatedPsd | None]) -> PriorModel:
        """The model with a further error of every estimate of roll, pitch, yaw (rad^2/Hz), or none."""
        both = zip(self.products, more, strict=True)
        return replace(self, products=tuple(own if one is None else (*own, one) for own, one in both))

    def grown(self, correlation: Array) -> Array:
        """Error correlation (2K, 2K) of a star scaled along lines (pitch, yaw) and columns (roll)."""
        roll, pitch, yaw = (max(scale, 1.0) for scale in self.noise_scale)
        size = np.sqrt(np.tile([0.5 * (pitch + yaw), roll], len(correlation) // 2))
        return np.asarray(correlation * np.outer(size, size))

    def with_turns(self, length: float, *, drift_alone: bool = False) -> PriorModel:
        """The model with a motion about the line of sight no smaller than that across it (rad).

        A narrow field hardly shows that angle: its likelihood is as content with none as with a large one,
        and a spectrum of none would be certain of it. Nothing holds a body stiller about one axis than
        another: where the drift found bends less, every part of the spectrum of that axis of the others
        whose drift bends most stands in the place of a smaller one, and what the field does show stays.

        Parameters
        ----------
        length : float
            s; of the strip.
        drift_alone : bool
            Whether the other parts hold what the field leaves open already.
        """
        bends = [_drift(s).bend(length) for s in self.spectra]
        across = self.spectra[int(np.argmax(bends[:2]))]
        if bends[2] >= max(bends[:2]):
            return self
        yaw = self.spectra[2]
        if drift_alone:
            others = tuple(c for c in yaw.components if c is not _drift(yaw))
            turns = Spectrum((_drift(across), *others))
        else:
            turns = _larger_parts(yaw, across, length)
        return replace(self, spectra=(*self.spectra[:2], turns))

    def beside_relief(self, length: float) -> PriorModel:
        """The model with a drift of pitch no smaller than that of roll (rad); `length` (s) of the strip.

        Relief that nobody knows shifts matches as pitch does, never as roll: what it takes from the drift of
        pitch in one estimate would not be looked for in the next. Nor is it so smooth that all that is
        quicker must be relief: its time scale is at most ROUGH of the length, its bend as found.
        """
        roll, pitch, yaw = self.spectra
        larger = max((_drift(roll), _drift(pitch)), key=lambda part: part.bend(length))
        if larger.timescale > ROUGH * length:
            quick = Matern(1.0, ROUGH * length, larger.order)
            larger = replace(quick, sigma=larger.bend(length) / quick.bend(length))
        others = tuple(part for part in pitch.components if part is not _drift(pitch))
        return replace(self, spectra=(roll, Spectrum((larger, *others)), yaw))

    def scaled(self, pixel_angle: float, half_field: float) -> PriorModel:
        """The model given in px (yaw: px at the field edge) as one in rad."""
        yaw = pixel_angle / max(half_field, pixel_angle)
        factors = (pixel_angle, pixel_angle, yaw)
        roll, pitch, turn = (s.scaled(f) for s, f in zip(self.spectra, factors, strict=True))
        return PriorModel((roll, pitch, turn))

    def alike(self, scale: Array, length: float) -> PriorModel:
        """The model with motions about all axes no smaller than STILLEST of that which drifts most (in px).

        An axis held stiller would not let hidden drifts move it; under motions larger than need be these bend
        where the images see little.

        Parameters
        ----------
        scale : (3,)
            rad of a pixel, per axis (yaw: of one at the field edge).
        length : float
            s; of the strip.
        """
        if not all(any(isinstance(c, Matern) for c in s.components) for s in self.spectra):
            return self  # densities that are given are taken as they are
        in_px = [s.scaled(1.0 / float(size)) for s, size in zip(self.spectra, scale, strict=True)]
        largest = in_px[int(np.argmax([_drift(s).bend(length) for s in in_px]))]
        least = largest.scaled(STILLEST)
        roll, pitch, yaw = (s if s is largest else _larger_parts(s, least, length) for s in in_px)
        return PriorModel(
            (roll.scaled(float(scale[0])), pitch.scaled(float(scale[1])), yaw.scaled(float(scale[2])))
        )

    def processes(self, grid: TimeGrid) -> tuple[Autoregressive, Autoregressive, Autoregressive]:
        """Autoregressive processes on the grid."""
        roll, pitch, yaw = (s.autoregressive(grid.step, ORDER, grid.count) for s in self.spectra)
        return roll, pitch, yaw

    def apart(self, grid: TimeGrid, width: int) -> tuple[SplitPrior, SplitPrior, SplitPrior] | None:
        """The processes with their drifts on one coarse grid; None where an axis has no drift to part.

        Parameters
        ----------
        width : int
            Nodes that the data's rows span.
        """
        ratios = [coarse_ratio(s, grid.step, ORDER, width=width) for s in self.spectra]
        ratio = min((r for r in ratios if r is not None), default=None)
        parts = [split(s, grid.step, ORDER, grid.count, ratio=ratio) for s in self.spectra]
        roll, pitch, yaw = parts
        return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def _drift(spectrum: Spectrum) -> Matern:
    """The first of the broad parts."""
    return next(c for c in spectrum.components if isinstance(c, Matern))


def _broadband(spectrum: Spectrum) -> Matern:
    """The last of the broad parts."""
    return [c for c in spectrum.components if isinstance(c, Matern)][-1]


def _larger_parts(one: Spectrum, other: Spectrum, length: float) -> Spectrum:
    """Drift, broadband and each tone of two spectra over `length` s, whichever is the larger."""
    drift = max((_drift(one), _drift(other)), key=lambda part: part.bend(length))
    broadband = max((_broadband(one), _broadband(other)), key=lambda part: part.sigma)
    tones = list(one.tones)
    for tone in other.tones:
        near = [k for k, own in enumerate(tones) if abs(own.frequency - tone.frequency) * length < SAME_TONE]
        if not near:
            tones.append(tone)
        elif tone.sigma > tones[near[0]].sigma:
            tones[near[0]] = tone
    return Spectrum((drift, broadband, *sorted(tones, key=lambda tone: tone.frequency)))


_WIDE = Spectrum((Matern(20.0, 1.0, "5/2"), Matern(0.5, 0.01, "3/2")))
#: What is assumed before anything is known, in px: tens of px of slow drift, half a px of jitter.
BROAD = PriorModel((_WIDE, _WIDE, _WIDE))


@dataclass(frozen=True)
class KnownContent:
    """What is known of the motion before the images are looked at: frequencies (S1, claim 8), and its size.

    Attributes
    ----------
    tones : tuple of float
        Hz; tones of any axis that are there whether the images show them or not.
    spectra : three Spectrum or None
        Of roll, pitch, yaw (rad): taken as they are, nothing is fitted.
    attitude_sigma, rate_sigma : float or None
        rad and rad/s; how far constant angles, and even rates, may be from the reference attitude. They bound
        what no image sees. None, where nothing is given: ATTITUDE_SIGMA and RATE_SIGMA, and of yaw as much
        more as the motion goes that is found.
    attitude_added : float
        rad; by what else, orbits or the Earth's turn, constant angles may be off beside that.
    """

    tones: tuple[float, ...] = ()
    spectra: tuple[Spectrum, Spectrum, Spectrum] | None = None
    attitude_sigma: float | None = None
    rate_sigma: float | None = None
    attitude_added: float = 0.0

    def usual(self) -> tuple[float, float]:
        """What is given of both; where nothing is, what is taken for granted."""
        angle = ATTITUDE_SIGMA if self.attitude_sigma is None else self.attitude_sigma
        rate = RATE_SIGMA if self.rate_sigma is None else self.rate_sigma
        return math.hypot(angle, self.attitude_added), rate


def angle_differences(
    stars: Sequence[Star],
    post_px: Sequence[Array],
    estimate: JointEstimate,
    relief_sigmas: tuple[float, float] = (0.0, 0.0),
) -> list[AngleDifferences]:
    """One difference of the three angles per row of windows and pair (S1 step b, about the present estimate).

    Parameters
    ----------
    stars : sequence of Star
    post_px : sequence of (G, K, 2)
        Residuals after the estimate.
    estimate : JointEstimate
        Its motion is added back, so that the differences are those of the whole motion.
    relief_sigmas : (float, float)
        m; of the mean height of a row of ground and of its slope at the field's edge, where neither is known:
        the covariance owns what they move.

    Returns
    -------
    list of AngleDifferences
        One per star and pair.
    """
    parts = [star.by_stages() for star in stars]
    out = _differences(stars, parts, post_px, estimate, relief_sigmas)
    if all(len(part) <= 1 for part in parts):
        return out
    seen = [np.isfinite(d.covariance[:, [0, 1, 2], [0, 1, 2]]).any(axis=0) for d in out]
    if seen and not np.any(seen, axis=0).all():  # the windows of each stage are too few, or too near together
        return _differences(stars, [[star] for star in stars], post_px, estimate, relief_sigmas)
    return out


def _differences(
    stars: Sequence[Star],
    parts: Sequence[Sequence[Star]],
    post_px: Sequence[Array],
    estimate: JointEstimate,
    relief_sigmas: tuple[float, float],
) -> list[AngleDifferences]:
    """The same of each of a star's `parts`: windows of a row that average alike, or all of it."""
    out = []
    patch_start = 0
    for star, alikes, post in zip(stars, parts, post_px, strict=True):
        rows, _ = star.shape
        for alike in alikes:
            for k, image in enumerate(star.images):
                part = _collapse(alike, post, k, relief_sigmas)
                good = np.flatnonzero(np.isfinite(part.t_hub))
                if len(good) < FEWEST_ROWS:
                    continue
                # of windows whose lines have instants of their own, those present set a row's
                good = good[np.argsort(part.t_hub[good], kind="stable")]
                at_hub = _seen(star, estimate, part.t_hub[good], part.tdi_hub)
                at_partner = _seen(star, estimate, part.t[good], part.tdi)
                out.append(
                    AngleDifferences(
                        t=part.t_hub[good],
                        lag=part.t[good] - part.t_hub[good],
                        angles=part.angles[good] + at_partner - at_hub,
                        covariance=part.covariance[good],
                        images=(star.hub, image),
                        window=star.duration,
                        stretch=star.stretch,
                        tdi=(round(part.tdi_hub, 12), round(part.tdi, 12)),
                        patch=patch_start + good,
                    )
                )
            patch_start += rows
    return out


@dataclass(frozen=True, eq=False)
class _Rows:
    t_hub: Array
    t: Array
    angles: Array
    covariance: Array
    tdi_hub: float = 0.0
    tdi: float = 0.0


def _collapse(star: Star, post: Array, k: int, relief_sigmas: tuple[float, float]) -> _Rows:
    """Weighted least squares of the three angles per row of windows for pair k; NaN where too few."""
    present, (hub, partner) = star.present[:, k], star.averaging()
    parts = []
    for some in star.stretches():
        parts.append(_collapsed(star, post, present, k, some, relief_sigmas))
        let_go()
    t_hub, t, angles, covariance = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not present.any():
        return _Rows(t_hub, t, angles, covariance)
    return _Rows(t_hub, t, angles, covariance, float(hub[present].mean()), float(partner[present, k].mean()))


def _collapsed(
    star: Star,
    post: Array,
    present: NDArray[np.bool_],
    k: int,
    some: slice,
    relief_sigmas: tuple[float, float],
) -> tuple[Array, Array, Array, Array]:
    """The same of some whole rows: instants in hub and partner, angles, covariance."""
    blocks = star.shape[1]
    scale = star.correlation[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
    factor = np.linalg.cholesky(star.covariance_px[some, k])
    covariance = factor @ scale @ np.swapaxes(factor, 1, 2)
    weight = np.linalg.inv(covariance)
    seen = present[some]
    weight = weight * np.where(seen, star.weight[some, k], 0.0)[:, None, None]
    j = star.by_partner[some, k].astype(float)
    y = np.where(seen[:, None], post[some, k], 0.0)
    normal = np.einsum("gca,gcd,gdb->gab", j, weight, j).reshape(-1, blocks, 3, 3).sum(1)
    right = np.einsum("gca,gcd,gd->ga", j, weight, y).reshape(-1, blocks, 3).sum(1)
    w = np.where(seen, 1.0, 0.0).reshape(-1, blocks)
    count = w.sum(1)
    inverse = np.linalg.inv(normal + WEAK * np.eye(3))
    angles = np.einsum("rab,rb->ra", inverse, right)
    # an axis, or a mix of axes, that a row cannot see: what it says there is what was put in
    diagonal = inverse[:, [0, 1, 2], [0, 1, 2]]
    unseen = WEAK * (inverse**2).sum(axis=2) > 0.5 * diagonal
    if any(relief_sigmas):
        field = star.field[some]
        shapes = np.stack([np.ones(len(field)), field], axis=1) * relief_sigmas
        height = np.nan_to_num(star.by_height[some, k].astype(float))[:, :, None] * shapes[:, None, :]
        pushed = np.einsum("gca,gcd,gds->gas", j, weight, height).reshape(-1, blocks, 3, 2).sum(1)
        moved = inverse @ pushed
        inverse = inverse + moved @ np.swapaxes(moved, 1, 2)
    diagonal = inverse[:, [0, 1, 2], [0, 1, 2]]
    inverse[:, [0, 1, 2], [0, 1, 2]] = np.where(unseen, np.inf, diagonal)
    with np.errstate(invalid="ignore", divide="ignore"):
        t_hub = np.where(count > 0, (w * star.t_hub[some].reshape(-1, blocks)).sum(1) / count, np.nan)
        t = np.nansum(w * np.nan_to_num(star.t[some, k]).reshape(-1, blocks), axis=1) / count
    return t_hub, t, angles, inverse


def _seen(star: Star, estimate: JointEstimate, t: Array, tdi: float) -> Array:
    """The motion (N, 3) at `t` as the windows of a star average it: pitch is seen along the lines.

    Its lines average over `tdi` (s).
    """
    out = window_means(estimate.grid, estimate.nodes, t, star.duration, tdi)
    if star.stretch > 0.0:
        whole = star.duration + star.stretch
        out[:, PITCH] = window_means(estimate.grid, estimate.nodes, t, whole, tdi)[:, PITCH]
    return out


def window_means(grid: TimeGrid, nodes: Array, t: Array, duration: float, tdi: float = 0.0) -> Array:
    """Mean of the node motion over windows of `duration` about `t`, of lines averaged over `tdi`: (N, C)."""
    if tdi > 0.0:
        points = 2 + int(np.ceil(2.0 * tdi / grid.step))
        offsets = tdi * ((np.arange(points) + 0.5) / points - 0.5)
        return np.asarray(sum(window_means(grid, nodes, t + o, duration) for o in offsets) / points)
    if duration <= 0.0:
        return grid.interpolate(nodes, t)
    points = 2 + int(np.ceil(duration / grid.step))
    offsets = duration * ((np.arange(points) + 0.5) / points - 0.5)
    return np.asarray(sum(grid.interpolate(nodes, t + o) for o in offsets) / points)


def fit_prior_model(
    stars: Sequence[Star],
    post_px: Sequence[Array],
    estimate: JointEstimate,
    pixel: Array,
    start: PriorModel | None = None,
    jumps: Sequence[Array] = (),
    grown_by: tuple[float, float, float] = (1.0, 1.0, 1.0),
    work: float = WORK,
    known_tones: Sequence[float] = (),
    step: Step = no_step,
    settled: float = SETTLED,
    near: bool = False,
    smoothness: bool = True,
    aside: bool = False,
) -> PriorModel:
    """Spectra of the three axes by marginal likelihood, tones found blind.

    Parameters
    ----------
    stars, post_px, estimate
        As for `angle_differences`.
    pixel : (3,)
        rad; one pixel of roll, pitch, and of yaw at the field edge: how far pairs may be offset.
    start : PriorModel, optional
        A model fitted before, to start from.
    jumps : three arrays, optional
        s; instants at which roll, pitch, yaw jump. Differences taken across one are left out: a step is no
        part of a spectrum.
    grown_by : (3,)
        Noise scales that the stars' correlations hold already.
    work : float
        Allowed per evaluation of the likelihood, see `estimation.likelihood.WORK`.
    known_tones : sequence of float
        Hz; see `estimation.likelihood.fit_spectrum`.
    step : callable
        Called with the number of fits that are done, and of all: two of each axis, by itself and with what
        the others show.
    settled : float
    near, smoothness : bool
        See `estimation.likelihood.fit_spectrum`.
    aside : bool
        Whether the camera looks far off the body's z: the turn about its line of sight is then, where rows do
        not show it, about as large as the angles across it.
    """
    differences = angle_differences(stars, post_px, estimate)
    if not differences:
        raise EstimationError(
            "no row of windows is seen by any pair; check that the bands overlap, and by more than the "
            "[matching] window"
        )

    dark = [
        name
        for axis, name in enumerate(("roll", "pitch", "yaw"))
        if not any(d.of_axis(axis).used.any() for d in differences)
    ]
    if dark:
        raise EstimationError(
            f"no row of any pair holds enough kept matches to show {', '.join(dark)}: too few windows side "
            "by side, or too weak a texture; give more columns, larger windows ([matching] window), or bands "
            "of more contrast"
        )
    untied = estimate.untied_drifts()

    def fitted(
        axis: int,
        begin: Spectrum | None = None,
        possible: Sequence[Tone] = (),
        corner: float | None = None,
        elsewhere: Sequence[tuple[float, float]] = (),
        usual: Spectrum | None = None,
    ) -> FittedSpectrum:
        series = [d.of_axis(axis) for d in differences]
        if jumps:
            series = [_without_jumps(one, jumps[axis]) for one in series]
        return fit_spectrum(
            series,
            start=begin or (None if start is None else start.spectra[axis]),
            offset_sigma=float(pixel[axis]),
            work=work,
            known_tones=known_tones,
            possible=possible,
            max_tones=MOST_TONES if begin is None else 0,
            corner=corner,
            detail=DETAIL[axis] / float(pixel[axis]) ** 2,
            elsewhere=elsewhere,
            motion=(estimate.grid.nodes, estimate.nodes[:, axis]),
            rate_seen=axis not in untied,
            settled=settled,
            near=near or begin is not None,
            smoothness=smoothness and begin is None,
            usual=usual,
        )

    first = in_threads(fitted, range(3), step=lambda done, _: step(done, 6))
    length = max(float(d.t.max()) for d in differences) - min(float(d.t.min()) for d in differences)
    spectra = [one.spectrum for one in first]
    missing = [_tones_elsewhere(spectra, axis, SAME_TONE / length) for axis in range(3)]
    row_sigma = [_row_sigma(differences, axis) for axis in range(3)]
    shown = _shown(spectra, row_sigma)
    corners = _corners_elsewhere(spectra, shown)

    # rows do not show the turn about a line of sight far aside, which holds some of the body's angles across
    across = None
    if aside and corners[YAW] is not None:
        across = _larger_parts(first[0].as_found, first[PITCH].as_found, length)

    certain = [any(chance == 1.0 for _, chance in one.through) for one in first]

    def shared(axis: int) -> FittedSpectrum:
        through = [
            (f, _odds_of_sharing(spectra[axis], one.spectrum, SAME_TONE / length, chance))
            for other, one in enumerate(first)
            for f, chance in (() if other == axis or certain[axis] else one.through)
        ]
        usual = across if axis == YAW else None
        if usual is None and not missing[axis] and corners[axis] is None and not through:
            return first[axis]
        return fitted(axis, spectra[axis], missing[axis], corners[axis], through, usual)

    roll, pitch, yaw = in_threads(shared, range(3), step=lambda done, _: step(3 + done, 6))
    spectra = [roll.spectrum, pitch.spectrum, yaw.spectrum]
    own = _own_share(differences)
    best = int(np.argmax(shown))
    # a pixel of each axis is alike: of yaw one at the edge, larger than what shakes a stiff body
    usual = [first[best].as_found.scaled(float(size / pixel[best])) for size in pixel]
    # none where rows do not see the angles
    together = min(own[ROLL], own[YAW]) < OWN and any(
        _rows_see(differences, axis) > 0.5 for axis in (ROLL, YAW)
    )
    # what stages hide shows in rows by its blur, and together would be taken for quick jitter: so only
    # where one angle by itself is as loud as rows can tell, up to half their rate, which is its noise
    staged = any(s.tdi is not None for s in stars)
    hidden_modes = staged and any(one.hidden for one in (roll, pitch, yaw))
    if hidden_modes:
        quick = 0.5 / max(float(np.median(np.diff(np.unique(d.t)))) for d in differences)
        together &= any(_broadband(spectra[axis]).corner > quick for axis in (ROLL, YAW))
    if together:
        if across is not None:
            usual[YAW] = across
        evidence = TiedEvidence.of(*_rows_apart(stars, post_px), estimate, ORDER)
        begins = [spectra, *([] if start is None else _of_one_kind(start.spectra, spectra))]
        tied = [ROLL, YAW] if own[PITCH] > OWN else [ROLL, PITCH, YAW]
        spectra = fit_tied(evidence, begins, tied, usual, max(settled, TIED_SETTLED), louder=not hidden_modes)
    scales = [
        one.noise_scale * max(grown, 1.0) if share > OWN else 1.0
        for one, grown, share in zip((roll, pitch, yaw), grown_by, own, strict=True)
    ]
    blur_shows = all(s.uneven is not None for s in stars)
    hidden = [roll.hidden, pitch.hidden, yaw.hidden]
    if start is not None and start.blur_shows:
        hidden = [old or new for old, new in zip(start.unseen, hidden, strict=True)]
    blind = _blind_modes([one.as_found for one in first], differences, estimate, pixel, length)
    if start is not None and any(start.blind):
        blind = start.blind
    model = PriorModel(
        (spectra[0], spectra[1], spectra[2]),
        (scales[0], scales[1], scales[2]),
        (hidden[0], hidden[1], hidden[2]),
        ((), (), ()) if blur_shows else (roll.products, pitch.products, yaw.products),
        blur_shows,
        blind,
    )
    return model.with_turns(length, drift_alone=across is not None)


def _rows_apart(stars: Sequence[Star], post_px: Sequence[Array]) -> tuple[list[Star], list[Array]]:
    """The stars, and their residuals, by rows of windows that share no lines, each in place of all it shares.

    Errors of rows that share pixels are as large in the long run as the stars' correlations say, and far less
    from row to row: taken for white noise as large, they would speak against any quick jitter.
    """
    apart, residuals = [], []
    for star, post in zip(stars, post_px, strict=True):
        each = overlapping(star) + 1
        if each > 1:
            some = slice(0, star.shape[0], each)
            post = star.of_rows(post, some)
            star = star.rows(some).with_correlation(star.correlation / each)
        apart.append(star)
        residuals.append(post)
    return apart, residuals


def _of_one_kind(before: Sequence[Spectrum], spectra: Sequence[Spectrum]) -> list[Sequence[Spectrum]]:
    """The spectra fitted before, if they are of the same kind: broad parts of one order, tones alike."""
    for old, new in zip(before, spectra, strict=True):
        if len(old.tones) != len(new.tones) or _broadband(old).order != _broadband(new).order:
            return []
    return [before]


def _tones_elsewhere(spectra: Sequence[Spectrum], axis: int, apart: float) -> list[Tone]:
    """Tones, `apart` (Hz) at least, that other axes have and this one does not, as large as to be expected.

    What shakes a spacecraft shakes all axes of it. A tone too weak to be found by itself would be owned by
    nobody; where another axis shows it, it may be here too, as large as goes unseen. Where both axes show
    another tone, this one is about as much larger or smaller than there as that; where they share none it
    may be as large as the largest that is here, and where there is none as the drift.
    """
    own = spectra[axis].tones
    largest = max((tone.sigma for tone in own), default=_drift(spectra[axis]).sigma)
    out: list[Tone] = []
    shares = {k: _share(own, spectrum.tones, apart) for k, spectrum in enumerate(spectra) if k != axis}
    for other, share in sorted(shares.items(), key=lambda pair: (pair[1] is None, pair[0])):
        for tone in spectra[other].tones:
            size = largest if share is None else share * tone.sigma
            near = [k for k, one in enumerate(out) if abs(tone.frequency - one.frequency) <= apart]
            if near and share is not None:
                out[near[0]] = replace(out[near[0]], sigma=max(size, out[near[0]].sigma))
            elif not near and all(abs(tone.frequency - one.frequency) > apart for one in own):
                out.append(replace(tone, sigma=size))
    return out


def _blind_modes(
    found: Sequence[Spectrum],
    differences: Sequence[AngleDifferences],
    estimate: JointEstimate,
    pixel: Array,
    length: float,
) -> tuple[tuple[Tone, ...], ...]:
    """Tones (rad) that roll, pitch and yaw may have where all pairs are blind and the estimate shows one.

    Parameters
    ----------
    found : three Spectrum
        With the tones that the differences of each axis show by themselves.
    differences, estimate
        As for `angle_differences`.
    pixel : (3,)
        rad
    length : float
        s; of the data.

    Notes
    -----
    Bands that look ahead are moved across by yaw itself, not by a difference of it, by as much more as they
    look farther ahead: as a tone of roll beside a frequency to which all pairs are blind moves them. Which
    of the two it is no match tells, and differences, about an estimate that has taken one of them, show
    nothing of the other. A tone of such a frequency in the estimate of any axis is taken for a mode
    that may be of each, as large as the strongest that are seen: with the odds of one to one. So is one that
    is found no farther from there than tones are told apart, where it is found on average: what an axis
    shows of it changes much within what is known of its frequency, and may be another's; pitch, which moves
    bands along the strip as no other does, has no more of it than it shows.
    """
    none: tuple[tuple[Tone, ...], ...] = ((), (), ())
    tones = [(t.frequency, (t.sigma / px) ** 2) for s, px in zip(found, pixel, strict=True) for t in s.tones]
    if not tones:
        return none
    frequency, variance = np.array(tones).T
    lags = [float(np.median(d.lag)) for d in differences]
    blind = blind_together(lags, [len(d.t) for d in differences], NOT_FAR * float(frequency.max())).tolist()
    strength = seen_modes(frequency, variance)[0]
    some = []
    for f in blind:
        near = np.abs(frequency - f) <= SAME_TONE / length
        if near.any():
            some.append(float(np.average(frequency[near], weights=variance[near])))
        elif _moves_at(f, 3 * len(blind), found, differences, estimate, length):
            some.append(f)
    # nothing but pitch moves bands along the strip: what it shows there is its own
    own = [tone.frequency for tone in found[PITCH].tones]
    unshown = [f for f in some if all(abs(f - shown) > SAME_TONE / length for shown in own)]
    return tuple(
        tuple(Tone(px * math.sqrt(0.5 * strength / f**3), f, BLIND_WIDTH / length) for f in possible)
        for px, possible in zip(pixel.tolist(), (some, unshown, some), strict=True)
    )


def _moves_at(
    frequency: float,
    trials: int,
    found: Sequence[Spectrum],
    differences: Sequence[AngleDifferences],
    estimate: JointEstimate,
    length: float,
) -> bool:
    """Whether the estimate of an axis moves at a frequency (Hz) as its error and its jitter hardly ever do.

    Of so many `trials`; not of an axis that has tones so near that their flanks reach there.
    """
    first = min(float(np.minimum(d.t, d.t + d.lag).min()) for d in differences)
    last = max(float(np.maximum(d.t, d.t + d.lag).max()) for d in differences)
    inside = (estimate.grid.nodes >= first) & (estimate.grid.nodes <= last)
    t = estimate.grid.nodes[inside]
    u = (t - 0.5 * (first + last)) / (0.5 * (last - first))
    places = frequency + np.array([0.0, *BESIDE, *(-f for f in BESIDE)]) / length
    window = np.cos(0.5 * math.pi * u) ** 2
    waves = (2.0 * window / window.sum())[:, None] * np.exp(2j * math.pi * np.outer(t, places))
    drift = np.polynomial.legendre.legvander(u, 3)
    for axis, spectrum in enumerate(found):
        if any(abs(tone.frequency - frequency) < FLANKS / length for tone in spectrum.tones):
            continue
        angles = estimate.nodes[inside, axis]
        rest = angles - drift @ np.linalg.lstsq(drift, angles, rcond=None)[0]
        power = np.abs(waves.T @ rest) ** 2
        weights = np.zeros((len(t), 3, 2))
        weights[:, axis] = np.stack([waves[:, 0].real, waves[:, 0].imag], axis=1)
        error = float(np.trace(estimate.functional_covariance(t, weights)))
        # without a tone an exponential of that mean
        if power[0] > (error + power[1:].mean()) * math.log(trials / CHANCE):
            return True
    return False


def _odds_of_sharing(own: Spectrum, other: Spectrum, apart: float, chance: float) -> float:
    """Odds that an axis has a further mode of another, by how many of its tones it has (Laplace's rule).

    The other has that mode by a `chance`.
    """
    shared = sum(any(abs(a.frequency - b.frequency) <= apart for a in own.tones) for b in other.tones)
    both = chance * (shared + 1.0) / (len(other.tones) + 2.0)
    return both / (1.0 - both)


def _share(own: Sequence[Tone], others: Sequence[Tone], apart: float) -> float | None:
    """How large tones of `own` are beside those of `others` that they share; None where they share none."""
    both = [(a.sigma, b.sigma) for a in own for b in others if abs(a.frequency - b.frequency) <= apart]
    sizes = np.square(np.array(both).reshape(-1, 2)).sum(axis=0)
    return float(np.sqrt(sizes[0] / sizes[1])) if both else None


def _evenly_weighted(t: Array, weights: Array) -> tuple[Array, Array]:
    """Even instants, and weights (M, 3, K) of theirs that stand for those (N, 3, K) at `t` (s).

    Uneven instants lie between nodes FINER times as dense: a straight line between these is 8 % off at half
    the rate of the lines, .5 % at an eighth.
    """
    steps = np.diff(t)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        return t, weights
    even = np.linspace(t[0], t[-1], FINER * (len(t) - 1) + 1)
    place = np.clip((t - t[0]) / (even[1] - even[0]), 0.0, len(even) - 1.0)
    first = np.minimum(place.astype(np.intp), len(even) - 2)
    share = (place - first)[:, None, None]
    out = np.zeros((len(even), *weights.shape[1:]))
    np.add.at(out, first, (1.0 - share) * weights)
    np.add.at(out, first + 1, share * weights)
    return even, out


def _own_share(differences: Sequence[AngleDifferences]) -> Array:
    """Median share (3,) of the variance of a row's roll, pitch, yaw that is no error of another angle."""
    covariance = np.concatenate([d.covariance for d in differences])
    covariance = covariance[np.isfinite(covariance).all(axis=(1, 2))]
    if len(covariance) == 0:
        return np.ones(3)
    alone = 1.0 / np.linalg.inv(covariance)[:, [0, 1, 2], [0, 1, 2]]
    return np.asarray(np.median(alone / covariance[:, [0, 1, 2], [0, 1, 2]], axis=0))


def _row_sigma(differences: Sequence[AngleDifferences], axis: int) -> float:
    """Median sigma (rad) of one row's difference of an angle, of rows that see it; infinite if none does."""
    variance = np.concatenate([d.covariance[:, axis, axis] for d in differences])
    seen = variance[np.isfinite(variance)]
    return float(np.sqrt(np.median(seen))) if len(seen) else math.inf


def _rows_see(differences: Sequence[AngleDifferences], axis: int) -> float:
    """Share of rows that see an angle by themselves."""
    return float(np.mean(np.concatenate([np.isfinite(d.covariance[:, axis, axis]) for d in differences])))


def _shown(spectra: Sequence[Spectrum], row_sigma: Sequence[float]) -> list[float]:
    """Size of the broadband jitter of each axis, in units of the noise of a row of windows."""
    return [_broadband(s).sigma / sigma for s, sigma in zip(spectra, row_sigma, strict=True)]


def _corners_elsewhere(spectra: Sequence[Spectrum], shown: Sequence[float]) -> list[float | None]:
    """Corner (Hz) of the broadband jitter of the axis that shows it best, for axes whose rows do not show it.

    Below the noise of a row, jitter and noise are separated by how they follow in time alone: jitter of a
    corner above all that is seen would pass for noise, and noise for jitter. What shakes one axis of a body
    shakes the others about as fast.
    """
    best = int(np.argmax(shown))
    if shown[best] < SHOWN:
        return [None] * len(shown)
    return [_broadband(spectra[best]).corner if one < SHOWN else None for one in shown]


def _without_jumps(series: DifferenceSeries, jumps: Array) -> DifferenceSeries:
    """The series with differences across a jump made infinitely uncertain."""
    early = np.minimum(series.t, series.t + series.lag) - series.whole
    late = np.maximum(series.t, series.t + series.lag) + series.whole
    across = np.zeros(len(series.t), dtype=bool)
    for instant in jumps:
        across |= (early < instant) & (instant < late)
    if across.mean() > MOST_ACROSS:
        return series
    return replace(series, variance=np.where(across, np.inf, series.variance))
