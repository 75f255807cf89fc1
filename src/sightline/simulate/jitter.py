"""Motions with a seed: what shakes a line of sight, as a sum of parts whose law is known.

A part gives one axis against time; a :class:`JitterProfile` holds the parts of roll, pitch and yaw and
becomes a :class:`~sightline.geometry.trajectory.Motion`. Parts marked ``instrument`` move the line of
sight but not the body: gyros and star trackers do not feel them.

Random parts are drawn by circulant embedding of their autocovariance, so that their law is exact at the
knots and shares no code with the priors of ``estimation``. Measured curves are read in ``measured.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.trajectory import Motion

Array = NDArray[np.float64]


class JitterPart(Protocol):
    """One part of the motion of one axis."""

    @property
    def instrument(self) -> bool:
        """True where the instrument moves inside the body: attitude sensors do not feel it."""
        ...

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """Values at the evenly spaced times `t` (N,) s; random numbers come from `rng` alone."""
        ...


@dataclass(frozen=True)
class ConstantJitter:
    """A constant, drawn from a normal law: the pointing error that images alone cannot see.

    Parameters
    ----------
    sigma : float
        Standard deviation of the constant, in the unit of the profile.
    """

    sigma: float
    instrument: bool = False

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """The same normal draw at every time."""
        return np.full(t.shape, self.sigma * rng.standard_normal())


@dataclass(frozen=True)
class MaternJitter:
    """A stationary Gaussian process of Matern's family.

    Parameters
    ----------
    sigma : float
        Standard deviation, in the unit of the profile.
    timescale : float
        s; the length l of the usual form, in which the decay rate is ``sqrt(2 nu) / l``.
    order : {"3/2", "5/2"}
        Smoothness nu: one or two derivatives.

    Notes
    -----
    With r = sqrt(2 nu) |lag| / l: order 3/2 is sigma^2 (1 + r) exp(-r), order 5/2 is
    sigma^2 (1 + r + r^2/3) exp(-r).
    """

    sigma: float
    timescale: float
    order: str = "3/2"
    instrument: bool = False

    def autocovariance(self, lags: Array) -> Array:
        """Covariance at time differences `lags`, s."""
        if self.order == "3/2":
            r = np.sqrt(3.0) * np.abs(lags) / self.timescale
            return self.sigma**2 * (1.0 + r) * np.exp(-r)
        if self.order == "5/2":
            r = np.sqrt(5.0) * np.abs(lags) / self.timescale
            return self.sigma**2 * (1.0 + r + r**2 / 3.0) * np.exp(-r)
        raise InputError(f"unknown Matern order: got {self.order!r}; allowed are '3/2' and '5/2'")

    @classmethod
    def with_corner(cls, sigma: float, corner: float, order: str = "3/2") -> MaternJitter:
        """The process whose spectrum bends at `corner` Hz: PSD as (1 + (f/corner)^2)^-(nu + 1/2)."""
        twice_nu = {"3/2": 3.0, "5/2": 5.0}.get(order)
        if twice_nu is None:
            raise InputError(f"unknown Matern order: got {order!r}; allowed are '3/2' and '5/2'")
        return cls(sigma, float(np.sqrt(twice_nu)) / (2.0 * np.pi * corner), order)

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """An exact draw of the process at the evenly spaced times `t`."""
        step = time_step(t)
        # a period of ten timescales beyond the wanted span leaves no correlation around the circle
        period = t.size + int(np.ceil(10.0 * self.timescale / step)) + 1
        distance = np.minimum(np.arange(period), period - np.arange(period)) * step
        eigenvalues = np.maximum(np.fft.rfft(self.autocovariance(distance)).real, 0.0)
        white = np.fft.rfft(rng.standard_normal(period))
        return np.fft.irfft(white * np.sqrt(eigenvalues), period)[: t.size]


@dataclass(frozen=True)
class ToneJitter:
    """A sinusoid of known size and random phase: a wheel, a cooler, a flexible mode.

    Parameters
    ----------
    rms : float
        Root mean square, in the unit of the profile; the amplitude is sqrt(2) times larger.
    frequency : float
        Hz.
    since : float
        Where it begins, as a part of the span: 0.5 starts it in the middle, at once.
    """

    rms: float
    frequency: float
    instrument: bool = True
    since: float = 0.0

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """The sinusoid, its phase uniform over the circle; nothing before it begins."""
        phase = rng.uniform(0.0, 2.0 * np.pi)
        wave = self.rms * np.sqrt(2.0) * np.sin(2.0 * np.pi * self.frequency * t + phase)
        return np.where(t >= t[0] + self.since * (t[-1] - t[0]), wave, 0.0)


@dataclass(frozen=True, eq=False)
class CurveJitter:
    """A measured curve: scaled to a wanted rms, stretched in time, started anywhere it fits.

    Parameters
    ----------
    t : (K,) s, increasing
    values : (K,) any unit
    rms : float or None
        Root mean square about the mean of the part used, in the unit of the profile; None keeps the values.
    stretch : float
        Time of the curve is multiplied by this (below 1 plays it faster).
    start : float or None
        s of the stretched curve at the first time asked for; None draws it evenly.
    """

    t: Array
    values: Array
    rms: float | None = None
    stretch: float = 1.0
    start: float | None = None
    instrument: bool = False

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """The curve by a cubic spline; raises InputError where it is shorter than the span asked for."""
        from scipy.interpolate import CubicSpline

        span = float(t[-1] - t[0])
        clock = (self.t - self.t[0]) * self.stretch
        spare = float(clock[-1]) - span
        if spare < 0.0:
            raise InputError(
                f"the measured curve is too short: {clock[-1]:.3f} s after stretching by {self.stretch:g}; "
                f"the scene lasts {span:.3f} s; raise `stretch` above {span / (self.t[-1] - self.t[0]):.3f}"
            )
        start = rng.uniform(0.0, spare) if self.start is None else min(self.start, spare)
        values: Array = CubicSpline(clock, self.values)(t - t[0] + start)
        if self.rms is None:
            return values
        values = values - values.mean()
        return values * (self.rms / max(float(np.sqrt(np.mean(values**2))), 1e-300))


@dataclass(frozen=True)
class ChirpJitter:
    """A sinusoid whose frequency sweeps evenly from `first` to `last` Hz over the span.

    Parameters
    ----------
    rms : float
        Root mean square, in the unit of the profile.
    first, last : float
        Hz, at the first and the last time asked for.
    """

    rms: float
    first: float
    last: float
    instrument: bool = True

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """The chirp, its phase uniform over the circle."""
        since = t - t[0]
        span = max(float(since[-1]), 1e-12)
        turns = self.first * since + 0.5 * (self.last - self.first) * since**2 / span
        return self.rms * np.sqrt(2.0) * np.sin(2.0 * np.pi * (turns + rng.uniform()))


@dataclass(frozen=True)
class StepJitter:
    """A step, smooth over `rise` seconds, somewhere in the middle three fifths of the span.

    Parameters
    ----------
    size : float
        Height of the step, in the unit of the profile; its sign is drawn.
    rise : float
        s, from 12 % to 88 % of the step.
    """

    size: float
    rise: float = 4e-3
    instrument: bool = False

    def sample(self, t: Array, rng: np.random.Generator) -> Array:
        """The step, centred on zero."""
        at = t[0] + (t[-1] - t[0]) * rng.uniform(0.2, 0.8)
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        return sign * 0.5 * self.size * np.tanh(2.0 * (t - at) / self.rise)


@dataclass(frozen=True)
class JitterProfile:
    """The parts of the motion, axis by axis, in pixels at the image.

    Parameters
    ----------
    roll, pitch, yaw : tuple of JitterPart
        Parts of each axis. Values are in pixels: an IFOV for roll and pitch; for yaw, what it moves the
        edge of the field by.
    """

    roll: tuple[JitterPart, ...]
    pitch: tuple[JitterPart, ...]
    yaw: tuple[JitterPart, ...]

    def draw(self, t: Array, rad_per_px: Array, seed: np.random.SeedSequence) -> tuple[Motion, Motion]:
        """One motion of the line of sight, and what the body has of it.

        Parameters
        ----------
        t : (N,) s, evenly spaced
        rad_per_px : (3,) rad, of one pixel of roll, pitch and yaw
        seed : numpy.random.SeedSequence
            Decides everything; every part has a stream of its own.

        Returns
        -------
        line_of_sight, body : Motion
            Without covariance: they are truth.
        """
        axes = (self.roll, self.pitch, self.yaw)
        angles = np.zeros((t.size, 3))
        body = np.zeros((t.size, 3))
        for axis, (parts, axis_seed) in enumerate(zip(axes, seed.spawn(3), strict=True)):
            for part, part_seed in zip(parts, axis_seed.spawn(len(parts)), strict=True):
                values = rad_per_px[axis] * part.sample(t, np.random.default_rng(part_seed))
                angles[:, axis] += values
                if not part.instrument:
                    body[:, axis] += values
        return Motion(t, angles), Motion(t, body)


def time_step(t: Array) -> float:
    """The step of evenly spaced times, s; raises InputError where they are not."""
    if t.ndim != 1 or t.size < 2:
        raise InputError(f"`t` must be a series of two or more times, got shape {t.shape}")
    steps = np.diff(t)
    step = float(steps.mean())
    if not (step > 0.0 and np.all(np.abs(steps - step) < 1e-6 * step)):
        raise InputError(
            f"`t` must be evenly spaced: its steps run from {steps.min():.6g} to {steps.max():.6g} s; "
            "sample the motion on an even grid and interpolate it with Motion.at"
        )
    return step


def nominal_profile(constant_px: float = 2.0) -> JitterProfile:
    """The motion of S1's reference scene, alike on the three axes with phases of their own.

    Drift Matern-5/2 of 2 px and 1 s; broadband Matern-3/2 of 0.10 px with a corner at 30 Hz; tones at
    47, 83 and 121 Hz of 0.30, 0.15 and 0.08 px rms (instrument modes); a constant of `constant_px` sigma.
    """
    parts: tuple[JitterPart, ...] = (
        ConstantJitter(constant_px),
        MaternJitter(2.0, 1.0, "5/2"),
        MaternJitter.with_corner(0.10, 30.0, "3/2"),
        ToneJitter(0.30, 47.0),
        ToneJitter(0.15, 83.0),
        ToneJitter(0.08, 121.0),
    )
    return JitterProfile(parts, parts, parts)


def with_part(profile: JitterProfile, part: JitterPart) -> JitterProfile:
    """The profile with one more part on every axis."""
    return JitterProfile((*profile.roll, part), (*profile.pitch, part), (*profile.yaw, part))


def curve_profile(
    t: Array, curves: Array, rms_px: float = 2.0, stretch: float = 1.0, extra: tuple[JitterPart, ...] = ()
) -> JitterProfile:
    """A measured curve on each axis, with a constant of 2 px sigma and `extra` parts added.

    Parameters
    ----------
    t : (K,) s
    curves : (K, 3) roll, pitch, yaw in any unit; each is scaled to `rms_px`
    rms_px : float
    stretch : float
        See :class:`CurveJitter`.
    extra : tuple of JitterPart
        Added to every axis, with draws of their own.
    """
    axes: list[tuple[JitterPart, ...]] = [
        (ConstantJitter(2.0), CurveJitter(t, curves[:, axis], rms_px, stretch), *extra) for axis in range(3)
    ]
    return JitterProfile(axes[0], axes[1], axes[2])
