"""An ACQUISITION.toml for HiRISE EDRs of one observation: channels joined, each CCD a band of its own.

Where CCDs look, which line of one is exposed when, and how channels lie in a CCD: HiRISE instrument kernel
(NAIF and USGS, ``mro_hirise_v12.ti``, 2011). Without SPICE neither orbit nor attitude of the day is known:
the flight is level, as fast over its height as lines follow one another.

Not here: reading an EDR (``io/formats/hirise_edr.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.io.formats.hirise_edr import (
    CODES,
    TICKS,
    HiriseSetting,
    read_hirise_edr,
    read_hirise_setting,
)
from sightline.io.init.bands import FirstAcquisition, acquisition_text
from sightline.io.names import toml_string
from sightline.writing import whole_raster, whole_text

Array = NDArray[np.float64]

#: mm; focal length, and terms of the lens by powers 0, 2 and 4 of the distance from the axis.
_FOCAL, _LENS = 11994.9988, (-0.0048509, 2.41312e-7, -1.62369e-13)
#: CCD by the number of its electronics: name, and mm of its centre and mm a sample along x (ahead) and y.
_CCDS = {
    0: ("RED0", (-96.3935, -5.7e-5), (112.9956, -0.012)),
    1: ("RED1", (-89.4914, -4.2e-5), (88.9950, -0.012)),
    2: ("RED2", (-96.9459, -3.4e-5), (65.0469, -0.012)),
    3: ("RED3", (-89.4927, -1.8e-5), (41.0380, -0.012)),
    5: ("RED4", (-96.4998, 2e-6), (16.9992, -0.012)),
    8: ("RED5", (-89.4960, -1e-6), (-7.0010, -0.012)),
    10: ("RED6", (-96.6811, 1.9e-5), (-30.9996, -0.012)),
    11: ("RED7", (-89.4935, 3.1e-5), (-55.0034, -0.012)),
    12: ("RED8", (-96.3954, 4.9e-5), (-78.9990, -0.012)),
    13: ("RED9", (-89.1039, 5.6e-5), (-102.9997, -0.012)),
    6: ("IR10", (-110.9610, 0.0), (16.9991, -0.012)),
    7: ("IR11", (-103.6857, -1e-6), (-7.0010, -0.012)),
    4: ("BG12", (-82.2033, 2e-6), (16.9993, -0.012)),
    9: ("BG13", (-74.9334, 3e-6), (-7.0007, -0.012)),
}
#: mm from line to line; samples of a channel; sample of the centre of a CCD, from 1, and lines before it.
_PITCH, _CHANNEL, _CENTRE = 0.012, 1024, (1024.5, 64.0)
#: m above the ground that the kernel takes MRO to be.
_ALTITUDE = 300e3
#: Columns in common from which on windows need not be narrowed; narrowest windows that are matched.
_WIDE, _LEAST_WINDOW = 150.0, 16
#: Lines of a CCD at least, and s within which CCDs of one observation begin.
_LEAST_LINES, _BEGIN = 8, 60.0
#: Share of clipped pixels from which on a whole column is masked.
_CLIPPED = 0.01
#: By how much neighbours across the middle of a CCD correlate better with a channel mirrored, to say it is.
_MIRRORED = 0.2
#: px; how well a CCD's place beside others is known: 0.1 px, and what the flight is not as even as assumed.
_OFFSET_SIGMA = 3.0
_PARTNERS = "neighbours (RED4 and RED5 overlap by 48 columns), or BG12, IR10 with RED4, BG13, IR11 with RED5"
_SOURCE = (
    "where CCDs look, when lines are exposed, channels of a CCD (1 holds its samples 1 to 1024, 0 the rest): "
    "HiRISE instrument kernel mro_hirise_v12.ti (NAIF and USGS, 2011)"
)
_KERNELS = (
    "orbit and attitude of the day, and UTC to better than a ms: with kernels of SPICE (lsk, sclk, pck, fk, "
    "and spk and ck of MRO for the day) a camera model of each CCD (USGS CSM, by `ale`) takes the place of "
    'the even flight: [platform] kind = "camera-model", model of each [[band]]'
)


@dataclass(frozen=True)
class _Ccd:
    """One CCD: its channels, by their number, where they are and what their labels set."""

    name: str
    number: int
    channels: dict[int, tuple[Path, HiriseSetting]]

    @property
    def set(self) -> HiriseSetting:
        """What is alike of its channels."""
        return next(iter(self.channels.values()))[1]

    def centre_time(self, zero: int) -> float:
        """s from a reading of the spacecraft's clock to the middle of the TDI block of line 0."""
        own = self.set
        return (own.clock - zero) / TICKS - own.scan_period * (own.stages / 2.0 - own.binning / 2.0)

    def directions(self) -> Array:
        """(columns, 3) where columns look, ahead, right and down, mm in the focal plane without the lens."""
        return self._looks(0.0)

    def step(self) -> float:
        """Tangent of the angle from a line of the CCD to the next, in its middle."""
        ahead = self._looks(1.0) - self._looks(0.0)
        return float(ahead[:, 0].mean()) / _FOCAL

    def _looks(self, further: float) -> Array:
        """Directions so many lines of the CCD further ahead."""
        own = self.set
        first = 0 if 1 in self.channels else _CHANNEL // own.binning
        count = _CHANNEL // own.binning * len(self.channels)
        sample = (np.arange(count) + first + 0.5) * own.binning + 0.5 - _CENTRE[0]
        line = -_CENTRE[1] + own.stages / 2.0 - (own.binning / 2.0 - 0.5) + further
        _, (x, by_x), (y, by_y) = _CCDS[self.number]
        # the table turns the lines of a CCD by the same small angle as its samples
        place = np.stack([x + by_x * sample + _PITCH * line, y + by_y * sample + by_x * line], axis=1)
        square = (place**2).sum(axis=1)
        ideal = place * (1.0 - (_LENS[0] + square * (_LENS[1] + square * _LENS[2])))[:, None]
        return np.column_stack([ideal, np.full(count, _FOCAL)])


def acquisition_of_edrs(paths: Sequence[Path], folder: Path) -> FirstAcquisition:
    """The acquisition of channels of one HiRISE observation; images, masks, directions are written beside it.

    Parameters
    ----------
    paths : sequence of Path
        EDRs, one channel each, in any order.
    folder : Path
        Where the file will lie.

    Returns
    -------
    FirstAcquisition

    Raises
    ------
    FormatError
        If one cannot be read.
    InputError
        If they are of several observations, twice the same channel, or channels of a CCD do not go together.
    """
    ccds = _ccds(paths)
    if len(ccds) < 2:
        raise InputError(
            f"{paths[0]}: of one CCD ({ccds[0].name}) alone; motion is seen between two or more that show "
            f"the same ground at different times: give {_PARTNERS} too"
        )
    joined = [_Joined.of(ccd) for ccd in ccds]
    first = ccds[0]
    speed = _ALTITUDE * first.step() / first.set.scan_period
    assumed = (
        _SOURCE,
        f"straight and level flight {_ALTITUDE / 1e3:g} km above the ground (that of the kernel), at "
        f"{speed:.0f} m/s, so that a line of {first.name} moves on by one pixel of its CCD (TDI)",
        f"CCDs are placed to {_OFFSET_SIGMA:g} px (1-sigma) beside one another",
        *_meanings(joined),
    )
    unknown = (
        _KERNELS,
        "heights of the ground: one height; give [surface] dem and radii with a camera model",
    )
    parts = [
        f"[acquisition]\nname = {toml_string(first.set.observation)}\n"
        f"epoch = {toml_string(first.set.start + 'Z')}   # t = 0: the clock {first.set.clock_text}, to a ms",
        f'[platform]\nkind = "level-flight"\naltitude = {_ALTITUDE!r}\nground_speed = {speed:.8g}',
        *(_band(one, first) for one in joined),
        "[surface]\nheight = 0.0   # m, the mean of the ground",
    ]
    shared = _shared_columns(ccds)
    lacking = _lacking(shared)
    narrow = {name: count for name, count in shared.items() if 0.0 < count < _WIDE}
    window = int(min(narrow.values(), default=_WIDE) * 2 / 3)
    if narrow and window >= _LEAST_WINDOW:
        parts.append(
            f"[matching]\nfirst_window = [32, {window}]   # {', '.join(narrow)}: "
            f"{min(narrow.values()):.0f} columns in common\nwindow = [16, {window}]"
        )
    found = (
        *(line for one in joined for line in one.said),
        *(
            f"{name} shows {count:.0f} columns that another shows too: too few to be matched; leave it out"
            for name, count in narrow.items()
            if count * 2 / 3 < _LEAST_WINDOW
        ),
    )
    return FirstAcquisition(
        acquisition_text(assumed, unknown, parts, folder), assumed, unknown, found, lacking, _Beside(joined)
    )


def _meanings(joined: Sequence[_Joined]) -> list[str]:
    """What values are, once where that is alike for all CCDs."""
    of = {one.ccd.name: one.meaning for one in joined}
    if len(set(of.values())) == 1:
        return [joined[0].meaning]
    return [f"{name}: {meaning}" for name, meaning in of.items()]


def _ccds(paths: Sequence[Path]) -> list[_Ccd]:
    """CCDs of one observation, in the order of the focal plane from its left."""
    settings = [(path, read_hirise_setting(path)) for path in paths]
    of = {one.observation: path for path, one in settings}
    if len(of) > 1:
        (a, path), (b, other) = list(of.items())[:2]
        raise InputError(
            f"{path} is of observation {a}, {other} of {b}; give channels of one observation at a time"
        )
    held: dict[int, dict[int, tuple[Path, HiriseSetting]]] = {}
    for path, one in settings:
        if one.cpmm not in _CCDS or one.channel not in (0, 1):
            raise InputError(
                f"{path}: is of electronics {one.cpmm}, channel {one.channel}; HiRISE has 0 to 13, each with "
                "channels 0 and 1"
            )
        channels = held.setdefault(one.cpmm, {})
        if one.channel in channels:
            name = _CCDS[one.cpmm][0]
            raise InputError(
                f"{channels[one.channel][0]} and {path} are both channel {one.channel} of {name}"
            )
        channels[one.channel] = path, one
    order = [number for number in _CCDS if number in held]
    ccds = [
        _Ccd(_CCDS[number][0], number, dict(sorted(held[number].items(), reverse=True))) for number in order
    ]
    for ccd in ccds:
        _check_channels(ccd)
    _check_begin(ccds)
    return ccds


def _check_begin(ccds: Sequence[_Ccd]) -> None:
    """InputError unless CCDs begin within seconds of one another."""
    first, last = (of(ccds, key=lambda ccd: ccd.set.clock) for of in (min, max))
    apart = (last.set.clock - first.set.clock) / TICKS
    if apart > _BEGIN:
        (a, _), (b, _) = (next(iter(ccd.channels.values())) for ccd in (first, last))
        raise InputError(
            f"{b} begins {apart:.4g} s after {a} by SPACECRAFT_CLOCK_START_COUNT; CCDs of one observation "
            f"begin within {_BEGIN:g} s: are the labels whole?"
        )


def _check_channels(ccd: _Ccd) -> None:
    """InputError unless channels of a CCD can be laid side by side."""
    if len(ccd.channels) < 2:
        return
    (a, one), (b, other) = ccd.channels.values()
    for what in ("stages", "binning", "scan_period", "clock"):
        if getattr(one, what) != getattr(other, what):
            raise InputError(
                f"{a} and {b} are channels of {ccd.name}, but differ in {what} ({getattr(one, what):g} and "
                f"{getattr(other, what):g}): give one of them alone"
            )


@dataclass(frozen=True)
class _Joined:
    """A CCD, what was found of its pixels, and which of its channels are mirrored."""

    ccd: _Ccd
    lines: int
    columns: int
    masked: bool
    mirrored: tuple[int, ...]
    meaning: str
    said: tuple[str, ...]

    @staticmethod
    def of(ccd: _Ccd) -> _Joined:
        """Reads the channels of a CCD."""
        read = {channel: _half(path) for channel, (path, _) in ccd.channels.items()}
        halves = {channel: (values, bad) for channel, (values, bad, _) in read.items()}
        meanings = {meaning for _, _, meaning in read.values()}
        if len(meanings) > 1 and CODES in meanings:
            a, b = (path for path, _ in ccd.channels.values())
            raise InputError(
                f"{a} and {b} are channels of {ccd.name}, but one holds values and the other codes of a "
                "table that is not there: give one of them alone"
            )
        lines = min(len(values) for values, _ in halves.values())
        said = []
        wide = {values.shape[1] for values, _ in halves.values()}
        due, path = _CHANNEL // ccd.set.binning, next(iter(ccd.channels.values()))[0]
        if wide != {due}:
            raise InputError(
                f"{path}: has {min(wide - {due})} columns, not the {due} of a channel in "
                f"{ccd.set.binning} x binning"
            )
        mirrored: tuple[int, ...] = ()
        if len(halves) == 2:
            mirrored = _mirrored(halves[1][0][:lines], halves[0][0][:lines])
        values, bad = _side_by_side(halves, lines, mirrored)
        _check_held(path, ccd.name, values, bad)
        columns = int(bad.all(axis=0).sum())
        channels = " and ".join(map(str, ccd.channels))
        own = ccd.set
        said.append(
            f"{ccd.name}: channel {channels}, {lines} lines x {values.shape[1]} columns, {own.stages} TDI "
            f"stages, binning {own.binning}; {columns} columns and "
            f"{(bad.mean() - columns / bad.shape[1]) * 100:.2g} % of the pixels beside them are masked "
            "(clipped codes, gaps)"
        )
        if len({len(value) for value, _ in halves.values()}) > 1:
            said.append(
                f"{ccd.name}: its channels have unlike numbers of lines; the first {lines} are joined"
            )
        said += [
            f"{ccd.name}: channel {channel} was mirrored: only so do its columns go on across the middle"
            for channel in mirrored
        ]
        meaning = "; ".join(sorted(meanings))
        return _Joined(ccd, lines, values.shape[1], bool(bad.any()), mirrored, meaning, tuple(said))

    def pixels(self) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
        """Values (lines, columns) and which of them are none."""
        halves = {channel: _half(path)[:2] for channel, (path, _) in self.ccd.channels.items()}
        return _side_by_side(halves, self.lines, self.mirrored)


def _check_held(path: Path, name: str, values: NDArray[np.uint16], bad: NDArray[np.bool_]) -> None:
    """InputError where nothing of a CCD can be matched."""
    if len(values) < _LEAST_LINES:
        raise InputError(
            f"{path}: {name} has {len(values)} lines; {_LEAST_LINES} or more are needed for a window that "
            "can be matched"
        )
    held = values[~bad]
    if not held.size or (held == held[0]).all():
        what = f"the same value ({held[0]}) everywhere" if held.size else "no value (clipped codes, gaps)"
        raise InputError(f"{path}: {name} holds {what}; give the channel as it came, or leave the CCD out")


def _half(path: Path) -> tuple[NDArray[np.uint16], NDArray[np.bool_], str]:
    """Values of a channel, where there is none (clipped, missing, whole columns), and what they are."""
    edr = read_hirise_edr(path)
    bad = edr.none
    codes = np.arange(len(edr.table.lower), dtype=np.uint16)
    values = np.round(np.where(np.isnan(edr.table.lower), 0.0, edr.table.values(codes))).astype(np.uint16)
    whole = edr.image.arrived
    if whole.any():
        bad[:, bad[whole].mean(axis=0) > _CLIPPED] = True
    bad[~whole] = True
    return values[edr.image.image], bad, edr.meaning


def _side_by_side(
    halves: dict[int, tuple[NDArray[np.uint16], NDArray[np.bool_]]], lines: int, mirrored: tuple[int, ...]
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Channel 1, then channel 0."""
    turned = {
        channel: tuple(array[:lines, ::-1] if channel in mirrored else array[:lines] for array in half)
        for channel, half in halves.items()
    }
    order = [channel for channel in (1, 0) if channel in turned]
    return np.hstack([turned[c][0] for c in order]), np.hstack([turned[c][1] for c in order])


def _mirrored(left: NDArray[np.uint16], right: NDArray[np.uint16]) -> tuple[int, ...]:
    """Which of two channels (1, 0) must be mirrored for the columns of both to go on across their seam."""

    def alike(a: NDArray[np.uint16], b: NDArray[np.uint16]) -> float:
        x, y = (np.diff(column.astype(np.float64)) for column in (a, b))
        size = float(np.sqrt((x @ x) * (y @ y)))
        return float(x @ y) / size if size > 0.0 else 0.0

    ways = {
        (): alike(left[:, -1], right[:, 0]),
        (1,): alike(left[:, 0], right[:, 0]),
        (0,): alike(left[:, -1], right[:, -1]),
        (1, 0): alike(left[:, 0], right[:, -1]),
    }
    best = max(ways, key=lambda way: ways[way])
    return best if ways[best] > ways[()] + _MIRRORED else ()


def _level(first: _Ccd) -> Rotation:
    """Turns the middle of a CCD straight down."""
    middle = first.directions().mean(axis=0)
    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [middle / np.linalg.norm(middle)])[0]


def _band(one: _Joined, first: _Ccd) -> str:
    ccd = one.ccd
    own = ccd.set
    lines = [
        "[[band]]",
        f"name = {toml_string(ccd.name)}",
        f'image = "{ccd.name}.tif"   # its channels side by side',
        *([f'mask = "{ccd.name}_mask.tif"   # clipped codes, gaps'] if one.masked else []),
        f'directions = "{ccd.name}.csv"',
        f"line_period = {own.scan_period * own.binning!r}   # s, by the label",
        f"first_line_time = {ccd.centre_time(first.set.clock)!r}   # s, middle of its TDI, by the clock",
        f"stages = {max(1, own.stages // own.binning)}   # {own.stages} lines of the CCD",
        f"offset_sigma_px = {_OFFSET_SIGMA!r}",
    ]
    return "\n".join(lines)


@dataclass(frozen=True)
class _Beside:
    """Images, masks and directions of the bands."""

    joined: Sequence[_Joined]

    def __call__(self, folder: Path) -> None:
        level = _level(self.joined[0].ccd)
        for one in self.joined:
            ahead, right, down = level.apply(one.ccd.directions() / _FOCAL).T
            # camera axes: x to larger columns, which lie left, y ahead
            rows = "".join(
                f"{k},{x:.12g},{y:.12g},{z:.12g}\n"
                for k, (x, y, z) in enumerate(zip(-right, ahead, down, strict=True))
            )
            whole_text(folder / f"{one.ccd.name}.csv", f"column,x,y,z\n{rows}")
            values, bad = one.pixels()
            _write(folder / f"{one.ccd.name}.tif", values)
            if one.masked:
                _write(folder / f"{one.ccd.name}_mask.tif", bad.astype(np.uint8))


def _write(path: Path, values: NDArray[np.uint16] | NDArray[np.uint8]) -> None:
    lines, columns = values.shape
    size = {"height": lines, "width": columns, "count": 1, "dtype": values.dtype.name}
    with (
        whole_raster(path) as draft,
        rasterio.open(draft, "w", driver="GTiff", compress="deflate", **size) as raster,
    ):
        raster.write(values, 1)


def _shared_columns(ccds: Sequence[_Ccd]) -> dict[str, float]:
    """Columns that each CCD shows of the ground of another, at most."""
    most = {ccd.name: 0.0 for ccd in ccds}
    for a, b in combinations(ccds, 2):
        ends = [np.sort(ccd.directions()[[0, -1], 1]) for ccd in (a, b)]
        common = min(end[1] for end in ends) - max(end[0] for end in ends)
        for ccd in (a, b):
            # from centre to centre of the outermost ones
            columns = 1.0 + common / (ccd.step() * _FOCAL * ccd.set.binning)
            most[ccd.name] = max(most[ccd.name], columns)
    return most


def _lacking(shared: Mapping[str, float]) -> tuple[str, ...]:
    """Why these hold no motion; nothing where two of them show the same ground."""
    if any(shared.values()):
        return ()
    names = ", ".join(shared)
    return (f"no two of {names} show the same ground: give {_PARTNERS}",)
