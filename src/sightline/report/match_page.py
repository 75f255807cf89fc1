"""The report of ``match``: images before and after in colour, the shifts over the image, their means.

Not here: the shifts (``applications/raster_matches.py``), how bands of a strip fit (``register_page.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.raster_matches import BandMatches, MatchProfile, Overlay, RasterMatches
from sightline.errors import printable
from sightline.imaging.reduce import reduced_pixels
from sightline.imaging.source import ImageSource
from sightline.imaging.warp import WarpedImage
from sightline.matching.matches import STATUS_NAMES
from sightline.report.composite import CROP, colours
from sightline.report.figure import Figure
from sightline.report.marks import Bars, Between, Line, Map
from sightline.report.page import Page, Section, Table, inputs, pictures, resources
from sightline.report.raster import data_png
from sightline.report.reduce import cell_edges, cell_means
from sightline.report.style import AXIS_COLOURS, labels

Array = NDArray[np.float64]

#: Arrows along the longer side of the image; pairs of bands that have figures of their own.
_ARROWS, _PAIRS = 24, 12
#: Cells of a map along each side.
_CELLS = 300
_NAMES = ("d_line", "d_column")


def match_page(result: RasterMatches, summary: Mapping[str, Any]) -> Page:
    """The page of one pair.

    Parameters
    ----------
    result : RasterMatches
    summary : mapping
        As ``io.results.raster_matches`` gives it.
    """
    windows = summary["windows"]
    return Page(
        heading=summary["name"],
        what="shifts between two images",
        about=f"{windows['kept']} of {windows['tried']} windows of {_sides(result.window)} px by Sightline "
        f"{summary['version']}{resources(summary)}",
        sentences=sentences(result, summary),
        warnings=summary["warnings"],
        sections=[
            *overlay_sections(result),
            *shift_sections(result),
            Section("windows", "What became of the windows", [_status_table(result)]),
            inputs(summary),
        ],
        footer="d_line and d_column are the place in the second image less the place in the first, in pixels "
        "of the first, once the second is laid on its grid. Files beside this page: matches.csv, rows.csv, "
        "columns.csv, shifts.tif, summary.json.",
    )


def band_page(result: BandMatches, summary: Mapping[str, Any]) -> Page:
    """The page of the bands of a file."""
    heads = "pair|median d_line / d_column (px)|rms (px)|sigma of a window (px)|windows|kept".split("|")
    rows = [
        [
            " – ".join(pair["images"]),
            _both(pair["median_px"]),
            _both(pair["rms_px"]),
            _both(pair["sigma_px"]),
            pair["windows"]["tried"],
            pair["windows"]["kept"],
        ]
        for pair in summary["pairs"]
    ]
    shown = list(zip(summary["pairs"], result.matches, strict=True))[:_PAIRS]
    sections = [Section("pairs", "Shifts of the pairs", [Table(heads, rows)])]
    for number, (pair, one) in enumerate(shown, 1):
        name = " – ".join(labels(pair["images"]))
        sections.append(Section(f"pair{number}", f"{name}: over the image", [shift_maps(one)]))
        sections.append(Section(f"means{number}", f"{name}: means", [profile_figure(one)]))
    return Page(
        heading=summary["name"],
        what="shifts between bands",
        about=f"{len(summary['bands'])} bands, {len(rows)} pairs by Sightline {summary['version']}"
        f"{resources(summary)}",
        sentences=[
            "Each pair of bands was matched window by window; what single windows are good to stands beside "
            "what they show."
        ],
        warnings=summary["warnings"],
        sections=[*sections, inputs(summary)],
        footer="Files beside this page, by the numbers of the bands: matches_*.csv, rows_*.csv, "
        "columns_*.csv, shifts_*.tif; pairs.csv, summary.json.",
    )


def shift_sections(result: RasterMatches) -> list[Section]:
    """The shifts over the image, their means, their score."""
    return [
        Section(
            "shifts",
            "Shifts over the image",
            [
                "Colours are shifts less their median, so that both signs are seen. Stripes along columns "
                "are motion between lines, slopes a rotation or another scale, patches relief or change.",
                shift_maps(result),
            ],
        ),
        Section("arrows", "The same as strokes from each window", [arrows(result)]),
        Section(
            "means",
            "Means of rows and of columns of windows",
            [
                "Weighted means with the sigma that the covariances of the windows make of them (shaded).",
                profile_figure(result),
            ],
        ),
        Section("score", "How alike the windows are", [score_figure(result)]),
    ]


def sentences(result: RasterMatches, summary: Mapping[str, Any]) -> list[str]:
    """What was found, in words."""
    line, column = summary["median_px"]
    how = {
        "map": "The second image was laid on the first by their places on the map",
        "pixels": "The images were compared pixel by pixel",
    }[result.geometry]
    reduced = "" if result.reduced == 1 else f", pixels of the first averaged over {result.reduced} a side"
    scatter, sigma = summary["scatter_px"], summary["sigma_px"]
    return [
        f"{how}{reduced}.",
        f"The second shows the ground {_signed(line)} lines and {_signed(column)} columns (median) from "
        "where the first does.",
        f"Windows scatter by {scatter[0]:.3f} / {scatter[1]:.3f} px (lines / columns); a window alone is "
        f"known to {sigma[0]:.3f} / {sigma[1]:.3f} px.",
    ]


def _signed(value: float) -> str:
    return f"{value:+.3f}".replace("-", "−")


def _sides(pair: Sequence[float]) -> str:
    return f"{pair[0]:g} × {pair[1]:g}"


def _both(pair: Sequence[float]) -> str:
    return " / ".join(f"{value:.4f}".replace("-", "−") for value in pair)


def _axes(result: RasterMatches) -> tuple[Array, Array]:
    """Lines and columns of the windows' centres."""
    lines, columns = (
        result.first[k] + result.step[k] * np.arange(result.shape[k], dtype=np.float64) for k in (0, 1)
    )
    return lines, columns


def _cells(values: Array) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """A table of windows small enough for a page, and the first rows and columns of its cells."""
    rows, columns = (cell_edges(size, _CELLS) for size in values.shape)
    return cell_means(cell_means(values, rows).T, columns).T, rows, columns


def _middles(places: Array, edges: NDArray[np.intp]) -> Array:
    return np.array([places[a:b].mean() for a, b in pairwise(edges)])


def shift_maps(result: RasterMatches) -> Figure:
    """Each component over the image, less its median."""
    figure = Figure(1, 2, height=230)
    lines, columns = _axes(result)
    shift = result.shift_px.reshape(*result.shape, 2)
    for k, name in enumerate(_NAMES):
        middle = float(np.nanmedian(shift[..., k]))
        values, rows, cells = _cells(shift[..., k] - middle)
        seen = np.abs(values[np.isfinite(values)])
        reach = max(float(np.percentile(seen, 98.0)) if len(seen) else 1.0, 1e-6)
        panel = figure[0, k]
        panel.title = f"{name} less {middle:.3f} px"
        panel.add(
            Map(
                x=_middles(columns, cells), y=_middles(lines, rows), z=values, palette="diverging",
                low=-reach, high=reach, bar="px",
            )
        )  # fmt: skip
        panel.x.title, panel.y.title = "column (px)", "line (px)"
        panel.y.downward, panel.y.tight = True, True
    return figure


def arrows(result: RasterMatches) -> Figure:
    """Shifts less their median as strokes from each window, drawn longer than they are."""
    lines, columns = _axes(result)
    shift = result.shift_px.reshape(*result.shape, 2)
    shift = shift - np.nanmedian(shift, axis=(0, 1))
    every = [max(1, -(-size // _ARROWS)) for size in result.shape]
    at = np.stack(np.meshgrid(lines[:: every[0]], columns[:: every[1]], indexing="ij"), axis=-1)
    some = shift[:: every[0], :: every[1]]
    length = np.hypot(*np.moveaxis(some, -1, 0))
    longest = float(np.nanpercentile(length, 95.0)) if np.isfinite(length).any() else 1.0
    room = min(every[k] * result.step[k] for k in (0, 1))
    by = room / max(longest, 1e-9)
    end = at + by * some
    figure = Figure(1, height=320)
    panel = figure[0]
    x = np.stack([at[..., 1], end[..., 1], np.full(length.shape, np.nan)], axis=-1).ravel()
    y = np.stack([at[..., 0], end[..., 0], np.full(length.shape, np.nan)], axis=-1).ravel()
    gone = ~np.isfinite(np.repeat(length.ravel(), 3))
    x[gone], y[gone] = np.nan, np.nan
    panel.add(Line(x=x, y=y, colour=AXIS_COLOURS[0], name=f"shift less its median, {by:.3g} times as long"))
    panel.x.title, panel.y.title, panel.y.downward = "column (px)", "line (px)", True
    panel.equal = True
    return figure


def profile_figure(result: RasterMatches) -> Figure:
    """Means of rows and columns with their sigma."""
    figure = Figure(2, 1, height=150, shared=False)
    profiles: tuple[tuple[str, MatchProfile], ...] = (
        ("line", result.row_means), ("column", result.column_means),
    )  # fmt: skip
    for row, (name, profile) in enumerate(profiles):
        panel = figure[row]
        for k, (component, colour) in enumerate(zip(_NAMES, AXIS_COLOURS, strict=False)):
            mean, sigma = profile.shift_px[:, k], profile.sigma_px[:, k]
            mean = mean - np.nanmedian(mean)
            panel.add(
                Between(x=profile.place, low=mean - sigma, high=mean + sigma, colour=colour),
                Line(x=profile.place, y=mean, colour=colour, name=f"{component} less its median"),
            )
        panel.x.title, panel.y.title = f"{name} (px)", "mean shift (px)"
        panel.x.tight = True
    return figure


def score_figure(result: RasterMatches) -> Figure:
    """Histogram of the normalised correlation of windows, kept and not."""
    figure = Figure(1, height=170)
    panel = figure[0]
    kept = result.matches.kept
    edges = np.linspace(0.0, 1.0, 51)
    middle, step = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    for rows, name, colour in (
        (np.isfinite(result.matches.score), "all that were compared", "#b8bec5"),
        (kept, "kept", AXIS_COLOURS[0]),
    ):
        counts, _ = np.histogram(result.matches.score[rows], bins=edges)
        panel.add(Bars(place=middle, length=counts, thick=step, colour=colour, name=name))
    panel.x.title, panel.y.title, panel.y.from_zero = "normalised correlation", "windows", True
    return figure


def _status_table(result: RasterMatches) -> Table:
    """How many windows were kept, and why the others were not."""
    counts = result.matches.counts()
    return Table(["window", "number"], [[name, counts[name]] for name in STATUS_NAMES if counts[name]])


def overlay_sections(result: RasterMatches) -> list[Section]:
    """A crop of both images in red and cyan, before and after the shifts."""
    overlay = result.overlay
    if overlay is None:
        return []
    lines, columns = _crop(result, overlay)
    shown = [
        _pixels(overlay.a, lines, columns),
        _pixels(_moved(result, overlay, follow=False), lines, columns),
        _pixels(_moved(result, overlay, follow=True), lines, columns),
    ]
    first, second = (printable(name) for name in result.names)
    drawn = [data_png(colours([shown[0], other])) for other in shown[1:]]
    caption = (
        f"{first} in red, {second} in cyan; lines {lines[0]}–{lines[1] - 1}, columns {columns[0]}–"
        f"{columns[1] - 1}"
        + (f" of images reduced by {overlay.reduced}" if overlay.reduced > 1 else "")
        + ", where shifts depart most from their median. Where images fit, the overlay is grey. Flat light "
        "grey: no value."
    )
    given = "by their pixels" if result.geometry == "pixels" else "by the map"
    both = [
        (drawn[0], "Both images as they lie", f"Before: {given}"),
        (drawn[1], "Both images by the shifts found", "After: the second moved by the shifts found"),
    ]
    return [Section("pictures", "The same ground, before and after", [caption, pictures(both)])]


def _crop(result: RasterMatches, overlay: Overlay) -> tuple[tuple[int, int], tuple[int, int]]:
    """Lines and columns of `overlay.a` about a window that departs from the median."""
    shift = result.shift_px
    away = np.linalg.norm(shift - np.nanmedian(shift, axis=0), axis=1)
    order = np.argsort(np.where(np.isfinite(away), away, -1.0))
    kept = int(result.matches.kept.sum())
    # not the very farthest: it may be the one false match
    window = order[len(order) - 1 - int(0.03 * kept)]
    centre = reduced_pixels(result.matches.a[[window]], overlay.reduced)[0]
    spans = []
    for k in (0, 1):
        size = min(CROP[k], overlay.a.shape[k])
        first = int(np.clip(round(centre[k] - size / 2), 0, overlay.a.shape[k] - size))
        spans.append((first, first + size))
    return spans[0], spans[1]


def _moved(result: RasterMatches, overlay: Overlay, *, follow: bool) -> ImageSource:
    """The second image on the grid of the first, by the shifts found or as it lies."""

    def mapping(lines: Array, columns: Array) -> Array:
        at = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1)
        moved = _shift_at(result, at, overlay.reduced) if follow else 0.0
        return np.asarray(at + overlay.offset + moved)

    return WarpedImage(overlay.b, mapping, overlay.a.shape, spacing=8, smooth=False)


def _shift_at(result: RasterMatches, at: Array, reduced: int) -> Array:
    """Shifts (..., 2) in pixels of the reduced image at its pixels, between the windows that were kept."""
    from scipy.interpolate import RegularGridInterpolator, griddata

    kept = result.matches.kept
    shift = result.shift_px.reshape(*result.shape, 2)
    axes = [a / reduced - 0.5 * (reduced - 1) / reduced for a in _axes(result)]
    if not kept.all():
        # holes take the nearest window
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        filled = griddata(grid[kept], result.shift_px[kept], grid, method="nearest")
        shift = filled.reshape(*result.shape, 2)
    if min(result.shape) < 2:
        return np.broadcast_to(np.nanmedian(shift, axis=(0, 1)) / reduced, at.shape)
    low, high = (np.array([axis[k] for axis in axes]) for k in (0, -1))
    table = RegularGridInterpolator(tuple(axes), shift / reduced)
    return np.asarray(table(np.clip(at, low, high)))


def _pixels(image: ImageSource, lines: tuple[int, int], columns: tuple[int, int]) -> Array:
    """Pixels of a crop, NaN where there is no value."""
    pixels, bad = image.read(lines, columns).astype(np.float64), image.mask(lines, columns)
    return pixels if bad is None else np.where(bad, np.nan, pixels)
