"""Times of tables of a sequence: seconds from its epoch, or UTC instants in every row of a table.

Not here: times of photographs (``io/formats/exif.py``), what rows are of which frame (``matched_rows.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.io.formats.instants import seconds_from_epoch
from sightline.io.formats.tables import first_row, line_of_row, read_columns

Array = NDArray[np.float64]

_INSTANT = re.compile(r"\d{4}-\d\d-\d\d[T ].*")


def first_instant(path: Path) -> str | None:
    """The `t` of the first row of a table where that is a UTC instant; None where it is seconds."""
    word = first_row(path).get("t", "")
    return word if _INSTANT.fullmatch(word) else None


def _refuse_other_dates(path: Path) -> None:
    """FormatError where the `t` of the first row is neither a number nor a UTC instant."""
    word = first_row(path).get("t", "0")
    try:
        float(word)
    except ValueError:
        raise FormatError(
            f"{path}: line {line_of_row(path, 0)}, column 't': {word!r} is neither seconds from the epoch, "
            "as 12.5, nor a UTC instant, as 2026-01-31T12:00:00Z (all rows of a table alike)"
        ) from None


@reads("a CSV table")
def read_timed(
    path: Path,
    columns: Sequence[str],
    epoch: str | None,
    text: Sequence[str] = (),
    infinite: Sequence[str] = (),
) -> dict[str, list[str] | Array]:
    """The same as `sightline.io.formats.tables.read_columns` of columns with `t`, in s from `epoch` either
    way.

    Raises
    ------
    FormatError
        As there; also where some rows are UTC and others not, and where UTC has no epoch to count from.
    """
    if first_instant(path) is None:
        _refuse_other_dates(path)
        return read_columns(path, columns, text, infinite)
    if epoch is None:
        raise FormatError(
            f"{path}: its times are UTC, those of the frames seconds from an epoch that is not given; add "
            '[sequence] epoch = "..." (UTC of t = 0)'
        )
    table = read_columns(path, columns, (*text, "t"), infinite)
    words = [str(word) for word in table["t"]]
    other = next((k for k, word in enumerate(words) if not _INSTANT.fullmatch(word)), None)
    if other is not None:
        raise FormatError(
            f"{path}: line {line_of_row(path, other)}: t = {words[other]!r} is no UTC instant as that of the "
            f"first row, {words[0]!r}, is; all rows of a table are of one kind"
        )
    table["t"] = np.array(
        [seconds_from_epoch(word, epoch, f"{path}: row {k}") for k, word in enumerate(words, 1)]
    )
    return table
