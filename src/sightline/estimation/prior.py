"""What is believed of a motion before it is measured: its spectrum, and that as a banded precision.

A motion is a sum of parts, each with a closed autocovariance: slow drift and broadband jitter
(Matern), tones of instrument modes. On an even time grid the sum is approximated by an
autoregression of finite order, whose precision matrix is banded; the first rows are exact, so
there is no start-up error, and every row carries its own weight, so that a single step or the
switch-on of a tone can be let through.

Not here: which spectrum the data ask for (``likelihood.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit
from sightline.errors import EstimationError, InputError

Array = NDArray[np.float64]

#: White variance added to every prior, as a fraction of its total variance. A very smooth prior
#: on a fine grid is predictable to the last digit of a float64; this keeps its precision matrix
#: 1e10 away from that, at the price of a white jitter 1e-5 times the size of the motion.
NUGGET = 1e-10
#: The same where a spectrum is given point by point: it may be zero outside a band, and such a motion is
#: determined by its past to the last digit.
BAND_NUGGET = 1e-6


#: Smoothness of a Matern process. For a motion that ends at a frequency each step up lowers the deviance of a
#: strip of 3000 lines by hundreds (360-550, 300-360, 140-170); twice "17/2" would bring 60-80 more, and
#: changes errors and sigmas by less than 5 %.
Order = Literal["3/2", "5/2", "9/2", "17/2"]
ORDERS: tuple[Order, ...] = get_args(Order)


class Component(Protocol):
    """One part of a motion's spectrum."""

    def autocovariance(self, lags: Array) -> Array:
        """Covariance of two values `lags` (s) apart, in the unit of the motion squared."""
        ...

    def psd(self, frequency: Array) -> Array:
        """One-sided power spectral density at `frequency` (Hz), unit squared per Hz."""
        ...


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"`{name}` must be a positive number of {unit}, got {value}")


def _polynomial(p: int) -> list[float]:
    """Coefficients of x^0 .. x^p of the polynomial in a Matern covariance of p derivatives."""
    whole = math.factorial(p) / math.factorial(2 * p)
    return [
        whole * math.factorial(2 * p - k) / (math.factorial(p - k) * math.factorial(k)) * 2.0**k
        for k in range(p + 1)
    ]


@dataclass(frozen=True)
class Matern:
    """Stationary motion without a preferred frequency: drift or broadband jitter.

    Parameters
    ----------
    sigma : float
        Its standard deviation, in the unit of the motion.
    timescale : float
        s; the ``l`` of the Matern covariance. The spectrum is flat below the corner frequency
        ``sqrt(2 nu) / (2 pi l)`` and falls as f^-(2 nu + 1) above it: f^-4 for "3/2", f^-6 for "5/2".
    order : one of ORDERS
        The smoothness nu: one derivative exists for "3/2", two for "5/2", eight for "17/2", whose spectrum
        ends at its corner as that of a motion that is limited to a band.

    Examples
    --------
    >>> float(Matern(2.0, 1.0, "5/2").autocovariance(np.array([0.0]))[0])
    4.0
    """

    sigma: float
    timescale: float
    order: Order = "3/2"

    def __post_init__(self) -> None:
        _positive("sigma", self.sigma, "motion units")
        _positive("timescale", self.timescale, "seconds")
        if self.order not in ORDERS:
            raise InputError(f"`order` must be one of {', '.join(ORDERS)}, got {self.order!r}")

    @property
    def corner(self) -> float:
        """Hz; where the spectrum turns from flat to falling."""
        return self._rate / (2.0 * math.pi)

    @property
    def derivatives(self) -> int:
        """How many derivatives exist: nu - 1/2."""
        return int(self.order.split("/")[0]) // 2

    @property
    def _rate(self) -> float:
        return math.sqrt(2.0 * self.derivatives + 1.0) / self.timescale

    def autocovariance(self, lags: Array) -> Array:
        """Covariance of two values `lags` (s) apart."""
        x = self._rate * np.abs(lags)
        shape = np.polynomial.polynomial.polyval(x, _polynomial(self.derivatives))
        return np.asarray(self.sigma**2 * shape * np.exp(-x), dtype=np.float64)

    def bend(self, length: float) -> float:
        """Standard deviation of how far a motion bends away from a line over `length` s.

        Constants and even drifts are hidden where offsets are free; sigma and timescale of a drift longer
        than `length` are then observable only as what bends (sigma over timescale squared), not either alone.
        """
        k = self.autocovariance(np.array([0.0, 0.5 * length, length]))
        return float(np.sqrt(max(6.0 * k[0] - 8.0 * k[1] + 2.0 * k[2], 0.0)))

    def psd(self, frequency: Array) -> Array:
        """One-sided power spectral density at `frequency` (Hz)."""
        rate, p = self._rate, self.derivatives
        height = 2.0 * math.sqrt(math.pi) * math.gamma(p + 1.0) / (math.gamma(p + 0.5) * rate)
        fall = 1.0 + (2.0 * math.pi * np.asarray(frequency) / rate) ** 2
        return np.asarray(2.0 * self.sigma**2 * height * fall ** -(p + 1.0), dtype=np.float64)


@dataclass(frozen=True)
class Tone:
    """A narrow line of the spectrum: a mode of a structure, as an oscillator that noise drives.

    Parameters
    ----------
    sigma : float
        Its standard deviation (amplitude over sqrt 2), in the unit of the motion.
    frequency : float
        Hz.
    bandwidth : float
        Hz, full width at half maximum of the line, which falls as f^-4 above it; its phase wanders over a
        time of ``1 / (pi bandwidth)``.
    """

    sigma: float
    frequency: float
    bandwidth: float

    def __post_init__(self) -> None:
        _positive("sigma", self.sigma, "motion units")
        _positive("frequency", self.frequency, "hertz")
        _positive("bandwidth", self.bandwidth, "hertz")

    def autocovariance(self, lags: Array) -> Array:
        """Covariance of two values `lags` (s) apart: what a damped oscillator still knows of where it was."""
        lags = np.abs(lags)
        damping, turn = math.pi * self.bandwidth * lags, 2.0 * math.pi * self.frequency * lags
        # the second part keeps the speed of a body that has mass: a damped cosine alone would have none, and
        # the tails of its line (Lorentzian) would pass for jitter of all frequencies
        shape = np.cos(turn) + 0.5 * self.bandwidth / self.frequency * np.sin(turn)
        return np.asarray(self.sigma**2 * np.exp(-damping) * shape, dtype=np.float64)

    def psd(self, frequency: Array) -> Array:
        """One-sided power spectral density at `frequency` (Hz)."""
        square = np.asarray(frequency, dtype=np.float64) ** 2
        own = self.frequency**2 + 0.25 * self.bandwidth**2
        line = (square - own) ** 2 + self.bandwidth**2 * square
        return np.asarray(2.0 / math.pi * self.sigma**2 * self.bandwidth * own / line)


@dataclass(frozen=True)
class TabulatedPsd:
    """A spectrum known beforehand at some frequencies, straight between them and nothing outside.

    Parameters
    ----------
    frequency : tuple of float
        Hz, increasing from 0 or more.
    density : tuple of float
        One-sided power spectral density, unit squared per Hz; not negative, not all zero.

    Examples
    --------
    >>> flat = TabulatedPsd((0.0, 10.0), (0.1, 0.1))
    >>> float(flat.autocovariance(np.array([0.0]))[0])
    1.0
    """

    frequency: tuple[float, ...]
    density: tuple[float, ...]

    def __post_init__(self) -> None:
        f, s = np.array(self.frequency), np.array(self.density)
        if f.ndim != 1 or len(f) < 2 or f.shape != s.shape:
            raise InputError(
                f"`frequency` and `density` must be two or more numbers each, got {len(f)} and {len(s)}"
            )
        if not (np.isfinite(f).all() and f[0] >= 0.0 and (np.diff(f) > 0.0).all()):
            raise InputError("`frequency` must increase from 0 Hz or more")
        if not (np.isfinite(s).all() and (s >= 0.0).all() and s.any()):
            raise InputError("`density` must be 0 or more everywhere and positive somewhere")

    @property
    def sigma(self) -> float:
        """Standard deviation, in the unit of the motion."""
        return math.sqrt(float(np.trapezoid(self.density, self.frequency)))

    def autocovariance(self, lags: Array) -> Array:
        """Covariance of two values `lags` (s) apart: the cosine transform, exact for straight pieces."""
        w = 2.0 * math.pi * np.abs(np.asarray(lags, dtype=np.float64))
        f, s = np.array(self.frequency), np.array(self.density)
        total = np.zeros(w.shape)
        for f0, f1, s0, s1 in zip(f[:-1], f[1:], s[:-1], s[1:], strict=True):
            # the mean of the piece and its slope about the middle, each against cos(w f)
            half, middle = 0.5 * (f1 - f0), 0.5 * (f0 + f1)
            x = w * half
            even = np.sinc(x / math.pi)
            small = x < 1e-2
            safe = np.where(small, 1.0, x)
            odd = np.where(small, x / 3.0, (np.sin(safe) - safe * np.cos(safe)) / safe**2)
            total += (f1 - f0) * 0.5 * (s0 + s1) * even * np.cos(w * middle)
            total -= (f1 - f0) * 0.5 * (s1 - s0) * odd * np.sin(w * middle)
        return total

    def psd(self, frequency: Array) -> Array:
        """One-sided power spectral density at `frequency` (Hz)."""
        return np.interp(np.asarray(frequency), self.frequency, self.density, left=0.0, right=0.0)


@dataclass(frozen=True)
class Spectrum:
    """A motion's prior: the sum of independent parts.

    Examples
    --------
    >>> spectrum = Spectrum((Matern(2.0, 1.0, "5/2"), Tone(0.3, 47.0, 0.2)))
    >>> round(float(spectrum.autocovariance(np.array([0.0]))[0]), 12)
    4.09
    """

    components: tuple[Matern | Tone | TabulatedPsd, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", tuple(self.components))
        if not self.components:
            raise InputError("a Spectrum needs at least one component, got none")

    @property
    def tones(self) -> tuple[Tone, ...]:
        """The narrow lines among the parts, by rising frequency."""
        tones = [c for c in self.components if isinstance(c, Tone)]
        return tuple(sorted(tones, key=lambda tone: tone.frequency))

    @property
    def without_tones(self) -> Spectrum | None:
        """The spectrum less its tones; None where it is nothing else."""
        parts = tuple(c for c in self.components if not isinstance(c, Tone))
        return Spectrum(parts) if parts else None

    @property
    def sigma(self) -> float:
        """Standard deviation of the whole motion."""
        return math.sqrt(sum(c.sigma**2 for c in self.components))

    def autocovariance(self, lags: Array) -> Array:
        """Covariance of two values `lags` (s) apart."""
        total = np.zeros(np.shape(lags))
        for component in self.components:
            total += component.autocovariance(np.asarray(lags, dtype=np.float64))
        return total

    def psd(self, frequency: Array) -> Array:
        """One-sided power spectral density at `frequency` (Hz)."""
        total = np.zeros(np.shape(frequency))
        for component in self.components:
            total += component.psd(np.asarray(frequency, dtype=np.float64))
        return total

    def scaled(self, factor: float) -> Spectrum:
        """The same spectrum of a motion `factor` times as large (a change of unit)."""
        parts: list[Matern | Tone | TabulatedPsd] = []
        for c in self.components:
            if isinstance(c, Tone):
                parts.append(Tone(c.sigma * factor, c.frequency, c.bandwidth))
            elif isinstance(c, TabulatedPsd):
                parts.append(TabulatedPsd(c.frequency, tuple(d * factor**2 for d in c.density)))
            else:
                parts.append(Matern(c.sigma * factor, c.timescale, c.order))
        return Spectrum(tuple(parts))

    def autoregressive(
        self, step: float, order: int, n: int, *, nugget: float | None = None
    ) -> Autoregressive:
        """This prior on an even grid of `n` epochs `step` seconds apart; see `autoregressive`."""
        _positive("step", step, "seconds")
        if nugget is None:
            nugget = BAND_NUGGET if any(isinstance(c, TabulatedPsd) for c in self.components) else NUGGET
        order = max(0, min(order, n - 1))
        return autoregressive(self.autocovariance(step * np.arange(order + 1.0)), order, n, nugget=nugget)


@dataclass(frozen=True, eq=False)
class Autoregressive:
    """A stationary process of n epochs as an autoregression with exact start-up rows.

    ``x[t] = sum_k a[k] x[t - 1 - k] + e[t]``, the e independent.

    Attributes
    ----------
    n : int
        Number of epochs.
    coefficients : (order,)
        The a of every row from `order` on.
    startup : (order, order)
        Row t holds the coefficients of epoch t < order: the best prediction from all t before it.
    startup_variances : (order,)
        Innovation variances of those rows.
    variance : float
        Innovation variance of all further rows.
    """

    n: int
    coefficients: Array
    startup: Array
    startup_variances: Array
    variance: float

    @property
    def order(self) -> int:
        """Number of earlier epochs that a row looks back to; the precision has as many subdiagonals."""
        return len(self.coefficients)

    @property
    def variances(self) -> Array:
        """(n,) innovation variance of every row."""
        out = np.full(self.n, self.variance)
        out[: self.order] = self.startup_variances
        return out

    @property
    def table(self) -> Array:
        """(order + 1, order + 1) rows ``1, -a[0], ...`` of epochs 0 to order; the last serves all others."""
        table = np.zeros((self.order + 1, self.order + 1))
        table[:, 0] = 1.0
        table[:-1, 1:] = -self.startup
        table[-1, 1:] = -self.coefficients
        return table

    @property
    def logdet(self) -> float:
        """Natural logarithm of the determinant of the precision matrix (unit row weights)."""
        inner = (self.n - self.order) * math.log(self.variance)
        return float(-np.sum(np.log(self.startup_variances)) - inner)

    def precision_band(self, weights: Array | None = None) -> Array:
        """Lower band of the precision matrix, (order + 1, n).

        Parameters
        ----------
        weights : array (n,), optional
            Of the rows: each multiplies the inverse variance of one innovation. 1 is the plain
            prior, near 0 lets the motion jump at that epoch; adds ``sum(log(weights))`` to `logdet`.
        """
        return self.precision_columns(0, self.n, weights)

    def precision_columns(self, first: int, last: int, weights: Array | None = None) -> Array:
        """Columns [first, last) of `precision_band`, (order + 1, last - first)."""
        p, n = self.order, self.n
        if weights is not None:
            weights = np.ascontiguousarray(weights, dtype=np.float64)
            if weights.shape != (n,) or not (np.isfinite(weights).all() and (weights > 0.0).all()):
                raise InputError(f"`weights` must be {n} positive finite numbers, got shape {weights.shape}")
            return _sum_rows(self.table, weights / self.variances, first, last)
        # Without weights all inner columns are alike: sum a short process and repeat its middle.
        short = min(n, 2 * p + 1)
        ends = _sum_rows(self.table, 1.0 / self.variances[:short], 0, short)
        column = np.arange(first, last)
        alike = np.where(column < p, column, np.maximum(column - (n - short), min(p, short - 1)))
        return np.ascontiguousarray(ends[:, alike])

    def variance_of(self, weights: Array) -> float:
        """Variance of the sum of `weights` (n,) times the process."""
        shares = _shares_of_innovations(
            np.ascontiguousarray(weights, dtype=np.float64), self.startup, self.coefficients
        )
        return float(self.variances @ shares**2)

    @property
    def all_variances(self) -> Array:
        """(order + 1,) of the innovations of the first epochs, and of all after them."""
        return np.append(self.startup_variances, self.variance)

    def slopes_of_variance(self, weights: Array) -> tuple[Array, Array]:
        """Derivatives of `variance_of` by the coefficients of every order (p + 1, p), by `all_variances`."""
        return _slopes_of_variance(
            np.ascontiguousarray(weights, dtype=np.float64),
            self.startup,
            self.coefficients,
            self.all_variances,
        )

    def slope(self, autocovariance: Array, by_rows: Array, by_variances: Array) -> Array:
        """Derivative (p + 1,) by the autocovariances that gave this, of what has the other two derivatives.

        Those by the coefficients of every order (p + 1, p) and by `all_variances`: the recursion of
        `autoregressive` taken backwards.
        """
        r = np.array(autocovariance[: self.order + 1], dtype=np.float64)
        r[0] *= 1.0 + NUGGET
        out = _levinson_back(r, -self.table[:, 1:], self.all_variances, by_rows.copy(), by_variances.copy())
        out[0] *= 1.0 + NUGGET
        return np.asarray(out)

    def innovations(self, x: Array) -> Array:
        """Innovations of a motion `x` (n,) in units of their sigma, (n,): white, of unit variance."""
        x = np.asarray(x, dtype=np.float64)
        if x.shape != (self.n,):
            raise InputError(f"`x` must hold {self.n} epochs, got shape {x.shape}")
        e = x.copy()
        p = self.order
        for t in range(1, p):
            e[t] -= self.startup[t, :t] @ x[:t][::-1]
        for k in range(p):
            e[p:] -= self.coefficients[k] * x[p - 1 - k : self.n - 1 - k]
        return np.asarray(e / np.sqrt(self.variances), dtype=np.float64)


def autoregressive(
    autocovariance: Array | Sequence[float], order: int, n: int, *, nugget: float = NUGGET
) -> Autoregressive:
    """Autoregression that keeps the first `order` + 1 autocovariances exactly.

    Parameters
    ----------
    autocovariance : array (order + 1 or more,)
        At lags 0, 1, 2 ... grid steps; unit of the motion squared.
    order : int
        Rows look back this far (at most n - 1).
    n : int
        Epochs of the grid.
    nugget : float
        White variance added, as a fraction of the total; see `NUGGET`.

    Raises
    ------
    InputError
        If there are too few lags, or they are no autocovariance (an innovation variance is not positive).

    Notes
    -----
    Durbin-Levinson recursion; the coefficients of every order below the last are the start-up rows,
    so the first `order` epochs have exactly the given covariance.
    """
    if n < 1:
        raise InputError(f"`n` must be at least 1 epoch, got {n}")
    if order < 0:
        raise InputError(f"`order` must be 0 or more, got {order}")
    order = min(order, n - 1)
    r = np.array(autocovariance, dtype=np.float64)
    if r.ndim != 1 or len(r) < order + 1 or not np.isfinite(r).all() or not r[0] > 0.0:
        raise InputError(
            f"`autocovariance` must hold {order + 1} finite lags, the first positive, got shape {r.shape}"
        )
    r = r[: order + 1]
    r[0] *= 1.0 + nugget
    table, variances = _levinson(r)
    if not variances[-1] > 0.0 or not np.isfinite(variances).all():
        raise EstimationError(
            "a covariance over time is that of no stationary process, to the precision of numbers: a "
            f"prediction from the past has a variance of {variances.min():g}; give smaller sigmas of heights "
            f"and motion, or raise `nugget` (now {nugget:g})"
        )
    return Autoregressive(n, table[order].copy(), table[:order], variances[:order], float(variances[order]))


@njit(cache=True, nogil=True)
def _shares_of_innovations(weights, startup, coefficients):  # type: ignore[no-untyped-def]
    """By how much each innovation moves a weighted sum of the process."""
    n, p = len(weights), len(coefficients)
    out = weights.copy()
    for t in range(n - 1, 0, -1):
        if t >= p:
            for k in range(p):
                out[t - 1 - k] += coefficients[k] * out[t]
        else:
            for k in range(t):
                out[t - 1 - k] += startup[t, k] * out[t]
    return out


@njit(cache=True, nogil=True)
def _levinson(r):  # type: ignore[no-untyped-def]
    """Prediction coefficients of all orders 0 .. p (rows) and their innovation variances."""
    p = len(r) - 1
    table = np.zeros((p + 1, p))
    variances = np.full(p + 1, -1.0)
    variances[0] = r[0]
    for m in range(1, p + 1):
        reflection = r[m]
        for k in range(m - 1):
            reflection -= table[m - 1, k] * r[m - 1 - k]
        reflection /= variances[m - 1]
        for k in range(m - 1):
            table[m, k] = table[m - 1, k] - reflection * table[m - 1, m - 2 - k]
        table[m, m - 1] = reflection
        variances[m] = variances[m - 1] * (1.0 - reflection * reflection)
        if not variances[m] > 0.0:
            break
    return table, variances


@njit(cache=True, nogil=True)
def _levinson_back(r, table, variances, by_rows, by_variances):  # type: ignore[no-untyped-def]
    """Derivative by r of what has these derivatives by the table and the variances of `_levinson`."""
    p = len(r) - 1
    out = np.zeros(p + 1)
    for m in range(p, 0, -1):
        reflection, before = table[m, m - 1], variances[m - 1]
        by_reflection = by_rows[m, m - 1] - 2.0 * reflection * before * by_variances[m]
        by_variances[m - 1] += by_variances[m] * (1.0 - reflection * reflection)
        for k in range(m - 1):
            by_rows[m - 1, k] += by_rows[m, k]
            by_rows[m - 1, m - 2 - k] -= reflection * by_rows[m, k]
            by_reflection -= by_rows[m, k] * table[m - 1, m - 2 - k]
        each = by_reflection / before
        out[m] += each
        for k in range(m - 1):
            by_rows[m - 1, k] -= each * r[m - 1 - k]
            out[m - 1 - k] -= each * table[m - 1, k]
        by_variances[m - 1] -= each * reflection
    out[0] += by_variances[0]
    return out


@njit(cache=True, nogil=True)
def _slopes_of_variance(weights, startup, coefficients, variances):  # type: ignore[no-untyped-def]
    """Derivatives of a weighted sum's variance by the coefficients of all orders, and the variances."""
    n, p = len(weights), len(coefficients)
    shares = _shares_of_innovations(weights, startup, coefficients)
    by_rows, by_variances = np.zeros((p + 1, p)), np.zeros(p + 1)
    by_shares = np.empty(n)
    for t in range(n):
        by_shares[t] = 2.0 * variances[min(t, p)] * shares[t]
        by_variances[min(t, p)] += shares[t] ** 2
    for t in range(1, n):
        for k in range(min(t, p)):
            by_rows[min(t, p), k] += shares[t] * by_shares[t - 1 - k]
            by_shares[t] += (coefficients[k] if t >= p else startup[t, k]) * by_shares[t - 1 - k]
    return by_rows, by_variances


@njit(cache=True, nogil=True)
def _sum_rows(table, weights, first, last):  # type: ignore[no-untyped-def]
    """Lower band of the sum over rows t of weight[t] * row row', row t = table[min(t, p)] read backwards.

    Its columns [first, last).
    """
    p = table.shape[0] - 1
    out = np.zeros((p + 1, last - first))
    for t in range(first, min(len(weights), last + p)):
        m = min(t, p)
        row = table[m]
        for k in range(max(0, t - last + 1), min(m, t - first) + 1):
            scaled = row[k] * weights[t]
            for lower in range(k + 1):
                out[k - lower, t - k - first] += scaled * row[lower]
    return out
