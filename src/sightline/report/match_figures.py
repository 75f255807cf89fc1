"""Figures of the matches: what they left over before and after, where they were kept or rejected and why.

Not here: the matching itself (``matching/``), the images themselves (``composite.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sightline.matching.matches import KEPT, OUTLIER, OUTSIDE, STATUS_NAMES
from sightline.motion.measure.stars import StarRecord
from sightline.motion.results import LineOfSight
from sightline.report.figure import Figure
from sightline.report.marks import Bars, Line, Map
from sightline.report.reduce import cell_edges, cell_means, cell_modes
from sightline.report.style import AFTER, BEFORE, labels, short_label
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
#: One colour per status code of a match, in the order of ``STATUS_NAMES``.
STATUS_COLOURS = (
    "#7fa8cc", "#f3f4f6", "#b8bec5", "#e3b34c", "#8f5aa8", "#c1502e", "#e08a64", "#7a1f1f",
    "#dfe3e8",
)  # fmt: skip
COMPONENTS = ("along (lines)", "across (columns)")


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


def residual_map_figure(result: LineOfSight, view: PairView) -> Figure:
    """Residuals of one pair over the image, before and after, along and across."""
    record = result.records[view.index]
    kept = record.star.present[:, view.partner]
    maps = []
    for residual in (result.before_px[view.index], result.after_px[view.index]):
        own = residual[:, view.partner]
        reach = _reach(own[kept])
        maps += [(*_as_map(record, np.where(kept, own[:, k], np.nan)), reach) for k in (0, 1)]
    return offset_maps(maps, f"line of {short_label(view.images[0])} (px)")


def offset_maps(maps: Sequence[tuple[Array, Array, Array, float]], title: str) -> Figure:
    """Offsets before and after, along and across: lines, columns, px (lines, columns), end of the scale."""
    figure = Figure(4, height=125)
    for row, (lines, columns, values, reach) in enumerate(maps):
        panel = figure[row]
        panel.title = f"{('before', 'after')[row // 2]}, {COMPONENTS[row % 2]}"
        panel.add(Map(x=lines, y=columns, z=values.T, palette="diverging", low=-reach, high=reach, bar="px"))
        panel.y.title, panel.y.tight = "column (px)", True
    figure[0].x.title = title
    return figure


def residual_histogram(result: LineOfSight) -> Figure:
    """Histograms of all residuals before and after, and what the error model expects of the latter."""
    figure = Figure(1, 2, height=240)
    before, after, sigma = _all_residuals(result)
    for column, (values, name, colour) in enumerate(
        ((before, "before: against the nominal cameras", BEFORE), (after, "after the estimate", AFTER))
    ):
        panel, reach = figure[0, column], _reach(values, 99.8)
        counts, edges = np.histogram(values, bins=81, range=(-reach, reach))
        step = edges[1] - edges[0]
        middle = 0.5 * (edges[1:] + edges[:-1])
        panel.add(
            Bars(place=middle, length=counts / (len(values) * step), thick=step, colour=colour, name=name)
        )
        panel.x.title = f"residual {('before', 'after')[column]} (px)"
        panel.y.title, panel.y.from_zero = "share per px", True
        if column == 1:
            sample = sigma[:: max(1, len(sigma) // 2000)]
            shape = np.exp(-0.5 * (middle[:, None] / sample) ** 2) / (np.sqrt(2.0 * np.pi) * sample)
            panel.add(
                Line(x=middle, y=shape.mean(axis=1), width=1.6, name="expected from the matches' own sigma")
            )
    return figure


def status_figure(result: LineOfSight, views: list[PairView]) -> Figure:
    """Where the matches of each pair were kept, and why the others were not."""
    figure = Figure(len(views), height=80)
    kinds = len(STATUS_NAMES)
    drawn = []
    for view in views:
        record = result.records[view.index]
        codes, edges = _status(record, view.partner).astype(np.uint8), cell_edges(record.star.shape[0])
        drawn.append((*_places(record, edges), cell_modes(codes.reshape(record.star.shape), edges, kinds)))
    met = np.unique(np.concatenate([modes.ravel() for _, _, modes in drawn]))
    names = [
        ("no common ground" if kind == OUTSIDE else STATUS_NAMES[kind], STATUS_COLOURS[kind]) for kind in met
    ]
    for panel, view, (lines, columns, modes) in zip(figure.panels, views, drawn, strict=True):
        panel.title = view.label
        panel.add(Map(x=lines, y=columns, z=np.searchsorted(met, modes).T, names=names))
        panel.y.title, panel.y.tight = "column (px)", True
    figure[0].x.title, figure[0].x.low = "line of the first image of the pair (px)", 0.0
    return figure


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
    present = [record.star.present for record in result.records]
    out, filled = scratch_array((3, 2 * sum(int(one.sum()) for one in present))), 0
    sides = zip(result.records, present, result.before_px, result.after_px, strict=True)
    for record, kept, before, after in sides:
        star = record.star
        for some in star.stretches():
            here = kept[some]
            sigma = np.sqrt(star.error_variance(some))
            values = np.stack([side[here].ravel() for side in (before[some], after[some], sigma)])
            values = values[:, np.isfinite(values[:2]).all(axis=0)]
            out[:, filled : filled + values.shape[1]] = values
            filled += values.shape[1]
            let_go()
    return out[0, :filled], out[1, :filled], out[2, :filled]


def _reach(values: Array, percent: float = 98.0) -> float:
    """Half-range of a symmetric scale."""
    finite = values[np.isfinite(values)]
    np.abs(finite, out=finite)
    return float(np.percentile(finite, percent, overwrite_input=True)) if len(finite) else 1.0
