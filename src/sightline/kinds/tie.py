"""Control points between images and a reference: `tie`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.reference_tie import ReferenceTie
from sightline.errors import foreign_errors
from sightline.io.results.line_of_sight import write_json
from sightline.io.results.reference_tie import TIE_FILES, control_columns, summarize_tie, write_tables
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell, columns_of, given, warned
from sightline.report.tie_page import tie_page
from sightline.writing import whole_text


class ReferenceTies(ResultKind):
    """`ReferenceTie`."""

    types = (ReferenceTie,)
    table, index, files = "control_points", ("point",), TIE_FILES
    units = {
        **dict.fromkeys(("x", "y", "z", "sigma", "sigma_ground"), "m"),
        **dict.fromkeys(("line", "column", "lines", "sigma_px", "offset_line", "offset_column"), "px"),
        **dict.fromkeys(("sigma_line", "sigma_column"), "px"),
    }

    def facts(self, result: ReferenceTie) -> Mapping[str, str]:
        """How many points, how far off."""
        line, column = np.nanmedian(result.offset_px, axis=0)
        return {
            "control points": f"{len(result.image)}",
            "cameras off by": f"{line:.2f}, {column:.2f} px (line, column, median)",
            "sigma": f"{np.median(result.sigma):.3g} m, {result.control_sigma_px:.3g} px",
            **warned(result),
        }

    def columns(self, result: ReferenceTie) -> Columns:
        """``control_points.csv``."""
        return control_columns(result)

    def dataset(self, result: ReferenceTie) -> Any:
        """The points by their number."""
        from sightline.kinds.kind import library

        columns = self.numbers(result, self.table)
        variables = {
            name: (("point",), np.asarray(values, dtype=object if name == "image" else None))
            + (({"units": self.unit(name, self.table)},) if name != "image" else ())
            for name, values in columns.items()
        }
        coordinates = {"point": np.arange(len(columns["x"]))}
        facts = {"result": type(result).__name__, **self.facts(result)}
        return library("xarray").Dataset(variables, coordinates, facts)

    def summarize(self, result: ReferenceTie) -> dict[str, Any]:
        """Nothing has to be written for it."""
        reference = getattr(given(result)["reference"], "path", None)
        name = "reference" if reference is None else Path(reference).name
        return summarize_tie(result, "tie", name, (), wall_seconds=result.origin.seconds)

    def render(
        self,
        result: ReferenceTie,
        folder: Path,
        tell: Tell,
        begun: float,
        *,
        name: str = "tie",
        more: Mapping[str, str] | None = None,
        inputs: Sequence[Path] = (),
    ) -> dict[str, Any]:
        """Every file; `more`: texts of others by their names, such as the TOML that names the points."""
        tell("writing the control points and their report")
        write_tables(folder, result)
        for file, text in (more or {}).items():
            whole_text(folder / file, text)
        reference = getattr(given(result)["reference"], "path", None)
        summary = summarize_tie(
            result, name, "reference" if reference is None else Path(reference).name, inputs,
            wall_seconds=time.perf_counter() - begun,
        )  # fmt: skip
        tie_page(result, summary).write(folder / REPORT)
        write_json(folder / SUMMARY, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The control points and what lies behind them."""
        with foreign_errors(folder / SUMMARY, "is no summary of `tie`", "run `sightline tie` again"):
            points, ties = (
                columns_of((folder / f"{name}.csv").read_text(encoding="utf-8"), folder / f"{name}.csv")
                for name in ("control_points", "ties")
            )
            names = tuple(dict.fromkeys(str(name) for name in points["image"]))

            def both(table: Mapping[str, Any], *columns: str) -> Any:
                return np.stack([np.asarray(table[column], dtype=np.float64) for column in columns], axis=1)

            return {
                "names": names,
                "image": np.array([names.index(str(name)) for name in points["image"]], dtype=np.intp),
                "pixels": both(points, "line", "column"),
                "places": both(points, "x", "y", "z"),
                "sigma": np.asarray(points["sigma"], dtype=np.float64),
                "control_sigma_px": float(summary["control_sigma_px"]),
                "match_sigma_px": both(ties, "sigma_line", "sigma_column"),
                "offset_px": both(ties, "offset_line", "offset_column"),
                "ground_sigma": np.asarray(
                    points["sigma_ground" if "sigma_ground" in points else "sigma"], dtype=np.float64
                ),
                "lines": np.asarray(points["lines"], dtype=np.float64) if "lines" in points else None,
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: ReferenceTie, axes: Sequence[Any]) -> None:
        """How far the cameras are off, by line."""
        for k, name in enumerate(("offset_line", "offset_column")):
            axes[0].plot(result.pixels[:, 0], result.offset_px[:, k], ".", label=name)
        axes[0].set_xlabel("line (px)")
        axes[0].set_ylabel("image less camera (px)")
        axes[0].legend()
