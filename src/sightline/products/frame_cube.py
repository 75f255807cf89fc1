"""Frames of a sequence → orthomosaics of every band: each pixel from the frame in which its band saw it best.

The map is made tile by tile. For a tile, first the geometry of all frames that show it says which frame shows
each place best in each band; then these frames are read one after the other, each only where it is needed,
and resampled once. Memory is that of a tile in all bands and a frame, however many frames there are.

Not here: the heights of the ground (``ground_model.py``), how well bands fit (``cube_fit.py``), files
(``io/results/cube_files.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.compiled import only_read
from sightline.errors import InputError, SightlineError
from sightline.execution import in_threads
from sightline.geometry.checks import ReadOnlyArrays
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ImageSource
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.products.cube_kernels import (
    cells_by_phase,
    choose_views,
    fill_bands,
    place_weights,
    see_places,
    sort_by_frame,
)
from sightline.products.resample import TAPS

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.bool_]
#: Heights (...) m of the ground at map places x, y (...).
Heights = Callable[[Array, Array], Array]

#: MiB that a tile may take in all bands, and its least and largest side (px).
_TILE_MIB, _TILE_SIDES = 48, (64, 512)
#: Bytes per pixel and group (cost, view, two flags, order) and per pixel and band (value).
_GROUP_BYTES, _BAND_BYTES = 14, 4
#: Magnitude of weights on pixels that cannot be used from which a result has no value.
_MASK_SHARE = 0.02
#: Places per side of a frame that show which part of the map it shows.
_OUTLINE = 5
#: Frames that show how bright each line is on the whole.
_GAIN_FRAMES = 96
#: Lines on each side of a place that the kernel may need, the border's included.
_REACH = TAPS + 1


@dataclass(frozen=True, eq=False)
class FrameViews(ReadOnlyArrays):
    """How M frames of one camera see the world.

    Attributes
    ----------
    detector : AreaDetector
    position : (M, K, 3)
        m, world axes; K = 1, or 3 for the first, middle and last line of a rolling shutter.
    camera_from_world : (M, K, 3, 3)
    stretch : (M,) int
        Frames of one flew on without a pause.
    penalty : (M,)
        What a view costs beyond its geometry (1: as the end of a band's lines); inf: not to be used.
    """

    detector: AreaDetector
    position: Array
    camera_from_world: Array
    stretch: NDArray[np.intp]
    penalty: Array

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.position)

    def of(self, frame: int) -> tuple[Array, Array, Array, Array, float]:
        """Matrices, positions, lens, distortion and reach, as the loops take them."""
        d = self.detector
        lens = np.array([d.focal_length_px, *d.principal_point_px])
        matrix, position, lens, coefficients = only_read(
            self.camera_from_world[frame], self.position[frame], lens, d.coefficients
        )
        return matrix, position, lens, coefficients, d.reach


@dataclass(frozen=True)
class MapTile:
    """Part of a map: first row and column, and how many."""

    row: int
    column: int
    rows: int
    columns: int


@dataclass(frozen=True, eq=False)
class FilledTile:
    """What was made of a tile.

    Attributes
    ----------
    tile : MapTile
    values : (B, rows, columns) float32
        NaN where there is none.
    view : (groups, rows, columns) int32
        Frame of each value; -1: none.
    passed : (groups, rows, columns) bool
        Passed over by lines of the band, in a frame or between two of one stretch.
    beyond : (groups, rows, columns) bool
        Seen by lines next to the band's own.
    """

    tile: MapTile
    values: Array32
    view: NDArray[np.int32]
    passed: Flags
    beyond: Flags


def tiles_of(grid: CubeGrid, layout: BandLayout) -> list[MapTile]:
    """Tiles of a map, row by row, of a size that all bands of one fit into `_TILE_MIB`."""
    each = _GROUP_BYTES * layout.groups + _BAND_BYTES * len(layout) + 32
    side = int(np.sqrt(_TILE_MIB * 2**20 / each)) // 64 * 64
    side = int(np.clip(side, *_TILE_SIDES))
    rows, columns = grid.shape
    return [
        MapTile(row, column, min(side, rows - row), min(side, columns - column))
        for row in range(0, rows, side)
        for column in range(0, columns, side)
    ]


def map_outlines(views: FrameViews, ground: Callable[[Array, Array], Array]) -> Array:
    """Map places (M, n, 2) around each frame; NaN where a line of sight misses the ground.

    Parameters
    ----------
    views : FrameViews
    ground : callable
        Map places (N, 2 or 3) that rays (N, 3), (N, 3) meet.
    """
    lines, columns = views.detector.shape
    down, right = np.linspace(-0.5, lines - 0.5, _OUTLINE), np.linspace(-0.5, columns - 0.5, _OUTLINE)
    at = np.stack(np.meshgrid(down, right, indexing="ij"), axis=-1).reshape(-1, 2)
    rays = views.detector.directions(at)
    out = np.full((len(views), len(at), 2), np.nan)
    for frame in range(len(views)):
        turned, origin = [], []
        for k in range(views.position.shape[1]):
            turned.append(rays @ views.camera_from_world[frame, k])
            origin.append(np.broadcast_to(views.position[frame, k], rays.shape))
        step = np.clip(np.rint((len(turned) - 1) * at[:, 0] / lines), 0, len(turned) - 1).astype(int)
        pick = np.arange(len(at))
        out[frame] = ground(np.stack(origin)[step, pick], np.stack(turned)[step, pick])[:, :2]
    return out


def covering_grid(places: Array, system: object, gsd: float) -> CubeGrid:
    """The map that holds all places (N, 2), its corner at whole pixels."""
    known = places[np.isfinite(places).all(axis=1)]
    if not len(known):
        raise InputError("no frame that can be used looks at the ground: there is nothing to map")
    west, south = np.floor(known.min(axis=0) / gsd) * gsd
    east, north = np.ceil(known.max(axis=0) / gsd) * gsd
    shape = max(int(round((north - south) / gsd)), 1), max(int(round((east - west) / gsd)), 1)
    return CubeGrid(system, float(west), float(north), gsd, shape)  # type: ignore[arg-type]


class CubeMaker:
    """Fills tiles of a map from frames.

    Parameters
    ----------
    grid : CubeGrid
    layout : BandLayout
    views : FrameViews
    outline : (M, n, 2)
        Map places around each frame, as `map_outlines` gives them, on low and on high ground.
    heights : callable
        Of the ground, by map places.
    channels : sequence of sequences of ImageSource
        Images of each channel, one per frame.
    gain : (channels, lines), optional
        Mean brightness of each line: lines are made alike by it before they are resampled, and the result has
        the brightness of the lines of its band, so that none of what lines differ by moves or ripples edges.
    """

    def __init__(
        self,
        grid: CubeGrid,
        layout: BandLayout,
        views: FrameViews,
        outline: Array,
        heights: Heights,
        channels: Sequence[Sequence[ImageSource]],
        gain: Array | None = None,
    ) -> None:
        """Sort bands by group and image."""
        self.grid, self.layout, self.views, self.heights = grid, layout, views, heights
        self._channels = channels
        self._penalty = views.penalty
        self._gain = None if gain is None else gain.astype(np.float32)
        self._level = self._levels(gain)
        self._table = place_weights()
        self._bands = [self._bands_of(channel) for channel in range(len(channels))]
        #: Frames that could not be read, and why.
        self.unread: dict[int, str] = {}
        room = 2.0 * grid.gsd + 0.02 * np.nanmax(np.nanmax(outline, axis=1) - np.nanmin(outline, axis=1))
        self._low, self._high = np.nanmin(outline, axis=1) - room, np.nanmax(outline, axis=1) + room
        if min(self._cells_shape()) < TAPS:
            raise InputError(f"frames of {views.detector.shape} px are too small for the kernel of {TAPS}")

    def _levels(self, gain: Array | None) -> Array32:
        """Brightness (B,) of the lines of each band."""
        out = np.ones(len(self.layout), dtype=np.float32)
        if gain is None:
            return out
        layout = self.layout
        line = np.repeat(np.arange(len(layout.offset) - 1), np.diff(layout.offset))
        for band, (group, channel) in enumerate(zip(layout.group, layout.channel, strict=True)):
            out[band] = gain[channel, line[(layout.entry_group == group) & ~layout.spare]].mean()
        return out

    def _cells_shape(self) -> tuple[int, int]:
        lines, columns = self.views.detector.shape
        return lines // self.layout.period[0], columns // self.layout.period[1]

    def _bands_of(self, channel: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """First of each group, bands, and their phases, of one image."""
        rows = np.flatnonzero(self.layout.channel == channel)
        rows = rows[np.argsort(self.layout.group[rows], kind="stable")]
        count = np.bincount(self.layout.group[rows], minlength=self.layout.groups)
        first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
        return first, rows.astype(np.int64), np.ascontiguousarray(self.layout.phase[rows])

    def world(self, tile: MapTile) -> Array:
        """World points (rows, columns, 3) of the pixels of a tile; NaN where the ground is not known."""
        rows = np.arange(tile.row, tile.row + tile.rows, dtype=np.float64)[:, None]
        columns = np.arange(tile.column, tile.column + tile.columns, dtype=np.float64)[None, :]
        flat = self.grid.centres(rows, columns)
        places = np.concatenate([flat, self.heights(flat[..., 0], flat[..., 1])[..., None]], axis=2)
        return np.ascontiguousarray(self.grid.system.world(places.reshape(-1, 3)).reshape(places.shape))

    def frames_of(self, tile: MapTile, unread: Container[int] = ()) -> list[tuple[int, NDArray[np.int64]]]:
        """Frames but `unread`, in order of time, that may show a tile, each with its part of it (4,)."""
        g = self.grid
        west, north = g.west + g.gsd * tile.column, g.north - g.gsd * tile.row
        out = []
        usable = np.isfinite(self._penalty) & np.isfinite(self._low).all(axis=1)
        for frame in (int(k) for k in np.flatnonzero(usable) if int(k) not in unread):
            box = np.array([
                np.clip(np.floor((north - self._high[frame, 1]) / g.gsd), 0, tile.rows),
                np.clip(np.ceil((north - self._low[frame, 1]) / g.gsd), 0, tile.rows),
                np.clip(np.floor((self._low[frame, 0] - west) / g.gsd), 0, tile.columns),
                np.clip(np.ceil((self._high[frame, 0] - west) / g.gsd), 0, tile.columns),
            ]).astype(np.int64)  # fmt: skip
            if box[0] < box[1] and box[2] < box[3]:
                out.append((int(frame), box))
        return out

    def fill(self, tiles: Sequence[MapTile]) -> list[FilledTile | None]:
        """All bands of some tiles, on threads; None where no frame shows one."""
        known = dict(self.unread)
        found = in_threads(lambda tile: self._filled(tile, dict(known)), tiles)
        for _, unread in found:
            self.unread.update(unread)
        return [filled for filled, _ in found]

    def _filled(self, tile: MapTile, unread: dict[int, str]) -> tuple[FilledTile | None, dict[int, str]]:
        """A tile from all frames but those `unread`, and these with what was found to be among them."""
        while frames := self.frames_of(tile, unread):
            world = self.world(tile)
            out = self.choose(tile, world, frames)
            if self._fill(world.reshape(-1, 3), out, unread):
                return out, unread
            # a frame turned out unreadable: others take its place
        return None, unread

    def choose(self, tile: MapTile, world: Array, frames: list[tuple[int, NDArray[np.int64]]]) -> FilledTile:
        """Which frame shows each place best; no values yet."""
        flat, bands = world.shape[:2], self.layout
        shape = (bands.groups, *flat)
        cost = np.full(shape, np.inf, dtype=np.float32)
        view = np.full(shape, -1, dtype=np.int32)
        beyond, passed = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        last, stretch = np.full(flat, np.nan), -1
        for frame, box in frames:
            if self.views.stretch[frame] != stretch:
                stretch = int(self.views.stretch[frame])
                last[:] = np.nan
            # places that this frame cannot show are left until they are seen anew
            last[: box[0]], last[box[1] :], last[:, : box[2]], last[:, box[3] :] = (np.nan,) * 4
            choose_views(
                *only_read(world), box, *self.views.of(frame), self.views.detector.shape, bands.period,
                bands.offset, bands.entry_group, bands.centre, bands.half, bands.spare,
                float(self._penalty[frame]), frame, cost, view, beyond, last, passed,
            )  # fmt: skip
        values = np.full((len(bands), *flat), np.nan, dtype=np.float32)
        return FilledTile(tile, values, view, passed, beyond)

    def _fill(self, world: Array, out: FilledTile, unread: dict[int, str]) -> bool:
        """Values of all places, frame after frame; whether all of them could be read."""
        first = np.empty(len(self.views) + 1, dtype=np.int64)
        places = np.empty(out.view.size, dtype=np.int32)
        sort_by_frame(out.view.ravel(), first, places)
        values = out.values.reshape(len(self.layout), -1)
        for frame in np.flatnonzero(np.diff(first)):
            own = places[first[frame] : first[frame + 1]]
            if not self._fill_from(int(frame), own, world, values, unread):
                return False
        return True

    def _fill_from(
        self, frame: int, places: NDArray[np.int32], world: Array, values: Array32, unread: dict[int, str]
    ) -> bool:
        """Values of the places of which a frame is the view; whether it could be read."""
        shape, period = np.array(self.views.detector.shape), np.array(self.layout.period)
        pixels = np.empty((len(places), 2))
        see_places(*only_read(world), places, *self.views.of(frame), self.views.detector.shape, pixels)
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - _REACH * period, 0)
        low -= low % period
        high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + _REACH * period + 1, shape)
        for channel, sources in enumerate(self._channels):
            try:
                image, bad = self._read(sources[frame], channel, low, high)
            except (SightlineError, OSError) as error:
                unread[frame] = str(error)
                return False
            first, rows, phase = self._bands[channel]
            cells = cells_by_phase(image, bad, self.layout.period)
            fill_bands(
                places, pixels, *cells, low.astype(np.float64), period, first, rows, phase, self._level,
                self._table, _MASK_SHARE, values,
            )  # fmt: skip
        return True

    def _read(
        self, source: ImageSource, channel: int, low: NDArray[np.int_], high: NDArray[np.int_]
    ) -> tuple[Array32, Flags]:
        """Part of a frame, even along lines, and which of its pixels cannot be used (empty: none)."""
        window = (int(low[0]), int(high[0])), (int(low[1]), int(high[1]))
        image, bad = source.read(*window), source.mask(*window)
        gaps = ~np.isfinite(image)
        bad = gaps if bad is None else bad | gaps
        if bad.any():
            usable = image[~bad]
            image = np.where(bad, np.float32(usable.mean() if usable.size else 0.0), image)
        if self._gain is not None:
            image = image / self._gain[channel, low[0] : high[0], None]
        return np.ascontiguousarray(image, dtype=np.float32), bad if bad.any() else np.zeros((0, 0), np.bool_)


def line_gain(channels: Sequence[Sequence[ImageSource | None]], lines: int) -> Array:
    """Mean brightness (channels, lines) of each line over many frames; 1 where nothing is known.

    Lines of a filter differ by their wavelengths, the detector and vignetting, not by the ground, which all
    of them see in turn.
    """
    usable = [k for k, source in enumerate(channels[0]) if source is not None]
    spread = np.linspace(0, len(usable) - 1, min(_GAIN_FRAMES, len(usable))).astype(int)
    some = [usable[k] for k in spread]
    out = np.ones((len(channels), lines))
    for channel, images in enumerate(channels):
        means = [mean for frame in some if (mean := _line_means(images[frame])) is not None]
        if means:
            level = np.nanmean(means, axis=0)
            out[channel] = np.where(np.isfinite(level) & (level > 0.0), level, np.nanmedian(level))
    return out


def _line_means(source: ImageSource | None) -> Array | None:
    """(lines,) of a frame; None where it cannot be read."""
    if source is None:
        return None
    lines, columns = source.shape
    try:
        pixels, bad = source.read((0, lines), (0, columns)), source.mask((0, lines), (0, columns))
    except (SightlineError, OSError):
        return None
    usable = np.isfinite(pixels) if bad is None else np.isfinite(pixels) & ~bad
    count = usable.sum(axis=1)
    total = np.where(usable, pixels, np.float32(0.0)).sum(axis=1, dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
