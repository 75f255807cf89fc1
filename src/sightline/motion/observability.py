"""What a lag, or several, can see: G(f), blind frequencies, pass-bands, gains of S1's filters.

A pair of images `lag` apart measures ``angles(t + lag) - angles(t)``. In the frequency domain the
motion is multiplied by ``G(f) = exp(2 i pi f lag) - 1``, which vanishes at f = n/lag: there the pair is
blind, and between the zeros every filter trades noise against loss. All gains here are closed forms.

Not here: the filters themselves (``motion/estimators/harmonic.py``, ``estimators/``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]
Passbands = tuple[tuple[float, float], ...]

#: Periods by which a time may differ from a whole number of them.
WHOLE_PERIODS = 1e-6
#: Pairs are blind together where their differences hold no more than this share of what they hold at most, on
#: average: six hundredths of a tone's amplitude. Lags of 150, 157.4 and 172.2 ms are nowhere up to 300 Hz.
BLIND_TOGETHER = 1e-3
#: Places at which the least gain of a gap is sought.
GAP_SAMPLES = 401


def transfer(frequency: ArrayLike, lag: ArrayLike) -> NDArray[np.complex128]:
    """G(f) = exp(2 i pi f lag) - 1: what a lag does to a motion.

    Parameters
    ----------
    frequency : array, Hz
    lag : array, s
        The two broadcast against each other.

    Notes
    -----
    S1, III: ``G(w) = exp(j w tau) - 1``.
    """
    phase = 2.0 * math.pi * np.asarray(frequency, dtype=np.float64) * np.asarray(lag, dtype=np.float64)
    return np.asarray(np.expm1(1j * phase), dtype=np.complex128)


def power_transfer(frequency: ArrayLike, lag: ArrayLike) -> Array:
    """|G(f)|^2 = 4 sin^2(pi f lag), between 0 (blind) and 4.

    Notes
    -----
    S1 writes ``2 (1 - cos w tau)``: the same, less exact near the zeros.
    """
    phase = math.pi * np.asarray(frequency, dtype=np.float64) * np.asarray(lag, dtype=np.float64)
    return np.asarray(4.0 * np.sin(phase) ** 2)


def window_gain(frequency: ArrayLike, duration: float) -> Array:
    """What a matching window that spans `duration` (s) leaves of a motion: sin(pi f d) / (pi f d).

    S1, III: "correlation works as a filter on the signal": 10 lines cut at 1 / (10 line periods).
    """
    return np.asarray(np.sinc(np.asarray(frequency, dtype=np.float64) * duration))


def blind_frequencies(lag: float, upper: float) -> Array:
    """Frequencies n/lag (Hz), n = 1, 2 ..., up to `upper`: no pair of this lag sees them.

    Zero frequency (the constant) is blind for every lag and is not listed.

    Examples
    --------
    >>> blind_frequencies(0.01, 250.0)
    array([100., 200.])
    """
    _check_lags([lag])
    first = 1.0 / abs(lag)
    count = math.floor(upper / first * (1.0 + 1e-12))
    return np.asarray(first * np.arange(1, count + 1))


def blind_together(lags: Sequence[float], weights: Sequence[float], upper: float) -> Array:
    """Frequencies (Hz), rising, up to `upper` that all pairs are blind to, the constant apart.

    Parameters
    ----------
    lags : sequence of float, s
    weights : sequence of float
        How much each pair tells: its number of rows, or of windows.
    upper : float, Hz

    Examples
    --------
    >>> blind_together([0.0375, 0.075], [1.0, 1.0], 100.0).round(3)
    array([26.667, 53.333, 80.   ])
    >>> len(blind_together([0.15, 0.1574, 0.1722], [1.0, 1.0, 1.0], 300.0))
    0
    """
    _check_lags(lags)
    # where all are blind each is: of the pair that tells most
    f = blind_frequencies(lags[int(np.argmax(np.abs(np.multiply(lags, weights))))], upper)
    share = np.sin(math.pi * np.outer(f, lags)) ** 2
    return np.asarray(f[np.average(share, axis=1, weights=weights) < BLIND_TOGETHER])


def averaged_away(times: Sequence[float], upper: float) -> Array:
    """Frequencies (Hz) up to `upper` that averages over each of `times` (s) remove: k / (N T) of N stages.

    Empty without any time.

    Examples
    --------
    >>> averaged_away([0.008, 0.016], 300.0)
    array([125., 250.])
    """
    if not times:
        return np.zeros(0)
    found = blind_frequencies(min(times), upper)
    periods = np.outer(found, np.asarray(times))
    return np.asarray(found[(np.abs(periods - np.rint(periods)) < WHOLE_PERIODS).all(axis=1)])


def filter_response(frequency: ArrayLike, lag: float, k: float) -> NDArray[np.complex128]:
    """Pseudo-inverse filter ``H_k = conj(G) / (|G|^2 + k)``.

    Its modulus is at most ``1 / (2 sqrt k)``, reached where |G|^2 = k.

    Notes
    -----
    S1, III, the filter before eq. (3).
    """
    return np.asarray(np.conj(transfer(frequency, lag)) / (power_transfer(frequency, lag) + k))


def chain_gain(frequency: ArrayLike, lag: float, k: float) -> Array:
    """What one lag and its pseudo-inverse filter leave of a motion: ``F_k = |G|^2 / (|G|^2 + k)``.

    Real, so the phase is kept; at most 4 / (4 + k), at f = 1 / (2 lag).

    Notes
    -----
    S1, eq. (3).
    """
    power = power_transfer(frequency, lag)
    return np.asarray(power / (power + k))


def combined_gain(
    frequency: ArrayLike,
    lags: Sequence[float],
    k: float | Sequence[float],
    combination: Literal["joint", "max-band"] = "joint",
) -> Array:
    """What several pairs together leave of a motion.

    Parameters
    ----------
    frequency : array, Hz
    lags : sequence of float, s
    k : float or one per lag
        Noise over motion (power) of each pair.
    combination : "joint" or "max-band"
        "joint" fits all pairs at once: ``S / (S + 1)``, S = sum of |G_m|^2 / k_m. "max-band" takes at each
        frequency the pair that sees it best, as S1, fig. 13, does.
    """
    _check_lags(lags)
    ks = np.broadcast_to(np.asarray(k, dtype=np.float64), (len(lags),))
    f = np.asarray(frequency, dtype=np.float64)
    power = power_transfer(f[..., None], np.asarray(lags)) / ks
    strength = power.sum(axis=-1) if combination == "joint" else power.max(axis=-1)
    return np.asarray(strength / (strength + 1.0))


def passbands(
    lags: float | Sequence[float],
    upper: float,
    *,
    k: float | Sequence[float] = 0.1,
    level: float = 0.5,
    combination: Literal["joint", "max-band"] = "joint",
) -> Passbands:
    """Intervals (Hz) below `upper` where the pairs leave at least `level` of a motion.

    Parameters
    ----------
    lags : float or sequence of float, s
    upper : float, Hz
    k : float or one per lag
        Noise over motion (power) of each pair.
    level : float
        Between 0 and 1.
    combination : "joint" or "max-band"
        See `combined_gain`.

    Returns
    -------
    tuple of (low, high), Hz
        For one lag and for "max-band" exact; for "joint" to 1e-9 of a band's width.

    Examples
    --------
    >>> low, high = passbands(0.01, 100.0, k=1.0)[0]
    >>> round(low, 4), round(high, 4)
    (16.6667, 83.3333)
    """
    lags = [float(x) for x in np.atleast_1d(np.asarray(lags, dtype=np.float64))]
    _check_lags(lags)
    if not 0.0 < level < 1.0:
        raise InputError(f"`level` must be between 0 and 1, got {level}")
    ks = np.broadcast_to(np.asarray(k, dtype=np.float64), (len(lags),))
    if len(lags) == 1 or combination == "max-band":
        return merge(band for lag, x in zip(lags, ks, strict=True) for band in _bands(lag, x, level, upper))

    def above(frequency: Array) -> Array:
        return combined_gain(frequency, lags, k, combination) - level

    # The gain has no feature narrower than a fraction of 1/(longest lag): 200 samples per such period.
    count = max(2, math.ceil(200.0 * upper * max(abs(x) for x in lags)))
    return _crossings(above, np.linspace(0.0, upper, count + 1))


def shared_blind_frequencies(lags: Sequence[float], bands: Passbands, upper: float) -> tuple[float, ...]:
    """Hz, rising; where pairs together see least, in each gap that `passbands` of them leaves below `upper`.

    What lies below the first band is a drift for all of them, and is not listed.

    Parameters
    ----------
    lags : sequence of float, s
    bands : sequence of (low, high), Hz
    upper : float, Hz

    Examples
    --------
    >>> bands = passbands([0.01, 0.02], 250.0)
    >>> [round(f, 6) for f in shared_blind_frequencies([0.01, 0.02], bands, 250.0)]
    [100.0, 200.0]
    """
    ends = [*(low for low, _ in bands[1:]), upper] if bands else []
    out = []
    for (_, left), right in zip(bands, ends, strict=True):
        if right > left:
            f = np.linspace(left, right, GAP_SAMPLES)
            out.append(float(f[int(np.argmin(combined_gain(f, lags, 1.0)))]))
    return tuple(out)


def intervals_above(frequency: Array, gain: Array, level: float) -> Passbands:
    """Intervals (Hz) where a sampled `gain` (F,) is at least `level`, ends by linear interpolation."""
    frequency, above = np.asarray(frequency, dtype=np.float64), np.asarray(gain, dtype=np.float64) - level

    def between(at: Array) -> Array:
        return np.asarray(np.interp(at, frequency, above))

    return _crossings(between, frequency)


def merge(bands: Iterable[tuple[float, float]]) -> Passbands:
    """The union of intervals, sorted."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(bands):
        if out and low <= out[-1][1]:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    return tuple(out)


def _bands(lag: float, k: float, level: float, upper: float) -> list[tuple[float, float]]:
    """Pass-bands of one lag: between the blind frequencies, where 4 sin^2 >= k level / (1 - level)."""
    sine_squared = 0.25 * k * level / (1.0 - level)
    if sine_squared > 1.0:
        return []
    edge = math.asin(math.sqrt(sine_squared)) / math.pi
    period = 1.0 / abs(lag)
    starts = period * np.arange(math.ceil(upper / period))
    return [
        (float(x + edge * period), float(min(x + (1.0 - edge) * period, upper)))
        for x in starts
        if x + edge * period < upper
    ]


def _crossings(above: Callable[[Array], Array], frequency: Array) -> Passbands:
    """Intervals where the function `above` is positive, each sampled sign change refined by bisection."""
    positive = np.asarray(above(frequency)) >= 0.0
    change = np.flatnonzero(positive[1:] != positive[:-1])
    low, high = frequency[change].copy(), frequency[change + 1].copy()
    rising = positive[change + 1]
    for _ in range(40):
        middle = 0.5 * (low + high)
        right = (np.asarray(above(middle)) >= 0.0) == rising
        high = np.where(right, middle, high)
        low = np.where(right, low, middle)
    edges = [float(x) for x in 0.5 * (low + high)]
    if positive[0]:
        edges.insert(0, float(frequency[0]))
    if positive[-1]:
        edges.append(float(frequency[-1]))
    return tuple(zip(edges[::2], edges[1::2], strict=True))


def noise_gain(k: float) -> float:
    """Sigma of the restored motion over that of the differences, for white noise.

    ``sqrt2 k^(-1/4) (k + 4)^(-3/4)``: the mean of |H_k|^2 over all frequencies. It does not depend on the
    lag, as S1, III, says.
    """
    return math.sqrt(2.0) * k**-0.25 * (k + 4.0) ** -0.75


def bias_gain(k: float) -> float:
    """Sigma lost of a white motion over its sigma: ``[k^2 (k + 2) / (k (k + 4))^1.5]^(1/2)``.

    The mean of ``|F_k - 1|^2`` over all frequencies.
    """
    return math.sqrt(k**2 * (k + 2.0) / (k * (k + 4.0)) ** 1.5)


def best_k(snr: float, *, band: float = 1.0) -> float:
    """The constant k of least error, ``a / SNR^2``.

    Parameters
    ----------
    snr : float
        Sigma of the motion itself (not of its differences) over that of a difference's error.
    band : float
        a: part of the sampled band that a white motion fills, ``2 f_c / f_s``; 1 for a white one.

    Notes
    -----
    S1, III. Its printed spectral density of a band-limited motion has the square of ``w_e / (2 w_c)``; kept
    variance asks for the first power, and only with it does k come out as ``a / SNR^2``.
    """
    return band / snr**2


def polynomial_gain(
    at: ArrayLike, t: ArrayLike, lag: ArrayLike, *, degree: int = 5, origin: float | None = None
) -> Array:
    """Sigma of a fitted polynomial motion at `at` over that of one difference: S1, fig. 14.

    Parameters
    ----------
    at : (N,), s
        Where the motion is wanted.
    t, lag : (M,), s
        Of independent differences of equal sigma.
    degree : int
        Terms t .. t^degree; the constant is never observable.
    origin : float, optional
        s; instant at which the motion is held at zero. Without it the mean over `at` is.

    Returns
    -------
    (N,)
        ``[T (M' M)^-1 T']^(1/2)``, T the polynomial terms at `at` less those at the origin.
    """
    at = np.atleast_1d(np.asarray(at, dtype=np.float64))
    t, lag = np.broadcast_arrays(
        np.asarray(t, dtype=np.float64).ravel(), np.asarray(lag, dtype=np.float64).ravel()
    )
    lower, upper = min(at.min(), t.min()), max(at.max(), (t + lag).max())
    rows = polynomial_terms(t + lag, lower, upper, degree) - polynomial_terms(t, lower, upper, degree)
    wanted = polynomial_terms(at, lower, upper, degree)
    if origin is None:
        wanted = wanted - wanted.mean(axis=0)
    else:
        wanted = wanted - polynomial_terms(np.array([origin]), lower, upper, degree)
    triangular: Array = np.linalg.qr(rows)[1]
    return np.asarray(np.linalg.norm(np.linalg.solve(triangular.T, wanted.T), axis=0))


def polynomial_terms(t: Array, lower: float, upper: float, degree: int) -> Array:
    """Legendre polynomials 1 .. degree over [lower, upper] at `t`: (N, degree).

    They span, with a constant, the same motions as t .. t^degree, and keep the normal equations well
    conditioned.
    """
    x = (2.0 * t - (lower + upper)) / (upper - lower)
    return np.asarray(np.polynomial.legendre.legvander(x, degree)[:, 1:])


def _check_lags(lags: Sequence[float]) -> None:
    if len(lags) == 0 or not all(math.isfinite(lag) and lag != 0.0 for lag in lags):
        raise InputError(
            f"lags must be finite and not zero, got {list(lags)} s; a lag is the time in b minus that in a"
        )
