"""Wiener filter: the least mean square error for known spectra of motion and noise.

Not here: the constant k (``inverse.py``); ends, gaps and lines finer than the record, which the
smoother treats exactly (``smoother.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.estimation.prior import Spectrum
from sightline.geometry.trajectory import Motion
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.estimators.harmonic import Bins, restore

Array = NDArray[np.float64]
AxisPriors = Spectrum | tuple[Spectrum, Spectrum, Spectrum]


def wiener(
    differences: Sequence[AngleDifferences],
    t: ArrayLike,
    *,
    prior: AxisPriors | None = None,
    degree: int = 5,
) -> Motion:
    """Motion by a polynomial and the Wiener filter on what it leaves.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        One pair, or several, which are then fitted together at each frequency.
    t : (N,)
        s; where the motion is wanted.
    prior : Spectrum or three of them, optional
        Of the motion (rad) beyond the polynomial, for all axes or for roll, pitch, yaw. Without it the
        spectrum is estimated from the differences.
    degree : int
        Of the polynomial that takes the low frequencies first; 0 for none.

    Returns
    -------
    Motion
        Of mean zero over `t`.

    Notes
    -----
    S1, III: ``H = conj(G) / (|G|^2 + P_B / P_theta)``, for motion and noise that are *un*correlated (the
    document says correlated). With several pairs
    ``H_m = (conj(G_m) / P_Bm) / (sum of |G|^2 / P_B + 1 / P_theta)``.
    """

    def choose(bins: Bins) -> NDArray[np.complex128]:
        information = np.einsum("mf,xm->xf", np.abs(bins.gain) ** 2, 1.0 / bins.noise_psd)
        posterior = 1.0 / (information + 1.0 / bins.motion_psd)
        return np.asarray(np.conj(bins.gain) / bins.noise_psd[:, :, None] * posterior[:, None, :])

    return restore(
        differences, t, choose, degree=degree, motion_psd=None if prior is None else _psd_of(prior)
    )


def _psd_of(prior: AxisPriors) -> Callable[[Array], Array]:
    axes = (prior, prior, prior) if isinstance(prior, Spectrum) else prior

    def psd(frequency: Array) -> Array:
        return np.stack([axis.psd(frequency) for axis in axes])

    return psd
