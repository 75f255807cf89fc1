"""Windows that do not go with their neighbours: the normalised median test of velocimetry.

Not here: the neighbours themselves (``match_images.py``), clouds of a strip
(``motion/measure/consensus.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.robust import robust_sigma

Array = NDArray[np.float64]

#: Windows to each side, of the same row or column of windows, whose median is compared with.
NEIGHBOURS = 3
#: Departures of so many sigmas of all departures are false matches; chance makes one in 3000.
CUT = 4.0


def departures(shift_px: Array, sigma_px: Array) -> Array:
    """How far the shift of each window departs from those beside, or from those above and below.

    Parameters
    ----------
    shift_px, sigma_px : (rows, columns, 2)
        Of a grid of windows; NaN where there is none.

    Returns
    -------
    (rows, columns), in sigmas; NaN where there are fewer than two neighbours in either direction, or none.

    Notes
    -----
    Jitter moves rows of windows against each other, relief columns as much as rows: a window of either is
    like its neighbours in one direction.
    """
    return np.asarray(np.fmin(*(_departure(shift_px, sigma_px, axis) for axis in (0, 1))))


def scatter(departure: Array) -> float:
    """What most windows depart by, over what their sigmas say; NaN of none."""
    finite = np.isfinite(departure)
    # departures are lengths of two components: 1.18 is their median for a sigma of 1 each
    return robust_sigma(departure[finite]) / (1.4826 * 1.1774) if finite.any() else np.nan


def disagreeing(departure: Array) -> NDArray[np.bool_]:
    """Windows that depart further from their neighbours than chance, and what is common to most, explains.

    Notes
    -----
    The scale of all departures, at least 1, is what most windows depart by (J. Westerweel, F. Scarano,
    *Experiments in Fluids* 39, 2005).
    """
    return np.asarray(np.nan_to_num(departure) > CUT * np.fmax(scatter(departure), 1.0))


def _departure(shift_px: Array, sigma_px: Array, axis: int) -> Array:
    """Length of the departure from the median of the neighbours along an axis, in sigmas."""
    from numpy.lib.stride_tricks import sliding_window_view

    pad = [(0, 0)] * 3
    pad[axis] = (NEIGHBOURS, NEIGHBOURS)
    wide = np.pad(shift_px, pad, constant_values=np.nan)
    around = sliding_window_view(wide, 2 * NEIGHBOURS + 1, axis=axis)
    around = np.delete(around, NEIGHBOURS, axis=-1)
    count = np.isfinite(around).sum(axis=-1)
    # the median by sorting: NaN last
    ordered = np.sort(around, axis=-1)
    low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(count // 2, 2 * NEIGHBOURS - 1)[..., None], axis=-1)[..., 0]
    # a median of n numbers of one sigma has pi / 2n of their variance
    own = sigma_px**2 * (1.0 + 0.5 * np.pi / np.maximum(count, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(((shift_px - 0.5 * (low + high)) ** 2 / own).sum(axis=-1))
    return np.where((count >= 2).all(axis=-1), size, np.nan)
