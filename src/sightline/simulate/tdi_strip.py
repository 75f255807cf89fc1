"""A strip of a TDI detector imaging a finely sampled scene that drifts over it, by brute force.

Every stage of every pixel sums what it sees over its photosensitive area and over instants of its exposure,
draws its own noise, and fills its own well; stages are added one line period apart. No transfer function is
used, so that those of ``imaging/tdi_transfer.py`` and the noise law can be checked against the image.

The scene lies in the geometry of the image: without drift, stages are centred on the pixel of the same line
and column. Line j, stage k, instant u sees the scene at column c - V tan(g) (k + u) - x(j + k + u) and at
line j + (V - 1) k + V u + y(j + k + u): (x, y) is a motion beyond the drift.

Not here: what is in the scene (``tdi_target.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.compiled import njit, only_read
from sightline.errors import InputError
from sightline.tdi.setting import TdiDetector

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Where in its line period a stage is exposed: centre of the exposure minus that of the line, in exposures.
SHUTTER = {"centre": 0.0, "start": 0.5, "end": -0.5}
#: Instants of an exposure: their sum departs from the integral by (pi f / 16)^2 / 6, 0.16 % at f = 0.5.
INSTANTS = 16
#: Sub-pixels of the photosensitive width, each way: 0.07 % by the same law.
SUBPIXELS = 24


@dataclass(frozen=True, eq=False)
class FineScene:
    """Radiance on a grid finer than the pixels of the detector.

    Attributes
    ----------
    radiance : ((lines + 2 margin) per_pixel, (columns + 2 margin) per_pixel)
        Means over the cells of the grid; any unit in which 1 is what `signal` electrons come from.
    per_pixel : int
        Cells per pixel, each way.
    margin : int
        Pixels around the image.
    """

    radiance: Array
    per_pixel: int
    margin: int

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and columns of the image."""
        rows, columns = self.radiance.shape
        return rows // self.per_pixel - 2 * self.margin, columns // self.per_pixel - 2 * self.margin

    def blurred(self, sigma: tuple[float, float], aperture: tuple[float, float]) -> FineScene:
        """What the pixels see: the scene through optics and diffusion, summed over photosensitive areas.

        Parameters
        ----------
        sigma : (float, float)
            Pixels across and along; of the Gaussian that optics and diffusion spread a point into.
        aperture : (float, float)
            Photosensitive width across and along, pixels; 0 samples a point.
        """
        from scipy.ndimage import convolve1d

        seen = _diffused(self.radiance, [s * self.per_pixel for s in sigma])
        for axis, width in ((1, aperture[0]), (0, aperture[1])):
            if width:
                seen = convolve1d(seen, _aperture_weights(width * self.per_pixel), axis=axis, mode="nearest")
        return FineScene(np.ascontiguousarray(seen), self.per_pixel, self.margin)


def _diffused(cells: Array, sigma: list[float]) -> Array:
    """Values at the centres of cells after a Gaussian blur, the averaging over cells undone."""
    import scipy.fft

    fx, fy = scipy.fft.rfftfreq(cells.shape[1]), scipy.fft.fftfreq(cells.shape[0])[:, None]
    transfer = [
        np.exp(-2.0 * (np.pi * s * f) ** 2) / np.sinc(f) for s, f in zip(sigma, (fx, fy), strict=True)
    ]
    spectrum = scipy.fft.rfft2(cells) * transfer[0] * transfer[1]
    return np.asarray(scipy.fft.irfft2(spectrum, cells.shape))


def _aperture_weights(width: float) -> Array:
    """Weights of cells around a centre for the mean over sub-pixels spread over `width` cells."""
    half = int(np.ceil(0.5 * width)) + 2
    weights = np.zeros(2 * half + 1)
    for place in width * ((np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5):
        first = int(np.floor(place))
        weights[half + first - 1 : half + first + 3] += np.array(_cubic(place - first)) / SUBPIXELS
    return weights


@njit(cache=True, nogil=True, inline="always")
def _cubic(t):  # type: ignore[no-untyped-def]
    """Weights of four neighbours for a value `t` cells after the second (Keys 1981)."""
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@dataclass(frozen=True, eq=False)
class StripSettings:
    """How a strip is imaged.

    Attributes
    ----------
    stages, ratio : (C,) or (lines, C)
        Number of stages; integration ratio beyond the head.
    velocity, slip : (C,)
        Pixels per line period along the column; rad.
    motion : (M, 2) or None
        Pixels across and along beyond the drift at line periods 0, 1, ...; linear between.
    """

    stages: Index
    ratio: Array
    velocity: Array
    slip: Array
    motion: Array | None = None

    def each(self, shape: tuple[int, int]) -> tuple[Index, Array]:
        """Stages and ratio of every pixel, both of `shape` (lines, columns)."""
        if np.shape(self.velocity) != (shape[1],) or np.shape(self.slip) != (shape[1],):
            raise InputError(
                f"the scene has {shape[1]} columns, `velocity` {np.shape(self.velocity)} values and `slip` "
                f"{np.shape(self.slip)}"
            )
        try:
            return (
                np.ascontiguousarray(np.broadcast_to(np.asarray(self.stages, dtype=np.intp), shape)),
                np.ascontiguousarray(np.broadcast_to(np.asarray(self.ratio, dtype=np.float64), shape)),
            )
        except ValueError:
            raise InputError(
                f"`stages` and `ratio` have shapes {np.shape(self.stages)} and {np.shape(self.ratio)}; "
                f"{shape[1:]} or {shape} are needed"
            ) from None


@dataclass(frozen=True, eq=False)
class TdiStrip:
    """An image of a TDI detector.

    Attributes
    ----------
    electrons : (lines, columns)
        Sum of all stages.
    radiance : (lines, columns)
        Electrons less dark current over what a radiance of 1 gives: comparable between settings.
    saturated : (lines, columns) bool
        Where a well was full.
    """

    electrons: Array
    radiance: Array
    saturated: NDArray[np.bool_]


def exposed_stages(scene: FineScene, settings: StripSettings, detector: TdiDetector) -> Array:
    """Radiance times integration time that every stage collects, without noise.

    Parameters
    ----------
    scene : FineScene
        As the pixels see it (`FineScene.blurred`).
    settings : StripSettings
    detector : TdiDetector

    Returns
    -------
    (lines, columns, stages of the most)
        Zero beyond a pixel's own stages.

    Raises
    ------
    InputError
        Shapes that differ, a scene whose margin is narrower than the drift, a motion that ends too soon.
    """
    stages, ratio = settings.each(scene.shape)
    most, lines = int(stages.max()), scene.shape[0]
    motion = np.zeros((lines + most + 2, 2)) if settings.motion is None else np.asarray(settings.motion)
    if len(motion) < lines + most + 1:
        raise InputError(
            f"the motion covers {len(motion)} line periods; {lines} lines of {most} stages need "
            f"{lines + most + 1}"
        )
    across = settings.velocity * np.tan(settings.slip)
    reach = most * np.max(np.abs([across, settings.velocity - 1.0])) + np.max(np.abs(motion)) + 2.0
    if not reach <= scene.margin:
        raise InputError(f"the image moves by up to {reach:.3g} px; the scene's margin is {scene.margin} px")
    exposure = detector.exposure
    out = np.zeros((*scene.shape, most))
    drift = np.stack([across, settings.velocity], axis=1)
    head = (exposure.head_stages, float(exposure.head_ratio), SHUTTER[exposure.align])
    # cells that an exposure can spread over, two line periods of motion and the interpolation included
    spread = np.max(np.abs(drift)) + 2.0 * np.max(np.abs(np.diff(motion, axis=0)), initial=0.0)
    stencil = np.zeros((int(np.ceil(spread * scene.per_pixel)) + 6,) * 2)
    moving = settings.motion is not None
    grid = (scene.per_pixel, scene.margin)
    _expose(scene.radiance, grid, *only_read(stages, ratio), head, drift, motion, moving, stencil, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _expose(scene, grid, stages, ratio, head, drift, motion, moving, stencil, out):  # type: ignore[no-untyped-def]
    """Sums of `exposed_stages`: weights of cells for an exposure, laid over the scene at every line."""
    for column in range(out.shape[1]):
        for k in range(out.shape[2]):
            length, top, left, rows, columns = -1.0, 0, 0, 0, 0
            for line in range(out.shape[0]):
                if k >= stages[line, column]:
                    continue
                wanted = head[1] if k < head[0] else ratio[line, column]
                if moving or wanted != length:
                    length = wanted
                    top, left, rows, columns = _lay_stencil(
                        stencil, grid[0], line, k, length, head[2], drift[column], motion
                    )
                y = (line + grid[1]) * grid[0] + top
                x = (column + grid[1]) * grid[0] + left
                total = 0.0
                for r in range(rows):
                    for c in range(columns):
                        total += stencil[r, c] * scene[y + r, x + c]
                out[line, column, k] = length * total


@njit(cache=True, nogil=True)
def _lay_stencil(stencil, per_pixel, line, k, length, shutter, drift, motion):  # type: ignore[no-untyped-def]
    """Weights of cells around a pixel for the mean over the instants of one exposure, and where they lie.

    Every instant sees the scene interpolated at its own place; the first cell is given from the pixel's own.
    """
    place = np.empty((INSTANTS, 2))
    for i in range(INSTANTS):
        u = length * ((i + 0.5) / INSTANTS - 0.5 + shutter)
        # before the centre of line 0 the motion is as at it
        t = max(line + k + u, 0.0)
        before = int(t)
        part = t - before
        dx = (1.0 - part) * motion[before, 0] + part * motion[before + 1, 0]
        dy = (1.0 - part) * motion[before, 1] + part * motion[before + 1, 1]
        place[i, 0] = ((drift[1] - 1.0) * k + drift[1] * u + dy + 0.5) * per_pixel - 0.5
        place[i, 1] = (0.5 - drift[0] * (k + u) - dx) * per_pixel - 0.5
    top = int(np.floor(place[:, 0].min())) - 1
    left = int(np.floor(place[:, 1].min())) - 1
    rows = int(np.floor(place[:, 0].max())) + 3 - top
    columns = int(np.floor(place[:, 1].max())) + 3 - left
    stencil[:rows, :columns] = 0.0
    for i in range(INSTANTS):
        r, c = int(np.floor(place[i, 0])), int(np.floor(place[i, 1]))
        wy, wx = _cubic(place[i, 0] - r), _cubic(place[i, 1] - c)
        for m in range(4):
            for n in range(4):
                stencil[r - 1 - top + m, c - 1 - left + n] += wy[m] * wx[n] / INSTANTS
    return top, left, rows, columns


def read_strip(
    exposed: Array,
    settings: StripSettings,
    detector: TdiDetector,
    signal: float,
    rng: np.random.Generator | None = None,
) -> TdiStrip:
    """Electrons of a strip: every stage draws its noise and fills its well, and so does their sum.

    Parameters
    ----------
    exposed : (lines, columns, stages)
        From :func:`exposed_stages`.
    settings : StripSettings
    detector : TdiDetector
    signal : float
        Electrons of one line that a radiance of 1 gives at the integration ratio `detector.signal_ratio`.
    rng : numpy.random.Generator, optional
        Without one, no noise.
    """
    law, exposure = detector.noise, detector.exposure
    stages, ratio = settings.each((exposed.shape[0], exposed.shape[1]))
    per_radiance = signal / detector.signal_ratio
    k = np.arange(exposed.shape[2])
    lengths = np.where(k < exposure.head_stages, exposure.head_ratio, ratio[..., None])
    lengths = np.where(k < stages[..., None], lengths, 0.0)
    lines = per_radiance * exposed
    if rng is not None:
        lines *= 1.0 + np.sqrt(law.gain) * rng.standard_normal(lines.shape)
        lines = _shot(np.maximum(lines, 0.0), law.shot, rng)
    if law.dark:
        lines += law.dark * lengths if rng is None else rng.poisson(law.dark * lengths)
    full = (lines > detector.full_well_line).any(axis=-1)
    lines = np.minimum(lines, detector.full_well_line)
    if rng is not None:
        lines += law.read * rng.standard_normal(lines.shape) * (lengths > 0.0)
    total = lines.sum(axis=-1)
    if rng is not None:
        pattern = 1.0 + np.sqrt(law.column_fixed) * rng.standard_normal(total.shape[1])
        total = total * pattern + law.output * rng.standard_normal(total.shape)
    full |= total > detector.full_well_sum
    total = np.minimum(total, detector.full_well_sum)
    exposed_for = lengths.sum(axis=-1)
    return TdiStrip(total, (total - law.dark * exposed_for) / (per_radiance * exposed_for), full)


def _shot(electrons: Array, variance: float, rng: np.random.Generator) -> Array:
    """Electrons with shot noise of `variance` per electron."""
    if variance == 0.0:
        return electrons
    return np.asarray(variance * rng.poisson(electrons / variance).astype(np.float64))


def one_setting(
    columns: int, stages: int, ratio: float, velocity: ArrayLike, slip: ArrayLike
) -> StripSettings:
    """Settings of a strip whose columns share stages and ratio; velocity and slip are broadcast."""
    velocity, slip = (
        np.ascontiguousarray(np.broadcast_to(np.asarray(v, dtype=np.float64), columns))
        for v in (velocity, slip)
    )
    return StripSettings(np.full(columns, stages), np.full(columns, float(ratio)), velocity, slip)
