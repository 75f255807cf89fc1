"""AngleDifferences: what one pair of images says, epoch by epoch (S1, step b).

The input of every estimator in ``estimators/``.

Not here: how they are made of matches (``motion/strip/hyper.py``), the joint observations of the best
estimator (``motion/measure/observations.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.estimation.series import DifferenceSeries
from sightline.execution import slices
from sightline.geometry.checks import as_points, as_times, frozen, same_length
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]

#: A difference does not show an axis whose variance is so many times the median of its pair.
UNSEEN = 100.0
#: Differences that are turned at a time.
AT_ONCE = 16384

#: The angle that is seen along the lines.
ROLL, PITCH, YAW = 0, 1, 2


@dataclass(frozen=True, eq=False)
class AngleDifferences:
    """What one image pair measures: angles(t + lag) - angles(t).

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
    tdi : (float, float)
        s; over which TDI averages the motion besides, in image a and in image b.
    stretch : float
        s; by how much longer it is for pitch, which is seen along the lines.
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
    stretch: float = 0.0
    tdi: tuple[float, float] = (0.0, 0.0)

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

    def of_axis(self, axis: int) -> DifferenceSeries:
        """One axis (0 roll, 1 pitch, 2 yaw) by itself, its variance being the marginal one."""
        return DifferenceSeries(
            self.t,
            self.lag,
            self.angles[:, axis],
            self.covariance[:, axis, axis],
            images=self.images,
            window=self.window + (self.stretch if axis == PITCH else 0.0),
            patch=None if self.patch is None else np.asarray(self.patch, dtype=np.int64),
            tdi=self.tdi,
            window_most=self.window + self.stretch if self.stretch > 0.0 else 0.0,
        )

    def sigma(self) -> Array:
        """(N, 3) rad; of each angle by itself."""
        return np.sqrt(np.einsum("nii->ni", self.covariance))

    def turned(self, turn: Array) -> AngleDifferences:
        """The same differences about the axes that the rotation `turn` (3, 3) leads to."""
        covariance = scratch_array(self.covariance.shape)
        for some in slices(len(self), AT_ONCE):
            covariance[some] = turn @ self.covariance[some] @ turn.T
            let_go()
        covariance.setflags(write=False)  # nobody else has it: not copied
        return replace(self, angles=self.angles @ turn.T, covariance=covariance)


def by_pair(differences: Sequence[AngleDifferences]) -> list[AngleDifferences]:
    """One set per pair of images, from the image of the lower number, in order of time.

    Differences that were taken from the image of the higher number are turned round. Those that do not show
    an axis, being `UNSEEN` times less certain of it than is usual in their pair, are left out.

    Parameters
    ----------
    differences : sequence of AngleDifferences
        Any number for each pair, in either direction.
    """
    parts: dict[tuple[int, int], list[AngleDifferences]] = {}
    for one in differences:
        first, second = one.images
        if first > second:
            one = _reversed(one)
        parts.setdefault((min(first, second), max(first, second)), []).append(one)
    joined = [_joined(parts[pair]) for pair in sorted(parts)]
    return [one for one in joined if len(one)]


def _reversed(one: AngleDifferences) -> AngleDifferences:
    """The same measurements from image b to image a."""
    t = one.t + one.lag
    order = np.argsort(t, kind="stable")
    return AngleDifferences(
        t[order],
        -one.lag[order],
        -one.angles[order],
        one.covariance[order],
        (one.images[1], one.images[0]),
        one.window,
        None if one.patch is None else one.patch[order],
        tdi=(one.tdi[1], one.tdi[0]),
    )


def _joined(parts: Sequence[AngleDifferences]) -> AngleDifferences:
    """Several sets of one pair as one, less what does not show every axis.

    Where TDI has unequal stages it is taken to average over as long as it does in the mean.
    """
    t, lag, angles, covariance = (
        np.concatenate([getattr(one, name) for one in parts]) for name in ("t", "lag", "angles", "covariance")
    )
    patches = [one.patch for one in parts if one.patch is not None]
    patch = np.concatenate(patches) if len(patches) == len(parts) else None
    variance = np.einsum("nii->ni", covariance)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    usual = np.median(variance[finite], axis=0) if finite.any() else np.zeros(3)
    seen = finite & (variance <= UNSEEN * usual).all(axis=1)
    order = np.flatnonzero(seen)[np.argsort(t[seen], kind="stable")]
    mean = np.average(
        [one.tdi for one in parts], axis=0, weights=[max(len(one), 1) for one in parts]
    ).tolist()
    return AngleDifferences(
        t[order],
        lag[order],
        angles[order],
        covariance[order],
        parts[0].images,
        parts[0].window,
        None if patch is None else patch[order],
        tdi=(mean[0], mean[1]),
    )
