"""What would have two bands match that do not as they are given: one mistake in the description of either.

Tried are lags of the other sign, images of other bands, columns or lines that run the other way, a
magnification some per cent off, and lags of another length. Not here: where it is said (``warnings.py``,
``applications/line_of_sight.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.matching.match_images import match_images
from sightline.matching.matches import OUTSIDE
from sightline.motion.band import Band
from sightline.motion.measure.laid_strips import groups_of_pixels, pixel_sizes
from sightline.motion.measure.windows import window_grid

Array = NDArray[np.float64]

#: Windows (lines, columns) px at most, and how many must lie on both images to prove anything.
WINDOW, FEWEST = (32, 100), 10
#: Windows that are tried at most: evenly spread; where there are fewer than so many, rows of them overlap by
#: half: a short strip with a long lag has fewer than FEWEST on both images.
MOST, FULL = 400, 40
#: Share of the windows on both images that match where bands belong together, and by how much it must exceed
#: that of bands as they are given: of FEWEST windows shares scatter by up to .16.
ENOUGH, BETTER = 0.5, 0.2
#: Lags up to so many times the one given are tried, or so many lines, by so many windows, in steps of so many
#: px each way.
FARTHEST, LEAST_FARTHEST, FEW, SCAN = 2.5, 1000.0, 50, 32
#: Partners that must show it before one cause is found for several bands.
SEVERAL = 2
#: Relative errors of a magnification: 3 % of a focal length, in steps by which a window is stretched by less
#: than it may be and still match.
SCALES = tuple(sign * step for step in (0.005, 0.01, 0.015, 0.02, 0.025, 0.03) for sign in (1.0, -1.0))


@dataclass(frozen=True, eq=False)
class Reversed:
    """An image whose lines (axis 0) or columns (axis 1) run the other way."""

    source: ImageSource
    axis: int

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, columns)."""
        return self.source.shape

    def read(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.float32]:
        """Pixels of a window, turned round."""
        return np.ascontiguousarray(np.flip(self.source.read(*self._there(lines, columns)), self.axis))

    def mask(self, lines: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Unusable pixels of a window, turned round."""
        mask = self.source.mask(*self._there(lines, columns))
        return None if mask is None else np.ascontiguousarray(np.flip(mask, self.axis))

    def _there(
        self, lines: tuple[int, int], columns: tuple[int, int]
    ) -> tuple[tuple[int, int], tuple[int, int]]:
        size = self.shape[self.axis]
        if self.axis == 0:
            return (size - lines[1], size - lines[0]), columns
        return lines, (size - columns[1], size - columns[0])


class Cause(NamedTuple):
    """Why bands do not match, as a sentence without its end; which ones, and how many pairs it explains."""

    words: str = ""
    bands: tuple[str, ...] = ()
    pairs: int = 0


def mistake(bands: Sequence[Band], surface: Surface, search_px: tuple[int, int]) -> str:
    """What must be otherwise for the bands to match the first, as a sentence without its end; "" if unknown.

    Parameters
    ----------
    bands : sequence of Band
        With their nominal cameras; as they are given they do not match.
    surface : Surface
        What the lines of sight meet.
    search_px : (lines, columns)
        px; half-range of the search about each place tried.
    """
    hub, *partners = bands = _coarsest_first(bands)
    pairs = [_Pair.of(hub, partner, surface, search_px) for partner in partners]
    turned, moved = _on_the_other_side(pairs), exchanged_bands(bands, surface, search_px)
    # either may be: of lags alike on both sides
    most = max(turned.pairs, moved.pairs)
    words = [cause.words for cause in (turned, moved) if cause.words and cause.pairs == most]
    if words:
        return "; or ".join(words)
    said = (
        (partner.name, alternative(hub, partner, surface, search_px, either=True)) for partner in partners
    )
    return next((f"{name}: {words}" for name, words in said if words), "")


def exchanged_bands(bands: Sequence[Band], surface: Surface, search_px: tuple[int, int]) -> Cause:
    """Which bands have each other's images, if those of more than one pair match when they are put right.

    Of several such orders that by which most pairs match: of bands in reverse order two alone seem to do.
    Parameters are those of `mistake`.
    """
    best, bands = Cause(), _coarsest_first(bands)
    if len(bands) < 3:
        return best  # two change places as their lag changes its sign
    places = range(len(bands))
    pairs = {k: _Pair.of(bands[0], bands[k], surface, search_px) for k in places[1:]}
    given = {k: pair.matches() for k, pair in pairs.items()}
    orders: list[tuple[int, ...]] = list(combinations(places, 2))
    if len(bands) > 3:  # of fewer, two change places
        orders.append(tuple(places))
    for moved in orders:
        if len({bands[k].image.shape for k in moved}) > 1:
            continue
        order = dict(zip(moved, reversed(moved), strict=True))
        put = [replace(band, image=bands[order.get(k, k)].image) for k, band in enumerate(bands)]
        # the pairs with the first band in which an image is another
        changed = {
            k: replace(pair, hub=put[0], partner=put[k])
            for k, pair in pairs.items()
            if 0 in moved or k in moved
        }
        if not all(changed[k].matches() for k in moved if k):
            continue
        fits = given | {k: k in moved or pair.matches() for k, pair in changed.items()}
        good = [k for k in changed if fits[k]]
        # some of the others may look like nothing, but none gets lost
        if len(good) < SEVERAL or any(given[k] and not fits[k] for k in changed):
            continue
        count = sum(fits.values())
        # where all of them match as given, lags are alike, and either order may be
        if all(given[k] for k in good) or count <= best.pairs:
            continue
        names = tuple(bands[k].name for k in moved)
        if len(moved) > 2:
            words = "the images match in the reverse order: give the files of all bands from last to first"
        else:
            one, other = names
            words = f"the image of {one} matches as that of {other}, and {other}'s as {one}'s: exchange them"
        best = Cause(words, names, count)
    return best


def alternative(
    hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int], *, either: bool = False
) -> str:
    """What must be otherwise for `partner` to match `hub`, as the end of a sentence about it; "" if unknown.

    Parameters are those of `mistake`, of two bands; `either`: the mistake may be that of `hub` as well, which
    no other band matches.
    """
    pair = _Pair.of(hub, partner, surface, search_px)
    given, _ = pair.found(pair.there)
    best, words = max(given + BETTER, ENOUGH), ""
    for image, predicted, stretch, said in _tried(pair, either):
        share, _ = pair.found(predicted, image, stretch)
        if share > best:
            best, words = share, said
    return words or ("" if given > ENOUGH else _farther(pair))


@dataclass(frozen=True, eq=False)
class _Pair:
    """Windows of a band, and where its partner should show them.

    `points`, `there` (N, 2) px; `step` (2,): px of the partner per px of the hub, as the cameras have them;
    `at_once` (N, 2) px: where the partner would show the same without a lag: lines begin together, columns
    share their middle.
    """

    hub: Band
    partner: Band
    size: tuple[int, int]
    search_px: tuple[int, int]
    points: Array
    there: Array
    step: Array
    at_once: Array

    @classmethod
    def of(cls, hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int]) -> _Pair:
        size = (min(WINDOW[0], hub.image.shape[0]), min(WINDOW[1], hub.image.shape[1]))
        points = window_grid(hub.image.shape, size, size[0]).centres
        if len(points) < FULL:
            points = window_grid(hub.image.shape, size, max(size[0] // 2, 1)).centres
        points = points[np.linspace(0, len(points) - 1, min(len(points), MOST)).astype(int)]
        there = predict_match(hub.camera, partner.camera, surface, points)
        of_hub, of_partner = pixel_sizes([hub.camera, partner.camera])
        step = of_hub / of_partner
        at_once = step * points
        at_once[:, 1] += (partner.camera.columns - 1) / 2.0 - step[1] * (hub.camera.columns - 1) / 2.0
        return cls(hub, partner, size, search_px, points, there, step, at_once)

    @property
    def lag(self) -> Array:
        """(2,) px; how far the partner shows the ground from where it would without a lag; NaN if nowhere."""
        has = np.isfinite(self.there).all(axis=1)
        return np.asarray(np.median((self.there - self.at_once)[has], axis=0) if has.any() else [np.nan] * 2)

    @property
    def far(self) -> bool:
        """Whether the two signs of the lag are not searched at once."""
        return bool(abs(self.lag[0]) >= 2 * self.search_px[0])

    @property
    def other_side(self) -> Array:
        """(N, 2) px; where windows are if the lag has the other sign, outside what the cameras say too."""
        return np.asarray(self.at_once - self.lag)

    def found(
        self,
        predicted: Array,
        image: ImageSource | None = None,
        stretch: float = 1.0,
        search_px: tuple[int, int] | None = None,
    ) -> tuple[float, Array]:
        """Share of the windows on both images that match about `predicted`, 0 where too few are; their lag.

        `image`: in place of the partner's; `stretch`: how much wider windows are in it. The lag (2,) px is
        that of the windows which match, as `lag` is that of the cameras.
        """
        nothing = 0.0, np.full(2, np.nan)
        has = np.isfinite(predicted).all(axis=1)
        affine = np.broadcast_to(np.diag(self.step * [1.0, stretch]), (int(has.sum()), 2, 2)).copy()
        try:
            matches = match_images(
                self.hub.image,
                self.partner.image if image is None else image,
                self.points[has],
                predicted[has],
                window=self.size,
                search_px=search_px or self.search_px,
                affine=affine,
            )
        except EstimationError:
            return nothing
        inside, kept = matches.status != OUTSIDE, matches.kept
        if inside.sum() < FEWEST or not kept.any():
            return nothing
        lag = np.median((matches.b - self.at_once[has])[kept], axis=0)
        return float(kept.sum() / inside.sum()), np.asarray(lag)

    def matches(self, predicted: Array | None = None) -> bool:
        """Whether most windows match there; where the cameras say if not given."""
        return self.found(self.there if predicted is None else predicted)[0] > ENOUGH


def _coarsest_first(bands: Sequence[Band]) -> list[Band]:
    """The same with the first of the coarsest pixels in front: windows of finer ones hold too few of them."""
    first = groups_of_pixels([band.camera for band in bands]).index(0)
    return [bands[first], *bands[:first], *bands[first + 1 :]]


def agree(hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int]) -> bool:
    """Whether two bands match where the cameras say. Parameters are those of `mistake`."""
    return _Pair.of(hub, partner, surface, search_px).matches()


def _on_the_other_side(pairs: Sequence[_Pair]) -> Cause:
    """What that means where lags of several pairs have the other sign, and none the one given."""
    turned = [pair for pair in pairs if pair.matches(pair.other_side)]
    # a lag shorter than the search may have either sign
    sure = [pair for pair in turned if pair.far or not pair.matches()]
    if len(sure) < SEVERAL or any(pair.matches() for pair in pairs if pair not in turned):
        return Cause()
    who = "all bands" if len(turned) == len(pairs) else " and ".join(pair.partner.name for pair in turned)
    return Cause(
        f"{who} match {pairs[0].hub.name} as far on the other side: change the sign of every `look_ahead` "
        "(forward is positive) or of all lags, or give all images with their earliest line first",
        tuple(pair.partner.name for pair in turned),
        len(turned),
    )


def _tried(pair: _Pair, either: bool) -> Iterator[tuple[ImageSource, Array, float, str]]:
    """Image of the partner, where windows are sought in it, how much wider they are, and what that means."""
    hub, partner, there = pair.hub, pair.partner, pair.there
    that = "that image" if either else "the image"
    if pair.far:
        exchange = ", or exchange the two images" if either and hub.image.shape == partner.image.shape else ""
        yield (
            partner.image,
            pair.other_side,
            1.0,
            f"it matches {hub.name} as far on the other side: change the sign of its lag, or of its "
            "`look_ahead` (forward is positive; of those of the other bands where its own is 0)" + exchange,
        )
    columns, lines = (
        f"the {way} of one of the two" if either else f"its {way}" for way in ("columns", "lines")
    )
    yield (
        Reversed(partner.image, 1),
        there,
        1.0,
        f"it matches {hub.name} when {columns} are taken the other way round: mirror {that}, or give "
        "`directions` in the order of its columns",
    )
    if either and pair.far:
        # the first band's lines turned round are the partner's turned round, and the lag with them
        turned = pair.other_side
        turned[:, 0] += partner.image.shape[0] - 1 - pair.step[0] * (hub.image.shape[0] - 1)
        yield (
            Reversed(partner.image, 0),
            turned,
            1.0,
            f"it matches {hub.name} when the lines of {hub.name} are taken the other way round: give the "
            f"image of {hub.name} with its earliest line first",
        )
        lines = "its lines"
    yield (
        Reversed(partner.image, 0),
        there,
        1.0,
        f"it matches {hub.name} when {lines} are taken the other way round: give {that} with its earliest "
        "line first",
    )
    middle = (partner.camera.columns - 1) / 2.0
    for error in SCALES:
        predicted = there.copy()
        predicted[:, 1] = middle + (1.0 + error) * (there[:, 1] - middle)
        size = f"{100 * abs(error):.1f} % {'larger' if error > 0 else 'smaller'}"
        yield (
            partner.image,
            predicted,
            1.0 + error,
            f"it matches {hub.name} where a magnification {size} would have it: check `ifov`, or the focal "
            "length and pixel pitch that it comes from, of both",
        )


def _farther(pair: _Pair) -> str:
    """Where along the track the partner matches, if its lag is other than given; "" if nowhere looked at."""
    if not np.isfinite(pair.lag).all():
        return ""
    search = (max(SCAN, pair.search_px[0]), pair.search_px[1])
    some = slice(None, None, max(1, len(pair.points) // FEW))
    few = replace(pair, points=pair.points[some], there=pair.there[some], at_once=pair.at_once[some])
    reach = min(max(FARTHEST * abs(pair.lag[0]), LEAST_FARTHEST), float(pair.partner.image.shape[0]))
    steps = np.arange(0.0, reach + search[0], 2.0 * search[0] + 1.0)
    for lines in sorted({*steps, *-steps}, key=lambda lines: abs(lines - pair.lag[0])):
        share, lag = few.found(few.at_once + np.array([lines, pair.lag[1]]), search_px=search)
        if share > ENOUGH:
            seen, said = round(lag[0]), round(pair.lag[0])
            times = f" ({lag[0] / pair.lag[0]:.3g} times as far)" if said else ""
            return (
                f"it matches {pair.hub.name} {seen} lines along its image, not {said} as the cameras say"
                f"{times}: check `look_ahead`, `first_line_time` and image of both, `line_period`, altitude "
                "and speed"
            )
    return ""
