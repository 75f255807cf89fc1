"""Power spectral density of the error that a recovered motion still has, frequency by frequency.

Not here: what could be seen (``observed.py``), the error against a truth (``score.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.evaluation.observed import observed
from sightline.geometry.trajectory import Motion
from sightline.motion.results import LineOfSight
from sightline.motion.tones import spectrum

Array = NDArray[np.float64]


def error_psd(result: LineOfSight, frequency: ArrayLike) -> Array:
    """One-sided PSD (F, 3) rad^2/Hz of the error of roll, pitch, yaw at `frequency` (F,) Hz.

    Parameters
    ----------
    result : LineOfSight
    frequency : (F,)
        Hz.

    Notes
    -----
    Measurements that tell M of the densities of roll, pitch and yaw, of motions of the densities S, leave the
    smoothed estimate the error density ``(S^-1 + M)^-1`` (the error of a Wiener smoother): 1 / M where the
    motion is seen well, S where it is not. M is a tone's information over the strip's duration
    (``observed.py``). Without a prior the error is that of M alone. The motion of another method adds the
    density of its departure from that estimate; products of what TDI averages away (`intermodulation`) are
    errors however well they are seen.
    """
    f = np.asarray(frequency, dtype=np.float64)
    seen = observed(result, f)
    duration = float(np.ptp(result.motion.t))
    if result.spectra is None:
        return np.asarray(seen.tone_sigma**2 * duration)
    prior = np.stack([one.psd(f) for one in result.spectra], axis=1)
    # in units of the prior: densities of motion fall over many powers of ten
    size = np.sqrt(prior)
    told = seen.information / duration * size[:, :, None] * size[:, None, :]
    error = prior * np.einsum("faa->fa", np.linalg.inv(np.eye(3) + told)).real
    for axis, products in enumerate(result.intermodulation):
        if products is not None:
            error[:, axis] += products.psd(f)
    if result.method is None:
        return error
    lost = spectrum(Motion(result.motion.t, result.method.departure))
    return error + np.stack([np.interp(f, lost.frequency, density) for density in lost.psd.T], axis=1)
