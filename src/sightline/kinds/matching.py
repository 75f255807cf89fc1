"""Shifts between two rasters, and between the bands of one: `match`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.raster_matches import BandMatches, RasterMatches
from sightline.errors import foreign_errors
from sightline.io.formats.tables import write_columns
from sightline.io.results.raster_matches import (
    BAND_FILES,
    MATCH_FILES,
    match_columns,
    pair_columns,
    pair_suffix,
    read_raster_matches,
    summarize_bands,
    summarize_matches,
    write_match_tables,
    write_summary,
)
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell, given, library, warned
from sightline.report.match_page import band_page, match_page

_UNITS = {
    **dict.fromkeys(("line", "column", "d_line", "d_column", "rms_line", "rms_column"), "px"),
    **dict.fromkeys(("sigma_line", "sigma_column"), "px"),
}
_AGAIN = "run `sightline match` again"


class Shifts(ResultKind):
    """`RasterMatches`."""

    types = (RasterMatches,)
    table, files, units, panels = "matches", MATCH_FILES, _UNITS, 2

    def facts(self, result: RasterMatches) -> Mapping[str, str]:
        """Which images, how many windows, what shift."""
        kept = result.matches.kept
        middle = np.median(result.shift_px[kept], axis=0) if kept.any() else np.full(2, np.nan)
        return {
            "images": " - ".join(result.names),
            "windows": f"{int(kept.sum())} kept",
            "median shift": f"{middle[0]:.4f}, {middle[1]:.4f} px (line, column)",
            "sigma": "{:.4f}, {:.4f} px".format(*np.median(result.sigma_px[kept], axis=0)),
            **warned(result),
        }

    def columns(self, result: RasterMatches) -> Columns:
        """``matches.csv``."""
        return match_columns(result)

    def dataset(self, result: RasterMatches) -> Any:
        """Shifts over the lines and columns of the windows."""
        xarray = library("xarray")
        values = {
            "d_line": result.shift_px[:, 0], "d_column": result.shift_px[:, 1],
            "sigma_line": result.sigma_px[:, 0], "sigma_column": result.sigma_px[:, 1],
            "correlation": result.correlation,
            "score": np.where(result.matches.kept, result.matches.score, np.nan),
        }  # fmt: skip
        axes = {
            name: (name, result.first[k] + result.step[k] * np.arange(result.shape[k]), {"units": "px"})
            for k, name in enumerate(("line", "column"))
        }
        variables = {
            name: (("line", "column"), array.reshape(result.shape), {"units": self.unit(name, self.table)})
            for name, array in values.items()
        }
        return xarray.Dataset(variables, axes, {"result": type(result).__name__, **self.facts(result)})

    def summarize(self, result: RasterMatches) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_matches(result, _files(result), wall_seconds=result.origin.seconds)

    def render(
        self, result: RasterMatches, folder: Path, tell: Tell, begun: float, *, inputs: Sequence[Path] = ()
    ) -> dict[str, Any]:
        """Every file; `inputs` are those that were read, where they are not those of the images."""
        tell("writing the shifts and their report")
        write_match_tables(folder, result, given(result)["a"])
        seconds = time.perf_counter() - begun
        summary = summarize_matches(result, inputs or _files(result), wall_seconds=seconds)
        match_page(result, summary).write(folder / REPORT)
        write_summary(folder, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The windows that were kept."""
        with foreign_errors(folder / SUMMARY, "is no summary of `match`", _AGAIN):
            return read_raster_matches(folder / "matches.csv", summary) | {
                "warnings": tuple(summary["warnings"])
            }

    def draw(self, result: RasterMatches, axes: Sequence[Any]) -> None:
        """Means over rows, and over columns, with their sigma."""
        profiles = (result.row_means, result.column_means)
        for panel, profile, name in zip(axes, profiles, ("line", "column"), strict=True):
            for k, axis in enumerate(("d_line", "d_column")):
                panel.errorbar(profile.place, profile.shift_px[:, k], profile.sigma_px[:, k], label=axis)
            panel.set_xlabel(f"{name} (px)")
            panel.set_ylabel("mean shift (px)")
        axes[0].legend()

    def plot(self, result: RasterMatches, axes: Any) -> Any:
        """The two panels have no abscissa in common."""
        return super().plot(result, axes) if axes is not None else self._own_axes(result)

    def _own_axes(self, result: RasterMatches) -> Any:
        library("matplotlib")
        import matplotlib.pyplot as pyplot

        _, axes = pyplot.subplots(self.panels, 1, layout="constrained", figsize=(8.0, 5.6))
        self.draw(result, list(axes))
        return axes


class BandShifts(ResultKind):
    """`BandMatches`."""

    types = (BandMatches,)
    table, index, files, units = "pairs", ("pair",), BAND_FILES, _UNITS

    def facts(self, result: BandMatches) -> Mapping[str, str]:
        """How many bands and pairs."""
        return {"bands": str(len(result.bands)), "pairs": str(len(result.pairs)), **warned(result)}

    def columns(self, result: BandMatches) -> Columns:
        """``pairs.csv``."""
        return pair_columns(result)

    def dataset(self, result: BandMatches) -> Any:
        """Figures over the pairs."""
        xarray = library("xarray")
        columns = self.numbers(result, self.table)
        pairs = [" - ".join(both) for both in zip(columns["first"], columns["second"], strict=True)]
        variables = {
            name: (("pair",), values, {"units": self.unit(name, self.table)})
            for name, values in columns.items()
            if name not in ("first", "second")
        }
        return xarray.Dataset(
            variables, {"pair": ("pair", np.array(pairs, dtype=object))},
            {"result": type(result).__name__, **self.facts(result)},
        )  # fmt: skip

    def summarize(self, result: BandMatches) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_bands(result, _files(result), wall_seconds=result.origin.seconds)

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """Those of the pairs that the summary lists."""
        ends = [str(pair["suffix"]) for pair in summary["pairs"]]
        ends = [end for end in ends if set(end) <= set("_0123456789")]
        each = [pattern for pattern in BAND_FILES if "*" in pattern]
        named = [pattern.replace("_*", end) for end in ends for pattern in each]
        return [name for name in BAND_FILES if "*" not in name] + named

    def render(
        self, result: BandMatches, folder: Path, tell: Tell, begun: float, *, inputs: Sequence[Path] = ()
    ) -> dict[str, Any]:
        """Every file; `inputs` are those that were read, where they are not those of the images."""
        tell("writing the shifts and their report")
        images = given(result)["images"]
        for pair, one in zip(result.pairs, result.matches, strict=True):
            write_match_tables(folder, one, images[pair[0]], pair_suffix(pair))
        write_columns(folder / "pairs.csv", pair_columns(result))
        seconds = time.perf_counter() - begun
        summary = summarize_bands(result, inputs or _files(result), wall_seconds=seconds)
        band_page(result, summary).write(folder / REPORT)
        write_summary(folder, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The windows of each pair that were kept."""
        with foreign_errors(folder / SUMMARY, "is no summary of `match --bands`", _AGAIN):
            bands = tuple(str(name) for name in summary["bands"])
            matches, pairs = [], []
            for pair in summary["pairs"]:
                one = object.__new__(RasterMatches)
                path = folder / f"matches_{'_'.join(pair['suffix'].strip('_').split('_')[:2])}.csv"
                for name, value in (read_raster_matches(path, pair) | {"warnings": ()}).items():
                    object.__setattr__(one, name, value)
                object.__setattr__(one, "origin", None)
                first, second = (int(number) - 1 for number in pair["suffix"].strip("_").split("_"))
                pairs.append((first, second))
                matches.append(one)
            return {
                "bands": bands,
                "pairs": tuple(pairs),
                "matches": tuple(matches),
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: BandMatches, axes: Sequence[Any]) -> None:
        """Median shift of each pair."""
        found = self.numbers(result, self.table)
        place = np.arange(len(found["first"]))
        for k, name in enumerate(("d_line", "d_column")):
            axes[0].bar(place + 0.4 * k - 0.2, found[name], width=0.4, label=name)
        names = [f"{a} - {b}" for a, b in zip(found["first"], found["second"], strict=True)]
        axes[0].set_xticks(place, names)
        axes[0].set_ylabel("median shift (px)")
        axes[0].legend()


def _files(result: RasterMatches | BandMatches) -> list[Path]:
    """Files of the images that were given."""
    values = given(result)
    images = values["images"] if "images" in values else (values["a"], values["b"])
    paths = [Path(path) for image in images if (path := getattr(image, "path", None)) is not None]
    return list(dict.fromkeys(paths))
