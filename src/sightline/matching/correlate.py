"""Whole-pixel search by FFT, then the sub-pixel fit with its covariance.

Not the cutting of images into blocks and patches: see `patches`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.execution import slices
from sightline.matching import kernels
from sightline.writing import let_go, scratch_array

__all__ = [
    "agreement_of_gradients",
    "chance_agreement",
    "correlation_surface",
    "pair_covariances",
    "search_shift",
]

_BATCH_PIXELS = 1 << 20
_PRIOR_WINDOWS = 3.0
#: Windows whose covariance is found at a time.
_AT_ONCE = 16384
_MOST_DIRECT = 500
"""Places up to which correlation term by term is faster than the Fourier transform."""


def correlation_surface(templates: NDArray[np.float32], regions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Normalised correlation of templates with every place of larger regions.

    Parameters
    ----------
    templates : (N, h, w) float32
    regions : (N, H, W) float32
        H >= h, W >= w.

    Returns
    -------
    (N, H - h + 1, W - w + 1) float32, -1 to 1: entry [n, i, j] compares the template with
    ``regions[n, i:i+h, j:j+w]``.
    """
    from scipy import fft

    (h, w), (rows, columns) = templates.shape[1:], regions.shape[1:]
    shape = (fft.next_fast_len(rows, True), fft.next_fast_len(columns, True))
    t = templates - templates.mean(axis=(1, 2), keepdims=True)
    g = regions - regions.mean(axis=(1, 2), keepdims=True)
    spectrum = fft.rfft2(t, s=shape).conj()
    spectrum *= fft.rfft2(g, s=shape)
    cross = fft.irfft2(spectrum, s=shape)[:, : rows - h + 1, : columns - w + 1]

    def boxes(values: NDArray[np.float32]) -> NDArray[np.float64]:
        total = np.zeros((len(values), rows + 1, columns + 1))
        np.cumsum(np.cumsum(values, axis=1, dtype=np.float64), axis=2, out=total[:, 1:, 1:])
        lines = total[:, h:] - total[:, :-h]
        return np.asarray(lines[:, :, w:] - lines[:, :, :-w])

    energy = boxes(g * g) - boxes(g) ** 2 / (h * w)
    own = (t.astype(np.float64) ** 2).sum(axis=(1, 2))[:, None, None]
    return np.asarray(cross / np.sqrt(np.maximum(energy * own, 1e-30)), dtype=np.float32)


def _peaks(surface: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Highest point of each surface with a parabola along each axis; True where it is not on the border."""
    n, rows, columns = surface.shape
    best = surface.reshape(n, -1).argmax(axis=1)
    y, x = best // columns, best % columns
    inner = (y > 0) & (y < rows - 1) & (x > 0) & (x < columns - 1)
    peak = np.stack([y, x], axis=1).astype(np.float64)
    k = np.flatnonzero(inner)
    centre = surface[k, y[k], x[k]]
    for axis, (dy, dx) in enumerate(((1, 0), (0, 1))):
        low, high = surface[k, y[k] - dy, x[k] - dx], surface[k, y[k] + dy, x[k] + dx]
        bend = np.minimum(low + high - 2 * centre, -1e-6)
        peak[k, axis] += np.clip(0.5 * (low - high) / bend, -0.5, 0.5)
    return peak, inner


def search_shift(
    fa: NDArray[np.float32],
    fb: NDArray[np.float32],
    corner: NDArray[np.int64],
    centre: NDArray[np.float64],
    size: tuple[int, int],
    reach: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Whole-pixel search around the predicted places, refined by a parabola.

    Parameters
    ----------
    fa, fb : (lines, columns) float32
        Filtered blocks.
    corner : (N, 2)
        First line and column of each window in `fa`.
    centre : (N, 2)
        Predicted place of the window's centre in `fb`.
    size, reach : (int, int)
        Window, and half-range of the search.

    Returns
    -------
    shift : (N, 2) px, to add to `centre`
    found : (N,) bool; False where the best place is on the border of the search
    """
    h, w = size
    big = (h + 2 * reach[0] + 2, w + 2 * reach[1] + 2)
    low = np.rint(centre - 0.5 * (np.array(size) - 1)).astype(np.int64)
    offset = low + 0.5 * (np.array(size) - 1) - centre
    low = low - np.array(reach) - 1
    views_a = np.lib.stride_tricks.sliding_window_view(fa, size)
    views_b = np.lib.stride_tricks.sliding_window_view(fb, big)
    low = np.clip(low, 0, np.array(views_b.shape[:2]) - 1)
    places = (2 * reach[0] + 3, 2 * reach[1] + 3)
    shift, found = np.zeros((len(corner), 2)), np.zeros(len(corner), bool)
    batch = max(1, _BATCH_PIXELS // (big[0] * big[1]))
    for first in range(0, len(corner), batch):
        k = slice(first, first + batch)
        if places[0] * places[1] <= _MOST_DIRECT:
            surface = np.empty((len(corner[k]), *places), np.float32)
            kernels.correlate_windows(fa, fb, corner[k], low[k], (int(h), int(w)), surface)
        else:
            surface = correlation_surface(views_a[corner[k, 0], corner[k, 1]], views_b[low[k, 0], low[k, 1]])
        peak, found[k] = _peaks(surface)
        shift[k] = peak - np.array(reach) - 1 + offset[k]
    return shift, found


def agreement_of_gradients(fits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalised correlation of the gradients of both windows in the direction where it is least.

    Parameters
    ----------
    fits : (N, kernels.COLUMNS)
        What `kernels.refine_windows` gave.

    Returns
    -------
    (N,) -1 to 1; NaN where there is no fit.

    Notes
    -----
    Stripes with noise of its own in each image look alike as a whole, and say nothing along themselves: there
    the gradients are noise, and agree by chance alone (`chance_agreement`). With h the products of the
    gradients of a with those of b, and g those of their mean with itself, ``2 g - h`` is the mean of those of
    either image with itself; returned is the smaller eigenvalue of ``(2 g - h)^-1 h``.
    """
    h, g = _symmetric(fits[:, 2:5]), _symmetric(fits[:, 5:8])
    own = 2.0 * g - h
    with np.errstate(invalid="ignore", divide="ignore"):
        size = own[:, 0, 0] * own[:, 1, 1] - own[:, 0, 1] ** 2
        crossed = own[:, 1, 1] * h[:, 0, 0] + own[:, 0, 0] * h[:, 1, 1] - 2.0 * own[:, 0, 1] * h[:, 0, 1]
        product = (h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2) / size
        half = 0.5 * crossed / size
        return np.asarray(half - np.sqrt(np.maximum(half**2 - product, 0.0)))


def chance_agreement(window: tuple[int, int], search_px: tuple[int, int], share: float = 0.5) -> float:
    """Agreement of gradients that noise alone reaches in one window of a hundred, at its best place.

    Parameters
    ----------
    window : (int, int)
        Lines and columns.
    search_px : (int, int)
        Half-range of the search, px.
    share : float
        Independent values for each pixel (`Whitening.independent_share`).

    Notes
    -----
    The correlation of two noises over n independent pixels scatters by ``n^-1/2``. The largest of p of them
    lies at ``(2 ln p)^1/2`` of that on average, and in one of a hundred by 1.2 higher.
    """
    places = (2 * search_px[0] + 3) * (2 * search_px[1] + 3)
    return float((1.2 + np.sqrt(2.0 * np.log(places))) / np.sqrt(share * window[0] * window[1]))


def _symmetric(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2, 2) of yy, yx, xx (N, 3)."""
    return parts[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def pair_covariances(fits: NDArray[np.float64], kept: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Covariance of every fitted shift.

    Parameters
    ----------
    fits : (N, kernels.COLUMNS)
        What `kernels.refine_windows` gave for all windows of the pair.
    kept : (N,) bool
        Which of them are good; the rest do not teach the common factors.

    Returns
    -------
    (N, 2, 2) px^2, NaN where there is no fit.

    Notes
    -----
    Sandwich ``H^-1 V H^-1`` with ``V = K (s^2 G) K``: s^2 the window's residual variance, G the sum of the
    outer products of the mean gradient, and K the pair's two factors (line, column) by which residuals that
    are correlated from pixel to pixel make the variance of the score larger or smaller. K^2 is the variance
    of the score between column blocks of a window (neighbours' products included, the share that the fit
    removes restored) over s^2 G, averaged over the good windows; few windows lean towards K = 1.
    """
    covariance = scratch_array((len(fits), 2, 2))
    factor = _score_factors(fits, kept & (fits[:, 14] > 0))
    for some in slices(len(fits), _AT_ONCE):
        f, out = fits[some], covariance[some]
        done = f[:, 14] > 0
        f = f[done]
        v = _symmetric(f[:, 5:8]) * f[:, 8][:, None, None] * np.outer(factor, factor)
        inverse = np.linalg.inv(_symmetric(f[:, 2:5]))
        out[done], out[~done] = inverse @ v @ inverse, np.nan
        let_go()
    return covariance


def _score_factors(fits: NDArray[np.float64], good: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(2,) by how much residuals that are correlated make the score of line and column vary more."""
    factor = np.ones(2)
    for axis, (g, q) in enumerate(((5, 10), (7, 12))):
        rows = good & (fits[:, g] > 0) & (fits[:, 8] > 0)
        ratio, share = fits[rows, q] / (fits[rows, g] * fits[rows, 8]), fits[rows, q + 1]
        sound = ratio <= 30.0 * np.median(ratio) if len(ratio) else np.zeros(0, np.bool_)
        # the products of neighbours can make the sum of a few windows negative: the prior stays half of it
        seen, expected = ratio[sound].sum() + _PRIOR_WINDOWS, share[sound].sum() + _PRIOR_WINDOWS
        factor[axis] = np.sqrt(max(seen, 0.5 * _PRIOR_WINDOWS) / max(expected, 0.5 * _PRIOR_WINDOWS))
        let_go()
    return factor
