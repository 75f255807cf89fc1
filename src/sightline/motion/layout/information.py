"""What detectors at given places along the track show of a motion: information, blind spots, common lags.

n images see each piece of ground at t + t_k. Ground and motion are unknown, every image has an error of its
own; eliminating the ground leaves, at frequency f, the information

    J(f) = sum_k w_k |z_k - z|^2,    z_k = exp(2 i pi f t_k),  w_k = 1 / sigma_k^2,  z their weighted mean,

which for n equal images is ``(n - |sum z_k|^2 / n) / sigma^2``: at most n images' worth, and none where all
lags are whole periods. Pairs that share an image share its error, so their information does not add.

Not here: which places are best (``search.py``), the sigma of the motion (``sigma.py``).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.motion.observability import power_transfer, window_gain

Array = NDArray[np.float64]

#: Samples of J(f) per 1 / span, the shortest period of its variation, before the least is refined.
PER_PERIOD = 40
#: A frequency is called blind where J is below this share of its mean over all frequencies.
BLIND_SHARE = 0.05
#: Hz; of pass-bands.
LOWEST, HIGHEST = 1e-9, 1e8
#: Whole periods in all lags together up to which blind frequencies and common lags are listed: a focal plane
#: half a second long has 10,000 up to a kilohertz, and nobody reads more.
MOST_PERIODS = 20_000
#: A lag counts as whole periods of a frequency where it is no further from them than this part of one: there
#: its pair has a tenth of its largest information at most.
NEAR = 0.05


@dataclass(frozen=True)
class RowNoise:
    """How well one row of windows, all columns together, places each image.

    Attributes
    ----------
    sigma_px : tuple of float
        px; error of each image, in the order of the detectors along the track. A match between two images
        has the variances of both.
    period : float
        s; between rows whose errors are independent: the longer of a row's window and of the step.
    window : float
        s; time that a row's windows span, over which the motion is averaged.
    tdi : tuple of float
        s; time of all TDI stages of each image, over which it averages the motion besides; empty: no TDI.
    """

    sigma_px: tuple[float, ...]
    period: float
    window: float = 0.0
    tdi: tuple[float, ...] = ()

    @property
    def kinds(self) -> tuple[Hashable, ...]:
        """What distinguishes each image: two of one kind may change places."""
        return tuple(zip(self.sigma_px, self.tdi, strict=True)) if self.tdi else self.sigma_px

    def ordered(self, order: Iterable[int]) -> RowNoise:
        """Of the images in this order."""
        numbers = list(order)
        return replace(
            self,
            sigma_px=tuple(self.sigma_px[k] for k in numbers),
            tdi=tuple(self.tdi[k] for k in numbers) if self.tdi else (),
        )

    def seen(self, frequency: Array) -> Array:
        """(n, F) what TDI leaves of a motion of each frequency (Hz) in each image."""
        times = np.array(self.tdi if self.tdi else (0.0,) * len(self.sigma_px))
        return window_gain(np.asarray(frequency) * times[:, None], 1.0)

    @property
    def weights(self) -> Array:
        """(n,) 1 / sigma^2 of each image, px^-2."""
        return 1.0 / np.square(np.asarray(self.sigma_px, dtype=np.float64))

    @classmethod
    def alike(cls, images: int, match_sigma_px: float, period: float, window: float = 0.0) -> RowNoise:
        """Of `images` equal images, a match between any two of which has `match_sigma_px`."""
        return cls((match_sigma_px / math.sqrt(2.0),) * images, period, window)


def information(frequency: ArrayLike, positions: ArrayLike, noise: RowNoise) -> Array:
    """Information on a motion at each frequency, px^-2 per row of windows.

    Parameters
    ----------
    frequency : (F,)
        Hz.
    positions : (n,)
        s; when each detector sees the ground, after the first.
    noise : RowNoise
        Of as many images.

    Returns
    -------
    (F,)
        Divided by ``noise.period`` it is the inverse of the two-sided power spectral density of the error.

    Notes
    -----
    By pairs, ``sum_{k<l} w_k w_l / W 4 sin^2(pi f (t_l - t_k))`` with W the sum of the weights: the same as
    above, and exact where it vanishes. With TDI z_k is seen times ``g_k = sinc(f N_k T)``, and a pair has
    ``(g_k - g_l)^2 + g_k g_l 4 sin^2``: of equal images the whole times ``sinc^2(f N T)``.

    Examples
    --------
    >>> noise = RowNoise((1.0, 1.0), 1e-3)
    >>> [round(float(x), 9) for x in information([25.0, 50.0, 100.0], [0.0, 0.01], noise)]
    [1.0, 2.0, 0.0]
    """
    f = np.asarray(frequency, dtype=np.float64)
    t, w = _checked(positions, noise)
    total = np.zeros(f.shape)
    seen = noise.seen(f.ravel()).reshape(-1, *f.shape) if noise.tdi else None
    for k, m in combinations(range(len(t)), 2):
        of_pair = power_transfer(f, t[m] - t[k])
        if seen is not None:
            of_pair = (seen[k] - seen[m]) ** 2 + seen[k] * seen[m] * of_pair
        total += w[k] * w[m] * of_pair
    return total / w.sum() * window_gain(f, noise.window) ** 2


def images_worth(frequency: ArrayLike, positions: ArrayLike, tdi: tuple[float, ...] = ()) -> Array:
    """Information of equal images without a window, in units of one image's: between 0 and n."""
    t = np.asarray(positions, dtype=np.float64)
    return information(frequency, t, RowNoise((1.0,) * len(t), 1.0, tdi=tdi))


def worst_case(positions: ArrayLike, passband: tuple[float, float], noise: RowNoise) -> tuple[float, float]:
    """Least information within a pass-band (px^-2 per row) and the frequency (Hz) of it.

    J(f) is sampled `PER_PERIOD` times per 1 / span, then finely about the least sample.
    """
    t, _ = _checked(positions, noise)
    low, high = checked_passband(passband)
    count = max(
        16,
        math.ceil(PER_PERIOD * (high - low) * float(np.ptp(t) + noise.window + max(noise.tdi, default=0.0))),
    )
    step = (high - low) / count
    for _ in range(2):
        f = np.linspace(low, high, count + 1)
        found = information(f, t, noise)
        at = float(f[int(np.argmin(found))])
        low, high, count = max(low, at - step), min(high, at + step), 400
    return float(found.min()), at


@dataclass(frozen=True)
class BlindFrequency:
    """A frequency at which every pair of a layout sees next to nothing.

    Attributes
    ----------
    frequency : float
        Hz.
    share : float
        Information there over its mean over all frequencies.
    """

    frequency: float
    share: float


def listed_up_to(positions: ArrayLike, upper: float, most: int = MOST_PERIODS) -> float:
    """Hz, at most `upper`, up to which blind frequencies and common lags of a layout can be listed.

    Examples
    --------
    >>> listed_up_to([0.0, 0.01, 0.03], 150.0), listed_up_to([0.0, 170.0], 1000.0)
    (150.0, 117.6470588235294)
    """
    t = np.sort(np.asarray(positions, dtype=np.float64))
    # each place is the end of as many lags as stand before it, the beginning of as many as follow
    together = float(t @ (2.0 * np.arange(len(t)) - len(t) + 1.0))
    return min(upper, most / max(together, 1e-300))


def blind_frequencies_of(
    positions: ArrayLike, upper: float, tdi: tuple[float, ...] = ()
) -> tuple[BlindFrequency, ...]:
    """Frequencies up to `upper` (Hz), the constant apart, at which all pairs of equal images go blind.

    With `tdi` (s, of all stages of each image) also those that all of them average away, k / (N T).

    Examples
    --------
    >>> [round(blind.frequency, 3) for blind in blind_frequencies_of([0.0, 0.01, 0.03], 250.0)]
    [100.0, 200.0]
    """
    t = np.asarray(positions, dtype=np.float64)
    span = float(np.ptp(t)) + max(tdi, default=0.0)
    count = max(64, math.ceil(PER_PERIOD * upper * span))
    f = np.linspace(0.0, upper, count + 1)
    share = images_worth(f, t, tdi) / (len(t) - 1.0)
    inner = np.flatnonzero((share[1:-1] <= share[:-2]) & (share[1:-1] < share[2:])) + 1
    out = []
    for k in inner:
        fine = np.linspace(f[k - 1], f[k + 1], 401)
        near = images_worth(fine, t, tdi) / (len(t) - 1.0)
        if near.min() < BLIND_SHARE:
            out.append(BlindFrequency(float(fine[int(np.argmin(near))]), float(near.min())))
    return tuple(out)


@dataclass(frozen=True)
class CommonLags:
    """Lags that are all nearly whole periods of one frequency: their pairs go blind together.

    Attributes
    ----------
    frequency : float
        Hz; its multiples are blind too.
    pairs : tuple of (int, int)
        Numbers of the detectors along the track.
    periods : tuple of int
        Whole periods in each pair's lag, without a common divisor: the lags are nearly in these ratios.
    mismatch : float
        How far the worst of them is from whole, in periods.
    """

    frequency: float
    pairs: tuple[tuple[int, int], ...]
    periods: tuple[int, ...]
    mismatch: float


def common_lags(positions: ArrayLike, upper: float) -> tuple[CommonLags, ...]:
    """Groups of two or more lags that are blind together below `upper` (Hz), by rising frequency.

    Of two groups at the same frequency only the one with more pairs is given.

    Examples
    --------
    >>> [(round(c.frequency, 1), c.periods) for c in common_lags([0.0, 0.01, 0.03], 150.0)]
    [(100.0, (1, 3, 2))]
    """
    t = np.asarray(positions, dtype=np.float64)
    pairs = list(combinations(range(len(t)), 2))
    lags = np.array([abs(t[m] - t[k]) for k, m in pairs])
    groups: list[CommonLags] = []
    for lag in lags:
        for whole in range(1, math.floor(upper * lag * (1.0 + 1e-9)) + 1):
            found = _blind_together(whole / lag, pairs, lags)
            if found is not None and found.frequency <= upper * (1.0 + 1e-9):
                groups.append(found)
    groups.sort(key=lambda group: (-len(group.pairs), group.mismatch))
    number, near = {pair: k for k, pair in enumerate(pairs)}, NEAR / float(lags.min())
    kept: list[CommonLags] = []
    frequency, held = np.empty(len(groups)), np.zeros((len(groups), len(pairs)), dtype=bool)
    for group in groups:
        alike = np.flatnonzero(np.abs(frequency[: len(kept)] - group.frequency) < near)
        own = np.array([number[pair] for pair in group.pairs])
        if held[alike[:, None], own].all(axis=1).any():
            continue
        frequency[len(kept)] = group.frequency
        held[len(kept), own] = True
        kept.append(group)
    return tuple(sorted(kept, key=lambda group: group.frequency))


def _blind_together(frequency: float, pairs: Sequence[tuple[int, int]], lags: Array) -> CommonLags | None:
    """The pairs that are blind at about a frequency; None unless they are two or more of new ratios."""
    near = np.abs(frequency * lags - np.rint(frequency * lags)) < NEAR
    near &= np.rint(frequency * lags) >= 1.0
    if near.sum() < 2:
        return None
    periods = np.rint(frequency * lags[near]).astype(int)
    fitted = float(periods @ lags[near] / (lags[near] @ lags[near]))
    mismatch = float(np.abs(fitted * lags[near] - periods).max())
    if math.gcd(*periods.tolist()) > 1 or mismatch >= NEAR:
        return None
    chosen = tuple(pair for pair, is_near in zip(pairs, near, strict=True) if is_near)
    return CommonLags(fitted, chosen, tuple(periods.tolist()), mismatch)


def checked_passband(passband: Sequence[float]) -> tuple[float, float]:
    """The two ends of a pass-band (Hz); InputError unless 0 < low < high."""
    if len(passband) != 2 or not all(math.isfinite(f) for f in passband):
        raise InputError(f"`passband` must be two frequencies in Hz, got {tuple(passband)}")
    low, high = float(passband[0]), float(passband[1])
    if not 0.0 < low < high:
        raise InputError(
            f"`passband` must rise from a positive frequency, got {low:g} to {high:g} Hz; a constant is "
            "never seen, and the lower end comes first"
        )
    if low < LOWEST or high > HIGHEST:
        raise InputError(
            f"`passband` is {low:g} to {high:g} Hz; {LOWEST:g} (a swing in thirty years) to {HIGHEST:g} Hz "
            "are allowed"
        )
    return low, high


def _checked(positions: ArrayLike, noise: RowNoise) -> tuple[Array, Array]:
    t = np.asarray(positions, dtype=np.float64)
    if t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all():
        raise InputError(f"`positions` must be two or more finite times in s, got {positions!r}")
    if len(noise.sigma_px) != len(t):
        raise InputError(
            f"`noise` is of {len(noise.sigma_px)} images, `positions` of {len(t)}; give one sigma for each"
        )
    return t, noise.weights
