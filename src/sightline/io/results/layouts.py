"""Ranked layouts → ``layouts.csv`` and ``summary.json``; their columns are described in ``docs/formats.md``.

Not here: the page for people (``report/layout_page.py``).
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.focal_plane import FocalPlane, JudgedLayout, LayoutChoice
from sightline.io.acquisition.acquired import sha256
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.version import VERSION
from sightline.writing import whole

#: Every file that ``layout`` leaves in its folder.
LAYOUT_FILES = ("layouts.csv", "report.html", "summary.json")
COLUMNS = (
    "rank", "name", "positions_px", "positions_s", "images", "span_s", "worst_information", "worst_images",
    "worst_frequency", "sigma_px", "harmonic_sigma_px", "band_sigma_px", "blind_frequencies",
)  # fmt: skip


def write_layouts(
    folder: Path, choice: LayoutChoice, source: Path | None, *, wall_seconds: float
) -> dict[str, Any]:
    """Write ``layouts.csv`` and ``summary.json``; gives the summary.

    Parameters
    ----------
    folder : Path
        Exists.
    choice : LayoutChoice
    source : Path or None
        The INSTRUMENT.toml.
    wall_seconds : float
        s; of the whole command so far.
    """
    plane = choice.focal_plane
    with whole(folder / "layouts.csv") as draft, draft.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for rank, layout in enumerate(choice.ranked, 1):
            row = as_row(plane, layout)
            table.writerow([rank, *(cell(row[name]) for name in COLUMNS[1:])])
    summary = summarize_layouts(choice, source, wall_seconds=wall_seconds)
    write_json(folder / "summary.json", summary)
    return summary


def summarize_layouts(choice: LayoutChoice, source: Path | None, *, wall_seconds: float) -> dict[str, Any]:
    """The content of ``summary.json``: px, s, Hz."""
    plane = choice.focal_plane
    return {
        "name": plane.name,
        "result": "LayoutChoice",
        "version": VERSION,
        "passband": list(choice.passband),
        "detectors": plane.detectors,
        "ranked": [as_row(plane, layout) for layout in choice.ranked],
        "compared": [as_row(plane, layout) for layout in choice.compared],
        "gain_over": {
            other.name: None if other.blind_in_band else choice.best.worst_images / other.worst_images
            for other in choice.compared
        },
        "by_span": {
            "span_s": choice.spans,
            "worst_information": choice.worst_by_span,
            "harmonic_sigma_px": choice.sigma_by_span,
        },
        "prior": [dict(vars(part), kind=type(part).__name__.lower()) for part in choice.prior.components],
        "duration": choice.duration,
        "highest_frequency": choice.highest,
        "tried": choice.tried,
        "exhaustive": choice.exhaustive,
        "warnings": list(choice.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {} if source is None else {source.name: sha256(source)},
    }


def as_row(plane: FocalPlane, layout: JudgedLayout) -> dict[str, Any]:
    """One layout by the names of the columns, and the groups of lags that are blind together."""
    return {
        "name": layout.name,
        "positions_px": places_px(plane, layout),
        "positions_s": layout.positions,
        "images": list(layout.order),
        "span_s": layout.span,
        "worst_information": layout.worst_information,
        "worst_images": layout.worst_images,
        "worst_frequency": layout.worst_frequency,
        "sigma_px": layout.sigma_px,
        "harmonic_sigma_px": layout.harmonic_sigma_px,
        "band_sigma_px": layout.band_sigma_px,
        "blind_frequencies": [blind.frequency for blind in layout.blind],
        "common_lags": [vars(common) for common in layout.common],
    }


def places_px(plane: FocalPlane, layout: JudgedLayout) -> list[float]:
    """Places in px: from the first detector, or the lines of the one detector they are chosen from."""
    first = 0.0 if plane.lines is None or layout.source != "found" else float(plane.lines[0])
    px = first + np.asarray(layout.positions) * plane.ground_rate_px
    return [float(value) for value in np.round(px, 6)]


def cell(value: Any) -> Any:
    """A list as words apart by spaces; a number in full."""
    if isinstance(value, list | np.ndarray):
        return " ".join(f"{item:.10g}" for item in value)
    return f"{value:.10g}" if isinstance(value, float) else value
