"""Kalman filter and smoother for differences over a lag: S1's third named filter, made exact.

The prior's parts are Markov processes of two or three states. A difference reaches back over its lag,
so the state also holds the motion at the last few hundred epochs, in a ring. Backwards it is
smoothed in the form of Bryson and Frazier, which needs no inverse and gives what Rauch, Tung and
Striebel's does.

Not here: the estimator to use. ``smoother.py`` solves the same problem by a band, faster, with errors
shared between pairs; this one is kept as an independent check of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.geometry.checks import as_times
from sightline.geometry.interpolation import stencils
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.harmonic import common_step
from sightline.motion.estimators.polynomial import checked_differences

Array = NDArray[np.float64]
AxisPriors = Spectrum | tuple[Spectrum, Spectrum, Spectrum]

#: Sigma of the constant that no difference sees, in sigmas of the prior. That it is not infinite changes
#: the relative variance by its ratio to the constant's, and rounding grows with the square: 3 keeps both
#: below 1e-4.
FREE_CONSTANT = 3.0

#: Largest state that is still worth a Kalman filter.
MAX_STATE = 1500


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A prior as a Markov process, ``x[k+1] = F x[k] + noise of covariance Q``.

    Attributes
    ----------
    transition, noise, stationary : (d, d)
        F, Q, and the covariance of x at any one epoch.
    output : (d,)
        The motion is ``output @ x``.
    """

    transition: Array
    noise: Array
    stationary: Array
    output: Array


def state_space(prior: Spectrum, step: float) -> StateSpace:
    """State-space form of `prior` at epochs `step` seconds apart; its autocovariance is kept exactly.

    Notes
    -----
    Hartikainen and Särkkä (2010): a Matern process of p derivatives is a critically damped oscillator of
    order p + 1; a tone is one that is damped at pi times its bandwidth.
    """
    from scipy.linalg import block_diag

    parts = [_part(c, step) for c in prior.components]
    transition = block_diag(*(f for f, _ in parts))
    stationary = block_diag(*(p for _, p in parts))
    output = np.concatenate([np.eye(len(f))[0] for f, _ in parts])
    return StateSpace(transition, stationary - transition @ stationary @ transition.T, stationary, output)


def _part(part: object, step: float) -> tuple[Array, Array]:
    """Transition and stationary covariance of one part of a spectrum."""
    if isinstance(part, Tone):
        return _tone(part, step)
    if isinstance(part, Matern):
        return _matern(part, step)
    raise InputError(
        f"`prior` holds a {type(part).__name__}, which has no state-space form; describe the motion by "
        "Matern parts and tones, or use `smooth`"
    )


def _tone(tone: Tone, step: float) -> tuple[Array, Array]:
    """Of its place, and its speed in units of the place: in those of the undamped oscillator."""
    damping, turn = math.pi * tone.bandwidth, 2.0 * math.pi * tone.frequency
    own, share = math.hypot(damping, turn), damping / turn
    cosine, sine = math.cos(turn * step), math.sin(turn * step)
    transition = np.array([
        [cosine + share * sine, own / turn * sine],
        [-own / turn * sine, cosine - share * sine],
    ])  # fmt: skip
    return math.exp(-damping * step) * transition, tone.sigma**2 * np.eye(2)


def _matern(part: Matern, step: float) -> tuple[Array, Array]:
    from scipy.linalg import expm, solve_continuous_lyapunov

    rate = 2.0 * math.pi * part.corner
    size = part.derivatives + 1
    # time in units of 1 / rate, so that derivatives of all orders are of one size
    drift = np.diag(np.ones(size - 1), 1)
    drift[-1] = [-math.comb(size, k) for k in range(size)]
    white = np.zeros((size, size))
    white[-1, -1] = 1.0
    stationary = solve_continuous_lyapunov(drift, -white)
    return expm(drift * rate * step), part.sigma**2 * stationary / stationary[0, 0]


def kalman(
    differences: Sequence[AngleDifferences],
    t: ArrayLike,
    *,
    prior: AxisPriors,
    grid_step: float | None = None,
) -> Motion:
    """Motion by a Kalman filter and smoother, each axis by itself.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        One pair or several, each difference with its own time and lag, and a mean over its window; gaps do no
        harm. Their errors are taken as independent, also those of pairs that share an image.
    t : (N,)
        s; where the motion is wanted, inside the span of the differences' instants.
    prior : Spectrum or three of them
        Of the motion (rad), for all axes or for roll, pitch, yaw.
    grid_step : float, optional
        s; of the epochs that the state steps through. By default a quarter of the shortest of the lags and
        of the usual time between differences, or less where the fastest tone asks for it (16 per period).

    Returns
    -------
    Motion
        Of mean zero over the epochs. Its covariance (diagonal) is that of the motion less its constant.

    Notes
    -----
    Time and lag of a difference become the four-point rows of a local cubic on the epochs. The constant
    is free, and held by the condition that the mean of the motion is zero: the only one it needs.
    """
    times = as_times(t, "t", increasing=True)
    pairs = checked_differences(differences)
    axes = (prior, prior, prior) if isinstance(prior, Spectrum) else prior
    first = min(float(np.minimum(d.t, d.t + d.lag).min()) for d in pairs)
    last = max(float(np.maximum(d.t, d.t + d.lag).max()) for d in pairs)
    if times[0] < first - 1e-9 or times[-1] > last + 1e-9:
        raise InputError(
            f"`t` spans [{times[0]:.6g}, {times[-1]:.6g}] s, the differences [{first:.6g}, {last:.6g}] s; "
            "the Kalman smoother does not extrapolate: ask within the span"
        )
    step = grid_step or epoch_step(pairs, axes)
    count = max(4, math.ceil((last - first) / step - 1e-9) + 1)
    epochs = np.asarray(first + step * np.arange(count), dtype=np.float64)
    rows = _rows(pairs, epochs)
    solved = [_smooth(state_space(axes[x], step), rows, x, len(epochs), axes[x].sigma) for x in range(3)]
    _, start, weights = stencils(epochs, times)
    taps = start[:, None] + np.arange(weights.shape[1])
    angles = np.stack([(weights * mean[taps]).sum(axis=1) for mean, _ in solved], axis=1)
    variance = np.stack([np.interp(times, epochs, v) for _, v in solved], axis=1)
    return Motion(times, angles, variance[:, :, None] * np.eye(3))


def epoch_step(pairs: Sequence[AngleDifferences], axes: Sequence[Spectrum]) -> float:
    """Step (s) of epochs fine enough for the lags, the differences and the tones."""
    shortest = min(float(np.abs(d.lag).min()) for d in pairs)
    step = min(0.25 * shortest, 0.25 * common_step(pairs))
    highest = max((tone.frequency for axis in axes for tone in axis.tones), default=0.0)
    return min(step, 1.0 / (16.0 * highest)) if highest else step


@dataclass(frozen=True, eq=False)
class _Rows:
    """Measurements as sparse rows on the epochs, in order of the last epoch they touch.

    `index` and `weight` (M, taps), `last` (M,), `values` and `variance` (M, 3); `depth` epochs are held.
    """

    index: NDArray[np.intp]
    weight: Array
    last: NDArray[np.intp]
    values: Array
    variance: Array
    depth: int


def _rows(pairs: Sequence[AngleDifferences], epochs: Array) -> _Rows:
    """``theta(t + lag) - theta(t)`` on the epochs."""
    begin = np.concatenate([d.t for d in pairs])
    end = np.concatenate([d.t + d.lag for d in pairs])
    window = np.concatenate([np.full(len(d), d.window) for d in pairs])
    points = 1 if not window.any() else 2 + math.ceil(float(window.max()) / float(epochs[1] - epochs[0]))
    taps, weights = [], []
    for when, sign in ((begin, -1.0), (end, 1.0)):
        for p in range(points):
            _, start, w = stencils(epochs, when + window * ((p + 0.5) / points - 0.5))
            taps.append(start[:, None] + np.arange(w.shape[1]))
            weights.append(sign * w / points)
    index, weight = np.concatenate(taps, axis=1), np.concatenate(weights, axis=1)
    # An epoch of weight zero is not waited for: on an even grid most rows touch two epochs only.
    touched = np.abs(weight) > 1e-9
    index = np.where(touched, index, index[np.arange(len(index)), touched.argmax(axis=1)][:, None])
    weight = np.where(touched, weight, 0.0)
    last = index.max(axis=1)
    order = np.argsort(last, kind="stable")
    depth = int((last - index.min(axis=1)).max()) + 1
    values = np.concatenate([d.angles for d in pairs])
    variance = np.concatenate([np.einsum("nii->ni", d.covariance) for d in pairs])
    return _Rows(index[order], weight[order], last[order], values[order], variance[order], depth)


def _smooth(space: StateSpace, rows: _Rows, axis: int, count: int, sigma: float) -> tuple[Array, Array]:
    """Smoothed motion and its variance at every epoch, (count,) each, for one axis.

    State: the parts of the prior, a constant, the mean of the motion so far, and a ring of `depth` epochs.
    """
    filtered = _Filter.start(space, rows.depth, count, sigma)
    bounds = np.searchsorted(rows.last, np.arange(count + 1))
    history: list[tuple[int, Array, Array, float, float]] = []
    rings = np.empty((count, filtered.size))
    now = np.empty((count, 2))
    for k in range(count):
        if k:
            filtered.advance(space)
        slot = filtered.remember(k)
        for i in range(bounds[k], bounds[k + 1]):
            h = np.zeros(filtered.size)
            np.add.at(h, filtered.ring(rows.index[i]), rows.weight[i])
            gain, innovation, s = filtered.measure(h, rows.values[i, axis], rows.variance[i, axis])
            history.append((k, h, gain, innovation, s))
        if k == count - 1:
            h = np.zeros(filtered.size)
            h[filtered.mean_at] = 1.0
            gain, innovation, s = filtered.measure(h, 0.0, (1e-6 * sigma) ** 2)
            history.append((k, h, gain, innovation, s))
        rings[k] = filtered.covariance[slot]
        now[k] = filtered.mean[slot], filtered.covariance[slot, slot]
    return _backwards(space, filtered, rings, now, history)


@dataclass(eq=False)
class _Filter:
    """Mean and covariance of the augmented state; changed in place, step by step."""

    mean: Array
    covariance: Array
    output: Array
    depth: int
    core: int
    count: int

    @classmethod
    def start(cls, space: StateSpace, depth: int, count: int, sigma: float) -> _Filter:
        """The prior at the first epoch; the ring is empty."""
        d = len(space.output)
        size = d + 2 + depth
        if size > MAX_STATE:
            raise EstimationError(
                f"the Kalman state would hold {size} numbers ({depth} epochs of the longest lag); "
                f"up to {MAX_STATE} are sensible; give a longer `grid_step`, or use the smoother"
            )
        covariance = np.zeros((size, size))
        covariance[:d, :d] = space.stationary
        covariance[d, d] = (FREE_CONSTANT * sigma) ** 2
        output = np.concatenate([space.output, [1.0]])
        return cls(np.zeros(size), covariance, output, depth, d, count)

    @property
    def size(self) -> int:
        """Length of the state."""
        return len(self.mean)

    @property
    def mean_at(self) -> int:
        """Place of the motion's share, so far, in its mean over all epochs."""
        return self.core + 1

    def ring(self, epoch: NDArray[np.intp] | int) -> NDArray[np.intp]:
        """Places of epochs in the state."""
        return np.asarray(self.core + 2 + np.asarray(epoch) % self.depth)

    def advance(self, space: StateSpace) -> None:
        """To the next epoch: the prior's parts move, everything else stays."""
        d, p, f = self.core, self.covariance, space.transition
        self.mean[:d] = f @ self.mean[:d]
        p[:d] = f @ p[:d]
        p[:, :d] = p[:, :d] @ f.T
        p[:d, :d] += space.noise

    def remember(self, epoch: int) -> int:
        """Copy the motion of this epoch into the ring and add it to the mean; its place."""
        slot, c, p = int(self.ring(epoch)), self.core + 1, self.covariance
        self.mean[slot] = self.output @ self.mean[:c]
        row = self.output @ p[:c]
        row[slot] = self.output @ row[:c]
        p[slot] = row
        p[:, slot] = row
        self.mean[self.mean_at] += self.mean[slot] / self.count
        p[self.mean_at] += p[slot] / self.count
        p[:, self.mean_at] += p[:, slot] / self.count
        return slot

    def measure(self, h: Array, value: float, variance: float) -> tuple[Array, float, float]:
        """Take in one measurement ``h @ x``; its gain, innovation and innovation variance."""
        used = np.flatnonzero(h)
        ph = self.covariance[:, used] @ h[used]
        s = float(h[used] @ ph[used]) + variance
        innovation = value - float(h[used] @ self.mean[used])
        gain = ph / s
        self.mean += gain * innovation
        self.covariance -= np.outer(gain, ph)
        return gain, innovation, s


def _backwards(
    space: StateSpace,
    end: _Filter,
    rings: Array,
    now: Array,
    history: list[tuple[int, Array, Array, float, float]],
) -> tuple[Array, Array]:
    """Bryson and Frazier: from the last measurement to the first, the adjoint of mean and covariance."""
    count, d = len(now), end.core
    adjoint, information = np.zeros(end.size), np.zeros((end.size, end.size))
    mean, variance = np.empty(count), np.empty(count)
    for k in range(count - 1, -1, -1):
        mean[k] = now[k, 0] - rings[k] @ adjoint
        variance[k] = now[k, 1] - rings[k] @ information @ rings[k]
        while history and history[-1][0] == k:
            _, h, gain, innovation, s = history.pop()
            adjoint -= h * (gain @ adjoint + innovation / s)
            carried = gain @ information
            information -= np.outer(h, carried) + np.outer(carried, h)
            information += np.outer(h, h) * (float(carried @ gain) + 1.0 / s)
        _forget(end, k, adjoint, information)
        adjoint[:d] = space.transition.T @ adjoint[:d]
        information[:d] = space.transition.T @ information[:d]
        information[:, :d] = information[:, :d] @ space.transition
    return mean, variance


def _forget(end: _Filter, epoch: int, adjoint: Array, information: Array) -> None:
    """Transpose of `_Filter.remember`: first of the mean, then of the copy into the ring."""
    slot, c = int(end.ring(epoch)), end.core + 1
    adjoint[slot] += adjoint[end.mean_at] / end.count
    information[slot] += information[end.mean_at] / end.count
    information[:, slot] += information[:, end.mean_at] / end.count
    adjoint[:c] += end.output * adjoint[slot]
    information[:c] += np.outer(end.output, information[slot])
    information[:, :c] += np.outer(information[:, slot], end.output)
    adjoint[slot] = 0.0
    information[slot] = 0.0
    information[:, slot] = 0.0


__all__: Sequence[str] = ("StateSpace", "epoch_step", "kalman", "state_space")
