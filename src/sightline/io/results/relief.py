"""``relief.csv``: rows of ground that were found beside the motion, m above the surface that was given.

``t`` (s) is when the image that ``summary.json`` names saw the row, ``height`` (m) its mean, ``slope`` (m)
what its end at the last column adds to that (the other end as much less), then their sigmas.

Not here: how they are found (``motion/strip/relief.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.errors import FormatError, foreign_errors
from sightline.io.formats.tables import check_times, read_columns, write_columns
from sightline.motion.strip.relief import RowRelief

RELIEF = "relief.csv"
COLUMNS = ("t", "height", "slope", "sigma_height", "sigma_slope")


def write_relief(path: Path, relief: RowRelief) -> None:
    """The table of a relief that was found."""
    values = [relief.t, *relief.heights.T, *relief.sigma.T]
    write_columns(path, dict(zip(COLUMNS, values, strict=True)), {"t": "%.9f"})


def read_relief(folder: Path, summary: Mapping[str, Any], images: Sequence[str]) -> RowRelief | None:
    """What `recover` found of the ground; None where its summary names none.

    Parameters
    ----------
    folder : Path
        That it wrote.
    summary : mapping
        Its ``summary.json``.
    images : sequence of str
        Names of the images, in the order in which the relief counts them.

    Raises
    ------
    FormatError
        If the table is missing or damaged, or of another image.
    """
    entry = summary.get("relief")
    if entry is None:
        return None
    place = folder / "summary.json"
    with foreign_errors(place, "names no relief in `relief`", "run `sightline recover` again"):
        name = str(entry["image"])
    if name not in images:
        raise FormatError(f"{place}: `relief` is of image {name!r}; there are: {', '.join(images)}")
    path = folder / RELIEF
    if not path.is_file():
        raise FormatError(
            f"{path}: is missing, though {place} names the ground that was found; without it bands lie apart "
            "where that differs from what was given: run `sightline recover` again"
        )
    table = read_columns(path, COLUMNS)
    columns = [np.asarray(table[key], dtype=np.float64) for key in COLUMNS]
    check_times(path, columns[0])
    rms, wrote = float(np.sqrt(np.mean(columns[1] ** 2))), entry.get("rms_height")
    # 9 digits are written
    if isinstance(wrote, float) and not np.isclose(rms, wrote, rtol=1e-6, atol=1e-9):
        raise FormatError(
            f"{path}: its heights are {rms:.6g} m rms, where {place} says {wrote:.6g} m: rows are missing, "
            "or of another result; give the folder as `recover` wrote it, or run it again"
        )
    return RowRelief(
        list(images).index(name), columns[0], np.column_stack(columns[1:3]), np.column_stack(columns[3:])
    )
