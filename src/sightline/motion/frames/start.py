"""Where frames start from: the shift between neighbours, found blind on down-sampled frames.

Time stamps to the second, an unknown focal length and an unknown mount can put the first
prediction hundreds of pixels away. One correlation of whole frames per pair finds the shift;
what stands still in the detector (a window's edge, dust) is taken out first.

Not here: sub-pixel matches (``matches.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError
from sightline.estimation.robust import robust_sigma
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource, read_padded

Array = NDArray[np.float64]

#: Frames needed to find what stands still, and the least shift of neighbours (px) at which ground does not.
STILL_FRAMES, STILL_SHIFT_PX = 5, 20.0
#: Mean over all frames, in standard errors, that makes a pixel stand still: its core, and around it.
STILL_CORE, STILL_EDGE = 10.0, 5.0
#: Down-sampled frames have at most so many pixels along their larger side.
COARSE_SIDE = 384
#: The same for finding what stands still.
STILL_SIDE = 648
#: Least share of a frame that two neighbours must have in common for a shift to be looked for.
MIN_OVERLAP = 0.15
#: A peak must stand so many standard deviations above the correlation of unrelated frames.
MIN_PEAK = 7.0
#: Displacements whose direction differs by more (rad) from the predicted one mean another mount.
MAX_TURN = 0.5


@dataclass(frozen=True, eq=False)
class CoarseShift:
    """Shift between two frames: ``partner pixel = hub pixel + shift_px`` in their middle.

    Attributes
    ----------
    hub, partner : int
    shift_px : (2,)
        (lines, columns), px.
    sigma_px : float
        px; the coarse pixel.
    peak : float
        Height of the correlation peak in standard deviations.
    """

    hub: int
    partner: int
    shift_px: Array
    sigma_px: float
    peak: float

    def points(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        """Two conjugate points, (2,) px each, as near to the middle of both frames as they can be."""
        middle = (np.array(shape) - 1) / 2.0
        return middle - self.shift_px / 2.0, middle + self.shift_px / 2.0


def standing_still(images: Sequence[ImageSource]) -> NDArray[np.bool_] | None:
    """Pixels that show the same in all frames although the ground moves: dust, the edge of a window.

    Returns
    -------
    (lines, columns) bool or None
        True where a pixel must not be used; None when too few frames are given.
    """
    from scipy.ndimage import binary_propagation, maximum_filter, uniform_filter

    if len(images) < STILL_FRAMES:
        return None
    shape = images[0].shape
    factor = max(1, round(max(shape) / STILL_SIDE))
    total = square = np.zeros(1)
    for image in images:
        pixels, _ = read_padded(image, (0, shape[0]), (0, shape[1]))
        flat = _evened(uniform_filter(_block_means(pixels, factor), 3), 27)
        total, square = total + flat, square + flat**2
    n = len(images)
    mean = total / n
    error = np.sqrt(np.maximum(square / n - mean**2, 0.0) / (n - 1))
    # where all frames are smooth, chance alone may make the scatter small
    significance = np.abs(mean) / np.maximum(error, 0.5 * float(np.median(error)))
    still = binary_propagation(significance > STILL_CORE, mask=significance > STILL_EDGE)
    if not still.any():
        return None
    near = maximum_filter(still, size=5)
    full = np.zeros(shape, dtype=bool)
    big = np.repeat(np.repeat(near, factor, axis=0), factor, axis=1)
    full[: big.shape[0], : big.shape[1]] = big
    return full


def _evened(image: Array, size: int) -> Array:
    """Local mean taken out, local contrast about 1, clipped at 3."""
    from scipy.ndimage import uniform_filter

    flat = image - uniform_filter(image, size)
    contrast = np.sqrt(uniform_filter(flat**2, size))
    floor = 0.2 * float(np.median(contrast)) + 1e-6
    return np.asarray(np.clip(flat / np.maximum(contrast, floor), -3.0, 3.0))


def coarse_frames(images: Sequence[ImageSource]) -> tuple[Array, int]:
    """Frames block-averaged, their local contrast evened out, what stands still removed.

    Returns
    -------
    frames : (n, lines, columns)
        Of local mean 0 and contrast about 1; 0 where pixels are unusable.
    factor : int
        Pixels per coarse pixel.
    """
    factor = max(1, math.ceil(max(images[0].shape) / COARSE_SIDE))
    out = []
    for image in images:
        pixels, unusable = read_padded(image, (0, image.shape[0]), (0, image.shape[1]))
        small = _block_means(pixels, factor)
        flat = _evened(small, max(5, max(small.shape) // 24))
        if unusable is not None:
            flat = np.where(_block_means(unusable.astype(np.float32), factor) > 0.0, 0.0, flat)
        out.append(flat)
    frames = np.stack(out)
    if len(frames) >= 4:
        frames = frames - np.median(frames, axis=0)
    return np.asarray(frames, dtype=np.float64), factor


def _block_means(pixels: NDArray[np.float32], factor: int) -> Array:
    """Means over blocks of factor x factor pixels; what is left at the end is dropped."""
    lines, columns = (size // factor for size in pixels.shape)
    blocks = pixels[: lines * factor, : columns * factor].reshape(lines, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float64)


def coarse_shift(frames: Array, hub: int, partner: int, factor: int) -> CoarseShift:
    """Shift between two of the frames of `coarse_frames`, to a coarse pixel."""
    from scipy import fft

    a, b = frames[hub], frames[partner]
    lines, columns = a.shape
    shape = (fft.next_fast_len(2 * lines, True), fft.next_fast_len(2 * columns, True))
    cross = fft.irfft2(fft.rfft2(a, s=shape).conj() * fft.rfft2(b, s=shape), s=shape)
    dl, dc = fft.fftfreq(shape[0], 1.0 / shape[0]), fft.fftfreq(shape[1], 1.0 / shape[1])
    common = np.outer(np.maximum(1 - np.abs(dl) / lines, 0.0), np.maximum(1 - np.abs(dc) / columns, 0.0))
    significance = np.where(common >= MIN_OVERLAP, cross / np.sqrt(np.maximum(common, 1e-9)), 0.0)
    spread = robust_sigma(significance[common >= MIN_OVERLAP])
    row, column = np.unravel_index(int(significance.argmax()), shape)
    shift = factor * np.array([dl[row], dc[column]])
    peak = float(significance[row, column] / max(spread, 1e-12))
    return CoarseShift(hub, partner, shift, float(factor), peak)


def coarse_shifts(images: Sequence[ImageSource]) -> list[CoarseShift]:
    """Shifts between neighbouring frames; those without a clear peak are left out.

    Raises
    ------
    EstimationError
        No pair of neighbours has one.
    """
    frames, factor = coarse_frames(images)
    found = [coarse_shift(frames, k, k + 1, factor) for k in range(len(images) - 1)]
    clear = [shift for shift in found if shift.peak >= MIN_PEAK]
    if not clear:
        raise EstimationError(
            f"no two neighbouring frames show the same ground: the best correlation of {len(found)} pairs "
            f"stands {max(s.peak for s in found):.1f} standard deviations above chance, {MIN_PEAK:g} are "
            "needed; check the order of the frames and that neighbours overlap, or mask what stands still in "
            "them"
        )
    return clear


def turn_about_axis(
    shifts: Sequence[CoarseShift], cameras: Sequence[FrameCamera], surface: Surface
) -> tuple[float, float]:
    """How the measured displacements differ from the predicted ones.

    Returns
    -------
    turn : float
        rad; from the predicted direction to the measured one, in the plane of the frame from columns to
        lines.
    scale : float
        Measured over predicted length.
    """
    ratios = []
    for shift in shifts:
        hub, partner = cameras[shift.hub], cameras[shift.partner]
        # where the nominal cameras send the middle of the hub; beyond the frame it cannot be projected, so
        # the displacement is that of the ground near the middle, half of it on either side
        start, _ = shift.points(hub.shape)
        moved = _displacement(hub, partner, surface, np.clip(start, 0.0, np.array(hub.shape) - 1.0))
        ratios.append(complex(shift.shift_px[1], shift.shift_px[0]) / complex(moved[1], moved[0]))
    median = complex(float(np.median(np.real(ratios))), float(np.median(np.imag(ratios))))
    return math.atan2(median.imag, median.real), abs(median)


def _displacement(hub: FrameCamera, partner: FrameCamera, surface: Surface, pixel: Array) -> Array:
    """Displacement (2,) px that the cameras predict about a pixel, even where it leaves the frame."""
    ground = hub.locate(pixel[None, :], surface)
    if not np.isfinite(ground).all():
        ground = hub.locate((np.array(hub.shape)[None, :] - 1) / 2.0, surface)
        pixel = (np.array(hub.shape) - 1) / 2.0
    pose = partner.trajectory.at([partner.t])
    body = pose.world_from_body.inv().apply(ground - pose.position)
    directions = partner.pointing.to_camera(np.ascontiguousarray(body), np.array([partner.t]))
    seen = partner.detector.pixels(np.ascontiguousarray(directions))[0]
    if not np.isfinite(seen).all():
        raise EstimationError(
            "the cameras do not see the ground: the middle of a frame looks past the surface; check "
            "positions and mount"
        )
    return np.asarray(seen - pixel)


def turned_mount(mount: FixedMount, turn: float) -> FixedMount:
    """The mount with the camera turned about its optical axis so that displacements turn by `turn` (rad)."""
    return FixedMount(mount.body_from_camera * Rotation.from_rotvec([0.0, 0.0, -turn]))
