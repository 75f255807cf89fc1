"""Hidden directions ↔ files: motions that leave every measured image position as it is.

``hidden.csv`` holds them on the lines of ``motion.csv``, three columns per direction; ``summary.json``
names them. A result of another program may put them straight into its ``summary.json``.

Not here: what they are for (``evaluation/score.py``) and where they come from (``motion/joint.py``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, InputError
from sightline.io.inputs import note
from sightline.io.tables import ANGLES, read_columns, write_columns

Array = NDArray[np.float64]

TABLE = "hidden.csv"


def write_hidden(folder: Path, t: Array, hidden: Array, names: Sequence[str]) -> dict[str, Any]:
    """Write ``hidden.csv`` and give the value of ``hidden_directions`` for ``summary.json``.

    Parameters
    ----------
    folder : Path
        Where ``motion.csv`` is.
    t : (N,)
        s; its lines.
    hidden : (N, 3, H)
        rad, of any size; roll, pitch, yaw of each direction.
    names : sequence of str
        One per direction.
    """
    if hidden.shape != (len(t), 3, len(names)):
        raise InputError(f"`hidden` must have shape ({len(t)}, 3, {len(names)}); got {hidden.shape}")
    columns: dict[str, Array] = {"t": t}
    for k, name in enumerate(names):
        for axis in range(3):
            columns[f"{name} {ANGLES[axis]}"] = hidden[:, axis, k]
    write_columns(folder / TABLE, columns)
    return {"table": TABLE, "names": list(names)}


def read_hidden(folder: Path, summary: Mapping[str, Any], lines: int) -> tuple[Array, tuple[str, ...]] | None:
    """Hidden directions (lines, 3, H) of a result with their names; None where the summary lists none.

    Parameters
    ----------
    folder : Path
        Of the result.
    summary : mapping
        Its ``summary.json``. ``hidden_directions`` is ``{"table": FILE, "names": [..]}``, or a list of
        ``{"name": .., "roll": [..], "pitch": [..], "yaw": [..]}`` with one number per line, or one for all
        of them; an axis left out is zero.
    lines : int
        Rows of ``motion.csv``.

    Raises
    ------
    FormatError
        If the entry has another form, or another number of lines.
    """
    entry = summary.get("hidden_directions")
    place = folder / "summary.json"
    if entry is None:
        return None
    if isinstance(entry, Mapping):
        return _from_table(folder, entry, lines)
    if not isinstance(entry, list) or not all(isinstance(item, Mapping) for item in entry):
        raise FormatError(
            f"{place}: `hidden_directions` is neither a list nor a table: {str(entry)[:60]!r}; expected "
            '[{"name": .., "roll": [..], "pitch": [..], "yaw": [..]}, ..] or {"table": FILE, "names": [..]}'
        )
    hidden = np.zeros((lines, 3, len(entry)))
    for k, item in enumerate(entry):
        for axis, name in enumerate(ANGLES):
            hidden[:, axis, k] = _sampled(place, item, name, lines)
    return hidden, tuple(str(item.get("name", f"direction {k}")) for k, item in enumerate(entry))


def read_summary(folder: Path) -> dict[str, Any]:
    """``summary.json`` of a result as a dict; empty where there is none."""
    path = folder / "summary.json"
    note(path)
    if not path.is_file():
        return {}
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FormatError(f"{path}: not JSON ({error}); write it anew with `sightline recover`") from None
    if not isinstance(summary, dict):
        raise FormatError(f"{path}: holds {type(summary).__name__}; an object with named values is expected")
    return summary


def _from_table(folder: Path, entry: Mapping[str, Any], lines: int) -> tuple[Array, tuple[str, ...]]:
    path = folder / str(entry.get("table", TABLE))
    names = tuple(str(name) for name in entry.get("names", ()))
    columns = [f"{name} {axis}" for name in names for axis in ANGLES]
    table = read_columns(path, columns)
    values = np.array([np.asarray(table[column]) for column in columns]).reshape(len(names), 3, -1)
    if values.shape[2] != lines:
        raise FormatError(
            f"{path}: {values.shape[2]} rows for the {lines} lines of motion.csv; one row per line is needed"
        )
    return np.ascontiguousarray(values.transpose(2, 1, 0)), names


def _sampled(place: Path, item: Mapping[str, Any], axis: str, lines: int) -> Array:
    try:
        values = np.atleast_1d(np.asarray(item.get(axis, 0.0), dtype=np.float64))
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape not in ((1,), (lines,)) or not np.isfinite(values).all():
        raise FormatError(
            f"{place}: `hidden_directions` {str(item.get('name', '?'))!r}: {axis!r} must be {lines} finite "
            "numbers, one per line of motion.csv, or one number for all"
        )
    return np.broadcast_to(values, (lines,))
