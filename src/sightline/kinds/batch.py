"""What became of many inputs: `batch`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.batch import Batch, JobOutcome
from sightline.errors import foreign_errors
from sightline.io.results.batch import (
    BATCH_FILES,
    COLUMNS,
    FIGURES,
    batch_columns,
    summarize_batch,
    write_batch,
)
from sightline.kinds.kind import REPORT, SUMMARY, Columns, ResultKind, Tell
from sightline.report.batch_page import batch_page


class Batches(ResultKind):
    """`Batch`."""

    types = (Batch,)
    table, index, files = "results", ("name",), BATCH_FILES
    units = {name: unit for name, unit in (COLUMNS | FIGURES).items() if unit}

    def facts(self, result: Batch) -> Mapping[str, str]:
        """How many, and how many failed."""
        return {"inputs": str(len(result.outcomes)), "failed": str(len(result.failed))}

    def columns(self, result: Batch) -> Columns:
        """``results.csv``."""
        return {
            name: values if not (COLUMNS | FIGURES)[name] else np.array(values, dtype=np.float64)
            for name, values in batch_columns(result.outcomes).items()
        }

    def summarize(self, result: Batch) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return summarize_batch(result, {}, wall_seconds=0.0)

    def render(
        self, result: Batch, folder: Path, tell: Tell, begun: float, inputs: Mapping[str, str]
    ) -> dict[str, Any]:
        """Every file but those of the inputs, which are there."""
        tell("writing the summary of all inputs")
        summary = write_batch(folder, result, inputs, wall_seconds=time.perf_counter() - begun)
        batch_page(result, summary).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The inputs, as the summary has them."""
        with foreign_errors(folder / SUMMARY, "is no summary of `batch`", "run `sightline batch` again"):
            jobs = [{key: value for key, value in job.items() if key != "state"} for job in summary["jobs"]]
            return {"name": summary["name"], "outcomes": tuple(JobOutcome(**job) for job in jobs)}

    def draw(self, result: Batch, axes: Sequence[Any]) -> None:
        """How long each input took."""
        axes[0].bar(np.arange(len(result.outcomes)), [one.wall_seconds for one in result.outcomes])
        axes[0].set_xticks(np.arange(len(result.outcomes)), [one.name for one in result.outcomes])
        axes[0].set_ylabel("time (s)")
