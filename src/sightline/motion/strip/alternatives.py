"""What would have two bands match that do not as they are given: one mistake in the description of either.

Tried are lags of the other sign, images of other bands, columns or lines that run the other way, a
magnification some per cent off, and lags of any length. Not here: where it is said (``warnings.py``,
``applications/line_of_sight.py``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.matching.match_images import match_images
from sightline.matching.matches import OUTSIDE
from sightline.motion.band import Band
from sightline.motion.measure.laid_strips import pixel_sizes
from sightline.motion.measure.windows import window_grid

Array = NDArray[np.float64]

#: Windows (lines, columns) px at most, and how many must lie on both images to prove anything.
WINDOW, FEWEST = (32, 100), 10
#: Windows that are tried at most: evenly spread.
MOST = 400
#: Share of the windows on both images that match where bands belong together.
ENOUGH = 0.5
#: Lags up to so many times the one given are tried, so many windows in steps of so many px each way.
FARTHEST, FEW, SCAN = 2.5, 50, 32
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
    hub, partners = bands[0], bands[1:]
    pairs = [_Pair.of(hub, partner, surface, search_px) for partner in partners]
    if len(pairs) > 1 and all(pair.far and pair.matches(pair.other_side) for pair in pairs):
        return (
            f"all bands match {hub.name} as far on the other side: change the sign of every `look_ahead` "
            "(forward is positive) or of all lags"
        )
    words = exchanged(bands, surface, search_px)
    if words:
        return words
    said = ((partner.name, alternative(hub, partner, surface, search_px)) for partner in partners)
    return next((f"{name}: {words}" for name, words in said if words), "")


def exchanged(bands: Sequence[Band], surface: Surface, search_px: tuple[int, int]) -> str:
    """Which bands have each other's images, where all bands match the first when these are put right.

    Parameters are those of `mistake`; so is what is returned.
    """
    if len(bands) < 3:
        return ""  # two change places as their lag changes its sign
    places = range(len(bands))
    orders: list[tuple[int, ...]] = list(combinations(places, 2))
    if len(bands) > 3:  # of fewer, two change places
        orders.append(tuple(places))
    for moved in orders:
        if len({bands[k].image.shape for k in moved}) > 1:
            continue
        # those of the pairs with the first band in which an image is another
        partners = [k for k in places[1:] if 0 in moved or k in moved]
        order = dict(zip(moved, reversed(moved), strict=True))
        put = [replace(band, image=bands[order.get(k, k)].image) for k, band in enumerate(bands)]
        if not all(_Pair.of(put[0], put[k], surface, search_px).matches() for k in partners):
            continue
        if all(_Pair.of(bands[0], bands[k], surface, search_px).matches() for k in partners):
            continue  # lags alike: either order may be
        if len(moved) > 2:
            return "the images match in the reverse order: give the files of all bands from last to first"
        first, second = (bands[k].name for k in moved)
        return f"the image of {first} matches as that of {second}, and {second}'s as {first}'s: exchange them"
    return ""


def alternative(hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int]) -> str:
    """What must be otherwise for `partner` to match `hub`, as the end of a sentence about it; "" if unknown.

    Parameters are those of `mistake`, of two bands.
    """
    pair = _Pair.of(hub, partner, surface, search_px)
    given, _ = pair.found(pair.there)
    best, words = max(given, ENOUGH), ""
    for image, predicted, stretch, said in _tried(pair):
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


def _tried(pair: _Pair) -> Iterator[tuple[ImageSource, Array, float, str]]:
    """Image of the partner, where windows are sought in it, how much wider they are, and what that means."""
    hub, partner, there = pair.hub, pair.partner, pair.there
    if pair.far:
        yield (
            partner.image,
            pair.other_side,
            1.0,
            f"it matches {hub.name} as far on the other side: change the sign of its `look_ahead` (forward "
            "is positive) or of its lag",
        )
    yield (
        Reversed(partner.image, 1),
        there,
        1.0,
        f"it matches {hub.name} when its columns are taken the other way round: mirror the image, or give "
        "`directions` in the order of its columns",
    )
    yield (
        Reversed(partner.image, 0),
        there,
        1.0,
        f"it matches {hub.name} when its lines are taken the other way round: give the image with its "
        "earliest line first",
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
    steps = np.arange(0.0, FARTHEST * abs(pair.lag[0]) + search[0], 2.0 * search[0] + 1.0)
    for lines in sorted({*steps, *-steps}, key=lambda lines: abs(lines - pair.lag[0])):
        share, lag = few.found(few.at_once + np.array([lines, pair.lag[1]]), search_px=search)
        if share > ENOUGH:
            return (
                f"it matches {pair.hub.name} {lag[0]:.0f} lines along its image, not {pair.lag[0]:.0f} as "
                f"the cameras say ({lag[0] / pair.lag[0]:.3g} times as far): check its `look_ahead`, "
                "`line_period` and `first_line_time`"
            )
    return ""
