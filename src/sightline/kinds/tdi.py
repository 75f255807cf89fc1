"""A choice of TDI stages and integration ratios: `tdi`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.tdi_choice import TdiResult
from sightline.applications.tdi_lines import SignalLines, check_columns
from sightline.errors import InputError
from sightline.evaluation.tdi_pictures import strip_pictures
from sightline.io.results.tdi import COLUMNS, summarize_tdi, write_choice, write_tdi_summary
from sightline.io.results.tdi_settings import SETTINGS, TAGS, open_signals, write_signal_lines
from sightline.io.results.tdi_table import write_table
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell, warned
from sightline.report.tdi_page import tdi_page
from sightline.result import source_of
from sightline.stages import Stages
from sightline.tdi.choose import LIMITS
from sightline.tdi.table import IMAGE_FILE, TdiTable


class Choice(ResultKind):
    """`TdiResult`."""

    types = (TdiResult,)
    table, index = "choice", ("column", "signal")
    files = (
        "choice.csv", IMAGE_FILE, "table.h", "table.c", "table.hex", "table_segments.bin", SETTINGS, TAGS,
        SUMMARY, REPORT,
    )  # fmt: skip
    units = {"signal": "electrons"}
    options = ("pictures", "signals")

    def facts(self, result: TdiResult) -> Mapping[str, str]:
        """Columns and signals, what was chosen, the table."""
        said = self.summary(result)
        stages, ratio, table = said["stages"], said["integration_ratio"], said["table"]
        return {
            "": f"{said['columns']} columns x {said['signals']} signals",
            "stages": f"{stages['min']:g} to {stages['max']:g}",
            "integration ratio": f"{ratio['min']:g} to {ratio['max']:g}",
            "table": f"{table['bytes']} bytes, loses {table['certified_loss']:.2g} of the merit at most",
            **warned(result),
        }

    def columns(self, result: TdiResult) -> Columns:
        """``choice.csv``."""
        choice = result.choice
        shape = choice.snr.shape
        signals = np.broadcast_to(choice.signals, shape)
        columns = np.broadcast_to(choice.columns.column[:, None], shape)
        values = [
            columns.astype(np.int64), signals, choice.stages, choice.integration_ratio, choice.mtf[..., 0],
            choice.mtf[..., 1], choice.snr, choice.merit, np.array(LIMITS, dtype=object)[choice.limit],
        ]  # fmt: skip
        return {name: np.ravel(value) for name, value in zip(COLUMNS, values, strict=True)}

    def summarize(self, result: TdiResult) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_tdi(result, _inputs(result), wall_seconds=result.origin.seconds)

    def render(
        self,
        result: TdiResult,
        folder: Path,
        tell: Tell,
        begun: float,
        *,
        pictures: bool = True,
        signals: str | Path | None = None,
        stages: Stages | None = None,
    ) -> dict[str, Any]:
        """Every file; `pictures` of a target, settings and tags of an image of `signals`, by its stages."""
        target = None
        lines = None if signals is None else signal_lines(result, Path(signals))
        # the target drifts steadily: under a motion it would look as sharp as it is not
        if pictures and result.problem.motion is None:
            tell("imaging a target")
            try:
                target = strip_pictures(result.choice, aperture=result.problem.aperture)
            except InputError as reason:  # the choice stands without them
                result = replace(result, warnings=(*result.warnings, f"no pictures of a target: {reason}"))
        write_choice(folder / "choice.csv", result.choice)
        write_table(folder, result.table)
        more: dict[str, Any] = {}
        warnings = list(result.warnings)
        if lines is not None:
            step = partial(tell, "settings of the lines")
            more["signal_image"] = write_signal_lines(folder, lines, step, stages)
            warnings += lines.counts.warnings(result.table)
        inputs = (*_inputs(result), *([] if signals is None else [Path(signals)]))
        seconds = time.perf_counter() - begun
        summary = write_tdi_summary(
            folder / SUMMARY, result, inputs, wall_seconds=seconds, warnings=warnings, **more
        )
        tdi_page(result, summary, target).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The table that is looked up; what was chosen is the result's own table."""
        return {
            "table": TdiTable.read(folder / IMAGE_FILE),
            "warnings": tuple(summary.get("warnings", ())),
        }

    def draw(self, result: TdiResult, axes: Sequence[Any]) -> None:
        """Stages over columns and signals."""
        found = self.numbers(result, self.table)
        column, signal = np.unique(found["column"]), np.unique(found["signal"])
        stages = found["stages"].reshape(len(column), len(signal)).T
        if min(stages.shape) > 1:
            drawn = axes[0].pcolormesh(column, signal, stages, shading="nearest")
            axes[0].set_yscale("log")
            axes[0].set_ylabel("signal (electrons)")
            axes[0].figure.colorbar(drawn, ax=axes[0], label="TDI stages")
            axes[0].set_xlabel("column")
            return
        along = column if len(column) > 1 else signal
        axes[0].plot(along, stages.ravel(), "o-")
        axes[0].set_xlabel("column" if len(column) > 1 else "signal (electrons)")
        axes[0].set_ylabel("TDI stages")


def signal_lines(result: TdiResult, signals: Path) -> SignalLines:
    """An image of signals opened for a choice."""
    image = open_signals(signals)
    check_columns(image, result.problem.columns)
    return SignalLines(result, image)


def _inputs(result: TdiResult) -> tuple[Path, ...]:
    """Files that the problem was read from."""
    source = source_of(result.problem)
    return source if isinstance(source, tuple) else ()
