"""A band laid on the grid of another by the cameras of both: read window by window, masks kept.

Pixels that cannot be used (masked, no data, beyond the image) are made up from their neighbours before the
kernel runs; where they weigh too much (`MASK_SHARE`) the result has no value.

Not here: the kernel (``resample.py``), how often the map is evaluated (``image_map.py``), how well bands fit
(``band_fit.py``), files (``io/results/registered.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.execution import in_threads, thread_count
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.imaging.reduce import Mapping
from sightline.imaging.source import ImageSource
from sightline.products.image_map import sample_map
from sightline.products.resample import BEFORE, TAPS, product_kernel, resample_rows

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

#: Magnitude of weights on pixels that cannot be used from which a result has no value. All weights sum to 1;
#: what is made up for such pixels is off by the local contrast, so the error is below 2 % of that.
MASK_SHARE = 0.02
#: Lines beyond the ends of an image at which its map is still followed, so that the kernel may begin there.
_MARGIN_LINES = 16.0
#: px about a place that the kernel may read, rounding of its stretches included.
_REACH = 10
#: Reach (px) of the mean that stands in for a pixel that cannot be used.
_FILL = 8
#: Pixels of a block of lines that one thread resamples at a time.
BLOCK_PIXELS = 2_000_000


#: Heights (N,) m above the surface at places (N, 3) of it; NaN where nothing is known.
RaisedGround = Callable[[Array], Array]


def band_map(
    reference: PushbroomCamera, camera: PushbroomCamera, surface: Surface, raised: RaisedGround | None = None
) -> Mapping:
    """Where pixels of one image lie in another.

    Parameters
    ----------
    reference, camera : PushbroomCamera
        Of the grid, and of the image to be laid on it.
    surface : Surface
        What both see.
    raised : callable, optional
        Ground above it that was found; where nothing is known of it, it is the surface.

    Returns
    -------
    callable
        ``mapping(lines, columns)``, (n,) and (M,) px of the grid, gives (n, M, 2) px in the image, (line,
        column); NaN where the motion is not known, the surface not met, or the place beyond the image.
    """
    low, high = reference.known_lines

    def mapping(lines: Array, columns: Array) -> Array:
        out = np.full((len(lines), len(columns), 2), np.nan)
        known = np.flatnonzero((lines >= low) & (lines <= high))
        pixels = np.stack(np.meshgrid(lines[known], columns, indexing="ij"), axis=-1).reshape(-1, 2)
        ground = reference.locate(pixels, surface)
        if raised is not None:
            # along each ray, which a height of some hundred metres does not bend
            height = np.nan_to_num(raised(ground))
            ground = ground + height[:, None] * (reference.locate(pixels, surface.raised(1.0)) - ground)
        places = camera.project(ground, line_margin=_MARGIN_LINES)
        out[known] = places.reshape(-1, len(columns), 2)
        return out

    return mapping


@dataclass(frozen=True, eq=False)
class RegisteredImage:
    """An image seen on the grid of another, resampled with the 16-tap kernel.

    Attributes
    ----------
    source : ImageSource
        The image to resample.
    mapping : callable
        As `band_map` gives it: smooth along the lines of the grid, whatever from line to line.
    shape : (lines, columns)
        Of the grid.
    """

    source: ImageSource
    mapping: Mapping
    shape: tuple[int, int]

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> Pixels:
        """Resampled pixels, float32; NaN where there is no value.

        Parameters
        ----------
        lines, columns : (int, int)
            First and one past the last line (column) of the grid.
        """
        out = np.full((lines[1] - lines[0], columns[1] - columns[0]), np.nan, dtype=np.float32)
        sampled = sample_map(self.mapping, lines, columns)
        position, nodes = sampled.position, sampled.nodes
        seen: NDArray[np.bool_] = np.isfinite(position[..., 0]) & np.isfinite(position[..., 1])
        rows = np.flatnonzero(seen.any(axis=1))
        if not len(rows):
            return out
        position, seen, nodes = _completed(position[rows], seen[rows], nodes), seen[rows], nodes - columns[0]
        piece, bad, corner = self._piece(position)
        if piece is None:
            return out
        position = position - corner
        values = np.empty((len(position), out.shape[1]), np.float32)
        resample_rows(piece, position, nodes, values)
        _blank_unseen(values, seen, nodes)
        if bad is not None:
            _blank_masked(values, bad, position, nodes)
        out[rows] = values
        return out

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """None: pixels without a value are NaN in `read`."""
        return None

    def _piece(self, position: Array) -> tuple[Pixels | None, NDArray[np.bool_] | None, Array]:
        """What the kernel reads about `position`, flags of what cannot be used, and the corner of both.

        Beyond the image its edge is repeated and flagged. None where it is not met at all.
        """
        low = np.floor(position.min(axis=(0, 1))).astype(int) - _REACH
        high = np.floor(position.max(axis=(0, 1))).astype(int) + _REACH + 1
        first = np.maximum(low, 0)
        last = np.minimum(high, self.source.shape)
        if np.any(first >= last):
            return None, None, low.astype(float)
        inside = (int(first[0]), int(last[0])), (int(first[1]), int(last[1]))
        pixels, bad = self.source.read(*inside), self.source.mask(*inside)
        unusable = ~np.isfinite(pixels) if bad is None else bad | ~np.isfinite(pixels)
        if unusable.any():
            pixels = _made_up(pixels, unusable)
        pads = [(int(first[k] - low[k]), int(high[k] - last[k])) for k in (0, 1)]
        if any(pad for both in pads for pad in both):
            pixels = np.pad(pixels, pads, mode="edge")
            unusable = np.pad(unusable, pads, constant_values=True)
        return np.ascontiguousarray(pixels), unusable if unusable.any() else None, low.astype(float)


def _completed(position: Array, seen: NDArray[np.bool_], nodes: NDArray[np.int64]) -> Array:
    """Places that are not known take the line and the shift of the nearest known place in their row."""
    if seen.all():
        return position
    order = np.arange(len(nodes))
    before = np.maximum.accumulate(np.where(seen, order, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, order, len(nodes))[:, ::-1], axis=1)[:, ::-1]
    from_before = (before >= 0) & ((after == len(nodes)) | (order - before <= after - order))
    nearest = np.where(from_before, before, np.minimum(after, len(nodes) - 1))
    out = np.take_along_axis(position, nearest[:, :, None], axis=1)
    out[:, :, 1] += nodes - nodes[nearest]
    return out


def _made_up(pixels: Pixels, unusable: NDArray[np.bool_]) -> Pixels:
    """Pixels that cannot be used replaced by the mean of the usable ones around, or of the whole piece."""
    from scipy.ndimage import uniform_filter

    usable = ~unusable
    if not usable.any():
        return np.zeros_like(pixels)
    mean = np.float32(pixels[usable].mean())
    size = 2 * _FILL + 1
    share = uniform_filter(usable.astype(np.float32), size, mode="constant")
    about = uniform_filter(np.where(usable, pixels - mean, np.float32(0.0)), size, mode="constant")
    local = mean + np.where(share > 1e-3, about / np.maximum(share, np.float32(1e-3)), np.float32(0.0))
    return np.where(usable, pixels, local).astype(np.float32)


def _blank_unseen(values: Pixels, seen: NDArray[np.bool_], nodes: NDArray[np.int64]) -> None:
    """No value between two nodes of which one has no place."""
    whole = seen[:, 1:] & seen[:, :-1]
    if not whole.all():
        values[~np.repeat(whole, np.diff(nodes), axis=1)] = np.nan


def _blank_masked(values: Pixels, bad: NDArray[np.bool_], position: Array, nodes: NDArray[np.int64]) -> None:
    """No value where the kernel weighs pixels that cannot be used by more than `MASK_SHARE`."""
    met = np.concatenate([[0], np.cumsum(bad.any(axis=0))])
    left = np.floor(np.minimum(position[:, :-1, 1], position[:, 1:, 1]).min(axis=0)).astype(int) - BEFORE
    right = np.floor(np.maximum(position[:, :-1, 1], position[:, 1:, 1]).max(axis=0)).astype(int) + TAPS
    left, right = np.clip(left, 0, bad.shape[1]), np.clip(right, 0, bad.shape[1])
    touched = met[right] > met[left]
    flags = bad.astype(np.float32)
    for m in np.flatnonzero(touched):
        share = np.empty((len(values), nodes[m + 1] - nodes[m]), np.float32)
        resample_rows(
            flags,
            position[:, m : m + 2],
            nodes[m : m + 2] - nodes[m],
            share,
            table=product_kernel(absolute=True),
        )
        values[:, nodes[m] : nodes[m + 1]][share > MASK_SHARE] = np.nan


def values_of_lines(source: ImageSource, first: int, last: int) -> Pixels:
    """Lines [first, last) of an image, NaN where it has no value."""
    window = (first, last), (0, source.shape[1])
    pixels, bad = source.read(*window), source.mask(*window)
    return pixels if bad is None else np.where(bad, np.float32(np.nan), pixels)


def line_blocks(
    sources: Sequence[ImageSource], *, begin: int = 0, threads: int | None = None
) -> Iterator[tuple[int, list[Pixels]]]:
    """Images of one size from top to bottom in blocks of lines, read on threads.

    Parameters
    ----------
    sources : sequence of ImageSource
        All of one shape.
    begin : int
        First line that is wanted, the first of a block.
    threads : int, optional
        As in ``execution.in_threads``; so many blocks are held at a time.

    Yields
    ------
    first : int
        First line of the block.
    pixels : list of (lines, columns) float32
        One per image; NaN where there is no value.
    """
    lines, columns = sources[0].shape
    height = max(1, BLOCK_PIXELS // columns)
    together = max(1, (threads or thread_count()) // len(sources))

    def work(job: tuple[int, ImageSource]) -> Pixels:
        first, source = job
        return values_of_lines(source, first, min(first + height, lines))

    starts = range(begin, lines, height)
    for k in range(0, len(starts), together):
        group = starts[k : k + together]
        done = in_threads(work, [(first, source) for first in group for source in sources], threads)
        for place, first in enumerate(group):
            yield first, done[place * len(sources) : (place + 1) * len(sources)]
