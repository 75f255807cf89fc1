"""Whether two bands match where a lag of the other sign would have them.

Not here: what is reported of it (``warnings.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.errors import EstimationError
from sightline.geometry.surface import Surface
from sightline.matching.match_images import match_images
from sightline.matching.matches import OUTSIDE
from sightline.motion.band import Band
from sightline.motion.measure.predict import predict_match
from sightline.motion.measure.windows import window_grid

#: Windows (lines, columns) px at most, and how many must lie on both images to prove anything.
WINDOW, FEWEST = (32, 200), 10


def matches_backwards(hub: Band, partner: Band, surface: Surface, search_px: tuple[int, int]) -> bool:
    """Whether most windows of one band match in the other at the mirrored lag.

    Parameters
    ----------
    hub, partner : Band
        With their nominal cameras.
    surface : Surface
        What the lines of sight meet.
    search_px : (lines, columns)
        px; half-range of the search about the mirrored place.
    """
    size = (min(WINDOW[0], hub.image.shape[0]), min(WINDOW[1], hub.image.shape[1]))
    points = window_grid(hub.image.shape, size, size[0]).centres
    ahead = predict_match(hub.camera, partner.camera, surface, points) - points
    seen = np.isfinite(ahead[:, 0])
    if not seen.any():
        return False
    shift = np.median(ahead[seen], axis=0)
    if abs(shift[0]) < 2 * search_px[0]:  # both signs are searched at once
        return False
    try:
        mirrored = match_images(
            hub.image, partner.image, points, points - shift, window=size, search_px=search_px
        )
    except EstimationError:
        return False
    inside = mirrored.status != OUTSIDE
    return bool(inside.sum() >= FEWEST and mirrored.kept.sum() > 0.5 * inside.sum())
