"""Windows followed from frame to frame of a sequence, as long as they look alike.

Neighbours of a sequence look alike, because their places and their wavelengths are near. Windows of one
frame, its hub, are looked for in the frames after it, each time where the motion so far has carried them;
when too few are left, a new hub takes over. Every sighting is compared with the hub itself, so that errors do
not add up. A frame that links to none is stepped over; where that does not help, a new stretch begins.

One frame at a time is read, and only hubs whose windows are still followed are kept.

Not here: poses (``photogrammetry/flight/poses.py``); stretches seen from other directions
(``photogrammetry/match_frames.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sightline.compiled import only_read
from sightline.errors import EstimationError, InputError, SightlineError
from sightline.geometry.checks import ReadOnlyArrays, frozen
from sightline.imaging.reduce import pattern_means, whole_pixels
from sightline.imaging.resample import kernel_table
from sightline.imaging.source import ArrayImage, ImageSource, read_padded
from sightline.matching import kernels
from sightline.matching.correlate import pair_covariances, search_shift
from sightline.matching.select import select_points
from sightline.matching.whitening import gradient_filter

__all__ = ["FollowPlan", "FollowState", "Followed", "follow_windows"]

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.bool_]

#: Lines that whole frames are compared at.
_COARSE_LINES = 128
#: px, least reduction of the contrast that fine contrast is compared with.
_BLUNT = 4
#: Standard deviations of the phase correlation that its peak must stand out by: noise reaches 4 of them.
_LEAST_PEAK = 6.0
#: Windows that tell how a frame moved as a whole, at most; and how many must agree, as number and as share.
_SEEDS, _LEAST, _AGREEMENT = 64, 10, 0.5
#: px; windows that lie further from the common motion disagree (relief moves some by a part of a pixel).
_DISAGREE = 1.5
#: Share of the larger side by which a turn between two frames may move a window at the rim.
_TURN = 0.01
#: px; how far a window may lie from where it is predicted, when the frame's own motion is known.
_REACH = 1.2
#: Frames, evenly over the sequence, that tell how bright each line is on the whole.
_SAMPLES = 24
#: Cells along each side that share new windows evenly.
_CELLS = 8
#: px; what filter, derivative and interpolation need around a window.
_RIM = 20
#: Steps and px that end the fit of a window.
_ITERATIONS, _TOLERANCE = 12, 0.01
#: Frames after which the state is kept.
_KEPT = 500
_NONE = np.empty((0, 0), np.bool_)
#: What is noted of each sighting.
_SIGHTED = ("image", "point", "pixels", "variance")
NOTHING = (
    "no two frames in a row look alike; check that the frames are in the order of their times, that they "
    "overlap and that they show more than water or cloud"
)


@dataclass(frozen=True)
class FollowPlan:
    """How windows are followed.

    Attributes
    ----------
    points : int
        Windows wanted in every frame.
    window : int
        px, side of a window.
    renewal : float
        Share of a frame's lines that it moves before windows are added.
    life : float
        Share of a frame's lines that a window moves before it is given up: its wavelength is another then.
    min_score : float
        Lowest normalised correlation of a window with its hub.
    reduction : int
        Pixels are averaged in squares of this side first: the period of a mosaic filter.
    """

    points: int = 300
    window: int = 21
    renewal: float = 0.05
    life: float = 0.4
    min_score: float = 0.5
    reduction: int = 1

    def __post_init__(self) -> None:
        """Check."""
        if self.points < _LEAST or self.window < 9 or self.window % 2 == 0 or self.reduction < 1:
            raise InputError(
                f"points must be {_LEAST} or more, window odd and 9 px or more, reduction 1 or more; got "
                f"{self.points}, {self.window} and {self.reduction}"
            )
        if not (0.0 < self.renewal < 1.0 and 0.0 < self.life <= 1.0 and 0.0 < self.min_score < 1.0):
            raise InputError(
                "renewal, life and min_score must be between 0 and 1, got "
                f"{self.renewal}, {self.life} and {self.min_score}"
            )


def check_followable(shape: tuple[int, int], plan: FollowPlan) -> None:
    """InputError for frames of `shape` (lines, columns) px that are too small to be followed."""
    least = 2 * (plan.window + 2 * _RIM) * plan.reduction
    if min(shape) < least:
        raise InputError(
            f"frames of {shape[0]} lines x {shape[1]} columns are too small to be followed; {least} x "
            f"{least} are needed"
        )


@dataclass(frozen=True, eq=False)
class Followed(ReadOnlyArrays):
    """Windows followed through M frames.

    Attributes
    ----------
    image, point : (N,) int
        Of each sighting. The first of a point is its hub.
    pixels : (N, 2)
        (line, column).
    sigma_px : (N,)
        1-sigma of each coordinate, each frame's own share.
    before : (M,) int
        The frame that each was linked to; -1 where a stretch begins or a frame stands alone.
    motion : (M, 4)
        From that frame to this one, about the middle of the frame: shift of (line, column) px, turn (rad,
        from line towards column), relative growth. NaN without a link.
    windows : (M,) int
        Sightings in each frame.
    sharpness : (M,)
        Fine over coarse contrast, free of the scene's own; NaN where a frame could not be read.
    contrast : (M,)
        Of brightness in detail, standard deviation over mean.
    reason : tuple of str
        Why a frame has no link; "" where it has one, or was linked to later.
    wide : bool
        Found by features, as frames overlap too little to be followed
        (``photogrammetry/flight/wide_links.py``).
    """

    image: NDArray[np.intp]
    point: NDArray[np.intp]
    pixels: Array
    sigma_px: Array
    before: NDArray[np.intp]
    motion: Array
    windows: NDArray[np.intp]
    sharpness: Array
    contrast: Array
    reason: tuple[str, ...]
    wide: bool = False

    def linked(self) -> NDArray[np.intp]:
        """Frames (M,) linked to each other, directly or through others, by number; -1: to none."""
        out = np.full(len(self.before), -1, dtype=np.intp)
        count = 0
        for k, before in enumerate(self.before):
            if before < 0:
                continue
            if out[before] < 0:
                out[before] = count
                count += 1
            out[k] = out[before]
        return out


@dataclass(frozen=True, eq=False)
class FollowState(ReadOnlyArrays):
    """Where following stands between two frames: what it goes on from.

    Attributes
    ----------
    number : int
        Frames done.
    last, waiting : int
        The frame that the next is linked to, and one stepped over; -1: none.
    moved : float
        px since the last hub.
    names : int
        Points so far.
    hub_frame, hub_name, hub_windows, hub_alive, hub_seen : (H,) int
        Of each hub: its frame, the number of its first point, and rows of its windows, of those still
        followed and of their sightings in the arrays below.
    centre : (W, 2) int
    alive : (A,) int
    place : (A, 2)
    seen : (S,) int
    seen_variance : (S,)
    image, point, pixels, variance : (N,), (N,), (N, 2), (N,)
        Sightings since the state before.
    before, motion, sharpness, contrast : (M,), (M, 4), (M,), (M,)
    reason : tuple of str
        As of `Followed`.
    """

    number: int
    last: int
    waiting: int
    moved: float
    names: int
    hub_frame: NDArray[np.intp]
    hub_name: NDArray[np.intp]
    hub_windows: NDArray[np.intp]
    hub_alive: NDArray[np.intp]
    hub_seen: NDArray[np.intp]
    centre: NDArray[np.int64]
    alive: NDArray[np.intp]
    place: Array
    seen: NDArray[np.intp]
    seen_variance: Array
    image: NDArray[np.intp]
    point: NDArray[np.intp]
    pixels: Array
    variance: Array
    before: NDArray[np.intp]
    motion: Array
    sharpness: Array
    contrast: Array
    reason: tuple[str, ...]


@dataclass(eq=False)
class _Frame:
    """A frame as it is compared: filtered, and coarse."""

    number: int
    level: Array32
    fine: Array32
    bad: Flags
    coarse: NDArray[np.complex64]
    sharpness: float
    contrast: float


@dataclass(eq=False)
class _Hub:
    """Windows of one frame: `alive` are the rows of those still followed, `place` where they were last."""

    frame: _Frame
    centre: NDArray[np.int64]
    first_name: int
    alive: NDArray[np.intp]
    place: Array
    seen: list[tuple[NDArray[np.intp], Array]] = field(default_factory=list)


class _Reader:
    """Frames read, made even along lines, filtered."""

    def __init__(self, sources: Sequence[ImageSource | None], plan: FollowPlan) -> None:
        self._sources, self._plan = sources, plan
        self.shape = self._shape()
        self._factor = max(1, min(self.shape) // _COARSE_LINES)
        self._gain = self._line_gain()
        self.taps = gradient_filter().taps_a
        coarse = tuple(size // self._factor for size in self.shape)
        self._taper = np.outer(*(np.hanning(size + 2)[1:-1] for size in coarse)).astype(np.float32)

    @property
    def factor(self) -> int:
        """Pixels per coarse pixel."""
        return self._factor

    def _shape(self) -> tuple[int, int]:
        shapes = {source.shape for source in self._sources if source is not None}
        if len(shapes) != 1:
            raise InputError(f"frames of one size are needed, got {sorted(shapes)}; leave out the others")
        lines, columns = shapes.pop()
        shape = (lines // self._plan.reduction, columns // self._plan.reduction)
        check_followable((lines, columns), self._plan)
        return shape

    def _pixels(self, number: int) -> tuple[Array32, Flags | None] | None:
        source = self._sources[number]
        if source is None:
            return None
        try:
            if self._plan.reduction > 1:
                source = pattern_means(source, self._plan.reduction)
            return read_padded(source, (0, self.shape[0]), (0, self.shape[1]))
        except (SightlineError, OSError):
            return None

    def _line_gain(self) -> Array32:
        """(lines, 1): brightness of each line over that of all; a filter's steps would look like texture."""
        rows = np.unique(np.linspace(0, len(self._sources) - 1, _SAMPLES).astype(int))
        read = [pixels[0].mean(axis=1) for row in rows if (pixels := self._pixels(int(row))) is not None]
        if not read:
            return np.ones((self.shape[0], 1), np.float32)
        gain = np.mean([line / max(float(line.mean()), 1e-6) for line in read], axis=0)
        return np.asarray(np.maximum(gain, 0.05), dtype=np.float32)[:, None]

    def read(self, number: int) -> _Frame | None:
        """A frame; None where it cannot be read."""
        found = self._pixels(number)
        if found is None:
            return None
        level = found[0] / self._gain
        mean = float(level.mean())
        level = np.ascontiguousarray((level - np.float32(mean)) / np.float32(max(abs(mean), 1e-6)))
        fine = np.empty_like(level)
        kernels.filter_image(level, *only_read(self.taps), fine)
        coarse = _detail(level, self._factor)
        # blur must leave what fine contrast is compared with
        blunt = coarse if self._factor >= _BLUNT else _detail(level, _BLUNT)
        bad = _NONE
        if found[1] is not None:
            from scipy import ndimage

            bad = ndimage.maximum_filter(found[1], 9, mode="nearest")
        contrast = float(fine[_RIM:-_RIM, _RIM:-_RIM].std())
        return _Frame(
            number, level, fine, bad, np.asarray(np.fft.rfft2(coarse * self._taper), dtype=np.complex64),
            contrast / max(float(blunt[1:, 1:].std()), 1e-9), contrast,
        )  # fmt: skip


def _detail(level: Array32, factor: int) -> Array32:
    """Differences of an image reduced by a factor from its neighbours above and to the left; 0 at the rim."""
    lines, columns = (size // factor for size in level.shape)
    small = level[: lines * factor, : columns * factor]
    small = small.reshape(lines, factor, columns, factor).mean(axis=(1, 3))
    out = np.zeros_like(small)
    out[1:, 1:] = small[1:, 1:] - 0.5 * (small[:-1, 1:] + small[1:, :-1])
    return out


def phase_shift(
    a: NDArray[np.complex64], b: NDArray[np.complex64], shape: tuple[int, int]
) -> tuple[Array, float]:
    """Whole pixels by which an image moved, from two spectra: where b shows what a shows, and how clearly.

    Parameters
    ----------
    a, b : (lines, columns // 2 + 1)
        `numpy.fft.rfft2` of two images.
    shape : (int, int)
        Of the images.

    Returns
    -------
    shift : (2,) px
        (line, column), within half of the image.
    peak : float
        In standard deviations of the correlation.
    """
    cross = a.conj() * b
    cross /= np.maximum(np.abs(cross), 1e-20)
    surface = np.fft.irfft2(cross, s=shape)
    best = np.unravel_index(int(surface.argmax()), shape)
    shift = np.array([(p + size // 2) % size - size // 2 for p, size in zip(best, shape, strict=True)], float)
    return shift, float(surface[best] / max(float(surface.std()), 1e-20))


def fit_motion(places: Array, moved: Array, middle: Array) -> tuple[Array, Flags]:
    """Shift, turn and growth that carry places to where they were found, whatever some of them say.

    Parameters
    ----------
    places, moved : (N, 2)
        (line, column) px.
    middle : (2,)

    Returns
    -------
    motion : (4,)
        As `Followed.motion`.
    agree : (N,) bool
    """
    x = places - middle
    d = moved - places
    rows = np.zeros((len(x), 2, 4))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -x[:, 1], x[:, 0]
    rows[:, 0, 3], rows[:, 1, 3] = x[:, 0], x[:, 1]
    motion = np.array([*np.median(d, axis=0), 0.0, 0.0])
    limit = 8.0 * _DISAGREE
    agree = np.ones(len(x), np.bool_)
    while True:
        agree = np.linalg.norm(d - rows @ motion, axis=1) < limit
        if agree.sum() < 4 or limit <= _DISAGREE:
            return motion, agree
        motion = np.linalg.lstsq(rows[agree].reshape(-1, 4), d[agree].ravel(), rcond=None)[0]
        limit *= 0.5


def move(places: Array, motion: Array, middle: Array) -> Array:
    """Where `motion` carries `places` (N, 2)."""
    x = places - middle
    turn, growth = motion[2], motion[3]
    return np.asarray(places + motion[:2] + x @ np.array([[growth, turn], [-turn, growth]]))


class _Follower:
    """What is followed at the moment, and what was found."""

    def __init__(self, reader: _Reader, plan: FollowPlan, count: int) -> None:
        self.reader, self.plan = reader, plan
        self.middle = 0.5 * (np.array(reader.shape) - 1.0)
        self.size = (plan.window, plan.window)
        self.table = kernel_table()
        self.hubs: list[_Hub] = []
        self.last: _Frame | None = None
        self.moved, self.names = 0.0, 0
        self.image: list[NDArray[np.intp]] = []
        self.point: list[NDArray[np.intp]] = []
        self.pixels: list[Array] = []
        self.variance: list[Array] = []
        self.before = np.full(count, -1, dtype=np.intp)
        self.motion = np.full((count, 4), np.nan)

    def begin(self, frame: _Frame) -> None:
        """The first stretch."""
        self.last = frame
        self._renew(frame)

    def restart(self, first: _Frame, second: _Frame) -> bool:
        """Begin a new stretch with two frames, if they are alike; nothing changes if not."""
        kept = self.hubs, self.last, self.moved
        self.hubs, self.last = [], first
        self._renew(first)
        if self.link(second):
            for hub in kept[0]:
                self._close(hub)
            return True
        self.hubs, self.last, self.moved = kept
        return False

    def state(self, number: int, waiting: int, since: int) -> dict[str, Any]:
        """Fields of `FollowState` that are known here; sightings from the list's item `since` on."""
        seen = [pair for hub in self.hubs for pair in hub.seen]
        return {
            "number": number,
            "last": -1 if self.last is None else self.last.number,
            "waiting": waiting,
            "moved": self.moved,
            "names": self.names,
            "hub_frame": np.array([hub.frame.number for hub in self.hubs], dtype=np.intp),
            "hub_name": np.array([hub.first_name for hub in self.hubs], dtype=np.intp),
            "hub_windows": np.array([len(hub.centre) for hub in self.hubs], dtype=np.intp),
            "hub_alive": np.array([len(hub.alive) for hub in self.hubs], dtype=np.intp),
            "hub_seen": np.array([sum(len(r) for r, _ in hub.seen) for hub in self.hubs], dtype=np.intp),
            "centre": _stacked([hub.centre for hub in self.hubs], (0, 2), np.int64),
            "alive": _stacked([hub.alive for hub in self.hubs], (0,), np.intp),
            "place": _stacked([hub.place for hub in self.hubs], (0, 2), np.float64),
            "seen": _stacked([rows for rows, _ in seen], (0,), np.intp),
            "seen_variance": _stacked([variance for _, variance in seen], (0,), np.float64),
            "image": _stacked(self.image[since:], (0,), np.intp),
            "point": _stacked(self.point[since:], (0,), np.intp),
            "pixels": _stacked(self.pixels[since:], (0, 2), np.float64),
            "variance": _stacked(self.variance[since:], (0,), np.float64),
            "before": self.before.copy(),
            "motion": self.motion.copy(),
        }

    def merge(self, since: int) -> None:
        """Hold sightings from the lists' item `since` on in one array each: small ones take much memory."""
        for name in _SIGHTED:
            parts = getattr(self, name)
            if len(parts) > since:
                parts[since:] = [np.concatenate(parts[since:])]

    def go_on(self, states: Sequence[FollowState]) -> None:
        """Stand where the last of some states in a row was."""
        for held in states:
            for name in _SIGHTED:
                getattr(self, name).append(getattr(held, name))
        state = states[-1]
        self.moved, self.names = state.moved, state.names
        self.before, self.motion = np.array(state.before), np.array(state.motion)
        self.last = self.reader.read(state.last) if state.last >= 0 else None
        ends = [np.cumsum(n)[:-1] for n in (state.hub_windows, state.hub_alive, state.hub_seen)]
        centre = np.split(state.centre, ends[0])
        alive, place = np.split(state.alive, ends[1]), np.split(state.place, ends[1])
        seen, variance = np.split(state.seen, ends[2]), np.split(state.seen_variance, ends[2])
        for k, number in enumerate(state.hub_frame):
            frame = self.reader.read(int(number))
            assert frame is not None  # it was read before the state was kept
            pairs = [(seen[k], variance[k])] if len(seen[k]) else []
            self.hubs.append(_Hub(frame, centre[k], int(state.hub_name[k]), alive[k], place[k], pairs))

    def end(self) -> None:
        """Write what is still held."""
        for hub in self.hubs:
            self._close(hub)
        self.hubs = []

    def link(self, frame: _Frame) -> bool:
        """Follow all windows into a frame; False, and nothing has changed, where it does not look alike."""
        assert self.last is not None
        motion = self._common_motion(frame)
        if motion is None:
            return False
        parts = [self._found(hub, frame, motion) for hub in self.hubs]
        fits = np.concatenate([part[1] for part in parts]) if parts else np.empty((0, kernels.COLUMNS))
        kept = np.concatenate([part[2] for part in parts]) if parts else np.empty(0, np.bool_)
        if kept.sum() < _LEAST:
            return False
        covariance = pair_covariances(fits, kept)
        first = 0
        for hub, (places, _, good) in zip(self.hubs, parts, strict=True):
            size = 0.5 * np.trace(covariance[first : first + len(good)], axis1=1, axis2=2)[good]
            first += len(good)
            self._note(hub, frame.number, places[good], good, 0.5 * size)
        self.before[frame.number], self.motion[frame.number] = self.last.number, motion
        self.last = frame
        for hub in [hub for hub in self.hubs if not len(hub.alive)]:
            self._close(hub)
        self.hubs = [hub for hub in self.hubs if len(hub.alive)]
        self.moved += float(np.hypot(*motion[:2]))
        if self.moved >= self.plan.renewal * self.reader.shape[0]:
            self._renew(frame)
        return True

    def _common_motion(self, frame: _Frame) -> Array | None:
        """How the frame moved as a whole since the last; None if that is not seen."""
        assert self.last is not None
        k = self.reader.factor
        coarse = (self.reader.shape[0] // k, self.reader.shape[1] // k)
        shift, peak = phase_shift(self.last.coarse, frame.coarse, coarse)
        places = [hub.place for hub in self.hubs]
        have = np.concatenate(places) if places else np.empty((0, 2))
        if peak < _LEAST_PEAK or len(have) < _LEAST:
            return None
        seeds = have[np.linspace(0, len(have) - 1, min(_SEEDS, len(have))).astype(int)]
        half = self.plan.window // 2
        reach = int(np.ceil(1.5 * k + 1 + _TURN * max(self.reader.shape)))
        corner = np.rint(seeds).astype(np.int64) - half
        start = corner + half + k * shift
        rim = half + reach + 3
        inside = self._inside(start, rim) & self._inside(corner + half, half + 1)
        if inside.sum() < _LEAST:
            return None
        moved, found = search_shift(
            self.last.fine, frame.fine, corner[inside], start[inside], self.size, (reach, reach)
        )
        if found.sum() < _LEAST:
            return None
        origin, to = corner[inside][found] + half, (start[inside] + moved)[found]
        motion, agree = fit_motion(origin.astype(np.float64), to, self.middle)
        return motion if agree.sum() >= max(_LEAST, _AGREEMENT * len(agree)) else None

    def _inside(self, places: Array, rim: float) -> Flags:
        """Whether places (N, 2) lie `rim` px or more within the frame."""
        return np.asarray(np.all((places >= rim) & (places < np.array(self.reader.shape) - rim), axis=1))

    def _found(self, hub: _Hub, frame: _Frame, motion: Array) -> tuple[Array, Array, Flags]:
        """Where the frame shows the windows of a hub, the fits, and which of them are good."""
        places = move(hub.place, motion, self.middle)
        fits = np.full((len(places), kernels.COLUMNS), np.nan)
        half = self.plan.window // 2
        life = np.abs(places - hub.centre[hub.alive]).max(axis=1) < self.plan.life * self.reader.shape[0]
        rows = np.flatnonzero(self._inside(places, half + _RIM - 6) & life)
        if len(rows):
            out = np.empty((len(rows), kernels.COLUMNS))
            still = np.zeros((len(rows), 2))
            kernels.refine_windows(
                hub.frame.fine, frame.fine, hub.frame.bad, frame.bad, hub.centre[hub.alive[rows]] - half,
                places[rows], np.zeros((len(rows), 2, 2)), still, self.size, self.table, 1, _ITERATIONS,
                _TOLERANCE, _REACH, out,
            )  # fmt: skip
            fits[rows] = out
        good = (fits[:, 14] > 0.0) & (fits[:, 9] >= self.plan.min_score)
        return places + np.nan_to_num(fits[:, :2]), fits, np.asarray(good)

    def _note(self, hub: _Hub, number: int, places: Array, good: Flags, variance: Array) -> None:
        """Keep what was found of a hub's windows; give up the others."""
        hub.alive, hub.place = hub.alive[good], places
        hub.seen.append((hub.alive, variance))
        self._write(number, hub.first_name + hub.alive, places, variance)

    def _write(self, number: int, names: NDArray[np.intp], places: Array, variance: Array) -> None:
        self.image.append(np.full(len(names), number, dtype=np.intp))
        self.point.append(names)
        self.pixels.append(places)
        self.variance.append(variance)

    def _close(self, hub: _Hub) -> None:
        """The hub's own sightings, with its share of the errors of its pairs."""
        if not hub.seen:
            return
        rows = np.concatenate([rows for rows, _ in hub.seen])
        size = np.concatenate([variance for _, variance in hub.seen])
        # the first frames after it: later ones differ by their wavelength too
        found, first = np.unique(rows, return_index=True)
        self._write(hub.frame.number, hub.first_name + found, hub.centre[found].astype(float), size[first])

    def _renew(self, frame: _Frame) -> None:
        """New windows where there are none."""
        self.moved = 0.0
        places = [hub.place for hub in self.hubs]
        have = np.concatenate(places) if places else np.empty((0, 2))
        wanted = self.plan.points - len(have)
        if wanted <= 0:
            return
        step = 2 * self.plan.window // 3

        def free(centres: Array) -> Flags:
            """Which windows have room for filters, and none that is followed beside them."""
            inside = self._inside(centres, self.plan.window // 2 + _RIM)
            return inside & (cKDTree(have).query(centres)[0] >= step) if len(have) else inside

        source = ArrayImage(frame.level, frame.bad if frame.bad.size else None)
        chosen = select_points(
            source, window=self.size, step=(step, step), count=wanted, cells=(_CELLS, _CELLS), allowed=free
        )
        if len(chosen):
            centre = np.rint(chosen).astype(np.int64)
            self.hubs.append(_Hub(frame, centre, self.names, np.arange(len(centre)), centre.astype(float)))
            self.names += len(centre)


def follow_windows(
    sources: Sequence[ImageSource | None],
    plan: FollowPlan | None = None,
    *,
    progress: Callable[[int], None] | None = None,
    keep: Callable[[FollowState], None] | None = None,
    states: Sequence[FollowState] = (),
) -> Followed:
    """Windows of a sequence's frames followed through the frames after them.

    Parameters
    ----------
    sources : sequence of ImageSource or None
        Frames in the order they were taken, all of one size; None where there is none.
    plan : FollowPlan, optional
    progress : callable, optional
        Called with the number of frames done.
    keep : callable, optional
        Called every few hundred frames with where following stands.
    states : sequence of FollowState
        All that were kept of these frames by an earlier call, from the first on: where to go on from.

    Returns
    -------
    Followed
        The same, bit for bit, wherever it went on from.

    Raises
    ------
    InputError
        If frames differ in size.
    """
    plan = FollowPlan() if plan is None else plan
    count = len(sources)
    reader = _Reader(sources, plan)
    follower = _Follower(reader, plan, count)
    sharpness, contrast = np.full(count, np.nan), np.full(count, np.nan)
    reason = [""] * count
    waiting: _Frame | None = None
    begin = 0
    if states:
        follower.go_on(states)
        state = states[-1]
        begin, sharpness, contrast = state.number, np.array(state.sharpness), np.array(state.contrast)
        reason = list(state.reason)
        waiting = reader.read(state.waiting) if state.waiting >= 0 else None
    kept = len(follower.image)
    for number in range(begin, count):
        if number > begin and number % _KEPT == 0:
            follower.merge(kept)
            if keep is not None:
                fields = follower.state(number, -1 if waiting is None else waiting.number, kept)
                copies = sharpness.copy(), contrast.copy(), tuple(reason)
                keep(FollowState(**fields, sharpness=copies[0], contrast=copies[1], reason=copies[2]))
            kept = len(follower.image)
        frame = reader.read(number)
        if progress is not None:
            progress(number + 1)
        if frame is None:
            reason[number] = "the image cannot be read"
            continue
        sharpness[number], contrast[number] = frame.sharpness, frame.contrast
        if follower.last is None:
            follower.begin(frame)
        elif follower.link(frame):
            waiting = None
        else:
            reason[number] = "looks like none of the frames before it"
            # what was stepped over begins a new stretch where it is like this frame
            if waiting is not None and follower.restart(waiting, frame):
                reason[number] = reason[waiting.number] = ""
                waiting = None
            else:
                waiting = frame
    follower.end()
    return _assembled(follower, sharpness, contrast, reason)


def _stacked(parts: Sequence[NDArray[Any]], empty: tuple[int, ...], kind: type) -> NDArray[Any]:
    """Arrays one after the other; an array of shape `empty` where there is none."""
    return np.concatenate(parts) if len(parts) else np.empty(empty, kind)


def _taken(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Arrays one after the other, taken from the list, so that they are held once."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole


def _sorted(values: NDArray[Any], order: NDArray[np.intp]) -> NDArray[Any]:
    """Read-only rows in an order."""
    out = values[order]
    out.setflags(write=False)
    return out


def _assembled(follower: _Follower, sharpness: Array, contrast: Array, reason: list[str]) -> Followed:
    """What was found, in pixels of the frames as they are."""
    k = follower.plan.reduction
    if not follower.image:
        raise EstimationError(NOTHING)
    image, point, pixels, variance = (_taken(getattr(follower, name)) for name in _SIGHTED)
    order = np.lexsort((image, point))
    windows = np.bincount(image, minlength=len(sharpness))
    for number in np.flatnonzero((windows == 0) & np.isfinite(sharpness)):
        reason[number] = reason[number] or "looks like none of the frames after it"
    return Followed(
        _sorted(image, order),
        _sorted(point, order),
        _sorted(whole_pixels(pixels, k), order),
        _sorted(np.sqrt(variance) * k, order),
        follower.before,
        frozen(follower.motion * np.array([k, k, 1.0, 1.0])),
        windows,
        frozen(sharpness),
        frozen(contrast),
        tuple(reason),
    )
