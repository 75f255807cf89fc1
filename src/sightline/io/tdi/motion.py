"""The folder that ``recover`` wrote → what it says of the motion, for the choice of TDI stages.

``motion.csv`` (prolonged by ``covariance.npz``), ``spectrum.csv``, ``hidden.csv`` and ``summary.json``.

Not here: checking whose result it is (``io/results/recovered.py``), what the motion does
(``tdi/motion_mtf.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, foreign_errors
from sightline.geometry.trajectory import Motion
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.tables import ANGLES, read_columns, read_motion
from sightline.io.results.hidden import read_hidden
from sightline.io.results.recovered import read_recovered
from sightline.tdi.motion_knowledge import MotionKnowledge, error_and_jitter, prolonged

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RecoveredStrip:
    """What a result folder gives the choice of TDI stages.

    Attributes
    ----------
    knowledge : MotionKnowledge
    statics, statics_sigma : dict
        Name of a static parameter to its value and its 1-sigma.
    """

    knowledge: MotionKnowledge
    statics: dict[str, float]
    statics_sigma: dict[str, float]


def read_motion_knowledge(folder: Path, acquisition: Acquisition) -> RecoveredStrip:
    """What ``recover`` found of an acquisition, and how well.

    Parameters
    ----------
    folder, acquisition
        As of `read_recovered`, and so are its errors.
    """
    found = read_recovered(folder, acquisition)
    frequency, error, jitter = _error(folder)
    hidden, covariance, warnings = _hidden(folder, found.summary, found.motion)
    with foreign_errors(
        folder / "summary.json", "`statics` are not those of a strip", "run `sightline recover` again"
    ):
        sigmas = {str(s["name"]): float(s.get("sigma") or 0.0) for s in found.summary.get("statics", ())}
    knowledge = MotionKnowledge(found.motion, frequency, error, hidden, covariance, jitter, warnings)
    return RecoveredStrip(knowledge, found.statics, sigmas)


def _error(folder: Path) -> tuple[Array, Array, Array]:
    """Frequencies (F,), density (F, 3) of the error, and jitter (3,) above, from ``spectrum.csv``."""
    path = folder / "spectrum.csv"
    if not path.is_file():
        raise FormatError(
            f"{path}: is missing: it says how well the motion is known; run `sightline recover` again"
        )
    names = ["frequency", *(f"psd_{axis}" for axis in ANGLES), *(f"error_{axis}" for axis in ANGLES)]
    table = read_columns(path, names, infinite=names[4:])
    columns = [np.asarray(table[name], dtype=np.float64) for name in names]
    f, psd, error = columns[0], np.stack(columns[1:4], axis=1), np.stack(columns[4:], axis=1)
    if len(f) < 2 or not (np.diff(f) > 0.0).all() or (error < 0.0).any():
        raise FormatError(
            f"{path}: rising frequencies, and densities of 0 or more, are expected; run `sightline recover` "
            "again"
        )
    return f, *error_and_jitter(f, error, psd)


def _hidden(
    folder: Path, summary: Mapping[str, Any], motion: Motion
) -> tuple[Array | None, Array | None, tuple[str, ...]]:
    """Hidden directions at the times of the motion with their covariance, or a warning why not."""
    t = read_motion(folder / "motion.csv").t
    read = read_hidden(folder, summary, len(t))
    if read is None:
        return None, None, ()
    directions, names = read
    entry = summary["hidden_directions"]
    stated = entry.get("covariance") if isinstance(entry, Mapping) else None
    if stated is None:
        return None, None, (
            f"the result does not say how much of its hidden directions ({', '.join(names)}) there may be: "
            "they are taken for nothing; run `sightline recover` again, or give [columns] sigma_slip",
        )  # fmt: skip
    try:
        covariance = np.array(stated, dtype=np.float64)
    except (TypeError, ValueError):
        covariance = np.full((0, 0), np.nan)
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise FormatError(
            f"{folder / 'summary.json'}: `hidden_directions.covariance` must be {len(names)} rows of "
            f"{len(names)} finite numbers; run `sightline recover` again"
        )
    # rounding leaves variances of combinations a little below 0
    least, size = float(np.linalg.eigvalsh(covariance)[0]), float(np.trace(covariance))
    if not np.allclose(covariance, covariance.T) or least < -1e-9 * size:
        raise FormatError(
            f"{folder / 'summary.json'}: `hidden_directions.covariance` is none: it is not symmetric, or a "
            "variance in it is negative; run `sightline recover` again"
        )
    return prolonged(t, directions, motion.t), covariance, ()
