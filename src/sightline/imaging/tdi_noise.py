"""Signal and noise of a TDI column, electrons.

The variance of one line of signal s is A s^2 + B s + D K + C^2: gain noise, shot noise, dark current during
the integration ratio K, read noise; EP2733929 has A, B and C. What sums once is added once: the noise of the
output and the column's fixed pattern, common to all lines.

Not here: what motion does to the image (``tdi_transfer.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError
from sightline.imaging.tdi_transfer import Exposure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseLaw:
    """Noise of a TDI column.

    Attributes
    ----------
    gain : float
        A: variance per squared signal of a line, independent from line to line (photo-response, 1).
    shot : float
        B: variance per electron of signal (1 for photons).
    read : float
        C, electrons rms of each line.
    dark : float
        D, electrons per line period at an integration ratio of 1.
    output : float
        Electrons rms, added once to the sum.
    column_fixed : float
        Variance per squared signal of the sum that a column keeps.
    """

    gain: float = 0.0
    shot: float = 1.0
    read: float = 0.0
    dark: float = 0.0
    output: float = 0.0
    column_fixed: float = 0.0

    def __post_init__(self) -> None:
        """Refuse negative noise."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"noise `{field.name}` is {value:g}; a noise is 0 or more")

    def line_variance(self, signal: ArrayLike, ratio: ArrayLike) -> Array:
        """Variance (electrons^2) of one line of `signal` electrons at an integration ratio."""
        s = np.asarray(signal, dtype=np.float64)
        dark = self.dark * np.asarray(ratio, dtype=np.float64)
        return np.asarray(self.gain * s * s + self.shot * s + dark + self.read**2)


def summed_signal(
    signal: ArrayLike, stages: ArrayLike, ratio: ArrayLike, exposure: Exposure, reference: float | None = None
) -> Array:
    """Electrons that all stages collect.

    Parameters
    ----------
    signal : array_like
        Electrons of one line at the integration ratio `reference`.
    stages, ratio : array_like
    exposure : Exposure
    reference : float, optional
        By default the head's integration ratio.
    """
    per_ratio = np.asarray(signal, dtype=np.float64) / _reference(exposure, reference)
    return np.asarray(per_ratio * exposure.total(stages, ratio))


def snr(
    signal: ArrayLike,
    stages: ArrayLike,
    ratio: ArrayLike,
    law: NoiseLaw,
    exposure: Exposure,
    reference: float | None = None,
) -> Array:
    """Signal over noise of the sum; parameters as of :func:`summed_signal`."""
    per_ratio = np.asarray(signal, dtype=np.float64) / _reference(exposure, reference)
    n, kt = np.asarray(stages, dtype=np.float64), np.asarray(ratio, dtype=np.float64)
    head = np.minimum(n, exposure.head_stages)
    total = per_ratio * exposure.total(n, kt)
    variance = head * law.line_variance(per_ratio * exposure.head_ratio, exposure.head_ratio)
    variance = variance + (n - head) * law.line_variance(per_ratio * kt, kt)
    variance = variance + law.output**2 + law.column_fixed * total**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(
            np.where(variance > 0.0, total / np.sqrt(variance), np.where(total > 0.0, np.inf, 0.0))
        )


def _reference(exposure: Exposure, reference: float | None) -> float:
    if reference is None:
        reference = exposure.head_ratio if exposure.head_stages else 1.0
    if not 0.0 < reference <= 1.0:
        raise InputError(f"the signal's integration ratio is {reference:g}; it is above 0, up to 1")
    return reference
