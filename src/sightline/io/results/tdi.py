"""A TDI choice → ``choice.csv`` and ``summary.json``; their columns are described in ``docs/formats.md``.

Not here: the table that is looked up (``tdi_table.py``), the page for people (``report/tdi_page.py``).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.tdi_choice import OtherWay, TdiResult
from sightline.io.acquisition.acquired import sha256
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.tdi.choose import LIMITS, TdiChoice
from sightline.tdi.hysteresis import SteadyChoice
from sightline.tdi.merit import ColumnMtf
from sightline.tdi.motion_mtf import MotionMtf
from sightline.tdi.predict_loss import PredictedLoss
from sightline.version import VERSION
from sightline.writing import whole

COLUMNS = (
    "column", "signal", "stages", "integration_ratio", "mtf_x", "mtf_y", "snr", "merit", "limit",
)  # fmt: skip


def write_choice(path: Path, choice: TdiChoice) -> None:
    """``choice.csv``: one row per column and signal, complete or not at all."""
    count = len(choice.signals)
    signals = [f"{value:.10g}" for value in choice.signals]
    ratios = {value: f"{value:.10g}" for value in choice.grid.ratios}
    stages, ratio, merit = choice.stages, choice.integration_ratio, choice.merit
    with whole(path) as draft, draft.open("w", encoding="utf-8") as stream:
        stream.write(",".join(COLUMNS) + "\n")
        for c, column in enumerate(choice.columns.column):
            mtf, snr, why = choice.mtf[c], choice.snr[c], [LIMITS[code] for code in choice.limit[c]]
            stream.writelines(
                f"{column:.0f},{signals[s]},{stages[c, s]},{ratios[ratio[c, s]]},"
                f"{mtf[s, 0]:.9g},{mtf[s, 1]:.9g},{snr[s]:.9g},{merit[c, s]:.9g},{why[s]}\n"
                for s in range(count)
            )


def write_tdi_summary(
    path: Path, result: TdiResult, inputs: Iterable[Path], *, wall_seconds: float, **more: Any
) -> dict[str, Any]:
    """Write ``summary.json``; gives its content.

    Parameters
    ----------
    path : Path
    result : TdiResult
    inputs : iterable of Path
        Files that were read.
    wall_seconds : float
        s; of the whole command so far.
    more
        Further entries.
    """
    summary = summarize_tdi(result, inputs, wall_seconds=wall_seconds) | more
    write_json(path, summary)
    return summary


def summarize_tdi(result: TdiResult, inputs: Iterable[Path], *, wall_seconds: float) -> dict[str, Any]:
    """The content of ``summary.json``."""
    problem, choice = result.problem, result.choice
    columns, rules = problem.columns, problem.rules
    codes, counts = np.unique(choice.limit, return_counts=True)
    return {
        "name": problem.name,
        "result": "TdiResult",
        "version": VERSION,
        "columns": len(columns),
        "signals": len(problem.signals),
        "settings": len(problem.grid),
        "model": rules.model,
        "merit": rules.merit,
        "frequencies": list(rules.frequencies),
        "scan_velocity": _spread(columns.velocity),
        "slip": _spread(columns.slip),
        "stages": _spread(choice.stages),
        "integration_ratio": _spread(choice.integration_ratio),
        "mtf_x": _spread(choice.mtf[..., 0]),
        "mtf_y": _spread(choice.mtf[..., 1]),
        "snr": _spread(choice.snr),
        "limits": {LIMITS[code]: int(count) for code, count in zip(codes, counts, strict=True)},
        "infeasible": int(choice.infeasible.sum()),
        "steady": None if result.steady is None else _steady(result.steady),
        "other_ways": [_other_way(way) for way in (result.one_setting, result.one_signal, result.patent)],
        "table": _table(result),
        "motion": _motion(problem.motion),
        "predicted_loss": None if result.predicted_loss is None else _predicted(result.predicted_loss),
        "warnings": list(result.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {path.name: sha256(path) for path in inputs},
    }


def _table(result: TdiResult) -> dict[str, Any]:
    table, certificate = result.table, result.certificate
    return {
        "certified_loss": certificate.loss,
        "max_loss": certificate.max_loss,
        "holds": certificate.holds,
        "mean_loss": certificate.mean_loss,
        "loss_at_limits": certificate.at_limits,
        "worst_column": certificate.column,
        "worst_signal": certificate.signal,
        "points": list(certificate.points),
        "flagged": certificate.flagged,
        "bytes": certificate.bytes,
        "groups": len(table.edges) - 1,
        "cells": len(table.words),
        "id": f"{table.identity:08x}",
    }


def _steady(steady: SteadyChoice) -> dict[str, Any]:
    return {
        "mean_loss": steady.mean_loss,
        "worst_loss": steady.worst_loss,
        "changes": [steady.changes_before, steady.changes_after],
        "largest_step": [steady.largest_step_before, steady.largest_step_after],
        "too_far": int(steady.too_far.sum()),
    }


def _motion(model: ColumnMtf | None) -> dict[str, Any] | None:
    """The strip whose motion the choice was made for."""
    if not isinstance(model, MotionMtf):
        return None
    t = model.start_times()
    return {
        "first_start": float(t.min()),
        "last_start": float(t.max()),
        "lines": int(t.size),
        "draws": len(t),
        "jitter": [float(sigma) for sigma in model.knowledge.jitter],
    }


def _predicted(loss: PredictedLoss) -> dict[str, Any]:
    return {
        "columns": [float(column) for column in loss.column],
        "signals": [float(signal) for signal in loss.signals],
        "mean": float(loss.mean.mean()),
        "upper_95": float(loss.upper().max()),
    }


def _other_way(way: OtherWay) -> dict[str, Any]:
    return {
        "name": way.name,
        "columns_compared": len(way.columns),
        "mean_loss": float(way.loss.mean()),
        "worst_loss": float(way.loss.max()),
    }


def _spread(values: Any) -> dict[str, float]:
    """Least, mean and most of some values."""
    return {"min": float(np.min(values)), "mean": float(np.mean(values)), "max": float(np.max(values))}
