"""``orientation.csv`` and ``covariance.csv`` of a folder, against a truth, as a score.

Not here: what is made of them (``evaluation/score_orientation.py``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_text
from sightline.errors import FormatError, foreign_errors, naming
from sightline.evaluation.direction_words import AXES
from sightline.evaluation.score_orientation import score_orientation
from sightline.io.formats.tables import read_columns
from sightline.io.results.stereo import ORIENTATION
from sightline.io.stereo.tables import listed

Array = NDArray[np.float64]


#: rad; beyond, what stands in a table is no angle, nor a sigma of one.
LARGEST = 1e6


def read_orientation(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """``orientation.csv``: cameras, angles (C, 3) rad and sigmas (C, 3) rad; nan and inf: not observable."""
    table = read_columns(path, ORIENTATION, text=ORIENTATION)
    cameras = tuple(str(name) for name in table["camera"])
    _refuse_twice(path, cameras)
    angles, sigma = _numbers(path, table, AXES), _numbers(path, table, ORIENTATION[4:])
    for values in (angles, sigma[np.isfinite(sigma)]):
        if (np.abs(values) > LARGEST).any():
            raise FormatError(
                f"{path}: holds {values[np.abs(values) > LARGEST][0]:g} rad; angles and sigmas up to "
                f"{LARGEST:g} rad, nan and inf are expected; run `sightline orient` again"
            )
    return cameras, angles, sigma


def _numbers(path: Path, table: dict[str, Any], names: tuple[str, ...]) -> Array:
    """Columns side by side; nan and inf are words that a table of results may hold."""
    try:
        return np.column_stack([np.array(table[name], dtype=np.float64) for name in names])
    except ValueError as problem:
        raise FormatError(f"{path}: {problem}; numbers, nan or inf are expected") from None


def _refuse_twice(path: Path, cameras: tuple[str, ...]) -> None:
    twice = sorted({name for name in cameras if cameras.count(name) > 1})
    if twice:
        raise FormatError(f"{path}: camera {twice[0]!r} has two rows; a camera has one; remove the other")


def read_orientation_truth(path: Path, cameras: tuple[str, ...]) -> Array:
    """``camera,roll,pitch,yaw``: true angles (C, 3) rad in the order of `cameras`."""
    table = read_columns(path, ("camera", *AXES), text=("camera",))
    names = tuple(str(name) for name in table["camera"])
    _refuse_twice(path, names)
    missing = [camera for camera in cameras if camera not in names]
    if missing:
        raise FormatError(f"{path}: no row of camera {missing[0]!r}; the truth has: {listed(names)}")
    rows = [names.index(camera) for camera in cameras]
    return np.column_stack([np.asarray(table[axis], dtype=np.float64) for axis in AXES])[rows]


def read_covariance(path: Path, count: int) -> Array:
    """``covariance.csv`` (count, count), rad^2; a line with names is a comment."""
    text = read_text(path, "a table of numbers", advice="run `sightline orient` again")
    rows = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    with foreign_errors(path, "cannot be read as a table of numbers", "run `sightline orient` again"):
        covariance = np.array([line.split(",") for line in rows], dtype=np.float64, ndmin=2)
    if covariance.shape != (count, count):
        raise FormatError(
            f"{path}: {covariance.shape[0]} rows x {covariance.shape[1]} columns; {count} x {count} are "
            "expected: "
            "roll, pitch, yaw of every camera of orientation.csv"
        )
    if (np.diagonal(covariance) < 0.0).any():
        raise FormatError(f"{path}: holds a negative variance; run `sightline orient` again")
    return np.asarray(covariance)


def score_orientation_folder(folder: Path, truth: Path) -> dict[str, Any]:
    """Score of the ``orientation.csv`` in `folder`, with its ``covariance.csv`` where there is one."""
    cameras, angles, sigma = read_orientation(folder / "orientation.csv")
    if np.isnan(angles).all() and np.isfinite(sigma).any():
        raise FormatError(
            f"{folder}: holds a prediction (`orient --predict`): sigmas and no angles, so there is "
            "nothing to score; run `orient` without --predict"
        )
    true = read_orientation_truth(truth, cameras)
    table = folder / "covariance.csv"
    covariance = read_covariance(table, 3 * len(cameras)) if table.is_file() else None
    with naming(folder if covariance is None else table):
        return score_orientation(cameras, angles, sigma, true, covariance)
