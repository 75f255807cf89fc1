"""Where to put detectors, or which lines of one to use, so that a band of jitter is seen (S1, claims 21, 23).

The best places for the worst frequency of a band, the best for the whole motion, and what lies between, each
beside the user's own layout and published ones: information, posterior sigma, blind frequencies, common lags.

Not here: the search (``motion/layout/search.py``), what the numbers mean (``motion/layout/information.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.expected_cost import Cost, search_cost
from sightline.errors import InputError, computes
from sightline.estimation.prior import Matern, Spectrum
from sightline.execution import Progress, one_blas_thread, silent
from sightline.motion.layout.information import (
    BlindFrequency,
    CommonLags,
    RowNoise,
    blind_frequencies_of,
    checked_passband,
    common_lags,
    information,
    listed_up_to,
    worst_case,
)
from sightline.motion.layout.search import (
    Candidates,
    Found,
    choices,
    polished,
    search_layouts,
)
from sightline.motion.layout.sigma import harmonic_sigma, least_sigma, smoother_sigma
from sightline.result import Result, makes_result, one_line

Array = NDArray[np.float64]

#: Free places are sought on a grid of so many steps per period of the band's upper end, then moved off it.
STEPS_PER_PERIOD = 32
#: Most places of such a grid; a longer focal plane takes a coarser one, down to the least steps per period.
MOST_PLACES, LEAST_STEPS = 4000, 8
#: Images' worth below which a layout counts as blind at its worst frequency.
BLIND_IMAGES = 1e-6
#: What TDI leaves of a motion that it is said to average away.
UNSEEN = 1e-6
#: Layouts with less than this part of the best worst case are listed only where they stand out.
WORTH_LISTING = 0.01
#: Layouts count as one where no detector is further apart than this part of a period of the upper end.
SAME = 0.25
#: Spans whose best layouts are listed beside the best of all.
LISTED_SPANS = 6
#: Epochs of the smoother's grid per period of the upper end, and the work (n b^2) up to which it is asked.
EPOCHS_PER_PERIOD, SMOOTHER_WORK = 10.0, 2.0e9
#: The same of a node and of a row of a pair, which take 3 kB and 100 bytes: 2 GB at most.
_NODE_WORK, _ROW_WORK = 3000.0, 100.0
#: Periods of the band's width that a layout to be judged may span: stereo cameras look a minute apart.
MOST_PERIODS = 100_000
#: A motion to judge by where none is given: px, s, and a corner at the band's upper end.
DRIFT, BROADBAND = Matern(2.0, 1.0, "5/2"), 0.1
#: Names of the layouts that stand out.
BEST, BALANCED = "best in the band", "balanced"
FULL_SPAN, LEAST_SIGMA = "best of the full span", "least sigma"
#: Balanced: the least sigma among layouts with this part of the best one's worst-case information.
BALANCED_SHARE = 0.75


@dataclass(frozen=True, eq=False)
class NamedLayout:
    """A layout to compare with.

    Attributes
    ----------
    name : str
    positions : (n,)
        s; when each detector sees the ground.
    source : str
        "yours" or "published".
    """

    name: str
    positions: Array
    source: str = "yours"


#: Layouts in the literature. ASTER SWIR: Teshima, Iwasaki (2008), six lines; ZY-3: four lines of its
#: multispectral camera; S1: the lags of its fig. 13, of which the order is inferred.
PUBLISHED = (
    NamedLayout("S1, fig. 13", np.array([0.0, 0.1500, 0.1574, 0.1722]), "published"),
    NamedLayout("ZY-3", np.array([0.0, 0.1216, 0.2240, 0.3264]), "published"),
    NamedLayout("ASTER SWIR", 0.356 * np.arange(6.0), "published"),
)


@dataclass(frozen=True, eq=False, repr=False)
class FocalPlane:
    """What an instrument designer knows before the detectors have places.

    Attributes
    ----------
    focal_length_px : float
        Focal length / pixel pitch.
    line_period : float
        s.
    ground_rate_px : float
        Pixels per second at which the ground crosses the focal plane: lag = separation / this.
    image_sigma_px : tuple of float
        Error of each image per row of windows, one per detector: a match has the variances of both.
    span_px : float
        Most distance between the first and the last detector.
    min_spacing_px : float
        Least between neighbours.
    step_px : float or None
        Places are multiples of it; None: any place will do.
    lines : (G,) or None
        px; in place of span, spacing and step: the lines of one detector to choose from.
    window_lines, step_lines : float
        Lines that a row of windows spans, and lines from one row to the next.
    stages : tuple of int
        TDI stages of each image, which averages the motion over as many line periods; empty: no TDI.
    prior : Spectrum or None
        Of the motion, px.
    duration : float or None
        s; of a strip. None: 20 periods of the band's lower end, 2 s at least.
    layouts : tuple of NamedLayout
        The user's own.
    name : str
    """

    focal_length_px: float
    line_period: float
    ground_rate_px: float
    image_sigma_px: tuple[float, ...]
    span_px: float
    min_spacing_px: float = 1.0
    step_px: float | None = None
    lines: Array | None = None
    window_lines: float = 1.0
    step_lines: float = 1.0
    stages: tuple[int, ...] = ()
    prior: Spectrum | None = None
    duration: float | None = None
    layouts: tuple[NamedLayout, ...] = ()
    name: str = "instrument"

    def __repr__(self) -> str:
        """One line."""
        places = f"a span of {self.span_px:g} px" if self.lines is None else f"{len(self.lines)} lines"
        facts = {"": repr(self.name), "detectors": f"{self.detectors} within {places}"}
        rate = f"{self.ground_rate_px:g} px/s"
        return one_line("FocalPlane", facts | {"line period": f"{self.line_period:g} s", "ground at": rate})

    @property
    def detectors(self) -> int:
        """How many have to be placed."""
        return len(self.image_sigma_px)

    @property
    def row_rate(self) -> float:
        """Hz; at which rows of windows sample the motion: half of it is the highest frequency spoken of."""
        return 1.0 / (self.step_lines * self.line_period)

    @property
    def noise(self) -> RowNoise:
        """Of its images; rows that overlap hold no more than rows that touch."""
        window = self.window_lines * self.line_period
        some = any(count > 1 for count in self.stages)
        # a single stage is an instant, as a line is
        times = (count * self.line_period if count > 1 else 0.0 for count in self.stages)
        return RowNoise(
            self.image_sigma_px,
            max(window, 1.0 / self.row_rate),
            window if self.window_lines > 1.0 else 0.0,
            tuple(times) if some else (),
        )

    def noise_of(self, detectors: int) -> RowNoise:
        """The same, of a layout that may have another number of detectors.

        Then all are of the mean variance and the longest TDI.
        """
        noise = self.noise
        if detectors == self.detectors:
            return noise
        mean = math.sqrt(float(np.mean(np.square(self.image_sigma_px))))
        tdi = (max(noise.tdi),) * detectors if noise.tdi else ()
        return replace(noise, sigma_px=(mean,) * detectors, tdi=tdi)

    def candidates(self, upper: float) -> Candidates:
        """Places to choose from, in s, for a band that ends at `upper` (Hz)."""
        rate = self.ground_rate_px
        if self.lines is not None:
            t = np.sort(self.lines) / rate
            even = len(t) > 1 and bool(np.ptp(np.diff(t)) <= 1e-9 * float(np.ptp(t)))
            return Candidates(t - t[0], self.min_spacing_px / rate, even)
        span = self.span_px / rate
        step = max(1.0 / (STEPS_PER_PERIOD * upper), span / MOST_PLACES)
        if self.step_px is not None:
            step = self.step_px / rate
        elif span > 0.0:
            step = span / math.ceil(span / step)  # the last place is the end of the span
        return Candidates.even_grid(span, step, self.min_spacing_px / rate)


@dataclass(frozen=True, eq=False)
class JudgedLayout:
    """A layout and how well it would see a motion.

    Attributes
    ----------
    name : str
    source : str
        "found", "yours" or "published".
    positions : (n,)
        s, increasing.
    order : tuple of int
        Which image (number in `FocalPlane.image_sigma_px`) stands at each place.
    noise : RowNoise
        In the order of the places.
    worst_information : float
        px^-2 per row, at the worst frequency of the band.
    worst_images : float
        The same in units of one image of mean weight: at most their number.
    worst_frequency : float
        Hz.
    sigma_px : float
        Posterior sigma of the motion less its mean, rms over the strip, ends included: by the smoother.
    harmonic_sigma_px : float
        The same without ends, frequency by frequency.
    band_sigma_px : float
        Of the part of the motion within the band, without ends.
    blind : tuple of BlindFrequency
        Where all pairs go blind.
    common : tuple of CommonLags
        Lags nearly as small whole numbers.
    """

    name: str
    source: str
    positions: Array
    order: tuple[int, ...]
    noise: RowNoise
    worst_information: float
    worst_images: float
    worst_frequency: float
    sigma_px: float
    harmonic_sigma_px: float
    band_sigma_px: float
    blind: tuple[BlindFrequency, ...]
    common: tuple[CommonLags, ...]

    @property
    def span(self) -> float:
        """s."""
        return float(self.positions[-1] - self.positions[0])

    @property
    def blind_in_band(self) -> bool:
        """Whether it sees nothing worth the name at some frequency of the band."""
        return self.worst_images < BLIND_IMAGES

    def information(self, frequency: Array) -> Array:
        """Information at each frequency (Hz), px^-2 per row, (F,)."""
        return information(frequency, self.positions, self.noise)


@dataclass(frozen=True, eq=False, repr=False)
class LayoutChoice(Result):
    """Ranked layouts of an instrument for a band.

    Attributes
    ----------
    focal_plane : FocalPlane
    passband : (low, high)
        Hz.
    prior : Spectrum
        By which sigma was judged, px.
    duration : float
        s; of the strip.
    ranked : tuple of JudgedLayout
        The largest worst-case information first.
    compared : tuple of JudgedLayout
        The user's layouts, then the published ones.
    spans, worst_by_span, sigma_by_span : (B,)
        s; px^-2 per row; px (harmonic): the layout of best worst case of each span.
    highest : float
        Hz; up to where blind frequencies were sought.
    tried : float
        Layouts gone through.
    exhaustive : bool
        Whether those were all on the grid.
    warnings : tuple of str
    """

    focal_plane: FocalPlane
    passband: tuple[float, float]
    prior: Spectrum
    duration: float
    ranked: tuple[JudgedLayout, ...]
    compared: tuple[JudgedLayout, ...]
    spans: Array
    worst_by_span: Array
    sigma_by_span: Array
    highest: float
    tried: float
    exhaustive: bool
    warnings: tuple[str, ...] = field(default=())

    @property
    def best(self) -> JudgedLayout:
        """Of the largest worst-case information."""
        return self.ranked[0]


@makes_result
@one_blas_thread
@computes("layouts")
def choose_layout(
    focal_plane: FocalPlane,
    passband: Sequence[float],
    *,
    count: int = 10,
    exhaustive: bool | None = None,
    progress: Progress | None = None,
) -> LayoutChoice:
    """Places of the detectors that see a band of jitter best, ranked, beside other layouts.

    Parameters
    ----------
    focal_plane : FocalPlane
    passband : (low, high)
        Hz.
    count : int
        Best layouts listed, besides the best of some spans and the one of least sigma.
    exhaustive : bool, optional
        Go through all choices or not; by default where there are no more than a thousand million.
    progress : callable
        Called with what is being done, in words.

    Returns
    -------
    LayoutChoice

    Raises
    ------
    InputError
        If the detectors do not fit, or the band is not one that rows of matches can sample.

    Examples
    --------
    >>> plane = FocalPlane(1e6, 5e-4, 2000.0, (0.02, 0.02, 0.02), span_px=40.0)
    >>> choice = choose_layout(plane, (40.0, 150.0), count=1)
    >>> choice.exhaustive, round(choice.best.worst_images, 2)
    (True, 2.49)
    """
    low, high = _checked_band(focal_plane, passband)
    if count < 1:
        raise InputError(f"`count` must be 1 or more, got {count}")
    prior, duration, warnings = _believed(focal_plane, low, high)
    candidates, noise = focal_plane.candidates(high), focal_plane.noise
    search_cost(candidates, noise).check()
    tell = progress or silent
    tell(f"seeking among {choices(candidates, noise):.3g} layouts")
    found = search_layouts(candidates, noise, (low, high), exhaustive=exhaustive)
    judge = _Judge(focal_plane, (low, high), prior, duration)
    tell("judging the layouts found")
    chosen = _shortlist(focal_plane, candidates, found, (low, high), prior, duration, count)
    ranked = [judge(name, "found", positions, order) for name, positions, order in chosen]
    ranked = _named(sorted(ranked, key=lambda layout: -layout.worst_information))
    compared = [judge(own.name, own.source, own.positions) for own in (*focal_plane.layouts, *PUBLISHED)]
    spans, worst, sigma = _by_span(focal_plane, candidates, found, prior, duration)
    if not found.exhaustive:
        warnings.append(
            f"there are {choices(candidates, noise):.2g} layouts, too many to go through: no move of one or "
            "two detectors betters the best one found, but another layout may"
        )
    return LayoutChoice(
        focal_plane, (low, high), prior, duration, tuple(ranked), tuple(compared), spans, worst, sigma,
        judge.highest, found.tried, found.exhaustive, tuple(warnings + judge.warnings),
    )  # fmt: skip


def layout_cost(plane: FocalPlane, passband: tuple[float, float] | None = None) -> Cost:
    """Of ``choose_layout``; without a pass-band, of the widest that the rows of matches can sample."""
    return search_cost(
        plane.candidates(0.5 * plane.row_rate if passband is None else passband[1]), plane.noise
    )


def _checked_band(plane: FocalPlane, passband: Sequence[float]) -> tuple[float, float]:
    """The band, refused where rows of matches do not sample it or their windows hide it."""
    low, high = checked_passband(passband)
    span = plane.span_px / plane.ground_rate_px
    if plane.step_px is None and plane.lines is None and span * high * LEAST_STEPS > MOST_PLACES:
        raise InputError(
            f"the focal plane is {span * high:.0f} periods of {high:g} Hz long, the search holds "
            f"{MOST_PLACES / LEAST_STEPS:.0f} at most; lower the band, shorten the span or give step_px"
        )
    for own in plane.layouts:
        periods = float(np.ptp(own.positions)) * (high - low)
        if periods > MOST_PERIODS:
            raise InputError(
                f"[[layout]] {own.name!r} spans {np.ptp(own.positions):.4g} s, {periods:.3g} periods of the "
                f"band's width; {MOST_PERIODS:,} are allowed: are its positions, and ground_rate_px, right?"
            )
    if high > 0.5 * plane.row_rate:
        raise InputError(
            f"the pass-band ends at {high:g} Hz, but rows of matches every {1e3 / plane.row_rate:g} ms "
            f"sample motion up to {0.5 * plane.row_rate:g} Hz; lower the band, step_lines or line_period"
        )
    if plane.noise.window > 0.0 and high >= 1.0 / plane.noise.window:
        raise InputError(
            f"the pass-band ends at {high:g} Hz, but windows of {1e3 * plane.noise.window:g} ms average "
            f"motion away at {1.0 / plane.noise.window:g} Hz; lower the band or window_lines"
        )
    _check_tdi(plane, low, high)
    return low, high


def _check_tdi(plane: FocalPlane, low: float, high: float) -> None:
    """Refuse a band in which there is a frequency that the TDI of every image averages away."""
    noise = plane.noise
    if not noise.tdi or min(noise.tdi) == 0.0:
        return
    least = min(noise.tdi)
    first, last = math.ceil(low * least * (1.0 - 1e-9)), math.floor(high * least * (1.0 + 1e-9))
    hidden = np.arange(max(first, 1), last + 1) / least
    hidden = hidden[(np.abs(noise.seen(hidden)) < UNSEEN).all(axis=0)]
    if len(hidden):
        counts = " and ".join(str(count) for count in sorted(set(plane.stages)))
        raise InputError(
            f"the pass-band {low:g} to {high:g} Hz holds {hidden[0]:.6g} Hz, which TDI of {counts} stages "
            f"averages away in every image (k / (stages x line_period)); move the band, or give fewer stages"
        )


def _believed(plane: FocalPlane, low: float, high: float) -> tuple[Spectrum, float, list[str]]:
    """Prior and duration to judge by, and what to say of them."""
    duration = max(2.0, 20.0 / low) if plane.duration is None else plane.duration
    if plane.prior is not None:
        return plane.prior, duration, []
    broadband = Matern(BROADBAND, math.sqrt(3.0) / (2.0 * math.pi * high), "3/2")
    said = (
        f"no prior of the motion is given: sigmas are for a drift of {DRIFT.sigma:g} px over "
        f"{DRIFT.timescale:g} s and broadband jitter of {BROADBAND:g} px up to {high:g} Hz; give [[prior]]"
    )
    return Spectrum((DRIFT, broadband)), duration, [said]


def _named(ranked: list[JudgedLayout]) -> list[JudgedLayout]:
    """The same list with the best and the balanced layout named, the latter unless it stands out already."""
    ranked = [replace(ranked[0], name=BEST), *ranked[1:]]
    enough = BALANCED_SHARE * ranked[0].worst_information
    balanced = min((x for x in ranked if x.worst_information >= enough), key=lambda x: x.sigma_px)
    return [replace(x, name=BALANCED) if x is balanced and not x.name else x for x in ranked]


class _Judge:
    """Makes a JudgedLayout of positions; remembers what it could not do."""

    def __init__(
        self, plane: FocalPlane, passband: tuple[float, float], prior: Spectrum, duration: float
    ) -> None:
        self.plane, self.passband, self.prior, self.duration = plane, passband, prior, duration
        self.highest = min(2.0 * passband[1], 0.5 * plane.row_rate)
        self.endless: dict[str, list[str]] = {}
        self.cut: list[str] = []

    @property
    def warnings(self) -> list[str]:
        """What was left out, and of which layouts."""
        return [
            f"sigma leaves out the ends, a strip of {self.duration:g} s being too {why}: {', '.join(names)}"
            for why, names in self.endless.items()
        ] + self.cut

    def __call__(
        self, name: str, source: str, positions: Array, order: Sequence[int] | None = None
    ) -> JudgedLayout:
        noise = self.plane.noise_of(len(positions))
        along = np.argsort(positions) if order is None else np.asarray(order)
        positions = np.sort(positions)
        noise = noise.ordered(along)
        worst, at = worst_case(positions, self.passband, noise)
        harmonic = harmonic_sigma(positions, noise, self.prior, self.duration)
        listed = listed_up_to(positions, self.highest)
        if listed < self.highest:
            self.cut.append(
                f"blind frequencies of {name or 'a layout'} are listed up to {listed:.4g} Hz: beyond, its "
                "lags hold too many periods to be read"
            )
        return JudgedLayout(
            name=name,
            source=source,
            positions=positions,
            order=tuple(int(k) for k in along),
            noise=noise,
            worst_information=worst,
            worst_images=worst / float(noise.weights.mean()),
            worst_frequency=at,
            sigma_px=self._smoothed(name, positions, noise, harmonic),
            harmonic_sigma_px=harmonic,
            band_sigma_px=harmonic_sigma(positions, noise, self.prior, self.duration, passband=self.passband),
            blind=blind_frequencies_of(positions, listed, noise.tdi),
            common=common_lags(positions, listed),
        )

    def _smoothed(self, name: str, positions: Array, noise: RowNoise, harmonic: float) -> float:
        """Rms of the smoother's sigma over the strip; the harmonic one where that would take too long."""
        wanted, span = 1.0 / (EPOCHS_PER_PERIOD * self.passband[1]), float(np.ptp(positions))
        whole = noise.period / wanted  # nodes between rows, or rows between nodes
        step = noise.period / math.ceil(whole) if whole > 1.0 else noise.period * math.floor(1.0 / whole)
        nodes, rows = self.duration / step, (self.duration + span) / noise.period
        work = max(nodes * (span / step) ** 2, _NODE_WORK * nodes, _ROW_WORK * rows * len(positions) ** 2)
        if self.duration <= 2.0 * span or work > SMOOTHER_WORK:
            why = "short for their span" if self.duration <= 2.0 * span else "long for the smoother"
            self.endless.setdefault(why, []).append(name or f"{1e3 * span:.4g} ms of span")
            return harmonic
        _, sigma = smoother_sigma(positions, noise, self.prior, self.duration, step=step)
        return math.sqrt(float(np.mean(sigma**2)))


class _Shortlist:
    """Layouts to list, no two alike: positions in s from the first place, moved off the grid where places are
    free."""

    def __init__(self, plane: FocalPlane, candidates: Candidates, passband: tuple[float, float]) -> None:
        self.plane, self.candidates, self.passband = plane, candidates, passband
        self.free = plane.step_px is None and plane.lines is None
        self.entries: list[tuple[str, Array, tuple[int, ...]]] = []

    def noise(self, order: Sequence[int]) -> RowNoise:
        """Of the images in this order."""
        return self.plane.noise.ordered(order)

    def holds(self, positions: Array, order: Sequence[int]) -> bool:
        """Whether a layout like this is listed."""
        same = SAME / self.passband[1]
        kinds, mirrored = self.noise(order).kinds, positions[0] + positions[-1] - positions[::-1]
        return any(
            (kinds == self.noise(o).kinds and np.abs(positions - p).max() < same)
            or (kinds[::-1] == self.noise(o).kinds and np.abs(mirrored - p).max() < same)
            for _, p, o in self.entries
        )

    def add(
        self,
        name: str,
        positions: Array,
        order: Sequence[int],
        *,
        fixed_span: bool = False,
        move: bool = True,
    ) -> None:
        """Polish a layout and list it, unless one like it is listed before or after."""
        if self.holds(positions, order):
            return
        t = self.candidates.t
        if self.free and move:
            positions = polished(
                positions, self.noise(order), self.passband, step=float(t[1] - t[0]), span=float(t[-1]),
                min_spacing=self.candidates.min_spacing, fixed_span=fixed_span,
            )  # fmt: skip
            if self.holds(positions, order):
                return
        self.entries.append((name, positions, tuple(int(k) for k in order)))


def _shortlist(
    plane: FocalPlane,
    candidates: Candidates,
    found: Found,
    passband: tuple[float, float],
    prior: Spectrum,
    duration: float,
    count: int,
) -> list[tuple[str, Array, tuple[int, ...]]]:
    """Name, positions (s) and order of the layouts to list: the best, some spans' best, of least sigma."""
    listed = _Shortlist(plane, candidates, passband)
    for row in _apart(candidates.t[found.places], found.order, SAME / passband[1], 3 * count):
        if len(listed.entries) < count and found.worst[row] >= WORTH_LISTING * found.worst[0]:
            listed.add("", candidates.t[found.places[row]], found.order[row])
    seen = np.flatnonzero(np.isfinite(found.by_span))
    enough = seen[found.by_span[seen] >= BALANCED_SHARE * found.worst[0]]
    longest = enough[-1] if len(enough) else seen[-1]
    listed.add("", candidates.t[found.by_span_places[longest]], found.by_span_order[longest])
    wanted = np.geomspace(max(seen[0], 1), max(seen[-1], 1), LISTED_SPANS)
    for row in np.unique(seen[np.clip(np.searchsorted(seen, wanted), 0, len(seen) - 1)]):
        full = bool(row == seen[-1])
        if not full and found.by_span[row] < WORTH_LISTING * found.worst[0]:
            continue
        positions, order = candidates.t[found.by_span_places[row]], found.by_span_order[row]
        listed.add(FULL_SPAN if full else "", positions, order, fixed_span=full)

    def sigma(entry: tuple[str, Array, tuple[int, ...]]) -> float:
        return harmonic_sigma(entry[1], listed.noise(entry[2]), prior, duration)

    _, positions, kept = min(listed.entries, key=sigma)
    calm = least_sigma(positions, candidates, listed.noise(kept), prior, duration)
    along = np.argsort(calm)
    listed.add(LEAST_SIGMA, calm[along], [kept[k] for k in along], move=False)
    return listed.entries


def _apart(positions: Array, orders: NDArray[np.int64], same: float, count: int) -> list[int]:
    """Rows of the first `count` layouts (K, n), best first, that are not like a better one."""
    open_rows = np.ones(len(positions), dtype=bool)
    rows: list[int] = []
    while open_rows.any() and len(rows) < count:
        row = int(np.argmax(open_rows))
        rows.append(row)
        alike = (np.abs(positions - positions[row]).max(axis=1) < same) & (orders == orders[row]).all(axis=1)
        open_rows &= ~alike
    return rows


def _by_span(
    plane: FocalPlane, candidates: Candidates, found: Found, prior: Spectrum, duration: float
) -> tuple[Array, Array, Array]:
    """Span (s), worst-case information (px^-2 per row) and harmonic sigma (px) of the best of each span."""
    seen = np.flatnonzero(np.isfinite(found.by_span))
    shown = np.unique(np.linspace(0, len(seen) - 1, min(len(seen), 80)).round().astype(int))
    seen = seen[np.union1d(shown, [np.argmax(found.by_span[seen])])]
    positions = candidates.t[found.by_span_places[seen]]
    sigma = [
        harmonic_sigma(p, plane.noise.ordered(order), prior, duration)
        for p, order in zip(positions, found.by_span_order[seen], strict=True)
    ]
    return positions[:, -1] - positions[:, 0], found.by_span[seen], np.array(sigma)
