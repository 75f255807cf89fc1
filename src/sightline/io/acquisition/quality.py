"""MTF and SNR predicted per column → how much sharper matches are in one column than in another.

Reads ``choice.csv`` of ``sightline tdi``, or any table ``column,mtf_x,mtf_y,snr``.

Not here: what is made of it (``motion/measure/stars.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, reads
from sightline.io.formats.tables import header_of, read_columns

Array = NDArray[np.float64]

QUALITY = ("column", "mtf_x", "mtf_y", "snr")
#: A column is not taken for less than this share of the best: noise and aliasing are matched there too.
LEAST = 0.02


@reads("a table of quality")
def read_match_sigma(path: Path, columns: int) -> Array:
    """(columns, 2) relative sigma along lines and columns of matches at every column; the best is 1.

    Parameters
    ----------
    path : Path
        ``column,mtf_x,mtf_y,snr``; with a ``signal`` column, as of ``choice.csv``, its rows are averaged.
    columns : int
        Of the image; columns between those of the table are interpolated.

    Raises
    ------
    FormatError
        If an MTF lies outside (0, 1], an SNR is not above 0, or columns lie outside the image.

    Notes
    -----
    What a window knows of its place falls with the contrast of what it shows: sigma ~ 1 / (MTF x SNR), MTF
    along lines (y) or columns (x) at the frequency that the table is for.
    """
    header = header_of(path)
    names = (*QUALITY, "signal") if "signal" in header else QUALITY
    table = {name: np.asarray(value, dtype=np.float64) for name, value in read_columns(path, names).items()}
    at, where = np.unique(table["column"], return_inverse=True)
    if at[0] < 0.0 or at[-1] > columns - 1.0 or (at != np.round(at)).any():
        raise FormatError(
            f"{path}: columns {at[0]:g} to {at[-1]:g} do not lie in an image of {columns} columns (0 to "
            f"{columns - 1}); give the table of this band"
        )
    for name, most, allowed in (
        ("mtf_x", 1.0, "above 0 to 1, at the frequency that the table is for"),
        ("mtf_y", 1.0, "above 0 to 1, at the frequency that the table is for"),
        ("snr", np.inf, "above 0"),
    ):
        wrong = np.flatnonzero(~((table[name] > 0.0) & (table[name] <= most)))
        if len(wrong):
            raise FormatError(
                f"{path}: {name} is {table[name][wrong[0]]:g} at column {table['column'][wrong[0]]:g} "
                f"({len(wrong)} such in all); {allowed} is allowed"
            )
    worth = np.empty((len(at), 2))
    for axis, name in enumerate(("mtf_y", "mtf_x")):
        product = table[name] * table["snr"]
        # signals weigh alike: each relative to its own mean over the columns
        if "signal" in table:
            _, signal = np.unique(table["signal"], return_inverse=True)
            product = product / (np.bincount(signal, product) / np.bincount(signal))[signal]
        worth[:, axis] = np.bincount(where, product) / np.bincount(where)
    worth = np.maximum(worth / worth.max(axis=0), LEAST)
    every = np.arange(columns)
    return 1.0 / np.column_stack([np.interp(every, at, worth[:, axis]) for axis in range(2)])
