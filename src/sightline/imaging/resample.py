"""The separable interpolation kernel that matching, products and simulation share.

Eight taps per axis, the least-squares best approximation of a pure delay over the frequencies that an
image carries. Not the resampling of whole products: that is in `sightline.products`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import njit

__all__ = [
    "PHASES",
    "TAPS",
    "delay_weights",
    "kernel_table",
    "natural_correlation",
    "sample",
    "weights_of_sum_one",
]

TAPS = 8
"""Taps of the kernel along each axis; the sample lies between taps 3 and 4."""

PHASES = 256
"""Sub-pixel phases tabulated; weights between two phases are interpolated linearly (error < 2e-5)."""


def delay_weights(
    fractions: NDArray[np.float64], taps: int = TAPS, band: float = 0.38, *, natural: bool = False
) -> NDArray[np.float64]:
    """Interpolation weights for positions between two samples.

    Parameters
    ----------
    fractions : (N,)
        Position after the tap number ``taps/2 - 1``, in samples, 0 to 1.
    taps : int
        Number of taps, even.
    band : float
        Highest frequency (cycles per sample) that must come through faithfully.
    natural : bool
        Frequencies count by the power that natural ground has there (`natural_correlation`); else all alike.

    Returns
    -------
    (N, taps) weights, each row of sum 1.

    Notes
    -----
    Row d minimises the integral over |f| < band of ``|sum_k w_k exp(2i pi f k) - exp(2i pi f d)|^2 S(f)``
    under ``sum w = 1``: the normal matrix is the autocorrelation of S at ``k - l``, the right side at
    ``k - d``; ``2 band sinc(2 band lag)`` where S is flat.

    Examples
    --------
    >>> import numpy as np
    >>> delay_weights(np.array([0.5])).sum().round(12)
    np.float64(1.0)
    """
    k = np.arange(taps, dtype=np.float64) - (taps // 2 - 1)

    def flat(lag: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(2 * band * np.sinc(2 * band * lag))

    correlation, least = (natural_correlation(band, 400), 1e-13) if natural else (flat, 1e-9)
    right = correlation(k[:, None] - np.asarray(fractions, dtype=np.float64)[None, :])
    return weights_of_sum_one(correlation(k[:, None] - k[None, :]) + least * np.eye(taps), right)


def natural_correlation(band: float, nodes: int) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Autocorrelation, by lag in samples, of natural ground up to a frequency.

    Its power falls with 1/f^2 and is flat below 1/200 cycles per sample; `nodes` of Gauss's quadrature up to
    `band` (cycles per sample).
    """
    at, share = np.polynomial.legendre.leggauss(nodes)
    f = 0.5 * band * (at + 1.0)
    power = share / (f + 1.0 / 200.0) ** 2
    power /= power.sum()

    def correlation(lag: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.cos(2.0 * np.pi * lag[..., None] * f) @ power)

    return correlation


def weights_of_sum_one(normal: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares weights (N, taps) of sum 1 for a normal matrix (taps, taps) and right sides (taps, N)."""
    inverse = np.linalg.inv(normal)
    free = inverse @ right
    ones = inverse.sum(axis=1)
    return np.ascontiguousarray((free + np.outer(ones / ones.sum(), 1.0 - free.sum(axis=0))).T)


@cache
def kernel_table() -> NDArray[np.float32]:
    """Tabulated weights, (PHASES + 1, TAPS) float32, read-only: row p is the fraction p / PHASES."""
    table = delay_weights(np.arange(PHASES + 1) / PHASES).astype(np.float32)
    table.setflags(write=False)
    return table


@njit(cache=True, nogil=True, fastmath=True)
def fill_weights(table, fraction, out):  # type: ignore[no-untyped-def]
    """Write the TAPS weights of a fraction in [0, 1] into `out`."""
    position = fraction * (table.shape[0] - 1)
    index = min(max(int(position), 0), table.shape[0] - 2)
    share = np.float32(position - index)
    for k in range(table.shape[1]):
        out[k] = table[index, k] + share * (table[index + 1, k] - table[index, k])


@njit(cache=True, nogil=True, fastmath=True)
def sample_at(image, line, column, table, wy, wx):  # type: ignore[no-untyped-def]
    """One interpolated value; the caller keeps the position 3 px from the low and 4 px from the high edge."""
    row, col = int(np.floor(line)), int(np.floor(column))
    fill_weights(table, line - row, wy)
    fill_weights(table, column - col, wx)
    total = np.float32(0.0)
    for i in range(8):
        part = np.float32(0.0)
        for j in range(8):
            part += wx[j] * image[row - 3 + i, col - 3 + j]
        total += wy[i] * part
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _sample_many(image, positions, table, out):  # type: ignore[no-untyped-def]
    wy, wx = np.empty(8, np.float32), np.empty(8, np.float32)
    for n in range(positions.shape[0]):
        line, column = positions[n, 0], positions[n, 1]
        if not (3 <= line <= image.shape[0] - 5 and 3 <= column <= image.shape[1] - 5):
            out[n] = np.nan
        else:
            out[n] = sample_at(image, line, column, table, wy, wx)


def sample(image: NDArray[np.float32], positions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Image values between pixels.

    Parameters
    ----------
    image : (lines, columns) float32
    positions : (N, 2)
        (line, column), fractional.

    Returns
    -------
    (N,) float32; NaN where the kernel would reach beyond the image (3 px before, 4 px after).
    """
    out = np.empty(len(positions), np.float32)
    inside = np.nan_to_num(np.ascontiguousarray(positions, dtype=np.float64), nan=-1.0)
    _sample_many(np.ascontiguousarray(image, dtype=np.float32), inside, kernel_table(), out)
    return out
