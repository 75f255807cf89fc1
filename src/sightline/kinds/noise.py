"""The noise law and the columns of a detector: `noise`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.detector_noise import DetectorNoise
from sightline.errors import foreign_errors
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.io.results.noise import NOISE_FILES, summarize_noise, write_noise
from sightline.kinds.kind import SUMMARY, Columns, ResultKind, Tell, columns_of, warned


class Noise(ResultKind):
    """`DetectorNoise`."""

    types = (DetectorNoise,)
    table, index, files = "columns", ("column",), NOISE_FILES
    units = {"offset": "DN"}
    panels = 2

    def facts(self, result: DetectorNoise) -> Mapping[str, str]:
        """The law, how many columns."""
        law = {name: value for name, value in vars(result.law).items() if value}
        return {
            "law of a TDI line": ", ".join(f"{name} {value:.3g}" for name, value in law.items()),
            "signals in": result.unit,
            "stages": str(result.stages),
            "columns": f"{len(result.gain)}, {int((result.flags != 0).sum())} flagged",
            **warned(result),
        }

    def columns(self, result: DetectorNoise) -> Columns:
        """``columns.csv``."""
        number = np.arange(len(result.gain))
        return {"column": number, "gain": result.gain, "offset": result.offset, "flags": result.flags}

    def summarize(self, result: DetectorNoise) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_noise(result, (), wall_seconds=result.origin.seconds)

    def render(
        self, result: DetectorNoise, folder: Path, tell: Tell, begun: float, *, inputs: Sequence[Path] = ()
    ) -> dict[str, Any]:
        """Every file; `inputs` are those that were read."""
        return write_noise(folder, result, inputs, wall_seconds=time.perf_counter() - begun)

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The law and the columns; each figure is in the summary."""
        path = folder / "columns.csv"
        advice = "run `sightline noise` again"
        table = columns_of(path.read_text(encoding="utf-8"), path)
        with foreign_errors(folder / SUMMARY, "and columns.csv are no result of `noise`", advice):
            low, high = (float(value) for value in summary["signals"])
            return {
                "law": NoiseLaw(**summary["noise"]),
                "unit": str(summary["unit"]),
                "stages": int(summary["stages"]),
                "electrons_per_dn": summary["electrons_per_dn"],
                "gain": np.asarray(table["gain"], dtype=np.float64),
                "offset": np.asarray(table["offset"], dtype=np.float64),
                "flags": np.asarray(table["flags"], dtype=np.uint8),
                "signals": (low, high),
                "full_well_sum": summary["full_well_sum"],
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: DetectorNoise, axes: Sequence[Any]) -> None:
        """Gain and offset of each column."""
        for panel, values, name in zip(
            axes, (result.gain, result.offset), ("gain (1)", "offset (DN)"), strict=True
        ):
            panel.plot(values, linewidth=0.8)
            panel.set_ylabel(name)
        axes[-1].set_xlabel("column")
