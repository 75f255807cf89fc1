"""Ranked layouts of a focal plane: `layout`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.focal_plane import LayoutChoice
from sightline.errors import foreign_errors
from sightline.io.results.layouts import COLUMNS, LAYOUT_FILES, as_row, cell, summarize_layouts, write_layouts
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell, given, warned
from sightline.report.layout_page import layout_page
from sightline.result import source_of


class Layouts(ResultKind):
    """`LayoutChoice`."""

    types = (LayoutChoice,)
    table, index, files = "layouts", ("rank",), LAYOUT_FILES
    units = {
        "positions_px": "px", "positions_s": "s", "span_s": "s", "worst_information": "px-2",
        "worst_frequency": "Hz", "sigma_px": "px", "harmonic_sigma_px": "px", "band_sigma_px": "px",
        "blind_frequencies": "Hz",
    }  # fmt: skip

    def facts(self, result: LayoutChoice) -> Mapping[str, str]:
        """The band, the best layout, how many."""
        low, high = result.passband
        rows = self.summary(result)["ranked"]
        places = " ".join(f"{1e3 * t:.4g}" for t in rows[0]["positions_s"])
        return {
            "band": f"{low:g} to {high:g} Hz",
            "best": f"detectors at {places} ms",
            "worst case": f"{rows[0]['worst_images']:.3g} images at {rows[0]['worst_frequency']:.4g} Hz",
            "layouts": str(len(rows)),
            **warned(result),
        }

    def columns(self, result: LayoutChoice) -> Columns:
        """``layouts.csv``."""
        rows = [as_row(result.focal_plane, layout) for layout in result.ranked]
        shown = [
            [
                cell(row[name]) if isinstance(row[name], list | np.ndarray) else row[name]
                for name in COLUMNS[1:]
            ]
            for row in rows
        ]
        return {
            "rank": np.arange(1, len(rows) + 1),
            **dict(zip(COLUMNS[1:], zip(*shown, strict=True), strict=True)),
        }

    def summarize(self, result: LayoutChoice) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_layouts(result, _source(result), wall_seconds=result.origin.seconds)

    def render(self, result: LayoutChoice, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """Every file."""
        tell("writing the layouts and their report")
        summary = write_layouts(folder, result, _source(result), wall_seconds=time.perf_counter() - begun)
        layout_page(result, summary).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """What the summary has in numbers; the layouts themselves are its table."""
        with foreign_errors(folder / SUMMARY, "is no summary of `layout`", "run `sightline layout` again"):
            spans = summary["by_span"]
            low, high = (float(value) for value in summary["passband"])
            return {
                "passband": (low, high),
                "duration": summary["duration"],
                "highest": summary["highest_frequency"],
                "tried": summary["tried"],
                "exhaustive": summary["exhaustive"],
                "spans": np.array(spans["span_s"], dtype=np.float64),
                "worst_by_span": np.array(spans["worst_information"], dtype=np.float64),
                "sigma_by_span": np.array(spans["harmonic_sigma_px"], dtype=np.float64),
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: LayoutChoice, axes: Sequence[Any]) -> None:
        """Where each layout has its detectors."""
        rows = self.summary(result)["ranked"]
        for rank, row in enumerate(rows, 1):
            axes[0].plot(
                1e3 * np.array(row["positions_s"]), np.full(len(row["positions_s"]), rank), "|", markersize=12
            )
        axes[0].set_xlabel("place (ms)")
        axes[0].set_ylabel("rank")
        axes[0].invert_yaxis()


def _source(result: LayoutChoice) -> Path | None:
    """The INSTRUMENT.toml."""
    source = source_of(given(result)["focal_plane"])
    return source if isinstance(source, Path) else None
