"""Maps of the heights of a stereo series' points, before and after its constant errors are taken out.

Not here: the heights (``applications/stereo_heights.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.stereo_heights import height_sigmas, heights_of
from sightline.applications.stereo_orientation import StereoOrientation
from sightline.geometry.earth import local_axes, to_geodetic
from sightline.io.stereo import Stereo
from sightline.io.stereo_results import planned_points
from sightline.report.stereo_figures import panel_grid
from sightline.report.style import MUTED

Array = NDArray[np.float64]

#: Points of a map at most; sigma of a height over the median from which on it is drawn apart; percent of the
#: values at either end of a scale that may lie beyond it.
DRAWN_POINTS, POOR, BEYOND = 4000, 3.0, 1.0


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
        Those whose sigma is below `POOR` times the median; all where none is told.
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
    told = np.isfinite(sigma)
    good = sigma < POOR * np.median(sigma[told]) if told.any() else np.ones(len(known), dtype=bool)
    east, north = _level(after[known], problem.radii).T
    return PointHeights(
        problem.point_names[known], east, north, heights_of(before[known], problem.radii),
        heights_of(after[known], problem.radii), sigma, good,
    )  # fmt: skip


def height_figure(heights: PointHeights) -> go.Figure:
    """Maps of heights before and after, of their difference less its mean, and of sigma."""
    good = heights.good
    moved = heights.after - heights.before - heights.change
    low, high = _scale(np.concatenate([heights.before[good], heights.after[good]]))
    reach = max(map(abs, _scale(moved[good]))) or 1.0
    maps: list[tuple[str, Array, str, float, float]] = [
        ("Height by the planned attitudes", heights.before, "Viridis", low, high),
        ("Height by the corrected attitudes", heights.after, "Viridis", low, high),
        (f"After less before, less its mean of {heights.change:+.3g} m", moved, "RdBu", -reach, reach),
    ]
    if np.isfinite(heights.sigma).any():
        maps.append(("1 sigma of the height after", heights.sigma, "Cividis", *_scale(heights.sigma[good])))
    rows = -(-len(maps) // 2)
    figure = panel_grid(
        rows, 2, 60 + 400 * rows, [m[0] for m in maps], horizontal_spacing=0.19, vertical_spacing=0.15
    )
    for panel, drawn in enumerate(maps):
        _map(figure, heights, drawn, panel, rows)
    figure.update_layout(showlegend=False)
    return figure


def _scale(values: Array) -> tuple[float, float]:
    """Ends of a scale that all but a few values fill."""
    low, high = np.percentile(values[np.isfinite(values)], [BEYOND, 100.0 - BEYOND])
    return float(low), float(high)


def _map(
    figure: go.Figure,
    heights: PointHeights,
    drawn: tuple[str, Array, str, float, float],
    panel: int,
    rows: int,
) -> None:
    """One map: good points as discs, those known poorly as crosses."""
    title, values, scale, least, most = drawn
    row, col = panel // 2 + 1, panel % 2 + 1
    shown = np.linspace(0, len(values) - 1, min(len(values), DRAWN_POINTS)).astype(np.intp)
    for which, symbol, edge in (
        (shown[heights.good[shown]], "circle", {"width": 0.5, "color": MUTED}),
        (shown[~heights.good[shown]], "x", {"width": 0.5, "color": MUTED}),
    ):
        if not len(which):
            continue
        figure.add_scatter(
            x=heights.east[which], y=heights.north[which], row=row, col=col, mode="markers",
            customdata=np.column_stack([heights.name, values])[which],
            marker={
                "size": 7, "symbol": symbol, "color": values[which], "colorscale": scale, "cmin": least,
                "cmax": most, "line": edge, "showscale": symbol == "circle",
                "colorbar": {
                    "title": {"text": "m"}, "thickness": 12, "outlinewidth": 0, "len": 0.8 / rows,
                    "x": 0.41 if col == 1 else 1.005, "y": 1.0 - (row - 0.5) / rows,
                },
            },
            hovertemplate=f"{title}<br>point %{{customdata[0]:.0f}}: %{{customdata[1]:.4g}} m<extra></extra>",
        )  # fmt: skip
    figure.update_xaxes(title_text="east (km)" if row == rows else None, row=row, col=col)
    figure.update_yaxes(
        title_text="north (km)" if col == 1 else None,
        row=row,
        col=col,
        scaleanchor=f"x{panel + 1 if panel else ''}",
        constrain="domain",
    )


def _level(points: Array, radii: tuple[float, float] | None) -> Array:
    """East and north (n, 2) km about the middle of the points; x and y of a flat world."""
    middle = points.mean(axis=0)
    if radii is None:
        return (points - middle)[:, :2] / 1e3
    lon, lat, _ = to_geodetic(middle[None], radii)[0]
    return np.asarray(local_axes(lon, lat).inv().apply(points - middle)[:, :2] / 1e3)
