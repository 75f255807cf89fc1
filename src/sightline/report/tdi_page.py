"""The report of a TDI choice: one HTML page that asks no network for anything.

Not here: its figures (``tdi_figures.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sightline.applications.tdi_choice import TdiResult
from sightline.evaluation.tdi_pictures import StripPictures
from sightline.report import tdi_figures
from sightline.report.page import Section, render, write_page
from sightline.report.tdi_pictures import tdi_pictures_html
from sightline.report.words import digits


def write_tdi_report(
    path: Path, result: TdiResult, summary: Mapping[str, Any], pictures: StripPictures | None = None
) -> None:
    """Write ``report.html``, complete or not at all.

    Parameters
    ----------
    path : Path
        Of the page.
    result : TdiResult
    summary : mapping
        As ``io.tdi_results.write_tdi_summary`` gives it.
    pictures : StripPictures, optional
        A target as it would be imaged.
    """
    write_page(path, tdi_html(result, summary, pictures))


def tdi_html(result: TdiResult, summary: Mapping[str, Any], pictures: StripPictures | None = None) -> str:
    """The page as text; parameters as of `write_tdi_report`."""
    return render(
        "tdi.html.j2",
        summary=summary,
        sentences=sentences(result, summary),
        sections=sections(result),
        pictures=None if pictures is None else tdi_pictures_html(pictures),
        picture_signal=None if pictures is None else digits(pictures.signal, 3),
        ways=[
            [way["name"], f"{100.0 * way['mean_loss']:.2f} %", f"{100.0 * way['worst_loss']:.2f} %"]
            for way in summary["other_ways"]
        ],
        limits=[[name, f"{count:,}"] for name, count in summary["limits"].items()],
    )


def sections(result: TdiResult) -> list[Section]:
    """All figures in the order of the page."""
    choice = result.choice
    signal = choice.signals[result.landscape.signal]
    return [
        Section(
            "settings",
            "The choice",
            "For every column and signal, the setting with the largest merit among those that keep the "
            "limits. Columns differ by how the scene drifts over them, signals by which noise rules.",
            tdi_figures.settings_figure(result),
        ),
        Section(
            "quality",
            "What it makes of the image",
            "MTF of the whole system (optics, pixel, diffusion, motion) and SNR of the sum, predicted for "
            "the chosen settings. The dotted line is what a scene at rest would have.",
            tdi_figures.quality_figure(result),
        ),
        Section(
            "merit",
            "Merit against stages and integration ratio",
            f"Three columns at {signal:.3g} electrons a line; each relative to its own best. The cross is "
            "the choice: off the summit where a limit forbids it.",
            tdi_figures.merit_figure(result),
        ),
        Section(
            "table",
            "The table that is looked up",
            f"Merit that the table of {len(result.table.words)} cells, {result.certificate.bytes:,} bytes, "
            "loses against the best setting of every column and signal. Within a cell one setting serves "
            "all; the bound holds at every point judged. White: no setting keeps all limits.",
            tdi_figures.table_figure(result),
        ),
        Section(
            "others",
            "What other ways of choosing would lose",
            "Merit lost against the choice, all of it beyond the main lobe (where contrast is reversed) "
            "and where a well is full. One setting: that of the centre column at the middle signal, for the "
            "whole detector. One signal: each column its own setting, whatever the scene. The form of "
            "EP2733929: its equations, misprints corrected, judged by the exact ones.",
            tdi_figures.others_figure(result),
        ),
    ]


def sentences(result: TdiResult, summary: Mapping[str, Any]) -> list[str]:
    """The choice in plain words."""
    said = [_what(result, summary), _how_good(summary), _others(summary), _table(summary["table"])]
    if summary["steady"] is not None:
        said.append(_steady(summary["steady"]))
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
    stages, ratio = summary["stages"], summary["integration_ratio"]
    return (
        f"For {summary['columns']:,} columns and {summary['signals']} signals every one of "
        f"{summary['settings']:,} settings was judged by {form}. Chosen are {stages['min']:g} to "
        f"{stages['max']:g} stages, and integration times of {ratio['min']:g} to {ratio['max']:g} of the "
        "line period."
    )


def _how_good(summary: Mapping[str, Any]) -> str:
    x, y, snr = summary["mtf_x"], summary["mtf_y"], summary["snr"]
    return (
        f"With them the MTF is {digits(x['min'], 2)} to {digits(x['max'], 2)} across and "
        f"{digits(y['min'], 2)} to {digits(y['max'], 2)} along the columns, the SNR {digits(snr['min'], 2)} "
        f"to {digits(snr['max'], 2)}."
    )


def _table(table: Mapping[str, Any]) -> str:
    columns, signals = table["points"]
    return (
        f"As a table it takes {table['bytes']:,} bytes and loses {100.0 * table['certified_loss']:.2g} % of "
        f"the merit at worst, {100.0 * table['mean_loss']:.2g} % on average, judged at {columns:,} columns × "
        f"{signals:,} signals."
    )


def _uncertain(summary: Mapping[str, Any]) -> str:
    loss, motion = summary["predicted_loss"], summary["motion"]
    what = "Velocity and slip are" if motion is None else "Velocity, slip and the recovered motion are"
    lines = "" if motion is None else f" Settings were judged by {motion['lines']} lines of the strip."
    return (
        f"{what} not known exactly: against one who knew them this choice gives away "
        f"{100.0 * loss['mean']:.2g} % of the merit on average, and with 95 % probability no more than "
        f"{100.0 * loss['upper_95']:.2g} % in the worst of {len(loss['columns'])} columns.{lines}"
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
