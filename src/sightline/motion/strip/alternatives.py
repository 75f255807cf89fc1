"""What would have two bands match that do not as they are given: one mistake in the description of either.

Tried are the lag of the other sign, columns or lines that run the other way, and a magnification some per
cent off. Not here: where it is said (``warnings.py``, ``applications/line_of_sight.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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


def alternative(hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int]) -> str:
    """What must be otherwise for `partner` to match `hub`, as the end of a sentence about it; "" if unknown.

    Parameters
    ----------
    hub, partner : Band
        With their nominal cameras; as they are given they do not match.
    surface : Surface
        What the lines of sight meet.
    search_px : (lines, columns)
        px; half-range of the search about each place tried.
    """
    size = (min(WINDOW[0], hub.image.shape[0]), min(WINDOW[1], hub.image.shape[1]))
    points = window_grid(hub.image.shape, size, size[0]).centres
    there = predict_match(hub.camera, partner.camera, surface, points)
    if not np.isfinite(there).any():
        return ""
    # px of the partner per px of the hub, as the cameras have them
    of_hub, of_partner = pixel_sizes([hub.camera, partner.camera])
    step = of_hub / of_partner
    some = np.linspace(0, len(points) - 1, min(len(points), MOST)).astype(int)
    points, there = points[some], there[some]
    best, words = 0.5, ""
    for image, predicted, stretch, said in _tried(hub, partner, points, there, step, search_px):
        has = np.isfinite(predicted).all(axis=1)
        affine = np.broadcast_to(np.diag(step * [1.0, stretch]), (int(has.sum()), 2, 2)).copy()
        share = _kept(hub.image, image, points[has], predicted[has], size, search_px, affine)
        if share > best:
            best, words = share, said
    return words


def _tried(
    hub: Band, partner: Band, points: Array, there: Array, step: Array, search_px: tuple[int, int]
) -> Iterator[tuple[ImageSource, Array, float, str]]:
    """Image of the partner, where windows are sought in it, how much wider they are, and what that means."""
    # where the partner would show the same without a lag: lines begin together, columns share their middle
    at_once = step * points
    at_once[:, 1] += (partner.camera.columns - 1) / 2.0 - step[1] * (hub.camera.columns - 1) / 2.0
    shift = np.nanmedian(there - at_once, axis=0)
    if abs(shift[0]) >= 2 * search_px[0]:  # else both signs are searched at once
        # also what the cameras have outside the partner
        yield (
            partner.image,
            at_once - shift,
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


def _kept(
    image: ImageSource,
    other: ImageSource,
    points: Array,
    predicted: Array,
    size: tuple[int, int],
    search_px: tuple[int, int],
    affine: Array,
) -> float:
    """Share of the windows on both images that match; 0 where too few are."""
    try:
        found = match_images(image, other, points, predicted, window=size, search_px=search_px, affine=affine)
    except EstimationError:
        return 0.0
    inside = found.status != OUTSIDE
    return float(found.kept.sum() / inside.sum()) if inside.sum() >= FEWEST else 0.0
