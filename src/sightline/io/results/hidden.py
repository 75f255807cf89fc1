"""Hidden directions ↔ files: motions that leave every measured image position as it is.

``hidden.csv`` holds them on the lines of ``motion.csv``, three columns per direction; ``summary.json``
names them. A result of another program may put them straight into its ``summary.json``.

Not here: how they are removed (``evaluation/score.py``) and where they come from (``motion/strip/joint.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.access import check_file, check_inside, read_json
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.evaluation.score import at_lines, constant_directions, less_hidden
from sightline.geometry.trajectory import Motion
from sightline.inputs import note
from sightline.io.formats.tables import ANGLES, read_columns, read_motion, write_columns

Array = NDArray[np.float64]

TABLE = "hidden.csv"
#: Begins the names of the columns that hold the hidden part of ``motion.csv``.
LEFT_OUT = "left out"


def remove_hidden(motion: Motion | ArrayLike | str | Path, folder: str | Path) -> Array:
    """A motion less what the images of a result cannot show, as `sightline score` compares it.

    Parameters
    ----------
    motion : Motion, (N, 3) or path
        A motion that covers the lines of the result, the angles at these lines (rad; roll, pitch, yaw), or a
        CSV file with the columns ``t,roll,pitch,yaw``: a truth, another estimate, or the result's own
        ``motion.csv``.
    folder : str or Path
        Of the result, with its ``motion.csv``, ``summary.json`` and ``hidden.csv``.

    Returns
    -------
    (N, 3)
        rad; at the lines of ``motion.csv``. The hidden directions (constants, drifts, and what they bring on
        other axes, such as the parabola of roll of a drift of yaw) are fitted to the motion over all lines,
        by least squares in px (yaw at the field's edge), and taken off. The difference of two such motions
        is the error that the sigmas of the result speak of.

    Raises
    ------
    FormatError
        If a file is missing or not of its form.
    InputError
        If an array does not have one row per line of the result.
    SpanError
        If the motion does not cover the lines of the result.
    """
    place = Path(folder)
    t, summary = read_motion(place / "motion.csv").t, read_summary(place)
    if isinstance(motion, str | Path):
        table = read_motion(Path(motion))
        motion = Motion(table.t, table.angles)
    angles = at_lines(motion, t) if isinstance(motion, Motion) else np.asarray(motion, dtype=np.float64)
    if angles.shape != (len(t), 3) or not np.isfinite(angles).all():
        raise InputError(
            f"`motion` must be {len(t)} rows of three finite angles, one per line of {place / 'motion.csv'}; "
            f"got shape {angles.shape}; give a Motion if it is sampled otherwise"
        )
    hidden = read_hidden(place, summary, len(t))
    directions = constant_directions(len(t)) if hidden is None else hidden[0]
    return less_hidden(angles, directions, **pixel_scale(place, summary))


def pixel_scale(folder: Path, summary: Mapping[str, Any]) -> dict[str, float | None]:
    """`ifov` and `half_field_px` of a result's ``summary.json``: both, or neither.

    Raises
    ------
    FormatError
        If one of them is missing.
    """
    scale = {key: summary.get(key) for key in ("ifov", "half_field_px")}
    missing = [key for key, value in scale.items() if value is None]
    if len(missing) == 1:
        raise FormatError(
            f"{folder / 'summary.json'}: no {missing[0]}, which turns angles into pixels beside "
            f"{'ifov' if missing[0] != 'ifov' else 'half_field_px'}; give the folder as `recover` wrote it"
        )
    return scale


def write_hidden(
    folder: Path, t: Array, hidden: Array, names: Sequence[str], left_out: Array | None = None
) -> dict[str, Any]:
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
    left_out : (N, 3), optional
        rad; what ``motion.csv`` holds of all directions together.
    """
    if hidden.shape != (len(t), 3, len(names)):
        raise InputError(f"`hidden` must have shape ({len(t)}, 3, {len(names)}); got {hidden.shape}")
    columns: dict[str, Array] = {"t": t}
    for k, name in enumerate(names):
        for axis in range(3):
            columns[f"{name} {ANGLES[axis]}"] = hidden[:, axis, k]
    own = {} if left_out is None else {f"{LEFT_OUT} {name}": left_out[:, k] for k, name in enumerate(ANGLES)}
    write_columns(folder / TABLE, columns | own, dict.fromkeys(own, "%.12g"))
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
    summary = read_json(path, "the summary of a result", advice="run the command that wrote it again")
    if not isinstance(summary, dict):
        raise FormatError(f"{path}: holds {type(summary).__name__}; an object with named values is expected")
    return summary


def _from_table(folder: Path, entry: Mapping[str, Any], lines: int) -> tuple[Array, tuple[str, ...]]:
    path = folder / str(entry.get("table", TABLE))
    place = f"{folder / 'summary.json'}: `hidden_directions`"
    with foreign_errors(place, "cannot be read", "names of directions are expected"):
        check_inside(path, [folder.resolve()], folder / "summary.json")
        names = tuple(str(name) for name in entry["names"])
    if not names:
        return np.zeros((lines, 3, 0)), ()
    check_file(path, "summary.json says that it is part of this result: run the command that wrote it again")
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
