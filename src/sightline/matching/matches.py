"""Pairs of conjugate points with their covariance: what matching gives and motion takes.

Not how they are found: see `sightline.matching.match_images`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError

__all__ = ["STATUS_NAMES", "Matches", "concatenate_matches", "largest_sigma"]

KEPT = 0
OUTSIDE = 1
MASKED = 2
TEXTURELESS = 3
SATURATED = 4
NO_CONVERGENCE = 5
LOW_SCORE = 6
OUTLIER = 7
NOT_CHOSEN = 8

STATUS_NAMES = (
    "kept", "outside", "masked", "textureless", "saturated", "no convergence", "low score", "outlier",
    "not chosen",
)  # fmt: skip
"""Plain words of the status codes, in the order of the codes."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Conjugate points of two images, one row per point that was asked for.

    Parameters
    ----------
    a : (N, 2)
        Points of image a as given, (line, column).
    b : (N, 2)
        Where they were found in image b; NaN where they were not.
    covariance_px : (N, 2, 2)
        Covariance of `b` given `a`, px^2: the error of the pair, both images' noise together.
    score : (N,)
        Normalised correlation of the two windows after the fit, 0 to 1 (of the whitened windows when
        whitening is on); NaN where nothing was compared.
    status : (N,) uint8
        Why a row was kept or not: an index into `STATUS_NAMES`, 0 = kept.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    score: NDArray[np.float64]
    status: NDArray[np.uint8]

    def __post_init__(self) -> None:
        n = len(self.a)
        shapes = {"a": (n, 2), "b": (n, 2), "covariance_px": (n, 2, 2), "score": (n,), "status": (n,)}
        for name, shape in shapes.items():
            dtype = np.uint8 if name == "status" else np.float64
            array = getattr(self, name)
            # what is read-only already is not copied: of long strips all are large
            if not isinstance(array, np.ndarray) or array.flags.writeable or array.dtype != dtype:
                array = np.array(array, dtype=dtype)
            if array.shape != shape:
                raise InputError(
                    f"matches refused: `{name}` has shape {array.shape}; {shape} is needed for {n} points; "
                    "give one row per point"
                )
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """Number of points asked for, kept or not."""
        return len(self.a)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Matches:
        """The same matches, only some rows."""
        covariance, score, status = self.covariance_px[rows], self.score[rows], self.status[rows]
        return Matches(self.a[rows], self.b[rows], covariance, score, status)

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(N,) True where the match may be used."""
        return self.status == KEPT

    @property
    def sigma_px(self) -> NDArray[np.float64]:
        """(N, 2) standard deviations of line and column, px."""
        return np.sqrt(np.einsum("nii->ni", self.covariance_px))

    def counts(self) -> dict[str, int]:
        """Number of points per status, every status named.

        Returns
        -------
        dict
            Status in plain words -> number of points.
        """
        numbers = np.bincount(self.status, minlength=len(STATUS_NAMES))
        return {name: int(number) for name, number in zip(STATUS_NAMES, numbers, strict=True)}

    def with_status(self, rows: NDArray[np.bool_], status: int) -> Matches:
        """The same matches, some kept rows given another status.

        Parameters
        ----------
        rows : (N,) bool
            Which rows; those already rejected keep their reason.
        status : int
            The new status code.
        """
        changed = np.where(rows & self.kept, np.uint8(status), self.status)
        return Matches(self.a, self.b, self.covariance_px, self.score, changed)


def largest_sigma(covariance_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) px: sigma in the direction in which it is largest, of covariances (N, 2, 2); NaN for NaN."""
    trace = covariance_px[:, 0, 0] + covariance_px[:, 1, 1]
    difference = np.hypot(covariance_px[:, 0, 0] - covariance_px[:, 1, 1], 2.0 * covariance_px[:, 0, 1])
    return np.asarray(np.sqrt(0.5 * (trace + difference)))


def concatenate_matches(parts: list[Matches]) -> Matches:
    """Several sets of matches in one, in the order given.

    Parameters
    ----------
    parts : list of Matches
        At least one.
    """
    if not parts:
        raise InputError(
            "matches refused: an empty list was given; at least one set is needed; check the selection"
        )
    return Matches(
        *(np.concatenate([getattr(part, name) for part in parts])
          for name in ("a", "b", "covariance_px", "score", "status"))
    )  # fmt: skip
