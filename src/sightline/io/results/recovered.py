"""The folder that ``recover`` wrote → motion and statics, checked to be those of an acquisition.

``motion.csv`` gives the angles at the lines of the first band; beyond its span ``covariance.npz``, where it
is there, goes on to the lines of the others; ``summary.json`` gives the statics and the hashes of the
inputs, ``relief.csv`` the ground that was found.

Not here: what is done with them (``applications/registration.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_arrays
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.geometry.trajectory import Motion
from sightline.inputs import note
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.tables import read_motion
from sightline.io.results.hidden import read_summary
from sightline.io.results.relief import read_relief
from sightline.motion.strip.relief import RowRelief
from sightline.result import set_source

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recovered:
    """What a result folder says of an acquisition.

    Attributes
    ----------
    motion : Motion
        rad; without covariance.
    relief : RowRelief or None
        Ground that was found, images counted as the bands of the acquisition.
    statics : dict
        Name of a static parameter, as ``motion.statics`` names it, to its value.
    summary : dict
        The whole of ``summary.json``.
    """

    motion: Motion
    statics: dict[str, float]
    summary: dict[str, Any]
    relief: RowRelief | None = None


def as_given(acquisition: Acquisition) -> Recovered:
    """No motion and no statics: the cameras of an acquisition as they are, whose bands hold no motion."""
    spans = np.array([camera.trajectory.span for camera in acquisition.cameras])
    found = Recovered(Motion.zero(float(spans[:, 0].min()), float(spans[:, 1].max())), {}, {})
    set_source(found.motion, found)
    return found


def read_recovered(folder: Path, acquisition: Acquisition) -> Recovered:
    """What ``recover`` found of an acquisition.

    Parameters
    ----------
    folder : Path
        Its ``--out``.
    acquisition : Acquisition
        What the result must belong to.

    Raises
    ------
    FormatError
        If files are missing or damaged.
    InputError
        If the result is of another acquisition, or an input was changed since.
    """
    if not (folder / "motion.csv").is_file():
        lacking = "it is a file" if folder.is_file() else "motion.csv is missing"
        raise FormatError(f"{folder}: --motion must be a folder that `recover` wrote ({lacking})")
    summary = read_summary(folder)
    _check_hashes(folder, summary, acquisition)
    table = read_motion(folder / "motion.csv")
    whole = summary.get("lines", len(table.t))
    if len(table.t) != whole:
        raise FormatError(
            f"{folder / 'motion.csv'}: has {len(table.t)} rows where `recover` wrote {whole} (lines of "
            "summary.json); give its folder as it was written, or run it again"
        )
    t, angles = _prolonged(folder, table.t, table.angles)
    relief = read_relief(folder, summary, acquisition.names)
    recovered = Recovered(Motion(t, angles), _statics(folder, summary), summary, relief)
    set_source(recovered.motion, recovered)
    return recovered


def _check_hashes(folder: Path, summary: Mapping[str, Any], acquisition: Acquisition) -> None:
    """InputError unless the summary lists every input of the acquisition with its hash."""
    listed = summary.get("inputs")
    if not isinstance(listed, Mapping):
        raise FormatError(
            f"{folder / 'summary.json'}: `inputs`, the hashes of what was recovered, is missing; without it "
            "nothing says which images the motion is of; run `sightline recover` again"
        )
    for name, digest in acquisition.input_hashes().items():
        if listed.get(name) == digest:
            continue
        what = "was changed since" if name in listed else "was no part of it"
        raise InputError(
            f"{folder}: the result does not belong to {acquisition.path}: {name} {what}; give the folder "
            "that `sightline recover` wrote for it, or run it again"
        )


def _statics(folder: Path, summary: Mapping[str, Any]) -> dict[str, float]:
    """Values of the statics by name; none where the summary has none."""
    try:
        found = {str(entry["name"]): float(entry["value"]) for entry in summary.get("statics", ())}
    except (TypeError, KeyError, ValueError):
        found = {"": np.nan}
    if not np.isfinite(list(found.values())).all():
        raise FormatError(
            f"{folder / 'summary.json'}: `statics` must be a list of objects with `name` and a finite "
            "`value`; run `sightline recover` again"
        )
    return found


def _prolonged(folder: Path, t: Array, angles: Array) -> tuple[Array, Array]:
    """The motion at the lines of the first band, and before and after them on the grid of the estimate."""
    path = folder / "covariance.npz"
    note(path)
    if not path.is_file():
        return t, angles
    advice = "run `sightline recover` again, or delete it: lines outside motion.csv are then left out"
    stored = read_arrays(path, "the covariance of a motion", advice)
    with foreign_errors(path, "cannot be read as the covariance of a motion", advice):
        grid = np.asarray(stored["t"], dtype=np.float64).reshape(-1)
        values = np.asarray(stored["angles"], dtype=np.float64).reshape(len(grid), 3)
    if not (np.isfinite(grid).all() and np.isfinite(values).all() and (np.diff(grid) > 0.0).all()):
        raise FormatError(f"{path}: `t` does not increase, or holds no numbers as `angles` may not; {advice}")
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    early, late = grid < t[0] - 0.5 * step, grid > t[-1] + 0.5 * step
    return (
        np.concatenate([grid[early], t, grid[late]]),
        np.concatenate([values[early], angles, values[late]]),
    )
