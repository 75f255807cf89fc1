"""Constant attitude errors of cameras against their truth: errors, NEES, coverage.

Not here: reading the files (``io/results/stereo_score.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.evaluation.consistency import consistency, squares_over_covariance
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC

Array = NDArray[np.float64]


def score_orientation(
    cameras: Sequence[str], angles: Array, sigma: Array, truth: Array, covariance: Array | None = None
) -> dict[str, Any]:
    """Errors of an orientation.

    Parameters
    ----------
    cameras : sequence of str
    angles, sigma : (C, 3)
        rad; roll, pitch, yaw. NaN and inf where an angle was not observable.
    truth : (C, 3)
        rad.
    covariance : (3 C, 3 C), optional
        rad^2.

    Returns
    -------
    dict
        Per camera and axis ``error`` and ``sigma`` (rad), ``error_arcsec``, ``error_over_sigma``;
        ``rms_arcsec``, ``max_arcsec``; ``nees``, the squared error in units of the covariance, its
        ``expected`` value (the number of angles), and where it falls 95 times in 100; ``coverage_95``; angles
        ``not_observable``.
    """
    error = angles - truth
    known = np.isfinite(error) & np.isfinite(sigma)
    if not known.any():
        raise InputError("no angle of the result is observable, so there is no error to be scored")
    scaled = np.where(known, error, 0.0) / np.where(known, sigma, 1.0)
    rows = {
        camera: {
            axis: {
                "error": float(error[c, k]),
                "sigma": float(sigma[c, k]),
                "error_arcsec": float(error[c, k] / ARCSEC),
                "error_over_sigma": float(scaled[c, k]) if known[c, k] else None,
            }
            for k, axis in enumerate(AXES)
        }
        for c, camera in enumerate(cameras)
    }
    some = error[known] / ARCSEC
    count = int(known.sum())
    stated = consistency(scaled[known])
    return {
        "cameras": rows,
        "rms_arcsec": float(np.sqrt((some**2).mean())),
        "max_arcsec": float(np.abs(some).max()),
        "nees": None if covariance is None else _nees(error, known, covariance),
        "nees_independent": float((scaled[known] ** 2).sum()),
        "expected": count,
        "nees_low": count * stated.nees_low,
        "nees_high": count * stated.nees_high,
        "coverage_95": stated.coverage_95,
        "not_observable": [
            f"{axis}_{camera}"
            for c, camera in enumerate(cameras)
            for k, axis in enumerate(AXES)
            if not known[c, k]
        ],
    }


def _nees(error: Array, known: NDArray[np.bool_], covariance: Array) -> float:
    """Squared error in units of the covariance, over the angles that are known."""
    rows = np.flatnonzero(known.ravel())
    some = np.asarray(error).ravel()[rows]
    try:
        return float(squares_over_covariance(some[None], covariance[np.ix_(rows, rows)][None])[0])
    except np.linalg.LinAlgError:
        raise InputError(
            "the covariance of the angles is singular: it claims that a combination of them is known exactly"
        ) from None
