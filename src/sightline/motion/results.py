"""What a recovery of the line of sight hands back.

Not here: how it is found (``applications/line_of_sight.py``), how it is written (``io/``) or shown
(``report/``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.estimation.prior import Spectrum
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import MASKED, NOT_CHOSEN, OUTSIDE, STATUS_NAMES
from sightline.motion.estimators.differences import AngleDifferences
from sightline.motion.measure.plan import END
from sightline.motion.measure.stars import StarRecord
from sightline.motion.strip.fusion import SensorUse
from sightline.motion.strip.relief import RowRelief
from sightline.motion.strip.withheld import WithheldAxis
from sightline.result import Result
from sightline.writing import let_go

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StaticEstimate:
    """A static parameter after the fit: value and sigma in `unit`, beside the sigma before."""

    name: str
    unit: str
    value: float
    sigma: float
    prior_sigma: float


@dataclass(frozen=True, eq=False)
class PairResiduals:
    """What one pair of images left over.

    Attributes
    ----------
    images : (int, int)
        Hub and partner.
    lag : float
        s; median time between their exposures of the same ground.
    tried, kept : int
        Windows.
    rejected : dict
        Why the others fell out: name of the status -> number.
    rms_before_px, rms_after_px : float
        Of both components over the kept windows: against the nominal cameras, and after the estimate.
    sigma_px : float
        What the error model expects of the latter: of single matches, whatever rows and neighbours share.
    """

    images: tuple[int, int]
    lag: float
    tried: int
    kept: int
    rejected: dict[str, int]
    rms_before_px: float
    rms_after_px: float
    sigma_px: float


@dataclass(frozen=True, eq=False)
class NamedMethod:
    """The estimator of S1's claim 6 whose motion stands in the place of the joint estimate.

    Attributes
    ----------
    name : str
        ``"inverse"``, ``"wiener"``, ``"polynomial"`` or ``"kalman"``.
    departure : (N, 3)
        rad; of its motion from the joint estimate. The covariance of the motion holds its square.
    stated_sigma : (N, 3)
        rad; what the method by itself takes for its error, which leaves out part of it.
    """

    name: str
    departure: Array
    stated_sigma: Array


@dataclass(frozen=True, eq=False)
class ControlFit:
    """Control points of a strip of one band, which carry its motion alone.

    Attributes
    ----------
    t : (N,)
        s; when each was exposed.
    before_px, after_px : (N, 2)
        Where it was seen, less where the nominal camera, and the recovered one, sees it: (line, column).
    sigma_px : (N, 2)
        Of that, as given: of the pixel, and of the place on the ground.
    information : (3,)
        rad^-2; of all about roll, pitch and yaw.
    kept : (N,) bool
        False where the others contradict it.
    """

    t: Array
    before_px: Array
    after_px: Array
    sigma_px: Array
    information: Array
    kept: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class LineOfSight(Result):
    """Result of S1.

    Attributes
    ----------
    motion : Motion
        From the first exposure of any image to the last, at the lines of the first (or at the frames):
        departures from the reference attitude, with the covariance of the motion less its hidden part.
    absolute_sigma : (N, 3)
        rad; hidden part included, infinite where nothing ties it.
    hidden : (N, 3, H)
        Motions that the images cannot see, named by `hidden_names`; rad per unit.
    hidden_covariance : (H, H) or None
        rad^2; of how much the motion holds of each, by what is believed beforehand and what sensors say.
    observed : (N,) bool
        Where matches speak; elsewhere only prior and interpolation do.
    scale : (3,)
        rad; one pixel of roll, of pitch, and of yaw at the edge of the field.
    ifov, half_field : float
        rad; angle of one pixel and of half the field of the first image.
    statics : tuple of StaticEstimate
    spectra : three Spectrum or None
        Priors of roll, pitch, yaw as the data asked for them (rad); None where none is used.
    intermodulation : three Spectrum or None
        Sums and differences of modes that TDI averages away and of others (rad): averaging puts them into
        roll, pitch, yaw as they are found, and no body moves so. Errors, no part of `spectra`.
    records : tuple of StarRecord
        Observations of the last pass, with the status of every match.
    before_px, after_px : tuple of (G, K, 2)
        Per star: residuals against the nominal cameras, and after the estimate.
    cameras : tuple of cameras
        With the recovered motion and statics.
    image_names : tuple of str
    changes : tuple of float
        Per pass: change of the motion in units of its sigma.
    band : TimeCovariance or None
        Banded covariance of the motion in time.
    functional_covariance : callable or None
        Covariance (K, K) rad^2 of sums of the motion at its instants with weights (N, 3, K).
    sensors : tuple of SensorUse
        What attitude sensors and control points gave.
    differences : tuple of AngleDifferences
        S1's step b, one per pair of images: rows of windows that show all three angles. None of frames.
    method : NamedMethod or None
        None: the joint estimate.
    relief : RowRelief or None
        Ground that was found beside the motion, where its height is not known well enough.
    lines : (N,) int or None
        Lines of the first image at which the motion is given; before it negative, behind it beyond its last.
        None of frames.
    withheld : tuple of WithheldAxis
        Pairs of bands that the estimate did not use, against what it predicts of them: those left out on
        demand, or a sample of those that three bands or more can do without. None of frames.
    control : ControlFit or None
        Of a strip of one band: what its control points say.
    warnings : tuple of str
    """

    motion: Motion
    absolute_sigma: Array
    hidden: Array
    hidden_names: tuple[str, ...]
    observed: NDArray[np.bool_]
    scale: Array
    ifov: float
    half_field: float
    statics: tuple[StaticEstimate, ...]
    spectra: tuple[Spectrum, Spectrum, Spectrum] | None
    records: tuple[StarRecord, ...]
    before_px: tuple[Array, ...]
    after_px: tuple[Array, ...]
    cameras: tuple[PushbroomCamera | FrameCamera, ...]
    image_names: tuple[str, ...]
    changes: tuple[float, ...]
    band: TimeCovariance | None = None
    functional_covariance: Callable[[Array], Array] | None = None
    hidden_covariance: Array | None = None
    sensors: tuple[SensorUse, ...] = ()
    differences: tuple[AngleDifferences, ...] = ()
    method: NamedMethod | None = None
    relief: RowRelief | None = None
    intermodulation: tuple[Spectrum | None, ...] = (None, None, None)
    lines: NDArray[np.int64] | None = None
    withheld: tuple[WithheldAxis, ...] = ()
    control: ControlFit | None = None
    warnings: tuple[str, ...] = ()

    @property
    def sigma(self) -> Array:
        """(N, 3) rad; of the motion less its hidden part."""
        covariance = self.motion.covariance
        if covariance is None:
            return np.zeros_like(self.motion.angles)
        return np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]])

    @property
    def pairs(self) -> list[PairResiduals]:
        """Every pair of images with what it left over."""
        out = []
        for record, before, after in zip(self.records, self.before_px, self.after_px, strict=True):
            star = record.star
            for k, image in enumerate(star.images):
                out.append(_pair(record, before[:, k], after[:, k], k, (star.hub, image)))
                let_go()
        return out


@dataclass(frozen=True, eq=False)
class TimeCovariance:
    """Covariance in time of the motion on its grid, hidden directions held: a band, as the estimate has it.

    Attributes
    ----------
    t : (count,)
        s; nodes of the grid.
    angles : (count, 3)
        rad; the motion there.
    band : (width + 1, 3 * count)
        rad^2; lower band, ``band[d, j] = C[j + d, j]``, unknown ``3 * node + axis``.
    """

    t: Array
    angles: Array
    band: Array


def without_common_ground(
    record: StarRecord,
    cameras: Sequence[PushbroomCamera | FrameCamera],
    surface: Surface,
    window: tuple[int, int],
) -> StarRecord:
    """The record with windows that leave a partner's image called outside, not masked.

    The matcher cannot tell: an image laid on another has no pixels there, as under a mask.

    Parameters
    ----------
    record : StarRecord
    cameras : sequence of cameras
        Of all images, as recovered.
    surface : Surface
    window : (lines, columns)
        px; of windows whose star does not say.
    """
    star, status = record.star, record.status.copy()
    rows = np.flatnonzero((status == MASKED).any(axis=1))
    ground = cameras[star.hub].locate(star.pixels[rows], surface)
    # whole windows only, and what the kernels read around them
    margin = (np.array(star.window or window) - 1) / 2.0 + END
    for k, image in enumerate(star.images):
        partner = cameras[image]
        shape = partner.shape if isinstance(partner, FrameCamera) else (partner.lines, partner.columns)
        at = partner.project(ground)
        inside = ((at >= margin) & (at <= np.array(shape) - 1 - margin)).all(axis=1)
        status[rows, k] = np.where(~inside & (status[rows, k] == MASKED), OUTSIDE, status[rows, k])
    return StarRecord(star, status, record.score)


def _pair(record: StarRecord, before: Array, after: Array, k: int, images: tuple[int, int]) -> PairResiduals:
    star = record.star
    kept = star.present[:, k]
    status = record.status[:, k]
    inside = (status != OUTSIDE) & (status != NOT_CHOSEN)
    rejected = {
        name: int((status == code).sum())
        for code, name in enumerate(STATUS_NAMES)
        if code > 1 and (status == code).any()
    }
    late = int(((status == 0) & ~kept).sum())
    if late:
        rejected["outlier"] = rejected.get("outlier", 0) + late

    def rms(values: Array) -> float:
        found = float(np.sqrt(np.mean(values[kept] ** 2))) if kept.any() else float("nan")
        let_go()
        return found

    expected = star.error_variance(kept)[:, k]
    let_go()
    return PairResiduals(
        images=images,
        lag=float(np.nanmedian((star.t[:, k] - star.t_hub)[kept])) if kept.any() else float("nan"),
        tried=int(inside.sum()),
        kept=int(kept.sum()),
        rejected=rejected,
        rms_before_px=rms(before),
        rms_after_px=rms(after),
        sigma_px=float(np.sqrt(expected.mean())) if kept.any() else float("nan"),
    )
