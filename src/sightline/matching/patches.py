"""Cut images into blocks around groups of windows, filter them, warp where the local affine is large.

Keeps memory bounded whatever the size of the images. Not the comparison of windows: see `correlate`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import only_read
from sightline.imaging.resample import kernel_table
from sightline.imaging.source import ImageSource, read_padded
from sightline.matching import kernels

__all__ = ["Block", "column_parts", "cut_blocks", "group_windows", "warp_block"]

_EMPTY = np.zeros((0, 0), np.bool_)
_FILL = 15
_GROW = 4
_LEAST_PIXELS = 40_000
"""Pieces of a group that hold fewer pixels than this cost more in calls than the pixels between them."""
_MARGIN = kernels.RADIUS + kernels.HALO + 8
"""What the filter, the derivative and the interpolation reach beyond a window, px."""


@dataclass(frozen=True, eq=False)
class Block:
    """Filtered pieces of both images that hold a group of windows.

    Parameters
    ----------
    rows : (n,)
        Which windows of the call.
    fa, fb : (lines, columns) float32
    bad_a, bad_b : (lines, columns) bool
        Unusable pixels; size 0 when there are none.
    corner : (n, 2) int64
        First line and column of each window in `fa`.
    centre : (n, 2)
        Predicted place of the window's centre in `fb`.
    linear : (n, 2, 2)
        Local affine less the identity, as still to be applied.
    turn : (n, 2, 2)
        Takes a shift on the grid of `fb` to pixels of image b.
    given_a, given_b : (lines, columns) bool
        Unusable pixels as the images say, before they were grown by what the filter spreads.
    full_a, full_b : (lines, columns) bool
        Saturated pixels.
    """

    rows: NDArray[np.intp]
    fa: NDArray[np.float32]
    fb: NDArray[np.float32]
    bad_a: NDArray[np.bool_]
    bad_b: NDArray[np.bool_]
    corner: NDArray[np.int64]
    centre: NDArray[np.float64]
    linear: NDArray[np.float64]
    turn: NDArray[np.float64]
    given_a: NDArray[np.bool_]
    given_b: NDArray[np.bool_]
    full_a: NDArray[np.bool_]
    full_b: NDArray[np.bool_]


def column_parts(linear: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.int64]:
    """Column parts of constant shift that keep the departure from the affine below 0.02 px; 0 = too many.

    Parameters
    ----------
    linear : (N, 2, 2)
        Local affine less the identity.
    size : (int, int)
        Lines and columns of the window.

    Returns
    -------
    (N,) int64; 0 where lines too depart by more than 0.05 px, or parts would be under 8 columns: the window
    has to be warped pixel by pixel.
    """
    h, w = size
    across = np.abs(linear[:, :, 1]).max(axis=1) * (w + 2 * kernels.HALO)
    parts = np.maximum(np.ceil(across / 0.04), 1).astype(np.int64)
    along = np.abs(linear[:, :, 0]).max(axis=1) * h
    return np.where((along > 0.1) | (parts > (w + 2 * kernels.HALO) // 8), 0, parts)


def group_windows(
    points_a: NDArray[np.float64],
    points_b: NDArray[np.float64],
    rows: NDArray[np.intp],
    size: tuple[int, int],
    most_pixels: int,
) -> Iterator[NDArray[np.intp]]:
    """Groups of windows whose boxes in both images stay small.

    Parameters
    ----------
    points_a, points_b : (N, 2)
        Centres of all windows in both images.
    rows : (n,)
        Which of them to group.
    size : (int, int)
        Lines and columns of a window.
    most_pixels : int
        Largest box, px; a single window may need more.

    Returns
    -------
    iterator of (k,) row numbers

    Notes
    -----
    A group is halved along the longer side of its box until the box is small enough and not mostly empty,
    then cut between rows and between columns of windows that stand far apart. The groups depend on the points
    only, never on the number of threads.
    """
    stack = [rows]
    window = (size[0] + 2 * _MARGIN) * (size[1] + 2 * _MARGIN)
    while stack:
        group = stack.pop()
        spans = [np.ptp(p[group], axis=0) + np.array(size) + 2 * _MARGIN for p in (points_a, points_b)]
        area = max(float(s.prod()) for s in spans)
        full = area <= most_pixels and area <= 12.0 * window * len(group)
        if len(group) == 1 or (full and len(group) <= 8192):
            yield from _apart(points_a, group, size)
            continue
        axis = int(np.argmax(spans[0]))
        order = np.argsort(points_a[group, axis], kind="stable")
        half = len(group) // 2
        stack += [group[order[half:]], group[order[:half]]]


def _apart(
    points: NDArray[np.float64], group: NDArray[np.intp], size: tuple[int, int]
) -> list[NDArray[np.intp]]:
    """A group cut where no window needs the lines or the columns between, unless the pieces are too small."""
    pieces = [group]
    for axis in (0, 1):
        pieces = [some for piece in pieces for some in _cut(points, piece, size, axis)]
    return pieces


def _cut(
    points: NDArray[np.float64], group: NDArray[np.intp], size: tuple[int, int], axis: int
) -> list[NDArray[np.intp]]:
    """The same along one axis."""
    along = points[group, axis]
    order = np.argsort(along, kind="stable")
    gaps = np.flatnonzero(np.diff(along[order]) > size[axis] + 2 * _MARGIN) + 1
    if not len(gaps):
        return [group]
    pieces = np.split(group[order], gaps)
    reach = [float(np.ptp(points[piece, axis])) + size[axis] + 2 * _MARGIN for piece in pieces]
    beside = float(np.ptp(points[group, 1 - axis])) + size[1 - axis] + 2 * _MARGIN
    if beside * sum(reach) < _LEAST_PIXELS * len(pieces):
        return [group]
    return [np.sort(piece) for piece in pieces]


def _filtered(pixels: NDArray[np.float32], taps: NDArray[np.float32] | None) -> NDArray[np.float32]:
    level = pixels - np.float32(pixels.mean())
    if taps is None:
        return level
    out = np.empty_like(level)
    kernels.filter_image(level, *only_read(taps), out)
    return out


def _without_unusable(
    pixels: NDArray[np.float32], unusable: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Unusable pixels replaced by the mean of the usable around them, and the flags grown by what they touch.

    The fill keeps the filter from ringing at the border of a cloud; the flags grow by the derivative and the
    inner half of the filter.
    """
    from scipy import ndimage

    filled, grown = pixels.copy(), np.zeros(unusable.shape, dtype=np.bool_)
    mean = np.float32(pixels[~unusable].mean() if not unusable.all() else 0.0)
    reach = _FILL // 2 + 1
    columns = np.flatnonzero(unusable.any(axis=0))
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 2 * reach) + 1):
        # lines and columns near none are left as they are
        across = _around(run, reach)
        part = _around(np.flatnonzero(unusable[:, across].any(axis=1)), reach), across
        bad = unusable[part]
        good = (~bad).astype(np.float32)
        share = ndimage.uniform_filter(good, _FILL, mode="nearest")
        around = ndimage.uniform_filter((pixels[part] - mean) * good, _FILL, mode="nearest")
        fill = mean + np.where(share > 1e-3, around / np.maximum(share, 1e-3), 0.0)
        filled[part] = np.where(bad, fill, pixels[part])
        grown[part] = ndimage.maximum_filter(bad, 2 * _GROW + 1, mode="nearest")
    return filled, grown


def _around(places: NDArray[np.intp], reach: int) -> slice:
    """From the first of ascending places to the last, and as far beyond as `reach`."""
    return slice(max(int(places[0]) - reach, 0), int(places[-1]) + reach + 1)


def _read(
    image: ImageSource,
    box: NDArray[np.int64],
    saturation: float | None,
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Usable pixels of a box; flags grown, flags as given, saturated pixels (size 0 where there are none)."""
    lines, columns = ((int(low), int(high)) for low, high in box)
    pixels, unusable = read_padded(image, lines, columns)
    full = _EMPTY
    if saturation is not None and (pixels >= saturation).any():
        full = pixels >= saturation
        unusable = full if unusable is None else unusable | full
    if unusable is None:
        return pixels, _EMPTY, _EMPTY, full
    pixels, grown = _without_unusable(pixels, unusable)
    return pixels, grown, np.ascontiguousarray(unusable), full


def _box(points: NDArray[np.float64], size: tuple[int, int], margin: NDArray[np.int64]) -> NDArray[np.int64]:
    """First and last + 1 of lines and columns that hold windows at points, with a margin."""
    half = 0.5 * (np.array(size) - 1)
    low = np.floor(points.min(axis=0) - half).astype(np.int64) - margin
    high = np.ceil(points.max(axis=0) + half).astype(np.int64) + 1 + margin
    return np.stack([low, high], axis=1)


def cut_blocks(
    image_a: ImageSource,
    image_b: ImageSource,
    centre_a: NDArray[np.float64],
    centre_b: NDArray[np.float64],
    linear: NDArray[np.float64],
    rows: NDArray[np.intp],
    size: tuple[int, int],
    reach: tuple[int, int],
    taps: tuple[NDArray[np.float32] | None, NDArray[np.float32] | None],
    saturation: float | None = None,
) -> Block:
    """Read and filter what a group of windows needs.

    Parameters
    ----------
    image_a, image_b : ImageSource
    centre_a, centre_b : (N, 2)
        Window centres: in a exactly on the pixel grid (half pixels for even sizes), in b as predicted.
    linear : (N, 2, 2)
        Local affine less the identity.
    rows : (n,)
        The group.
    size, reach : (int, int)
        Window, and how far a shift may go, px.
    taps : pair of (7, 7) or None
        Whitening filters of image a and of image b.
    saturation : float, optional
        Pixel value from which on a pixel is saturated.
    """
    margin = np.full(2, _MARGIN, np.int64)
    box_a = _box(centre_a[rows], size, margin)
    box_b = _box(centre_b[rows], size, margin + np.array(reach))
    raw_a, bad_a, given_a, full_a = _read(image_a, box_a, saturation)
    raw_b, bad_b, given_b, full_b = _read(image_b, box_b, saturation)
    corner = np.rint(centre_a[rows] - 0.5 * (np.array(size) - 1)).astype(np.int64) - box_a[:, 0]
    return Block(
        rows=rows,
        fa=_filtered(raw_a, taps[0]),
        fb=_filtered(raw_b, taps[1]),
        bad_a=bad_a,
        bad_b=bad_b,
        corner=corner,
        centre=centre_b[rows] - box_b[:, 0],
        linear=np.ascontiguousarray(linear[rows]),
        turn=np.broadcast_to(np.eye(2), (len(rows), 2, 2)),
        given_a=given_a,
        given_b=given_b,
        full_a=full_a,
        full_b=full_b,
    )


def warp_block(
    block: Block, size: tuple[int, int], reach: tuple[int, int], taps: NDArray[np.float32] | None
) -> Block:
    """The same windows with image b laid pixel by pixel on the grid of image a, one patch under the other.

    For affines far from the identity: the filter then sees both images at one scale and orientation.

    Parameters
    ----------
    block : Block
        Cut without whitening of image b.
    size, reach : (int, int)
        Window, and how far a shift may go, px.
    taps : (7, 7), optional
        Whitening filter of image b.
    """
    patch = np.array(size) + 2 * (_MARGIN + np.array(reach))
    shape = (int(patch[0]), int(patch[1]))
    n = len(block.rows)
    tall = np.zeros((n * shape[0], shape[1]), np.float32)
    outside = np.zeros(tall.shape, np.bool_)
    kernels.warp_windows(block.fb, block.centre, block.linear, shape, kernel_table(), tall, outside)

    def warped(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
        if not flags.size:
            return _EMPTY
        spots = np.zeros(tall.shape, np.float32)
        kernels.warp_windows(
            flags.astype(np.float32), block.centre, block.linear, shape, kernel_table(), spots, outside
        )
        return spots > 0.25

    bad, given, full = warped(block.bad_b), warped(block.given_b), warped(block.full_b)
    if outside.any():
        bad = outside | bad if bad.size else outside
    centre = np.empty((n, 2))
    centre[:, 0] = np.arange(n) * shape[0] + 0.5 * (shape[0] - 1)
    centre[:, 1] = 0.5 * (shape[1] - 1)
    return replace(
        block,
        fb=_filtered(tall, taps),
        bad_b=bad,
        given_b=given,
        full_b=full,
        centre=centre,
        linear=np.zeros_like(block.linear),
        turn=np.eye(2) + block.linear,
    )
