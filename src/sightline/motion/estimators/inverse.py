"""Pseudo-inverse filter with a constant k: S1's filter ``H_k = conj(G) / (|G|^2 + k)``.

Not here: filters that know the spectra of motion and noise (``wiener.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.harmonic import Bins, restore

#: Below this |G|^2 the plain inverse (k = 0) is not formed: its noise gain would exceed 100.
INVERSE_FLOOR = 1e-4


def inverse(
    differences: Sequence[AngleDifferences], t: ArrayLike, *, k: float = 0.1, degree: int = 5
) -> Motion:
    """Motion by a polynomial and the pseudo-inverse filter on what it leaves.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        One pair, or several, which are then fitted together at each frequency, weighted by their noise.
    t : (N,)
        s; where the motion is wanted.
    k : float
        Noise over motion, in power: large k smooths, small k amplifies noise beside the blind frequencies.
        0 is the plain inverse 1/G, left out where it would amplify more than a hundredfold.
    degree : int
        Of the polynomial that takes the low frequencies first; 0 for none.

    Returns
    -------
    Motion
        Of mean zero over `t`; blind frequencies n/lag are missing from it, and its covariance says so.

    Notes
    -----
    S1, III, before eq. (3). With several pairs ``H_m = w_m conj(G_m) / (sum of w |G|^2 + k)``, w the noise of
    the best pair over that of each.
    """
    if not k >= 0.0:
        raise InputError(f"`k` must be 0 or more, got {k}; it is the noise over the motion, in power")

    def choose(bins: Bins) -> NDArray[np.complex128]:
        weight = bins.noise_psd.min(axis=1, keepdims=True) / bins.noise_psd
        seen = np.einsum("xm,mf->xf", weight, np.abs(bins.gain) ** 2)
        total = np.where(seen < INVERSE_FLOOR, np.inf, seen) if k == 0.0 else seen + k
        return np.asarray(weight[:, :, None] * np.conj(bins.gain) / total[:, None, :])

    return restore(differences, t, choose, degree=degree)
