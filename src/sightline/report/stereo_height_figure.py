"""Maps of the heights of a stereo series' points, before and after its constant errors are taken out.

Not here: the heights (``applications/stereo_heights.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.stereo_heights import height_sigmas, heights_of
from sightline.applications.stereo_orientation import StereoOrientation
from sightline.geometry.earth import local_axes, to_geodetic
from sightline.io.results.stereo import planned_points
from sightline.io.stereo.load import Stereo
from sightline.report.figure import Figure
from sightline.report.marks import Points

Array = NDArray[np.float64]
#: Points of a map at most; sigma of a height over the median from which on it is drawn apart; percent of the
#: values at either end of a scale that may lie beyond it.
DRAWN_POINTS, POOR, BEYOND = 2000, 3.0, 1.0


@dataclass(frozen=True, eq=False)
class PointHeights:
    """Points with a height before and after.

    Attributes
    ----------
    name : (n,)
        Numbers of the points.
    east, north : (n,)
        km about their middle.
    before, after, sigma : (n,)
        m; by the planned and by the corrected attitudes, and 1 sigma of the latter.
    good : (n,) bool
        Those whose sigma is below `POOR` times the median; all where none is known.
    """

    name: Array
    east: Array
    north: Array
    before: Array
    after: Array
    sigma: Array
    good: NDArray[np.bool_]

    @property
    def change(self) -> float:
        """m; mean over the good points of after less before."""
        return float((self.after - self.before)[self.good].mean())

    @property
    def spread(self) -> float:
        """m rms; what is left of that where its mean is taken off."""
        return float((self.after - self.before)[self.good].std())

    @property
    def median_sigma(self) -> float:
        """m; of the good points."""
        return float(np.median(self.sigma[self.good]))


def point_heights(stereo: Stereo, result: StereoOrientation) -> PointHeights | None:
    """Heights of a result's points; None where no point or no angle is known."""
    problem = stereo.problem
    after = np.asarray(result.points)
    before = planned_points(problem, ~result.rejected)
    known = np.flatnonzero(np.isfinite(after).all(axis=1) & np.isfinite(before).all(axis=1))
    if not len(known):
        return None
    sigma = height_sigmas(after[known], result.point_covariance[known], problem.radii)
    finite = np.isfinite(sigma)
    good = sigma < POOR * np.median(sigma[finite]) if finite.any() else np.ones(len(known), dtype=bool)
    east, north = _level(after[known], problem.radii).T
    return PointHeights(
        problem.point_names[known], east, north, heights_of(before[known], problem.radii),
        heights_of(after[known], problem.radii), sigma, good,
    )  # fmt: skip


def height_figure(heights: PointHeights) -> Figure:
    """Maps of heights before and after, of their difference less its mean, and of sigma."""
    good = heights.good
    moved = heights.after - heights.before - heights.change
    low, high = _scale(np.concatenate([heights.before[good], heights.after[good]]))
    reach = max(map(abs, _scale(moved[good]))) or 1.0
    maps: list[tuple[str, Array, str, float, float]] = [
        ("Height by the planned attitudes", heights.before, "viridis", low, high),
        ("Height by the corrected attitudes", heights.after, "viridis", low, high),
        (f"After less before, less its mean of {heights.change:+.3g} m", moved, "diverging", -reach, reach),
    ]
    if np.isfinite(heights.sigma).any():
        maps.append(("1 sigma of the height after", heights.sigma, "cividis", *_scale(heights.sigma[good])))
    figure = Figure(-(-len(maps) // 2), 2, height=330, shared=False)
    shown = np.linspace(0, len(good) - 1, min(len(good), DRAWN_POINTS)).astype(np.intp)
    for panel, (title, values, palette, least, most) in zip(figure.panels, maps, strict=False):
        for which, symbol in ((shown[good[shown]], "dot"), (shown[~good[shown]], "cross")):
            says = [f"point {heights.name[k]:.0f}: {values[k]:.4g} m" for k in which]
            scale: dict[str, Any] = {"palette": palette, "low": least, "high": most, "bar": "m"}
            x, y = heights.east[which], heights.north[which]
            panel.add(
                Points(
                    x=x,
                    y=y,
                    values=values[which],
                    symbol=symbol,
                    size=7.0,
                    says=says,
                    name=title,
                    key=False,
                    **scale,
                )
            )
        panel.title, panel.equal = title, True
        panel.x.title, panel.y.title = "east (km)", "north (km)"
    return figure


def _scale(values: Array) -> tuple[float, float]:
    """Ends of a scale that all but a few values fill."""
    low, high = np.percentile(values[np.isfinite(values)], [BEYOND, 100.0 - BEYOND])
    return float(low), float(high)


def _level(points: Array, radii: tuple[float, float] | None) -> Array:
    """East and north (n, 2) km about the middle of the points; x and y of a flat world."""
    middle = points.mean(axis=0)
    if radii is None:
        return (points - middle)[:, :2] / 1e3
    lon, lat, _ = to_geodetic(middle[None], radii)[0]
    return np.asarray(local_axes(lon, lat).inv().apply(points - middle)[:, :2] / 1e3)
