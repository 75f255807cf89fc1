"""The report of ``register``: bands before and after in colour, how well every pair fits, maps of misfit.

Not here: the images (``products/``), the page of a recovery (``page.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.imaging.source import ImageSource
from sightline.io.registered import Written
from sightline.products.band_fit import WINDOW, BandFit
from sightline.report.composite import CROP, colours, data_png
from sightline.report.page import Section, render, write_page
from sightline.report.style import panels

Array = NDArray[np.float64]

DIVERGING = "RdBu_r"
#: How a band came to its place, in words.
_PLACED = {"matches": "its own matches", "motion": "the recovered motion alone"}
#: Places tried for the pictures until one has no gap.
CROPS_TRIED = 12


@dataclass(frozen=True)
class Pictures:
    """A crop of up to three bands in colour, before and after, as ``data:`` addresses of PNG pictures."""

    legend: str
    lines: tuple[int, int]
    columns: tuple[int, int]
    before: str
    after: str


def write_register_report(
    path: Path,
    written: Written,
    before: Sequence[BandFit],
    after: Sequence[BandFit],
    summary: Mapping[str, Any],
) -> None:
    """Write ``report.html``, complete or not at all.

    Parameters
    ----------
    path : Path
        Of the page.
    written : Written
        The images.
    before, after : sequence of BandFit
        Of the same pairs.
    summary : mapping
        As ``io.registration_summary`` gives it, with `wall_seconds`.
    """
    html = render(
        "register.html.j2",
        summary=summary,
        sentences=sentences(summary),
        pictures=pictures(written, before, summary),
        pairs=[_pair_row(pair) for pair in summary["pairs"]],
        sections=sections(before, after, summary),
        bands=_band_rows(summary),
    )
    write_page(path, html)


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """What the numbers say, in words."""
    sizes = {
        when: [float(np.hypot(*pair[when][key])) for pair in summary["pairs"]]
        for when, key in (("before", "rms_px"), ("after", "rms_px"))
    }
    noise = [float(np.hypot(*pair["after"]["noise_px"])) for pair in summary["pairs"]]
    known = np.isfinite(sizes["after"]) & np.isfinite(sizes["before"])
    out = [
        f"{len(summary['bands'])} bands were resampled onto {summary['onto']}, each once, with the motion "
        "and the band offsets that were recovered from them."
    ]
    if known.any():
        worst = int(np.nanargmax(np.where(known, sizes["after"], np.nan)))
        label = " and ".join(summary["pairs"][worst]["images"])
        whose = "pairs of bands" if known.all() else "the pairs of bands that can be matched"
        out.append(
            f"By the nominal cameras, {whose} lay up to {np.nanmax(sizes['before']):.2f} px apart "
            f"(rms over the image). Now they lie within {sizes['after'][worst]:.3f} px; the worst pair is "
            f"{label}, of which single matches are good to {noise[worst]:.3f} px."
        )
    unknown = [" – ".join(pair["images"]) for pair, ok in zip(summary["pairs"], known, strict=True) if not ok]
    if unknown:
        out.append(f"Too few windows match to say how well these fit: {', '.join(unknown)}.")
    alone = [band["name"] for band in summary["bands"] if band["placed_by"] == "motion"]
    if alone:
        out.append(
            f"Placed by the recovered motion alone, their own place never measured: {', '.join(alone)}."
        )
    return out


def pictures(written: Written, before: Sequence[BandFit], summary: Mapping[str, Any]) -> Pictures | None:
    """Colour crops where the pair that was furthest apart was so most; None without a match."""
    # pairs with a few false matches only would be the furthest apart of all
    fits = [fit for fit in before if fit.known] or [fit for fit in before if len(fit.points)]
    if not fits:
        return None
    fit = max(fits, key=lambda one: float((one.offset_px**2).mean()))
    others = [k for k in range(len(written.after)) if k not in fit.images]
    shown = sorted([*fit.images, *others[:1]])
    lines, columns = _busiest_crop(
        fit, [images[k] for images in (written.before, written.after) for k in shown]
    )
    names = [summary["bands"][k]["name"] for k in shown]
    hues = ("red", "green", "blue") if len(shown) == 3 else ("red", "cyan")
    legend = ", ".join(f"{name} in {hue}" for name, hue in zip(names, hues, strict=True))
    drawn = [
        data_png(colours([_crop(images[k], lines, columns) for k in shown]))
        for images in (written.before, written.after)
    ]
    return Pictures(legend, lines, columns, drawn[0], drawn[1])


def _busiest_crop(fit: BandFit, images: Sequence[ImageSource]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Lines and columns of a crop about a window that lay far off, where all images have values.

    The fullest of a few tried is taken where none is full.
    """
    shape = images[0].shape
    size = [min(CROP[k], shape[k]) for k in (0, 1)]
    moved = np.linalg.norm(fit.offset_px - np.median(fit.offset_px, axis=0), axis=1)
    best, chosen = -1.0, ((0, size[0]), (0, size[1]))
    for rank in np.linspace(0.97, 0.5, CROPS_TRIED):
        centre = fit.points[np.argsort(moved)[int(rank * (len(moved) - 1))]]
        first = [int(np.clip(round(centre[k] - size[k] / 2), 0, shape[k] - size[k])) for k in (0, 1)]
        crop = (first[0], first[0] + size[0]), (first[1], first[1] + size[1])
        full = min(float(np.isfinite(_crop(image, *crop)).mean()) for image in images)
        if full > best:
            best, chosen = full, crop
        if best == 1.0:
            break
    return chosen


def _crop(image: ImageSource, lines: tuple[int, int], columns: tuple[int, int]) -> Array:
    """Pixels of a crop, NaN where there is no value."""
    pixels, bad = image.read(lines, columns).astype(np.float64), image.mask(lines, columns)
    return pixels if bad is None else np.where(bad, np.nan, pixels)


def sections(
    before: Sequence[BandFit], after: Sequence[BandFit], summary: Mapping[str, Any]
) -> list[Section]:
    """Maps of misfit of the pair that was furthest apart; none without matches."""
    # of the pairs whose fit is known, if there is one: a few false matches would be the furthest apart of all
    some = [fit.known for fit in before] if any(fit.known for fit in before) else [True] * len(before)
    sizes = [
        float((fit.offset_px**2).mean()) if ok and len(fit.points) else -1.0
        for fit, ok in zip(before, some, strict=True)
    ]
    if not sizes or max(sizes) < 0.0:
        return []
    worst = int(np.argmax(sizes))
    label = " – ".join(summary["pairs"][worst]["images"])
    return [
        Section(
            "misfit",
            f"Misfit over the image, before and after ({label})",
            f"Where {summary['pairs'][worst]['images'][1]} shows a window, less where the other does: red is "
            "a later line (a larger column). Stripes are motion, slopes a rotation, patches relief or false "
            "matches. The scales of before and after differ.",
            misfit_figure(before[worst], after[worst], summary["shape"]),
        )
    ]


def misfit_figure(before: BandFit, after: BandFit, shape: Sequence[int]) -> go.Figure:
    """Offsets of one pair over the image, before and after, along and across."""
    titles = [
        f"{when}, {axis}" for when in ("before", "after") for axis in ("along (lines)", "across (columns)")
    ]
    figure = panels(4, 640, shared_xaxes=True, gap_px=34.0, subplot_titles=titles)
    seen_lines, seen_columns = (_seen_range([before, after], axis, shape[axis]) for axis in (0, 1))
    for row, (fit, component) in enumerate((fit, k) for fit in (before, after) for k in (0, 1)):
        lines, columns, table = _table(fit, component)
        reach = float(np.percentile(np.abs(fit.offset_px), 99.0)) if len(fit.points) else 1.0
        figure.add_heatmap(
            x=_cells(lines, 0), y=_cells(columns, 1), z=table.T, zmin=-reach, zmax=reach,
            colorscale=DIVERGING, row=row + 1, col=1,
            colorbar={
                "title": {"text": "px", "side": "right"},
                "len": 0.5, "y": 0.77 if row < 2 else 0.23, "thickness": 12,
            },
            showscale=row % 2 == 0,
            hovertemplate="line %{x:.0f}, column %{y:.0f}: %{z:.3f} px<extra></extra>",
        )  # fmt: skip
        figure.update_yaxes(title_text="column (px)", range=seen_columns, row=row + 1)
    figure.update_xaxes(title_text="line (px)", range=seen_lines, row=4)
    return figure


def _seen_range(fits: Sequence[BandFit], axis: int, size: int) -> list[float]:
    """First and last line (axis 0) or column (axis 1) of the windows kept: narrow overlaps fill the map."""
    places = np.concatenate([fit.points[:, axis] for fit in fits])
    if not len(places):
        return [0.0, float(size)]
    half = 0.5 * WINDOW[axis]
    return [max(float(places.min()) - half, 0.0), min(float(places.max()) + half, float(size))]


def _cells(centres: Array, axis: int) -> Array:
    """Centres of windows as they are drawn; the two ends of a single one, else a pixel wide."""
    half = 0.5 * WINDOW[axis]
    return centres if len(centres) != 1 else np.array([centres[0] - half, centres[0] + half])


def _table(fit: BandFit, component: int) -> tuple[Array, Array, Array]:
    """Offsets on the grid of their windows, NaN where none was kept."""
    lines, row = np.unique(fit.points[:, 0], return_inverse=True)
    columns, column = np.unique(fit.points[:, 1], return_inverse=True)
    table = np.full((len(lines), len(columns)), np.nan)
    table[row, column] = fit.offset_px[:, component]
    return lines, columns, table


def _pair_row(pair: Mapping[str, Any]) -> list[str]:
    """One line of the table of pairs."""
    before, after = pair["before"], pair["after"]
    return [
        " – ".join(pair["images"]),
        _both(before["rms_px"], 2),
        _both(after["rms_px"], 4),
        _both(after["noise_px"], 4),
        _both(after["mean_px"], 4),
        str(after["windows"]),
        str(after["kept"]),
    ]


def _both(values: Sequence[float], digits: int) -> str:
    """Along / across; a dash where not known."""
    return " / ".join(
        "–" if not np.isfinite(v) else f"{round(v, digits) + 0.0:.{digits}f}".replace("-", "−")
        for v in values
    )


def _band_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """One line per band of what was written."""
    files = summary["files"] if len(summary["files"]) > 1 else summary["files"] * len(summary["bands"])
    return [
        [
            band["name"],
            f"{100.0 * band['valid_share']:.1f} %",
            _PLACED[band["placed_by"]],
            band["type"],
            file,
        ]
        for band, file in zip(summary["bands"], files, strict=True)
    ]
