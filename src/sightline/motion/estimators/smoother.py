"""The banded maximum-likelihood smoother: posterior mean and sigma of each axis by itself.

All pairs at once, each difference with its own two times, its window and the errors it shares with
other pairs, under a prior spectrum that is given or found in the data. Cost grows linearly with the
length of the strip. This is the fast special case of the joint estimate, for axes that do not mix.

Not here: exact rays, band offsets tied to the geometry, relief (``motion/strip/joint.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.estimation.evidence import Posterior, posterior
from sightline.estimation.likelihood import FittedSpectrum, default_step, fit_spectrum, fitting_step, span
from sightline.estimation.prior import Spectrum
from sightline.estimation.robust import expected_innovations, student_weights
from sightline.estimation.series import DifferenceSeries, Grid, SeriesEquations, series_equations
from sightline.estimation.series_kernels import TAPS
from sightline.estimation.split import split
from sightline.geometry.checks import as_times
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences

Array = NDArray[np.float64]

#: Order of the autoregressive prior; against the exact prior the loss is below 0.5 %.
ORDER = 60
#: Rounds in which the weights of jumping innovations settle.
JUMP_ROUNDS = 8
AXES = ("roll", "pitch", "yaw")


def smooth(
    differences: Sequence[AngleDifferences],
    t: ArrayLike,
    *,
    prior: Spectrum | FittedSpectrum | Sequence[Spectrum | FittedSpectrum] | None = None,
    grid_step: float | None = None,
    offset_sigma: float | None = None,
    independent: float = 0.0,
    order: int = ORDER,
    jumps: bool = False,
) -> Motion:
    """Motion with its covariance from the differences of all pairs.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        Any number of pairs. Those that name the same image and patch share that image's error.
    t : (N,)
        s; where the motion is wanted. Gaps and the ends beyond the data are bridged by the prior.
    prior : Spectrum or FittedSpectrum, one or three, optional
        Of roll, pitch and yaw (rad). By default found in the data, tones included (`fit_spectra`).
        A FittedSpectrum also scales the measurement variances.
    grid_step : float, optional
        s; step of the time grid, at most 1/7 period of the fastest motion. By default a seventh of
        the shortest lag, within 1/5 to 1 sampling step of the differences. A prior is not looked for
        in the data on a finer one.
    offset_sigma : float, optional
        rad; 1-sigma of an unknown constant angle of every image. By default the images' geometry is
        taken as exact. With it, a linear drift is hidden as well as the constant.
    independent : float
        Fraction of each difference's variance that no other pair of the patch shares.
    order : int
        Of the autoregressive prior.
    jumps : bool
        Whether the motion may jump now and then: its innovations are then Student's, not Gaussian, and
        a step is followed instead of smeared.

    Returns
    -------
    Motion
        At `t`, less what the differences cannot see: each axis has mean zero over `t` (and no linear
        trend when offsets are free), and its covariance is that of the motion so reduced. Axes are
        estimated one by one, so that the covariance is diagonal.

    Raises
    ------
    InputError
        If no difference is usable, or `prior` is neither one spectrum nor three.

    Notes
    -----
    S1, III, "filtering", in its optimal form: ``m = (Q + H' R^-1 H)^-1 H' R^-1 y`` with Q the banded
    precision of the prior and H rows of local interpolation at t and t + lag.

    Examples
    --------
    >>> t = np.arange(0.0, 1.0, 0.01)
    >>> roll = 1e-5 * np.sin(2 * np.pi * 2.0 * t)
    >>> angles = np.zeros((90, 3))
    >>> angles[:, 0] = roll[10:] - roll[:-10]
    >>> pair = AngleDifferences(t[:90], np.full(90, 0.1), angles, np.tile(1e-16 * np.eye(3), (90, 1, 1)))
    >>> from sightline.estimation.prior import Matern
    >>> motion = smooth([pair], t, prior=Spectrum((Matern(1e-5, 0.2, "5/2"),)))
    >>> bool(np.abs(motion.angles[:, 0] - (roll - roll.mean())).max() < 2e-7)
    True
    """
    times = as_times(t, "t", increasing=True)
    series = [axis_series(differences, axis) for axis in range(3)]
    step = default_step(series[0]) if grid_step is None else grid_step
    first, last = span(series[0])
    margin = 0.5 * TAPS * step
    grid = Grid.covering(min(first, times[0]) - margin, max(last, times[-1]) + margin, step)
    if prior is None:
        # An autoregression tells tones apart that its memory of so many steps holds a period of their
        # difference of: on a finer grid than the fit asks for, dying tones were taken for others, and
        # a fit that had room for the middle of the motion alone knew nothing of what began later.
        own = max(default_step(series[0]), fitting_step(series[0]))
        coarse = None if grid_step is None or grid_step <= own else grid_step
        prior = fit_spectra(differences, grid_step=coarse, offset_sigma=offset_sigma, independent=independent)
    angles = np.empty((len(times), 3))
    covariance = np.zeros((len(times), 3, 3))
    for axis, believed in enumerate(_three(prior)):
        equations = series_equations(
            series[axis],
            grid,
            offsets=offset_sigma is not None,
            independent=independent,
            spectrum=believed.spectrum,
        )
        now = _solve(equations, believed, order, 1.0 if offset_sigma is None else offset_sigma, jumps)
        angles[:, axis], covariance[:, axis, axis] = reduced(now, times, trend=offset_sigma is not None)
    return Motion(times, angles, covariance)


def _solve(
    equations: SeriesEquations, believed: FittedSpectrum, order: int, offset_sigma: float, jumps: bool
) -> Posterior:
    """Posterior of one axis; with `jumps` after some rounds of weights for the prior's innovations."""
    grid, scale = equations.grid, believed.noise_scale
    plain = believed.spectrum.autoregressive(grid.step, order, grid.count)
    if not jumps:
        apart = split(believed.spectrum, grid.step, order, grid.count, width=len(equations.band) - 1)
        prior = plain if apart is None else apart
        return posterior(equations, prior, noise_scale=scale, offset_sigma=offset_sigma)
    now = posterior(equations, plain, noise_scale=scale, offset_sigma=offset_sigma)
    for _ in range(JUMP_ROUNDS):
        expected = expected_innovations(plain, now.mean, now.covariance_band(plain.order))
        weights = student_weights(expected)
        now = posterior(equations, plain, noise_scale=scale, offset_sigma=offset_sigma, weights=weights)
    return now


def fit_spectra(
    differences: Sequence[AngleDifferences],
    *,
    grid_step: float | None = None,
    offset_sigma: float | None = None,
    independent: float = 0.0,
    max_tones: int = 8,
) -> tuple[FittedSpectrum, FittedSpectrum, FittedSpectrum]:
    """Spectra of roll, pitch and yaw (rad) by marginal likelihood, tones found blind.

    Parameters are those of `smooth`; `max_tones` limits the search for tones on each axis.
    """
    roll, pitch, yaw = (
        fit_spectrum(
            axis_series(differences, axis),
            step=grid_step,
            offset_sigma=offset_sigma,
            independent=independent,
            max_tones=max_tones,
        )
        for axis in range(3)
    )
    return roll, pitch, yaw


def axis_series(differences: Sequence[AngleDifferences], axis: int) -> list[DifferenceSeries]:
    """One axis (0 roll, 1 pitch, 2 yaw) of all pairs, its variance being the marginal one."""
    if len(differences) == 0:
        raise InputError("`differences` is empty; give the angle differences of at least one image pair")
    return [d.of_axis(axis) for d in differences]


def reduced(now: Posterior, t: Array, *, trend: bool = False) -> tuple[Array, Array]:
    """Mean and variance at `t` (N,) of the motion less its mean over `t`, or less its linear trend."""
    grid = now.equations.grid
    first, w = grid.weights(t)
    nodes = first[:, None] + np.arange(w.shape[1])
    u = np.linspace(-1.0, 1.0, len(t)) if len(t) < 2 else 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    shapes = np.stack([np.ones(len(t)), u], axis=1)[:, : 2 if trend and len(t) > 2 else 1]
    hidden = np.linalg.qr(shapes)[0]
    spread = np.zeros((grid.count, hidden.shape[1]))
    for k in range(w.shape[1]):
        np.add.at(spread, nodes[:, k], w[:, k, None] * hidden)
    along = np.einsum("nk,nkh->nh", w, now.covariance_times(spread)[nodes])
    band = now.covariance_band(w.shape[1] - 1)
    variance = np.zeros(len(t))
    for k in range(w.shape[1]):
        for h in range(k + 1):
            pair = w[:, k] * w[:, h] * band[k - h, nodes[:, h]]
            variance += pair if h == k else 2.0 * pair
    variance += np.sum(hidden * (hidden @ (hidden.T @ along) - 2.0 * along), axis=1)
    values = np.einsum("nk,nk->n", w, now.mean[nodes])
    return values - hidden @ (hidden.T @ values), np.maximum(variance, 0.0)


def _three(
    prior: Spectrum | FittedSpectrum | Sequence[Spectrum | FittedSpectrum],
) -> tuple[FittedSpectrum, ...]:
    """One belief per axis."""
    given = (prior,) * 3 if isinstance(prior, (Spectrum, FittedSpectrum)) else tuple(prior)
    if len(given) != 3:
        raise InputError(f"`prior` must be one spectrum or one for each of {AXES}, got {len(given)}")
    return tuple(
        p if isinstance(p, FittedSpectrum) else FittedSpectrum(p, 1.0, float("nan"), float("nan"))
        for p in given
    )
