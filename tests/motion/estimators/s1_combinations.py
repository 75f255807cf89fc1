"""Several pairs of images into one motion, S1's ways: band by band, or one pair after another.

Both are kept for comparison. Pairs that share an image share its error, which neither knows; the
smoother does (``estimators/smoother.py``, ``motion/strip/joint.py``).

Not here: all pairs fitted at once at each frequency, which ``inverse`` and ``wiener`` do by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.geometry.checks import as_times
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.harmonic import Bins, restore
from sightline.motion.estimators.inverse import inverse
from sightline.motion.estimators.polynomial import checked_differences

Estimator = Callable[[Sequence[AngleDifferences], ArrayLike], Motion]
"""Every function of ``estimators/``, its options filled in (``functools.partial``)."""


def max_band(
    differences: Sequence[AngleDifferences], t: ArrayLike, *, k: float = 0.1, degree: int = 5
) -> Motion:
    """Motion in which each frequency comes from the pair that sees it best.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        Several pairs.
    t : (N,)
        s; where the motion is wanted.
    k : float
        Noise over motion, in power, of the best pair; that of the others grows with their noise.
    degree : int
        Of the polynomial, fitted to all pairs, that takes the low frequencies first; 0 for none.

    Returns
    -------
    Motion
        Of mean zero over `t`.

    Notes
    -----
    S1, III and fig. 13: "the restorable band is the maximum of the elementary bands".
    """
    if not k > 0.0:
        raise InputError(f"`k` must be positive, got {k}; it is the noise over the motion, in power")

    def choose(bins: Bins) -> NDArray[np.complex128]:
        own_k = k * bins.noise_psd / bins.noise_psd.min(axis=1, keepdims=True)
        power = np.abs(bins.gain) ** 2
        best = (power[None] / own_k[:, :, None]).argmax(axis=1)
        filters = np.conj(bins.gain)[None] / (power[None] + own_k[:, :, None])
        chosen = np.arange(len(bins.gain))[None, :, None] == best[:, None, :]
        return np.where(chosen, filters, 0.0)

    return restore(differences, t, choose, degree=degree)


def in_turn(
    differences: Sequence[AngleDifferences], t: ArrayLike, *, estimator: Estimator = inverse, rounds: int = 1
) -> Motion:
    """Motion refined by one pair after another, each seeing what the pairs before it left.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        In order of trust: best correlated pair first.
    t : (N,)
        s; where the motion is wanted, reaching from the first instant of any difference to the last.
    estimator : callable
        Applied to one pair at a time.
    rounds : int
        Times that all pairs are gone through.

    Returns
    -------
    Motion
        The covariance is that of the last pair's step: the steps before it are not remembered.

    Notes
    -----
    S1, claims 9 and 10 and fig. 15: the estimate less its estimated error is the next estimate.
    """
    times = as_times(t, "t", increasing=True)
    pairs = checked_differences(differences)
    if rounds < 1:
        raise InputError(f"`rounds` must be 1 or more, got {rounds}")
    total = Motion(times, np.zeros((len(times), 3)))
    for pair in list(pairs) * rounds:
        seen = total.at(pair.t + pair.lag) - total.at(pair.t)
        step = estimator([replace(pair, angles=pair.angles - seen)], times)
        total = Motion(times, total.angles + step.angles, step.covariance)
    return total
