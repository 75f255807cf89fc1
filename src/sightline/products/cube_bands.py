"""Bands of a cube: which lines, cells or channels of a frame see each, and how well.

Not here: pixels (``frame_cube.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen

Index = NDArray[np.int64]

#: Line, band, best line, lines to the end, whether beyond it.
_Entry = tuple[int, int, float, float, bool]

#: Bands of a continuous filter at most, unless more are asked for; distinct wavelengths that may be given.
_MOST = 256


@dataclass(frozen=True, eq=False)
class BandLayout(ReadOnlyArrays):
    """What a frame shows of each band.

    Bands that are seen from the same frames (cells of a mosaic, channels of a colour image) are of one group;
    bands on other lines of the frame are a group each.

    Attributes
    ----------
    names : tuple of str
        B.
    wavelength_nm : (B,)
        NaN: all light.
    group : (B,) int
    channel : (B,) int
        Image of the frame that shows the band.
    phase : (B, 2) int
        Line and column of its first pixel.
    period : (int, int)
        Lines and columns from one of its pixels to the next.
    offset : (lines + 1,) int
        Line l of a frame has the entries ``offset[l]`` to ``offset[l + 1]``.
    entry_group : (E,) int
        Group that an entry is of.
    centre : (E,)
        Line where that group is seen best.
    half : (E,)
        Lines from there to the group's end.
    spare : (E,) bool
        Lines beyond that end, which stand in where a step was too long.
    """

    names: tuple[str, ...]
    wavelength_nm: Array
    group: Index
    channel: Index
    phase: Index
    period: tuple[int, int]
    offset: Index
    entry_group: Index
    centre: Array
    half: Array
    spare: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of bands."""
        return len(self.names)

    def of(self, bands: Sequence[int]) -> BandLayout:
        """Only some of the bands, in the order given."""
        rows = np.asarray(bands, dtype=np.intp)
        kept, group = np.unique(self.group[rows], return_inverse=True)
        entries = np.isin(self.entry_group, kept)
        line = np.repeat(np.arange(len(self.offset) - 1), np.diff(self.offset))[entries]
        count = np.bincount(line, minlength=len(self.offset) - 1)
        return replace(
            self,
            names=tuple(self.names[k] for k in rows),
            wavelength_nm=frozen(self.wavelength_nm[rows]),
            group=group.astype(np.int64),
            channel=self.channel[rows],
            phase=self.phase[rows],
            offset=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
            entry_group=np.searchsorted(kept, self.entry_group[entries]).astype(np.int64),
            centre=frozen(self.centre[entries]),
            half=frozen(self.half[entries]),
            spare=self.spare[entries],
        )

    @property
    def groups(self) -> int:
        """Number of groups."""
        return int(self.group.max()) + 1


def line_bands(
    wavelength_nm: Array,
    bands: int | Sequence[float] | None = None,
    step: float | None = None,
    fill_nm: float | None = None,
    *,
    lines_per_step: float = 1.5,
) -> BandLayout:
    """Bands of a filter that varies from line to line.

    Parameters
    ----------
    wavelength_nm : (lines,)
    bands : int or sequence of float, optional
        How many, or their wavelengths (nm). By default each distinct wavelength where lines share them,
        else as many as leave each enough lines for the steps flown.
    step : float, optional
        px; lines from frame to frame.
    fill_nm : float, optional
        How far beyond its own wavelengths lines may stand in where a step was too long, each counted less
        good the further it is; default less than half the band's width: never those of the next step of a
        filter that has steps.
    lines_per_step : float
        Steps that a band has lines for, where the number of bands of a continuous filter is not given.

    Notes
    -----
    A band owns the lines whose wavelength is nearer than half its width.
    """
    lines = np.asarray(wavelength_nm, dtype=np.float64)
    distinct = np.unique(lines)
    centres, width = _wavelengths(lines, distinct, bands, lines_per_step * step if step else None)
    reach = np.full(len(centres), 0.5 * width)
    if len(centres) > 1:
        gap = np.diff(np.sort(centres))
        near = np.minimum(np.append(gap, np.inf), np.insert(gap, 0, np.inf))
        reach[np.argsort(centres)] = np.minimum(reach[np.argsort(centres)], 0.5 * near)
    entries: list[_Entry] = []
    for band, (centre, half) in enumerate(zip(centres, reach, strict=True)):
        limit = 2.0 * half * (1.0 - 1e-9) if fill_nm is None else half + fill_nm
        entries += _entries(band, lines, float(centre), float(half), float(limit))
    return _layout(centres, entries, len(lines))


def _wavelengths(
    lines: Array, distinct: Array, bands: int | Sequence[float] | None, wanted: float | None
) -> tuple[Array, float]:
    """Centres of the bands and their full width, nm; a band of a continuous filter has `wanted` lines."""
    low, high = distinct[0], distinct[-1]
    shared = 2 * len(distinct) <= len(lines)
    usual = len(distinct) if shared else int(len(lines) / wanted) if wanted else 64
    usual = int(np.clip(usual, 1, _MOST if shared else min(_MOST, len(lines) // 2)))
    count = usual if bands is None or not isinstance(bands, int) else bands
    if count < 1 or count > len(distinct):
        raise InputError(f"`bands` must be from 1 to the {len(distinct)} wavelengths there are, got {count}")
    # two distinct wavelengths and more lie at the middles of their bands, whose outer ends reach beyond
    span = (high - low) * (1.0 if not shared or len(distinct) < 2 else len(distinct) / (len(distinct) - 1))
    width = max(span / count, 1e-6)
    if bands is not None and not isinstance(bands, int):
        return _given(np.array(bands, dtype=np.float64), low, high, width), width
    if shared and count == len(distinct):
        return distinct, float(np.diff(distinct).max()) if count > 1 else width
    first = 0.5 * (low + high - span)
    return np.asarray(first + width * (np.arange(count) + 0.5)), width


def _given(centres: Array, low: float, high: float, width: float) -> Array:
    """Wavelengths asked for, checked."""
    beside = ~((centres >= low - 0.5 * width) & (centres <= high + 0.5 * width))
    if not centres.size or beside.any():
        wrong = f"{centres[beside][0]:g}" if centres.size else "none"
        raise InputError(f"`bands` must be wavelengths from {low:g} to {high:g} nm, got {wrong}")
    if len(np.unique(centres)) < len(centres):
        raise InputError("`bands` names a wavelength twice; name each once")
    return centres


def _entries(band: int, lines: Array, centre: float, half: float, limit: float) -> list[_Entry]:
    """Entries of the lines that show a band, run by run."""
    off = np.abs(lines - centre)
    slack = 1e-9 * max(abs(centre), 1.0)
    own = np.flatnonzero(off <= half + slack)
    if not len(own):
        own = np.array([int(np.argmin(off))])
    out = []
    for run in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
        best = _best_line(run, lines, centre)
        reach = max(0.5 * len(run), 0.5)
        first, last = int(run[0]), int(run[-1])
        while first > 0 and off[first - 1] <= limit and off[first - 1] > off[first] - slack:
            first -= 1
        while last < len(lines) - 1 and off[last + 1] <= limit and off[last + 1] > off[last] - slack:
            last += 1
        every = range(first, last + 1)
        out += [(line, band, best, reach, not run[0] <= line <= run[-1]) for line in every]
    return out


def _best_line(run: Index, lines: Array, centre: float) -> float:
    """Where along a run of lines a wavelength is met: between two lines, or in the middle of those alike."""
    nm = lines[run]
    order = np.argsort(nm)
    if len(run) > 1 and nm[order[0]] < centre < nm[order[-1]] and (np.diff(nm[order]) > 0.0).all():
        return float(np.interp(centre, nm[order], run[order]))
    off = np.abs(nm - centre)
    return float(run[off <= off.min() + 1e-9].mean())


def _layout(centres: Array, entries: list[_Entry], lines: int) -> BandLayout:
    table = np.array(sorted(entries), dtype=np.float64).reshape(-1, 5)
    counts = np.bincount(table[:, 0].astype(int), minlength=lines)
    count = len(centres)
    return BandLayout(
        tuple(f"{nm:.1f} nm" for nm in centres),
        frozen(centres),
        np.arange(count),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, 2), dtype=np.int64),
        (1, 1),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        table[:, 1].astype(np.int64),
        frozen(table[:, 2]),
        frozen(table[:, 3]),
        table[:, 4] > 0.0,
    )


def frame_bands(
    shape: tuple[int, int], mosaic_nm: Array | None = None, channel_nm: Sequence[float] = ()
) -> BandLayout:
    """Bands that a whole frame shows at once: cells of a mosaic filter, channels of a colour image, or one.

    Parameters
    ----------
    shape : (lines, columns)
        Of a frame.
    mosaic_nm : (rows, columns), optional
        Pattern that repeats over the frame.
    channel_nm : sequence of float
        One per channel; NaN where nothing says it.
    """
    lines = shape[0]
    if mosaic_nm is not None:
        period = (int(mosaic_nm.shape[0]), int(mosaic_nm.shape[1]))
        phase = np.stack(np.meshgrid(*map(np.arange, period), indexing="ij"), axis=-1).reshape(-1, 2)
        nm, channel = mosaic_nm.ravel(), np.zeros(mosaic_nm.size, dtype=np.int64)
    else:
        nm = np.array(channel_nm if len(channel_nm) else [np.nan], dtype=np.float64)
        period, phase, channel = (1, 1), np.zeros((len(nm), 2), dtype=np.int64), np.arange(len(nm))
    order = np.argsort(nm, kind="stable")
    unknown = [f"band {k + 1}" for k in range(len(nm))] if len(nm) > 1 else ["all light"]
    names = tuple(unknown[k] if np.isnan(nm[k]) else f"{nm[k]:.1f} nm" for k in order)
    return BandLayout(
        names,
        frozen(nm[order]),
        np.zeros(len(nm), dtype=np.int64),
        np.asarray(channel[order], dtype=np.int64),
        np.asarray(phase[order], dtype=np.int64),
        period,
        np.arange(lines + 1, dtype=np.int64),
        np.zeros(lines, dtype=np.int64),
        frozen(np.full(lines, 0.5 * (lines - 1))),
        frozen(np.full(lines, 0.5 * lines)),
        np.zeros(lines, dtype=np.bool_),
    )


def camera_bands(
    names: Sequence[str], wavelength_nm: Sequence[float], camera: Sequence[int], lines: int
) -> BandLayout:
    """Bands that cameras of a rig show, each of whole frames; a group per camera.

    Parameters
    ----------
    names : sequence of str
        Of the bands.
    wavelength_nm : sequence of float
        NaN: all light.
    camera : sequence of int
        Which camera shows each.
    lines : int
        Of a frame.

    Returns
    -------
    BandLayout
        By wavelength, those of all light last. `channel` numbers the bands as they are given here.
    """
    nm = np.asarray(wavelength_nm, dtype=np.float64)
    order = np.argsort(nm, kind="stable")
    cameras = np.asarray(camera, dtype=np.int64)
    count = int(cameras.max()) + 1
    return BandLayout(
        tuple(names[k] for k in order),
        frozen(nm[order]),
        cameras[order],
        order.astype(np.int64),
        np.zeros((len(nm), 2), dtype=np.int64),
        (1, 1),
        np.arange(0, count * lines + 1, count, dtype=np.int64),
        np.tile(np.arange(count, dtype=np.int64), lines),
        frozen(np.full(count * lines, 0.5 * (lines - 1))),
        frozen(np.full(count * lines, 0.5 * lines)),
        np.zeros(count * lines, dtype=np.bool_),
    )
