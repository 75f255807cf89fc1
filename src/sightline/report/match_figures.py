"""Figures of the matches: what they left over before and after, where they were kept or rejected and why.

Not here: the matching itself (``matching/``), the images themselves (``composite.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight
from sightline.matching.matches import KEPT, OUTLIER, OUTSIDE, STATUS_NAMES
from sightline.motion.stars import StarRecord
from sightline.report.reduce import cell_edges, cell_means, cell_modes
from sightline.report.style import AFTER, BEFORE, INK, MUTED, label, labels, panels

Array = NDArray[np.float64]

#: One colour per status code of a match, in the order of ``STATUS_NAMES``.
STATUS_COLOURS = (
    "#7fa8cc", "#f3f4f6", "#b8bec5", "#e3b34c", "#8f5aa8", "#c1502e", "#e08a64", "#7a1f1f",
    "#dfe3e8",
)  # fmt: skip
_HOVER = "line %{x:.0f}, column %{y:.0f}: "
COMPONENTS = ("along (lines)", "across (columns)")
DIVERGING = "RdBu_r"


@dataclass(frozen=True, eq=False)
class PairView:
    """One pair of images as a map: which star it is in, and where.

    Attributes
    ----------
    name : str
        ``"PAN – B1"``.
    images : (str, str)
        Its parts.
    index : int
        Of the star.
    partner : int
        Within the star.
    kept : int
        Matches.
    """

    name: str
    images: tuple[str, str]
    index: int
    partner: int
    kept: int

    @property
    def label(self) -> str:
        """The name as text of a figure."""
        return " – ".join(labels(self.images))


def pair_views(result: LineOfSight) -> list[PairView]:
    """Pairs that were tried at all, the one with most kept matches first."""
    views = []
    for index, record in enumerate(result.records):
        for k, image in enumerate(record.star.images):
            if (record.status[:, k] != OUTSIDE).any():
                images = result.image_names[record.star.hub], result.image_names[image]
                views.append(
                    PairView(" – ".join(images), images, index, k, int(record.star.present[:, k].sum()))
                )
    return sorted(views, key=lambda view: -view.kept)


def residual_map_figure(result: LineOfSight, view: PairView) -> go.Figure:
    """Residuals of one pair over the image, before and after, along and across."""
    record = result.records[view.index]
    figure = panels(4, 640, shared_xaxes=True, gap_px=34.0, subplot_titles=_map_titles())
    for row, (residual, component) in enumerate(
        (residual, component)
        for residual in (result.before_px[view.index], result.after_px[view.index])
        for component in (0, 1)
    ):
        values = np.where(record.star.present[:, view.partner], residual[:, view.partner, component], np.nan)
        lines, columns, mean = _as_map(record, values)
        both = result.before_px if row < 2 else result.after_px
        reach = _reach(both[view.index][:, view.partner][record.star.present[:, view.partner]])
        figure.add_heatmap(
            x=lines, y=columns, z=mean.T, zmin=-reach, zmax=reach, colorscale=DIVERGING, row=row + 1, col=1,
            colorbar=_colour_bar(row), showscale=row % 2 == 0,
            hovertemplate=_HOVER + "%{z:.3f} px<extra></extra>",
        )  # fmt: skip
        figure.update_yaxes(title_text="column (px)", row=row + 1)
    figure.update_xaxes(title_text=f"line of {label(view.images[0])} (px)", row=4)
    return figure


def residual_histogram(result: LineOfSight) -> go.Figure:
    """Histograms of all residuals before and after, and what the error model expects of the latter."""
    from plotly.subplots import make_subplots

    from sightline.report.style import TEMPLATE

    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.09)
    figure.update_layout(template=TEMPLATE, height=340, bargap=0.0)
    before, after, sigma = _all_residuals(result)
    for column, (values, name, colour) in enumerate(
        ((before, "before: against the nominal cameras", BEFORE), (after, "after the estimate", AFTER))
    ):
        reach = _reach(values, 99.8)
        counts, edges = np.histogram(values, bins=81, range=(-reach, reach))
        density = counts / (len(values) * np.diff(edges))
        middle = 0.5 * (edges[1:] + edges[:-1])
        figure.add_bar(
            x=middle, y=density, width=np.diff(edges), marker_color=colour, name=name, row=1, col=column + 1
        )
        figure.update_xaxes(title_text=f"residual {('before', 'after')[column]} (px)", row=1, col=column + 1)
        figure.update_yaxes(title_text="share per px", row=1, col=column + 1)
        if column == 1:
            sample = sigma[:: max(1, len(sigma) // 2000)]
            shape = np.exp(-0.5 * (middle[:, None] / sample) ** 2) / (np.sqrt(2.0 * np.pi) * sample)
            line = {"color": INK, "width": 1.6}
            figure.add_scatter(
                x=middle,
                y=shape.mean(axis=1),
                line=line,
                mode="lines",
                name="expected from the matches' own sigma",
                row=1,
                col=2,
            )
    return figure


def status_figure(result: LineOfSight, views: list[PairView]) -> go.Figure:
    """Where the matches of each pair were kept, and why the others were not."""
    titles = [view.label for view in views]
    figure = panels(
        len(views), 94 + 110 * len(views), gap_px=30.0, shared_xaxes=True, subplot_titles=titles, top=70
    )
    kinds = len(STATUS_NAMES)
    scale = [[(k + side) / kinds, STATUS_COLOURS[k]] for k in range(kinds) for side in (0, 1)]
    met = set()
    for row, view in enumerate(views):
        record = result.records[view.index]
        codes = _status(record, view.partner).astype(np.uint8)
        met |= set(np.unique(codes).tolist())
        shape = record.star.shape
        edges = cell_edges(shape[0])
        modes = cell_modes(codes.reshape(shape), edges, kinds)
        lines, columns = _places(record, edges)
        words = np.array(STATUS_NAMES)[modes].T
        figure.add_heatmap(
            x=lines, y=columns, z=modes.T, zmin=-0.5, zmax=kinds - 0.5, colorscale=scale, showscale=False,
            text=words, hovertemplate=_HOVER + "%{text}<extra></extra>", row=row + 1, col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text="column (px)", row=row + 1)
    pixels = np.concatenate([record.star.pixels for record in result.records])
    figure.update_xaxes(range=[0.0, float(pixels[:, 0].max())])
    figure.update_xaxes(title_text="line of the first image of the pair (px)", row=len(views))
    for kind in sorted(met):
        name = "no common ground" if kind == OUTSIDE else STATUS_NAMES[kind]
        mark = {
            "size": 11,
            "symbol": "square",
            "color": STATUS_COLOURS[kind],
            "line": {"width": 1, "color": MUTED},
        }
        figure.add_scatter(x=[None], y=[None], mode="markers", marker=mark, name=name)
    return figure


def _map_titles() -> list[str]:
    return [f"{when}, {component}" for when in ("before", "after") for component in COMPONENTS]


def _colour_bar(row: int) -> dict[str, Any]:
    return {
        "title": {"text": "px"},
        "len": 0.46,
        "y": 0.99 if row < 2 else 0.45,
        "yanchor": "top",
        "thickness": 12,
        "outlinewidth": 0,
    }


def _as_map(record: StarRecord, values: Array) -> tuple[Array, Array, Array]:
    """Lines, columns and means (lines, columns) of values at the windows of a star."""
    shape = record.star.shape
    edges = cell_edges(shape[0])
    lines, columns = _places(record, edges)
    return lines, columns, cell_means(values.reshape(shape), edges)


def _places(record: StarRecord, edges: NDArray[np.intp]) -> tuple[Array, Array]:
    pixels = record.star.pixels.reshape(*record.star.shape, 2)
    lines = np.array([pixels[first:last, 0, 0].mean() for first, last in pairwise(edges)], dtype=np.float64)
    return lines, pixels[0, :, 1]


def _status(record: StarRecord, partner: int) -> NDArray[np.uint8]:
    """Status codes of one pair; what the estimate itself threw out is an outlier."""
    late = (record.status[:, partner] == KEPT) & ~record.star.present[:, partner]
    return np.where(late, np.uint8(OUTLIER), record.status[:, partner])


def _all_residuals(result: LineOfSight) -> tuple[Array, Array, Array]:
    """Every component of every kept match: before, after, and the sigma expected of it, px."""
    parts: list[tuple[Array, Array, Array]] = []
    for record, before, after in zip(result.records, result.before_px, result.after_px, strict=True):
        star = record.star
        inflation = np.sqrt(np.diag(star.correlation)).reshape(1, -1, 2)
        sigma = np.sqrt(np.einsum("gkii->gki", star.covariance_px)) * inflation
        parts.append((before[star.present].ravel(), after[star.present].ravel(), sigma[star.present].ravel()))
    before_px, after_px, sigma_px = (np.concatenate([part[k] for part in parts]) for k in range(3))
    good = np.isfinite(before_px) & np.isfinite(after_px)
    return before_px[good], after_px[good], sigma_px[good]


def _reach(values: Array, percent: float = 98.0) -> float:
    """Half-range of a symmetric scale."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, percent)) if len(finite) else 1.0
