"""What a stereo orientation would give → tables of sigmas, covariance, ``summary.json``.

Not here: the results of an orientation (``stereo.py``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.stereo_prediction import SigmaTable, StereoPrediction
from sightline.evaluation.direction_words import AXES, angle_names
from sightline.io.formats.tables import write_columns
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.io.results.stereo import (
    baseline_turn,
    improvement_entry,
    principal_sigmas,
    unobservable,
    write_covariance,
    write_orientation,
)
from sightline.io.stereo.load import Stereo
from sightline.io.stereo.plan import PlannedPass
from sightline.version import VERSION


def write_prediction(
    folder: Path,
    problem: Stereo | PlannedPass,
    predicted: StereoPrediction,
    *,
    wall_seconds: float,
) -> dict[str, Any]:
    """Write every table of a prediction and its summary.

    Parameters
    ----------
    folder : Path
        Exists.
    problem : Stereo or PlannedPass
        What it is for.
    predicted : StereoPrediction
    wall_seconds : float
        s; of the whole command so far.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.
    """
    unknown = np.full(predicted.sigmas.shape, np.nan)
    write_orientation(folder / "orientation.csv", predicted.cameras, unknown, predicted.sigmas)
    write_covariance(folder / "covariance.csv", predicted.cameras, predicted.covariance)
    if predicted.tables:
        _write_tables(folder / "tables.csv", predicted)
    summary = summarize_prediction(problem, predicted, wall_seconds=wall_seconds)
    write_json(folder / "summary.json", summary)
    return summary


def _write_tables(path: Path, predicted: StereoPrediction) -> None:
    """``tables.csv``: the bounds against every quantity, one row per value and method."""
    rows = [
        (table.quantity, table.unit, method, table.values[v], *table.sigmas[m, v], table.weakest[m, v])
        for table in predicted.tables
        for m, method in enumerate(table.methods)
        for v in range(len(table.values))
    ]
    heads = ["quantity", "unit", "method", "value", *angle_names(predicted.cameras), "weakest"]
    columns = dict(zip(heads, (np.array(column) for column in zip(*rows, strict=True)), strict=True))
    write_columns(path, columns)


def summarize_prediction(
    problem: Stereo | PlannedPass, predicted: StereoPrediction, *, wall_seconds: float
) -> dict[str, Any]:
    """The content of ``summary.json``."""
    entries = principal_sigmas(predicted)
    return {
        "name": problem.name,
        "result": "StereoPrediction",
        "version": VERSION,
        "method": predicted.method,
        "cameras": list(predicted.cameras),
        "points_from": predicted.how,
        "points": predicted.points,
        "shots": predicted.shots,
        "sightings": predicted.sightings,
        "baseline": predicted.baseline,
        "window_seconds": predicted.window,
        "sigmas": {
            camera: {axis: float(predicted.sigmas[c, k]) for k, axis in enumerate(AXES)}
            for c, camera in enumerate(predicted.cameras)
        },
        "principal_sigmas": entries,
        "unobservable": unobservable(
            predicted, baseline_turn(problem.problem) if isinstance(problem, Stereo) else None
        ),
        "tables": [_table(table) for table in predicted.tables],
        "improvements": [improvement_entry(change) for change in predicted.improvements],
        "warnings": list(problem.problem.warnings) if isinstance(problem, Stereo) else [],
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": problem.input_hashes(),
    }


def _table(table: SigmaTable) -> dict[str, Any]:
    """The bounds of both methods against one quantity."""
    return {
        "quantity": table.quantity,
        "unit": table.unit,
        "planned": table.planned,
        "values": table.values.tolist(),
        "how": table.how,
        "sigmas": {m: table.sigmas[k].tolist() for k, m in enumerate(table.methods)},
        "weakest": {m: table.weakest[k].tolist() for k, m in enumerate(table.methods)},
    }
