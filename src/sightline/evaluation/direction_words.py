"""Principal directions of constant attitude errors in words.

Not here: how they are found (``photogrammetry/block/observability.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")
#: Components below this share of the largest are not spoken of.
SPOKEN = 0.25
#: Two components this close in size are one motion of both cameras.
ALIKE = 0.2


def angle_names(cameras: Sequence[str]) -> list[str]:
    """Names of the angles in the order of every covariance: ``roll_1``, ``pitch_1``, ..."""
    return [f"{axis}_{camera}" for camera in cameras for axis in AXES]


def direction_words(direction: Array, cameras: Sequence[str]) -> str:
    """A direction over the angles of all cameras in a few words.

    Parameters
    ----------
    direction : (3 C,)
        Unit vector; roll, pitch, yaw of each camera.
    cameras : sequence of str
        Their names.

    Examples
    --------
    >>> direction_words(np.array([0, 0, 0.7, 0, 0, 0.7]), ["1", "2"])
    'yaw of both cameras together'
    >>> direction_words(np.array([0.7, 0, 0, -0.7, 0, 0.1]), ["1", "2"])
    'roll of camera 1 against camera 2'
    """
    parts = np.asarray(direction).reshape(len(cameras), 3)
    least = SPOKEN * float(np.abs(parts).max())
    said = []
    for axis in np.argsort(-np.abs(parts).max(axis=0)):
        column = parts[:, axis]
        if np.abs(column).max() >= least:
            said.append(_axis_words(AXES[axis], column, cameras, least))
    return ", with ".join(said)


def _axis_words(axis: str, column: Array, cameras: Sequence[str], least: float) -> str:
    """One axis of a direction: which cameras turn, and whether together."""
    turning = np.flatnonzero(np.abs(column) >= least)
    if len(turning) == 1:
        return f"{axis} of camera {cameras[int(turning[0])]}"
    same = np.ptp(np.abs(column[turning])) <= ALIKE * np.abs(column[turning]).max()
    signs = np.sign(column[turning])
    if same and (signs == signs[0]).all() and len(turning) == len(cameras):
        return f"{axis} of {'both' if len(cameras) == 2 else 'all'} cameras together"
    if same and len(turning) == 2 and signs[0] != signs[1]:
        return f"{axis} of camera {cameras[int(turning[0])]} against camera {cameras[int(turning[1])]}"
    listed = [f"camera {cameras[int(k)]} ({column[k]:+.2f})" for k in turning]
    return f"{axis} of {', '.join(listed[:-1])} and {listed[-1]}"
