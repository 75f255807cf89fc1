"""Heights of a stereo series' points, before and after its constant errors are taken out (S2, figures 1, 2).

Not here: the errors (``stereo_orientation.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen, same_length
from sightline.geometry.earth import to_geodetic
from sightline.photogrammetry.block.point_priors import level_axes
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.triangulate import Triangulation, triangulate


@dataclass(frozen=True, eq=False)
class StereoHeights(ReadOnlyArrays):
    """Heights above the ellipsoid, or z where the world is flat; NaN where a point or an angle is not had.

    Attributes
    ----------
    position : (n, 3)
        m, world axes; the points after.
    before, after : (n,)
        m; of each point, by all shots: under the planned poses, and under the errors found.
    sigma : (n,)
        m, of `after`.
    shot : (K,) int
        Shots that two images or more share points of.
    t : (K,)
        s, mean of the shot's images.
    shot_before, shot_after : (K,)
        m; mean over the points of a shot of their height by this shot alone, less the reference.
    shot_sigma : (K,)
        m; scatter over the points of a shot of their height by this shot alone, less the reference, after.
    scatter_before, scatter_after : float
        m; scatter over the shots at one point, rms over the points.
    """

    position: Array
    before: Array
    after: Array
    sigma: Array
    shot: NDArray[np.intp]
    t: Array
    shot_before: Array
    shot_after: Array
    shot_sigma: Array
    scatter_before: float
    scatter_after: float


def stereo_heights(
    problem: StereoProblem, found: StereoOrientation, reference: Array | None = None
) -> StereoHeights:
    """Heights of a series' points, by all shots and shot by shot.

    Parameters
    ----------
    problem : StereoProblem
    found : StereoOrientation
        Of the same problem.
    reference : (n,), optional
        m; what heights of single shots are compared with; those after, by all shots, unless given.

    Returns
    -------
    StereoHeights

    Notes
    -----
    Shot by shot only the constant angles are taken out, as S2 does, not what was found of each image.
    """
    sightings, used = problem.sightings(), ~found.rejected
    angles = np.array(found.angles)
    radii = problem.radii
    after, sigma = heights_of(found.points, radii), height_sigmas(found.points, found.point_covariance, radii)
    level = after if reference is None else np.asarray(reference, dtype=np.float64)
    same_length(after, "points", level, "reference")
    before = heights_of(triangulate(sightings, used=used).position, radii)
    plain = triangulate(sightings, by_shot=True, used=used)
    turned = plain
    if np.isfinite(angles).all():
        turned = triangulate(sightings, angles, by_shot=True, used=used)
    first, second = (heights_of(met.position, radii) - level[met.point] for met in (plain, turned))
    if turned is plain:
        second = np.full(len(first), np.nan)
    assert plain.shot is not None  # by_shot
    shots, row = np.unique(plain.shot[plain.count >= 2], return_inverse=True)
    rows = np.flatnonzero(plain.count >= 2)
    times = np.array([problem.images.t[problem.images.shot == shot].mean() for shot in shots])
    mean_before, _ = _mean_and_scatter(first[rows], row, len(shots))
    mean_after, spread = _mean_and_scatter(second[rows], row, len(shots))
    return StereoHeights(
        found.points, frozen(before), frozen(after), frozen(sigma), shots, frozen(times),
        frozen(mean_before), frozen(mean_after), frozen(spread),
        _scatter(first, plain), _scatter(second, plain),
    )  # fmt: skip


def heights_of(points: Array, radii: tuple[float, float] | None) -> Array:
    """Heights (n,) m of points (n, 3) above an ellipsoid, or their z; NaN rows stay NaN."""
    if radii is None:
        return np.array(points[:, 2])
    return np.array(to_geodetic(points, radii)[:, 2])


def height_sigmas(points: Array, covariance: Array, radii: tuple[float, float] | None) -> Array:
    """1-sigma (n,) m of the heights of points (n, 3) of a covariance (n, 3, 3); NaN where that is."""
    out, known = np.full(len(points), np.nan), np.isfinite(points).all(axis=1)
    up = level_axes(points[known], radii)[0]
    out[known] = np.sqrt(np.einsum("na,nab,nb->n", up, covariance[known], up))
    return out


def _mean_and_scatter(values: Array, row: NDArray[np.intp], count: int) -> tuple[Array, Array]:
    """Mean and standard deviation (count,) of `values` of each row; NaN where a row has none."""
    seen = np.isfinite(values)
    size = np.bincount(row[seen], minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(row[seen], values[seen], minlength=count) / size
        square = np.bincount(row[seen], (values[seen] - mean[row[seen]]) ** 2, minlength=count) / (size - 1)
    return mean, np.where(size > 1, np.sqrt(square), np.nan)


def _scatter(values: Array, met: Triangulation) -> float:
    """Standard deviation over the shots at a point, rms over the points with two shots or more."""
    _, spread = _mean_and_scatter(values, met.point, int(met.point.max()) + 1 if len(met) else 0)
    known = spread[np.isfinite(spread)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
