"""The filters that let every frequency weigh as much as it knows about the shift.

Estimated from the images themselves. Not their application: see `kernels.filter_image`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.imaging.resample import delay_weights, kernel_table
from sightline.imaging.source import ImageSource, read_padded
from sightline.matching import kernels

__all__ = ["Whitening", "estimate_whitening", "gradient_filter", "pair_whitening"]

_QUADRANT = (7, 7)
_GRID = 64
_EDGE = 6
TILES = 128
"""Tiles that teach the filters of a pair, where there are many pairs."""
_HIGHEST = 0.45
"""Cycles per pixel; frequencies that filters let pass."""
_FADE = 0.08
"""Cycles per pixel over which filters fade out."""
_OVER = 12
"""Pixels that the wider tiles of image b may reach beyond it, where it is reflected."""


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
    phase_bias : (float, float), optional
        px along lines and columns; what aliasing adds to matches, times the sine of the fraction of a pixel
        between the images (`sightline.motion.measure.aliasing`); None where it is not known.
    """

    taps_a: NDArray[np.float32]
    taps_b: NDArray[np.float32]
    coherence: NDArray[np.float64] | None = None
    tiles: int = 0
    phase_bias: tuple[float, float] | None = None

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

    def swapped(self) -> Whitening:
        """The filters of the same pair with its images taken in the other order."""
        return Whitening(self.taps_b, self.taps_a, self.coherence, self.tiles, self.phase_bias)

    def below(self, highest: float) -> Whitening:
        """The same filters for frequencies below `highest` (cycles/px) along each axis alone."""
        low = _fade(highest)
        return Whitening.from_response(self.response("a") * low, self.response("b") * low)

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

    @property
    def hub_share(self) -> float:
        """Share of a match's variance that is the noise of image a, its hub: the same in all its matches.

        Notes
        -----
        With the signal-to-noise ratio r of each of two images alike, the score's variance is 2 / r + 1 / r^2
        at each frequency: noise of either image times the texture, and noise times noise, which is new in
        every pair. Their coherence is c = (r / (1 + r))^2, a match weighs frequencies by f^2 c / (1 - c).
        Half where the coherence is not known.
        """
        if self.coherence is None:
            return 0.5
        c = self.coherence
        ratio = np.sqrt(c) / (1.0 - np.sqrt(c))
        fy, fx = np.meshgrid(np.fft.fftfreq(len(c)), np.fft.rfftfreq(len(c)), indexing="ij")
        # frequencies beyond this are filtered out; columns but the first stand for two
        weight = (fy**2 + fx**2) * (np.maximum(np.abs(fy), fx) < _HIGHEST) * np.where(fx > 0.0, 2.0, 1.0)
        odds = c / (1.0 - c)
        return float((weight * odds**2 / ratio).sum() / (weight * odds).sum())

    @property
    def independent_share(self) -> float:
        """Independent values for each pixel in the product of both images' gradients, where they are noise.

        Notes
        -----
        ``(sum P)^2 / (N sum P^2)`` over the N frequencies, with P the power that filter and derivative make
        of white noise; of the axis along which fewer are. Half where filters let everything pass.
        """
        fy, fx = _frequencies()
        twice = np.where(fx > 0.0, 2.0, 1.0) * (np.maximum(np.abs(fy), fx) < _HIGHEST)
        passed = np.abs(self.response("a") * self.response("b"))
        powers = [passed * f**2 for f in (fy, fx)]
        return min(float((twice * p).sum() ** 2 / (twice * p**2).sum() / _GRID**2) for p in powers)


def gradient_filter(corner: float = 0.18) -> Whitening:
    """A fixed filter that compares edges: the size of the gradient, |f|, below a Gaussian corner (cycles/px).

    A texture of power f^-2 becomes white; differences of brightness over an area do not count.
    """
    fy, fx = _frequencies()
    f = np.hypot(fy, fx)
    taps = _taps(f * np.exp(-0.5 * (f / corner) ** 2))
    # what cutting the filter to 13 taps left of brightness is taken out again, smoothly
    smooth = np.outer(*[np.cos(0.5 * np.pi * np.arange(7) / 7.5)] * 2)
    twice = np.where(np.arange(7) == 0, 1.0, 2.0)
    taps = taps - smooth * (twice @ taps @ twice) / (twice @ smooth @ twice)
    return Whitening(np.asarray(taps, dtype=np.float32), np.asarray(taps, dtype=np.float32))


def _frequencies() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    fy, fx = np.meshgrid(np.fft.fftfreq(_GRID), np.fft.rfftfreq(_GRID), indexing="ij")
    return fy, fx


def _fade(highest: float) -> NDArray[np.float64]:
    """1 for frequencies well below `highest`, 0 from it on (cycles/px), along each axis."""
    beyond = [np.clip((np.abs(g) - (highest - _FADE)) / _FADE, 0, 1) for g in _frequencies()]
    return np.prod([np.cos(0.5 * np.pi * each) for each in beyond], axis=0)


def _taps(response: NDArray[np.float64]) -> NDArray[np.float32]:
    """Quadrant of the 13 x 13 filter nearest to a response; the cut is softened by the root of a cosine."""
    impulse = np.fft.irfft2(np.asarray(response, dtype=np.float64), s=(_GRID, _GRID))
    soft = np.sqrt(np.cos(0.5 * np.pi * np.arange(7) / 7.5))
    return np.asarray(impulse[:7, :7] * np.outer(soft, soft), dtype=np.float32)


def _tiles(
    images: tuple[ImageSource, ImageSource],
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64],
    linear: NDArray[np.float64],
    tile: tuple[int, int],
    reach: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pairs of tiles without unusable pixels; those of b on the grid of a, wider by `reach` and 6 px."""
    size = np.array(tile)
    big = size + 2 * (np.array(reach) + _EDGE)
    corner_a = np.rint(points_a - (size - 1) / 2).astype(int)
    moved = corner_a + (size - 1) / 2 - points_a
    centre_b = predicted_b + moved + np.einsum("nij,nj->ni", linear, moved)
    # rounding to a whole pixel; what the kernel reads where tiles are warped
    beside = np.where(linear.any(axis=(1, 2)), 5.0, 1.0)
    half = 0.5 * big + np.abs(linear) @ (0.5 * big) + beside[:, None]
    low, high = np.floor(centre_b - half).astype(int), np.ceil(centre_b + half).astype(int) + 1
    inside = np.all((corner_a >= 0) & (corner_a + size <= images[0].shape), axis=1)
    inside &= np.all((low >= -_OVER) & (high <= np.array(images[1].shape) + _OVER), axis=1)
    tiles_a = np.empty((int(inside.sum()), *tile), np.float32)
    tiles_b = np.empty((len(tiles_a), int(big[0]), int(big[1])), np.float32)
    count = 0
    for n in np.flatnonzero(inside):
        (ya, xa), box = corner_a[n], np.stack([low[n], high[n]], axis=1)
        a, bad_a = read_padded(images[0], (ya, ya + tile[0]), (xa, xa + tile[1]))
        b, bad_b = read_padded(images[1], tuple(box[0]), tuple(box[1]))
        if bad_a is not None or bad_b is not None or not (a.std() > 0 and b.std() > 0):
            continue
        tiles_a[count] = a
        _on_grid(b, centre_b[n] - low[n], linear[n], tiles_b[count])
        count += 1
    return tiles_a[:count], tiles_b[:count]


def _on_grid(
    image: NDArray[np.float32],
    centre: NDArray[np.float64],
    linear: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Fill `out` with an image around a centre, at the nearest whole pixels or through an affine."""
    if not linear.any():
        y, x = np.rint(centre - 0.5 * (np.array(out.shape) - 1)).astype(int)
        out[:] = image[y : y + out.shape[0], x : x + out.shape[1]]
        return
    outside = np.zeros(out.shape, np.bool_)
    kernels.warp_windows(image, centre[None], linear[None], out.shape, kernel_table(), out, outside)


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
    along, across = np.exp(1j * shift[:, :1] * wy[:, 0]), np.exp(1j * shift[:, 1:] * wx[0])
    return np.asarray(along[:, :, None] * across[:, None, :])


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
    """Cross- and auto-periodograms of aligned tiles; what shift is left is taken out by phase.

    Tiles that are much less alike than most (a cloud in one image, a false shift) are left out.
    """
    tile = (a.shape[1], a.shape[2])
    spectra_a, spectra_b = _tapered_spectra(a), _tapered_spectra(b)
    auto_a, auto_b = np.abs(spectra_a) ** 2, np.abs(spectra_b) ** 2
    cross = spectra_a.conj() * spectra_b
    mean_a, mean_b = auto_a.mean(axis=0), auto_b.mean(axis=0)
    shift = _phase_shift(cross, mean_a + mean_b, tile)
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    cross = cross * _turn(shift, 2 * np.pi * fy, 2 * np.pi * fx)
    middle = (np.hypot(fy, fx) > 1.5 / min(tile)) & (np.hypot(fy, fx) < 0.25)
    level = middle / (mean_a + mean_b)
    own = [(level * auto).sum(axis=(1, 2)) for auto in (auto_a, auto_b)]
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = (level * cross.real).sum(axis=(1, 2)) / np.sqrt(own[0] * own[1])
    # a tile that is flat under the taper (saturated but for its rim) has no likeness at all
    good = alike >= 0.6 * np.nanmedian(alike)
    return cross[good], auto_a[good], auto_b[good]


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
    affine: NDArray[np.float64] | None = None,
    tile: tuple[int, int] | None = None,
    reach: tuple[int, int] = (4, 4),
    most_tiles: int = 400,
) -> Whitening:
    """Filters for a pair of images, from their spectra and coherence.

    Parameters
    ----------
    image_a, image_b : ImageSource
    points_a, predicted_b : (N, 2)
        Where to look in image a and where that should lie in image b; spread over the images.
    affine : (N, 2, 2), optional
        Local change of geometry, as for `match_images`; identity by default.
    tile : (int, int), optional
        Lines and columns of the tiles whose spectra are averaged: 16 x 128 by default, less for images under
        32 lines or 256 columns. Low, so that motion within one is small.
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
    out between 0.42 and 0.5 cycle/px along each axis.
    """
    if tile is None:
        tile = (min(16, image_a.shape[0] // 2), min(128, image_a.shape[1] // 2))
    count = len(points_a)
    chosen = np.unique(np.linspace(0, max(count - 1, 0), min(most_tiles, count)).astype(int))
    finite = np.isfinite(points_a[chosen]).all(axis=1) & np.isfinite(predicted_b[chosen]).all(axis=1)
    chosen = chosen[finite]
    linear = np.zeros((len(chosen), 2, 2)) if affine is None else affine[chosen] - np.eye(2)
    a, b = _tiles((image_a, image_b), points_a[chosen], predicted_b[chosen], linear, tile, reach)
    if len(a) < 8:
        raise EstimationError(
            f"whitening cannot be estimated: {len(a)} usable tiles of {tile[0]} x {tile[1]} px at "
            f"{len(chosen)} points; at least 8 are needed; give more points, a smaller `tile`, or "
            "whitening=None"
        )
    a, b = _aligned(a, b, reach)
    cross, auto_a, auto_b = _spectra(a, b) if len(a) else (a, a, a)
    if len(cross) == 0:
        raise EstimationError(
            f"whitening cannot be estimated: none of {count} points lies within {reach} px of where it is "
            "predicted; check the predicted positions or raise `reach`"
        )
    # each tile weighs the same whatever its contrast, but scaled alike in a and b
    scale = 1.0 / np.sqrt(auto_a[:, 1:, 1:].mean(axis=(1, 2)) * auto_b[:, 1:, 1:].mean(axis=(1, 2)))
    scale = np.minimum(scale, 4 * np.median(scale)) / max(len(scale), 1)
    s_ab, s_a, s_b = (np.tensordot(scale, t, axes=1) for t in (cross, auto_a, auto_b))
    fy, fx = np.meshgrid(np.fft.fftfreq(tile[0]), np.fft.rfftfreq(tile[1]), indexing="ij")
    bias = 1.0 / len(cross)
    signal = np.maximum(s_ab.real, 0.0)
    coherence = np.clip((signal**2 / (s_a * s_b) - bias) / (1 - bias), 1e-3, 1 - 1e-5)
    use = (np.hypot(fy, fx) > 1.0 / min(tile)) & (s_a > 0) & (s_b > 0)
    # unrelated tiles, each aligned at its best, reach 0.03 + 1 / tiles in the best 2 % of frequencies
    best, needed = float(np.quantile(coherence[use], 0.98)), 0.05 + 1.0 / len(cross)
    if best < needed:
        raise EstimationError(
            f"whitening cannot be estimated: the coherence of {len(cross)} tiles is {best:.3f} at its best "
            f"frequencies; above {needed:.3f} is needed; check the predicted positions or raise `reach`"
        )
    weight = np.sqrt(np.maximum(coherence, 0.02)) / np.hypot(np.hypot(fy, fx), 0.05)
    odds = _smooth_log(coherence / (1 - coherence), fy, fx, use, weight)
    spectrum = _smooth_log(np.sqrt(s_a * s_b), fy, fx, use, weight)
    smooth = odds / (1 + odds)
    response = np.sqrt(odds / (np.sqrt(smooth) * spectrum)) * _fade(0.5)
    response[0, 0] = 0.0
    response /= np.sqrt((response**2 * spectrum).mean())
    made = Whitening.from_response(response)
    return Whitening(made.taps_a, made.taps_b, smooth, len(cross))


def pair_whitening(
    image_a: ImageSource,
    image_b: ImageSource,
    points_a: NDArray[np.float64],
    predicted_b: NDArray[np.float64] | None = None,
    *,
    affine: NDArray[np.float64] | None = None,
    tile: tuple[int, int] | None = None,
    reach: tuple[int, int] = (4, 4),
    most_tiles: int = 400,
) -> Whitening | None:
    """Filters of a pair as `estimate_whitening` gives them; None where too little can be seen at the points.

    `predicted_b`: the same points by default, for an image that is laid on the other.
    """
    predicted_b = points_a if predicted_b is None else predicted_b
    options = {"affine": affine, "tile": tile, "reach": reach, "most_tiles": most_tiles}
    try:
        return estimate_whitening(image_a, image_b, points_a, predicted_b, **options)  # type: ignore[arg-type]
    except EstimationError:
        return None
