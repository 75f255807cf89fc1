"""The filters that let every frequency weigh as much as it knows about the shift.

Estimated from the images themselves. Not their application: see `kernels.filter_image`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.imaging.resample import delay_weights
from sightline.imaging.source import ImageSource, read_padded

__all__ = ["Whitening", "estimate_whitening"]

_QUADRANT = (7, 7)
_GRID = 64
_EDGE = 6


@dataclass(frozen=True, eq=False)
class Whitening:
    """One filter per image of a pair, symmetric along lines and columns.

    Parameters
    ----------
    taps_a, taps_b : (7, 7)
        Quadrant of the 13 x 13 taps of image a (b), [0, 0] the centre, [i, j] the tap i lines and j columns
        away from it.
    coherence : (64, 33), optional
        Magnitude-squared coherence the filters were made from, on the grid of `numpy.fft.rfft2`.
    tiles : int
        Number of tiles it was estimated from; 0 when it was given.
    """

    taps_a: NDArray[np.float32]
    taps_b: NDArray[np.float32]
    coherence: NDArray[np.float64] | None = None
    tiles: int = 0

    def __post_init__(self) -> None:
        for name in ("taps_a", "taps_b"):
            taps = np.array(getattr(self, name), dtype=np.float32, order="C")
            if taps.shape != _QUADRANT or not np.isfinite(taps).all():
                raise InputError(
                    f"whitening refused: `{name}` has shape {taps.shape}; a finite quadrant of shape (7, 7) "
                    "is needed, [0, 0] the centre of the 13 x 13 filter; see Whitening.from_response"
                )
            taps.setflags(write=False)
            object.__setattr__(self, name, taps)

    @classmethod
    def from_response(
        cls, response_a: NDArray[np.float64], response_b: NDArray[np.float64] | None = None
    ) -> Whitening:
        """Filters nearest to wanted frequency responses.

        Parameters
        ----------
        response_a, response_b : (64, 33)
            Real responses on the grid of `numpy.fft.rfft2` of 64 x 64 pixels; `response_b` defaults to
            `response_a`.
        """
        taps_a = _taps(response_a)
        return cls(taps_a, taps_a if response_b is None else _taps(response_b))

    def response(self, image: str = "a") -> NDArray[np.float64]:
        """Frequency response of the filter as applied.

        Parameters
        ----------
        image : "a" or "b"

        Returns
        -------
        (64, 33) real response on the grid of `numpy.fft.rfft2`.
        """
        taps = self.taps_a if image == "a" else self.taps_b
        fy, fx = _frequencies()
        k = np.arange(7)
        twice = np.where(k == 0, 1.0, 2.0)
        cy = twice * np.cos(2 * np.pi * fy[:, :1] * k)
        cx = twice * np.cos(2 * np.pi * fx[0][:, None] * k)
        return np.asarray(cy @ taps.astype(np.float64) @ cx.T)


def _frequencies() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    fy, fx = np.meshgrid(np.fft.fftfreq(_GRID), np.fft.rfftfreq(_GRID), indexing="ij")
    return fy, fx


def _taps(response: NDArray[np.float64]) -> NDArray[np.float32]:
    """Quadrant of the 13 x 13 filter nearest to a response; the cut is softened by a raised cosine."""
    impulse = np.fft.irfft2(np.asarray(response, dtype=np.float64), s=(_GRID, _GRID))
    soft = np.cos(0.5 * np.pi * np.arange(7) / 7.5) ** 1.0
    return np.asarray(impulse[:7, :7] * np.outer(soft, soft), dtype=np.float32)


def _tiles(
    image_a: ImageSource,
    image_b: ImageSource,
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    tile: tuple[int, int],
    reach: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pairs of tiles without unusable pixels; those of b wider by `reach` and 6 px on every side."""
    size = np.array(tile)
    corner_a = np.rint(points_a - (size - 1) / 2).astype(int)
    border = np.array(reach) + _EDGE
    corner_b = np.rint(predicted_b - points_a + corner_a).astype(int) - border
    big = size + 2 * border
    inside = np.all((corner_a >= 0) & (corner_a + size <= image_a.shape), axis=1)
    inside &= np.all((corner_b >= 0) & (corner_b + big <= image_b.shape), axis=1)
    tiles_a, tiles_b = [], []
    for (ya, xa), (yb, xb) in zip(corner_a[inside], corner_b[inside], strict=True):
        a, bad_a = read_padded(image_a, (ya, ya + tile[0]), (xa, xa + tile[1]))
        b, bad_b = read_padded(image_b, (yb, yb + int(big[0])), (xb, xb + int(big[1])))
        if bad_a is None and bad_b is None and a.std() > 0 and b.std() > 0:
            tiles_a.append(a)
            tiles_b.append(b)
    shape = (0, 1, 1)
    return (
        np.stack(tiles_a) if tiles_a else np.empty(shape, np.float32),
        np.stack(tiles_b) if tiles_b else np.empty(shape, np.float32),
    )


def _tapered_spectra(tiles: NDArray[np.float32]) -> NDArray[np.complex128]:
    """Spectra of tiles without their mean, under a cosine taper of unit power."""
    from scipy import fft

    rows, columns = tiles.shape[1:]
    taper = np.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) for n in (rows, columns)))
    taper = (taper / np.sqrt((taper**2).mean() * rows * columns)).astype(np.float32)
    flat = tiles - tiles.mean(axis=(1, 2), keepdims=True)
    return np.asarray(fft.rfft2(flat * taper), dtype=np.complex128)


def _phase_shift(
    cross: NDArray[np.complex128], power: NDArray[np.float64], tile: tuple[int, int]
) -> NDArray[np.float64]:
    """Sub-pixel shift of every tile from the slope of its cross-spectrum's phase, by Newton steps."""
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    middle = (np.hypot(fy, fx) > 1.5 / min(tile)) & (np.abs(fy) < 0.3) & (fx < 0.3)
    weight = middle * np.hypot(fy, fx) ** 2 / power
    wy, wx = 2 * np.pi * fy, 2 * np.pi * fx
    shift = np.zeros((len(cross), 2))
    for _ in range(6):
        turned = weight * cross * _turn(shift, wy, wx)
        slope = [-(turned.imag * w).sum(axis=(1, 2)) for w in (wy, wx)]
        real = np.abs(turned.real)
        hyy, hyx, hxx = ((real * u * v).sum(axis=(1, 2)) for u, v in ((wy, wy), (wy, wx), (wx, wx)))
        det = np.maximum(hyy * hxx - hyx**2, 1e-30)
        step = np.stack([hxx * slope[0] - hyx * slope[1], hyy * slope[1] - hyx * slope[0]], axis=1)
        shift += np.clip(step / det[:, None], -0.5, 0.5)
    return shift


def _turn(
    shift: NDArray[np.float64], wy: NDArray[np.float64], wx: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Phase factors that undo a shift."""
    return np.asarray(np.exp(1j * (shift[:, :1, None] * wy + shift[:, 1:, None] * wx)))


def _aligned(
    a: NDArray[np.float32], b: NDArray[np.float32], reach: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Tiles of a and, interpolated at each tile's own shift, of b; those that found no shift are left out.

    Whole pixels by correlation of the differentiated tiles, then the phase. Cutting b at whole pixels only
    would leave the taper up to half a pixel off the texture: 0.3 % of lost coherence for tiles of 16 lines.
    """
    from sightline.matching.correlate import correlation_surface

    tile = (a.shape[1], a.shape[2])
    edge = _EDGE
    searched = np.ascontiguousarray(b[:, edge:-edge, edge:-edge])
    rough = [np.diff(np.diff(t, axis=1), axis=2) for t in (a, searched)]
    corner = np.empty((len(a), 2), np.int64)
    for first in range(0, len(a), 32):
        k = slice(first, first + 32)
        surface = correlation_surface(rough[0][k], rough[1][k])
        best = surface.reshape(len(surface), -1).argmax(axis=1)
        corner[k] = np.stack(np.unravel_index(best, surface.shape[1:]), axis=1)
    corner += edge
    cut = np.stack([t[y : y + tile[0], x : x + tile[1]] for t, (y, x) in zip(b, corner, strict=True)])
    spectra_a, spectra_b = _tapered_spectra(a), _tapered_spectra(cut)
    power = (np.abs(spectra_a) ** 2).mean(axis=0) + (np.abs(spectra_b) ** 2).mean(axis=0)
    shift = _phase_shift(spectra_a.conj() * spectra_b, power, tile)
    for n, (y, x) in enumerate(corner):
        cut[n] = _interpolated(b[n], y + shift[n, 0], x + shift[n, 1], tile)
    good = np.abs(shift).max(axis=1) < 1.2
    return a[good], cut[good]


def _interpolated(
    image: NDArray[np.float32], line: float, column: float, tile: tuple[int, int]
) -> NDArray[np.float32]:
    """A tile whose first pixel lies at a fractional place."""
    y, x = int(np.floor(line)), int(np.floor(column))
    y, x = min(max(y, 3), image.shape[0] - tile[0] - 4), min(max(x, 3), image.shape[1] - tile[1] - 4)
    wy, wx = delay_weights(np.clip(np.array([line - y, column - x]), 0.0, 1.0)).astype(np.float32)
    part = sum(wy[k] * image[y - 3 + k : y - 3 + k + tile[0], x - 3 : x + 4 + tile[1]] for k in range(8))
    return np.asarray(sum(wx[k] * part[:, k : k + tile[1]] for k in range(8)), dtype=np.float32)


def _spectra(
    a: NDArray[np.float32], b: NDArray[np.float32]
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Cross- and auto-periodograms of aligned tiles; what shift is left is taken out by phase."""
    tile = (a.shape[1], a.shape[2])
    spectra_a, spectra_b = _tapered_spectra(a), _tapered_spectra(b)
    auto_a, auto_b = np.abs(spectra_a) ** 2, np.abs(spectra_b) ** 2
    cross = spectra_a.conj() * spectra_b
    shift = _phase_shift(cross, auto_a.mean(axis=0) + auto_b.mean(axis=0), tile)
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    return cross * _turn(shift, 2 * np.pi * fy, 2 * np.pi * fx), auto_a, auto_b


def _smooth_log(values: NDArray[np.float64], fy: NDArray[np.float64], fx: NDArray[np.float64],
                use: NDArray[np.bool_], weight: NDArray[np.float64]) -> NDArray[np.float64]:  # fmt: skip
    """A log-spectrum as a smooth function of |fy| and |fx|, evaluated on the 64 x 64 grid."""

    def basis(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        p, q = 4 * y**2, 4 * x**2
        radial = np.log(y**2 + x**2 + 0.02**2)
        terms = (np.ones_like(p), radial, p, q, p * p, q * q, p * q, p**3, q**3, p * q * (p + q))
        return np.stack(terms, axis=-1)

    rows = basis(fy[use], fx[use]) * weight[use][:, None]
    solution = np.linalg.lstsq(rows, np.log(values[use]) * weight[use], rcond=1e-8)[0]
    gy, gx = _frequencies()
    return np.asarray(np.exp(basis(gy, gx) @ solution))


def estimate_whitening(
    image_a: ImageSource,
    image_b: ImageSource,
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    *,
    tile: tuple[int, int] = (16, 128),
    reach: tuple[int, int] = (4, 4),
    most_tiles: int = 400,
) -> Whitening:
    """Filters for a pair of images, from their spectra and coherence.

    Parameters
    ----------
    image_a, image_b : ImageSource
    points_a, predicted_b : (N, 2)
        Where to look in image a and where that should lie in image b; spread over the images.
    tile : (int, int)
        Lines and columns of the tiles whose spectra are averaged. Low, so that motion within one is small.
    reach : (int, int)
        Largest error of the prediction, px.
    most_tiles : int
        At most so many points are used, evenly taken from those given.

    Returns
    -------
    Whitening

    Raises
    ------
    EstimationError
        If fewer than 8 pairs of tiles are usable or nothing in them is alike.

    Notes
    -----
    Maximum-likelihood weight of frequency f in the cross-spectrum of two noisy images of one scene:
    ``w = c / ((1 - c) |S_ab|)``, c the coherence (the information on a shift is the integral of
    ``(2 pi f)^2 c / (1 - c)``); each image takes ``sqrt(w)``. Tiles are first aligned, each by its own phase:
    what stays misaligned would look like lost coherence. Frequencies that the interpolation cannot carry fade
    out between 0.36 and 0.5 cycle/px along each axis.
    """
    chosen = np.unique(np.linspace(0, len(points_a) - 1, min(most_tiles, max(len(points_a), 1))).astype(int))
    finite = np.isfinite(points_a[chosen]).all(axis=1) & np.isfinite(predicted_b[chosen]).all(axis=1)
    chosen = chosen[finite]
    a, b = _tiles(image_a, image_b, points_a[chosen], predicted_b[chosen], tile, reach)
    if len(a) < 8:
        raise EstimationError(
            f"whitening cannot be estimated: {len(a)} usable tiles of {tile[0]} x {tile[1]} px at "
            f"{len(chosen)} points; at least 8 are needed; give more points, a smaller `tile`, or "
            "whitening=None"
        )
    cross, auto_a, auto_b = _spectra(*_aligned(a, b, reach))
    # each tile weighs the same whatever its contrast, but scaled alike in a and b
    scale = 1.0 / np.sqrt(auto_a[:, 1:, 1:].mean(axis=(1, 2)) * auto_b[:, 1:, 1:].mean(axis=(1, 2)))
    scale = np.minimum(scale, 4 * np.median(scale)) / max(len(scale), 1)
    s_ab, s_a, s_b = (np.tensordot(scale, t, axes=1) for t in (cross, auto_a, auto_b))
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    bias = 1.0 / len(cross)
    signal = np.maximum(s_ab.real, 0.0)
    coherence = np.clip((signal**2 / (s_a * s_b) - bias) / (1 - bias), 1e-3, 1 - 1e-5)
    use = (np.hypot(fy, fx) > 1.0 / min(tile)) & (s_a > 0) & (s_b > 0)
    if coherence[use].max() < 0.05:
        raise EstimationError(
            f"whitening cannot be estimated: the largest coherence of {len(cross)} tiles is "
            f"{coherence[use].max():.3f}; above 0.05 is needed; check the predicted positions or raise "
            "`reach`"
        )
    weight = np.sqrt(np.maximum(coherence, 0.02)) / np.hypot(np.hypot(fy, fx), 0.05)
    odds = _smooth_log(coherence / (1 - coherence), fy, fx, use, weight)
    spectrum = _smooth_log(np.sqrt(s_a * s_b), fy, fx, use, weight)
    smooth = odds / (1 + odds)
    gy, gx = _frequencies()
    fade = np.prod([np.cos(0.5 * np.pi * np.clip((np.abs(g) - 0.36) / 0.14, 0, 1)) for g in (gy, gx)], axis=0)
    response = np.sqrt(odds / (np.sqrt(smooth) * spectrum)) * fade
    response[0, 0] = 0.0
    response /= np.sqrt((response**2 * spectrum).mean())
    made = Whitening.from_response(response)
    return Whitening(made.taps_a, made.taps_b, smooth, len(cross))
