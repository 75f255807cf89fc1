"""Which bands to take first where pairs are taken one after the other: S1's claim 10, best correlated first.

Not here: what is done with them (``applications/line_of_sight.py``).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Surface
from sightline.imaging.source import ImageSource
from sightline.matching.matches import OUTSIDE
from sightline.matching.on_geometry import PairOnGeometry
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.windows import window_grid

Array = NDArray[np.float64]

#: Windows of each pair that are looked at, at most, and the fewest that say anything.
MOST_WINDOWS, FEWEST_WINDOWS = 200, 5


def pair_correlations(
    images: Sequence[ImageSource],
    cameras: Sequence[MovingCamera],
    surface: Surface,
    window: tuple[int, int],
    search_px: tuple[int, int],
    allowed: Collection[tuple[int, int]] | None = None,
) -> Array:
    """How alike every pair of images is: the median over windows of their correlation.

    Parameters
    ----------
    images, cameras : sequences
    surface : Surface
        What the lines of sight meet.
    window : (lines, columns)
        px
    search_px : (lines, columns)
        px; half-range about the prediction.
    allowed : collection of (int, int), optional
        Pairs that may be matched, either way round; all by default.

    Returns
    -------
    (K, K)
        Normalised correlation of the images as they are, 0 .. 1; a window that does not match counts as 0, a
        pair with too little ground in common is 0, one that may not be matched -1.
    """
    may = None if allowed is None else {frozenset(pair) for pair in allowed}
    out = np.zeros((len(images), len(images)))
    for a, b in combinations(range(len(images)), 2):
        if may is not None and frozenset((a, b)) not in may:
            out[a, b] = out[b, a] = -1.0
            continue
        pair = PairOnGeometry(images[a], images[b], partial(predict_match, cameras[a], cameras[b], surface))
        centres = window_grid(images[a].shape, window, window[0]).centres
        seen = np.flatnonzero(np.isfinite(pair.where(centres)[:, 0]))
        chosen = seen[np.unique(np.linspace(0, len(seen) - 1, min(MOST_WINDOWS, len(seen))).astype(int))]
        if len(chosen) < FEWEST_WINDOWS:
            continue
        found = pair.found(centres[chosen], window=window, search_px=search_px, whitening=None).matches
        tried = found.status != OUTSIDE
        if tried.sum() >= FEWEST_WINDOWS:
            out[a, b] = out[b, a] = np.median(np.where(found.kept, np.nan_to_num(found.score), 0.0)[tried])
    return out


def best_first(correlations: Array) -> tuple[int, ...]:
    """Images in the order to take them: the best pair, then whichever is most like one already taken.

    Images that may not be matched with any taken begin again with the best pair among themselves.

    Parameters
    ----------
    correlations : (K, K)
        Symmetric, negative for pairs that may not be matched; the diagonal is not looked at.

    Examples
    --------
    >>> import numpy as np
    >>> best_first(np.array([[0, 0.4, 0.9], [0.4, 0, 0.8], [0.9, 0.8, 0]]))
    (0, 2, 1)
    """
    count = len(correlations)
    apart = np.where(np.eye(count, dtype=bool), -2.0, correlations)
    order: list[int] = []
    while len(order) < count:
        rest = [k for k in range(count) if k not in order]
        nearest = max(rest, key=lambda k: float(apart[k, order].max(initial=-2.0)))
        if apart[nearest, order].max(initial=-2.0) < 0.0 and len(rest) > 1:
            among = apart[np.ix_(rest, rest)]
            first, second = np.unravel_index(int(np.argmax(among)), among.shape)
            order += [rest[first], rest[second]]
        else:
            order.append(nearest)
    return tuple(order)
