"""Passbands in words: a few by their ends, many with gaps at the multiples of one frequency by those.

Not here: how they are found (``motion/observability.py``, ``evaluation/observed.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.motion.observability import Passbands

#: So many gaps at least make a series, and so much of it must be there.
FEWEST_GAPS, COMPLETE = 3, 0.8
#: Gaps whose widths differ by less than this factor are said to have one width.
ALIKE = 1.2


def passband_words(bands: Passbands, most: int = 3) -> str:
    """Passbands as text, such as ``2–498 Hz but for gaps of 0.15 Hz at multiples of 6.68 Hz``.

    Parameters
    ----------
    bands : sequence of (low, high)
        Hz, in rising order.
    most : int
        So many bands are given by their ends, the widest; the others are counted.
    """
    if not bands:
        return "nowhere"
    gaps = _regular_gaps(bands)
    if gaps is not None and len(bands) > most:
        return f"{_ends(bands[0][0], bands[-1][1])} Hz but for {gaps}"
    wide = sorted(sorted(bands, key=lambda band: band[0] - band[1])[:most])
    listed = ", ".join(_ends(low, high) for low, high in wide)
    rest = len(bands) - len(wide)
    return f"{listed} Hz" + (f" and {rest} narrower" if rest else "")


def _ends(low: float, high: float) -> str:
    return f"{low:.4g}–{high:.4g}"


def _regular_gaps(bands: Passbands) -> str | None:
    """Width and frequency of gaps that lie at the multiples of one frequency; None where they do not."""
    ends = np.array(bands)
    left, right = ends[:-1, 1], ends[1:, 0]
    middle, width = 0.5 * (left + right), right - left
    if len(middle) < FEWEST_GAPS:
        return None
    apart = float(np.median(np.diff(middle)))
    order = np.maximum(np.rint(middle / apart), 1.0)
    first = float(order @ middle / (order @ order))
    order = np.maximum(np.rint(middle / first), 1.0)
    present = len(np.unique(order)) / (order[-1] - order[0] + 1.0)
    # every gap must hold the multiple that makes it
    if (np.abs(middle - order * first) > 0.5 * width).any() or present < COMPLETE:
        return None
    most = "" if width.max() < ALIKE * width.min() else f" (at most {width.max():.2g} Hz)"
    return f"gaps of {np.median(width):.2g} Hz{most} at multiples of {first:.3g} Hz"
