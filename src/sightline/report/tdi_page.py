"""The page of a TDI choice.

Not here: its figures (``tdi_figures.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from sightline.applications.tdi_choice import TdiResult
from sightline.evaluation.tdi_pictures import Crop, StripPictures
from sightline.report import tdi_figures
from sightline.report.page import Page, Section, Table, inputs, pictures, resources
from sightline.report.raster import data_png
from sightline.report.words import digits


def tdi_page(result: TdiResult, summary: Mapping[str, Any], shown: StripPictures | None = None) -> Page:
    """The page of a TDI choice.

    Parameters
    ----------
    result : TdiResult
    summary : mapping
        As ``write_tdi_summary`` gives it.
    shown : StripPictures, optional
        A target as it would be imaged.
    """
    limits = [[name, f"{count:,}"] for name, count in summary["limits"].items()]
    ways = [
        [way["name"], f"{100.0 * way['mean_loss']:.2f} %", f"{100.0 * way['worst_loss']:.2f} %"]
        for way in summary["other_ways"]
    ]
    compared = result.comparison
    return Page(
        heading=summary["name"],
        what="TDI stages and integration ratio",
        about=f"TDI stages and integration ratio Kt per column and signal by Sightline {summary['version']}"
        f"{resources(summary)}. Kt is the time that a stage integrates, as a share of the line period.",
        sentences=sentences(result, summary),
        warnings=[warning for warning in summary["warnings"] if warning != compared],
        sections=[
            *sections(result),
            *([] if shown is None else [pictures_section(shown)]),
            Section(
                "limits",
                "What decided",
                [
                    "“None”: merit alone. A limit: it forbids the setting that merit alone would take. "
                    "“Infeasible”: no setting meets this limit; the safest one is used.",
                    *([tdi_figures.limit_figure(result)] if result.choice.limit.any() else []),
                    Table(["limit", "cells"], limits),
                ],
            ),
            Section(
                "comparison",
                "For comparison: other ways of choosing",
                [
                    "Merit lost against the choice, over columns and signals.",
                    Table(["way", "mean loss", "worst loss"], ways),
                    *([f"{compared[0].upper()}{compared[1:]}."] if compared else []),
                ],
            ),
            inputs(summary),
        ],
        footer="Signals are electrons of one line as [head] or [signals] say. Files beside this page: "
        "choice.csv, table.bin with its C, Intel HEX and uplink forms, summary.json.",
    )


#: Radiance that is white in every picture, so that they can be compared; 0 is black.
WHITE = 1.8
CHOSEN, SINGLE = "each column by its own setting", "all columns by the setting of the centre column"


def pictures_section(shown: StripPictures) -> Section:
    """Two miniatures of the whole detector line, and crops of a target: chosen settings above, one below."""
    rows = ((CHOSEN, shown.miniature_chosen, shown.chosen), (SINGLE, shown.miniature_single, shown.single))
    parts: list[str | Markup] = [
        f"A target of {digits(shown.signal, 3)} electrons a line, imaged stage by stage with its drift and "
        "its noise, in units of radiance and with the same greys everywhere: with the setting of each "
        "column, and with the one of the centre column for all. MTF is measured on the slanted edges, SNR "
        "on the flat patch. Rendered, not taken by an instrument.",
        pictures(
            [
                (data_png(grey(small)), f"ground, {title}", _miniature(title, shown))
                for title, small, _ in rows
            ],
            "one",
        ),
    ]
    for title, _, crops in rows:
        parts.append(Markup("<h3>{}</h3>").format(title[0].upper() + title[1:]))
        crop_of = [(data_png(grey(crop.radiance)), f"target, {title}", _caption(crop)) for crop in crops]
        parts.append(pictures(crop_of, "three"))
    return Section("pictures", "What it looks like", parts)


def grey(radiance: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Radiance (lines, columns) as a picture (lines, columns, 3), the same greys for all."""
    level = np.clip(255.0 * radiance / WHITE, 0.0, 255.0).round().astype(np.uint8)
    return np.repeat(level[..., None], 3, axis=2)


def _miniature(title: str, shown: StripPictures) -> str:
    """What the miniature shows."""
    first, last, width = shown.columns[0], shown.columns[-1], len(shown.columns)
    different = len(np.unique(shown.columns))
    if different == 1:
        which = f"column {first:g}, {width} times"
    elif different == width:
        which = f"{width} columns taken evenly from {first:g} to {last:g}"
    else:
        which = f"{different} columns from {first:g} to {last:g}, some more than once to make {width}"
    return f"The whole line in little, {title}: {which}, each drifting as it does"


def _caption(crop: Crop) -> Markup:
    """Setting, and measured beside predicted quality."""
    group, found, said = crop.group, crop.measured, crop.predicted
    mtf = [
        f"{axis} {found.mtf[k]:.3f} ± {found.mtf_sigma[k]:.3f} (predicted {said.mtf[k]:.3f})"
        for k, axis in enumerate(("across", "along"))
    ]
    full = f"; {100.0 * crop.saturated:.0f} % of pixels with a full well" if crop.saturated else ""
    return Markup("<strong>Column {}: {} stages, Kt {}</strong><br>MTF {},<br>{}<br>SNR {}{}").format(
        f"{group.column:g}", group.stages, f"{group.ratio:.2f}", *mtf,
        f"{found.snr:.0f} ± {found.snr_sigma:.0f} (predicted {said.snr:.0f})", full,
    )  # fmt: skip


def sections(result: TdiResult) -> list[Section]:
    """All figures in the order of the page."""
    choice = result.choice
    signal = tdi_figures.electrons(choice.signals[result.landscape.signal])
    grid, merit = choice.grid, []
    # a grid of one number of stages or one ratio has no landscape
    if min(len(grid.stages), len(grid.ratios)) > 1:
        merit.append(
            Section(
                "merit",
                "Merit against stages and integration ratio",
                [
                    f"Every setting at {signal}: {_columns_of(result)}, each relative to its own best. "
                    "The cross is the choice: off the summit where a limit forbids it.",
                    tdi_figures.merit_figure(result),
                ],
            )
        )
    if result.problem.motion is not None:
        merit.append(
            Section(
                "summits",
                "Merit along the stages, under this motion",
                [
                    f"At {signal} and the integration ratio chosen: {_columns_of(result)}, each relative to "
                    "its own best. A motion that comes back periodically may give two summits: few stages, "
                    "which freeze it, or many, over which whole periods are averaged. Where the two are "
                    "nearly equal, stages jump from column to column, and MTF and SNR with them. Hysteresis "
                    "in [choice] makes such jumps fewer; as large as the valley between the summits, and "
                    "with max_step, it keeps neighbouring columns on one of them, at that cost. The cross "
                    "is the choice.",
                    tdi_figures.stages_figure(result),
                ],
            )
        )
    return [
        Section(
            "settings",
            "The choice",
            [
                "For every column and signal, the setting with the largest merit among those that keep the "
                "limits. Columns differ by how the scene drifts over them, signals by which noise rules.",
                tdi_figures.settings_figure(result),
            ],
        ),
        Section(
            "quality",
            "What it makes of the image",
            [
                "MTF of the whole system (optics, pixel, diffusion, motion) and SNR of the sum, predicted "
                "for the chosen settings. Dotted: MTF that a scene at rest would have. Lines of lower "
                "signals are wider, so that equal ones are seen.",
                tdi_figures.quality_figure(result),
            ],
        ),
        *merit,
        Section(
            "table",
            "The table that is looked up",
            [
                f"Merit that the table of {_count(len(result.table.words), 'cell')}, "
                f"{result.certificate.bytes:,} bytes, loses against the best setting of every column "
                "and signal. Within a cell one setting serves all; the bound holds at every point judged."
                + (" Grey: no setting meets all limits." if np.isnan(result.table_loss.loss).any() else ""),
                tdi_figures.table_figure(result),
            ],
        ),
        Section(
            "others",
            "What other ways of choosing would lose",
            [
                "Merit lost against the choice, all of it beyond the main lobe (where contrast is reversed) "
                "and where a well is full. One setting: that of the centre column at the middle signal, for "
                "the whole detector. One signal: each column its own setting, whatever the scene. The form "
                "of EP2733929: its equations, misprints corrected, judged by the exact ones.",
                tdi_figures.others_figure(result),
            ],
        ),
    ]


def _columns_of(result: TdiResult) -> str:
    """The columns of the landscape in words."""
    some = result.landscape.columns
    return {1: "the one column", 2: "the first and the last column"}.get(
        len(some), "the first, the middle and the last column"
    )


def sentences(result: TdiResult, summary: Mapping[str, Any]) -> list[str]:
    """The choice in plain words."""
    said = [_what(result, summary), _how_good(summary), _others(summary), _table(summary["table"])]
    if summary["steady"] is not None:
        said.append(_steady(summary["steady"]))
    if summary["motion"] is not None:
        said.append(_strip(summary["motion"]))
    if summary["predicted_loss"] is not None:
        said.append(_uncertain(summary))
    return said


def _what(result: TdiResult, summary: Mapping[str, Any]) -> str:
    rules = result.problem.rules
    form = {
        "product": "MTF across x MTF along x SNR",
        "geomean": "geometric mean of the MTFs x SNR",
        "mean": "mean of the MTFs x SNR",
        "min": "smaller of the MTFs x SNR",
        "x": "MTF across x SNR",
        "y": "MTF along x SNR",
    }[rules.merit].replace(" x ", " × ")
    return (
        f"For {_count(summary['columns'], 'column')} and {_count(summary['signals'], 'signal')} every one "
        f"of {_count(summary['settings'], 'setting')} was judged by {form}. Chosen are "
        f"{_range(summary['stages'])} stages, and integration ratios Kt (integration time over line period) "
        f"of {_range(summary['integration_ratio'])}."
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def _range(spread: Mapping[str, float], figures: int | None = None) -> str:
    """Least to most, or the one value."""
    low, high = (
        f"{spread[end]:g}" if figures is None else digits(spread[end], figures) for end in ("min", "max")
    )
    return low if low == high else f"{low} to {high}"


def _how_good(summary: Mapping[str, Any]) -> str:
    x, y, snr = (_range(summary[name], 2) for name in ("mtf_x", "mtf_y", "snr"))
    return f"With them the MTF is {x} across and {y} along the columns, the SNR {snr}."


def _table(table: Mapping[str, Any]) -> str:
    columns, signals = table["points"]
    return (
        f"As a table it takes {table['bytes']:,} bytes and loses {100.0 * table['certified_loss']:.2g} % of "
        f"the merit at worst, {100.0 * table['mean_loss']:.2g} % on average, judged at "
        f"{_count(columns, 'column')} × {_count(signals, 'signal')}."
    )


def _uncertain(summary: Mapping[str, Any]) -> str:
    loss, motion = summary["predicted_loss"], summary["motion"]
    what = "Velocity and slip are" if motion is None else "Velocity, slip and the recovered motion are"
    columns = [f"{column:g}" for column in loss["columns"]]
    where = (
        f"in column {columns[0]}" if len(columns) == 1 else f"in the worst of columns {', '.join(columns)}"
    )
    return (
        f"{what} not known exactly: against one who knew them this choice gives away "
        f"{100.0 * loss['mean']:.2g} % of the merit on average, and with 95 % probability no more than "
        f"{100.0 * loss['upper_95']:.2g} % {where}, for which this was "
        "reckoned."
    )


def _strip(motion: Mapping[str, Any]) -> str:
    """What part of the motion settings were judged by."""
    lines, draws = motion["lines"], motion["draws"]
    each = (
        f"{lines} lines"
        if draws == 1
        else (
            f"{lines} lines, {lines // draws} for each of {draws} motions that agree with what was recovered"
        )
    )
    return (
        f"The settings are for the motion of one strip, from {digits(motion['first_start'], 3)} to "
        f"{digits(motion['last_start'], 3)} s: the merit of each is its mean over {each}."
    )


def _steady(steady: Mapping[str, Any]) -> str:
    before, after = steady["changes"]
    return (
        f"So that settings change seldom from column to column ({after:,} times instead of {before:,}), "
        f"{100.0 * steady['mean_loss']:.2g} % of the merit is given up on average, "
        f"{100.0 * steady['worst_loss']:.2g} % at most."
    )


def _others(summary: Mapping[str, Any]) -> str:
    one = summary["other_ways"][0]
    return (
        f"One setting for all, taken from the centre column, would lose {100.0 * one['mean_loss']:.3g} % of "
        f"the merit on average and {100.0 * one['worst_loss']:.3g} % in the worst cell."
    )
