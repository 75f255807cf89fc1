"""AngleDifferences: what one pair of images says, epoch by epoch (S1, step b).

The input of every estimator in ``estimators/``.

Not here: the joint observations of the best estimator (``observations.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.geometry.checks import as_points, as_times, frozen, same_length

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AngleDifferences:
    """What one image pair tells: angles(t + lag) - angles(t).

    Attributes
    ----------
    t : (N,)
        s; exposure of each difference's epoch in image a, not decreasing.
    lag : (N,)
        s; time in b minus time in a, of each difference by itself.
    angles : (N, 3)
        rad; roll, pitch, yaw.
    covariance : (N, 3, 3)
        rad^2; a huge variance where an axis is not observed.
    images : (int, int)
        Numbers of image a and image b: differences that share an image share its error.
    window : float
        s; time that the matching window spans: each difference is a mean over it.
    patch : (N,) or None
        Number of the patch of ground each difference was measured on; the same number in two pairs
        that share an image means the same error of that image.
    """

    t: Array
    lag: Array
    angles: Array
    covariance: Array
    images: tuple[int, int] = (0, 1)
    window: float = 0.0
    patch: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        t = frozen(as_times(self.t, "t"))
        lag = frozen(np.broadcast_to(np.asarray(self.lag, dtype=np.float64), t.shape))
        angles = frozen(as_points(self.angles, "angles"))
        same_length(t, "t", angles, "angles")
        covariance = frozen(self.covariance)
        if covariance.shape != (len(t), 3, 3):
            raise InputError(
                f"`covariance` must have shape ({len(t)}, 3, 3) in rad^2, got {covariance.shape}"
            )
        if not (np.isfinite(lag).all() and (lag != 0.0).all()):
            raise InputError(
                "`lag` must be finite and not zero: it is the time in image b minus that in image a, s"
            )
        if (np.diff(t) < 0.0).any():
            raise InputError("`t` of AngleDifferences must not decrease; sort the differences by time")
        if not (np.isfinite(self.window) and self.window >= 0.0):
            raise InputError(f"`window` must be a time of 0 s or more, got {self.window}")
        if self.patch is not None:
            patch = np.array(self.patch, dtype=np.intp)
            if patch.shape != t.shape:
                raise InputError(f"`patch` must hold one number per difference, {t.shape}, got {patch.shape}")
            patch.setflags(write=False)
            object.__setattr__(self, "patch", patch)
        for name, value in (("t", t), ("lag", lag), ("angles", angles), ("covariance", covariance)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Number of differences."""
        return len(self.t)
