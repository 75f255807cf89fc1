"""The focal length among the globals of a flight: a stretch beside the constant errors of the tables.

Not here: the adjustment whose globals they are (``poses.py``, ``joined_blocks.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.errors import EstimationError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.sightings import Index

#: Relative sigma of a focal length of which nothing is known: a weak hold, so that one that is not observable
#: (it goes with all heights then) comes out as not known rather than as no solution.
_FREE = 1.0


@dataclass(frozen=True, eq=False)
class FocalStretch(ReadOnlyArrays):
    """The focal length of all frames, found with their poses.

    Attributes
    ----------
    stretch : float
        Relative: the focal length found over the one given, less 1.
    sigma : float
        1-sigma of it.
    prior : float
        What its sigma was beforehand; inf where nothing was known.
    with_bias : (6,)
        Covariance of `stretch` with the biases of `FramePoses`, m and rad.
    """

    stretch: float
    sigma: float
    prior: float
    with_bias: Array


def focal_information(prior: float) -> float:
    """1 / variance of a stretch whose 1-sigma is `prior`; inf: nothing is known of it."""
    return min(prior, _FREE) ** -2.0


def globals_of(bias: Array, rows: Index, focal: FocalStretch | None, prior: float) -> Array:
    """Values (G,) of the globals.

    Parameters
    ----------
    bias : (6,)
        Of the tables, as of `FramePoses`.
    rows : (n,) int
        Those that are sought.
    focal : FocalStretch or None
        Found before.
    prior : float
        1-sigma of the stretch; 0: it is not sought.
    """
    stretch = [0.0 if focal is None else focal.stretch] if prior > 0.0 else []
    return np.concatenate([-bias[rows], stretch])


def common_errors(
    common: Array, covariance: Array, rows: Index, prior: float
) -> tuple[Array, Array, FocalStretch | None]:
    """Biases (6,) of the tables, their covariance (6, 6), and the focal length, from the globals.

    Parameters
    ----------
    common : (G,)
    covariance : (G, G)
    rows, prior
        As of `globals_of`.
    """
    bias, bias_covariance, with_bias = np.zeros(6), np.zeros((6, 6)), np.zeros(6)
    count = len(rows)
    bias[rows] = -common[:count]
    bias_covariance[np.ix_(rows, rows)] = covariance[:count, :count]
    if not prior > 0.0:
        return frozen(bias), frozen(bias_covariance), None
    with_bias[rows] = -covariance[:count, count]
    sigma = float(np.sqrt(covariance[count, count]))
    focal = FocalStretch(float(common[count]), sigma, prior, frozen(with_bias))
    return frozen(bias), frozen(bias_covariance), focal


def unobservable_focal_length(prior: float) -> EstimationError:
    """What to say where frames were solved with the focal length given, but not with it as an unknown."""
    size = "nothing known of it" if np.isinf(prior) else f"{100.0 * prior:.2g} %"
    return EstimationError(
        "the frames can be adjusted with the focal length given, but not with it as an unknown "
        f"(1-sigma beforehand: {size}): it is hardly observable; give a smaller focal_length_sigma_px, or "
        "heights of positions above a known surface, or control points"
    )
